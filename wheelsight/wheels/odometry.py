"""`WheelOdometry` integrates the readings of a differential drive into a pose with covariance.

The travel of both wheels gives distance and turn (Trinh et al., eq. 2), and these give the next pose by one of three
integrations: "euler", along the previous heading (Trinh et al., eq. 3); "midpoint", along the mean heading (Ligocki,
eq. 1); "arc", along the arc, exact for constant wheel speeds. The variance of a wheel's travel grows with its distance,
independently of the other wheel. The yaw rate of a gyroscope, if there is one, is fused with the turn of the wheels
five times a second. It is used as given; `GyroCheck` decides whether it contradicts the wheels.

`ReadingTimes` corrects the stamps of readings that are stamped when they arrive.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration_parts import Gyro, HolonomicWheels, Wheels, least_step
from wheelsight.core.checks import check_event, need_kind, need_number
from wheelsight.core.errors import ArgumentError
from wheelsight.core.estimates import PoseFinding, Reason, WheelEstimate, status_of
from wheelsight.core.geometry import BoolArray, ByteArray, FloatArray, se3
from wheelsight.core.messages import OdometryReading, WheelCounts, WheelReading, WheelSpeeds, WheelTicks
from wheelsight.core.settings import CHOSEN, Settings, setting
from wheelsight.core.stamps import StampCheck
from wheelsight.core.threads import OneCaller, one_at_a_time
from wheelsight.core.trajectory import Trajectory
from wheelsight.wheels import state_kernels as at
from wheelsight.wheels.odometry_kernels import (
    ARC,
    BACKWARDS,
    COUNT_VARIANCE,
    EULER,
    GAP_LIMIT,
    GYRO_VARIANCE,
    IMPLAUSIBLE,
    INTEGRATION,
    LEFT_M,
    MIDPOINT,
    OK,
    PARAMETERS_SIZE,
    RIGHT_M,
    SLIP_SQUARED,
    SPAN,
    SPEED_LIMIT,
    TRACK,
    WALK_VARIANCE,
    Log,
    LogPoses,
    integrate,
    likelier,
    update,
)

Integration = Literal["arc", "midpoint", "euler"]

_INTEGRATIONS = {"euler": EULER, "midpoint": MIDPOINT, "arc": ARC}
_REASONS = (None, Reason.CLOCK_BACKWARDS, Reason.GAP, Reason.COUNTER_AMBIGUOUS, Reason.IMPLAUSIBLE_MOTION)
_DEAD_RECKONED, _REFUSED = status_of(PoseFinding.DEAD_RECKONED), status_of(PoseFinding.READING_REFUSED)
_WIDE = 2**53  # beyond, floats do not represent a roll-over exactly
_PLANE = np.array([0, 1, 5])  # vx, vy, ωz of a (6,) perturbation


class WheelSettings(Settings):
    """How wheel readings become a pose."""

    integration: Integration = setting(
        "arc", "of a step: exact, by Ligocki's eq. 1 (midpoint), or by Trinh's eq. 3 (euler)", "the papers"
    )
    gyro: bool = setting(
        True,
        "fuse the yaw rates of a gyroscope, if the recording has them",
        "docs/wheel-odometry.md: a real skid-steered robot, and ten simulated drives",
    )
    gyro_gap_s: float = setting(
        0.1, "over a longer gap between its readings, a gyroscope gives no turn, seconds", CHOSEN, gt=0, le=10
    )


class WheelOdometry(OneCaller):
    """Pose of the base in the frame `odom`, which starts at the first reading.

    A reading is refused if its stamp is not newer, if it comes too late (`max_gap_s`), if counters may have rolled over
    by more than half their range, or if a wheel exceeds `max_speed_m_s`. Then the pose stays, the covariance grows by
    any possible motion, and the next reading continues from there. A stamp that runs backwards changes nothing.

    Args:
        wheels: of the robot. Estimates have the time of the motion as their stamp: `stamp_s - delay_s`.
        integration: "arc", "midpoint" or "euler".
        gyro: noise of the yaw rates; None for the defaults of `Gyro`.
    """

    def __init__(self, wheels: Wheels, integration: Integration = "arc", gyro: Gyro | None = None) -> None:
        self._wheels = need_kind("wheels", wheels, Wheels, "calibration.wheels")
        self._parameters, self._states = _prepare(wheels, integration, gyro or Gyro())
        self._span, self._count_variance = self._parameters[SPAN], self._parameters[COUNT_VARIANCE]
        self._counter_span = wheels.counter_span
        self._ticks_per_rad = wheels.ticks_per_turn / (2 * math.pi)
        self._T_odom_base, self._covariance = np.eye(4), np.zeros((6, 6))
        self._last: WheelTicks | WheelSpeeds | None = None
        self._stamps = StampCheck()
        self._answered: tuple[float, FloatArray, FloatArray] | None = None
        self._paused_s = self._step_s = 0.0

    @property
    def _state(self) -> FloatArray:
        return np.asarray(self._states[likelier(self._states)])

    @property
    def T_odom_base(self) -> FloatArray:
        """Pose (4, 4) after the last reading."""
        return self._T_odom_base.copy()

    @property
    def covariance(self) -> FloatArray:
        """(6, 6) of the left perturbation (v, ω) of `T_odom_base`; zero out of the plane."""
        return self._covariance.copy()

    @property
    def pose(self) -> tuple[float, float, float]:
        """x, y in metres and yaw in [-π, π] radians of the base in odom."""
        x_m, y_m, yaw_rad = self._state[:3]
        return float(x_m), float(y_m), float(yaw_rad)

    @property
    def twist(self) -> tuple[float, float]:
        """Forward speed in m/s and yaw rate in rad/s over the last step; zero after a refused reading."""
        return float(self._state[at.SPEED]), float(self._state[at.YAW_RATE])

    def rescale(self, left: float, right: float) -> None:
        """Divide the ways of both wheels by a factor from the next reading on, as for a tyre that has lost air."""
        self._parameters[LEFT_M] /= left
        self._parameters[RIGHT_M] /= right

    def motion_in(self, seconds: float) -> FloatArray:
        """Return T_now_then (4, 4), the motion at the current twist over a time."""
        speed, yaw_rate = self.twist
        half = yaw_rate * seconds / 2
        # The exponential of the twist in closed form, along the chord of the arc, since each reading needs it.
        chord_m = speed * seconds * (math.sin(half) / half if half else 1.0)
        return se3.from_plane(chord_m * math.cos(half), chord_m * math.sin(half), 2 * half)

    @property
    def moved(self) -> FloatArray:
        """T_before_now (4, 4) of the last step alone, without its correction of the path before.

        `T_odom_base` jumps when the estimate of the gyroscope's bias or of the wheels' errors changes.
        """
        step, turn = self.motion_in(self._step_s), self._state[at.CORRECTION] if self._step_s else 0.0
        return step @ se3.from_plane(0.0, 0.0, turn)

    @property
    def turned_rad(self) -> float:
        """Turn of the base in the last accepted step, by the wheels and their calibration alone, radians."""
        return float(self._state[at.TURNED])

    def copy(self) -> WheelOdometry:
        """Return an independent copy."""
        other = WheelOdometry.__new__(WheelOdometry)
        other.__dict__.update({name: value for name, value in vars(self).items() if name not in vars(other)})
        other._parameters, other._states = self._parameters.copy(), self._states.copy()
        other._T_odom_base, other._covariance = self._T_odom_base.copy(), self._covariance.copy()
        return other

    @property
    def gyro_bias_rad_s(self) -> float:
        """Current estimate of the gyroscope's bias, by wheels whose own errors are unknown."""
        return float(self._of_bias[at.BIAS])

    @property
    def gyro_bias_sigma_rad_s(self) -> float:
        """Standard deviation of the bias."""
        return math.sqrt(self._of_bias[at.BIAS_VARIANCE])

    @property
    def _of_bias(self) -> FloatArray:  # the state of exact wheels takes what unequal wheels turn for bias
        return np.asarray(self._states[at.OFF if self._states[at.OFF, at.BEGUN] > 0 else at.EXACT])

    @one_at_a_time
    def pause(self, seconds: float) -> None:
        """Note that a time may have passed before the next reading, whatever its stamp, as after a suspended host.

        Counts still give the distance. One that is too long for its stamps is then accepted.
        """
        self._paused_s = seconds

    @one_at_a_time
    def process(self, reading: WheelReading, yaw_rate_rad_s: float | None = None) -> WheelEstimate:
        """Return the pose at a reading, and the step from the previous one.

        Args:
            reading: cumulative ticks, or speeds that hold until the next reading.
            yaw_rate_rad_s: the gyroscope's mean since the previous reading, or None.

        Returns:
            `Status.TRACKING` with the pose. For a refused reading, `Status.FAILING` with the reason, the previous pose
            and a larger covariance. Its `step` is the motion since the previous reading, as
            `ErrorStateFilter.predict` takes it.

        Raises:
            ArgumentError: no reading, invalid numbers, counts with a fraction, or stamps that are not seconds.
        """
        check_event(reading)
        if not isinstance(reading, WheelTicks | WheelSpeeds):
            fix = "WheelTicks or WheelSpeeds; HolonomicOdometry takes those of a holonomic base"
            raise ArgumentError(f"a {type(reading).__name__} is no reading of two wheels", fix=fix)
        if type(reading) not in self._stamps.settled:
            self._stamps.check(reading)
        rate_rad_s = math.nan if yaw_rate_rad_s is None else need_number("yaw_rate_rad_s", yaw_rate_rad_s)
        why = self._integrate(reading, rate_rad_s)
        stamp_s, before = reading.stamp_s - self._wheels.delay_s, self._answered
        T, C = self._T_odom_base.copy(), self._covariance.copy()
        if why == BACKWARDS:
            before = None
        else:
            self._answered = stamp_s, T, C
        status = _REFUSED if why else _DEAD_RECKONED
        return WheelEstimate(stamp_s, status, T, C, _REASONS[why], "base", before=before)

    def _integrate(self, reading: WheelTicks | WheelSpeeds, rate_rad_s: float) -> int:
        """Integrate a reading; return the code of why it is refused, or OK."""
        last, self._step_s = self._last, 0.0
        if last is None:
            self._last = reading
            return OK
        dt_s = reading.stamp_s - last.stamp_s
        ticks = _ticks_between(last, reading, self._ticks_per_rad * dt_s, self._counter_span)
        counts = isinstance(reading, WheelTicks)
        self._parameters[SPAN] = self._span if counts else 0.0
        self._parameters[COUNT_VARIANCE] = self._count_variance if counts else 0.0
        why = self._update(ticks, dt_s, rate_rad_s, self._paused_s if counts else 0.0)
        if why != BACKWARDS:
            self._last, self._paused_s, self._step_s = reading, 0.0, dt_s
        return why

    def _update(self, ticks: tuple[float, float], dt_s: float, rate_rad_s: float, paused_s: float) -> int:
        """Return why a step is refused, or OK. After a pause, the speed limit may use the longer of both times."""
        before = self.copy() if paused_s > dt_s > 0 else None
        filled = (self._T_odom_base, self._covariance)
        self._states[:, at.CORRECTION] = 0.0
        why: int = update(self._states, self._parameters, *ticks, dt_s, rate_rad_s, *filled)
        if before is None or why != IMPLAUSIBLE:
            return why
        self._states, self._T_odom_base, self._covariance = before._states, before._T_odom_base, before._covariance
        parameters, filled = self._parameters.copy(), (self._T_odom_base, self._covariance)
        parameters[SPEED_LIMIT] *= paused_s / dt_s
        why = update(self._states, parameters, *ticks, dt_s, rate_rad_s, *filled)
        return why


