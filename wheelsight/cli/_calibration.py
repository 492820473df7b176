"""What the commands of `wheelsight calibrate` share: squares from either source, results told and saved."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from wheelsight.calibration import Calibration, Wheels, load_calibration
from wheelsight.cli._console import console, print_warning
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray
from wheelsight.odometry.extrinsics import BaseCalibration
from wheelsight.odometry.wheels.squares import (
    errors_on_unused_runs_m,
    read_return_errors,
    square_run,
    umbmark_from_runs,
)
from wheelsight.odometry.wheels.trial import WheelTrial
from wheelsight.odometry.wheels.umbmark import Umbmark, umbmark
from wheelsight.recordings import Recording
from wheelsight.report.base_tables import mount_rows
from wheelsight.report.wheel_tables import HEAD, error_rows, fit_rows, square_rows


@dataclass(frozen=True, eq=False)
class Squares:
    """UMBmark with what is told of it: errors that corrected wheels leave, of clockwise and of the other runs.

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
    """From a table of return position errors. Raises CalibrationError where what it needs beside it is missing."""
    if not calibration or side_m is None:
        raise CalibrationError("a table tells neither wheels nor side", path=path, fix="add --calibration and --side")
    nominal = load_calibration(*calibration)
    result = umbmark(_wheels(nominal), *read_return_errors(path), side_m)
    return Squares(path.name, result, result.errors_after_m, nominal)


def squares_from_recordings(recordings: Sequence[Recording], side_m: float | None) -> Squares:
    """From recordings of one square each, all of one robot."""
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
    told = tuple(dict.fromkeys(warning for recording in recordings for warning in recording.warnings))
    after_m = (errors[~turns_left], errors[turns_left])
    return Squares(name, result, after_m, recordings[0].calibration, unused_m, told)


def print_trial(trial: WheelTrial, written: str, page: Path | None) -> None:
    """Wheels and errors before and after, and where the files are."""
    stdout, fit = console(), trial.fit
    along, across, turn = fit.spread
    slips = f"{len(fit.segments)} segments, {int(fit.is_slip.sum())} of them slips or jumps"
    left = f"{1e3 * along:.1f} mm along, {1e3 * across:.1f} mm across, {np.degrees(turn):.2f}°"
    stdout.print(table(f"{trial.recording}: wheels", HEAD, fit_rows(fit)))
    stdout.print(f"{slips}; left unexplained in each: {left}")
    title = f"errors on the {trial.held_out.length_m:.1f} m that the fit did not see, RMSE"
    stdout.print()
    stdout.print(table(title, ("", "nominal", "calibrated"), error_rows(trial)))
    print_end(trial.warnings, written, page)


def print_squares(squares: Squares, written: str, page: Path | None) -> None:
    """The same for UMBmark."""
    stdout, result = console(), squares.result
    stdout.print(table(f"{squares.name}: wheels", HEAD, square_rows(result)))
    before_m, after_m = result.largest_error_m, result.largest_error_after_m
    stdout.print(f"E_max,syst, sides of {result.side_m:.3g} m: {before_m:.3f} m nominal, {after_m:.3f} m corrected")
    if squares.unused_m is not None:
        told = "mean error of each run by wheels corrected without it"
        stdout.print(f"{told}: {squares.unused_m[0]:.3f} m nominal, {squares.unused_m[1]:.3f} m corrected")
    print_end(squares.warnings, written, page)


def print_mount(found: BaseCalibration, written: str, page: Path | None) -> None:
    """A camera's mount before and after, and where the files are."""
    stdout, fit = console(), found.fit
    stdout.print(table(f"{found.recording}: where the camera sits", HEAD, mount_rows(found)))
    pieces = f"{len(fit.segments)} pieces, {int(fit.is_slip.sum())} of them slips or jumps"
    stdout.print(f"{pieces}; floor seen in {len(found.floor.tilts)} of {found.floor.view_count} views")
    print_end(found.warnings, written, page)


@contextmanager
def show_steps() -> Iterator[Callable[[str], None]]:
    """Says on stderr what is being done, where a terminal watches."""
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


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """A table for a terminal: numbers to the right."""
    table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    for column in head:
        table.add_column(column, justify="right" if column else "left")
    for row in rows:
        table.add_row(*row)
    return table


def print_end(warnings: Sequence[str], written: str, page: Path | None) -> None:
    """What to know, and where the files are."""
    for warning in warnings:
        print_warning(warning)
    console().print(f"calibration: {written}", markup=False)
    if page is not None:
        console().print(f"page: {page}", markup=False)
