"""The steps of a robot's calibration, what each needs, and how a loop shows what they are worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wheelsight.calibration import read_layer
from wheelsight.calibration_history import Measured, history_of
from wheelsight.calibration_layers import NOMINAL
from wheelsight.cli._calibration_files import open_for
from wheelsight.errors import CalibrationError, RecordingError
from wheelsight.inputs import is_there

if TYPE_CHECKING:
    from wheelsight.odometry.wheels import LoopCause, LoopCheck


@dataclass(frozen=True, slots=True)
class Step:
    """One part of a robot's calibration: whether it was measured, what is known of it, how to measure it.

    Attributes:
        is_done: whether a calibration of ours measured it.
        is_known: whether the file has values of it, a ruler's or the maker's at least.
        told: what those values are.
    """

    name: str
    is_done: bool
    is_known: bool
    told: str
    how: str
    commands: tuple[str, ...]

    @property
    def state(self) -> str:
        """In a word or two."""
        return "measured" if self.is_done else "not measured" if self.is_known else "missing"


def steps_of(file: Path) -> tuple[list[Step], tuple[Measured, ...]]:
    """The steps in their order, and what was measured so far. Raises CalibrationError for a file that is none."""
    known: dict[str, Any] = read_layer(file) if is_there(file) else {}
    history = history_of(known)
    by = {entry.command for entry in history}
    force = " --force" if known else ""
    return [
        _camera(file, known, by, force),
        _mount(file, known, by, force),
        _wheels(file, known, by, force),
    ], history


def _camera(file: Path, known: dict[str, Any], by: set[str], force: str) -> Step:
    is_done = "calibrate camera" in by and "color" in known
    is_known = "color" in known
    told = "lenses, T_color_depth and depth_error, by a board" if is_done else "lenses as the maker has them"
    how = (
        "Print the board, measure the line on it, glue it to something flat. 20 to 40 views with all still: near and "
        "far, tilted each way, in every corner of the image."
    )
    commands = (
        "wheelsight board --out board.pdf",
        f"wheelsight calibrate camera --camera any --board 9x6:25mm --plate --out {file}{force}",
    )
    return Step("camera", is_done, is_known, told if is_known else "a live camera's maker says them", how, commands)


def _mount(file: Path, known: dict[str, Any], by: set[str], force: str) -> Step:
    is_done = "calibrate base" in by and "T_base_camera" in known
    is_known = "T_base_camera" in known
    told = "T_base_camera, found on a drive" if is_done else "T_base_camera, by a ruler" if is_known else "none"
    how = (
        "Drive two minutes over a flat floor that the camera sees: straight, turns both ways, some on the spot, stops "
        "between. Wheels by a ruler will do."
    )
    given = f" --calibration {file}" if known else ""
    if not _has_wheels(known):
        given += " --calibration nominal.yaml"
    return Step("mount", is_done, is_known, told, how, (f"wheelsight calibrate base DRIVE{given} --out {file}{force}",))


def _wheels(file: Path, known: dict[str, Any], by: set[str], force: str) -> Step:
    is_done = bool({"calibrate wheels", "calibrate umbmark"} & by) and "wheels" in known
    is_known = _has_wheels(known)
    told = "radii, track width, delay" if is_done else "by a data sheet or a ruler" if is_known else "none"
    # The camera's way tells of the wheels once it is known where on the robot the camera sits.
    how = "The same drive, or another of some minutes: straight, turns both ways, some on the spot, stops between."
    commands = (
        f"wheelsight run DRIVE --odometry dense --calibration {file} --out visual",
        f"wheelsight calibrate wheels DRIVE --reference visual/trajectory.txt --calibration {file} --out {file}{force}",
    )
    return Step("wheels", is_done, is_known, told, how, commands)


def _has_wheels(known: dict[str, Any]) -> bool:
    return "wheels" in known or "wheels" in known.get(NOMINAL, {})


def loop_check(folder: Path, file: Path, topics: Sequence[str] | None) -> tuple[tuple[str, ...], bool]:
    """What the wheels make of a drive that ends where it began, in lines, and whether a calibrated robot's does so.

    Raises:
        InputError: a recording without wheels, or a drive too short to tell.
    """
    from wheelsight.fusion.error_state import ErrorStateSettings
    from wheelsight.odometry.wheels import check_loop, drive_of, with_sigmas

    source = open_for(folder, [str(file)], topics)
    if source.calibration.holonomic is not None:
        raise RecordingError(source.calibration.lacks_two_wheels, path=folder, fix="a robot with two driven wheels")
    if source.calibration.wheels is None:
        raise RecordingError("has no wheels, and FILE tells none", path=folder, fix="calibrate the wheels first")
    likely = ErrorStateSettings()
    wheels = with_sigmas(source.calibration.wheels, likely.scale_sigma, likely.drift_sigma_rad_per_m, likely.turn_sigma)
    try:
        found = check_loop(drive_of(source, wheels), wheels)
    except CalibrationError as error:
        raise RecordingError(error.problem, path=folder, fix=error.fix) from error
    is_stated = wheels is source.calibration.wheels
    return (_loop_off(found), f"{_loop_against(found, is_stated)} {_loop_advice(found)}"), (
        found.is_as_stated and found.is_good
    )


def _loop_off(found: LoopCheck) -> str:
    degrees, count = np.degrees(found.off_rad), abs(found.turns)
    way = "counter-clockwise" if found.turns > 0 else "clockwise"
    turns = f"{count} turn{'s' if count > 1 else ''} {way}" if count else "no whole turn left over"
    a_turn = f", {degrees / count:+.2f}° a turn" if count else ""
    return (
        f"loop of {found.way_m:.1f} m, {turns}: by the wheels alone it ends {found.off_m:.3f} m "
        f"({1e3 * found.off_m / found.way_m:.1f} mm a metre) and {degrees:+.1f}° ({degrees / found.way_m:+.2f}° a metre"
        f"{a_turn}) off its start."
    )


def _loop_against(found: LoopCheck, is_stated: bool) -> str:
    whose = "The calibration's σ make" if is_stated else "The calibration states no σ; a data sheet's make"
    likely = f"{whose} {found.sizes_sigma_m:.3f} m and {np.degrees(found.sizes_sigma_rad):.1f}° likely"
    with_slip = f"with slip and the mark {found.off_sigma_m:.3f} m and {np.degrees(found.off_sigma_rad):.1f}°"
    return f"{likely}, {with_slip}: {'no more than that is off.' if found.is_as_stated else 'it is off by more.'}"


def _loop_advice(found: LoopCheck) -> str:
    """The next thing to do."""
    if found.is_as_stated:
        return "" if found.is_good else "Those σ are large: calibrate the wheels, on a longer drive."
    if not found.causes:
        return "No size of the wheels explains it: a wheel slipped, or it did not end at its mark; drive it again."
    told = " or ".join(_cause(cause, amount) for cause, amount in found.causes)
    return (
        f"It is as if {told}. Drive it the other way round: off to the same side again, the radii are unlike; to the "
        "other side, it is the track width. Then calibrate the wheels anew."
    )


def _cause(cause: LoopCause, amount: float) -> str:
    from wheelsight.odometry.wheels import LoopCause

    if cause is LoopCause.DRIFT:
        return f"the wheels turned it by {np.degrees(amount):+.2f}° a metre"
    return f"the track width were {100 * abs(amount):.1f} % too {'narrow' if amount > 0 else 'wide'}"
