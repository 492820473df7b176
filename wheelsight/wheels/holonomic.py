"""HolonomicOdometry: dead reckoning of a base that moves forward, sideways and turns at once.

The motion by counts is the least-squares solution of the wheels' distances (`HolonomicWheels.jacobian`). Its covariance
is that of the distances, propagated by the pseudo-inverse. Four wheels are redundant: contradictions beyond their noise
indicate slip, and scale the covariance (the a-posteriori variance of unit weight of least squares). Three wheels are
not redundant. A base with its own odometry gives the motion directly.

The pose is integrated by the exponential of the motion, exact for constant velocities in the base's frame between two
readings. The mean rate of a gyroscope is a measurement of each step's turn. Its bias is estimated with the pose: at
rest the wheels show it.
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
from wheelsight.core.estimates import PoseFinding, Reason, WheelEstimate, status_of
from wheelsight.core.geometry import FloatArray
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.geometry.chi_square import quantile
from wheelsight.core.messages import HolonomicReading, OdometryReading, WheelCounts, WheelReading
from wheelsight.core.stamps import StampCheck
from wheelsight.core.threads import OneCaller, one_at_a_time
from wheelsight.wheels.odometry import Integration, WheelOdometry

_PLANE = np.array([0, 1, 5])  # vx, vy, ωz of a (6,) perturbation
_IN_PLANE = np.ix_(_PLANE, _PLANE)
_DEAD_RECKONED, _REFUSED = status_of(PoseFinding.DEAD_RECKONED), status_of(PoseFinding.READING_REFUSED)
# Delay of readings, s: a step may last longer than its stamps by as much.
_STAMP_JITTER_S = 0.05
# Time over which contradictions of the wheels accumulate, s: a single step is dominated by the floor's roughness.
_SLIP_MEMORY_S = 0.5
# Contradictions beyond this quantile of the wheels' noise are slip.
_SLIP_CONFIDENCE = 0.9999
# Variance of a difference of counts, which are rounded down at both ends of a step, counts².
_COUNT_VARIANCE = 1 / 6


class _Motion(NamedTuple):
    """A step of the base.

    Attributes:
        xi: (3,) forward, left and turn.
        covariance: (3, 3).
        farthest_m: largest distance of a wheel.
        off_m: contradictions of the wheels.
        off_m2: covariance of these.
    """

    xi: FloatArray
    covariance: FloatArray
    farthest_m: float
    off_m: FloatArray
    off_m2: FloatArray


class HolonomicOdometry(OneCaller):
    """Pose of the base in the frame `odom`, which starts at the first reading.

    A reading is refused as in `WheelOdometry`: if it is not newer, comes too late (`max_gap_s`), counters may have
    rolled over, or a wheel exceeds `max_speed_m_s`. Then the pose stays, and the covariance grows by any possible
    motion.

    Args:
        wheels: of the robot.
        gyro: noise of the yaw rates; None for the defaults of `Gyro`.
    """

    def __init__(self, wheels: HolonomicWheels, gyro: Gyro | None = None) -> None:
        self._wheels = need_kind("wheels", wheels, HolonomicWheels, "calibration.holonomic")
        self._gyro = gyro or Gyro()
        self._T, self._moved = np.eye(4), np.eye(4)
        # Covariance of the pose's left perturbation (vx, vy, ω), and of the gyroscope's bias.
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
        """Pose (4, 4) after the last reading."""
        return self._T.copy()

    @property
    def covariance(self) -> FloatArray:
        """(6, 6) of the left perturbation (v, ω) of `T_odom_base`; zero out of the plane."""
        found = np.zeros((6, 6))
        found[_IN_PLANE] = self._P[:3, :3]
        return found

    @property
    def twist(self) -> tuple[float, float, float]:
        """Velocity forward and to the left, m/s, and yaw rate, rad/s, in the last step; zero after a refused one."""
        ahead, left, turn = self._twist.tolist()
        return ahead, left, turn

    def motion_in(self, seconds: float) -> FloatArray:
        """Return T_now_then (4, 4), the motion at the current twist over a time."""
        return np.asarray(motions.exp(_in_space(self._twist * seconds)))

    @property
    def moved(self) -> FloatArray:
        """T_before_now (4, 4) of the last step alone, without its correction of the path before."""
        return self._moved.copy()

    @property
    def turned_rad(self) -> float:
        """Turn of the base in the last accepted step by the wheels alone, radians."""
        return self._turned_rad

    @property
    def gyro_bias_rad_s(self) -> float:
        """Current estimate of the gyroscope's bias."""
        return self._bias_rad_s

    @property
    def gyro_bias_sigma_rad_s(self) -> float:
        """Standard deviation of the bias."""
        return math.sqrt(self._P[3, 3])

    @property
    def slip_chi2(self) -> float:
        """χ² of recent contradictions between wheels; 0 without redundancy (three wheels, the base's own odometry)."""
        if not len(self._off_m) or not self._off_m.any():
            return 0.0
        return float(motions.chi_squared(self._off_m, self._off_m2))

    @property
    def is_slipping(self) -> bool:
        """Whether the wheels contradict each other by more than their noise."""
        return len(self._off_m) > 0 and self.slip_chi2 > quantile(_SLIP_CONFIDENCE, len(self._off_m))

    def copy(self) -> HolonomicOdometry:
        """Return an independent copy."""
        other = HolonomicOdometry(self._wheels, self._gyro)
        for name in ("_T", "_moved", "_P", "_bias_rad_s", "_twist", "_off_m", "_off_m2", "_last", "_answered"):
            setattr(other, name, copy.copy(getattr(self, name)))
        other._stamps = copy.deepcopy(self._stamps)
        other._paused_s, other._turned_rad = self._paused_s, self._turned_rad
        return other

    @one_at_a_time
    def pause(self, seconds: float) -> None:
        """Note that a time may have passed before the next reading, whatever its stamp, as after a suspended host."""
        self._paused_s = seconds

    @one_at_a_time
    def process(self, reading: WheelReading, yaw_rate_rad_s: float | None = None) -> WheelEstimate:
        """Return the pose at a reading, and the step from the previous one.

        Args:
            reading: cumulative counts of all wheels, or the pose by the base's own odometry.
            yaw_rate_rad_s: the gyroscope's mean since the previous reading, or None.

        Returns:
            As `WheelOdometry.process`.

        Raises:
            ArgumentError: no reading of such wheels, or stamps that are not seconds.
        """
        check_event(reading)
        if not isinstance(reading, HolonomicReading):
            problem = f"a {type(reading).__name__} is no reading of a holonomic base"
            raise ArgumentError(problem, fix="WheelCounts or OdometryReading")
        names = self._wheels.wheel_names
        if isinstance(reading, WheelCounts) and len(reading.counts) != len(names):
            problem = f"{len(reading.counts)} counts are given, and the calibration has {len(names)} wheels"
            fix = f"one each of {', '.join(names)}" if names else "OdometryReading, as layout increments says"
            raise ArgumentError(problem, fix=fix)
        if type(reading) not in self._stamps.settled:
            self._stamps.check(reading)
        if yaw_rate_rad_s is not None:
            need_number("yaw_rate_rad_s", yaw_rate_rad_s)
        why, before = self._advance(reading, yaw_rate_rad_s), self._answered
        stamp_s, T, C = reading.stamp_s - self._wheels.delay_s, self.T_odom_base, self.covariance
        if why is Reason.CLOCK_BACKWARDS:
            before = None
        else:
            self._answered = stamp_s, T, C
        status = _DEAD_RECKONED if why is None else _REFUSED
        return WheelEstimate(stamp_s, status, T, C, why, "base", before=before)

    def _advance(self, reading: HolonomicReading, rate_rad_s: float | None) -> Reason | None:
        """Integrate a reading; return why it is refused, or None."""
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
            # Add the covariance of any motion that the wheels allow over that time, uniformly distributed.
            reach_m = self._wheels.max_speed_m_s * (while_s + _STAMP_JITTER_S)
            anywhere = np.diag([reach_m, reach_m, min(reach_m / self._wheels.lever_m, math.pi)]) ** 2 / 3
            Ad = motions.adjoint(self._T)[_IN_PLANE]
            self._P[:3, :3] += Ad @ anywhere @ Ad.T
            self._P[3, 3] += self._gyro.bias_walk_rad_s_per_sqrt_s**2 * while_s
            self._twist = np.zeros(3)
            self._off_m, self._off_m2 = self._no_slip()
            return why
        self._turned_rad, xi = float(motion.xi[2]), motion.xi
        self._P[3, 3] += self._gyro.bias_walk_rad_s_per_sqrt_s**2 * dt_s
        factor = 1.0  # of the variance, by contradictions of the wheels
        if len(self._off_m):
            kept = math.exp(-dt_s / _SLIP_MEMORY_S)
            self._off_m = kept * self._off_m + motion.off_m
            self._off_m2 = kept**2 * self._off_m2 + motion.off_m2
            factor = max(self.slip_chi2 / len(self._off_m), 1.0) if self.is_slipping else 1.0
        spread = motion.covariance * factor
        self._move(xi, spread, None if rate_rad_s is None else rate_rad_s * dt_s, dt_s)
        self._twist = motions.log(self._moved)[_PLANE] / dt_s
        return None

    def _motion(self, last: HolonomicReading, now: HolonomicReading) -> _Motion:
        """Return the motion of the base between two readings of one kind."""
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
        turn_rad = now.yaw_rad - last.yaw_rad
        c_now, s_now = math.cos(turn_rad), math.sin(turn_rad)
        T = np.array(
            [[c_now, -s_now, 0, c * x + s * y], [s_now, c_now, 0, c * y - s * x], [0, 0, 1, 0], [0, 0, 0, 1.0]]
        )
        xi = motions.log(T)[_PLANE]
        way_m = math.hypot(xi[0], xi[1]) + of.lever_m * abs(xi[2])
        variance = of.slip_m_per_sqrt_m**2 * way_m
        return _Motion(xi, np.diag([variance, variance, variance / of.lever_m**2]), way_m, *none)

    def _no_slip(self) -> tuple[FloatArray, FloatArray]:
        count = max(len(self._wheels.wheel_names) - 3, 0)
        return np.zeros(count), np.zeros((count, count))

    def _fault(self, motion: _Motion, dt_s: float, while_s: float) -> Reason | None:
        """Return why a motion is refused, or None. `while_s` is the longer time of a pause."""
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

    def _move(self, xi: FloatArray, spread: FloatArray, gyro_rad: float | None, dt_s: float) -> None:
        """Integrate a step ξ (3,) with its covariance (3, 3), and the turn of the gyroscope, or None."""
        P = np.zeros((7, 7))  # of pose, bias and step
        P[:4, :4], P[4:, 4:] = self._P, spread
        T_before = self._T
        if gyro_rad is not None:
            counted_rad2 = 0.0  # variance of a turn by the rounding of counts
            if self._wheels.wheel_names:
                row = self._wheels.to_base[2]
                counted_rad2 = float(_COUNT_VARIANCE * self._wheels.m_per_tick**2 * (row @ row))
            noise = self._gyro.noise_rad_per_sqrt_s**2 * dt_s + counted_rad2
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
        self._T = motions.renormalized(motions.times(T_before, self._moved))


AnyWheelOdometry = WheelOdometry | HolonomicOdometry


def odometry_of(calibration: Calibration, integration: Integration = "arc") -> AnyWheelOdometry:
    """Return the odometry of the robot's wheels. Raises CalibrationError if it has none."""
    if calibration.holonomic is not None:
        return HolonomicOdometry(calibration.holonomic, calibration.gyro)
    if calibration.wheels is None:
        problem = f"the calibration ({calibration.source}) has no wheels"
        raise CalibrationError(problem, fix="give a calibration.yaml with wheels by --calibration")
    return WheelOdometry(calibration.wheels, integration, calibration.gyro)


def _in_space(xi: FloatArray) -> FloatArray:
    """Return the tangent (6,) of a planar one (3,)."""
    found = np.zeros(6)
    found[_PLANE] = xi
    return found
