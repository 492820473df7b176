"""ByFrames: frames answered by feature odometry, or by dense odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.clocks import Untimed
from wheelsight.config import Config
from wheelsight.estimates import CameraEstimate, Estimate, Reason, Status
from wheelsight.events import Event, RgbdFrame, SkippedFrame
from wheelsight.geometry import FloatArray, se3
from wheelsight.keyframes import KeyframeId
from wheelsight.localizer._camera import camera_odometry
from wheelsight.localizer._frame_gate import FrameGate
from wheelsight.localizer._fused_camera import BLIND
from wheelsight.localizer._loops import LoopsBeside, begin_in, loops_beside
from wheelsight.localizer.choice import NO_PARTS, OwnParts
from wheelsight.odometry.dense import DenseEstimate
from wheelsight.odometry.features import FeatureEstimate, MatchedPixels
from wheelsight.slam.known import KnownMap
from wheelsight.slam.settings import PieceSettings


class ByFrames:
    """Frames answered by the odometry that the settings name, told of the base where it is known.

    Attributes:
        last_matches: the pixels that the last frame was found by; None where there are none.
        loops: closes loops while driving, where that is asked for.
        T_odom_map: (4, 4) where the map lies, which loops have moved the camera in.
    """

    answers = (RgbdFrame, SkippedFrame)

    def __init__(
        self,
        calibration: Calibration,
        settings: Config,
        known: KnownMap | None = None,
        *,
        waits: bool = False,
        parts: OwnParts = NO_PARTS,
    ) -> None:
        self.frame = "map" if known is None else "odom"  # in a map of before, odom begins anywhere
        self.body = "camera" if calibration.T_base_camera is None else "base"
        self.odometry, self.mapper = camera_odometry(calibration, settings, known, parts)
        T_base_camera = calibration.T_base_camera
        self._T_camera_base = None if T_base_camera is None else se3.invert(T_base_camera)
        self._gate = FrameGate(settings.localizer.frame_gate)
        self.hears: tuple[type[Event], ...] = self.answers
        self._status = Status.INITIALIZING
        self.last_matches: MatchedPixels | None = None
        detector = parts.loop_detector
        self.loops = loops_beside(self.odometry.store, calibration, settings, known, waits=waits, detector=detector)
        self.T_odom_map: FloatArray = np.eye(4)
        if known is not None:
            T_odom_camera = np.eye(4) if T_base_camera is None else T_base_camera
            self.T_odom_map = se3.nearest(
                T_odom_camera @ se3.invert(begin_in(known, calibration, settings.loops.pieces))
            )
        self._keyframe: KeyframeId | None = None
        self._last: CameraEstimate | None = None  # that had a pose, in odom
        self._pieces = settings.loops.pieces

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
            return self._of_body(self._tracked(event)), ""
        if why_not.is_repeat:
            return self._repeated(event.stamp_s), why_not.note
        return self._failed(event.stamp_s, why_not.note)

    def refuse(self, event: Event, why: Untimed) -> tuple[Estimate, str]:
        """The answer to a frame whose stamp means nothing."""
        return self._failed(event.stamp_s, why.note)

    def _failed(self, stamp_s: float, why: str) -> tuple[Estimate, str]:
        return self._of_body(self.odometry.miss(stamp_s)), why

    def _tracked(self, frame: RgbdFrame) -> CameraEstimate:
        """The camera's pose at a frame; the map learns where all of its motion was seen."""
        T_new_old = None if self.loops is None else self.loops.move_keyframes(frame.stamp_s, self._keyframe)
        if T_new_old is not None:
            self.T_odom_map = se3.nearest(self.T_odom_map @ se3.invert(T_new_old))
        estimate: CameraEstimate = self.odometry.process(frame)
        if self.loops is not None and estimate.status is Status.LOST and estimate.reason not in BLIND:
            estimate = self._begin_piece(self.loops, frame, estimate)
        self._keyframe = self._keyframe if estimate.keyframe is None else estimate.keyframe
        if self.mapper is not None and isinstance(estimate, DenseEstimate) and estimate.shows_all:
            self.mapper.fuse_tracked(frame, estimate)
        if self.loops is None:
            return estimate
        in_odom = framed(estimate, self.T_odom_map)
        if in_odom.covariance is not None:
            self.loops.hang_on(estimate, self.T_odom_map, in_odom.covariance)
            self.loops.keep(frame.stamp_s, self.T_odom_map, in_odom.covariance)
            self.loops.hand_over()
        self._last = self._last if in_odom.T_odom_body is None else in_odom
        return self.loops.called(in_odom)

    def _begin_piece(self, loops: LoopsBeside, frame: RgbdFrame, lost: CameraEstimate) -> CameraEstimate:
        """The answer at a frame that shows nothing known, at which another piece of map begins.

        In odom the camera stays where it was seen last, less certain by where it may be by now.
        """
        last = self._last
        if last is None or last.T_odom_body is None or last.covariance is None:
            return lost
        C_odom = last.covariance + carried_off(last.T_odom_body, frame.stamp_s - last.stamp_s, self._pieces)
        T_map_camera = loops.apart(se3.invert(self.T_odom_map) @ last.T_odom_body)
        T_odom_map = se3.nearest(last.T_odom_body @ se3.invert(T_map_camera))
        Ad = se3.adjoint(se3.invert(T_odom_map))
        found = self.odometry.restart(frame, T_map_camera, Ad @ C_odom @ Ad.T)
        if found.keyframe is None:
            return lost
        loops.begin_piece(found.keyframe)
        self.T_odom_map = T_odom_map
        return found

    def _repeated(self, stamp_s: float) -> Estimate:
        """The answer to an image that has come before: no pose, and odometry goes on as if it had not come."""
        status = Status.FAILING if self._status is Status.TRACKING else self._status
        return Estimate(stamp_s, status, reason=Reason.REPEATED, body=self.body)

    def _of_body(self, estimate: Estimate) -> Estimate:
        """The camera's estimate as the base's; the covariance, of a perturbation in the map, is that of both."""
        self._status = estimate.status
        self.last_matches = estimate.matched if isinstance(estimate, FeatureEstimate) else None
        if isinstance(estimate, DenseEstimate):
            estimate = replace(estimate, frame=None)  # whoever gets it may keep all estimates, but not all frames
        if self._T_camera_base is None:
            return estimate
        if estimate.T_odom_body is None:
            return replace(estimate, body="base")
        T_keyframe_camera, T_camera_base = estimate.T_keyframe_body, self._T_camera_base
        T_keyframe_base = None if T_keyframe_camera is None else T_keyframe_camera @ T_camera_base
        T_odom_base = estimate.T_odom_body @ T_camera_base
        return replace(estimate, T_odom_body=T_odom_base, T_keyframe_body=T_keyframe_base, body="base")


def carried_off(T_odom_camera: FloatArray, seconds: float, settings: PieceSettings) -> FloatArray:
    """Covariance (6, 6) that a pose gains while nobody saw where the camera was carried."""
    sigma_m = settings.speed_m_s * seconds
    sigma_rad = min(settings.turn_rad_s * seconds, settings.most_rad)
    Ad = se3.adjoint(T_odom_camera)
    return np.asarray(Ad @ np.diag(np.square([sigma_m] * 3 + [sigma_rad] * 3)) @ Ad.T)


def framed(seen: CameraEstimate, T_odom_map: FloatArray) -> CameraEstimate:
    """What odometry answers in the map, T_map_camera and its covariance, in odom, from where the map lies (4, 4)."""
    T_map_odom = se3.invert(T_odom_map)
    if seen.T_odom_body is None or seen.covariance is None:
        return replace(seen, T_map_odom=T_map_odom)
    Ad = se3.adjoint(T_odom_map)
    T_odom_camera = se3.nearest(T_odom_map @ seen.T_odom_body)
    return replace(seen, T_odom_body=T_odom_camera, covariance=Ad @ seen.covariance @ Ad.T, T_map_odom=T_map_odom)
