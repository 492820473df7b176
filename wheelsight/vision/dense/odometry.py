"""`DenseOdometry` estimates the pose of a camera frame by frame from all pixels, and reports when tracking is lost.

`KeyframePolicy` decides which frames become keyframes. `Verifier` checks a pose by keypoints where the alignment may be
wrong. `EvictedViews` returns keyframes when the camera comes back, `Vignetting` estimates the vignetting of the lens,
and `DepthDelay` how much later than colour the camera measures depth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import check_frame, need_twist
from wheelsight.core.errors import MapError
from wheelsight.core.estimates import (
    MotionEstimate,
    Reason,
    TrackingState,
)
from wheelsight.core.geometry import BoolArray, FloatArray, PinholeCamera, se3, so3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.keyframes import (
    FrameSurface,
    Keyframe,
    KeyframeId,
    KeyframeStore,
    ReferenceModel,
)
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.threads import Stopwatch, one_at_a_time
from wheelsight.vision.dense.alignment import (
    SECOND,
    Aligner,
    Gridder,
    GridFrame,
    Reference,
    ReferenceMaker,
    vignetting_of,
)
from wheelsight.vision.dense.settings import DenseSettings
from wheelsight.vision.dense.tracking import (
    DenseEstimate,
    KeypointPose,
    KeypointTracker,
    KnownView,
    Locator,
    Prediction,
    PriorMotion,
    Tracked,
    ViewCache,
    implausible,
    predict,
)
from wheelsight.vision.features.tracking import (
    LONGEST_STEP_S,
    Features,
)
from wheelsight.vision.image_kernels import ALONG_U, ALONG_V, DEPTH, GREY
from wheelsight.vision.visual_odometry import START_VARIANCE, CameraOdometry

_MIN_DEPTH_SHARE = 0.05  # share of a frame's pixels that must have depth


class DenseOdometry(CameraOdometry[DenseEstimate]):
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
        watch: times of the last frame's "extract", "prepare", "predict", "align", "recognise" and "keyframe".
    """

    def __init__(
        self,
        calibration: Calibration,
        settings: DenseSettings | None = None,
        model: ReferenceModel | None = None,
        T_map_first: FloatArray | None = None,
        store: KeyframeStore | None = None,
    ) -> None:
        self._settings = settings or DenseSettings()
        super().__init__(calibration, DenseEstimate, self._settings.lost_after, T_map_first, store)
        self._follower = self.store.follow()
        self._gridder = Gridder(calibration, self._settings)
        self._delay = DepthDelay(calibration.depth_late_s)
        self._maker = ReferenceMaker(calibration.depth_noise)
        aligner = Aligner(calibration, self._settings, self._gridder, self._maker)
        has_landmarks = model is not None or self._settings.reference == "keyframes"
        keypoints = KeypointTracker(
            calibration,
            has_landmarks=has_landmarks,
            fastest=(self._settings.max_speed_m_s, self._settings.max_turn_rad_s),
        )
        self._keypoints = keypoints
        self._views = ViewCache(self._settings, self._gridder, self._maker, self.watch, model)
        self._locator = Locator(calibration, self._settings, aligner, self._views, self.watch)
        self._verifier = Verifier(self._settings, keypoints, self._views, self._locator.by_regions, self.watch)
        evicted = EvictedViews(self.store, self._gridder, self._maker, keypoints, self._settings.kept_keyframes)
        parts = (self._gridder, self._locator, keypoints, self._views, self.store, evicted)
        self._policy = KeyframePolicy(self._settings, *parts)
        self._first: tuple[RgbdFrame, Features] | None = None
        self._last: Tracked | None = None

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
        if type(frame) not in self._stamps.settled:
            self._stamps.check(frame)
        if twist is not None:
            twist = need_twist(twist)
        self._start_frame()
        last, features = self._last, self._extracted(frame)
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
    def restart(self, frame: RgbdFrame, T_map_camera: FloatArray, covariance: FloatArray) -> DenseEstimate:
        """Restart at a frame with a pose (4, 4) from other sensors, its covariance (6, 6); earlier keyframes stay."""
        check_frame(frame, self._calibration, T_map_camera=T_map_camera, covariance=covariance)
        self._start_frame()
        self._verifier.faults.unseen_s = 0.0
        return self._begin(frame, self._extracted(frame), T_map_camera, covariance)

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

    def _extracted(self, frame: RgbdFrame) -> Features:
        with self.watch.stage("extract"):
            return self._keypoints.extract(frame)

    def _find(
        self, frame: RgbdFrame, features: Features, last: Tracked, prior: PriorMotion
    ) -> Tracked | MotionEstimate:
        """The frame's pose, predicted from the prior or constant velocity, or the reason of the failure."""
        ahead, twist = predict(last, frame.stamp_s, prior)
        ahead = self._verifier.ask(features, twist, ahead, self._state)
        pose, seen_twist = ahead.keypoint_pose, twist
        if pose is not None and pose.is_usable and 0 < ahead.seconds <= LONGEST_STEP_S:
            seen_twist = se3.twist_between(ahead.last.T_map_camera, pose.T_map_camera, ahead.seconds)
        with self.watch.stage("prepare"):
            grid = self._gridder.on_grid(frame, seen_twist)
        found: Tracked | MotionEstimate = MotionEstimate.failed(Reason.TOO_LITTLE_DEPTH)
        with self.watch.stage("verify"):
            if grid.depth_share >= _MIN_DEPTH_SHARE:
                found = self._locator.locate(grid, ahead, self._state)
                if isinstance(found, Tracked) and self._first is not None:
                    found, ahead = self._begin_again(found, features, ahead)
            found = self._verifier.verify(grid, found, ahead, self._state)
        if isinstance(found, Tracked):
            with self.watch.stage("keyframe"):
                found = self._policy.update(frame, features, found, ahead)
        return found

    def _begin(
        self,
        frame: RgbdFrame,
        features: Features,
        T_map_camera: FloatArray,
        covariance: FloatArray,
        *,
        is_first: bool = False,
    ) -> DenseEstimate:
        with self.watch.stage("prepare"):
            grid = self._gridder.on_grid(frame, np.zeros(6))
        if grid.depth_share < _MIN_DEPTH_SHARE:
            return self._fail(frame.stamp_s, MotionEstimate.failed(Reason.TOO_LITTLE_DEPTH))
        with self.watch.stage("keyframe"):
            start = self._policy.begin(features, grid, T_map_camera, covariance)
        begun = self._accept(start)
        self._first = (frame, features) if is_first else None
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
            relocation=found.relocation,
        )

    def _fail(self, stamp_s: float, failure: MotionEstimate, **more: Any) -> DenseEstimate:
        if self._last is not None:
            self._last = replace(self._last, twist=np.zeros(6))
        return super()._fail(stamp_s, failure, shows_all=self._shows_all, **more)

    @property
    def _shows_all(self) -> bool:
        """Whether the last frames constrained every direction of motion; else part of the pose is a prediction."""
        return self._verifier.faults.unseen_s == 0


