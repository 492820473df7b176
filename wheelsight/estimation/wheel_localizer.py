"""ByWheels: dead reckoning with the wheels. OdomFrame: the transform from `odom` to the frame of a filter."""

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

# ByWheels: wheel readings answered by dead reckoning.


_STILL = np.eye(4)


class ByWheels:
    """Wheel readings answered by dead reckoning; a gyroscope's readings between them are averaged.

    What the gyroscope makes of the drive is answered once it has agreed with the wheels. Where it contradicts them
    later, the way goes on by the wheels alone from where both last agreed.
    """

    body, frame, answers = "base", "odom", WHEEL_READINGS
    last_matches = None

    def __init__(self, calibration: Calibration, settings: WheelSettings) -> None:
        self.stage_seconds: dict[str, float] = {}
        self._alone: AnyWheelOdometry = odometry_of(calibration, settings.integration)
        self._joined: AnyWheelOdometry | None = None
        self._next: tuple[float, AnyWheelOdometry] | None = None  # what will be kept if the gyroscope agrees until then
        self._last: tuple[float, FloatArray, FloatArray] | None = None  # what was answered
        self._odom = OdomFrame()
        self._odom_base: FloatArray = _STILL  # where it is there
        self._moved: FloatArray = _STILL  # the base, at the last event
        self._has_trusted = False
        self._check = GyroCheck(settings.gyro_check)
        self._rates = YawRateMeter(settings.gyro_gap_s)
        assert calibration.any_wheels is not None  # of which the odometry is
        self._delay_s = calibration.any_wheels.delay_s
        self._uses_gyro = settings.gyro
        self.hears: tuple[type[Event], ...] = (*self.answers, YawRate) if settings.gyro else self.answers

    @property
    def odometry(self) -> AnyWheelOdometry:
        """What is answered by."""
        return self._joined if self._joined is not None and self.trusts_gyro else self._alone

    @property
    def trusts_gyro(self) -> bool:
        """Whether the gyroscope has agreed with the wheels, and not contradicted them since."""
        return self._check.is_trusted

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the gyroscope, as a sentence."""
        return self._check.warnings

    def pause(self, seconds: float) -> None:
        """Before the next reading, so long may have passed, whatever stamps say."""
        kept = None if self._next is None else self._next[1]
        for odometry in (self._alone, self._joined, kept):
            if odometry is not None:
                odometry.pause(seconds)

    def process(self, event: Event) -> tuple[WheelEstimate | None, str]:
        """The estimate at a reading, None at any other event, and a note."""
        if isinstance(event, YawRate) and self._uses_gyro and not self._check.problem:
            self._check.add_rate(event.stamp_s, event.yaw_rate_rad_s)
            self._rates.add(event.stamp_s, event.yaw_rate_rad_s)
            self._joined = self._joined or self._alone.copy()
        if not isinstance(event, WheelReading):
            return None, ""
        return self._reading(event)

    def refuse(self, event: Event, why: Untimed) -> tuple[WheelEstimate | None, str]:
        """The answer to an event whose stamp means nothing: none to a yaw rate, the pose before to a reading."""
        if isinstance(event, YawRate):
            return None, ""
        self._moved = _STILL
        T, C, stamp_s = self.odometry.T_odom_base, self.odometry.covariance, event.stamp_s - self._delay_s
        return WheelEstimate(stamp_s, Status.FAILING, T, C, why.reason, "base"), why.note

    def in_odom(self, answer: WheelEstimate) -> WheelEstimate:
        """The last answer in the frame that does not leap with what gyroscope and wheels tell of the way so far."""
        T = answer.T_odom_body
        if T is not None:
            self._has_trusted |= self.trusts_gyro
            if self._has_trusted:
                self._odom.lay(T, motions.times(self._odom_base, self._moved))
            self._odom_base = self._odom.T_odom_body(T)
        return self._odom.framed(answer)

    def _reading(self, reading: WheelReading) -> tuple[WheelEstimate, str]:
        answer, note = self._answer(reading)
        self._moved = self.odometry.moved
        last, T, C = self._last, answer.T_odom_body, answer.covariance
        if last is not None and answer.before is not None and answer.before[1] is not last[1]:
            # Another odometry answers than before: what it knows better of the way so far is part of the step.
            answer = replace(answer, before=last)
        if T is not None and C is not None and answer.reason is not Reason.CLOCK_BACKWARDS:
            self._last = answer.stamp_s, T, C
        return answer, note

    def _answer(self, reading: WheelReading) -> tuple[WheelEstimate, str]:
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
        self._keep(reading.stamp_s, self._joined)
        return joined if self._check.is_trusted else alone, self._slip

    @property
    def _slip(self) -> str:
        """That a wheel slips, where the wheels themselves show it."""
        is_slipping = isinstance(self._alone, HolonomicOdometry) and self._alone.is_slipping
        return "a wheel slips: the wheels contradict each other" if is_slipping else ""

    def _keep(self, stamp_s: float, joined: AnyWheelOdometry) -> None:
        """Have something to go back to: what both came to, where they went on agreeing after."""
        if not self._check.agrees_now:
            self._next = None
        elif self._next is None:
            self._next = (stamp_s + self._check.settings.kept_s, joined.copy())
        elif stamp_s > self._next[0]:
            self._alone, self._next = self._next[1], (stamp_s + self._check.settings.kept_s, joined.copy())


# OdomFrame: where `odom` lies in the frame in which a filter has its poses.
#
# A filter's pose leaps where it thinks better of the past: wheels had slipped, the gyroscope's bias was another. The
# robot has not leapt. In `odom` it moves by what is known of the motion alone, and the rest is where `odom` lies (REP
# 105).


AnyEstimate = TypeVar("AnyEstimate", bound=Estimate)
_IDENTITY = np.eye(4)
_READINGS = 256  # whose stamps are kept: a frame that comes later than so many is a rare thing


class OdomFrame:
    """See the module. It lies in the plane of the filter's frame: height and tilt are known of each pose.

    Attributes:
        T_odom_filter: (4, 4) where the filter's frame lies in it.
    """

    def __init__(self) -> None:
        self._T_filter_odom: FloatArray = _IDENTITY
        self.T_odom_filter: FloatArray = _IDENTITY

    def T_odom_body(self, T_filter_body: FloatArray) -> FloatArray:
        """(4, 4) of a pose of the filter."""
        return np.asarray(motions.times(self.T_odom_filter, T_filter_body))

    def rethink(self, T_before: FloatArray, T_now: FloatArray) -> None:
        """The filter has one and the same pose elsewhere (4, 4) than before; in odom it stays."""
        if (T_before != T_now).any():
            self.lay(T_now, self.T_odom_body(T_before))

    def lay(self, T_filter_body: FloatArray, T_odom_body: FloatArray) -> None:
        """Lie so that a pose of the filter (4, 4) is there in odom (4, 4), as far as both are in the plane."""
        self._T_filter_odom = motions.times(_planar(T_filter_body), motions.inverse(_planar(T_odom_body)))
        self.T_odom_filter = motions.inverse(self._T_filter_odom)

    def framed(self, answer: AnyEstimate) -> AnyEstimate:
        """A filter's answer in odom: in the map and in the filter's frame its pose is as it was."""
        if self._T_filter_odom is _IDENTITY:
            return answer
        T, C, Ad = answer.T_odom_body, answer.covariance, motions.adjoint(self.T_odom_filter)
        told: dict[str, Any] = {
            "T_map_odom": motions.times(np.ascontiguousarray(answer.T_map_odom), self._T_filter_odom),
            "T_filter_odom": self._T_filter_odom,
            "T_odom_body": None if T is None else self.T_odom_body(T),
            "covariance": None if C is None else Ad @ C @ Ad.T,
        }
        if isinstance(answer, WheelEstimate) and answer.before is not None:
            stamp_s, T_before, C_before = answer.before
            told["before"] = (stamp_s, self.T_odom_body(T_before), Ad @ C_before @ Ad.T)
        return replace(answer, **told)


class FusedOdom:
    """`odom` beside the default filter: it moves by the motion since a pose that the filter remembers.

    That is the motion by all that is known by now, of which what moves the remembered pose, too, is no part. The pose
    is that of the last reading before the last frame: up to there the wheels have told all of the way.

    Args:
        keep_s: after so long without a frame a pose is remembered all the same.

    Attributes:
        answered: by which the last pose was answered.
    """

    def __init__(self, keep_s: float) -> None:
        self._frame, self._keep_s = OdomFrame(), keep_s
        self.answered = self._frame
        self._begin: tuple[float, FloatArray, ErrorStateFilter] | None = None  # of the step; as the filter had it last
        self._last: tuple[float, FloatArray] | None = None  # that was answered, in odom
        self._readings_s: deque[float] = deque(maxlen=_READINGS)

    def framed(self, answer: AnyEstimate, fusion: ErrorStateFilter, event: Event | None = None) -> AnyEstimate:
        """The answer of this filter in odom, to an event with a stamp that means something."""
        own = fusion.estimate
        if own.T_odom_body is None or answer.T_odom_body is None:
            return self.answered.framed(answer)
        self._follow(own, own.T_odom_body, fusion)
        T_odom_body = self._frame.T_odom_body(own.T_odom_body)
        self._last = own.stamp_s, T_odom_body
        self._remember(own.stamp_s, fusion, event)
        # While sensors are being checked the answer is not always the filter's own.
        self.answered = self._frame
        if not np.array_equal(answer.T_odom_body, own.T_odom_body):
            self.answered = OdomFrame()
            self.answered.lay(answer.T_odom_body, T_odom_body)
        return self.answered.framed(answer)

    def _follow(self, own: FusedEstimate, T_filter_body: FloatArray, fusion: ErrorStateFilter) -> None:
        """Lie where the remembered pose stays in odom; of another filter, which knows none, where the twist goes on."""
        known = fusion.remembered(STEP_BEGIN)
        if self._begin is not None and known is not None and self._begin[2] is fusion:
            self._frame.rethink(self._begin[1], known)
            self._begin = self._begin[0], known, fusion
        elif self._last is not None and own.twist is not None:
            vx, vy, turn = own.twist * max(own.stamp_s - self._last[0], 0.0)
            T_before_now = motions.exp(np.array([vx, vy, 0.0, 0.0, 0.0, turn]))
            self._frame.lay(T_filter_body, motions.times(self._last[1], T_before_now))

    def _remember(self, stamp_s: float, fusion: ErrorStateFilter, event: Event | None) -> None:
        """Begin a step anew at the last reading up to a frame; or here, where no frame comes."""
        begin_s = -math.inf if self._begin is None or self._begin[2] is not fusion else self._begin[0]
        due_s = stamp_s if stamp_s - begin_s > self._keep_s else -math.inf
        if isinstance(event, WheelReading):
            self._readings_s.append(stamp_s)
        if isinstance(event, RgbdFrame | SkippedFrame):
            told_s = (read_s for read_s in self._readings_s if event.stamp_s - self._keep_s < read_s <= event.stamp_s)
            due_s = max(told_s, default=min(event.stamp_s, stamp_s))
        if due_s > begin_s:
            fusion.clone(due_s, STEP_BEGIN)
            known = fusion.remembered(STEP_BEGIN)
            self._begin = None if known is None else (due_s, known, fusion)


def _planar(T: FloatArray) -> FloatArray:
    """What of a motion (4, 4) is in the plane: x, y and yaw."""
    planar, yaw_rad = np.eye(4), math.atan2(T[1, 0], T[0, 0])
    planar[0, 0] = planar[1, 1] = math.cos(yaw_rad)
    planar[1, 0] = math.sin(yaw_rad)
    planar[0, 1] = -planar[1, 0]
    planar[:2, 3] = T[:2, 3]
    return planar
