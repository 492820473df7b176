"""`DenseOdometry` estimates the pose of a camera frame by frame from all pixels and reports when tracking is lost.
`DepthDelay` estimates how much later than colour the camera measures depth.
"""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import check_frame, need_calibration, need_motion, need_twist
from wheelsight.core.estimates import MotionEstimate, Reason
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import FrameSurface, KeyframeStore, ReferenceModel
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.stamps import StampCheck
from wheelsight.core.threads import OneCaller, Rows, one_at_a_time
from wheelsight.vision.dense.alignment import Aligner
from wheelsight.vision.dense.keyframes import EvictedViews, KeyframePolicy
from wheelsight.vision.dense.pyramid import Gridder, GridFrame, ReferenceMaker
from wheelsight.vision.dense.settings import DelaySettings, DenseSettings
from wheelsight.vision.dense.tracking import Locator, Verifier
from wheelsight.vision.dense.views import (
    DenseEstimate,
    KeypointTracker,
    Prediction,
    PriorMotion,
    Tracked,
    Views,
    predict,
)
from wheelsight.vision.features.extraction import Features
from wheelsight.vision.tracking_state import LONGEST_STEP_S, START_VARIANCE, Stopwatch, TrackingState, twist_between


class DenseOdometry(OneCaller):
    """Aligns each frame with a keyframe, with the previous frame, or with the view that a map predicts.

    The first frame with depth starts the map. Each frame passes four steps: predict its pose, align it with known
    views, verify the pose by keypoints, and make it a keyframe if it shows much that is new.

    The prior fills directions of motion that the view does not constrain; the estimate names them. After `lost_after`
    failed frames in a row the state is LOST, until a keyframe is recognised.

    Args:
        calibration: of the cameras.
        settings: default `DenseSettings()`.
        model: predicts the view to align with; default none.
        T_map_first: (4, 4) pose of the camera at the first frame with depth; default the map's origin.
        store: receives keyframes; default a new one. When it moves keyframes, the state of odometry moves with them.

    Attributes:
        store: holds all keyframes and their poses.
        watch: times of the last frame's "prepare", "predict", "align", "recognise" and "keyframe".
    """

    def __init__(
        self,
        calibration: Calibration,
        settings: DenseSettings | None = None,
        model: ReferenceModel | None = None,
        T_map_first: FloatArray | None = None,
        store: KeyframeStore | None = None,
    ) -> None:
        self._calibration, self._settings = need_calibration(calibration), settings or DenseSettings()
        self.store, self.watch = KeyframeStore() if store is None else store, Stopwatch()
        self._follower = self.store.follow()
        rows = Rows(self._settings.threads)
        self._gridder = Gridder(calibration, self._settings, rows)
        self._delay = DepthDelay(calibration.depth_late_s, self._settings.delay)
        self._maker = ReferenceMaker(calibration.depth_noise, self._settings, rows)
        aligner = Aligner(calibration, self._settings, rows, self._gridder, self._maker)
        has_landmarks = model is not None or self._settings.reference == "keyframes"
        keypoints = KeypointTracker(
            calibration,
            self._settings.verification,
            has_landmarks=has_landmarks,
            threads=self._settings.threads,
            fastest=(self._settings.max_speed_m_s, self._settings.max_turn_rad_s),
        )
        self._keypoints = keypoints
        self._views = Views(self._settings, self._gridder, self._maker, self.watch, model)
        self._locator = Locator(calibration, self._settings, aligner, self._views, self.watch)
        self._verifier = Verifier(self._settings, keypoints, self._views, self._locator.by_regions, self.watch)
        evicted = EvictedViews(self.store, self._gridder, self._maker, keypoints, self._settings.kept_keyframes)
        parts = (self._gridder, self._locator, keypoints, self._views, self.store, evicted)
        self._policy = KeyframePolicy(self._settings, *parts)
        self.begin_at(np.eye(4) if T_map_first is None else T_map_first)
        self._state, self._stamps = TrackingState(self._settings.lost_after), StampCheck()
        self._first: tuple[RgbdFrame, Features] | None = None
        self._last: Tracked | None = None

    @property
    def stage_seconds(self) -> dict[str, float]:
        """Seconds the last frame spent in each stage."""
        return self.watch.seconds

    @property
    def intrinsics(self) -> FloatArray:
        """fx, fy, cx, cy (4,) of the ideal camera of frames and predictions."""
        return self._gridder.intrinsics

    def surface(self, tracked: GridFrame, frame: RgbdFrame, with_color: bool = True) -> FrameSurface:
        """The surface that a frame adds to a map; `tracked` is its `DenseEstimate.frame`."""
        finest = tracked.levels[0]
        color = self._gridder.color_on_grid(frame, tracked) if with_color else None
        return FrameSurface(finest.depth_m, self._maker.normals(finest), finest.grey, color)

    @one_at_a_time
    def process(
        self,
        frame: RgbdFrame,
        T_previous_current_prior: FloatArray | None = None,
        T_previous_current_other: FloatArray | None = None,
        *,
        twist: FloatArray | None = None,
    ) -> DenseEstimate:
        """The camera's pose at a frame, T_map_camera, or the reason of the failure.

        Args:
            frame: newer than the previous one.
            T_previous_current_prior: (4, 4) expected motion of the camera since the last tracked frame, for instance
                from wheels; default constant velocity.
            T_previous_current_other: (4, 4) an alternative to the prior, used if it fits clearly better.
            twist: (6,) the camera's present velocity (v, ω) in its own frame, from other sensors. It corrects the
                rolling shutter after a gap, where the mean velocity since the last frame says little.

        Raises:
            ArgumentError: for an invalid frame, motion or velocity.
        """
        check_frame(frame, self._calibration, prior=T_previous_current_prior, other=T_previous_current_other)
        self._stamps.check(frame)
        if twist is not None:
            twist = need_twist(twist)
        self._start_frame()
        last, features = self._last, self._keypoints.look(frame)
        if last is None:
            return self._begin(frame, features, self._T_map_first, START_VARIANCE * np.eye(6), is_first=True)
        prior = PriorMotion(T_previous_current_prior, T_previous_current_other, twist)
        found = self._find(frame, features, last, prior)
        is_blind = not isinstance(found, Tracked) and found.reason is Reason.TOO_LITTLE_DEPTH
        if not (isinstance(found, Tracked) or is_blind or T_previous_current_prior is None):
            # The prior of spinning wheels is wrong: try again without it.
            found = self._find(frame, features, last, replace(prior, T_last_frame=None))
        return self._accept(found) if isinstance(found, Tracked) else self._fail(frame.stamp_s, found)

    @one_at_a_time
    def begin_at(self, T_map_camera: FloatArray) -> None:
        """Set the pose (4, 4) of the camera at the first frame with depth. Raises ArgumentError for no rigid motion."""
        self._T_map_first = need_motion("T_map_first", T_map_camera)

    @one_at_a_time
    def miss(self, stamp_s: float) -> DenseEstimate:
        """Count a frame that is unusable, and so never reached `process`, as a failed one."""
        self._start_frame()
        return self._fail(stamp_s, MotionEstimate.failed(Reason.FRAME_UNUSABLE))

    @one_at_a_time
    def restart(self, frame: RgbdFrame, T_map_camera: FloatArray, covariance: FloatArray) -> DenseEstimate:
        """Restart at a frame with a pose (4, 4) from other sensors, its covariance (6, 6); earlier keyframes stay."""
        check_frame(frame, self._calibration, T_map_camera=T_map_camera, covariance=covariance)
        self._start_frame()
        self._verifier.faults.unseen_s = 0.0
        return self._begin(frame, self._keypoints.look(frame), T_map_camera, covariance)

    @one_at_a_time
    def refer_to(self, model: ReferenceModel | None) -> None:
        """Align later frames with the predictions of a model of this map, or, for None, with keyframes alone."""
        self._views.refer_to(model)

    def _start_frame(self) -> None:
        """Restart the stopwatch, and move the state with keyframes that the store has moved."""
        self.watch.restart()
        T_new_old = self._follower.moves()
        if T_new_old is None:
            return
        self._views.move(T_new_old)
        self._keypoints.move(T_new_old)
        if self._last is not None:
            self._last = self._last.moved(T_new_old[self._last.keyframe])

    def _find(
        self, frame: RgbdFrame, features: Future[Features], last: Tracked, prior: PriorMotion
    ) -> Tracked | MotionEstimate:
        """The frame's pose, predicted from the prior or constant velocity, or the reason of the failure."""
        ahead, twist = predict(last, frame.stamp_s, prior)
        ahead = self._verifier.ask(features.result(), twist, ahead, self._state)
        with self.watch.stage("prepare"):
            grid = self._gridder.on_grid(frame, self._seen_twist(ahead, frame.stamp_s, twist))
        found: Tracked | MotionEstimate = MotionEstimate.failed(Reason.TOO_LITTLE_DEPTH)
        if grid.depth_share >= self._settings.min_depth_share:
            found = self._locator.locate(grid, ahead, self._state)
            if isinstance(found, Tracked) and self._first is not None:
                found, ahead = self._begin_again(found, features.result(), ahead)
        found = self._verifier.verify(grid, found, ahead, self._state)
        if isinstance(found, Tracked):
            with self.watch.stage("keyframe"):
                found = self._policy.update(frame, features.result(), found, ahead)
        return found

    def _seen_twist(self, ahead: Prediction, stamp_s: float, twist: FloatArray) -> FloatArray:
        """The camera's velocity (6,) by keypoints if most of them agree, else the predicted one."""
        seconds = ahead.seconds_to(stamp_s)
        if ahead.keypoint_pose is None or not ahead.keypoint_pose.is_usable or not 0 < seconds <= LONGEST_STEP_S:
            return twist
        return twist_between(ahead.last.T_map_camera, ahead.keypoint_pose.T_map_camera, seconds)

    def _begin(
        self,
        frame: RgbdFrame,
        features: Future[Features],
        T_map_camera: FloatArray,
        covariance: FloatArray,
        *,
        is_first: bool = False,
    ) -> DenseEstimate:
        with self.watch.stage("prepare"):
            grid = self._gridder.on_grid(frame, np.zeros(6))
        if grid.depth_share < self._settings.min_depth_share:
            return self._fail(frame.stamp_s, MotionEstimate.failed(Reason.TOO_LITTLE_DEPTH))
        with self.watch.stage("keyframe"):
            start = self._policy.begin(features.result(), grid, T_map_camera, covariance)
        begun = self._accept(start)
        self._first = (frame, features.result()) if is_first else None
        return begun

    def _begin_again(
        self, found: Tracked, features: Features, ahead: Prediction
    ) -> tuple[Tracked | MotionEstimate, Prediction]:
        """Correct the rolling shutter of the first frame by the speed at the second, and locate the second again."""
        first, self._first = self._first, None
        if first is None or self._last is None or not self._gridder.late_s.any():
            return found, ahead
        self._last = replace(self._last, frame=self._gridder.on_grid(first[0], found.twist), twist=found.twist)
        view = self._policy.begin_again(first[1], self._last)
        ahead = self._verifier.ask(features, found.twist, replace(ahead, last=self._last), self._state)
        return self._locator.by_view(found.frame, view, ahead, [found.T_map_camera]), ahead

    def _accept(self, found: Tracked) -> DenseEstimate:
        # `_begin_again` needs the first frame as the last one, and keypoints alone may have found this one.
        self._first = None
        self._last, self._state = found, self._state.tracked()
        self._verifier.faults.learn(found)
        if found.joint is not None:
            self._locator.weight.learn(found.joint)
            self._delay.learn(found.joint.ahead[3:], found.turning_rad_s)
            self._gridder.depth_late_s = self._delay.seconds
        T_keyframe_camera = se3.invert(self.store.pose(found.keyframe)) @ found.T_map_camera
        return DenseEstimate(
            found.frame.stamp_s,
            self._state.status,
            found.T_map_camera,
            found.covariance,
            matches=found.motion.matches,
            inliers=found.motion.inliers,
            keyframe=found.keyframe,
            T_keyframe_body=T_keyframe_camera,
            motion=found.motion,
            shows_all=self._shows_all,
            frame=found.frame,
        )

    def _fail(self, stamp_s: float, failure: MotionEstimate) -> DenseEstimate:
        self._state = self._state.failed()
        if self._last is not None:
            self._last = replace(self._last, twist=np.zeros(6))
        return DenseEstimate(
            stamp_s,
            self._state.status,
            reason=failure.reason,
            matches=failure.matches,
            inliers=failure.inliers,
            motion=failure,
            shows_all=self._shows_all,
        )

    @property
    def _shows_all(self) -> bool:
        """Whether the last frames constrained every direction of motion; else part of the pose is a prediction."""
        return self._verifier.faults.unseen_s == 0