# Share of the covariance of a motion to the last keyframe relative to that to the one before, and their largest
# difference: χ² of 6, 99.9 %. Within it, the difference between two keyframes is drift.
_SHORT_MOTIONS, _JOINED_CHI2 = 2.0, 22.5
# Error of rows in pixels above which the rolling shutter is corrected again, of keyframes and of other frames, where it
# costs 2 ms; chosen.
_KEPT_STRAIGHT_PX, _STRAIGHT_PX = 0.3, 1.0
# Number of recent keyframes; older ones return if a loop closure ties one of these to another visit. The newest is not
# verified yet, and not every one is recognised. Chosen.
_TIED_VIEWS = 5


class KeyframePolicy:
    """Makes keyframes of frames that show much that is new.

    Args:
        settings: of dense odometry.
        gridder: corrects the rolling shutter of frames.
        locator: aligns a frame with another keyframe.
        keypoints: holds the landmarks of keyframes.
        views: the cache of keyframes.
        store: holds all keyframes and their poses.
        evicted: keyframes that left the cache.
    """

    def __init__(
        self,
        settings: DenseSettings,
        gridder: Gridder,
        locator: Locator,
        keypoints: KeypointTracker,
        views: ViewCache,
        store: KeyframeStore,
        evicted: EvictedViews,
    ) -> None:
        self._settings, self._gridder, self._store = settings, gridder, store
        self._locator, self._keypoints, self._views, self._evicted = locator, keypoints, views, evicted
        self.vignetting = Vignetting(gridder)

    def begin(self, features: Features, grid: GridFrame, T_map_camera: FloatArray, covariance: FloatArray) -> Tracked:
        """Start, or restart, with a keyframe at a pose (4, 4) with its covariance (6, 6)."""
        motion = MotionEstimate(np.eye(4), START_VARIANCE * np.eye(6))
        start = Tracked(grid, T_map_camera, covariance, motion, KeyframeId(-1))
        start, view = self._stored(start, features)
        self._views.drop_prediction()
        self._keep(view)
        return start

    def begin_again(self, features: Features, first: Tracked) -> KnownView:
        """Replace the first keyframe by the same frame with its rolling shutter corrected."""
        self._keypoints.forget()
        self._keypoints.remember(first, features)
        features = self._keypoints.straightened(features, first.twist)
        self._store.replace(first.keyframe, partial(self._kept, first.frame, features))
        view = replace(self._views.of_frame(first), features=features)
        self._views.keyframes[:] = [view]
        return view

    def update(self, frame: RgbdFrame, features: Features, found: Tracked, ahead: Prediction) -> Tracked:
        """Update landmarks by a frame, and make it a keyframe if it shows much that the last one did not.

        Returns the frame with its rolling shutter corrected by the estimated speed.
        """
        if self._settings.reference == "previous" and not self._views.has_model:
            return self._replace_view(frame, features, found)
        if not self._views.lack(found, is_helped=ahead.is_helped):
            return self._remembered(self._straightened(frame, found, is_kept=False), features)
        seen = self._revisited(found, ahead)
        if seen is not None:
            return self._remembered(replace(seen, keypoint_pose=found.keypoint_pose), features)
        straight = self._straightened(frame, self._refined(found, ahead))
        self.vignetting.learn(straight.frame, straight.T_map_camera, self._views.keyframes[-1].reference)
        straight, view = self._stored(straight, features)
        self._keep(view)
        return straight

    def _remembered(self, tracked: Tracked, features: Features) -> Tracked:
        tracked = tracked.with_pose_error()
        self._keypoints.remember(tracked, features)
        return tracked

    def _replace_view(self, frame: RgbdFrame, features: Features, found: Tracked) -> Tracked:
        """Make the frame the only known view, and a keyframe of the store if the last one there is far."""
        straight = self._straightened(frame, found).with_pose_error()
        T_keyframe_camera = se3.invert(self._store.pose(found.keyframe)) @ straight.T_map_camera
        if float(se3.view_shift_m(T_keyframe_camera)) > self._settings.keyframe_way_m:
            straight, view = self._stored(straight, features)
        else:
            straightened = self._keypoints.straightened(features, straight.twist)
            view = replace(self._views.of_frame(straight), features=straightened)
            self._keypoints.remember(straight, features)
        self._views.keyframes[:] = [view]
        return straight

    def _revisited(self, found: Tracked, ahead: Prediction) -> Tracked | None:
        """The frame located by a nearer, older keyframe with enough overlap, which ends the drift; else None."""
        if self._views.has_model:
            return None
        here, nearest = ahead.at(found.T_map_camera), self._views.nearest(found.T_map_camera)
        evicted, newest = None, self._views.keyframes[-_TIED_VIEWS:]
        if any(self._evicted.is_tied(view.keyframe) for view in newest):  # a loop ties it to older ones
            evicted = self._evicted.nearer(found.T_map_camera, nearest.distance_m(found.T_map_camera))
        for view in (evicted, nearest):
            if view is None or view is self._views.keyframes[-1]:
                continue
            seen = self._locator.by_view(found.frame, view, here, here.T_map_camera)
            if isinstance(seen, Tracked) and seen.overlap > self._settings.keyframe_overlap:
                self._keep(view)
                T = seen.T_map_camera @ se3.invert(found.T_map_camera)
                is_drift = _innovation(se3.log(T), found.covariance + seen.covariance) is not None
                return replace(seen, relocation=T if is_drift else None)
        return None

    def _keep(self, view: KnownView) -> None:
        """Mark a view as the most recently used keyframe."""
        self._evicted.take(view)
        for evicted in self._views.keep(view):
            self._evicted.put(evicted)

    def _refined(self, found: Tracked, ahead: Prediction) -> Tracked:
        """The frame located by the last two keyframes together; without a map, this reduces drift."""
        before = self._views.keyframes[-2:-1]
        if not before or self._views.has_model or not found.is_by_keyframe:
            return found
        here = ahead.at(found.T_map_camera)
        seen = self._locator.by_view(found.frame, before[0], here, here.T_map_camera)
        if not isinstance(seen, Tracked):
            return found
        poses = (found.T_map_camera, found.motion, seen.T_map_camera, seen.motion)
        return replace(found, T_map_camera=joined(*poses, self._locator.of_frame))

    def _straightened(self, frame: RgbdFrame, found: Tracked, *, is_kept: bool = True) -> Tracked:
        """The frame with its rolling shutter corrected by the estimated speed instead of the predicted one."""
        wrong = np.abs(found.twist - found.frame.twist)[3:].max() * np.abs(self._gridder.late_s).max()
        if wrong * self._gridder.intrinsics[0] < (_KEPT_STRAIGHT_PX if is_kept else _STRAIGHT_PX):
            return found
        return replace(found, frame=self._gridder.on_grid(frame, found.twist))

    def _stored(self, tracked: Tracked, features: Features) -> tuple[Tracked, KnownView]:
        """Add a frame to the store as a keyframe, and return it with its view."""
        tracked = tracked.with_pose_error()
        straight = self._keypoints.straightened(features, tracked.twist)
        number = self._store.add(partial(self._kept, tracked.frame, straight), tracked.T_map_camera)
        tracked = replace(tracked, keyframe=number)
        self._keypoints.remember(tracked, features)
        return tracked, replace(self._views.of_frame(tracked), features=straight)

    def _kept(self, grid: GridFrame, features: Features) -> Keyframe:
        finest = grid.levels[0]
        images = (grid.stamp_s, finest.intrinsics, finest.depth_m, finest.grey)
        return Keyframe.of_images(*images, self._keypoints.kept(features))


