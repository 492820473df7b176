"""Return position errors of square runs: from recordings of them, or from a table measured by tape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wheelsight.calibration import Wheels
from wheelsight.errors import CalibrationError
from wheelsight.files import StrPath
from wheelsight.geometry import FloatArray
from wheelsight.inputs import Kind, as_number, lines_of, read_text, split_words
from wheelsight.odometry.wheels.drive import Drive, drive_of, poses_at
from wheelsight.odometry.wheels.umbmark import Umbmark, umbmark
from wheelsight.recordings import Recording
from wheelsight.recordings.bodies import express_for

_COLUMNS = ("direction", "x_m", "y_m")
_FILE = Kind("a table of return errors", most_mb=16)
_LARGEST_M = 1e3  # of a return error
_LEAST_TURN_RAD, _MOST_TURN_RAD = 1.5 * np.pi, 2.5 * np.pi


@dataclass(frozen=True, eq=False)
class SquareRun:
    """One square that was driven and recorded.

    Attributes:
        name: of the recording.
        drive: its readings.
        start_s, end_s: when the true poses at its start and end were taken.
        true_end_m: (2,) where it truly ended, in the frame of its start.
    """

    name: str
    drive: Drive
    start_s: float
    end_s: float
    true_end_m: FloatArray

    def path(self, wheels: Wheels) -> FloatArray:
        """x, y, yaw (N, 3) that `wheels` make of it, from the start."""
        sizes = np.array([wheels.left_radius_m, wheels.right_radius_m, wheels.track_width_m])
        inside = self.drive.stamps_s[(self.drive.stamps_s > self.start_s) & (self.drive.stamps_s < self.end_s)]
        poses = poses_at(self.drive, sizes, np.concatenate([[self.start_s], inside, [self.end_s]]) + wheels.delay_s)
        steps = (poses[:, :2] - poses[0, :2]) @ np.array([1, 1j]) * np.exp(-1j * poses[0, 2])
        return np.column_stack([steps.real, steps.imag, poses[:, 2] - poses[0, 2]])

    def way_m(self, wheels: Wheels) -> float:
        """How far it went; back and forth on the spot comes to nothing."""
        x, y, yaw_rad = self.path(wheels).T
        middle_rad = (yaw_rad[1:] + yaw_rad[:-1]) / 2
        return float(np.sum(np.diff(x) * np.cos(middle_rad) + np.diff(y) * np.sin(middle_rad)))

    def turns_left(self, wheels: Wheels) -> bool:
        """Whether it went counter-clockwise."""
        return bool(self.path(wheels)[-1, 2] > 0)

    def error_m(self, wheels: Wheels) -> FloatArray:
        """Return position error (2,), true minus computed."""
        return np.asarray(self.true_end_m - self.path(wheels)[-1, :2])


def square_run(recording: Recording, wheels: Wheels) -> SquareRun:
    """A recording of one square whose ground truth has, at least, a pose at the start and one at the end.

    Raises:
        CalibrationError: no two true poses, too few readings, or no turn of about 360° in all.
    """
    truth = recording.ground_truth
    if truth is None or len(truth) < 2:
        raise CalibrationError(
            f"{recording.name} has no true poses of start and end", fix="write them to its ground truth, or a table"
        )
    truth = express_for("base", truth, recording.calibration)
    T_start_end = np.linalg.inv(truth.T_frame_body[0]) @ truth.T_frame_body[-1]
    start_s, end_s = float(truth.stamps_s[0]), float(truth.stamps_s[-1])
    run = SquareRun(recording.name, drive_of(recording, wheels), start_s, end_s, T_start_end[:2, 3])
    turn_rad = abs(run.path(wheels)[-1, 2])
    if not _LEAST_TURN_RAD < turn_rad < _MOST_TURN_RAD:
        raise CalibrationError(
            f"{recording.name} turns by {np.degrees(turn_rad):.0f}° between its true poses, a square by 360°",
            fix="record each square by itself, from start to end",
        )
    return run


def umbmark_from_runs(wheels: Wheels, runs: Sequence[SquareRun], side_m: float | None = None) -> Umbmark:
    """UMBmark of recorded squares; which way each went is seen from its turning, the side from its length.

    Raises:
        CalibrationError: see `umbmark`.
    """
    if side_m is None:
        side_m = float(np.median([run.way_m(wheels) / 4 for run in runs])) if runs else 0.0
    errors = np.array([run.error_m(wheels) for run in runs]).reshape(-1, 2)
    turns_left = np.array([run.turns_left(wheels) for run in runs], bool)
    return umbmark(wheels, errors[~turns_left], errors[turns_left], side_m)


def errors_on_unused_runs_m(wheels: Wheels, runs: Sequence[SquareRun]) -> FloatArray | None:
    """Distance (N,) by which each run misses its true end with wheels corrected by all others; None for too few."""
    directions = [run.turns_left(wheels) for run in runs]
    if min(directions.count(True), directions.count(False)) < 2:
        return None
    others = [[run for run in runs if run is not left_out] for left_out in runs]
    found = [umbmark_from_runs(wheels, rest).wheels for rest in others]
    return np.array([np.hypot(*run.error_m(after)) for run, after in zip(runs, found, strict=True)])


def read_return_errors(path: StrPath) -> tuple[FloatArray, FloatArray]:
    """Clockwise (n, 2) and counter-clockwise (m, 2) errors of a table with columns direction, x_m, y_m.

    Direction is cw or ccw; x and y are true minus computed, in the frame of the run's start.

    Raises:
        CalibrationError: naming file and line.
    """
    path = Path(path)
    lines = enumerate(lines_of(read_text(path, _FILE, CalibrationError)), start=1)
    rows = [(number, words) for number, line in lines if (words := split_words(line))]
    if not rows or tuple(word.lower() for word in rows[0][1]) != _COLUMNS:
        problem, fix = "the first line must be " + ",".join(_COLUMNS), "then one run a line, such as cw,0.12,-0.03"
        raise CalibrationError(problem, path=path, line=1, fix=fix)
    errors: dict[str, list[tuple[float, float]]] = {"cw": [], "ccw": []}
    for line, row in rows[1:]:
        direction, error_m = _parse(row, path, line)
        errors[direction].append(error_m)
    clockwise, counter_clockwise = (np.array(errors[name]).reshape(-1, 2) for name in ("cw", "ccw"))
    return clockwise, counter_clockwise


def _parse(row: list[str], path: Path, line: int) -> tuple[str, tuple[float, float]]:
    direction = row[0].lower()
    error_m = [as_number(word) for word in row[1:]]
    if direction not in ("cw", "ccw") or len(error_m) != 2 or not all(abs(metres) <= _LARGEST_M for metres in error_m):
        problem = f"cw or ccw and two numbers are expected, not {','.join(row)!r}"
        raise CalibrationError(problem, path=path, line=line, fix="such as cw,0.12,-0.03, in metres")
    return direction, (error_m[0], error_m[1])
