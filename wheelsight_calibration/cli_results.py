"""Shows and saves results of calibrations: squares, mount and wheels, the file's history, and the steps of a
robot's calibration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.app.cli.console import console, print_warning, rows_table
from wheelsight.core.calibration import NOMINAL, Calibration, Measured, history_of, load_calibration, read_layer
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.inputs import is_there
from wheelsight.io.recordings import Recording
from wheelsight_calibration.base import BaseCalibration
from wheelsight_calibration.camera_page import mount_rows
from wheelsight_calibration.cli_options import open_for
from wheelsight_calibration.squares import (
    Umbmark,
    errors_on_unused_runs_m,
    read_return_errors,
    square_run,
    umbmark,
    umbmark_from_runs,
)
from wheelsight_calibration.wheel_page import HEAD as CALIBRATION_HEAD
from wheelsight_calibration.wheel_page import error_rows, fit_rows, square_rows
from wheelsight_calibration.wheels import WheelTrial


@dataclass(frozen=True, eq=False)
class Squares:
    """UMBmark with figures for its report: errors that corrected wheels leave, of clockwise and of the other runs.

    `nominal` is what was known before. `unused_m` are mean distances before and after, of each run by wheels corrected
    without it; None for too few runs.
    """

    name: str
    result: Umbmark
    after_m: tuple[FloatArray, FloatArray]
    nominal: Calibration
    unused_m: tuple[float, float] | None = None
    warnings: tuple[str, ...] = ()


def squares_from_table(path: Path, calibration: Sequence[str] | None, side_m: float | None) -> Squares:
    """UMBmark from a table of return position errors. Raises CalibrationError without wheels or side."""
    if not calibration or side_m is None:
        raise CalibrationError("a table has neither wheels nor side", path=path, fix="add --calibration and --side")
    nominal = load_calibration(*calibration)
    result = umbmark(_wheels(nominal), *read_return_errors(path), side_m)
    return Squares(path.name, result, result.errors_after_m, nominal)


def squares_from_recordings(recordings: Sequence[Recording], side_m: float | None) -> Squares:
    """UMBmark from recordings of one square each, all of one robot."""
    nominal = _wheels(recordings[0].calibration)
    for recording in recordings[1:]:
        if recording.calibration.wheels != nominal:
            raise CalibrationError(
                f"{recording.name} and {recordings[0].name} have different nominal wheels",
                fix="give those of the robot by --calibration",
            )
    runs = [square_run(recording, nominal) for recording in recordings]
    result = umbmark_from_runs(nominal, runs, side_m)
    errors = np.array([run.error_m(result.wheels) for run in runs])
    turns_left = np.array([run.turns_left(nominal) for run in runs])
    left_out_m = errors_on_unused_runs_m(nominal, runs)
    unused_m = None
    if left_out_m is not None:
        unused_m = (float(np.mean([np.hypot(*run.error_m(nominal)) for run in runs])), float(left_out_m.mean()))
    name = f"{len(runs)} squares, {runs[0].name} to {runs[-1].name}"
    warnings = tuple(dict.fromkeys(warning for recording in recordings for warning in recording.warnings))
    after_m = (errors[~turns_left], errors[turns_left])
    return Squares(name, result, after_m, recordings[0].calibration, unused_m, warnings)


def print_trial(trial: WheelTrial, written: str, page: Path | None) -> None:
    """Print wheels and errors before and after, and the paths of the files."""
    stdout, fit = console(), trial.fit
    along, across, turn = fit.spread
    slips = f"{len(fit.segments)} segments, {int(fit.is_slip.sum())} of them slips or jumps"
    left = f"{1e3 * along:.1f} mm along, {1e3 * across:.1f} mm across, {np.degrees(turn):.2f}°"
    stdout.print(rows_table(f"{trial.recording}: wheels", CALIBRATION_HEAD, fit_rows(fit)))
    stdout.print(f"{slips}; left unexplained in each: {left}")
    title = f"errors on the {trial.held_out.length_m:.1f} m that the fit did not see, RMSE"
    stdout.print()
    stdout.print(rows_table(title, ("", "nominal", "calibrated"), error_rows(trial)))
    print_end(trial.warnings, written, page)


def print_squares(squares: Squares, written: str, page: Path | None) -> None:
    """Print results of UMBmark, as `print_trial`."""
    stdout, result = console(), squares.result
    stdout.print(rows_table(f"{squares.name}: wheels", CALIBRATION_HEAD, square_rows(result)))
    before_m, after_m = result.largest_error_m, result.largest_error_after_m
    stdout.print(f"E_max,syst, sides of {result.side_m:.3g} m: {before_m:.3f} m nominal, {after_m:.3f} m corrected")
    if squares.unused_m is not None:
        label = "mean error of each run by wheels corrected without it"
        stdout.print(f"{label}: {squares.unused_m[0]:.3f} m nominal, {squares.unused_m[1]:.3f} m corrected")
    print_end(squares.warnings, written, page)


def print_mount(found: BaseCalibration, written: str, page: Path | None) -> None:
    """Print a camera's mount before and after, and the paths of the files."""
    stdout, fit = console(), found.fit
    stdout.print(rows_table(f"{found.recording}: where the camera sits", CALIBRATION_HEAD, mount_rows(found)))
    pieces = f"{len(fit.segments)} pieces, {int(fit.is_slip.sum())} of them slips or jumps"
    stdout.print(f"{pieces}; floor seen in {len(found.floor.tilts)} of {found.floor.view_count} views")
    print_end(found.warnings, written, page)


