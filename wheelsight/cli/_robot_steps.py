"""The steps of a robot's calibration, what each needs, and how a loop shows what they are worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.calibration import read_layer
from wheelsight.calibration_history import Measured, history_of
from wheelsight.calibration_layers import NOMINAL
from wheelsight.cli._calibration_files import open_for
from wheelsight.errors import RecordingError
from wheelsight.geometry import se3, so3
from wheelsight.inputs import is_there

# A calibrated differential drive is off by about 1 % of its way at the end of a loop, and its heading by 1° in 10 m.
_GOOD_SHARE, _GOOD_DEG_PER_M, _SHORTEST_M = 0.02, 0.2, 5.0


@dataclass(frozen=True, slots=True)
class Step:
    """One part of a robot's calibration: whether it is there, what it is, how to get it and by which commands."""

    name: str
    is_done: bool
    told: str
    how: str
    commands: tuple[str, ...]


def steps_of(file: Path) -> tuple[list[Step], tuple[Measured, ...]]:
    """The steps in their order, and what was measured so far. Raises CalibrationError for a file that is none."""
    known: dict[str, Any] = read_layer(file) if is_there(file) else {}
    history = history_of(known)
    by = {entry.command for entry in history}
    force = " --force" if known else ""
    return [
        _camera(file, known, by, force),
        _wheels(file, known, by, force),
        _mount(file, known, by, force),
    ], history


def _camera(file: Path, known: dict[str, Any], by: set[str], force: str) -> Step:
    is_done = "calibrate camera" in by and "color" in known
    told = "lenses, T_color_depth and depth_error, by a board" if is_done else "lenses as the maker has them or none"
    how = (
        "Print the board, measure the line on it, glue it to something flat. 20 to 40 views with all still: near and "
        "far, tilted each way, in every corner of the image."
    )
    commands = (
        "wheelsight board --out board.pdf",
        f"wheelsight calibrate camera --camera any --board 9x6:25mm --plate --out {file}{force}",
    )
    return Step("camera", is_done, told, how, commands)


def _wheels(file: Path, known: dict[str, Any], by: set[str], force: str) -> Step:
    is_done = bool({"calibrate wheels", "calibrate umbmark"} & by) and "wheels" in known
    told = "radii, track width, delay" if is_done else "by a data sheet or a ruler, or none"
    how = (
        "Drive a few minutes: straight, turns both ways, some on the spot, stops between; with the camera recorded too."
    )
    nominal = "" if "wheels" in known or "wheels" in known.get(NOMINAL, {}) else " --calibration nominal.yaml"
    commands = (
        f"wheelsight run DRIVE --odometry dense --calibration {file} --out visual",
        f"wheelsight calibrate wheels DRIVE --reference visual/trajectory.txt{nominal} --out {file}{force}",
    )
    return Step("wheels", is_done, told, how, commands)


def _mount(file: Path, known: dict[str, Any], by: set[str], force: str) -> Step:
    is_done = "calibrate base" in by and "T_base_camera" in known
    told = "T_base_camera, found on a drive" if is_done else "by a ruler" if "T_base_camera" in known else "none"
    how = "Drive a minute or two over a flat floor that the camera sees: straight, and turns both ways."
    return Step("mount", is_done, told, how, (f"wheelsight calibrate base DRIVE --out {file}{force}",))


def loop_check(folder: Path, file: Path, topics: Sequence[str] | None) -> tuple[str, bool]:
    """What the wheels make of a drive that ends where it began, in a line, and whether a calibrated robot's does so.

    Raises:
        InputError: a recording without wheels, or a drive too short to tell.
    """
    from wheelsight.odometry.wheels import drive_of, drive_path

    source = open_for(folder, [str(file)], topics)
    wheels = source.calibration.wheels
    if wheels is None:
        raise RecordingError("has no wheels, and FILE tells none", path=folder, fix="calibrate the wheels first")
    drive = drive_of(source, wheels)
    path = drive_path(drive, wheels, drive.stamps_s - wheels.delay_s)
    way_m = path.length_m
    if way_m < _SHORTEST_M:
        raise RecordingError(f"is a drive of {way_m:.1f} m", path=folder, fix=f"drive {_SHORTEST_M:g} m or more")
    T_start_end = se3.invert(path.T_frame_body[0]) @ path.T_frame_body[-1]
    off_m, turn_deg = float(np.linalg.norm(T_start_end[:3, 3])), float(np.degrees(so3.angle(T_start_end[:3, :3])))
    is_good = off_m <= _GOOD_SHARE * way_m and turn_deg <= _GOOD_DEG_PER_M * way_m
    told = f"loop of {way_m:.1f} m: off by {off_m:.3f} m ({100 * off_m / way_m:.1f} % of the way) and {turn_deg:.1f}°"
    return f"{told} at its end, by wheels alone", is_good
