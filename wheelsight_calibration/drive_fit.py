"""Identification of a drive: `fit_drive` finds the `DriveModel` whose free-running speeds fit measured ones.

Free-running: predicted from the commands alone, from the first speed on. Parameters have priors, which hold what a
drive does not show. Errors of neighbouring samples count as dependent: errors of the gain last for a whole step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.drive_model import EDGE, DriveAxis, DriveModel
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray
from wheelsight.wheels.drive_kernels import responses
from wheelsight_calibration.drive_log import DriveLog, Series, series_of
from wheelsight_calibration.parameters import Parameter
from wheelsight_calibration.solver import larger, spread

# Dead time, logarithms of the time constants, and for each direction: dead zone over the largest command U, logarithm
# of the size of the speed at U, bend and jump as shares of it. With a bend of one the slope of the curve ends at zero.
PARAMETERS = (
    Parameter("dead_time_s", 2.0),
    Parameter("log_rise", np.log(100.0)),
    Parameter("log_fall", np.log(100.0)),
    *(
        Parameter(name + side, bound, prior)
        for side in ("_plus", "_minus")
        for name, bound, prior in (
            ("dead_zone", 0.9, 0.5),
            ("log_speed", np.log(100.0), 3.0),
            ("bend", 1.0, 0.5),
            ("jump", 0.9, 0.2),
        )
    ),
)
_DEAD_ZONE, _LOG_SPEED, _BEND, _JUMP = range(4)
_OF_SIDES = (slice(3, 7), slice(7, 11))
# Standard deviations of differences: of the logarithms of both time constants, and of the two directions in dead zone,
# speed, bend and jump. Chosen; chairs back up more slowly than they drive forward, and turn alike to both sides.
_TIMES_SIGMA = 0.7
_SIDES_SIGMAS = {False: (0.1, 1.0, 0.5, 0.1), True: (0.1, 0.3, 0.3, 0.1)}

# What a drive must show; chosen.
_MOVES_M_S = 0.05  # least speed of a rim
_FEWEST_STEPS = 3  # changes of the command
_LEAST_EXPLAINED = 0.5  # share of the speeds' square
_MOST_DEAD_TIME_S, _LEAST_DEAD_TIME_S = 1.8, -0.05
_KNOWN_SHARE, _KNOWN_S = 0.3, 0.08  # σ of what is shown, relative or in seconds
_STEP_S = 1.0  # least duration of a step of the command, whose samples err together
_STARTS_S = (-0.5, 0.1, 0.3, 0.6)
_SETTLED_S = 1.5  # from the end of a turn until the wheels run alike
_OUTLIER = 6.0  # spreads
_RATE_S = 0.3  # over which an acceleration is measured


@dataclass(frozen=True, eq=False)
class AxisFit:
    """Response to one kind of commands, and the series it was found on.

    Attributes:
        axis: the response.
        series, predicted_m_s: what was measured, and the free-running speeds (N,) of each series.
        steps: (N,) for each series, which step of the command a sample belongs to.
        held_out_m_s: root mean square error on every second step by a fit on the others; None with too few steps.
        explained: share of the square of the speeds.
        not_shown: what the drive did not show, each with what to drive.
    """

    axis: DriveAxis
    series: tuple[Series, ...]
    predicted_m_s: tuple[FloatArray, ...]
    steps: tuple[IntArray, ...]
    held_out_m_s: float | None
    explained: float
    not_shown: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class DriveFit:
    """The model of a drive; `straight` and `turn` are None if there were no such commands."""

    model: DriveModel
    straight: AxisFit | None
    turn: AxisFit | None
    names: tuple[str, ...]
    not_shown: tuple[str, ...]
    warnings: tuple[str, ...]


def fit_drive(logs: Sequence[DriveLog]) -> DriveFit:
    """Return the model that the logs of one robot show.

    Raises:
        CalibrationError: logs of several robots or kinds of commands, wheels that do not move or do not follow the
            commands, or stamps of two clocks. It states what to drive.
    """
    kinds, widths = {log.command for log in logs}, {log.track_width_m for log in logs}
    if len(kinds) > 1 or len(widths) > 1:
        what = "joystick and velocity commands" if len(kinds) > 1 else f"track widths {sorted(widths)} m"
        raise CalibrationError(f"the logs have {what}: they are not of one robot", fix="give the logs of one robot")
    name = ", ".join(log.name for log in logs)
    if max(float(np.abs([log.left_m_s, log.right_m_s]).max()) for log in logs) < _MOVES_M_S:
        raise CalibrationError(
            f"{name}: no wheel moves", fix=f"drive a minute or two: {_DRIVE[False]}, and {_DRIVE[True]}"
        )
    fits = [_fit_axis(series_of(logs, is_turn=is_turn), is_turn=is_turn) for is_turn in (False, True)]
    if fits == [None, None]:
        raise CalibrationError(f"{name}: has no commands but stops", fix="record commands of the drive, too")
    straight, turn = fits
    not_shown = [note for fit in fits if fit is not None for note in fit.not_shown]
    not_shown += [f"{_WORDS[i]}: {_DRIVE[bool(i)]}" for i, fit in enumerate(fits) if fit is None]
    model = DriveModel(
        command=logs[0].command,
        straight=None if straight is None else straight.axis,
        turn=None if turn is None else turn.axis,
        track_width_m=logs[0].track_width_m,
    )
    if (ratio := _right_over_left(logs)) is not None:
        model = replace(model, right_over_left=ratio[0], right_over_left_sigma=ratio[1])
    elif straight is not None:
        not_shown.append("the difference of the wheels: drive straight on for some seconds")
    warnings = tuple(dict.fromkeys(warning for log in logs for warning in log.warnings))
    return DriveFit(model, straight, turn, tuple(log.name for log in logs), tuple(not_shown), warnings)


def predicted_m_s(axis: DriveAxis, series: Series) -> FloatArray:
    """Return the free-running speeds (N,) of a response at the stamps of a series."""
    towards = np.array([axis.speed_m_s(command) for command in series.commands.tolist()])
    return _speeds(series, towards, axis.dead_time_s, axis.rise_s, axis.fall_s)


def steps_of_commands(series: Series) -> IntArray:
    """Return for each sample (N,) the number of the step of the command that it belongs to.

    A step begins with a change of the command, and lasts for a second or more.
    """
    begins: list[float] = []
    for stamp_s in series.commands_s[1:].tolist():
        if not begins or stamp_s - begins[-1] >= _STEP_S:
            begins.append(stamp_s)
    return np.searchsorted(np.array(begins), series.stamps_s, side="right")


_WORDS = ("straight on", "turns")
_DRIVE = {
    False: "straight on at several speeds forward and backward, each for two seconds, with stops from speed",
    True: "on the spot at several speeds to both sides, each for two seconds, with stops from speed",
}


class _Static(NamedTuple):
    """The static gain, (2,) each for both directions; shares are of the largest command and of the speed there."""

    sign: float
    largest: float
    values: FloatArray

    def speeds(self, commands: FloatArray) -> FloatArray:
        found = np.zeros(len(commands))
        for side, direction in enumerate((1.0, -1.0)):
            dead, gain, bend, jump = self.coefficients(side)
            above = np.maximum(direction * commands - dead, 0.0)
            found += direction * (jump * -np.expm1(-above / EDGE) + (gain + bend * above) * above)
        return found

    def coefficients(self, side: int) -> tuple[float, float, float, float]:
        """Dead zone, gain, bend and jump as fields of `DriveAxis`."""
        dead_zone, log_speed, bend, jump = self.values[_OF_SIDES[side]].tolist()
        dead = max(dead_zone, 0.0) * self.largest
        most = self.largest - dead
        speed, jump = self.sign * np.exp(log_speed), max(jump, 0.0)
        rest = speed * (1.0 - jump)
        found = dead, rest * (1 + bend) / most, -rest * bend / most**2, speed * jump / -np.expm1(-most / EDGE)
        return tuple(map(float, found))  # type: ignore[return-value]


class _Problem:
    """Residuals of free-running speeds, over the error that a step's samples have together, and priors."""

    def __init__(
        self, series: Sequence[Series], used: Sequence[BoolArray], steps: Sequence[IntArray], *, is_turn: bool
    ):
        self.series, self.used = series, used
        counts, offset = [], 0
        for of_series, good in zip(steps, used, strict=True):
            counts.append(of_series[good] + offset)
            offset += int(of_series.max()) + 1
        self.clusters = np.unique(np.concatenate(counts), return_inverse=True)[1]
        self.samples_a_step = len(self.clusters) / (self.clusters.max() + 1)
        self.largest = max(float(np.abs(one.commands).max()) for one in series)
        agreement = sum(float(one.speeds_m_s @ _held(one)) for one in series)
        self.sign = 1.0 if agreement >= 0 else -1.0
        self.speed = max(float(np.abs(one.speeds_m_s).max()) for one in series)
        self.bounds = np.array([parameter.bound for parameter in PARAMETERS])
        self.low = -self.bounds
        for one in _OF_SIDES:
            self.low[one][[_DEAD_ZONE, _JUMP]] = 0.0
        self.low[:3] = _STARTS_S[0] - 0.4, np.log(0.005), np.log(0.005)
        self.high = self.bounds.copy()
        self.high[1:3] = np.log(4.0)
        self.prior_sigmas = np.array([parameter.prior_sigma for parameter in PARAMETERS])
        self.means = np.zeros(len(PARAMETERS))
        self.means[1:3] = np.log(0.2)
        self.means[[one.start + _LOG_SPEED for one in _OF_SIDES]] = np.log(self.speed)
        self.sides_sigmas = np.array(_SIDES_SIGMAS[is_turn])

    def static(self, values: FloatArray) -> _Static:
        return _Static(self.sign, self.largest, values)

    def errors(self, values: FloatArray) -> FloatArray:
        """(M,) predicted minus measured speeds, m/s."""
        static, times = self.static(values), np.exp(values[1:3])
        found = []
        for one, good in zip(self.series, self.used, strict=True):
            predicted = _speeds(one, static.speeds(one.commands), float(values[0]), float(times[0]), float(times[1]))
            found.append((predicted - one.speeds_m_s)[good])
        return np.concatenate(found)

    def misfit(self, values: FloatArray, sigma_m_s: float) -> FloatArray:
        """Residuals over their σ, and those of the priors."""
        plus, minus = (values[one] for one in _OF_SIDES)
        return np.concatenate(
            [
                _limited(self.errors(values) / sigma_m_s, _OUTLIER / np.sqrt(self.samples_a_step)),
                (values - self.means) / self.prior_sigmas,
                (plus - minus) / self.sides_sigmas,
                [(values[1] - values[2]) / _TIMES_SIGMA],
            ]
        )


