"""UMBmark: wheel ratio and track width from the return errors of square runs in both directions.

After Borenstein & Feng, "Measurement and correction of systematic odometry errors in mobile robots", IEEE Trans.
Robotics and Automation 12 (1996). A wrong track width and unequal wheels bend a square alike in one direction and
oppositely in the other one, so that both directions together separate them. The mean radius stays, because a square
does not depend on size. Return errors come from recordings or from a table measured by tape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import FloatArray
from wheelsight.core.inputs import Kind, as_number, lines_of, read_text, split_words
from wheelsight.io.recordings import Recording
from wheelsight.io.recordings.recording import express_for
from wheelsight_calibration.parameters import stated
from wheelsight_calibration.wheel_drive import WheelDrive, drive_of, poses_at, sizes_m

_LARGEST_FACTOR = 1.5
_LONGEST_SIDE_M = 1000.0  # a longer side is probably in another unit
_DERIVATIVE_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class Umbmark:
    """Result of square runs in both directions.

    Attributes:
        nominal: wheels of the runs.
        side_m: length of the squares' sides.
        clockwise_m, counter_clockwise_m: (n, 2), (m, 2) return position errors, true minus computed.
        diameter_ratio: E_d, right wheel over left wheel.
        track_factor: E_b, actual track width over nominal.
        diameter_ratio_sigma, track_factor_sigma: from the scatter of the runs; None for a single run in a direction.
    """

    nominal: Wheels
    side_m: float
    clockwise_m: FloatArray
    counter_clockwise_m: FloatArray
    diameter_ratio: float
    track_factor: float
    diameter_ratio_sigma: float | None
    track_factor_sigma: float | None

    @property
    def wheels(self) -> Wheels:
        """Corrected wheels: the mean of both radii stays, their ratio and the track width change.

        They have σ if there are several runs in each direction.
        """
        found = corrected(self.nominal, self.diameter_ratio, self.track_factor)
        if self.diameter_ratio_sigma is None or self.track_factor_sigma is None:
            return found
        return stated(found, self.diameter_ratio_sigma, self.track_factor_sigma)

    @property
    def largest_error_m(self) -> float:
        """E_max,syst: distance of the centre of gravity from the start, in the worse direction."""
        return max(float(np.hypot(*runs.mean(axis=0))) for runs in (self.clockwise_m, self.counter_clockwise_m))

    @property
    def errors_after_m(self) -> tuple[FloatArray, FloatArray]:
        """Errors (n, 2), (m, 2) of each run after the correction, by the model of the square."""
        explained = _square_errors(self.nominal, self.side_m, np.array([self.diameter_ratio, self.track_factor]))
        return self.clockwise_m - explained[:2], self.counter_clockwise_m - explained[2:]

    @property
    def largest_error_after_m(self) -> float:
        """E_max,syst after the correction."""
        return max(float(np.hypot(*runs.mean(axis=0))) for runs in self.errors_after_m)


def umbmark(wheels: Wheels, clockwise_m: ArrayLike, counter_clockwise_m: ArrayLike, side_m: float) -> Umbmark:
    """Return wheel ratio E_d and track factor E_b from the return position errors of square runs.

    The closed form of the paper (see `closed_form`) is the initial value. The solution uses the exact eight arcs of
    both squares, because the paper's small-angle approximation costs some per cent of the correction.

    Args:
        wheels: of the runs.
        clockwise_m, counter_clockwise_m: (n, 2) and (m, 2), true minus computed end position of each run, metres, in
            the frame of its start: x along the first side, y to the left.
        side_m: length of the squares' sides.

    Raises:
        CalibrationError: no run in one direction, values that are not finite, or impossible errors.
    """
    from scipy.optimize import least_squares

    runs = _checked(clockwise_m, "clockwise"), _checked(counter_clockwise_m, "counter-clockwise")
    if not 0 < side_m <= _LONGEST_SIDE_M:
        raise CalibrationError(f"the squares' side is {side_m} m", fix="give its length, 4 m in the paper")
    means = np.concatenate([errors.mean(axis=0) for errors in runs])
    if np.abs(means).max() > side_m:
        raise CalibrationError(
            f"the runs end {np.abs(means).max():.3g} m off, more than a side of {side_m:g} m",
            fix="errors are true minus computed, in metres, in the frame of the run's start",
        )
    start = closed_form(wheels, *runs, side_m)
    solution = least_squares(lambda factors: _square_errors(wheels, side_m, factors) - means, start, x_scale=1e-3)
    ratio, factor = (float(x) for x in solution.x)
    if not all(1 / _LARGEST_FACTOR < x < _LARGEST_FACTOR for x in (ratio, factor)):
        raise CalibrationError(
            f"the squares ask for a wheel ratio of {ratio:.3g} and {factor:.3g} times the track width"
        )
    if min(len(errors) for errors in runs) < 2:
        return Umbmark(wheels, side_m, *runs, ratio, factor, None, None)
    # Standard deviations, propagated from the mean errors.
    factors, steps = np.array([ratio, factor]), _DERIVATIVE_STEP * np.eye(2)
    columns = [_square_errors(wheels, side_m, factors + h) - _square_errors(wheels, side_m, factors - h) for h in steps]
    gain = np.linalg.pinv(np.stack(columns, axis=1) / (2 * _DERIVATIVE_STEP))
    of_means = np.zeros((4, 4))
    for i, errors in enumerate(runs):
        of_means[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = np.cov(errors.T) / len(errors)
    return Umbmark(wheels, side_m, *runs, ratio, factor, *np.sqrt(np.diag(gain @ of_means @ gain.T)).tolist())


def closed_form(wheels: Wheels, clockwise_m: ArrayLike, counter_clockwise_m: ArrayLike, side_m: float) -> FloatArray:
    """Return E_d and E_b (2,) by the paper's formulas; each angle is the mean of those by x and by y.

    α, the error of a turn at a corner, and β, the turning along a side, follow from the centres of gravity of the
    errors. A side that turns by β has a radius R = (L/2) / sin(β/2); E_d = (R + b/2) / (R - b/2), and
    E_b = 90° / (90° - α).
    """
    (x_cw, y_cw), (x_ccw, y_ccw) = (
        np.asarray(errors, float).mean(axis=0) for errors in (clockwise_m, counter_clockwise_m)
    )
    alpha = np.mean([x_cw + x_ccw, y_cw - y_ccw]) / (-4 * side_m)
    beta = np.mean([x_cw - x_ccw, y_cw + y_ccw]) / (-4 * side_m)
    curvature = 2 * np.sin(beta / 2) / side_m
    half = curvature * wheels.track_width_m / 2
    return np.array([(1 + half) / (1 - half), (np.pi / 2) / (np.pi / 2 - alpha)])


def corrected(wheels: Wheels, diameter_ratio: float, track_factor: float) -> Wheels:
    """Return wheels with radii that change by `diameter_ratio` (right over left) at the same mean."""
    left, right = _radius_factors(wheels, diameter_ratio)
    return replace(
        wheels,
        left_radius_m=left * wheels.left_radius_m,
        right_radius_m=right * wheels.right_radius_m,
        track_width_m=track_factor * wheels.track_width_m,
    )


def _radius_factors(wheels: Wheels, diameter_ratio: float) -> tuple[float, float]:
    """Return the factors of left and right radius, c_l and c_r of the paper, which starts with equal wheels."""
    total = wheels.left_radius_m + wheels.right_radius_m
    left = total / (wheels.left_radius_m + diameter_ratio * wheels.right_radius_m)
    return left, diameter_ratio * left


def _square_errors(wheels: Wheels, side_m: float, factors: FloatArray) -> FloatArray:
    """Return the ends (4,) of a clockwise and a counter-clockwise square, for wheel errors E_d and E_b (2,).

    By its odometry, each side is straight and `side_m` long, and each corner a right angle on the spot.
    """
    left, right = _radius_factors(wheels, float(factors[0]))
    track_width_m = float(factors[1]) * wheels.track_width_m
    ends = []
    for sense in (-1, 1):
        rolled_m = sense * np.pi / 4 * wheels.track_width_m
        side = np.array([left, right]) * side_m
        corner = np.array([-left, right]) * rolled_m
        position, yaw_rad = 0j, 0.0
        for left_m, right_m in (side, corner) * 4:
            turn_rad = (right_m - left_m) / track_width_m
            chord_m = (right_m + left_m) / 2 * np.sinc(turn_rad / (2 * np.pi))
            position += chord_m * np.exp(1j * (yaw_rad + turn_rad / 2))
            yaw_rad += turn_rad
        ends += [position.real, position.imag]
    return np.array(ends)


def _checked(errors_m: ArrayLike, name: str) -> FloatArray:
    errors = np.array(errors_m, float)
    if errors.ndim != 2 or errors.shape[1] != 2 or not len(errors):
        raise CalibrationError(f"there is no {name} run", fix="drive the square in both directions, five times each")
    if not np.isfinite(errors).all():
        raise CalibrationError("a return position error is not a finite number")
    return errors


_COLUMNS = ("direction", "x_m", "y_m")
_FILE = Kind("a table of return errors", most_mb=16)
_LARGEST_M = 1e3  # of a return error
_LEAST_TURN_RAD, _MOST_TURN_RAD = 1.5 * np.pi, 2.5 * np.pi


@dataclass(frozen=True, eq=False)
class SquareRun:
    """One recorded square.

    Attributes:
        name: of the recording.
        drive: its readings.
        start_s, end_s: stamps of the true poses at its start and end.
        true_end_m: (2,) true end, in the frame of its start.
    """

    name: str
    drive: WheelDrive
    start_s: float
    end_s: float
    true_end_m: FloatArray

    def path(self, wheels: Wheels) -> FloatArray:
        """Return x, y, yaw (N, 3) by `wheels`, from the start."""
        inside = self.drive.stamps_s[(self.drive.stamps_s > self.start_s) & (self.drive.stamps_s < self.end_s)]
        poses = poses_at(
            self.drive, sizes_m(wheels), np.concatenate([[self.start_s], inside, [self.end_s]]) + wheels.delay_s
        )
        steps = (poses[:, :2] - poses[0, :2]) @ np.array([1, 1j]) * np.exp(-1j * poses[0, 2])
        return np.column_stack([steps.real, steps.imag, poses[:, 2] - poses[0, 2]])

    def way_m(self, wheels: Wheels) -> float:
        """Return its signed length: moving back and forth cancels."""
        x, y, yaw_rad = self.path(wheels).T
        middle_rad = (yaw_rad[1:] + yaw_rad[:-1]) / 2
        return float(np.sum(np.diff(x) * np.cos(middle_rad) + np.diff(y) * np.sin(middle_rad)))

    def turns_left(self, wheels: Wheels) -> bool:
        """Whether it is counter-clockwise."""
        return bool(self.path(wheels)[-1, 2] > 0)

    def error_m(self, wheels: Wheels) -> FloatArray:
        """Return the return position error (2,), true minus computed."""
        return np.asarray(self.true_end_m - self.path(wheels)[-1, :2])


def square_run(recording: Recording, wheels: Wheels) -> SquareRun:
    """Return the run of a recording of one square, with ground truth at least at its start and end.

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
    """Return the UMBmark of recorded squares; direction and side come from their turns and lengths.

    Raises:
        CalibrationError: see `umbmark`.
    """
    if side_m is None:
        side_m = float(np.median([run.way_m(wheels) / 4 for run in runs])) if runs else 0.0
    errors = np.array([run.error_m(wheels) for run in runs]).reshape(-1, 2)
    turns_left = np.array([run.turns_left(wheels) for run in runs], bool)
    return umbmark(wheels, errors[~turns_left], errors[turns_left], side_m)


