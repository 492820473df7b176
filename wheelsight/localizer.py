"""Localizer: where the robot is, event by event. The whole step on one screen."""

from __future__ import annotations

import math
from dataclasses import replace

from wheelsight.calibration import Calibration
from wheelsight.config import Config, WheelSettings
from wheelsight.errors import CalibrationError, ConfigError
from wheelsight.estimates import Estimate
from wheelsight.events import Event, RgbdFrame, SkippedFrame, WheelSpeeds, WheelTicks, YawRate
from wheelsight.geometry import se3
from wheelsight.odometry.features import FeatureOdometry, MatchedPixels
from wheelsight.odometry.wheels import WheelOdometry, YawRateMeter


class Localizer:
    """Answers each frame or wheel reading with the pose of the body at its stamp, or with the reason why there is none.

    It goes by one odometry.

    With `odometry: features` the frames are answered; the body is the robot's base where the calibration knows
    `T_base_camera`, else the camera; the world is where the body was at the first tracked frame. With `odometry:
    wheels` the wheel readings are answered; the body is the base, its frame `odom`, which begins at the first reading.

    Attributes:
        body: "base" or "camera".
        world: "world" or "odom".
        answers: the types of the events that are answered.
        note: what there is to say about the last event beyond its reason; often empty.

    Raises:
        ConfigError: the configuration names several odometries.
        CalibrationError: the calibration lacks the cameras or wheels that the odometry needs.
    """

    def __init__(self, calibration: Calibration, config: Config | None = None) -> None:
        settings = config or Config()
        if len(settings.odometry) > 1:
            several = " and ".join(settings.odometry)
            raise ConfigError(f"a localizer goes by one odometry, not by {several}", fix="give it config.alone(name)")
        self._way: _ByFrames | _ByWheels
        if settings.odometry == ("wheels",):
            self._way = _ByWheels(calibration, settings.wheels)
        else:
            self._way = _ByFrames(calibration, settings)
        self.body, self.world, self.answers = self._way.body, self._way.world, self._way.answers
        self.note = ""

    @property
    def odometry(self) -> FeatureOdometry | WheelOdometry:
        """What estimates the motion."""
        return self._way.odometry

    @property
    def last_matches(self) -> MatchedPixels | None:
        """What the last frame was aligned by, if it was a frame that could be."""
        return None if isinstance(self._way, _ByWheels) else self._way.odometry.last_matches

    @property
    def stage_seconds(self) -> dict[str, float]:
        """How long each stage of the last frame took; none of a wheel reading."""
        return {} if isinstance(self._way, _ByWheels) else self._way.odometry.stage_seconds

    def process(self, event: Event) -> Estimate | None:
        """The estimate at an event that is answered, None at any other.

        A frame that could not be read, or that is not newer than the one before, counts as one that failed:
        it gives no pose, its reason is `FRAME_UNUSABLE`, and `note` says what was wrong with it.
        """
        estimate, self.note = self._way.process(event)
        return estimate


class _ByWheels:
    """Wheel readings answered by dead reckoning; a gyroscope's readings between them are averaged."""

    body, world, answers = "base", "odom", (WheelTicks, WheelSpeeds)

    def __init__(self, calibration: Calibration, settings: WheelSettings) -> None:
        if calibration.wheels is None:
            problem = f"the calibration ({calibration.source}) has no wheels"
            raise CalibrationError(problem, fix="give a calibration.yaml with wheels by --calibration")
        self.odometry = WheelOdometry(calibration.wheels, settings.integration, calibration.gyro)
        self._rates = YawRateMeter()
        self._delay_s = calibration.wheels.delay_s
        self._uses_gyro = settings.gyro

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        if isinstance(event, YawRate) and self._uses_gyro:
            self._rates.add(event.stamp_s, event.yaw_rate_rad_s)
        if not isinstance(event, WheelTicks | WheelSpeeds):
            return None, ""
        return self.odometry.process(event, self._rates.mean_until(event.stamp_s - self._delay_s)), ""


class _ByFrames:
    """Frames answered by feature odometry, told of the base where it is known."""

    world, answers = "world", (RgbdFrame, SkippedFrame)

    def __init__(self, calibration: Calibration, settings: Config) -> None:
        self.body = "camera" if calibration.T_base_camera is None else "base"
        self.odometry = FeatureOdometry(calibration, settings.features)
        self._T_base_camera = calibration.T_base_camera
        self._newest_s = -math.inf

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        if isinstance(event, SkippedFrame):
            return self._refuse(event.stamp_s, event.reason)
        if not isinstance(event, RgbdFrame):
            return None, ""
        if event.stamp_s <= self._newest_s:
            return self._refuse(event.stamp_s, f"its stamp does not come after {self._newest_s:.6f} s")
        self._newest_s = event.stamp_s
        return self._of_body(self.odometry.process(event)), ""

    def _refuse(self, stamp_s: float, why: str) -> tuple[Estimate, str]:
        return self._of_body(self.odometry.miss(stamp_s)), why

    def _of_body(self, estimate: Estimate) -> Estimate:
        """The camera's estimate as the base's: both worlds start at identity, so T_base_camera changes both sides."""
        if self._T_base_camera is None:
            return estimate
        if estimate.T_world_body is None:
            return replace(estimate, body="base")
        T_base_camera = self._T_base_camera
        covariance = estimate.covariance
        if covariance is not None:
            Ad = se3.adjoint(T_base_camera)
            covariance = Ad @ covariance @ Ad.T
        T_world_base = T_base_camera @ estimate.T_world_body @ se3.invert(T_base_camera)
        return replace(estimate, T_world_body=T_world_base, covariance=covariance, body="base")