def _limited(residuals: FloatArray, scale: float) -> FloatArray:
    """Return residuals whose squares grow linearly beyond a scale (pseudo-Huber)."""
    squares = 2 * scale**2 * (np.sqrt(1 + (residuals / scale) ** 2) - 1)
    return np.sign(residuals) * np.sqrt(squares)


class _Found(NamedTuple):
    values: FloatArray
    covariance: FloatArray
    problem: _Problem


def _solve(problem: _Problem) -> _Found:
    """Return the best values, from several starts: the misfit has local minima in dead time and dead zone."""
    from scipy.optimize import least_squares

    sigma_m_s = 0.03 * problem.speed * np.sqrt(problem.samples_a_step)
    options: dict[str, Any] = {"bounds": (problem.low, problem.high), "diff_step": 1e-4}
    options["x_scale"] = [0.1, 0.3, 0.3, *2 * (0.1, 0.3, 0.3, 0.1)]
    begins = []
    for dead_time_s in _STARTS_S:
        for dead_zone, jump in {(0.02, 0.0), (_stands_up_to(problem), 0.02), (_stands_up_to(problem), 0.2)}:
            values = problem.means.copy()
            values[0] = dead_time_s
            for one in _OF_SIDES:
                values[one][[_DEAD_ZONE, _JUMP]] = dead_zone, jump
            begins.append(least_squares(problem.misfit, values, args=(sigma_m_s,), max_nfev=6, **options))
    best = None
    for begin in sorted(begins, key=lambda found: float(found.cost))[:2]:
        values, own_m_s = begin.x, sigma_m_s
        for _ in range(2):
            own_m_s = _sigma_m_s(problem, values)
            solved = least_squares(problem.misfit, values, args=(own_m_s,), max_nfev=30, **options)
            values = solved.x
        off_m_s = float(np.mean(problem.errors(values) ** 2))
        if best is None or off_m_s < best[0]:
            best = off_m_s, values, solved
    assert best is not None
    _, values, solved = best
    # The inverse Hessian, and around it the scatter of the gradient over steps (Huber 1967), whichever is larger.
    J, r = np.asarray(solved.jac), np.asarray(solved.fun)
    inverse = np.linalg.inv(J.T @ J)
    count = len(problem.clusters)
    gradients = np.zeros((problem.clusters.max() + 1, len(values)))
    np.add.at(gradients, problem.clusters, J[:count] * r[:count, None])
    groups = len(gradients)
    scatter = gradients.T @ gradients * groups / max(groups - 1, 1)
    return _Found(values, larger(inverse @ scatter @ inverse, inverse), problem)