def joined(
    T_map_short: FloatArray,
    short: MotionEstimate,
    T_map_long: FloatArray,
    long: MotionEstimate,
    shared: FloatArray,
) -> FloatArray:
    """T_map_camera (4, 4) by the motions against the last two keyframes, weighted by their covariances.

    It is the pose by the last keyframe if both contradict each other, or if one is degenerate. The covariance of the
    short motion counts `_SHORT_MOTIONS` times, because the pose of its keyframe relative to the other one has the same
    error. `shared` (6, 6) is the covariance of the error common to both, as a right perturbation; it is subtracted.
    """
    if not (short.shows_all and long.shows_all):
        return T_map_short
    C_short, C_long = _SHORT_MOTIONS * (_right_covariance(short) - shared), _right_covariance(long) - shared
    innovation = _innovation(se3.log(se3.invert(T_map_short) @ T_map_long), C_short + C_long)
    if innovation is None:
        return T_map_short
    return np.asarray(se3.nearest(T_map_short @ se3.exp(C_short @ innovation)))


def _innovation(off: FloatArray, covariance: FloatArray) -> FloatArray | None:
    """C⁻¹ off (6,) of the difference of two poses; None where they contradict each other, or where C is singular."""
    C = np.ascontiguousarray(covariance)
    if not (np.isfinite(C).all() and motions.is_definite(C)):  # singular up to rounding
        return None
    innovation = np.asarray(np.linalg.solve(C, off), float)
    return innovation if off @ innovation < _JOINED_CHI2 else None


