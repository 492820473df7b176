"""ByLigocki: wheels and camera, each alone, joined at every frame by the filter of Ligocki's paper."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.clocks import Untimed
from wheelsight.config import Config
from wheelsight.estimates import Estimate, Reason, Status
from wheelsight.events import Event, RgbdFrame, SkippedFrame
from wheelsight.fusion import LigockiFilter
from wheelsight.geometry import FloatArray, se3
from wheelsight.localizer._camera import mount_of
from wheelsight.localizer.by_frames import ByFrames
from wheelsight.localizer.by_wheels import ByWheels
from wheelsight.localizer.choice import NO_PARTS, OwnParts
from wheelsight.odometry.features import MatchedPixels


class ByLigocki:
    """Frames answered by eq. 2. Both sensors begin at the identity at the first frame that the camera tracked.

    Attributes:
        odometry: the camera's.
        mapper: builds a map of the camera alone, where one is asked for.
        T_odom_map: (4, 4) where that lies by the last frame that both know.
    """

    body, frame, answers = "base", "map", (RgbdFrame, SkippedFrame)

    def __init__(self, calibration: Calibration, settings: Config, parts: OwnParts = NO_PARTS) -> None:
        mount_of(calibration)  # the camera answers for the base
        self._wheels = ByWheels(calibration, settings.wheels)
        self.hears: tuple[type[Event], ...] = (*self._wheels.hears, *self.answers)
        self._camera = ByFrames(calibration, settings, parts=parts)
        self.odometry, self.mapper = self._camera.odometry, self._camera.mapper
        assert calibration.any_wheels is not None  # ByWheels has refused it
        self._max_gap_s = calibration.any_wheels.max_gap_s
        self._filter = LigockiFilter(settings.fusion.ligocki)
        self._rolled: Estimate | None = None
        self._answer: Estimate | None = None
        self._T_begin_odom: FloatArray | None = None
        self.T_odom_map: FloatArray = np.eye(4)

    @property
    def last_matches(self) -> MatchedPixels | None:
        """What the last frame was aligned by."""
        return self._camera.last_matches

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the gyroscope, as a sentence."""
        return self._wheels.warnings

    @property
    def stage_seconds(self) -> dict[str, float]:
        """How long each stage of the last frame took."""
        return self._camera.stage_seconds

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        """The joined estimate at a frame, None at any other event, and what was wrong with a frame."""
        rolled, _ = self._wheels.process(event)
        if rolled is not None:
            self._rolled = rolled
        seen, note = self._camera.process(event)
        return None if seen is None else self._joined(seen), note

    def refuse(self, event: Event, why: Untimed) -> tuple[Estimate | None, str]:
        """The joined estimate at a frame whose stamp means nothing, None at any other event."""
        if not isinstance(event, RgbdFrame | SkippedFrame):
            return None, ""
        seen, note = self._camera.refuse(event, why)
        return self._joined(seen), note

    def _joined(self, seen: Estimate) -> Estimate:
        if not math.isfinite(seen.stamp_s):
            return seen
        if seen.reason is Reason.REPEATED and self._answer is not None:
            return replace(self._answer, reason=Reason.REPEATED)
        T_odom_base = self._rolled_to(seen.stamp_s)
        if T_odom_base is None:
            return replace(seen, T_odom_body=None, covariance=None, status=Status.INITIALIZING)
        if self._T_begin_odom is None:
            if seen.T_odom_body is None:
                return seen
            self._T_begin_odom = seen.T_odom_body @ se3.invert(T_odom_base)
        T_visual = None if seen.T_odom_body is None else se3.nearest(seen.T_odom_body)
        joined = self._filter.update(seen.stamp_s, se3.nearest(self._T_begin_odom @ T_odom_base), T_visual)
        reason = joined.reason or seen.reason
        if T_visual is not None and joined.T_odom_body is not None:
            self.T_odom_map = se3.nearest(joined.T_odom_body @ se3.invert(T_visual))
        self._answer = replace(joined, reason=reason, matches=seen.matches, inliers=seen.inliers)
        return self._answer

    def _rolled_to(self, stamp_s: float) -> FloatArray | None:
        """T_odom_base by the wheels, moved on from the last reading by their speed, as far as a gap may be bridged."""
        if self._rolled is None or self._rolled.T_odom_body is None:
            return None
        seconds = min(max(stamp_s - self._rolled.stamp_s, 0.0), self._max_gap_s)
        return self._rolled.T_odom_body @ self._wheels.odometry.motion_in(seconds)
