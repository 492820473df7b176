"""WheelOdometry: dead reckoning from the counts of two wheels, reading by reading or a whole log at once.

The robot drives differentially: from the travel of both wheels follow way and turn (Trinh et al., eq. 2), from these
the next pose by one of three integrations: "euler", along the old heading (Trinh et al., eq. 3); "midpoint", along the
heading halfway (Ligocki, eq. 1); "arc", along the arc itself, exact for wheels that turn evenly. The variance of a
wheel's travel grows with its way, independently of the other wheel's. A gyroscope's yaw rate, where there is one, is
joined with the turn that the wheels tell of, five times a second (`_gyro_kernels`). It is believed as it is given:
whether it contradicts the wheels says `GyroCheck`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.calibration import Gyro, Wheels
from wheelsight.calibration_parts import least_step
from wheelsight.checks import check_event, need_kind, need_number
from wheelsight.errors import ArgumentError
from wheelsight.estimates import Reason, Status, WheelEstimate
from wheelsight.events import WheelReading, WheelSpeeds, WheelTicks
from wheelsight.geometry import BoolArray, ByteArray, FloatArray, se3
from wheelsight.odometry.wheels import _kernels as kernels
from wheelsight.odometry.wheels import _state_kernels as at
from wheelsight.odometry.wheels._gyro_kernels import likelier
from wheelsight.stamps import StampCheck
from wheelsight.threads import OneCaller, one_at_a_time
from wheelsight.trajectory import Trajectory

Integration = Literal["arc", "midpoint", "euler"]

_INTEGRATIONS = {"euler": kernels.EULER, "midpoint": kernels.MIDPOINT, "arc": kernels.ARC}
_REASONS = (None, Reason.CLOCK_BACKWARDS, Reason.GAP, Reason.COUNTER_AMBIGUOUS, Reason.IMPLAUSIBLE_MOTION)
_WIDE = 2**53  # beyond, a roll-over as a float has lost counts
_PLANE = np.array([0, 1, 5])  # vx, vy, ωz of a (6,) perturbation


class WheelOdometry(OneCaller):
    """Where the base is in the frame `odom`, which is where it was at the first reading.

    A reading is refused when its stamp does not come after the last one's, when it comes too late (`max_gap_s`), when
    counters may have rolled over more than half their range since, or when a wheel would have had to roll faster than
    `max_speed_m_s`. Then the pose keeps, the covariance grows by all that the wheels could have done meanwhile, and the
    way goes on from there with the next reading; one whose stamp runs backwards changes nothing at all.

    Args:
        wheels: of the robot. Estimates are stamped with the time the wheels stood so: `stamp_s - delay_s`.
        integration: "arc", "midpoint" or "euler".
        gyro: what the yaw rates given are worth; None for the defaults of `Gyro`.
    """

    def __init__(self, wheels: Wheels, integration: Integration = "arc", gyro: Gyro | None = None) -> None:
        self._wheels = need_kind("wheels", wheels, Wheels, "calibration.wheels")
        self._parameters, self._states = _prepare(wheels, integration, gyro or Gyro())
        self._span = self._parameters[kernels.SPAN]
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
        """The pose (4, 4) after the last reading."""
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
        """Forward speed in m/s and yaw rate in rad/s over the last step; zero after a reading that was refused."""
        return float(self._state[at.SPEED]), float(self._state[at.YAW_RATE])

    def motion_in(self, seconds: float) -> FloatArray:
        """T_now_then (4, 4) after so many seconds more at this twist."""
        speed, yaw_rate = self.twist
        half = yaw_rate * seconds / 2
        # Along the arc's chord, as the exponential of this twist: in closed form, as it is asked for at each reading.
        chord_m = speed * seconds * (math.sin(half) / half if half else 1.0)
        return se3.from_plane(chord_m * math.cos(half), chord_m * math.sin(half), 2 * half)

    @property
    def moved(self) -> FloatArray:
        """T_before_now (4, 4) of the last step alone: with nothing of what it has told of the way before.

        `T_odom_base` leaps where the gyroscope's bias, or how wheels are off, turns out to be another than was thought.
        """
        step, turn = self.motion_in(self._step_s), self._state[at.TOLD] if self._step_s else 0.0
        return step @ se3.from_plane(0.0, 0.0, turn)

    @property
    def turned_rad(self) -> float:
        """By how much the wheels alone, by their calibration, turned the base in the last step that was not refused."""
        return float(self._state[at.TURNED])

    def copy(self) -> WheelOdometry:
        """Another that goes on from here by itself."""
        other = WheelOdometry.__new__(WheelOdometry)
        other.__dict__.update({name: value for name, value in vars(self).items() if name not in vars(other)})
        other._parameters, other._states = self._parameters.copy(), self._states.copy()
        other._T_odom_base, other._covariance = self._T_odom_base.copy(), self._covariance.copy()
        return other

    @property
    def gyro_bias_rad_s(self) -> float:
        """What the gyroscope is thought to show at rest, as far as it is known by now."""
        return float(self._state[at.BIAS])

    @property
    def gyro_bias_sigma_rad_s(self) -> float:
        """How far off that may be, as a standard deviation."""
        return math.sqrt(self._state[at.BIAS_VARIANCE])

    @one_at_a_time
    def pause(self, seconds: float) -> None:
        """Before the next reading, so long may have passed, whatever stamps say: as while a host slept, or a bus hung.

        Counts tell the way all the same; one that is too long for its stamps is then believed.
        """
        self._paused_s = seconds

    @one_at_a_time
    def process(self, reading: WheelReading, yaw_rate_rad_s: float | None = None) -> WheelEstimate:
        """The pose at a reading, and the step there from the one before.

        Args:
            reading: cumulative ticks, or speeds that hold until the next reading.
            yaw_rate_rad_s: the gyroscope's mean since the reading before, or None.

        Returns:
            `Status.TRACKING` with the pose; or, of a reading that was refused, `Status.FAILING` with the reason, the
            pose as it was before and the covariance grown. Its `step` is the motion since the reading before, as
            `ErrorStateFilter.predict` takes it.

        Raises:
            ArgumentError: no reading, numbers that are none, counts with a fraction, or stamps that are no seconds.
        """
        check_event(reading)
        if not isinstance(reading, WheelTicks | WheelSpeeds):
            fix = "WheelTicks or WheelSpeeds; of a holonomic base, HolonomicOdometry takes others"
            raise ArgumentError(f"a {type(reading).__name__} is no reading of two wheels", fix=fix)
        self._stamps.check(reading)
        rate_rad_s = math.nan if yaw_rate_rad_s is None else need_number("yaw_rate_rad_s", yaw_rate_rad_s)
        why = self._advance(reading, rate_rad_s)
        stamp_s, before = reading.stamp_s - self._wheels.delay_s, self._answered
        T, C = self._T_odom_base.copy(), self._covariance.copy()
        if why == kernels.BACKWARDS:
            before = None
        else:
            self._answered = stamp_s, T, C
        status = Status.FAILING if why else Status.TRACKING
        return WheelEstimate(stamp_s, status, T, C, _REASONS[why], "base", before=before)

    def _advance(self, reading: WheelTicks | WheelSpeeds, rate_rad_s: float) -> int:
        last, self._step_s = self._last, 0.0
        if last is None:
            self._last = reading
            return kernels.OK
        dt_s = reading.stamp_s - last.stamp_s
        ticks = _ticks_between(last, reading, self._ticks_per_rad * dt_s, self._wheels.counter_span)
        counts = isinstance(reading, WheelTicks)
        self._parameters[kernels.SPAN] = self._span if counts else 0.0
        self._parameters[kernels.COUNT_VARIANCE] = _count_variance(self._wheels) if counts else 0.0
        why = self._update(ticks, dt_s, rate_rad_s, self._paused_s if counts else 0.0)
        if why != kernels.BACKWARDS:
            self._last, self._paused_s, self._step_s = reading, 0.0, dt_s
        return why

    def _update(self, ticks: tuple[float, float], dt_s: float, rate_rad_s: float, paused_s: float) -> int:
        """Why a step is refused, or OK; of a reading after a pause, by the longer of both times where it needs that."""
        before = self.copy() if paused_s > dt_s > 0 else None
        filled = (self._T_odom_base, self._covariance)
        self._states[:, at.TOLD] = 0.0
        why: int = kernels.update(self._states, self._parameters, *ticks, dt_s, rate_rad_s, *filled)
        if before is None or why != kernels.IMPLAUSIBLE:
            return why
        self._states, self._T_odom_base, self._covariance = before._states, before._T_odom_base, before._covariance
        parameters, filled = self._parameters.copy(), (self._T_odom_base, self._covariance)
        parameters[kernels.SPEED_LIMIT] *= paused_s / dt_s
        why = kernels.update(self._states, parameters, *ticks, dt_s, rate_rad_s, *filled)
        return why


@dataclass(frozen=True, eq=False)
class WheelTrack:
    """A whole log, dead-reckoned.

    Attributes:
        stamps_s: (N,) as given, less `delay_s`; not growing where the clock ran backwards.
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
        """(N,) which readings were refused."""
        return np.not_equal(self.reason_codes, kernels.OK)

    def reason(self, index: int) -> Reason | None:
        """Why a reading was refused, or None."""
        return _REASONS[self.reason_codes[index]]

    @property
    def covariances(self) -> FloatArray:
        """(N, 3, 3) of the left perturbation (vx, vy, ω)."""
        return self.covariance_parts[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)

    def trajectory(self) -> Trajectory:
        """T_odom_base, without the readings that were refused."""
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
    """Dead reckoning of a whole log; the same as `WheelOdometry`, reading by reading, in one go.

    Args:
        wheels: of the robot.
        stamps_s: (N,) seconds.
        left, right: (N,) cumulative ticks, up to 2⁵³; they may be fractions (see `ticks_from_speeds`).
        integration: "arc", "midpoint" or "euler".
        yaw_rates_rad_s: (N,) the gyroscope's mean since the reading before (see `mean_yaw_rates`), NaN
            for none; or None.
        gyro: what these are worth; None for the defaults of `Gyro`.
    """
    stamps = np.ascontiguousarray(stamps_s, np.float64)
    left, right = (np.ascontiguousarray(side, np.float64) for side in (left, right))
    rates = np.empty(0) if yaw_rates_rad_s is None else np.ascontiguousarray(yaw_rates_rad_s, np.float64)
    n = len(stamps)
    if any(side.shape != (n,) for side in (left, right)) or rates.shape not in ((0,), (n,)):
        raise ValueError(f"{n} stamps need as many ticks of each wheel, and as many yaw rates if any")
    parameters, states = _prepare(wheels, integration, gyro or Gyro())
    if len(rates) and not all(np.array_equal(side, np.rint(side)) for side in (left, right)):
        parameters[kernels.COUNT_VARIANCE] = 0.0
    found = kernels.Poses(np.empty((n, 3)), np.empty((n, 6)), np.zeros(n, np.uint8))
    kernels.integrate(states, parameters, kernels.Log(stamps, left, right, rates), found)
    return WheelTrack(stamps - wheels.delay_s, *found)


