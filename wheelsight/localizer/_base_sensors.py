"""BaseSensors: wheels and gyroscope, as the default filter hears them."""

from __future__ import annotations

import math
from dataclasses import replace

from wheelsight.calibration import Calibration
from wheelsight.estimates import WheelEstimate
from wheelsight.events import Event, WheelReading, WheelSpeeds, YawRate
from wheelsight.fusion import ErrorStateFilter
from wheelsight.localizer.by_wheels import ByWheels
from wheelsight.odometry.wheels import ReadingTimes, WheelSettings


class BaseSensors:
    """Wheels by themselves; and beside them dead reckoning that joins the gyroscope.

    The filter knows the gyroscope's bias; had the wheels used it too, it would count twice. What dead reckoning with it
    tells is whether the gyroscope is to be believed, and what it shows at rest.

    Attributes:
        deaf: why the wheels are not heard, or "".
    """

    def __init__(self, calibration: Calibration, settings: WheelSettings) -> None:
        self._wheels = ByWheels(calibration, settings.model_copy(update={"gyro": False}))
        self._with_gyro = ByWheels(calibration, settings)
        assert calibration.any_wheels is not None  # ByWheels has refused it
        self._times = ReadingTimes(calibration.any_wheels, settings.reading_times)
        self._uses_gyro, self._hears_gyro, self._was_trusted = settings.gyro, False, False
        self.deaf = ""
        self._last_s = -math.inf

    @property
    def hears(self) -> tuple[type[Event], ...]:
        """The types of events that tell anything."""
        return self._with_gyro.hears

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the gyroscope, as a sentence."""
        return self._with_gyro.warnings

    @property
    def noise_s(self) -> float:
        """By which the times of readings are uncertain."""
        return self._times.noise_s

    def process(self, reading: WheelReading) -> tuple[WheelEstimate | None, str]:
        """What the wheels tell by themselves, stamped by when they did it, and a note of the gyroscope."""
        self._last_s = reading.stamp_s
        if not isinstance(reading, WheelSpeeds):  # speeds have no ways of their own to find the time by
            reading = replace(reading, stamp_s=self._times.time_of(reading))
        wheels, note = self._wheels.process(reading)
        return wheels, self._with_gyro.process(reading)[1] if self._hears_gyro else note

    def refuse(self, reading: WheelReading) -> None:
        """Take a reading whose stamp is far from all others: its clock leapt, or so long nothing was heard."""
        paused_s = reading.stamp_s - self._last_s
        if 0 < paused_s < math.inf:
            self._wheels.pause(paused_s)
            self._with_gyro.pause(paused_s)

    def hear(self, rate: YawRate) -> bool:
        """Take a yaw rate; whether it counts: the gyroscope is wanted, and has agreed with the wheels."""
        if self._uses_gyro:
            self._hears_gyro = True
            self._with_gyro.process(rate)
        return self._uses_gyro and self._with_gyro.trusts_gyro

    @property
    def uses_gyro(self) -> bool:
        """Whether a gyroscope is wanted."""
        return self._uses_gyro

    def tell(self, rate: YawRate, fusion: ErrorStateFilter) -> None:
        """Tell the filter a yaw rate that counts; before the first, the bias that was found."""
        if not self._was_trusted:
            found = self._with_gyro.odometry
            fusion.update_gyro_bias(rate.stamp_s, found.gyro_bias_rad_s, found.gyro_bias_sigma_rad_s)
        self._was_trusted = True
        fusion.update_yaw_rate(rate.stamp_s, rate.yaw_rate_rad_s)

    def begin_again(self) -> None:
        """Another filter is told from now on: it does not know the bias."""
        self._was_trusted = False
