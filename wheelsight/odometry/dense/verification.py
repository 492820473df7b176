"""Verifier: whether keypoints say the same as surfaces, wherever surfaces alone may be wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from wheelsight.estimates import MotionEstimate, Reason
from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.odometry.dense.fault_detection import FaultDetector
from wheelsight.odometry.dense.grid import GridFrame
from wheelsight.odometry.dense.keypoint_pose import KeypointPose
from wheelsight.odometry.dense.keypoints import KeypointTracker
from wheelsight.odometry.dense.locating import implausible
from wheelsight.odometry.dense.prediction import Prediction
from wheelsight.odometry.dense.reference import Reference
from wheelsight.odometry.dense.settings import DenseSettings
from wheelsight.odometry.dense.tracked import Tracked
from wheelsight.odometry.dense.views import Views
from wheelsight.odometry.features.extraction import Features
from wheelsight.odometry.state import TrackingState
from wheelsight.odometry.stopwatch import Stopwatch


class Verifier:
    """Asks keypoints where a frame is, and decides between them and surfaces where these say otherwise.

    Args:
        settings: which poses are suspected, and when keypoints count.
        keypoints: find a frame by its keypoints.
        views: the keyframes that it may show.
        by_regions: what a frame's regions say of its pose against a reference: see `Locator.by_regions`.
        watch: counts the time of "recognise".

    Attributes:
        faults: which poses are suspected.
    """

    def __init__(
        self,
        settings: DenseSettings,
        keypoints: KeypointTracker,
        views: Views,
        by_regions: Callable[[GridFrame, Reference, FloatArray], tuple[FloatArray, float | None]],
        watch: Stopwatch,
    ) -> None:
        self._all, self._settings, self._watch = settings, settings.verification, watch
        self._keypoints, self._views, self._by_regions = keypoints, views, by_regions
        self.faults = FaultDetector(settings.faults, settings.max_unseen_s)

    def ask(self, features: Features, twist: FloatArray, ahead: Prediction, state: TrackingState) -> Prediction:
        """What is expected of a frame, with what its keypoints say: by the frame before, or by keyframes known."""
        seconds = ahead.seconds_to(features.stamp_s)
        with self._watch.stage("recognise"):
            told = self._possible(self._keypoints.track(features, twist), ahead, seconds)
            if told is not None and (state.failures == 0 or told.is_likely):
                return replace(ahead, told=told)
            familiar = self._views.familiar(ahead.T_map_camera[0], state)
            seen_again = self._keypoints.recognise(features, familiar, twist)
            seen_again = self._possible(seen_again, ahead, seconds)
        if seen_again is None:
            return replace(ahead, told=told)
        is_elsewhere = not ahead.is_helped and not seen_again.agrees_with(ahead.T_map_camera[0])
        return replace(ahead.at(seen_again.T_map_camera) if is_elsewhere else ahead, told=seen_again)

    def _possible(self, told: KeypointPose | None, ahead: Prediction, seconds: float) -> KeypointPose | None:
        """The pose by keypoints; None where no camera turns that fast, however well they agree.

        Paint that repeats may look the same upside down, and all keypoints agree on it. Surfaces may have slid along a
        wall before, so that keypoints put that right by a leap; they have not turned over.
        """
        if told is None or seconds <= 0:
            return told
        R_last_now = ahead.last.T_map_camera[:3, :3].T @ told.T_map_camera[:3, :3]
        return told if so3.angle(R_last_now) <= self._all.max_turn_rad_s * seconds else None

    def verify(
        self, grid: GridFrame, found: Tracked | MotionEstimate, ahead: Prediction, state: TrackingState
    ) -> Tracked | MotionEstimate:
        """A pose that both agree with; theirs where they know better; that of surfaces where keypoints tell nothing.

        By surfaces alone it is kept while they show all motion and fit as usual, and without a leap. A prior stands in
        for what surfaces do not show, and for keypoints over a gap that it bridges.
        """
        told, seconds = ahead.told, ahead.seconds_to(grid.stamp_s)
        if not isinstance(found, Tracked):
            return self._instead(grid, found, ahead)
        if not ahead.is_helped and state.failures == 0:
            self.faults.count(seconds, shows_all=found.motion.shows_all)
        if told is not None and told.agrees_with(found.T_map_camera) and self._may_count(told, ahead, seconds):
            self.faults.unseen_s = 0.0  # keypoints show all motion
            return replace(found, told=told)
        if told is not None and told.is_clear:
            return self._taken(grid, told)
        if self._stands_alone(found, ahead, state, seconds):
            return found
        unseen = self.faults.is_blind and not ahead.is_helped
        if told is not None and self._may_count(told, ahead, seconds):
            reason = Reason.SURFACES_CONTRADICTED
        else:
            reason = Reason.DEGENERATE if unseen else Reason.NOT_RECOGNISED
        return self._instead(grid, MotionEstimate.failed(reason), ahead)

    def _stands_alone(self, found: Tracked, ahead: Prediction, state: TrackingState, seconds: float) -> bool:
        """Whether a pose counts that only surfaces tell, and perhaps a prior."""
        if ahead.is_helped and found.motion.shows_all and self.faults.is_bridged(found, ahead, seconds):
            return True
        is_steady = ahead.is_helped or bool(ahead.last.twist.any())
        if self.faults.suspects(found, seconds, is_alone=not ahead.is_helped, is_steady=is_steady):
            return False
        return state.failures == 0 or (ahead.is_helped and not self.faults.is_off_prior(found))

    def _may_count(self, told: KeypointPose, ahead: Prediction, seconds: float) -> bool:
        """Whether keypoints tell the place: after a while, and alone, the camera may be anywhere that looks alike."""
        return told.is_likely or ahead.is_helped or seconds <= self._settings.anywhere_s

    def _instead(self, grid: GridFrame, failure: MotionEstimate, ahead: Prediction) -> Tracked | MotionEstimate:
        """The pose by keypoints in place of one that surfaces do not tell, or why there is none."""
        told, seconds = ahead.told, ahead.seconds_to(grid.stamp_s)
        if told is None or not self._may_count(told, ahead, seconds):
            return failure
        if not told.is_clear and implausible(ahead.last, told.T_map_camera, seconds, self._all):
            return failure
        if ahead.is_helped and not told.is_clear and not told.agrees_with(ahead.T_map_camera[0]):
            return failure
        return self._taken(grid, told)

    def _taken(self, grid: GridFrame, told: KeypointPose) -> Tracked:
        """The pose by keypoints, as it lies off the nearest keyframe; somebody close by has many of them too."""
        self.faults.unseen_s = 0.0
        nearest = self._views.nearest(told.T_map_camera)
        T_map_camera, T_map_reference = se3.nearest(told.T_map_camera), nearest.reference.T_map_reference
        T_reference_camera = se3.invert(T_map_reference) @ T_map_camera
        doubt, fitting = self._by_regions(grid, nearest.reference, T_reference_camera)
        motion = replace(told.motion_from(T_map_reference), fitting=fitting)
        known = (grid, T_map_camera, told.covariance, motion, nearest.keyframe, grid.twist)
        is_near = nearest.distance_m(told.T_map_camera) < self._all.keyframe_way_m
        return Tracked(*known, overlap=float(is_near), told=told, doubt=doubt)
