"""ByWheels: dead reckoning with the wheels, and with a gyroscope once it agrees with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import Untimed
from wheelsight.core.estimates import OdomFrame, PoseFinding, Reason, WheelEstimate, status_of
from wheelsight.core.geometry import FloatArray
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.messages import WHEEL_READINGS, Event, WheelReading, YawRate
from wheelsight.core.threads import Stopwatch
from wheelsight.wheels import AnyWheelOdometry, GyroCheck, HolonomicOdometry, WheelSettings, YawRateMeter, odometry_of

_STILL = np.eye(4)
_REPLAYED_S = 2.0  # driven again by the wheels alone if the gyroscope fails; longer than that takes to detect


class ByWheels:
    """Answers wheel readings by dead reckoning, with the mean yaw rate of a gyroscope between them.

    The gyroscope counts once it agrees with the wheels. If it contradicts them later, the wheels alone continue from
    the last pose at which both agreed. If nothing shows which of both is wrong, the status is `coasting`, and the
    covariance covers the turn of the gyroscope since then.

    Args:
        calibration: of the wheels.
        settings: of their odometry.
        in_odom: whether poses are in `odom`, which does not jump when the estimate of the past changes. Else they are
            in a frame of their own, as a filter needs them.

    Attributes:
        gyro_check: compares the gyroscope with the wheels.
    """

    body, frame, answers = "base", "odom", WHEEL_READINGS
    last_matches = last_place = loops = mapper = keyframes = None

    def __init__(self, calibration: Calibration, settings: WheelSettings, *, in_odom: bool = False) -> None:
        self.watch = Stopwatch()  # frames have no stages
        self.T_odom_map: FloatArray = np.eye(4)
        self._alone: AnyWheelOdometry = odometry_of(calibration, settings.integration)
        self._joined: AnyWheelOdometry | None = None
        self._next: tuple[float, AnyWheelOdometry] | None = None  # backup from when, if the gyroscope agrees until then
        self._last: tuple[float, FloatArray, FloatArray] | None = None  # last estimate
        self._odom, self._is_in_odom = OdomFrame(), in_odom
        self._odom_base: FloatArray = _STILL  # pose of the base in it
        self._moved: FloatArray = _STILL  # motion of the base by the last event
        self._has_trusted = False
        # Turn of the wheels minus that of the gyroscope since both agreed, and the position (3,) then.
        self._apart_rad = 0.0
        self._agreed: FloatArray = np.zeros(3)
        self.gyro_check = GyroCheck()
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
        return self.gyro_check.is_trusted

    @property
    def warnings(self) -> tuple[str, ...]:
        """Fault of the gyroscope, as a sentence."""
        return self.gyro_check.warnings

    @property
    def odometries(self) -> tuple[AnyWheelOdometry, ...]:
        """All odometries of the same wheels."""
        kept = None if self._next is None else self._next[1]
        return tuple(one for one in (self._alone, self._joined, kept) if one is not None)

    def pause(self, seconds: float) -> None:
        """Note that a time may have passed before the next reading, whatever its stamp."""
        for odometry in self.odometries:
            odometry.pause(seconds)

    def process(self, event: Event) -> tuple[WheelEstimate | None, str]:
        """Return the estimate at a wheel reading, None at any other event, and a note."""
        if isinstance(event, YawRate) and self._uses_gyro and (not self.gyro_check.problem or self.gyro_check.is_open):
            self._rates.add(event.stamp_s, event.yaw_rate_rad_s)
            if not self.gyro_check.problem:
                self.gyro_check.add_rate(event.stamp_s, event.yaw_rate_rad_s)
                self._joined = self._joined or self._alone.copy()
        if not isinstance(event, WheelReading):
            return None, ""
        answer, note = self._dead_reckon(event)
        if self.gyro_check.is_open:
            answer = self._covering_both(answer)
        self._moved = self.odometry.moved
        last, T, C = self._last, answer.T_odom_body, answer.covariance
        if last is not None and answer.before is not None and answer.before[1] is not last[1]:
            # Another odometry takes over: the correction of the past becomes part of the step.
            answer = replace(answer, before=last)
        if T is not None and C is not None and answer.reason is not Reason.CLOCK_BACKWARDS:
            self._last = answer.stamp_s, T, C
        return self._in_odom(answer), note

    def refuse(self, event: Event, why: Untimed) -> tuple[WheelEstimate | None, str]:
        """Return the previous pose at a reading with an invalid stamp, and None at a yaw rate."""
        if isinstance(event, YawRate):
            return None, ""
        self._moved = _STILL
        T, C, stamp_s = self.odometry.T_odom_base, self.odometry.covariance, event.stamp_s - self._delay_s
        status = status_of(PoseFinding.READING_REFUSED)
        return self._in_odom(WheelEstimate(stamp_s, status, T, C, why.reason, "base")), why.note

    def _covering_both(self, answer: WheelEstimate) -> WheelEstimate:
        """Return an estimate of the wheels that also covers the turn of the gyroscope since both agreed."""
        x, y, _ = self._agreed  # the way since then turns about that place
        turn = self._apart_rad * np.array([y, -x, 0.0, 0.0, 0.0, 1.0])
        C = None if answer.covariance is None else answer.covariance + np.outer(turn, turn)
        status = answer.status if answer.reason is not None else status_of(PoseFinding.TURNS_CONTRADICTED)
        return replace(answer, status=status, covariance=C)

    def _in_odom(self, answer: WheelEstimate) -> WheelEstimate:
        """Return the last estimate in the frame of the poses."""
        T = answer.T_odom_body
        if not self._is_in_odom:
            return answer
        if T is not None:
            self._has_trusted |= self.trusts_gyro
            if self._has_trusted:
                self._odom.align(T, motions.times(self._odom_base, self._moved))
            self._odom_base = self._odom.T_odom_body(T)
        return self._odom.framed(answer)

    def _dead_reckon(self, reading: WheelReading) -> tuple[WheelEstimate, str]:
        alone, rate_rad_s = self._alone.process(reading), self._rates.mean_until(reading.stamp_s - self._delay_s)
        if self._next is not None:
            self._next[1].process(reading)
        seconds = 0.0 if alone.before is None else alone.stamp_s - alone.before[0]
        if rate_rad_s is not None and alone.reason is None:
            self._apart_rad += self._alone.turned_rad - rate_rad_s * seconds
        if self.gyro_check.agrees_now and alone.T_odom_body is not None:
            self._apart_rad, self._agreed = 0.0, self.odometry.T_odom_base[:3, 3].copy()
        self.gyro_check.add_turn(alone.stamp_s, self._alone.turned_rad, alone.reason is None)
        if self._joined is None:
            return alone, self._slip
        joined = self._joined.process(reading, rate_rad_s)
        if self.gyro_check.problem:
            self._joined = self._next = None
            return alone, f"the gyroscope is left out: {self.gyro_check.problem}"
        if not self.gyro_check.agrees_now:
            self._next = None
        elif self._next is None or reading.stamp_s > self._next[0]:
            # A copy from when both sensors agreed, and still did later, for the case that the gyroscope fails.
            if self._next is not None:
                self._alone = self._next[1]
            self._next = (reading.stamp_s + _REPLAYED_S, self._joined.copy())
        return joined if self.gyro_check.is_trusted else alone, self._slip

    @property
    def _slip(self) -> str:
        return slip_note(self._alone) if isinstance(self._alone, HolonomicOdometry) else ""


def slip_note(odometry: HolonomicOdometry) -> str:
    """Return a note on slip if the wheels contradict each other, else an empty one."""
    return "a wheel slips: the wheels contradict each other" if odometry.is_slipping else ""