def _right_covariance(motion: MotionEstimate) -> FloatArray:
    """Covariance (6, 6) of a motion's right perturbation, in the frame of the moved camera."""
    assert motion.T_reference_current is not None
    assert motion.covariance is not None
    return np.asarray(motions.carried(motions.inverse(motion.T_reference_current), motion.covariance))


# Time in seconds without a pose and prior after which the camera may be anywhere, so that a pose must be likely; after
# one second less suffices to recognise the right place in a corridor (simulator: docs/decisions/features.md).
_ANYWHERE_S = 2.0


class Verifier:
    """Estimates the pose of a frame by its keypoints, and decides between that and the pose by surfaces.

    Args:
        settings: thresholds of fault detection, and of agreement with keypoints.
        keypoints: estimates the pose of a frame by its keypoints.
        views: keyframes that the frame may show.
        by_regions: the pose error by regions: see `Locator.by_regions`.
        watch: counts the time of "recognise".

    Attributes:
        faults: decides which poses need verification.
    """

    def __init__(
        self,
        settings: DenseSettings,
        keypoints: KeypointTracker,
        views: ViewCache,
        by_regions: Callable[..., tuple[FloatArray, float | None]],
        watch: Stopwatch,
    ) -> None:
        self._settings, self._watch = settings, watch
        self._keypoints, self._views, self._by_regions = keypoints, views, by_regions
        self.faults = FaultDetector(settings.max_unseen_s)

    def ask(self, features: Features, twist: FloatArray, ahead: Prediction, state: TrackingState) -> Prediction:
        """The prediction with the pose by keypoints, against the previous frame or against known keyframes."""
        with self._watch.stage("recognise"):
            pose = self._plausible(self._keypoints.track(features, twist), ahead)
            if pose is not None and (state.failures == 0 or pose.is_likely):
                return replace(ahead, keypoint_pose=pose)
            candidates = self._views.candidates(ahead.T_map_camera[0], state)
            seen_again = self._keypoints.recognise(features, candidates, twist)
            seen_again = self._plausible(seen_again, ahead)
        if seen_again is None:
            return replace(ahead, keypoint_pose=pose)
        is_elsewhere = not ahead.is_helped and not seen_again.agrees_with(ahead.T_map_camera[0])
        return replace(ahead.at(seen_again.T_map_camera) if is_elsewhere else ahead, keypoint_pose=seen_again)

    def _plausible(self, pose: KeypointPose | None, ahead: Prediction) -> KeypointPose | None:
        """The pose by keypoints; None if it exceeds the limit on turning, however well keypoints agree.

        A repeated texture may look the same upside down. A leap of the position is allowed: it corrects surfaces that
        slid along a wall before.
        """
        if pose is None or ahead.seconds <= 0:
            return pose
        R_last_now = ahead.last.T_map_camera[:3, :3].T @ pose.T_map_camera[:3, :3]
        return pose if so3.angle(R_last_now) <= self._settings.max_turn_rad_s * ahead.seconds else None

    def verify(
        self, grid: GridFrame, found: Tracked | MotionEstimate, ahead: Prediction, state: TrackingState
    ) -> Tracked | MotionEstimate:
        """The verified pose, or the reason why none is accepted.

        It is the pose by surfaces if keypoints agree, and the one by keypoints if these contradict it clearly. Without
        keypoints the pose by surfaces stands while it fits as usual, constrains all directions and makes no leap. A
        prior replaces directions that surfaces do not constrain.
        """
        pose, seconds = ahead.keypoint_pose, ahead.seconds
        if not isinstance(found, Tracked):
            return self._fall_back(grid, found, ahead)
        if not ahead.is_helped and state.failures == 0:
            self.faults.count(seconds, shows_all=found.motion.shows_all)
        if pose is not None and pose.agrees_with(found.T_map_camera) and self._is_unambiguous(pose, ahead):
            self.faults.unseen_s = 0.0  # keypoints show all motion
            return replace(found, keypoint_pose=pose)
        if pose is not None and pose.is_clear:
            return self._by_keypoints(grid, pose, is_helped=ahead.is_helped)
        is_steady = ahead.is_helped or bool(ahead.last.twist.any())
        suspected = self.faults.suspects(found, seconds, is_alone=not ahead.is_helped, is_steady=is_steady)
        if not suspected and (state.failures == 0 or (ahead.is_helped and not self.faults.is_off_prior(found))):
            return found  # by surfaces alone, or by surfaces and a prior
        unseen = self.faults.is_blind and not ahead.is_helped
        if pose is not None and self._is_unambiguous(pose, ahead):
            reason = Reason.SURFACES_CONTRADICTED
        else:
            reason = Reason.DEGENERATE if unseen else Reason.NOT_RECOGNISED
        return self._fall_back(grid, MotionEstimate.failed(reason), ahead)

    def _is_unambiguous(self, pose: KeypointPose, ahead: Prediction) -> bool:
        """Whether keypoints identify the place: after a gap without prior the camera may be at one that looks alike."""
        return pose.is_likely or ahead.is_helped or ahead.seconds <= _ANYWHERE_S

    def _fall_back(self, grid: GridFrame, failure: MotionEstimate, ahead: Prediction) -> Tracked | MotionEstimate:
        """The pose by keypoints, or `failure` if that is not accepted either."""
        pose = ahead.keypoint_pose
        if pose is None or not self._is_unambiguous(pose, ahead):
            return failure
        if not pose.is_clear and implausible(ahead.last, pose.T_map_camera, ahead.seconds, self._settings):
            return failure
        if ahead.is_helped and not pose.is_clear and not pose.agrees_with(ahead.T_map_camera[0]):
            return failure
        return self._by_keypoints(grid, pose, is_helped=ahead.is_helped)

    def _by_keypoints(self, grid: GridFrame, pose: KeypointPose, *, is_helped: bool) -> Tracked:
        """The pose by keypoints, relative to the nearest keyframe and with the pose error by regions."""
        self.faults.unseen_s = 0.0
        nearest = self._views.nearest(pose.T_map_camera)
        T_map_camera, T_map_reference = se3.nearest(pose.T_map_camera), nearest.reference.T_map_reference
        T_reference_camera = se3.invert(T_map_reference) @ T_map_camera
        frame_error, fitting = self._by_regions(grid, nearest.reference, T_reference_camera, is_helped=is_helped)
        motion = replace(pose.motion_from(T_map_reference), fitting=fitting)
        known = (grid, T_map_camera, pose.covariance, motion, nearest.keyframe, grid.twist)
        is_near = nearest.distance_m(pose.T_map_camera) < self._settings.keyframe_way_m
        return Tracked(*known, overlap=float(is_near), keypoint_pose=pose, frame_error=frame_error)


