"""Verifier: whether keypoints say the same as surfaces, wherever surfaces alone may be wrong."""

from __future__ import annotations

from wheelsight.estimates import MotionEstimate, Reason
from wheelsight.events import RgbdFrame
from wheelsight.geometry import se3
from wheelsight.odometry.dense.fault_detection import FaultDetector
from wheelsight.odometry.dense.grid import GridFrame
from wheelsight.odometry.dense.keypoints import KeypointLocator, KeypointPose
from wheelsight.odometry.dense.locating import Locator
from wheelsight.odometry.dense.prediction import Prediction
from wheelsight.odometry.dense.settings import DenseSettings
from wheelsight.odometry.dense.tracked import Tracked
from wheelsight.odometry.dense.views import Views
from wheelsight.odometry.state import TrackingState
from wheelsight.odometry.stopwatch import Stopwatch


class Verifier:
    """Judges poses found by surfaces.

    Args:
        settings: which poses are suspected, and when keypoints count.
        locator: finds a frame again from where keypoints say.
        keypoints: find a frame by its keypoints.
        views: the keyframes that it may show.
        watch: counts the time of "recognise".

    Attributes:
        faults: which poses are suspected.
    """

    def __init__(
        self, settings: DenseSettings, locator: Locator, keypoints: KeypointLocator, views: Views, watch: Stopwatch
    ) -> None:
        self._settings, self._watch = settings.verification, watch
        self._locator, self._keypoints, self._views = locator, keypoints, views
        self.faults = FaultDetector(settings.faults, settings.max_unseen_s)

    def verify(
        self,
        frame: RgbdFrame,
        grid: GridFrame,
        found: Tracked | MotionEstimate,
        ahead: Prediction,
        state: TrackingState,
    ) -> Tracked | MotionEstimate:
        """A pose by surfaces alone is kept while they show all motion and fit as usual, and without a leap.

        Else, and after a failure or a gap, keypoints must say the same; where they know better, theirs is the pose. A
        prior stands in for what surfaces do not show, and for keypoints after a failure, or a gap that it bridges. Off
        the prior, they are asked too, for people who walk by may carry a pose along; but wheels may slip where no
        keypoint tells anything.
        """
        seconds, is_alone = ahead.seconds_to(grid.stamp_s), not ahead.is_helped
        if isinstance(found, Tracked):
            if is_alone and state.failures == 0:
                self.faults.count(seconds, shows_all=found.motion.shows_all)
            if ahead.is_helped and found.motion.shows_all and self.faults.is_bridged(found, ahead, seconds):
                return found
            is_steady = ahead.is_helped or bool(ahead.last.twist.any())
            is_suspect = self.faults.suspects(found, seconds, is_alone=is_alone, is_steady=is_steady)
            if not is_suspect and ahead.is_helped and self.faults.is_off_prior(found):
                return self._by_keypoints(frame, grid, found, ahead, state, is_needed=state.failures > 0)
            if not is_suspect and (ahead.is_helped or state.failures == 0):
                return found
        return self._by_keypoints(frame, grid, found, ahead, state)

    def _by_keypoints(
        self,
        frame: RgbdFrame,
        grid: GridFrame,
        found: Tracked | MotionEstimate,
        ahead: Prediction,
        state: TrackingState,
        *,
        is_needed: bool = True,
    ) -> Tracked | MotionEstimate:
        """A pose that keypoints agree with: as it was found, found again from where they say, or theirs.

        Unless they are needed, it is kept as well where too few of them tell anything.
        """
        with self._watch.stage("recognise"):
            T_guess = (found if isinstance(found, Tracked) else ahead.last).T_map_camera
            features, familiar = self._keypoints.look(frame), self._views.familiar(T_guess, state)
            told = self._keypoints.locate(features, familiar, grid.twist)
        if not is_needed and (told is None or not told.is_likely):
            return found
        is_anywhere = ahead.seconds_to(grid.stamp_s) > self._settings.anywhere_s and not ahead.is_helped
        if told is None or (is_anywhere and not told.is_likely):
            missing = Reason.DEGENERATE if self.faults.is_blind and not ahead.is_helped else Reason.NOT_RECOGNISED
            return MotionEstimate.failed(missing) if isinstance(found, Tracked) else found
        if not isinstance(found, Tracked) or not told.agrees_with(found.T_map_camera):
            found = self._locator.locate(grid, ahead.at(told.T_map_camera), state)
            if isinstance(found, Tracked) and not told.agrees_with(found.T_map_camera):
                # The rolling shutter bends keypoints by the speed expected; surfaces have corrected it.
                told = self._keypoints.locate(features, familiar, found.twist) or told
        if not (isinstance(found, Tracked) and told.agrees_with(found.T_map_camera)):
            if not told.is_clear:
                return MotionEstimate.failed(Reason.SURFACES_CONTRADICTED, told.matches, told.inliers)
            # Between two frames keypoints err by more than a camera's speed changes.
            found = self._taken(grid, told)
        self.faults.unseen_s = 0.0  # keypoints show all motion
        return found

    def _taken(self, grid: GridFrame, told: KeypointPose) -> Tracked:
        """The pose by keypoints, as it lies off the nearest keyframe."""
        nearest = self._views.nearest(told.T_map_camera)
        motion = told.motion_from(nearest.reference.T_map_reference)
        return Tracked(grid, se3.nearest(told.T_map_camera), told.covariance, motion, nearest.keyframe, grid.twist)