def errors_on_unused_runs_m(wheels: Wheels, runs: Sequence[SquareRun]) -> FloatArray | None:
    """Return the end error (N,) of each run by wheels corrected by all others; None for too few runs."""
    directions = [run.turns_left(wheels) for run in runs]
    if min(directions.count(True), directions.count(False)) < 2:
        return None
    others = [[run for run in runs if run is not left_out] for left_out in runs]
    found = [umbmark_from_runs(wheels, rest).wheels for rest in others]
    return np.array([np.hypot(*run.error_m(after)) for run, after in zip(runs, found, strict=True)])


def read_return_errors(path: StrPath) -> tuple[FloatArray, FloatArray]:
    """Read clockwise (n, 2) and counter-clockwise (m, 2) errors of a table with columns direction, x_m, y_m.

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
        direction, error_m = row[0].lower(), [as_number(word) for word in row[1:]]
        is_valid = direction in errors and len(error_m) == 2 and all(abs(metres) <= _LARGEST_M for metres in error_m)
        if not is_valid:
            problem = f"cw or ccw and two numbers are expected, not {','.join(row)!r}"
            raise CalibrationError(problem, path=path, line=line, fix="such as cw,0.12,-0.03, in metres")
        errors[direction].append((error_m[0], error_m[1]))
    clockwise, counter_clockwise = (np.array(errors[name]).reshape(-1, 2) for name in ("cw", "ccw"))
    return clockwise, counter_clockwise
