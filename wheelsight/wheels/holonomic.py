"""HolonomicOdometry: dead reckoning of a base that moves ahead, sideways and turns at once.

Of counts, the base's motion is the least-squares solution of the wheels' ways (`HolonomicWheels.jacobian`), and its
covariance that of the ways carried through the pseudo-inverse. Four wheels say one thing too many: by what they
contradict each other beyond their noise, a wheel slips, and the covariance is scaled by as much (the a-posteriori
variance of unit weight of least squares). Three wheels cannot say so. A base whose own odometry is read gives the
motion ready.

The pose goes on by the exponential of the motion, exact where the base's velocities in its own frame are constant
between two readings. A gyroscope's mean rate is a measurement of each step's turn, and its bias is estimated beside the
pose: at rest the wheels show it.
"""

from __future__ import annotations

import copy
import math
from typing import NamedTuple

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Gyro, HolonomicWheels, least_step
from wheelsight.core.checks import check_event, need_kind, need_number
from wheelsight.core.errors import ArgumentError, CalibrationError
from wheelsight.core.estimates import Reason, Status, WheelEstimate
from wheelsight.core.geometry import FloatArray
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.geometry.chi_square import quantile
from wheelsight.core.messages import HolonomicReading, OdometryReading, WheelCounts, WheelReading
from wheelsight.core.stamps import StampCheck
from wheelsight.core.threads import OneCaller, one_at_a_time
from wheelsight.wheels.odometry import Integration, WheelOdometry

_PLANE = np.array([0, 1, 5])  # vx, vy, ωz of a (6,) perturbation
_IN_PLANE = np.ix_(_PLANE, _PLANE)
# s, by which readings may arrive late: a step may take as much longer than its stamps say.
_STAMP_JITTER_S = 0.05
# s, over which contradictions of the wheels are summed up: one step shows less than the floor's roughness.
_SLIP_MEMORY_S = 0.5
# Contradictions that happen once in so many by the wheels' noise alone are slip.
_SLIP_CONFIDENCE = 0.9999
# Of a count, which is rounded down at both ends of a step: variance of the difference, counts².
_COUNT_VARIANCE = 1 / 6


class _Motion(NamedTuple):
    """A step of the base: (3,) ahead, left and turn; covariance (3, 3); farthest a wheel went; and contradictions."""

    xi: FloatArray
    covariance: FloatArray
    farthest_m: float
    off_m: FloatArray
    off_m2: FloatArray