# The mean residual of a perfect fit, in standard deviations of the sensor.
_PERFECT_FIT = 1.0
# Change of speed (m/s, rad/s) at once beyond which a pose is a leap, and its growth per second since the last frame;
# hand-held cameras change less. Chosen.
_LEAP, _LEAP_PER_S = (0.5, 1.5), (10.0, 30.0)
# Difference of speed (m/s, rad/s) from a prior by other sensors beyond which one of both is wrong: wheels without slip
# err by a tenth and a quarter of it (simulator: docs/decisions/features.md).
_OFF_PRIOR = np.array([0.2, 0.2])
# Without prior, a residual this many times the usual one needs verification: wrong poses had 4 to 5 times in eight
# simulated flats. On a real hand-held recording as much is usual, and learned (docs/decisions/features.md).
_POOR_FIT = 2.0
# Share of a frame's residual that updates the usual one; chosen.
_FIT_LEARNED = 0.1


class FaultDetector:
    """Decides which poses by surfaces need verification by keypoints.

    Args:
        max_unseen_s: how long a direction of motion may stay unconstrained.

    Attributes:
        unseen_s: how long some direction of motion has been unconstrained.
    """

    def __init__(self, max_unseen_s: float) -> None:
        self._max_unseen_s, self._usual, self.unseen_s = max_unseen_s, _PERFECT_FIT, 0.0

    @property
    def is_blind(self) -> bool:
        """Whether a direction of motion has been unconstrained for more than `max_unseen_s`."""
        return self.unseen_s > self._max_unseen_s

    def count(self, seconds: float, *, shows_all: bool) -> None:
        """Update `unseen_s` by a frame. One that constrains all directions counts half, because noise does so too."""
        self.unseen_s = max(self.unseen_s - 0.5 * seconds, 0.0) if shows_all else self.unseen_s + seconds

    def learn(self, found: Tracked) -> None:
        """Update the usual residual by an accepted pose."""
        better = min(found.residual, _POOR_FIT * self._usual)
        self._usual = max(self._usual + _FIT_LEARNED * (better - self._usual), _PERFECT_FIT)

    def fits(self, found: Tracked) -> bool:
        """Whether the residual of surfaces is about as usual."""
        return found.residual <= _POOR_FIT * self._usual

    def suspects(self, found: Tracked, seconds: float, *, is_alone: bool, is_steady: bool) -> bool:
        """Whether a pose needs verification by keypoints.

        Args:
            found: the pose.
            seconds: since the previous one.
            is_alone: whether there is no prior, which would replace directions that surfaces do not constrain.
            is_steady: whether the previous speed is known, so that a leap can be detected.
        """
        if seconds > LONGEST_STEP_S or (is_alone and (self.is_blind or not self.fits(found))):
            return True
        limits = np.array(_LEAP) + np.array(_LEAP_PER_S) * seconds  # beyond, no real camera moves
        return is_steady and bool((_speed_change(found) > limits).any())

    def is_off_prior(self, found: Tracked) -> bool:
        """Whether a pose lies so far from the prior that one of both is wrong."""
        return bool((_speed_change(found) > _OFF_PRIOR).any())


