"""The unit of a simulated robot, calibrated as docs/tutorial-your-robot.md says, without any truth.

A board before that camera gives lenses, registration and depth's error (`calibrate camera --plate`, without
`--registered`: the driver's registration is off by some pixels, and so the two images are two cameras). Squares whose
ends are measured by tape give the wheels (`calibrate umbmark`, which leaves their mean size as it was), and a drive
through the simulator's flat, with stops and turns on the spot, where the camera sits (`calibrate base`).

By squares right over left is within 0.01 %. By the camera's way (`calibrate wheels --reference`) radii came out 0.7 to
1.0 % too small while the depth lens was taken for straight (docs/decisions/calibration).
"""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.board_views import BOARD
from benchmarks.calibrated_sources import with_calibration
from benchmarks.unit_views import VIEWS, bench_of, views_of
from wheelsight.core.calibration import Calibration, load_calibration, save_calibration, save_layer
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3
from wheelsight.core.settings.calibration import CameraCalibrationSettings, RefusalSettings
from wheelsight.io.recordings.recording import express_for
from wheelsight_calibration.base import Sightings, calibrate_base, mount_values
from wheelsight_calibration.camera_model import CameraSetup
from wheelsight_calibration.cameras import CameraCalibration, calibrate_camera, camera_fields
from wheelsight_calibration.motion_errors import typical_motion_errors
from wheelsight_calibration.squares import square_run, umbmark_from_runs
from wheelsight_calibration.views import ViewSet
from wheelsight_calibration.wheels import fit_wheels
from wheelsight_sim import SimulatedRecording, SimulationSettings, camera_model, simulate, stream

DISTANCES_M = (0.8, 1.2, 2.0, 3.0, 4.0)
_SENSORS = {"kinect-v1": "structured-light", "kinect-v2": "tof"}
SQUARES = 3  # each way; Borenstein & Feng drive five
_TAPE_SIGMA_M = 0.003  # by a tape measure. Chosen
# Without infrared images a Kinect v1's scale of depth is stated to 1 %: 0.036 m at 3.7 m, of which units are off 0.01.
_DEPTH_SIGMA_M = 0.06
_DRIVE_HZ, _DAY = 10.0, 900  # from this day on nothing is measured


@dataclass(frozen=True, eq=False)
class FoundUnit:
    """A robot calibrated by its owner.

    Attributes:
        settings: of a drive of it.
        nominal: what the data sheet says; cameras in their own size.
        calibration: what was found, cameras likewise.
        camera: by the board.
        sigmas: of the mount and the delay, by name.
        by_way: the wheels as `calibrate wheels --reference` has them by the camera's way over the drive; not used.
        drive: by which these were found, for judging.
    """

    settings: SimulationSettings
    nominal: Calibration
    calibration: Calibration
    camera: CameraCalibration
    sigmas: dict[str, float]
    by_way: Wheels
    drive: SimulatedRecording


def add_option(parser: argparse.ArgumentParser) -> None:
    """`--calibrated`, the folder of units."""
    parser.add_argument(
        "--calibrated",
        type=Path,
        nargs="?",
        const=Path("calibrated_units"),
        metavar="DIR",
        help="gives the robot a calibration of its unit, found as the tutorial says and kept in this folder",
    )


def calibration_for(settings: SimulationSettings, folder: Path, reported: Callable[[str], None] = print) -> Calibration:
    """The calibration of a drive's robot for images of the drive's size, made where the folder has none of the unit."""
    path = folder / f"{settings.camera}-{settings.seed}-{zlib.crc32(repr(settings.robot).encode()):08x}.yaml"
    if not path.exists():
        found = calibrated(settings, folder)
        for line in judged(found):
            reported(line)
        save_calibration(found.calibration, path)
    return of_size(load_calibration(path), settings.size)


def calibrated(settings: SimulationSettings, folder: Path, views: int = VIEWS) -> FoundUnit:
    """The unit of a drive, calibrated by a board and a drive; what the board reported is left in the folder too."""
    drive = simulate(calibrating_drive(settings))
    nominal = of_size(drive.calibration, _own_size(settings))
    squared = replace(nominal, wheels=by_squares(settings))
    camera = by_board(views_of(settings, views), settings.camera)
    path = folder / f"board-{settings.camera}-{settings.seed}.yaml"
    folder.mkdir(parents=True, exist_ok=True)
    save_layer({"format": "wheelsight-calibration-1"} | camera_fields(camera, nominal), path)
    cameras = of_size(load_calibration(path, under=squared), settings.size)
    base = calibrate_base(with_calibration(drive, cameras))
    found = replace(cameras, wheels=base.wheels, T_base_camera=base.T_base_camera)
    way = by_way(base.sightings, found)
    return FoundUnit(settings, nominal, of_size(found, _own_size(settings)), camera, base.sigmas, way, drive)