@contextmanager
def show_steps() -> Iterator[Callable[[str], None]]:
    """Show the current step on stderr if it is a terminal."""
    stderr = console(stderr=True)
    if not stderr.is_terminal:
        yield lambda _: None
        return
    with stderr.status("starting") as status:
        yield lambda step: status.update(step[: stderr.width - 2])


def _wheels(calibration: Calibration) -> Wheels:
    if calibration.wheels is None:
        problem = f"the calibration ({calibration.source}) {calibration.lacks_two_wheels}"
        raise CalibrationError(problem, fix="give nominal ones by --calibration")
    return calibration.wheels


def print_end(warnings: Sequence[str], written: str, page: Path | None) -> None:
    """Print warnings, and the paths of the files."""
    for warning in warnings:
        print_warning(warning)
    console().print(f"calibration: {written}", markup=False)
    if page is not None:
        console().print(f"page: {page}", markup=False)


HEAD = ("", "by", "what", "figures")


def measured_wheels(trial: WheelTrial) -> Measured:
    """The history entry of wheels fitted to a reference."""
    before, after = (x.evaluation.ate.translation.rmse for x in (trial.before, trial.after))
    figures = {"segments": float(len(trial.fit.segments)), "ate_nominal_m": before, "ate_m": after}
    figures |= {f"sigma {name}": float(value) for name, value in trial.fit.sigmas.items()}
    return Measured(f"wheels, on {trial.recording}", "calibrate wheels", figures)


def measured_squares(squares: Squares) -> Measured:
    """The history entry of UMBmark."""
    before_m, after_m = squares.result.largest_error_m, squares.result.largest_error_after_m
    figures = {"side_m": squares.result.side_m, "error_nominal_m": before_m, "error_m": after_m}
    return Measured(f"wheels, by {squares.name}", "calibrate umbmark", figures)


def measured_mount(found: BaseCalibration) -> Measured:
    """The history entry of a camera's mount."""
    figures = {"pieces": float(len(found.fit.segments)), "views_with_floor": float(len(found.floor.tilts))}
    return Measured(f"T_base_camera, on {found.recording}", "calibrate base", figures)


def history_rows(history: Sequence[Measured]) -> list[tuple[str, ...]]:
    """One row an entry, the newest last."""
    return [
        (
            entry.date,
            entry.command,
            entry.what,
            ", ".join(f"{name} {value:.4g}" for name, value in entry.figures.items()),
        )
        for entry in history
    ]


@dataclass(frozen=True, slots=True)
class CalibrationStep:
    """One part of a robot's calibration: whether it was measured, what is known of it, how to measure it.

    Attributes:
        is_done: whether a calibration of ours measured it.
        is_known: whether the file has values of it, a ruler's or the maker's at least.
        values: what those values are.
    """

    name: str
    is_done: bool
    is_known: bool
    values: str
    how: str
    commands: tuple[str, ...]

    @property
    def state(self) -> str:
        """The state in one or two words."""
        return "measured" if self.is_done else "not measured" if self.is_known else "missing"