def _speed_change(found: Tracked) -> FloatArray:
    """The change (2,) of speed and angular speed, m/s and rad/s, between prediction and pose."""
    change = found.twist - found.frame.twist
    return np.array([np.linalg.norm(change[:3]), np.linalg.norm(change[3:])])


@dataclass(frozen=True, slots=True, eq=False)
class _EvictedView:
    """The attributes of a view that the store does not hold, about 0.5 kB.

    Attributes:
        covariance: (6, 6) of the right perturbation of its pose, which is invariant to motions of the map.
        turning_rad_s, vignetting: see `KnownView` and `Reference`.
    """

    covariance: FloatArray
    turning_rad_s: FloatArray
    vignetting: float


class EvictedViews:
    """Keyframes that left the cache, and return from the store when the camera comes back.

    Only those return that loop closures tie to keyframes of another visit. The poses of the others drift by odometry
    alone, and loop closures need new keyframes to correct that.

    Args:
        store: holds the keyframes and their poses.
        gridder, maker, keypoints: compute views of them.
        room: size of the cache; keyframes at least this many apart belong to different visits.
    """

    def __init__(
        self, store: KeyframeStore, gridder: Gridder, maker: ReferenceMaker, keypoints: KeypointTracker, room: int
    ) -> None:
        self._store, self._gridder, self._maker, self._keypoints = store, gridder, maker, keypoints
        self._room = room
        self._views: dict[KeyframeId, _EvictedView] = {}

    def __len__(self) -> int:
        return len(self._views)

    def put(self, view: KnownView) -> None:
        """Add a view that left the cache; it is a keyframe of the store."""
        Ad = se3.adjoint(se3.invert(view.reference.T_map_reference))
        covariance = Ad @ view.covariance @ Ad.T
        self._views[view.keyframe] = _EvictedView(covariance, view.turning_rad_s, view.reference.vignetting)

    def nearer(self, T_map_camera: FloatArray, limit_m: float) -> KnownView | None:
        """The nearest tied keyframe within `limit_m` of a pose (4, 4), where a rotation by a radian counts as 1.5 m.

        None if there is none, if the store cannot read it, or if its size differs from that of frames. It stays here
        until `take`.
        """
        numbers = [number for number in self._views if self.is_tied(number)]
        if not numbers:
            return None
        apart_m = se3.view_shift_m(se3.invert(self._store.T_map_keyframe[numbers]) @ T_map_camera)
        nearest = int(np.argmin(apart_m))
        if not apart_m[nearest] < limit_m:
            return None
        number = numbers[nearest]
        try:
            keyframe = self._store.as_of(number, KeyframeId(len(self._store) - 1))
        except MapError:  # the file is missing or damaged; odometry continues without it
            return None
        evicted, T_map_keyframe = self._views[number], self._store.pose(number)
        depth_m, grey = keyframe.depth_m, keyframe.grey
        if depth_m.shape != self._gridder.shape:
            return None
        grey[grey == 0] = -1  # keyframes store unknown grey as 0
        levels = self._gridder.pyramid(depth_m, grey)
        grid = GridFrame(keyframe.stamp_s, levels, np.zeros(6), evicted.vignetting)
        reference, Ad = self._maker.of_frame(grid, T_map_keyframe), se3.adjoint(T_map_keyframe)
        features = None if keyframe.features is None else self._keypoints.recalled(keyframe.stamp_s, keyframe.features)
        return KnownView(number, reference, Ad @ evicted.covariance @ Ad.T, features, evicted.turning_rad_s)

    def is_tied(self, number: KeyframeId) -> bool:
        """Whether a loop closure ties a keyframe to one of another visit."""
        return self._store.loop_span(number) >= self._room

    def take(self, view: KnownView) -> None:
        """Remove a view that is in the cache again."""
        self._views.pop(view.keyframe, None)