def _sigma_m_s(problem: _Problem, values: FloatArray) -> float:
    """Return the σ of a sample for which samples of a step count as independent, by the errors of moving wheels."""
    pairs = zip(problem.series, problem.used, strict=True)
    moving = np.concatenate([np.abs(one.speeds_m_s)[good] for one, good in pairs])
    errors = problem.errors(values)[moving > 0.05 * problem.speed]
    return max(float(spread(errors[:, None])[0]), 0.002 * problem.speed) * float(np.sqrt(problem.samples_a_step))


def _stands_up_to(problem: _Problem) -> float:
    """Return the share of the largest command up to which the wheels stand, or a small one if unknown."""
    stand, move = 0.0, 1.0
    for one in problem.series:
        held, speeds = np.abs(_held(one)) / problem.largest, np.abs(one.speeds_m_s)
        begin_s = one.commands_s[np.searchsorted(one.commands_s, one.stamps_s, side="right").clip(1) - 1]
        is_settled = (one.stamps_s - begin_s > _STEP_S) & (held > 0)
        is_moving = speeds > 0.02 * problem.speed
        stand = max(stand, float(held[is_settled & ~is_moving].max(initial=0.0)))
        move = min(move, float(held[is_settled & is_moving].min(initial=1.0)))
    return float(np.clip((stand + move) / 2, 0.02, 0.8)) if 0 < stand < move else 0.02