def steps_of(file: Path) -> tuple[list[CalibrationStep], tuple[Measured, ...]]:
    """The steps in their order, and what was measured so far. Raises CalibrationError for an invalid file."""
    known: dict[str, Any] = read_layer(file) if is_there(file) else {}
    history = history_of(known)
    by = {entry.command for entry in history}
    out = f"--out {file}" + (" --force" if known else "")
    has_wheels = "wheels" in known or "wheels" in known.get(NOMINAL, {})
    given = (f" --calibration {file}" if known else "") + ("" if has_wheels else " --calibration nominal.yaml")

    def step(name: str, is_done: bool, is_known: bool, values: Sequence[str], how: str, *todo: str) -> CalibrationStep:
        """`values`: measured, known, and missing."""
        return CalibrationStep(name, is_done, is_known, values[0 if is_done else 1 if is_known else 2], how, todo)

    camera = step(
        "camera",
        "calibrate camera" in by and "color" in known,
        "color" in known,
        (
            "lenses, T_color_depth and depth_error, by a board",
            "lenses as the maker has them",
            "a live camera's maker says them",
        ),
        "Print the board, measure the line on it, glue it to something flat. 20 to 40 views with all still: near and "
        "far, tilted each way, in every corner of the image.",
        "wheelsight board --out board.pdf",
        f"wheelsight calibrate camera --camera any --board 9x6:25mm --plate {out}",
    )
    mount = step(
        "mount",
        "calibrate base" in by and "T_base_camera" in known,
        "T_base_camera" in known,
        ("T_base_camera, found on a drive", "T_base_camera, by a ruler", "none"),
        "Drive two minutes over a flat floor that the camera sees: straight, turns both ways, some on the spot, stops "
        "between. Wheels by a ruler will do.",
        f"wheelsight calibrate base DRIVE{given} {out}",
    )
    # The camera's path calibrates the wheels once its mount is known.
    wheels = step(
        "wheels",
        bool({"calibrate wheels", "calibrate umbmark"} & by) and "wheels" in known,
        has_wheels,
        ("radii, track width, delay", "by a data sheet or a ruler", "none"),
        "The same drive, or another of some minutes: straight, turns both ways, some on the spot, stops between.",
        f"wheelsight run DRIVE --odometry dense --calibration {file} --out visual",
        f"wheelsight calibrate wheels DRIVE --reference visual/trajectory.txt --calibration {file} {out}",
    )
    drive = step(
        "drive",
        "calibrate drive" in by and "drive_model" in known,
        "drive_model" in known,
        ("drive_model: dead time, time constants, gain", "drive_model, by hand", "none: it is taken to obey at once"),
        "A drive of a minute or two with its commands: several speeds forward and backward and turns to both sides, "
        "each for two seconds, with stops from speed.",
        f"wheelsight drive --robot PORT --calibration {file} --explore --out first",
        f"wheelsight calibrate drive first{given} {out}",
    )
    return [camera, mount, wheels, drive], history


def loop_check(folder: Path, file: Path, topics: Sequence[str] | None) -> tuple[tuple[str, ...], bool]:
    """Lines on the closing error of a loop by the wheels alone, and whether it is that of a calibrated robot.

    Raises:
        InputError: a recording without wheels, or a drive that is too short.
    """
    from wheelsight.estimation import ErrorStateSettings
    from wheelsight_calibration.loop_check import LoopCause, check_loop, with_sigmas
    from wheelsight_calibration.wheel_drive import drive_of

    source = open_for(folder, [str(file)], topics)
    if source.calibration.holonomic is not None:
        raise RecordingError(source.calibration.lacks_two_wheels, path=folder, fix="a robot with two driven wheels")
    if source.calibration.wheels is None:
        raise RecordingError("has no wheels, and FILE has none either", path=folder, fix="calibrate the wheels first")
    usual = ErrorStateSettings()
    wheels = with_sigmas(source.calibration.wheels, usual.scale_sigma, usual.drift_sigma_rad_per_m, usual.turn_sigma)
    try:
        found = check_loop(drive_of(source, wheels), wheels)
    except CalibrationError as error:
        raise RecordingError(error.problem, path=folder, fix=error.fix) from error
    is_stated = wheels is source.calibration.wheels
    degrees, count = np.degrees(found.off_rad), abs(found.turns)
    way = "counter-clockwise" if found.turns > 0 else "clockwise"
    turns = f"{count} turn{'s' if count > 1 else ''} {way}" if count else "no whole turn left over"
    a_turn = f", {degrees / count:+.2f}° a turn" if count else ""
    off = (
        f"loop of {found.way_m:.1f} m, {turns}: by the wheels alone it ends {found.off_m:.3f} m "
        f"({1e3 * found.off_m / found.way_m:.1f} mm a metre) and {degrees:+.1f}° ({degrees / found.way_m:+.2f}° a metre"
        f"{a_turn}) off its start."
    )
    whose = "The calibration's σ make" if is_stated else "The calibration states no σ; a data sheet's make"
    likely = f"{whose} {found.sizes_sigma_m:.3f} m and {np.degrees(found.sizes_sigma_rad):.1f}° likely"
    with_slip = f"with slip and the mark {found.off_sigma_m:.3f} m and {np.degrees(found.off_sigma_rad):.1f}°"
    against = f"{likely}, {with_slip}: {'no more than that is off.' if found.is_as_stated else 'it is off by more.'}"
    if found.is_as_stated:
        advice = "" if found.is_good else "Those σ are large: calibrate the wheels, on a longer drive."
    elif not found.causes:
        advice = "No size of the wheels explains it: a wheel slipped, or it did not end at its mark; drive it again."
    else:
        causes = " or ".join(
            f"the wheels turned it by {np.degrees(amount):+.2f}° a metre"
            if cause is LoopCause.DRIFT
            else f"the track width were {100 * abs(amount):.1f} % too {'narrow' if amount > 0 else 'wide'}"
            for cause, amount in found.causes
        )
        advice = (
            f"It is as if {causes}. Drive it the other way round: off to the same side again, the radii are unlike; to "
            "the other side, it is the track width. Then calibrate the wheels again."
        )
    return (off, f"{against} {advice}"), found.is_as_stated and found.is_good
