"""What a calibration of cameras found, as the fields of a calibration file, and as an entry of its history."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.calibration import Calibration, calibration_fields
from wheelsight.calibration_history import Measured
from wheelsight.calibration_parts import DepthNoise
from wheelsight.camera_calibration.result import CameraCalibration

_CAMERA_PARTS = ("color", "depth", "T_color_depth", "depth_noise", "depth_error", "point_errors", "color_sigma_px")
# Depth cameras see on where no board was held; noise beyond is by the same law.
_LEAST_CONSTANT_M = 1e-4


def camera_calibration(found: CameraCalibration, nominal: Calibration | None = None) -> Calibration:
    """The cameras as a `Calibration`: depth's range, shutter, lateness and `frame_sigma`s stay `nominal`'s."""
    known = nominal if nominal is not None and nominal.color is not None else Calibration()
    constant_m, quadratic_per_m = found.noise or (known.depth_noise.constant_m, known.depth_noise.quadratic_per_m)
    noise = DepthNoise(
        max(constant_m, _LEAST_CONSTANT_M), quadratic_per_m, known.depth_noise.near_m, known.depth_noise.far_m
    )
    apart = found.T_color_depth
    return Calibration(
        color=found.color,
        depth=found.color if apart is None else found.depth,
        T_color_depth=apart,
        depth_noise=noise,
        depth_error=found.depth_error,
        point_errors=found.point_errors,
        color_sigma_px=found.color_sigma_px,
        rolling_shutter_s=known.rolling_shutter_s,
        depth_late_s=known.depth_late_s,
        frame_sigma_m=known.frame_sigma_m,
        frame_sigma_rad=known.frame_sigma_rad,
        source=f"cameras calibrated by {len(found.views)} views of a board",
    )


def camera_fields(found: CameraCalibration, nominal: Calibration | None = None) -> dict[str, Any]:
    """The fields that a calibration of cameras finds."""
    fields = calibration_fields(camera_calibration(found, nominal))
    return {name: fields[name] for name in _CAMERA_PARTS if name in fields}


def measured(command: str, found: CameraCalibration) -> Measured:
    """What a calibration of cameras is worth, for the history."""
    figures = {"views": float(len(found.views)), "reprojection_px": found.color_residuals.rms_px}
    figures |= {f"sigma {name}": found.sigmas[name] for name in ("color.fx", "depth.fx") if name in found.sigmas}
    if "T.x" in found.sigmas:
        figures["sigma_apart_m"] = float(np.sqrt(sum(found.sigmas[f"T.{axis}"] ** 2 for axis in "xyz")))
    if len(found.depth_residuals.off_m):
        figures["plane_rms_m"] = found.depth_residuals.rms_m
    if not found.board.is_size_known:
        figures["square_m"] = found.board.square_m
    what = "color" if found.depth is None else "color, depth" if found.T_color_depth is not None else "registered depth"
    return Measured(what, f"calibrate {command}", figures)