def by_board(views: ViewSet, camera: str) -> CameraCalibration:
    """As `wheelsight calibrate camera --plate --config` has it, which else asks for more views or infrared images."""
    settings = CameraCalibrationSettings(refusal=RefusalSettings(depth_sigma_m=_DEPTH_SIGMA_M))
    return calibrate_camera(views, BOARD, CameraSetup(_SENSORS[camera], on_plate=True), settings)


def by_way(sightings: Sightings, found: Calibration) -> Wheels:
    """As `wheelsight calibrate wheels --reference` has it, by the camera's way over all of the drive."""
    assert found.wheels is not None
    reference, errors = express_for("base", sightings.camera, found), typical_motion_errors(found)
    return fit_wheels(found.wheels, sightings.drive, reference, camera_errors=errors).wheels


def by_squares(settings: SimulationSettings, each_way: int = SQUARES) -> Wheels:
    """As `wheelsight calibrate umbmark` has it, by so many squares each way."""
    rng, drives = stream(settings.seed, "tape"), list[SimulatedRecording]()
    for number in range(2 * each_way):
        turned = {"stops_to_turn": True, "is_reverse": number % 2 == 1}
        drives.append(simulate(_driven(settings, "square", _DAY + 1 + number, **turned)))
    wheels = drives[0].calibration.wheels
    assert wheels is not None
    runs = [square_run(drive, wheels) for drive in drives]
    runs = [replace(run, true_end_m=run.true_end_m + _TAPE_SIGMA_M * rng.standard_normal(2)) for run in runs]
    return umbmark_from_runs(wheels, runs).wheels


def calibrating_drive(settings: SimulationSettings) -> SimulationSettings:
    """A lap of the flat by the robot of a drive: straight, turns both ways and on the spot, stops between."""
    return _driven(settings, "flat", _DAY, stops_to_turn=True)


def _driven(settings: SimulationSettings, world: str, day: int, **way: bool) -> SimulationSettings:
    robot = {"seed": settings.seed, "robot": settings.robot, "realism": settings.realism}
    return SimulationSettings(world, settings.camera, settings.size, _DRIVE_HZ, day=day, **robot, **way)  # type: ignore[arg-type]


def of_size(calibration: Calibration, size: tuple[int, int] | None) -> Calibration:
    """The same robot with images of another size of the same field of view; errors of depth are stated by shares."""
    color, depth = calibration.cameras
    if size is None or size == (color.width, color.height):
        return calibration
    share = size[0] / color.width
    sigma_px = calibration.color_sigma_px * share
    return replace(calibration, color=_resized(color, size), depth=_resized(depth, size), color_sigma_px=sigma_px)


def judged(found: FoundUnit) -> list[str]:
    """Each part beside the truth: before, after, and the σ that it states."""
    return [*_judged_camera(found), *_judged_wheels(found), *_judged_mount(found)]


def points_off_m(found: FoundUnit, calibration: Calibration, depth_m: float) -> FloatArray:
    """(63, 3) how far points of a frontal wall, by depth without noise, lie off in the colour camera's frame."""
    bench, (_, depth) = bench_of(found.settings), calibration.cameras
    true, registration = bench.lens, bench.unit.registration
    u, v = np.meshgrid(np.linspace(0.1, 0.9, 9) * true.width, np.linspace(0.2, 0.9, 7) * true.height)
    px = np.rint(np.stack([u.ravel(), v.ravel()], axis=-1))
    seen_px = px
    if registration is not None:
        seen_px = px + registration.scale * (px - np.array([true.width, true.height]) / 2) + registration.offset_px
        seen_px = seen_px + registration.parallax_px_m / depth_m
    reading_m = bench.wall_m(depth_m)[px[:, 1].astype(int), px[:, 0].astype(int)]
    points = depth.back_project(px, calibration.depth_error.of_readings(reading_m, px, depth))
    return np.asarray(
        se3.apply(calibration.T_color_camera, points) - true.back_project(seen_px, np.full(len(px), depth_m))
    )