class DepthDelay:
    """Estimates the constant delay of depth behind colour, beyond their stamps, by a Kalman filter with one state.

    In a turn, surfaces in depth lag behind keypoints in colour, so each turning frame measures the delay. The two
    sensors of a Kinect are not synchronised, and depth is stamped after it is computed. At 150 degrees per second
    20 ms are 3 degrees.

    Args:
        seconds: the delay by calibration.
        settings: its standard deviation, and the noise of a measurement.
    """

    def __init__(self, seconds: float, settings: DelaySettings) -> None:
        self._settings = settings
        self._expected_s = self._estimate_s = seconds
        self._variance = settings.sigma_s**2

    @property
    def seconds(self) -> float:
        """The delay: the estimate if it differs clearly from the calibration, else the calibration's."""
        is_clear = abs(self._estimate_s - self._expected_s) > self._settings.clear_sigmas * self._variance**0.5
        return self._estimate_s if is_clear else self._expected_s

    def learn(self, ahead_rad: FloatArray, turning_rad_s: FloatArray) -> None:
        """Update the estimate by one frame.

        Args:
            ahead_rad: (3,) rotation by keypoints beyond that by surfaces, in the reference's frame.
            turning_rad_s: (3,) angular velocity at the frame minus that at its reference, in the same frame.
        """
        limits = self._settings
        squared = float(turning_rad_s @ turning_rad_s)
        if squared < limits.least_rad_s**2 or np.linalg.norm(ahead_rad) > limits.most_rad:
            return
        self._variance += limits.walk_s**2
        # Frames are corrected by the delay in use, so the measurement is the remainder.
        measured = self.seconds - float(turning_rad_s @ ahead_rad) / squared - self._estimate_s
        variance = limits.turn_sigma_rad**2 / squared
        gain = self._variance / (self._variance + variance)
        self._estimate_s = float(np.clip(self._estimate_s + gain * measured, -limits.most_s, limits.most_s))
        self._variance *= 1 - gain