def ticks_from_speeds(
    wheels: Wheels, stamps_s: ArrayLike, left_rad_s: ArrayLike, right_rad_s: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Cumulative ticks (N,), with fractions, of wheels that turn at speeds (N,), each until the next stamp (N,)."""
    steps_s = np.diff(np.asarray(stamps_s, float))

    def turned(speeds_rad_s: ArrayLike) -> FloatArray:
        steps_rad = np.asarray(speeds_rad_s, float)[:-1] * steps_s
        return np.concatenate([[0.0], np.cumsum(steps_rad)]) * wheels.ticks_per_turn / (2 * np.pi)

    return turned(left_rad_s), turned(right_rad_s)


def sides_of_four(
    front_left: ArrayLike, rear_left: ArrayLike, front_right: ArrayLike, rear_right: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Ticks (N,) of the left and right side of a skid-steered robot: means of front and rear wheels, each (N,)."""
    pairs = ((front_left, rear_left), (front_right, rear_right))
    left, right = (np.mean([np.asarray(wheel, float) for wheel in pair], axis=0) for pair in pairs)
    return left, right


def _ticks_between(
    last: WheelTicks | WheelSpeeds, now: WheelTicks | WheelSpeeds, ticks_per_speed: float, span: int
) -> tuple[float, float]:
    if isinstance(now, WheelTicks) and isinstance(last, WheelTicks):
        steps = (now.left - last.left, now.right - last.right)
        left, right = (least_step(step, span) if span > _WIDE else step for step in steps)
        return float(left), float(right)
    if isinstance(last, WheelSpeeds) and isinstance(now, WheelSpeeds):
        return last.left_rad_s * ticks_per_speed, last.right_rad_s * ticks_per_speed
    raise TypeError("a robot's wheels tell either ticks or speeds, not both")


def _count_variance(wheels: Wheels) -> float:
    """rad² of a turn between two readings: each count may stand for any angle within it, at both ends."""
    return (wheels.left_m_per_tick**2 + wheels.right_m_per_tick**2) / 6 / wheels.track_width_m**2


def _prepare(wheels: Wheels, integration: Integration, gyro: Gyro) -> tuple[FloatArray, FloatArray]:
    """Parameters and first states (2, STATE_SIZE) as the kernels take them."""
    if integration not in _INTEGRATIONS:
        raise ArgumentError(f"integration is {integration!r}", fix=f"one of {', '.join(_INTEGRATIONS)}")
    parameters, state = np.zeros(kernels.PARAMETERS_SIZE), np.zeros(at.STATE_SIZE)
    parameters[kernels.INTEGRATION] = _INTEGRATIONS[integration]
    parameters[kernels.TRACK] = wheels.track_width_m
    parameters[kernels.SLIP_SQUARED] = wheels.slip_m_per_sqrt_m**2
    parameters[kernels.SPEED_LIMIT] = wheels.max_speed_m_s
    parameters[kernels.GAP_LIMIT] = wheels.max_gap_s
    parameters[kernels.GYRO_VARIANCE] = gyro.noise_rad_per_sqrt_s**2
    parameters[kernels.WALK_VARIANCE] = gyro.bias_walk_rad_s_per_sqrt_s**2
    parameters[kernels.LEFT_M], parameters[kernels.RIGHT_M] = wheels.left_m_per_tick, wheels.right_m_per_tick
    parameters[kernels.SPAN] = float(wheels.counter_span)
    parameters[kernels.COUNT_VARIANCE] = _count_variance(wheels)
    state[at.BIAS], state[at.BIAS_VARIANCE] = gyro.bias_rad_s, gyro.bias_sigma_rad_s**2
    state[at.RATIO] = 1.0
    return parameters, np.stack([state, state])