# Stride, in pixels, of the points compared for vignetting.
_STRIDE_PX = 2
# Iteratively reweighted least squares: Huber's limit in standard deviations, and the number of iterations.
_HUBER, _ROUNDS = 1.5, 3
# Least variance of vignetting over the compared points, so that the slope stays finite.
_FLAT = 1e-9
# Standard deviation of the exponent before the first pair of views: it is 0.22 for the simulated camera, 0.10 and 0.06
# for two real ones (docs/decisions/dense-alignment.md). No lens exceeds cos⁴.
_EXPONENT_SIGMA, _MOST_EXPONENT = 0.3, 1.0
# Standard deviation of a point's log grey between views, number of neighbouring pixels with the same error, and fewest
# pixels for an update; chosen.
_UNEVEN, _ALIKE_PIXELS, _MIN_PIXELS = 0.01, 20.0, 300
_DARKEST_GREY, _BRIGHTEST_GREY = 20.0, 235.0  # beyond, grey is noise or saturated
# Points of one surface are nearer than this, in metres and per metre of depth, and plain below this grey gradient;
# chosen.
_SAME_SURFACE, _PLAIN_GRADIENT = 0.06, 3.0


class Vignetting:
    """Estimates the vignetting of one camera from plain surfaces at two image positions, and corrects later frames.

    A wall seen ahead, and later at the image border, looks darker there, and the keyframe then seems tilted. Lenses
    darken about as cos⁴ of the angle to the axis; gamma reduces its exponent in grey values. The estimate is this
    exponent, updated by pairs of views.

    Args:
        gridder: makes the frames.

    Attributes:
        exponent: of cos⁴, in grey values; 0 for an even image.
    """

    def __init__(self, gridder: Gridder) -> None:
        self._gridder, self.exponent, self._variance = gridder, 0.0, _EXPONENT_SIGMA**2

    def learn(self, frame: GridFrame, T_map_camera: FloatArray, reference: Reference) -> None:
        """Update the estimate by plain surfaces that a frame at a pose (4, 4) and an earlier reference both show."""
        here, there, known = self._pairs(frame, reference, se3.invert(reference.T_map_reference) @ T_map_camera)
        if np.count_nonzero(known) < _MIN_PIXELS:
            return
        (grey, dark), (grey_then, dark_then) = here[:, known], there[:, known]
        # Undo the correction of each view, which used the estimate at its time.
        brighter = np.log(grey / grey_then) + frame.vignetting * dark - reference.vignetting * dark_then
        information, pull = self._slope(dark - dark_then, brighter)
        total = 1 / self._variance + information
        self.exponent = float(np.clip((self.exponent / self._variance + pull) / total, 0.0, _MOST_EXPONENT))
        self._variance = 1 / total
        self._gridder.even(self.exponent)

    def _pairs(self, frame: GridFrame, reference: Reference, T: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Grey and vignetting (2, N) of points in frame and in reference, and a mask (N,) of plain surfaces."""
        level, pixels = frame.levels[SECOND], reference.scales.levels[SECOND].pixels
        (h, w), some = level.depth_m.shape, (slice(None, None, _STRIDE_PX),) * 2
        camera = PinholeCamera(w, h, *level.intrinsics.tolist())
        px = np.stack([index[some].ravel() for index in np.mgrid[:h, :w][::-1]], axis=-1)
        z, grey = level.depth_m[some].ravel(), level.grey[some].ravel()
        p_then = se3.apply(T, camera.back_project(px, z))
        px_then, is_inside = camera.project(p_then)
        column, row = np.where(is_inside[:, None], np.rint(px_then), 0).astype(int).T
        met = pixels[row, column]
        is_one = np.abs(met[:, DEPTH] - p_then[:, 2]) < _SAME_SURFACE * (1 + p_then[:, 2])
        is_plain = met[:, ALONG_U] ** 2 + met[:, ALONG_V] ** 2 < _PLAIN_GRADIENT**2
        known = (z > 0) & is_inside & is_one & is_plain
        for seen in (grey, met[:, GREY]):
            known &= (seen > _DARKEST_GREY) & (seen < _BRIGHTEST_GREY)
        dark, dark_then = (vignetting_of((camera.normalise(seen) ** 2).sum(axis=-1)) for seen in (px, px_then))
        return np.stack([grey, dark]), np.stack([met[:, GREY], dark_then]), known

    def _slope(self, x: FloatArray, y: FloatArray) -> tuple[float, float]:
        """The information on the slope of y (N,) over x (N,) by Huber's weights, and that information times the slope.

        The offset is free. Both are 0 if x is constant.
        """
        weight = np.ones(len(x))
        for _ in range(_ROUNDS):
            total = weight.sum()
            dx, dy = x - weight @ x / total, y - weight @ y / total
            spread, common = weight @ dx**2 / total, weight @ (dx * dy) / total
            off = np.abs(dy - common / max(spread, _FLAT) * dx)
            sigma = max(1.4826 * float(np.median(off)), 1e-6)
            weight = _HUBER / np.maximum(off / sigma, _HUBER)
        variance = sigma**2 * _ALIKE_PIXELS / len(x) + _UNEVEN**2
        return float(spread / variance), float(common / variance)


# Standard deviations of the delay before the first frame (a Kinect's), of its change per frame, and of the difference
# between both rotations of a frame for other reasons; chosen.
_DELAY_SIGMA_S, _DELAY_WALK_S, _ROTATION_SIGMA_RAD = 0.015, 0.0002, 0.02
# The estimate replaces the calibration's delay if it differs by this number of standard deviations; chosen.
_CLEAR_SIGMAS = 1.0
# A slower rotation gives no measurement, a larger difference is no delay, and none is longer than 1.5 frames; chosen.
_LEAST_TURN_RAD_S, _MOST_DIFFERENCE_RAD, _MOST_DELAY_S = 0.2, 0.15, 0.05


class DepthDelay:
    """Estimates the constant delay of depth behind colour, beyond their stamps, by a Kalman filter with one state.

    In a turn, surfaces in depth lag behind keypoints in colour, so each turning frame measures the delay. The two
    sensors of a Kinect are not synchronised, and depth is stamped after it is computed. At 150 degrees per second
    20 ms are 3 degrees.

    Args:
        seconds: the delay by calibration.
    """

    def __init__(self, seconds: float) -> None:
        self._expected_s = self._estimate_s = seconds
        self._variance = _DELAY_SIGMA_S**2

    @property
    def seconds(self) -> float:
        """The delay: the estimate if it differs clearly from the calibration, else the calibration's."""
        is_clear = abs(self._estimate_s - self._expected_s) > _CLEAR_SIGMAS * self._variance**0.5
        return self._estimate_s if is_clear else self._expected_s

    def learn(self, ahead_rad: FloatArray, turning_rad_s: FloatArray) -> None:
        """Update the estimate by one frame.

        Args:
            ahead_rad: (3,) rotation by keypoints beyond that by surfaces, in the reference's frame.
            turning_rad_s: (3,) angular velocity at the frame minus that at its reference, in the same frame.
        """
        squared = float(turning_rad_s @ turning_rad_s)
        if squared < _LEAST_TURN_RAD_S**2 or np.linalg.norm(ahead_rad) > _MOST_DIFFERENCE_RAD:
            return
        self._variance += _DELAY_WALK_S**2
        # Frames are corrected by the delay in use, so the measurement is the remainder.
        measured = self.seconds - float(turning_rad_s @ ahead_rad) / squared - self._estimate_s
        variance = _ROTATION_SIGMA_RAD**2 / squared
        gain = self._variance / (self._variance + variance)
        self._estimate_s = float(np.clip(self._estimate_s + gain * measured, -_MOST_DELAY_S, _MOST_DELAY_S))
        self._variance *= 1 - gain