def _held(series: Series) -> FloatArray:
    """Return the command (N,) at each stamp."""
    index = np.searchsorted(series.commands_s, series.stamps_s, side="right").clip(1) - 1
    return np.asarray(series.commands[index])


def _speeds(series: Series, towards: FloatArray, dead_time_s: float, rise_s: float, fall_s: float) -> FloatArray:
    stamps_s, begin_m_s = series.stamps_s, float(series.speeds_m_s[1 if series.is_mean else 0])
    out = responses(series.commands_s + dead_time_s, towards, stamps_s, begin_m_s, rise_s, fall_s)
    if not series.is_mean:
        return out[:, 0]
    return np.concatenate([out[:1, 0], np.diff(out[:, 1]) / np.diff(stamps_s)])


def _fit_axis(series: Sequence[Series], *, is_turn: bool) -> AxisFit | None:
    series = [one for one in series if np.abs(one.speeds_m_s).max() >= _MOVES_M_S / 2 or len(one.commands) > 1]
    if not series:
        return None
    word = _WORDS[is_turn]
    steps = [steps_of_commands(one) for one in series]
    if sum(int(one.max()) for one in steps) < _FEWEST_STEPS:
        return None
    found = _solve(_Problem(series, [one.is_good for one in series], steps, is_turn=is_turn))
    axis = _axis_of(found, series)
    predicted = tuple(predicted_m_s(axis, one) for one in series)
    pairs = list(zip(series, predicted, strict=True))
    left = sum(float(((one.speeds_m_s - by)[one.is_good] ** 2).sum()) for one, by in pairs)
    whole = sum(float((one.speeds_m_s[one.is_good] ** 2).sum()) for one in series)
    explained = 1.0 - left / max(whole, 1e-12)
    names = ", ".join(one.name for one in series)
    dead_time_s = float(found.values[0])
    is_apart = dead_time_s > _MOST_DEAD_TIME_S or dead_time_s < _LEAST_DEAD_TIME_S - 2 * axis.dead_time_sigma_s
    if explained < _LEAST_EXPLAINED or is_apart:
        how = f"the wheels answer {dead_time_s:+.2f} s after the commands" if is_apart else "they do not follow them"
        raise CalibrationError(
            f"{names}: commands explain {100 * max(explained, 0.0):.0f} % of the speeds {word}: {how}",
            fix="stamp commands and readings by one clock, and give commands and wheels of one robot",
        )
    held_out = _held_out_m_s(series, steps, is_turn=is_turn)
    return AxisFit(axis, tuple(series), predicted, tuple(steps), held_out, explained, _not_shown(axis, word, is_turn))


