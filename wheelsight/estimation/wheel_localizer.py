"""ByWheels: dead reckoning with the wheels. OdomFrame: the transform from `odom` to the frame of a filter.

The pose of a filter jumps when its estimate of the past changes, for instance after slip or with a new bias of the
gyroscope. The robot has not jumped. In `odom` it moves by the estimated motion alone, and the transform between both
frames takes the jump (REP 105).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.clocks import Untimed
from wheelsight.core.estimates import STEP_BEGIN, Estimate, FusedEstimate, Reason, Status, WheelEstimate
from wheelsight.core.geometry import FloatArray
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.messages import WHEEL_READINGS, Event, RgbdFrame, SkippedFrame, WheelReading, YawRate
from wheelsight.estimation.filter import ErrorStateFilter
from wheelsight.wheels import AnyWheelOdometry, GyroCheck, HolonomicOdometry, WheelSettings, YawRateMeter, odometry_of

AnyEstimate = TypeVar("AnyEstimate", bound=Estimate)
_STILL = np.eye(4)
_IDENTITY = np.eye(4)
_REPLAYED_S = 2.0  # driven again by the wheels alone if the gyroscope fails; longer than that takes to detect
_READINGS = 256  # number of stamps kept: frames are hardly ever delayed by more readings


class ByWheels:
    """Answers wheel readings by dead reckoning, with the mean yaw rate of a gyroscope between them.

    The gyroscope counts once it agrees with the wheels. If it contradicts them later, the wheels alone continue from
    the last pose at which both agreed.
    """

    body, frame, answers = "base", "odom", WHEEL_READINGS
    last_matches = None

    def __init__(self, calibration: Calibration, settings: WheelSettings) -> None:
        self.stage_seconds: dict[str, float] = {}
        self._alone: AnyWheelOdometry = odometry_of(calibration, settings.integration)
        self._joined: AnyWheelOdometry | None = None
        self._next: tuple[float, AnyWheelOdometry] | None = None  # backup from when, if the gyroscope agrees until then
        self._last: tuple[float, FloatArray, FloatArray] | None = None  # last estimate
        self._odom = OdomFrame()
        self._odom_base: FloatArray = _STILL  # pose of the base in it
        self._moved: FloatArray = _STILL  # motion of the base by the last event
        self._has_trusted = False
        self._check = GyroCheck()
        self._rates = YawRateMeter(settings.gyro_gap_s)
        assert calibration.any_wheels is not None  # odometry_of has refused it
        self._delay_s = calibration.any_wheels.delay_s
        self._uses_gyro = settings.gyro
        self.hears: tuple[type[Event], ...] = (*self.answers, YawRate) if settings.gyro else self.answers

    @property
    def odometry(self) -> AnyWheelOdometry:
        """Odometry of the estimates, with the gyroscope while that is trusted."""
        return self._joined if self._joined is not None and self.trusts_gyro else self._alone

    @property
    def trusts_gyro(self) -> bool:
        """Whether the gyroscope agrees with the wheels, and has not contradicted them since."""
        return self._check.is_trusted

    @property
    def warnings(self) -> tuple[str, ...]:
        """Fault of the gyroscope, as a sentence."""
        return self._check.warnings

    def pause(self, seconds: float) -> None:
        """Note that a time may have passed before the next reading, whatever its stamp."""
        kept = None if self._next is None else self._next[1]
        for odometry in (self._alone, self._joined, kept):
            if odometry is not None:
                odometry.pause(seconds)

    def process(self, event: Event) -> tuple[WheelEstimate | None, str]:
        """Return the estimate at a wheel reading, None at any other event, and a note."""
        if isinstance(event, YawRate) and self._uses_gyro and not self._check.problem:
            self._check.add_rate(event.stamp_s, event.yaw_rate_rad_s)
            self._rates.add(event.stamp_s, event.yaw_rate_rad_s)
            self._joined = self._joined or self._alone.copy()
        if not isinstance(event, WheelReading):
            return None, ""
        answer, note = self._dead_reckon(event)
        self._moved = self.odometry.moved
        last, T, C = self._last, answer.T_odom_body, answer.covariance
        if last is not None and answer.before is not None and answer.before[1] is not last[1]:
            # Another odometry takes over: the correction of the past becomes part of the step.
            answer = replace(answer, before=last)
        if T is not None and C is not None and answer.reason is not Reason.CLOCK_BACKWARDS:
            self._last = answer.stamp_s, T, C
        return answer, note

    def refuse(self, event: Event, why: Untimed) -> tuple[WheelEstimate | None, str]:
        """Return the previous pose at a reading with an invalid stamp, and None at a yaw rate."""
        if isinstance(event, YawRate):
            return None, ""
        self._moved = _STILL
        T, C, stamp_s = self.odometry.T_odom_base, self.odometry.covariance, event.stamp_s - self._delay_s
        return WheelEstimate(stamp_s, Status.FAILING, T, C, why.reason, "base"), why.note

    def in_odom(self, answer: WheelEstimate) -> WheelEstimate:
        """Return the last estimate in `odom`, which does not jump when the estimate of the past changes."""
        T = answer.T_odom_body
        if T is not None:
            self._has_trusted |= self.trusts_gyro
            if self._has_trusted:
                self._odom.lay(T, motions.times(self._odom_base, self._moved))
            self._odom_base = self._odom.T_odom_body(T)
        return self._odom.framed(answer)

    def _dead_reckon(self, reading: WheelReading) -> tuple[WheelEstimate, str]:
        alone, rate_rad_s = self._alone.process(reading), self._rates.mean_until(reading.stamp_s - self._delay_s)
        if self._next is not None:
            self._next[1].process(reading)
        self._check.add_turn(alone.stamp_s, self._alone.turned_rad, alone.reason is None)
        if self._joined is None:
            return alone, self._slip
        joined = self._joined.process(reading, rate_rad_s)
        if self._check.problem:
            self._joined = self._next = None
            return alone, f"the gyroscope is left out: {self._check.problem}"
        if not self._check.agrees_now:
            self._next = None
        elif self._next is None or reading.stamp_s > self._next[0]:
            # A copy from when both sensors agreed, and still did later, for the case that the gyroscope fails.
            if self._next is not None:
                self._alone = self._next[1]
            self._next = (reading.stamp_s + _REPLAYED_S, self._joined.copy())
        return joined if self._check.is_trusted else alone, self._slip

    @property
    def _slip(self) -> str:
        """Note on slip, if the wheels contradict each other."""
        is_slipping = isinstance(self._alone, HolonomicOdometry) and self._alone.is_slipping
        return "a wheel slips: the wheels contradict each other" if is_slipping else ""


class OdomFrame:
    """Transform between `odom` and the frame of a filter; see the module.

    It is planar: the filter estimates height and tilt of each pose directly.

    Attributes:
        T_odom_filter: (4, 4) pose of the filter's frame in `odom`.
    """

    def __init__(self) -> None:
        self._T_filter_odom: FloatArray = _IDENTITY
        self.T_odom_filter: FloatArray = _IDENTITY

    def T_odom_body(self, T_filter_body: FloatArray) -> FloatArray:
        """Convert a pose (4, 4) of the filter to `odom`."""
        return np.asarray(motions.times(self.T_odom_filter, T_filter_body))

    def keep(self, T_before: FloatArray, T_now: FloatArray) -> None:
        """Keep a pose in `odom` when the filter has changed its estimate (4, 4) of it."""
        if (T_before != T_now).any():
            self.lay(T_now, self.T_odom_body(T_before))

    def lay(self, T_filter_body: FloatArray, T_odom_body: FloatArray) -> None:
        """Set the transform by one pose in both frames, (4, 4) each; only x, y and yaw count."""
        self._T_filter_odom = motions.times(_planar(T_filter_body), motions.inverse(_planar(T_odom_body)))
        self.T_odom_filter = motions.inverse(self._T_filter_odom)

    def framed(self, answer: AnyEstimate) -> AnyEstimate:
        """Return a filter's estimate in `odom`; its poses in the map and in the filter's frame do not change."""
        if self._T_filter_odom is _IDENTITY:
            return answer
        T, C, Ad = answer.T_odom_body, answer.covariance, motions.adjoint(self.T_odom_filter)
        fields: dict[str, Any] = {
            "T_map_odom": motions.times(np.ascontiguousarray(answer.T_map_odom), self._T_filter_odom),
            "T_filter_odom": self._T_filter_odom,
            "T_odom_body": None if T is None else self.T_odom_body(T),
            "covariance": None if C is None else Ad @ C @ Ad.T,
        }
        if isinstance(answer, WheelEstimate) and answer.before is not None:
            stamp_s, T_before, C_before = answer.before
            fields["before"] = (stamp_s, self.T_odom_body(T_before), Ad @ C_before @ Ad.T)
        return replace(answer, **fields)


class FusedOdom:
    """`odom` of the default filter, in which the base moves by its motion since a pose that the filter remembers.

    A correction that moves the remembered pose as well is no part of that motion. The remembered pose is that of the
    last wheel reading before the last frame: up to there wheel steps are complete.

    Args:
        keep_s: time without a frame after which the next pose is remembered.

    Attributes:
        answered: frame of the last estimate.
    """

    def __init__(self, keep_s: float) -> None:
        self._frame, self._keep_s = OdomFrame(), keep_s
        self.answered = self._frame
        self._begin: tuple[float, FloatArray, ErrorStateFilter] | None = None  # stamp and pose of the begin of the step
        self._last: tuple[float, FloatArray] | None = None  # stamp and pose in odom of the last estimate
        self._readings_s: deque[float] = deque(maxlen=_READINGS)

    def framed(self, answer: AnyEstimate, fusion: ErrorStateFilter, event: Event | None = None) -> AnyEstimate:
        """Return an estimate of the filter in `odom`; `event` is the event if its stamp is valid."""
        own = fusion.estimate
        if own.T_odom_body is None or answer.T_odom_body is None:
            return self.answered.framed(answer)
        self._follow(own, own.T_odom_body, fusion)
        T_odom_body = self._frame.T_odom_body(own.T_odom_body)
        self._last = own.stamp_s, T_odom_body
        self._remember(own.stamp_s, fusion, event)
        # While sensors are being checked, the estimate may not be that of the filter.
        self.answered = self._frame
        if not np.array_equal(answer.T_odom_body, own.T_odom_body):
            self.answered = OdomFrame()
            self.answered.lay(answer.T_odom_body, T_odom_body)
        return self.answered.framed(answer)

    def _follow(self, own: FusedEstimate, T_filter_body: FloatArray, fusion: ErrorStateFilter) -> None:
        """Keep the remembered pose in `odom`; after a change of filter, continue at the last twist."""
        known = fusion.remembered(STEP_BEGIN)
        if self._begin is not None and known is not None and self._begin[2] is fusion:
            self._frame.keep(self._begin[1], known)
            self._begin = self._begin[0], known, fusion
        elif self._last is not None and own.twist is not None:
            vx, vy, turn = own.twist * max(own.stamp_s - self._last[0], 0.0)
            T_before_now = motions.exp(np.array([vx, vy, 0.0, 0.0, 0.0, turn]))
            self._frame.lay(T_filter_body, motions.times(self._last[1], T_before_now))

    def _remember(self, stamp_s: float, fusion: ErrorStateFilter, event: Event | None) -> None:
        """Remember the pose at the last reading up to a frame; or the current one, if no frame arrives."""
        begin_s = -math.inf if self._begin is None or self._begin[2] is not fusion else self._begin[0]
        due_s = stamp_s if stamp_s - begin_s > self._keep_s else -math.inf
        if isinstance(event, WheelReading):
            self._readings_s.append(stamp_s)
        if isinstance(event, RgbdFrame | SkippedFrame):
            past_s = (read_s for read_s in self._readings_s if event.stamp_s - self._keep_s < read_s <= event.stamp_s)
            due_s = max(past_s, default=min(event.stamp_s, stamp_s))
        if due_s > begin_s:
            fusion.clone(due_s, STEP_BEGIN)
            known = fusion.remembered(STEP_BEGIN)
            self._begin = None if known is None else (due_s, known, fusion)


def _planar(T: FloatArray) -> FloatArray:
    """Return the planar part of a motion (4, 4): x, y and yaw."""
    planar, yaw_rad = np.eye(4), math.atan2(T[1, 0], T[0, 0])
    planar[0, 0] = planar[1, 1] = math.cos(yaw_rad)
    planar[1, 0] = math.sin(yaw_rad)
    planar[0, 1] = -planar[1, 0]
    planar[:2, 3] = T[:2, 3]
    return planar
