"""Views that do not determine a calibration, before and after the fit: what is missing is said."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wheelsight.camera_calibration.coach import covered_share, distances, largest_tilt_deg
from wheelsight.camera_calibration.model import Model
from wheelsight.camera_calibration.result import CameraCalibration
from wheelsight.camera_calibration.settings import RefusalSettings
from wheelsight.camera_calibration.views import Corners
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray, se3


def check_lens_views(
    model: Model, x: FloatArray, corners: Sequence[Corners], keeps_color: bool, settings: RefusalSettings
) -> None:
    """Refuse views whose geometry leaves something open. Raises CalibrationError, naming all of it."""
    T = se3.from_parts(*model.poses_of(x))
    problems, fixes = [], []
    if not keeps_color:
        tilt_deg = largest_tilt_deg(T)
        if tilt_deg < settings.least_tilt_deg:
            problems.append(f"all boards face the same way (tilts differ by {tilt_deg:.0f}°)")
            fixes.append("tilt the board by 30° to each side, up and down")
        size = model.color_start.width, model.color_start.height
        cover = covered_share([seen.px for seen in corners], size)
        if cover < settings.least_cover:
            problems.append(f"boards are seen in {100 * cover:.0f} % of the image alone")
            fixes.append("bring the board near, and into every corner of the image; or --keep-color")
    if len(model.cells.px):
        nearest, farthest = distances(T)
        if farthest < settings.least_distance_ratio * nearest:
            problems.append(f"all boards are {nearest:.2f} to {farthest:.2f} m away")
            fixes.append("add views from twice as far")
    if problems:
        raise CalibrationError(f"the views do not determine it: {'; '.join(problems)}", fix="; ".join(fixes))


def refuse_unsure(found: CameraCalibration, model: Model, keeps_color: bool, settings: RefusalSettings) -> None:
    """Refuse a result that is not sure enough. Raises CalibrationError, naming each number and its σ."""
    if found.color_residuals.rms_px > settings.largest_rms_px:
        problem = f"corners are {found.color_residuals.rms_px:.1f} px off what any lens explains"
        raise CalibrationError(problem, fix="check the counts of --board, that it is flat, and that nothing moved")
    sigmas, limits = found.sigmas, []
    if not keeps_color:
        widths = model.color_start.width / 640
        limits += [("color.fx", settings.focal_sigma * found.color.fx, "px")]
        limits += [(name, settings.centre_sigma_px * widths, "px") for name in ("color.cx", "color.cy")]
    if found.depth is not None and "depth.fx" in sigmas:
        limits.append(("depth.fx", settings.focal_sigma * found.depth.fx, "px"))
    limits += [(f"T.{axis}", settings.apart_sigma_m, "m") for axis in "xyz"]
    limits += [(f"T.turn_{axis}_deg", settings.apart_sigma_deg, "°") for axis in "xyz"]
    unsure = [f"{name} (σ {sigmas[name]:.2g} {unit})" for name, most, unit in limits if sigmas.get(name, 0) > most]
    if len(found.depth_sigma_m):
        known = found.depth_sigma_m[found.depth_sigma_m[:, 0] <= _farthest_m(found)]
        worst = known[int(np.argmax(known[:, 1]))]
        if worst[1] > settings.depth_sigma_m:
            unsure.append(f"depth at {worst[0]:.1f} m (σ {1e3 * worst[1]:.0f} mm)")
    if unsure:
        fix = "add views: near and far, tilted to each side, in every corner of the image"
        raise CalibrationError(f"the views do not determine: {', '.join(unsure)}", fix=fix)


def doubts_beyond(found: CameraCalibration, settings: RefusalSettings) -> tuple[str, ...]:
    """A warning where depth's σ is told beyond the farthest board, and is much larger there."""
    if not len(found.depth_sigma_m):
        return ()
    farthest_m = _farthest_m(found)
    at_board_m = float(np.interp(farthest_m, *found.depth_sigma_m.T))
    end_m, at_end_m = found.depth_sigma_m[-1].tolist()
    if at_end_m <= settings.beyond_factor * at_board_m:
        return ()
    told = f"Depth is known to {1e3 * at_board_m:.0f} mm where boards end, at {farthest_m:.1f} m,"
    return (f"{told} and to {1e3 * at_end_m:.0f} mm at {end_m:.1f} m: add boards that far if depth is used there.",)


def _farthest_m(found: CameraCalibration) -> float:
    """To where boards were, but for single cells."""
    return float(np.percentile(found.depth_residuals.depth_m, 99))