def _held_out_m_s(series: Sequence[Series], steps: Sequence[IntArray], *, is_turn: bool) -> float | None:
    """Return the root mean square error on odd steps by a fit on even ones; None with too few."""
    used = [one.is_good & (of_one % 2 == 0) for one, of_one in zip(series, steps, strict=True)]
    if min(sum(int(of_one.max()) for of_one in steps) // 2, sum(map(np.count_nonzero, used))) < _FEWEST_STEPS:
        return None
    axis = _axis_of(_solve(_Problem(series, used, steps, is_turn=is_turn)), series)
    errors = [
        (predicted_m_s(axis, one) - one.speeds_m_s)[one.is_good & (of_one % 2 == 1)]
        for one, of_one in zip(series, steps, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def _axis_of(found: _Found, series: Sequence[Series]) -> DriveAxis:
    values, problem = found.values, found.problem
    sigmas = np.sqrt(np.diag(found.covariance))
    rise_s, fall_s = np.exp(values[1:3]).tolist()
    command_sigma_s = max(one.command_sigma_s for one in series)
    # Along dead time and the logarithm of the falling time constant.
    gradient = np.array([1.0, fall_s])
    stop_sigma_s = np.hypot(np.sqrt(gradient @ found.covariance[np.ix_((0, 2), (0, 2))] @ gradient), command_sigma_s)
    sides = [problem.static(values).coefficients(side) for side in (0, 1)]
    dead, gain, bend, jump = (tuple(pair) for pair in zip(*sides, strict=True))
    rates = np.concatenate([_rates(one) for one in series])
    held = [(sign * one.commands).max() for sign in (1, -1) for one in series]
    speeds = [(sign * problem.sign * one.speeds_m_s[one.is_good]).max() for sign in (1, -1) for one in series]
    largest = [max(0.0, *map(float, part)) for part in np.reshape(held, (2, -1))]
    fastest = [max(0.0, *map(float, part)) for part in np.reshape(speeds, (2, -1))]
    errors = problem.errors(values)
    dead_sigmas, gain_sigmas = ([float(sigmas[one][index]) for one in _OF_SIDES] for index in (_DEAD_ZONE, _LOG_SPEED))
    return DriveAxis(
        dead_time_s=max(float(values[0]), 0.0),
        rise_s=rise_s,
        fall_s=fall_s,
        dead_zone=dead,
        gain=gain,
        bend=bend,
        jump_m_s=jump,
        largest_command=(largest[0], largest[1]),
        largest_speed_m_s=(fastest[0], fastest[1]),
        acceleration_m_s2=max(0.0, float(rates.max(initial=0.0))),
        braking_m_s2=max(0.0, -float(rates.min(initial=0.0))),
        dead_time_sigma_s=float(np.hypot(sigmas[0], command_sigma_s)),
        rise_sigma_s=float(min(rise_s * sigmas[1], 5.0)),
        fall_sigma_s=float(min(fall_s * sigmas[2], 5.0)),
        stop_sigma_s=float(min(stop_sigma_s, 5.0)),
        dead_zone_sigma=(problem.largest * dead_sigmas[0], problem.largest * dead_sigmas[1]),
        gain_sigma=(gain_sigmas[0], gain_sigmas[1]),
        residual_m_s=float(np.sqrt(np.mean(errors**2))),
    )


def _rates(series: Series) -> FloatArray:
    """Return rates at which the size of the speed changes, over a third of a second each, m/s²."""
    stamps_s = np.arange(series.stamps_s[0], series.stamps_s[-1], _RATE_S / 3)
    speeds = np.interp(stamps_s, series.stamps_s, series.speeds_m_s)
    return (np.abs(speeds[3:]) - np.abs(speeds[:-3])) / _RATE_S


def _not_shown(axis: DriveAxis, word: str, is_turn: bool) -> tuple[str, ...]:
    """Return what the drive did not show, each with what to drive."""
    notes = []
    directions = ("to one side", "to the other side") if is_turn else ("forward", "backward")
    for direction, most in zip(directions, axis.largest_command, strict=True):
        if not most:
            notes.append(f"{word}, {direction}: no command; drive {_DRIVE[is_turn]}")
    for name, value, sigma_s in (
        ("dead time", axis.dead_time_s, axis.dead_time_sigma_s),
        ("time constant of speeding up", axis.rise_s, axis.rise_sigma_s),
        ("time constant of slowing down", axis.fall_s, axis.fall_sigma_s),
    ):
        if sigma_s > max(_KNOWN_SHARE * value, _KNOWN_S):
            notes.append(f"{word}: {name} is known to {sigma_s:.2f} s alone; drive {_DRIVE[is_turn]}")
    return tuple(notes)


def _right_over_left(logs: Sequence[DriveLog]) -> tuple[float, float] | None:
    """Return the ratio of the wheels' speeds at straight commands with its σ; None without straight motion."""
    ratios: list[float] = []
    for log in logs:
        held = np.searchsorted(log.commands_s, log.stamps_s, side="right").clip(1) - 1
        means = (log.left_m_s + log.right_m_s) / 2
        # A turn before has to be over, dead time and lag.
        turned_s = log.stamps_s[log.turn[held] != 0]
        before = np.searchsorted(turned_s, log.stamps_s, side="right") - 1
        last_s = np.where(before >= 0, turned_s[before.clip(0)], -np.inf) if len(turned_s) else -np.inf
        is_straight = (log.stamps_s - last_s > _SETTLED_S) & (log.forward[held] != 0)
        is_straight &= np.abs(means) > max(0.2 * float(np.abs(means).max()), _MOVES_M_S)
        size = max(len(held) // 50, 1)
        for begin in range(0, len(held), size):
            left, right = (side[begin : begin + size][is_straight[begin : begin + size]] for side in _sides(log))
            if len(left) > 3 and np.abs(left).max() > 0:
                ratios.append(float(np.sqrt((right @ right) / (left @ left))))
    if len(ratios) < 3:
        return None
    return float(np.mean(ratios)), float(np.std(ratios, ddof=1) / np.sqrt(len(ratios)))


def _sides(log: DriveLog) -> tuple[FloatArray, FloatArray]:
    return log.left_m_s, log.right_m_s