class HolonomicOdometry(OneCaller):
    """Where the base is in the frame `odom`, which is where it was at the first reading.

    A reading is refused as by `WheelOdometry`: it does not come after the last one, comes too late (`max_gap_s`),
    counters may have rolled over unseen, or a wheel would have gone faster than `max_speed_m_s`. Then the pose keeps
    and the covariance grows by all that the base could have done meanwhile.

    Args:
        wheels: of the robot.
        gyro: what the yaw rates given are worth; None for the defaults of `Gyro`.
    """

    def __init__(self, wheels: HolonomicWheels, gyro: Gyro | None = None) -> None:
        self._wheels = need_kind("wheels", wheels, HolonomicWheels, "calibration.holonomic")
        self._gyro = gyro or Gyro()
        self._T, self._moved = np.eye(4), np.eye(4)
        # Of the pose's left perturbation (vx, vy, ω), and of the gyroscope's bias.
        self._P = np.zeros((4, 4))
        self._P[3, 3] = self._gyro.bias_sigma_rad_s**2
        self._bias_rad_s = self._gyro.bias_rad_s
        self._twist = np.zeros(3)
        self._off_m, self._off_m2 = self._no_slip()
        self._last: HolonomicReading | None = None
        self._answered: tuple[float, FloatArray, FloatArray] | None = None
        self._stamps = StampCheck()
        self._paused_s = self._turned_rad = 0.0

    @property
    def T_odom_base(self) -> FloatArray:
        """The pose (4, 4) after the last reading."""
        return self._T.copy()

    @property
    def covariance(self) -> FloatArray:
        """(6, 6) of the left perturbation (v, ω) of `T_odom_base`; zero out of the plane."""
        found = np.zeros((6, 6))
        found[_IN_PLANE] = self._P[:3, :3]
        return found

    @property
    def twist(self) -> tuple[float, float, float]:
        """Speed ahead and to the left, m/s, and yaw rate, rad/s, in the last step; zero after one that was refused."""
        ahead, left, turn = self._twist.tolist()
        return ahead, left, turn

    def motion_in(self, seconds: float) -> FloatArray:
        """T_now_then (4, 4) after so many seconds more at this twist."""
        return np.asarray(motions.exp(_in_space(self._twist * seconds)))

    @property
    def moved(self) -> FloatArray:
        """T_before_now (4, 4) of the last step alone, whatever it says of the way before."""
        return self._moved.copy()

    @property
    def turned_rad(self) -> float:
        """By how much the wheels alone turned the base in the last step that was not refused."""
        return self._turned_rad

    @property
    def gyro_bias_rad_s(self) -> float:
        """What the gyroscope shows at rest, as far as it is known by now."""
        return self._bias_rad_s

    @property
    def gyro_bias_sigma_rad_s(self) -> float:
        """Standard deviation of that."""
        return math.sqrt(self._P[3, 3])

    @property
    def slip_chi2(self) -> float:
        """χ² of what the wheels contradict each other by of late; 0 where they cannot (three wheels, increments)."""
        if not len(self._off_m) or not self._off_m.any():
            return 0.0
        return float(motions.chi_squared(self._off_m, self._off_m2))

    @property
    def is_slipping(self) -> bool:
        """Whether the wheels contradict each other by more than their noise."""
        return len(self._off_m) > 0 and self.slip_chi2 > quantile(_SLIP_CONFIDENCE, len(self._off_m))

    def copy(self) -> HolonomicOdometry:
        """Another that goes on from here by itself."""
        other = HolonomicOdometry(self._wheels, self._gyro)
        for name in ("_T", "_moved", "_P", "_bias_rad_s", "_twist", "_off_m", "_off_m2", "_last", "_answered"):
            setattr(other, name, copy.copy(getattr(self, name)))
        other._stamps = copy.deepcopy(self._stamps)
        other._paused_s, other._turned_rad = self._paused_s, self._turned_rad
        return other

    @one_at_a_time
    def pause(self, seconds: float) -> None:
        """Before the next reading, so long may have passed, whatever stamps say: as while a host slept."""
        self._paused_s = seconds

    @one_at_a_time
    def process(self, reading: WheelReading, yaw_rate_rad_s: float | None = None) -> WheelEstimate:
        """The pose at a reading, and the step there from the one before.

        Args:
            reading: cumulative counts of all wheels, or the pose by the base's own odometry.
            yaw_rate_rad_s: the gyroscope's mean since the reading before, or None.

        Returns:
            As `WheelOdometry.process`.

        Raises:
            ArgumentError: no reading of such wheels, or stamps that are no seconds.
        """
        check_event(reading)
        reading = self._checked(reading)
        self._stamps.check(reading)
        if yaw_rate_rad_s is not None:
            need_number("yaw_rate_rad_s", yaw_rate_rad_s)
        why, before = self._advance(reading, yaw_rate_rad_s), self._answered
        stamp_s, T, C = reading.stamp_s - self._wheels.delay_s, self.T_odom_base, self.covariance
        if why is Reason.CLOCK_BACKWARDS:
            before = None
        else:
            self._answered = stamp_s, T, C
        status = Status.TRACKING if why is None else Status.FAILING
        return WheelEstimate(stamp_s, status, T, C, why, "base", before=before)

    def _checked(self, reading: WheelReading) -> HolonomicReading:
        names = self._wheels.wheel_names
        if not isinstance(reading, HolonomicReading):
            problem = f"a {type(reading).__name__} is no reading of a holonomic base"
            raise ArgumentError(problem, fix="WheelCounts or OdometryReading")
        if isinstance(reading, WheelCounts) and len(reading.counts) != len(names):
            problem = f"{len(reading.counts)} counts are given, and the calibration has {len(names)} wheels"
            fix = f"one each of {', '.join(names)}" if names else "OdometryReading, as layout increments says"
            raise ArgumentError(problem, fix=fix)
        return reading

    def _advance(self, reading: HolonomicReading, rate_rad_s: float | None) -> Reason | None:
        """Why a reading is refused; None where it moved the pose."""
        last = self._last
        if last is None or type(last) is not type(reading):
            self._last = reading
            return None
        dt_s, self._moved = reading.stamp_s - last.stamp_s, np.eye(4)
        if not 0 < dt_s < math.inf:
            return Reason.CLOCK_BACKWARDS
        while_s, self._last, self._paused_s = max(dt_s, self._paused_s), reading, 0.0
        motion = self._motion(last, reading)
        why = self._fault(motion, dt_s, while_s)
        if why is not None:
            self._widen(while_s)
            return why
        self._turned_rad, xi = float(motion.xi[2]), motion.xi
        self._P[3, 3] += self._gyro.bias_walk_rad_s_per_sqrt_s**2 * dt_s
        spread = motion.covariance * self._slip_factor(motion, dt_s)
        self._move(xi, spread, None if rate_rad_s is None else rate_rad_s * dt_s, dt_s)
        self._twist = motions.log(self._moved)[_PLANE] / dt_s
        return None

    def _motion(self, last: HolonomicReading, now: HolonomicReading) -> _Motion:
        """What two readings of one kind say of the base between them."""
        of, none = self._wheels, self._no_slip()
        if isinstance(last, WheelCounts) and isinstance(now, WheelCounts):
            span = 1 << of.counter_bits if of.counter_bits else 0
            steps = [least_step(a - b, span) for a, b in zip(now.counts, last.counts, strict=True)]
            ways_m = of.m_per_tick * np.array(steps, float)
            variances = of.slip_m_per_sqrt_m**2 * np.abs(ways_m)
            N, counted_m2 = of.contradictions, _COUNT_VARIANCE * of.m_per_tick**2
            off_m2 = (N * (variances + counted_m2)) @ N.T
            covariance = (of.to_base * variances) @ of.to_base.T
            return _Motion(of.to_base @ ways_m, covariance, float(np.abs(ways_m).max()), N @ ways_m, off_m2)
        assert isinstance(last, OdometryReading)
        assert isinstance(now, OdometryReading)
        c, s = math.cos(last.yaw_rad), math.sin(last.yaw_rad)
        x, y = now.x_m - last.x_m, now.y_m - last.y_m
        T = _planar(c * x + s * y, c * y - s * x, now.yaw_rad - last.yaw_rad)
        xi = motions.log(T)[_PLANE]
        way_m = math.hypot(xi[0], xi[1]) + of.lever_m * abs(xi[2])
        variance = of.slip_m_per_sqrt_m**2 * way_m
        return _Motion(xi, np.diag([variance, variance, variance / of.lever_m**2]), way_m, *none)

    def _no_slip(self) -> tuple[FloatArray, FloatArray]:
        count = max(len(self._wheels.wheel_names) - 3, 0)
        return np.zeros(count), np.zeros((count, count))

    def _fault(self, motion: _Motion, dt_s: float, while_s: float) -> Reason | None:
        of = self._wheels
        if not np.isfinite(motion.xi).all():
            return Reason.INVALID
        if while_s > of.max_gap_s and while_s == dt_s:
            return Reason.GAP
        if of.counter_bits and of.max_speed_m_s * while_s >= 0.5 * (1 << of.counter_bits) * of.m_per_tick:
            return Reason.COUNTER_AMBIGUOUS
        if motion.farthest_m > of.max_speed_m_s * (while_s + _STAMP_JITTER_S):
            return Reason.IMPLAUSIBLE_MOTION
        return None

    def _slip_factor(self, motion: _Motion, dt_s: float) -> float:
        """By how much more a step varies than the wheels' noise says: 1 where they go together."""
        if not len(self._off_m):
            return 1.0
        kept = math.exp(-dt_s / _SLIP_MEMORY_S)
        self._off_m = kept * self._off_m + motion.off_m
        self._off_m2 = kept**2 * self._off_m2 + motion.off_m2
        return max(self.slip_chi2 / len(self._off_m), 1.0) if self.is_slipping else 1.0

    def _move(self, xi: FloatArray, spread: FloatArray, gyro_rad: float | None, dt_s: float) -> None:
        """Go on by a step ξ (3,) with its covariance (3, 3), of which the gyroscope shows the turn, or None."""
        P = np.zeros((7, 7))  # of pose, bias and step
        P[:4, :4], P[4:, 4:] = self._P, spread
        T_before = self._T
        if gyro_rad is not None:
            noise = self._gyro.noise_rad_per_sqrt_s**2 * dt_s + self._counted_rad2
            PHt = P[:, 6] + dt_s * P[:, 3]
            S = PHt[6] + dt_s * PHt[3] + noise
            x = PHt * ((gyro_rad - xi[2] - dt_s * self._bias_rad_s) / S)
            P -= np.outer(PHt, PHt) / S
            T_before = motions.times(motions.exp(_in_space(x[:3])), T_before)
            self._bias_rad_s += float(x[3])
            xi = xi + x[4:]
        tangent = _in_space(xi)
        A = np.zeros((4, 7))
        A[:4, :4] = np.eye(4)
        A[:3, 4:] = (motions.adjoint(T_before) @ motions.left_jacobian(tangent))[_IN_PLANE]
        P = A @ P @ A.T
        self._P, self._moved = (P + P.T) / 2, motions.exp(tangent)
        self._T = motions.mended(motions.times(T_before, self._moved))

    @property
    def _counted_rad2(self) -> float:
        """Variance of a turn by counts being whole."""
        if not self._wheels.wheel_names:
            return 0.0
        row = self._wheels.to_base[2]
        return float(_COUNT_VARIANCE * self._wheels.m_per_tick**2 * (row @ row))

    def _widen(self, while_s: float) -> None:
        """In so long the base may have gone anywhere its wheels could take it, evenly so."""
        of = self._wheels
        reach_m = of.max_speed_m_s * (while_s + _STAMP_JITTER_S)
        anywhere = np.diag([reach_m, reach_m, min(reach_m / of.lever_m, math.pi)]) ** 2 / 3
        Ad = motions.adjoint(self._T)[_IN_PLANE]
        self._P[:3, :3] += Ad @ anywhere @ Ad.T
        self._P[3, 3] += self._gyro.bias_walk_rad_s_per_sqrt_s**2 * while_s
        self._twist = np.zeros(3)
        self._off_m, self._off_m2 = self._no_slip()


AnyWheelOdometry = WheelOdometry | HolonomicOdometry


def odometry_of(calibration: Calibration, integration: Integration = "arc") -> AnyWheelOdometry:
    """Dead reckoning of the wheels that the robot has. Raises CalibrationError where it has none."""
    if calibration.holonomic is not None:
        return HolonomicOdometry(calibration.holonomic, calibration.gyro)
    if calibration.wheels is None:
        problem = f"the calibration ({calibration.source}) has no wheels"
        raise CalibrationError(problem, fix="give a calibration.yaml with wheels by --calibration")
    return WheelOdometry(calibration.wheels, integration, calibration.gyro)


def _in_space(xi: FloatArray) -> FloatArray:
    """(6,) of a planar tangent (3,)."""
    found = np.zeros(6)
    found[_PLANE] = xi
    return found


def _planar(x_m: float, y_m: float, yaw_rad: float) -> FloatArray:
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s, 0, x_m], [s, c, 0, y_m], [0, 0, 1, 0], [0, 0, 0, 1.0]])
