"""ByWheels: dead reckoning with the wheels. OdomFrame: the transform from `odom` to the frame of a filter.

The pose of a filter jumps when its estimate of the past changes, for instance after slip or with a new bias of the
gyroscope. The robot has not jumped. In `odom` it moves by the estimated motion alone, and the transform between both
frames takes the jump (REP 105).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.clocks import Untimed
from wheelsight.core.estimates import Estimate, Reason, Status, WheelEstimate
from wheelsight.core.geometry import FloatArray
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.messages import WHEEL_READINGS, Event, WheelReading, YawRate
from wheelsight.wheels import AnyWheelOdometry, GyroCheck, HolonomicOdometry, WheelSettings, YawRateMeter, odometry_of

AnyEstimate = TypeVar("AnyEstimate", bound=Estimate)
_STILL = np.eye(4)
_REPLAYED_S = 2.0  # driven again by the wheels alone if the gyroscope fails; longer than that takes to detect


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
        return slip_note(self._alone) if isinstance(self._alone, HolonomicOdometry) else ""


def slip_note(odometry: HolonomicOdometry) -> str:
    """Return a note on slip if the wheels contradict each other, else an empty one."""
    return "a wheel slips: the wheels contradict each other" if odometry.is_slipping else ""


class OdomFrame:
    """Transform between `odom` and the frame of a filter; see the module.

    It is planar: the filter estimates height and tilt of each pose directly.

    Attributes:
        T_odom_filter, T_filter_odom: (4, 4) pose of the filter's frame in `odom`, and its inverse.
        has_moved: whether `odom` is no longer the filter's frame.
    """

    def __init__(self) -> None:
        self.T_filter_odom: FloatArray = _STILL
        self.T_odom_filter: FloatArray = _STILL
        self.has_moved = False

    def T_odom_body(self, T_filter_body: FloatArray) -> FloatArray:
        """Convert a pose (4, 4) of the filter to `odom`."""
        return np.asarray(motions.times(self.T_odom_filter, T_filter_body))

    def lay(self, T_filter_body: FloatArray, T_odom_body: FloatArray) -> None:
        """Set the transform by one pose in both frames, (4, 4) each; only x, y and yaw count."""
        self.T_filter_odom = motions.times(_planar(T_filter_body), motions.inverse(_planar(T_odom_body)))
        self.T_odom_filter, self.has_moved = motions.inverse(self.T_filter_odom), True

    def framed(self, answer: AnyEstimate) -> AnyEstimate:
        """Return a filter's estimate in `odom`; its poses in the map and in the filter's frame do not change."""
        if not self.has_moved:
            return answer
        T, C, Ad = answer.T_odom_body, answer.covariance, motions.adjoint(self.T_odom_filter)
        fields: dict[str, Any] = {
            "T_map_odom": motions.times(np.ascontiguousarray(answer.T_map_odom), self.T_filter_odom),
            "T_filter_odom": self.T_filter_odom,
            "T_odom_body": None if T is None else self.T_odom_body(T),
            "covariance": None if C is None else Ad @ C @ Ad.T,
        }
        if isinstance(answer, WheelEstimate) and answer.before is not None:
            stamp_s, T_before, C_before = answer.before
            fields["before"] = (stamp_s, self.T_odom_body(T_before), Ad @ C_before @ Ad.T)
        return replace(answer, **fields)


def _planar(T: FloatArray) -> FloatArray:
    """Return the planar part of a motion (4, 4): x, y and yaw."""
    planar, yaw_rad = np.eye(4), math.atan2(T[1, 0], T[0, 0])
    planar[0, 0] = planar[1, 1] = math.cos(yaw_rad)
    planar[1, 0] = math.sin(yaw_rad)
    planar[0, 1] = -planar[1, 0]
    planar[:2, 3] = T[:2, 3]
    return planar