def _judged_camera(found: FoundUnit) -> list[str]:
    color, true, sigmas = found.camera.color, bench_of(found.settings).lens, found.camera.sigmas
    lines = []
    for name in ("fx", "fy", "cx", "cy"):
        before, after = (getattr(lens, name) - getattr(true, name) for lens in (found.nominal.cameras[0], color))
        lines.append(f"colour {name}: off by {before:+.2f} px, then {after:+.2f} (σ {sigmas[f'color.{name}']:.2f})")
    for depth_m in DISTANCES_M:
        before, after = (points_off_m(found, one, depth_m) for one in (found.nominal, found.calibration))
        sigma_m = float(np.interp(depth_m, *found.camera.depth_sigma_m.T))
        lines.append(
            f"points at {depth_m:g} m, RMS: depth off by {_rms_mm(before[:, 2:])} mm, then {_rms_mm(after[:, 2:])}"
            f" (mean {1e3 * after[:, 2].mean():+.1f}, σ {1e3 * sigma_m:.1f}); aside {_rms_mm(before[:, :2])} mm,"
            f" then {_rms_mm(after[:, :2])}"
        )
    return lines


def _rms_mm(off_m: FloatArray) -> str:
    return f"{1e3 * np.sqrt((off_m**2).sum(axis=1).mean()):.1f}"


def _judged_wheels(found: FoundUnit) -> list[str]:
    true, before, after = (one.wheels for one in (found.drive.true_calibration, found.nominal, found.calibration))
    assert true is not None
    assert before is not None
    assert after is not None
    lines = []
    for name in ("left_radius_m", "right_radius_m", "track_width_m"):
        size_m = getattr(true, name)
        off = [100 * (getattr(one, name) / size_m - 1) for one in (before, after, found.by_way)]
        shares = [one.turn_sigma if name == "track_width_m" else one.scale_sigma for one in (after, found.by_way)]
        lines.append(
            f"{name[:-2]}: off by {off[0]:+.2f} %, then {off[1]:+.2f} % (σ {100 * shares[0]:.2f} %);"
            f" by the camera's way {off[2]:+.2f} % (σ {100 * shares[1]:.2f} %)"
        )
    drift = [np.degrees(_drift_rad_m(one) - _drift_rad_m(true)) for one in (before, after)]
    sigma_deg = np.degrees(after.drift_sigma_rad_per_m)
    lines.append(f"turn by unequal radii: off by {drift[0]:+.4f} °/m, then {drift[1]:+.4f} (σ {sigma_deg:.4f})")
    return lines


def _drift_rad_m(wheels: Wheels) -> float:
    return (
        2
        * (wheels.right_radius_m - wheels.left_radius_m)
        / (wheels.right_radius_m + wheels.left_radius_m)
        / wheels.track_width_m
    )


def _judged_mount(found: FoundUnit) -> list[str]:
    T_base_color = [
        np.asarray(one.T_base_camera) @ se3.invert(one.T_color_camera)
        for one in (found.drive.true_calibration, found.nominal, found.calibration)
    ]
    true, before, after = (mount_values(T) for T in T_base_color)
    lines = []
    for name in true:
        unit, factor = ("mm", 1e3) if name in ("x", "y", "height") else ("°", np.degrees(1.0))
        off = [factor * (one[name] - true[name]) for one in (before, after)]
        sigma = factor * found.sigmas[name]
        lines.append(f"mount, {name}: off by {off[0]:+.2f} {unit}, then {off[1]:+.2f} (σ {sigma:.2f})")
    return lines


def _own_size(settings: SimulationSettings) -> tuple[int, int]:
    camera = camera_model(settings.camera).camera
    return camera.width, camera.height


def _resized(lens: PinholeCamera, size: tuple[int, int]) -> PinholeCamera:
    across, down = size[0] / lens.width, size[1] / lens.height
    # An image's edge is at -0.5, and that is what must stay.
    cx, cy = (lens.cx + 0.5) * across - 0.5, (lens.cy + 0.5) * down - 0.5
    return PinholeCamera(*size, lens.fx * across, lens.fy * down, cx, cy, lens.distortion)
