"""`FeatureOdometry` estimates the camera's pose frame by frame and reports when tracking is lost (Zhang, Fig. 3)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.camera_errors import frame_covariance
from wheelsight.core.checks import check_frame, need_twist
from wheelsight.core.estimates import MotionEstimate, Reason, with_frame_error
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.threads import one_at_a_time
from wheelsight.vision.features.tracking import (
    LONGEST_STEP_S,
    MIN_INLIERS,
    FeatureEstimate,
    FeatureExtractor,
    Features,
    FeatureSettings,
    Fix,
    KeyframeMaker,
    KeypointView,
    LandmarkMap,
    MapTracker,
    MatchedPixels,
    ViewTracker,
    straighten,
    velocity_of,
)
from wheelsight.vision.visual_odometry import START_VARIANCE, CameraOdometry


class FeatureOdometry(CameraOdometry[FeatureEstimate]):
    """ORB keypoints with 3D–3D alignment, the state machine of Zhang's Fig. 3, and relocalization.

    The first frame with enough keypoints starts the map. Each later frame is aligned with the last tracked frame and,
    unless `reference` is "previous", with the landmarks of near keyframes. After `lost_after` failed frames in a row
    the state is LOST, until one of the keyframes is recognised.

    The store holds keyframes. When it moves them, landmarks, views and the pose move with them before the next frame.
    With `reference` "previous" everything moves with the first keyframe.

    Args:
        calibration: of the cameras.
        settings: default `FeatureSettings()`.
        T_map_first: (4, 4) pose of the camera at the first tracked frame; default the map's origin.
        store: receives keyframes; default a new one.

    Attributes:
        store: holds all keyframes and their poses.
        landmarks: the local map, updated by each frame.
        stage_seconds: time of the last frame in "extract", "match", "align" and "map".
    """

    def __init__(
        self,
        calibration: Calibration,
        settings: FeatureSettings | None = None,
        T_map_first: FloatArray | None = None,
        store: KeyframeStore | None = None,
    ) -> None:
        self._settings = settings or FeatureSettings()
        super().__init__(calibration, FeatureEstimate, self._settings.lost_after, T_map_first, store)
        self._moves = self.store.follow()
        self._maker = KeyframeMaker(calibration)
        self._extractor = FeatureExtractor(calibration, self._settings)
        self.landmarks = LandmarkMap(self._settings.kept_keyframes)
        self._view_tracker = ViewTracker(calibration, self.watch, self._settings.seed)
        self._map_tracker = MapTracker(calibration, self._settings.local_keyframes)
        self._T_color_camera = calibration.T_color_camera
        self._of_frame = frame_covariance(calibration)
        self._last: KeypointView | None = None
        self._first_raw: Features | None = None
        self._velocity: FloatArray = np.zeros(6)
        self._frames = 0

    @one_at_a_time
    def process(
        self,
        frame: RgbdFrame,
        T_previous_current_prior: FloatArray | None = None,
        *,
        twist: FloatArray | None = None,
    ) -> FeatureEstimate:
        """The camera's pose at a frame, T_map_camera, or the reason of the failure.

        Args:
            frame: newer than the previous one.
            T_previous_current_prior: (4, 4) expected motion of the camera since the last tracked frame, for instance
                from wheels. It bounds the search for matches; if that fails, a search without it follows.
            twist: (6,) the camera's present velocity (v, ω) in its own frame, from other sensors. It corrects the
                rolling shutter after a gap, where the mean velocity since the last frame says little.

        Raises:
            ArgumentError: for images or a motion of a wrong shape or type, depth that is not in metres, or a stamp that
                is not in seconds.
        """
        check_frame(frame, self._calibration, prior=T_previous_current_prior)
        if type(frame) not in self._stamps.settled:
            self._stamps.check(frame)
        self.watch.restart()
        self._follow()
        self._frames += 1
        with self.watch.stage("extract"):
            raw = self._extractor.extract(frame)
        if np.count_nonzero(raw.has_depth) < MIN_INLIERS:
            return self._fail(raw.stamp_s, MotionEstimate.failed(Reason.TOO_FEW_KEYPOINTS))
        twist = None if twist is None else need_twist(twist)
        if twist is not None and self._last is not None and raw.stamp_s - self._last.features.stamp_s > LONGEST_STEP_S:
            self._velocity = se3.adjoint(self._T_color_camera) @ twist
        if self._last is None:
            self._first_raw = raw
            return self._start(frame, raw, self._T_map_first @ se3.invert(self._T_color_camera))
        fix = self._locate(raw, self._last, T_previous_current_prior)
        if isinstance(fix, Fix) and self._first_raw is not None:
            fix = self._begin_again(self._first_raw, raw, fix)
        return self._succeed(frame, fix) if isinstance(fix, Fix) else self._fail(raw.stamp_s, fix)

    @one_at_a_time
    def restart(self, frame: RgbdFrame, T_map_camera: FloatArray, covariance: FloatArray) -> FeatureEstimate:
        """Restart at a frame with a pose (4, 4) from other sensors, its covariance (6, 6); the local map is dropped."""
        check_frame(frame, self._calibration, T_map_camera=T_map_camera, covariance=covariance)
        self.watch.restart()
        self._follow()
        self._first_raw = None
        with self.watch.stage("extract"):
            raw = self._extractor.extract(frame)
        if np.count_nonzero(raw.has_depth) < MIN_INLIERS:
            return self._fail(raw.stamp_s, MotionEstimate.failed(Reason.TOO_FEW_KEYPOINTS))
        return self._start(frame, raw, T_map_camera @ se3.invert(self._T_color_camera), covariance)

    def _follow(self) -> None:
        """Move landmarks and the last view with keyframes that the store has moved."""
        T_new_old = self._moves.moves()
        if T_new_old is not None:
            self.landmarks.move(T_new_old)
            self._last = None if self._last is None else self._last.moved(T_new_old)

    def _start(
        self, frame: RgbdFrame, features: Features, T_map_color: FloatArray, covariance: FloatArray | None = None
    ) -> FeatureEstimate:
        certain = START_VARIANCE * np.eye(6)
        number = self._keep(frame, features, T_map_color)
        self._last = self._begin(features, T_map_color, certain if covariance is None else covariance, number)
        self._state = self._state.tracked()
        return self._answer(self._last, MotionEstimate(np.eye(4), certain), None)

    def _begin(
        self, features: Features, T_map_color: FloatArray, covariance: FloatArray, number: KeyframeId
    ) -> KeypointView:
        """Start a new local map with a keyframe, and return the keyframe's view."""
        self.landmarks = LandmarkMap(self._settings.kept_keyframes)
        return self.landmarks.add_keyframe(
            KeypointView(features, T_map_color, covariance, np.full(len(features), -1)), number
        )

    def _keep(self, frame: RgbdFrame, features: Features, T_map_color: FloatArray) -> KeyframeId:
        """Add a frame to the store as a keyframe, and return its number."""
        return self.store.add(partial(self._maker.keyframe, frame, features), T_map_color @ self._T_color_camera)

    def _begin_again(self, first_raw: Features, raw: Features, fix: Fix) -> Fix:
        """Correct the rolling shutter of the first frame by the speed at the second, and locate the second again."""
        assert self._last is not None
        velocity = velocity_of(self._last, fix.view)
        calibration = self._calibration
        straight = straighten(first_raw, velocity, calibration.rolling_shutter_s, calibration.cameras[0].height)
        self._first_raw = None
        if straight is first_raw:
            return fix
        assert self._last.keyframe is not None
        uncorrected = self.landmarks, self._last
        self._last = self._begin(straight, self._last.T_map_color, self._last.covariance, self._last.keyframe)
        better = self._locate(raw, self._last, None)
        if isinstance(better, Fix):
            return better
        self.landmarks, self._last = uncorrected  # the fix refers to landmarks of this map
        return fix

    def _locate(self, raw: Features, last: KeypointView, prior: FloatArray | None) -> Fix | MotionEstimate:
        """Align with the first reference that fits, then with the map; reject implausible motions."""
        keyframes, references = self.landmarks.keyframes, [last]
        if self._state.failures > 0:
            references.append(keyframes[-1])
        if self._state.is_lost and len(keyframes) > 1:  # older ones in turn
            references.append(keyframes[-1 - self._state.failures % len(keyframes)])
        expected = None if prior is None else self._T_color_camera @ prior @ se3.invert(self._T_color_camera)
        attempts: list[tuple[KeypointView, FloatArray | None]] = []
        for view in references:
            if all(view.features is not earlier.features for earlier, _ in attempts):
                attempts.append((view, expected if view is last else None))
        failure = MotionEstimate.failed(Reason.TOO_FEW_MATCHES)
        for reference, expected in attempts:
            found = self._view_tracker.track(raw, reference, self._velocity, expected, self._frames)
            if isinstance(found, Fix):
                break
            failure = found if reference is last else failure
        else:
            return failure
        if self._settings.reference == "keyframes":
            with self.watch.stage("map"):
                refined = self._map_tracker.track(raw, found, last, self.landmarks)
            # A quick turn may leave the map within one frame. The view alone then suffices, and becomes a keyframe.
            found = refined if isinstance(refined, Fix) else found
        seconds = found.view.features.stamp_s - last.features.stamp_s
        twist = se3.twist_between(last.T_map_color, found.view.T_map_color, seconds)
        fast = np.linalg.norm(twist[:3]) > self._settings.max_speed_m_s
        if fast or np.linalg.norm(twist[3:]) > self._settings.max_turn_rad_s:
            return MotionEstimate.failed(Reason.IMPLAUSIBLE_MOTION, found.motion.matches, found.motion.inliers)
        return found

    def _succeed(self, frame: RgbdFrame, fix: Fix) -> FeatureEstimate:
        # The error common to all pixels of a frame adds to the covariances.
        motion, view = fix.motion, fix.view
        assert motion.T_reference_current is not None
        assert motion.covariance is not None
        spread = with_frame_error(motion.covariance, motion.T_reference_current, self._of_frame)
        view = replace(view, covariance=with_frame_error(view.covariance, view.T_map_color, self._of_frame))
        with self.watch.stage("map"):
            if self._settings.reference == "previous":
                self.landmarks.keyframes[:] = [view]
            else:
                seen = np.flatnonzero(view.landmark >= 0)
                self.landmarks.see_again(view.landmark[seen], view.features, seen, view.T_map_color)
                known = np.count_nonzero(self.landmarks.keyframes[-1].landmark >= 0)
                if len(seen) < self._settings.keyframe_share * known:  # it shows too few landmarks of the last one
                    number = self._keep(frame, view.features, view.T_map_color)
                    view = self.landmarks.add_keyframe(view, number)
        self._velocity = velocity_of(self._last, view) if self._last else np.zeros(6)
        self._last, self._state = view, self._state.tracked()
        # The motion of the colour camera as one of the camera frame.
        T_camera_color = se3.invert(self._T_color_camera)
        Ad = se3.adjoint(T_camera_color)
        T_reference_current = T_camera_color @ motion.T_reference_current @ self._T_color_camera
        motion = replace(motion, T_reference_current=T_reference_current, covariance=Ad @ spread @ Ad.T)
        return self._answer(view, motion, fix.matched)

    def _fail(self, stamp_s: float, failure: MotionEstimate, **more: Any) -> FeatureEstimate:
        self._velocity = np.zeros(6)
        return super()._fail(stamp_s, failure, **more)

    def _answer(self, view: KeypointView, motion: MotionEstimate, matched: MatchedPixels | None) -> FeatureEstimate:
        assert view.keyframe is not None
        T_map_camera = view.T_map_color @ self._T_color_camera
        return FeatureEstimate(
            view.features.stamp_s,
            self._state.status,
            T_map_camera,
            view.covariance,
            matches=motion.matches,
            inliers=motion.inliers,
            keyframe=view.keyframe,
            T_keyframe_body=se3.invert(self.store.pose(view.keyframe)) @ T_map_camera,
            motion=motion,
            matched=matched,
        )
