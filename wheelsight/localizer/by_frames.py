"""ByFrames: frames answered by feature odometry, or by dense odometry."""

from __future__ import annotations

from dataclasses import replace

from wheelsight.calibration import Calibration
from wheelsight.clocks import Untimed
from wheelsight.config import Config
from wheelsight.estimates import Estimate, Reason, Status
from wheelsight.events import Event, RgbdFrame, SkippedFrame
from wheelsight.geometry import se3
from wheelsight.localizer._camera import camera_odometry
from wheelsight.localizer._frame_gate import FrameGate
from wheelsight.odometry.dense import DenseEstimate, DenseOdometry
from wheelsight.odometry.features import MatchedPixels


class ByFrames:
    """Frames answered by the odometry that the settings name, told of the base where it is known."""

    frame, answers = "map", (RgbdFrame, SkippedFrame)

    def __init__(self, calibration: Calibration, settings: Config) -> None:
        self.body = "camera" if calibration.T_base_camera is None else "base"
        self.odometry, self.mapper = camera_odometry(calibration, settings)
        T_base_camera = calibration.T_base_camera
        self._T_camera_base = None if T_base_camera is None else se3.invert(T_base_camera)
        self._gate = FrameGate()
        self.hears: tuple[type[Event], ...] = self.answers
        self._status = Status.INITIALIZING

    @property
    def last_matches(self) -> MatchedPixels | None:
        """What the last frame was aligned by, if it was a frame that could be; dense odometry matches no pixels."""
        return None if isinstance(self.odometry, DenseOdometry) else self.odometry.last_matches

    @property
    def stage_seconds(self) -> dict[str, float]:
        """How long each stage of the last frame took."""
        return self.odometry.stage_seconds

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        """The estimate at a frame, None at any other event, and what was wrong with a frame that cannot be used."""
        if isinstance(event, SkippedFrame):
            return self._failed(event.stamp_s, event.reason)
        if not isinstance(event, RgbdFrame):
            return None, ""
        why_not = self._gate.why_not(event)
        if why_not is None:
            seen = (self.mapper or self.odometry).process(event)
            # Whoever gets it may keep all estimates, but not all frames.
            return self._of_body(replace(seen, frame=None) if isinstance(seen, DenseEstimate) else seen), ""
        if why_not.is_repeat:
            return self._repeated(event.stamp_s), why_not.note
        return self._failed(event.stamp_s, why_not.note)

    def refuse(self, event: Event, why: Untimed) -> tuple[Estimate, str]:
        """The answer to a frame whose stamp means nothing."""
        return self._failed(event.stamp_s, why.note)

    def _failed(self, stamp_s: float, why: str) -> tuple[Estimate, str]:
        return self._of_body((self.mapper or self.odometry).miss(stamp_s)), why

    def _repeated(self, stamp_s: float) -> Estimate:
        """The answer to an image that has come before: no pose, and odometry goes on as if it had not come."""
        if self.mapper is not None:
            self.mapper.last_fused = None
        status = Status.FAILING if self._status is Status.TRACKING else self._status
        return Estimate(stamp_s, status, reason=Reason.REPEATED, body=self.body)

    def _of_body(self, estimate: Estimate) -> Estimate:
        """The camera's estimate as the base's; the covariance, of a perturbation in the map, is that of both."""
        self._status = estimate.status
        if self._T_camera_base is None:
            return estimate
        if estimate.T_odom_body is None:
            return replace(estimate, body="base")
        T_keyframe_body = estimate.T_keyframe_body
        if T_keyframe_body is not None:
            T_keyframe_body = T_keyframe_body @ self._T_camera_base
        T_odom_body = estimate.T_odom_body @ self._T_camera_base
        return replace(estimate, T_odom_body=T_odom_body, T_keyframe_body=T_keyframe_body, body="base")
