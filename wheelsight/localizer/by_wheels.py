"""ByWheels: wheel readings answered by dead reckoning."""

from __future__ import annotations

from wheelsight.calibration import Calibration
from wheelsight.config import WheelSettings
from wheelsight.errors import CalibrationError
from wheelsight.estimates import Estimate
from wheelsight.events import Event, WheelSpeeds, WheelTicks, YawRate
from wheelsight.odometry.wheels import WheelOdometry, YawRateMeter


class ByWheels:
    """Wheel readings answered by dead reckoning; a gyroscope's readings between them are averaged."""

    body, world, answers = "base", "odom", (WheelTicks, WheelSpeeds)
    last_matches = None

    def __init__(self, calibration: Calibration, settings: WheelSettings) -> None:
        if calibration.wheels is None:
            problem = f"the calibration ({calibration.source}) has no wheels"
            raise CalibrationError(problem, fix="give a calibration.yaml with wheels by --calibration")
        self.odometry = WheelOdometry(calibration.wheels, settings.integration, calibration.gyro)
        self.stage_seconds: dict[str, float] = {}
        self._rates = YawRateMeter()
        self._delay_s = calibration.wheels.delay_s
        self._uses_gyro = settings.gyro

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        """The estimate at a reading, None at any other event, and a note."""
        if isinstance(event, YawRate) and self._uses_gyro:
            self._rates.add(event.stamp_s, event.yaw_rate_rad_s)
        if not isinstance(event, WheelTicks | WheelSpeeds):
            return None, ""
        return self.odometry.process(event, self._rates.mean_until(event.stamp_s - self._delay_s)), ""