@dataclass(frozen=True, eq=False)
class WheelTrack:
    """A whole log, dead-reckoned.

    Attributes:
        stamps_s: (N,) as given, minus `delay_s`; not growing where the clock ran backwards.
        poses: (N, 3), x, y in metres and yaw in [-π, π] radians of T_odom_base.
        covariance_parts: (N, 6), xx, xy, xω, yy, yω, ωω of the left perturbation (vx, vy, ω).
        reason_codes: (N,) 0, or why a reading was refused; see `reason`.
    """

    stamps_s: FloatArray
    poses: FloatArray
    covariance_parts: FloatArray
    reason_codes: ByteArray

    def __len__(self) -> int:
        return len(self.stamps_s)

    @property
    def is_refused(self) -> BoolArray:
        """(N,) whether each reading was refused."""
        return np.not_equal(self.reason_codes, OK)

    def reason(self, index: int) -> Reason | None:
        """Return why a reading was refused, or None."""
        return _REASONS[self.reason_codes[index]]

    @property
    def covariances(self) -> FloatArray:
        """(N, 3, 3) of the left perturbation (vx, vy, ω)."""
        return self.covariance_parts[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)

    def trajectory(self) -> Trajectory:
        """Return T_odom_base, without refused readings."""
        kept = ~self.is_refused
        poses = self.poses[kept]
        covariances = np.zeros((len(poses), 6, 6))
        covariances[np.ix_(np.arange(len(poses)), _PLANE, _PLANE)] = self.covariances[kept]
        return Trajectory(self.stamps_s[kept], se3.from_plane(*poses.T), covariances, body="base", frame="odom")


