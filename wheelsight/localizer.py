"""Localizer: where the robot is, event by event. The whole step on one screen."""

from __future__ import annotations

import math
from dataclasses import replace

from wheelsight.calibration import Calibration
from wheelsight.config import Config
from wheelsight.estimates import Estimate
from wheelsight.events import Event, SkippedFrame, WheelTicks
from wheelsight.geometry import se3
from wheelsight.odometry.features import FeatureOdometry


class Localizer:
    """Answers each frame with the pose of the body at its stamp, or with the reason why there is none.

    The body is the robot's base where the calibration knows `T_base_camera`, else the camera; the world is
    where the body was at the first tracked frame. `odometry: features` takes no part of wheel readings.

    Attributes:
        body: "base" or "camera".
        odometry: what estimates the camera's motion; its `last_matches` and `stage_seconds` tell of the last frame.
        note: what there is to say about the last event beyond its reason; often empty.
    """

    def __init__(self, calibration: Calibration, config: Config | None = None) -> None:
        settings = config or Config()
        self.body = "camera" if calibration.T_base_camera is None else "base"
        self.odometry = FeatureOdometry(calibration, settings.features)
        self.note = ""
        self._T_base_camera = calibration.T_base_camera
        self._newest_s = -math.inf

    def process(self, event: Event) -> Estimate | None:
        """The estimate at a frame; None for events that say nothing about a frame, such as wheel readings.

        A frame that could not be read, or that is not newer than the one before, counts as one that failed:
        it gives no pose, its reason is `FRAME_UNUSABLE`, and `note` says what was wrong with it.
        """
        self.note = ""
        if isinstance(event, WheelTicks):
            return None
        if isinstance(event, SkippedFrame):
            return self._refuse(event.stamp_s, event.reason)
        if event.stamp_s <= self._newest_s:
            return self._refuse(event.stamp_s, f"its stamp does not come after {self._newest_s:.6f} s")
        self._newest_s = event.stamp_s
        return self._of_body(self.odometry.process(event))

    def _refuse(self, stamp_s: float, why: str) -> Estimate:
        self.note = why
        return self._of_body(self.odometry.miss(stamp_s))

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
