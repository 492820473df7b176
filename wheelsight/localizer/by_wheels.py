"""ByWheels: wheel readings answered by dead reckoning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.clocks import Untimed
from wheelsight.estimates import Reason, Status, WheelEstimate
from wheelsight.events import WHEEL_READINGS, Event, WheelReading, YawRate
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions
from wheelsight.localizer._odom_frame import OdomFrame
from wheelsight.odometry.wheels import (
    AnyWheelOdometry,
    GyroCheck,
    HolonomicOdometry,
    WheelSettings,
    YawRateMeter,
    odometry_of,
)

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