def integrate_log(
    wheels: Wheels,
    stamps_s: ArrayLike,
    left: ArrayLike,
    right: ArrayLike,
    *,
    integration: Integration = "arc",
    yaw_rates_rad_s: ArrayLike | None = None,
    gyro: Gyro | None = None,
) -> WheelTrack:
    """Return the dead reckoning of a whole log, as `WheelOdometry` gives it reading by reading.

    Args:
        wheels: of the robot.
        stamps_s: (N,) seconds.
        left, right: (N,) cumulative ticks, up to 2⁵³; they may be fractions (see `ticks_from_speeds`).
        integration: "arc", "midpoint" or "euler".
        yaw_rates_rad_s: (N,) the gyroscope's mean since the previous reading (see `mean_yaw_rates`), NaN
            for none; or None.
        gyro: noise of these; None for the defaults of `Gyro`.
    """
    stamps = np.ascontiguousarray(stamps_s, np.float64)
    left, right = (np.ascontiguousarray(side, np.float64) for side in (left, right))
    rates = np.empty(0) if yaw_rates_rad_s is None else np.ascontiguousarray(yaw_rates_rad_s, np.float64)
    n = len(stamps)
    if any(side.shape != (n,) for side in (left, right)) or rates.shape not in ((0,), (n,)):
        raise ValueError(f"{n} stamps need as many ticks of each wheel, and as many yaw rates if any")
    parameters, states = _prepare(wheels, integration, gyro or Gyro())
    if len(rates) and not all(np.array_equal(side, np.rint(side)) for side in (left, right)):
        parameters[COUNT_VARIANCE] = 0.0
    found = LogPoses(np.empty((n, 3)), np.empty((n, 6)), np.zeros(n, np.uint8))
    integrate(states, parameters, Log(stamps, left, right, rates), found)
    return WheelTrack(stamps - wheels.delay_s, *found)


def ticks_from_speeds(
    wheels: Wheels, stamps_s: ArrayLike, left_rad_s: ArrayLike, right_rad_s: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return cumulative ticks (N,), with fractions, of wheels at speeds (N,), each until the next stamp (N,)."""
    steps_s = np.diff(np.asarray(stamps_s, float))

    def turned(speeds_rad_s: ArrayLike) -> FloatArray:
        steps_rad = np.asarray(speeds_rad_s, float)[:-1] * steps_s
        return np.concatenate([[0.0], np.cumsum(steps_rad)]) * wheels.ticks_per_turn / (2 * np.pi)

    return turned(left_rad_s), turned(right_rad_s)


def sides_of_four(
    front_left: ArrayLike, rear_left: ArrayLike, front_right: ArrayLike, rear_right: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return ticks (N,) of both sides of a skid-steered robot: means of front and rear wheels, each (N,)."""
    pairs = ((front_left, rear_left), (front_right, rear_right))
    left, right = (np.mean([np.asarray(wheel, float) for wheel in pair], axis=0) for pair in pairs)
    return left, right


def _ticks_between(
    last: WheelTicks | WheelSpeeds, now: WheelTicks | WheelSpeeds, ticks_per_speed: float, span: int
) -> tuple[float, float]:
    if isinstance(now, WheelTicks) and isinstance(last, WheelTicks):
        steps = (now.left - last.left, now.right - last.right)
        if span > _WIDE:
            steps = (least_step(steps[0], span), least_step(steps[1], span))
        return float(steps[0]), float(steps[1])
    if isinstance(last, WheelSpeeds) and isinstance(now, WheelSpeeds):
        return last.left_rad_s * ticks_per_speed, last.right_rad_s * ticks_per_speed
    raise TypeError("a robot's wheels give either ticks or speeds, not both")


def _count_variance(wheels: Wheels) -> float:
    """Return the variance of a turn between two readings, rad², by the rounding of counts at both ends."""
    return (wheels.left_m_per_tick**2 + wheels.right_m_per_tick**2) / 6 / wheels.track_width_m**2


def _prepare(wheels: Wheels, integration: Integration, gyro: Gyro) -> tuple[FloatArray, FloatArray]:
    """Return parameters and initial states (2, STATE_SIZE) of the kernels."""
    if integration not in _INTEGRATIONS:
        raise ArgumentError(f"integration is {integration!r}", fix=f"one of {', '.join(_INTEGRATIONS)}")
    parameters, state = np.zeros(PARAMETERS_SIZE), np.zeros(at.STATE_SIZE)
    parameters[INTEGRATION] = _INTEGRATIONS[integration]
    parameters[TRACK] = wheels.track_width_m
    parameters[SLIP_SQUARED] = wheels.slip_m_per_sqrt_m**2
    parameters[SPEED_LIMIT] = wheels.max_speed_m_s
    parameters[GAP_LIMIT] = wheels.max_gap_s
    parameters[GYRO_VARIANCE] = gyro.noise_rad_per_sqrt_s**2
    parameters[WALK_VARIANCE] = gyro.bias_walk_rad_s_per_sqrt_s**2
    parameters[LEFT_M], parameters[RIGHT_M] = wheels.left_m_per_tick, wheels.right_m_per_tick
    parameters[SPAN] = float(wheels.counter_span)
    parameters[COUNT_VARIANCE] = _count_variance(wheels)
    state[at.BIAS], state[at.BIAS_VARIANCE] = gyro.bias_rad_s, gyro.bias_sigma_rad_s**2
    state[at.RATIO] = 1.0
    return parameters, np.stack([state, state])


Timed = WheelTicks | WheelCounts | OdometryReading
"""Readings with distances, which indicate their durations. Speeds have none."""

# Of `ReadingTimes`: docs/decisions/wheels-and-clocks.md (three simulated flats, a skid-steered robot), or computed.
_SPEED_STEPS = 8  # of the mean speed, which reduces the noise of stamps to a tenth
_ACCELERATION_M_S2 = 1.0  # of robots indoors (computed)
_SLOWEST_M_S = 0.03  # below it, the rounding of counts is much of the distance (computed)
_STOPPING_SHARE = 0.5  # of the usual distance: a shorter step is of a base that stops
_GAP_FACTOR, _GAP_SIGMAS = 1.5, 3.0  # a gap: this many usual periods, and this far over the duration by its distance
# Readings behind a gap waited until one comes less than this share of a period after its due time, or until
_WAITING_SHARE = 0.5
_PACE_SHARE, _PATIENCE = 0.6, 3  # this many steps took this share of the duration by their distance
_LATEST_S = 0.2  # largest correction, since filters accept events as late (computed)
_MEMORY_STEPS = 40  # of the mean of the stamps' variance
_LEAST_NOISE_S = 1e-3  # of stamps, initially
_EXACT_S = 3e-3  # less noise counts as none: the rounding of counts looks like it


class ReadingTimes:
    """Estimates when readings were taken that are stamped when they arrive.

    A count is right whenever it arrives, but its stamp is off by delays of host and wire. A step lasts about as long
    as its distance takes at the current speed. The differences give the noise of the stamps, beyond that of slip and
    changes of speed. The time of a reading lies between its stamp and the time by its distance, nearer to the stamp for
    exact stamps. A reading that waited behind a gap has the time by its distance.

    Args:
        wheels: of the robot.

    Attributes:
        late: number of readings that were taken well before their stamp.
    """

    def __init__(self, wheels: Wheels | HolonomicWheels) -> None:
        self._wheels, self._slip_m_per_sqrt_m = wheels, wheels.slip_m_per_sqrt_m
        self._span, self._m_per_tick = 0, (0.0, 0.0)
        if isinstance(wheels, Wheels):
            self._span, self._m_per_tick = wheels.counter_span, (wheels.left_m_per_tick, wheels.right_m_per_tick)
        self._last: Timed | None = None
        self._time_s = -math.inf
        self._steps: deque[tuple[float, float]] = deque(maxlen=_SPEED_STEPS)  # durations and distances
        self._variance_s2 = _LEAST_NOISE_S**2
        self._patience = self.late = 0

    @property
    def noise_s(self) -> float:
        """Standard deviation of the stamps, beyond changes of speed; 0 for exact stamps."""
        return math.sqrt(self._variance_s2) if self._variance_s2 > _EXACT_S**2 else 0.0

    def time_of(self, reading: Timed) -> float:
        """Return when a reading was taken, in seconds. Times grow if stamps do."""
        last, self._last = self._last, reading
        step_s = math.inf if last is None else reading.stamp_s - last.stamp_s
        if last is None or not 0 < step_s < _LATEST_S:
            self._steps.clear()
            self._time_s, self._patience = reading.stamp_s, 0
            return reading.stamp_s
        way_m, before_s = self._way_between(last, reading), self._time_s
        self._time_s = max(self._estimated_s(reading.stamp_s, step_s, way_m), before_s + 1e-6)
        self._steps.append((self._time_s - before_s, way_m))
        return self._time_s

    def _estimated_s(self, stamp_s: float, step_s: float, way_m: float) -> float:
        """Return the time of a reading by its stamp and its distance, or by its distance alone if it waited."""
        steps = self._steps
        total_s = total_m = 0.0
        for seconds, step_m in steps:
            total_s += seconds
            total_m += step_m
        speed_m_s = total_m / total_s if len(steps) >= _SPEED_STEPS else 0.0
        period_s = total_s / _SPEED_STEPS
        if speed_m_s < _SLOWEST_M_S or way_m < _STOPPING_SHARE * period_s * speed_m_s:
            self._patience = 0
            return stamp_s
        took_s, lag_s = way_m / speed_m_s, period_s * _SPEED_STEPS / 2
        of_slip_s = self._slip_m_per_sqrt_m * math.sqrt(way_m / 2) / speed_m_s
        unsure_s = math.hypot(took_s * min(_ACCELERATION_M_S2 * lag_s / speed_m_s, 1.0), of_slip_s)
        due_s = self._time_s + took_s
        # Whether the reading waited behind a gap.
        off_s = _GAP_SIGMAS * math.hypot(math.sqrt(2) * self.noise_s, unsure_s)
        if step_s > _GAP_FACTOR * period_s and step_s - took_s > off_s:
            self._patience = _PATIENCE
        elif step_s > _PACE_SHARE * took_s:
            self._patience -= 1
        if not _WAITING_SHARE * period_s < stamp_s - due_s < _LATEST_S:
            self._patience = 0
        self.late += self._patience > 0
        if self._patience > 0:
            return due_s
        found_s2 = ((step_s - took_s) ** 2 - unsure_s**2) / 2  # of one end of the step
        # Limited to three times the current noise: a sudden change of speed is no noise of the stamps.
        counted_s2 = min(max(found_s2, _LEAST_NOISE_S**2), 9 * self._variance_s2)
        self._variance_s2 += (counted_s2 - self._variance_s2) / _MEMORY_STEPS
        noise_s = self.noise_s
        if noise_s == 0:
            return stamp_s
        time_s = due_s + unsure_s / (unsure_s + noise_s / 2) * (stamp_s - due_s)
        return time_s if abs(stamp_s - time_s) < _LATEST_S else stamp_s

    def _way_between(self, before: Timed, now: Timed) -> float:
        """Return the mean distance of all wheels in metres; for a base's own odometry, about that of a wheel."""
        of = self._wheels
        if isinstance(of, Wheels) and isinstance(before, WheelTicks) and isinstance(now, WheelTicks):
            left, right, span = now.left - before.left, now.right - before.right, self._span
            if span:
                left, right = least_step(left, span), least_step(right, span)
            left_m, right_m = self._m_per_tick
            return (abs(left * left_m) + abs(right * right_m)) / 2
        if not isinstance(of, HolonomicWheels):
            return 0.0  # not a reading of these wheels; odometry refuses it
        if isinstance(before, OdometryReading) and isinstance(now, OdometryReading):
            turn_rad = abs(math.remainder(now.yaw_rad - before.yaw_rad, 2 * math.pi))
            return math.hypot(now.x_m - before.x_m, now.y_m - before.y_m) + of.lever_m * turn_rad
        if not (isinstance(before, WheelCounts) and isinstance(now, WheelCounts)):
            return 0.0
        span = 1 << of.counter_bits if of.counter_bits else 0
        counts = [abs(least_step(a - b, span)) for a, b in zip(now.counts, before.counts, strict=False)]
        return of.m_per_tick * sum(counts) / max(len(counts), 1)
