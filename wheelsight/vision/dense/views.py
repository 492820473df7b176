"""Views that a frame can be aligned with, `KeypointTracker`, and the predicted and estimated state of a tracked
frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.camera_errors import with_frame_error
from wheelsight.core.errors import MapError
from wheelsight.core.estimates import CameraEstimate, MotionEstimate
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.geometry.motion_kernels import is_definite
from wheelsight.core.keyframes import KeyframeFeatures, KeyframeId, KeyframeStore, ReferenceModel
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.dense.alignment import Joint
from wheelsight.vision.dense.pyramid import Gridder, GridFrame, Reference, ReferenceMaker
from wheelsight.vision.dense.settings import DenseSettings
from wheelsight.vision.features.tracking import (
    PYRAMID_LEVELS,
    FeatureExtractor,
    Features,
    FeatureSettings,
    Fix,
    KeypointView,
    LandmarkMap,
    MapTracker,
    ViewTracker,
    keypoint_sigma_px,
    maps_without_lens,
    straighten,
)
from wheelsight.vision.tracking_state import LONGEST_STEP_S, Stopwatch, TrackingState, twist_between

# Number of keyframes, the most recently used, with pyramids in memory. A pyramid is recomputed in 5 ms.
_IN_MEMORY = 6
# A map's prediction serves for this number of frames while the camera stays within this distance, metres; a rotation by
# a radian counts as 1.5 m (docs/decisions/dense-alignment.md).
_PREDICTED_FRAMES, _PREDICTED_WAY_M = 3, 0.04


@dataclass(eq=False)
class KnownView:
    """A view with a known pose: a keyframe, an earlier frame, or the prediction of a map.

    Attributes:
        keyframe: the keyframe of the store that its pose moves with: itself, or the one that located it.
        reference: the reference that frames are aligned with.
        covariance: (6, 6) of the left perturbation (v, ω) of its pose.
        features: keypoints of the colour camera, corrected for rolling shutter; None if it cannot be recognised.
        turning_rad_s: (3,) angular velocity of the camera there, in its own frame; 0 for a map's prediction.
    """

    keyframe: KeyframeId
    reference: Reference
    covariance: FloatArray
    features: Features | None = None
    turning_rad_s: FloatArray = field(default_factory=lambda: np.zeros(3))

    def with_motion(self, covariance: FloatArray) -> FloatArray:
        """The covariance (6, 6) of a pose that follows from this one by a motion with a covariance (6, 6)."""
        Ad = se3.adjoint(self.reference.T_map_reference)
        return np.asarray(self.covariance + Ad @ covariance @ Ad.T)

    def distance_m(self, T_map_camera: FloatArray) -> float:
        """The distance of a pose (4, 4) from this view in metres; a rotation by a radian counts as 1.5 m."""
        return float(se3.view_shift_m(se3.invert(self.reference.T_map_reference) @ T_map_camera))

    def move(self, T_new_old: FloatArray) -> None:
        """Move it with its keyframe, which moved in the map by (4, 4) from the left."""
        reference = self.reference
        reference.T_map_reference, self.covariance = moved(T_new_old, reference.T_map_reference, self.covariance)


class ViewCache:
    """The known views that frames can be aligned with: a cache of keyframes, and the prediction of a map.

    Args:
        settings: the size of the cache, and when a frame becomes a keyframe.
        gridder, maker: give the ideal grid, and references on it.
        watch: counts the time of "predict".
        model: predicts views; default none.

    Attributes:
        keyframes: the least recently used first.
        has_model: whether a map predicts views.
    """

    def __init__(
        self,
        settings: DenseSettings,
        gridder: Gridder,
        maker: ReferenceMaker,
        watch: Stopwatch,
        model: ReferenceModel | None = None,
    ) -> None:
        self._settings, self._gridder, self._maker, self._watch = settings, gridder, maker, watch
        self._model, self.has_model = model, model is not None
        self._prediction: tuple[KnownView | None, int] = None, 0
        self.keyframes: list[KnownView] = []

    def refer_to(self, model: ReferenceModel | None) -> None:
        """Replace the model that predicts views; None for none."""
        if model is not self._model:
            self._model, self.has_model, self._prediction = model, model is not None, (None, 0)

    def move(self, T_new_old: FloatArray) -> None:
        """Move keyframes by (N, 4, 4), indexed by number, and drop the prediction of the map, which moved too."""
        for view in self.keyframes:
            view.move(T_new_old[view.keyframe])
        self.drop_prediction()

    def drop_prediction(self) -> None:
        """Drop the prediction, so that the next frame gets a new one."""
        self._prediction = None, 0

    def keep(self, keyframe: KnownView) -> list[KnownView]:
        """Add a keyframe, or mark it as the most recently used; returns the keyframes that the cache evicts."""
        if keyframe in self.keyframes:
            self.keyframes.remove(keyframe)
        self.keyframes.append(keyframe)
        going = self.keyframes[: -self._settings.kept_keyframes]
        del self.keyframes[: len(going)]
        return going

    def of_frame(self, tracked: Tracked) -> KnownView:
        """A tracked frame as a view."""
        reference = self._maker.of_frame(tracked.frame, tracked.T_map_camera)
        return KnownView(tracked.keyframe, reference, tracked.covariance, turning_rad_s=tracked.twist[3:])

    def nearest(self, T_map_camera: FloatArray) -> KnownView:
        """The keyframe nearest to a pose (4, 4); see `KnownView.distance_m`."""
        T_map_keyframe = np.array([keyframe.reference.T_map_reference for keyframe in self.keyframes])
        return self.keyframes[int(np.argmin(se3.view_shift_m(se3.invert(T_map_keyframe) @ T_map_camera)))]

    def lack(self, found: Tracked, *, is_helped: bool) -> bool:
        """Whether a frame becomes a keyframe: by its overlap with the last one, or, beside a map, by its distance."""
        if not self.has_model:
            # Without prior, a frame located by the previous one alone is no keyframe: people may move with the camera.
            is_settled = found.is_by_keyframe or not is_helped
            return found.overlap < self._settings.keyframe_overlap or not is_settled
        nearest = self.nearest(found.T_map_camera)
        return nearest.distance_m(found.T_map_camera) > self._settings.keyframe_way_m

    def around(self, T_map_camera: FloatArray, last: Tracked, state: TrackingState) -> Iterator[KnownView]:
        """The model's prediction near a pose (4, 4), the last keyframe, and the last tracked frame.

        After failures the nearest keyframe replaces the last frame; once lost, older keyframes follow in turn.
        """
        for keyframe in self.keyframes[:-_IN_MEMORY]:
            keyframe.reference.known_scales = None
        if self._model is not None:
            known, served = self._prediction
            is_near = known is not None and known.distance_m(T_map_camera) < _PREDICTED_WAY_M
            if known is None or state.failures > 0 or not is_near or served >= _PREDICTED_FRAMES:
                with self._watch.stage("predict"):
                    view = self._model.predict(T_map_camera, self._gridder.intrinsics, self._gridder.shape)
                    reference = self._maker.of_view(view, T_map_camera, self._gridder.intrinsics)
                nearest = self.nearest(T_map_camera)
                known, served = KnownView(nearest.keyframe, reference, nearest.covariance), 0
            self._prediction = known, served + 1
            yield known
        yield self.keyframes[-1]
        if not state.failures:
            yield self.of_frame(last)
            return
        yield self.nearest(T_map_camera)
        yield from self._older(state)

    def candidates(self, T_map_camera: FloatArray, state: TrackingState) -> list[KnownView]:
        """Keyframes that a frame may show: the nearest, the last, and, once lost, older ones in turn."""
        keyframes = [self.nearest(T_map_camera), self.keyframes[-1], *self._older(state)]
        return list(dict.fromkeys(keyframes))

    def _older(self, state: TrackingState) -> Iterator[KnownView]:
        if state.is_lost:
            yield self.keyframes[-1 - state.failures % len(self.keyframes)]


# A variance below this share of the trace is a rounding error.
_LEAST_SHARE, _ALL = 1e-12, np.eye(6)
# Number of neighbouring keypoints with the same error, which gives surfaces their weight (two real recordings:
# docs/decisions/features.md).
KEYPOINT_CORRELATION = 20.0
# Poses by keypoints and by surfaces agree within these distances, because keypoints err by 1 to 2 cm, or within their
# covariance: χ² of 6, 99 %.
_AGREE_M, _AGREE_RAD, _AGREE_CHI2 = 0.04, 0.035, 16.8
# Number of agreeing keypoints, and share of the matched ones, that count against surfaces: crowds and repeated textures
# have less. Chosen.
_CLEAR_INLIERS, _CLEAR_SHARE = 60, 0.6
# Share of matched keypoints that agree at a known place: 63 to 96 % at the right one, 19 to 26 % in another stretch of
# the corridor (simulator: docs/decisions/features.md).
_LIKELY_SHARE = 0.5


class KeypointTracker:
    """Locates frames by ORB keypoints: against the previous frame, then against landmarks of near keyframes (Zhang, 3).

    Keypoints follow quick turns and see distant structure, where surfaces alone fail. Surfaces that are invariant to a
    motion, such as walls, floors and backs of people, also fit at wrong poses. Keypoints of a wrong place hardly ever
    agree on one motion.

    Args:
        calibration: of the cameras.
        has_landmarks: whether landmarks are used; else only the previous frame.
        threads: with more than one, keypoints are extracted in the background.
        fastest: limits on speed and angular speed, m/s and rad/s.
    """

    def __init__(
        self,
        calibration: Calibration,
        *,
        has_landmarks: bool = True,
        threads: int = 1,
        fastest: tuple[float, float] = (np.inf, np.inf),
    ) -> None:
        # 500 keypoints save 3 ms a frame, but lose rotations of 18 degrees between frames (docs/decisions/features.md).
        features = FeatureSettings()
        depth, self._straight = calibration.cameras[1], None
        if not calibration.is_registered and depth.has_distortion:  # images of a separate depth camera are undistorted
            self._straight = maps_without_lens(depth)
            calibration = replace(calibration, depth=replace(depth, distortion=(0.0,) * 5))
        self._T_color_camera = calibration.T_color_camera
        self._shutter_s, self._color_height = calibration.rolling_shutter_s, calibration.cameras[0].height
        self._noise, self._color_sigma_px = calibration.depth_noise, calibration.color_sigma_px
        self._has_landmarks, self._fastest = has_landmarks, fastest
        self._extractor = FeatureExtractor(calibration, features)
        self._by_view = ViewTracker(calibration, Stopwatch(), features.seed)
        self._by_landmarks = MapTracker(calibration, features.local_keyframes)
        self._features = features
        self._landmarks = LandmarkMap(features.kept_keyframes)
        self._last: KeypointView | None = None
        self._trials = 0
        self._pool = ThreadPoolExecutor(1, "wheelsight-keypoints") if threads > 1 else None

    def start(self, frame: RgbdFrame) -> Future[Features]:
        """Start the extraction of a frame's keypoints, and return their future."""
        if self._pool is not None:
            return self._pool.submit(self._extract, frame)
        found: Future[Features] = Future()
        found.set_result(self._extract(frame))
        return found

    def _extract(self, frame: RgbdFrame) -> Features:
        if self._straight is not None:
            map_u, map_v = self._straight
            depth_m = cv2.remap(frame.depth_m, map_u, map_v, cv2.INTER_NEAREST)
            frame = replace(frame, depth_m=np.asarray(depth_m, np.float32))
        return self._extractor.extract(frame)

    def straightened(self, features: Features, twist: FloatArray) -> Features:
        """Features corrected for rolling shutter by the velocity (6,) of the camera in its own frame."""
        twist_color = se3.adjoint(self._T_color_camera) @ twist
        return straighten(features, np.asarray(twist_color), self._shutter_s, self._color_height)

    def kept(self, features: Features) -> KeyframeFeatures:
        """Features, corrected for rolling shutter, in the form of a keyframe: with points in the camera's frame."""
        points = se3.apply(se3.invert(self._T_color_camera), features.points)
        points[~features.has_depth] = 0.0
        return KeyframeFeatures(features.px, points, features.descriptors)

    def recalled(self, stamp_s: float, kept: KeyframeFeatures) -> Features:
        """The inverse of `kept` for features with depth; their pyramid level is unknown, so it is the middle one."""
        has_depth = kept.points[:, 2] > 0
        points = se3.apply(self._T_color_camera, kept.points[has_depth])
        z_m = points[:, 2].copy()
        level = np.full(len(z_m), PYRAMID_LEVELS // 2)
        sigmas = np.hypot(keypoint_sigma_px(level), self._color_sigma_px), self._noise.sigma_m(z_m)
        pixels = kept.px[has_depth], level, kept.descriptors[has_depth]
        return Features(stamp_s, *pixels, points[:, :2] / z_m[:, None], z_m, *sigmas)

    def track(self, features: Features, twist: FloatArray) -> KeypointPose | None:
        """The pose of a frame by the previous one and by landmarks nearby; None if too few keypoints agree.

        Args:
            features: of the frame, not corrected for rolling shutter.
            twist: (6,) the camera's predicted velocity in its own frame.
        """
        if self._last is None:
            return None
        self._trials += 1
        found = self._by_view.track(features, self._last, self._in_color(twist), None, self._trials)
        if not isinstance(found, Fix):
            return None
        # A repeated texture also agrees one period farther.
        T, seconds = (
            se3.invert(self._last.T_map_color) @ found.view.T_map_color,
            features.stamp_s - self._last.features.stamp_s,
        )
        way_m, turn_rad = float(np.linalg.norm(T[:3, 3])), float(so3.angle(T[:3, :3]))
        if seconds > 0 and (way_m > self._fastest[0] * seconds or turn_rad > self._fastest[1] * seconds):
            return None
        if self._has_landmarks:
            refined = self._by_landmarks.track(features, found, self._last, self._landmarks)
            found = refined if isinstance(refined, Fix) else found
        return self._pose(found)

    def recognise(self, features: Features, keyframes: Iterable[KnownView], twist: FloatArray) -> KeypointPose | None:
        """The pose of a frame by the first of some keyframes that it shows; None if it shows none."""
        self._trials += 1
        for keyframe in keyframes:
            known = keyframe.features
            if known is None:
                continue
            T_map_color = keyframe.reference.T_map_reference @ se3.invert(self._T_color_camera)
            unknown = np.full(len(known), -1)
            view = KeypointView(known, T_map_color, keyframe.covariance, unknown, keyframe.keyframe)
            found = self._by_view.track(features, view, self._in_color(twist), None, self._trials)
            pose = self._pose(found) if isinstance(found, Fix) else None
            if pose is not None:
                return pose
        return None

    def remember(self, tracked: Tracked, features: Features) -> None:
        """Make a located frame the previous one, and update the landmarks that it shows.

        If it shows few landmarks of the last keyframe, its other keypoints become landmarks.
        """
        pose = tracked.keypoint_pose
        T_map_color = tracked.T_map_camera @ se3.invert(self._T_color_camera)
        if pose is not None and pose.view is not None:
            view = replace(pose.view, T_map_color=T_map_color, covariance=tracked.covariance, keyframe=tracked.keyframe)
        else:
            straight, unknown = self.straightened(features, tracked.twist), np.full(len(features), -1)
            view = KeypointView(straight, T_map_color, tracked.covariance, unknown, tracked.keyframe)
        if self._has_landmarks:
            seen = np.flatnonzero(view.landmark >= 0)
            self._landmarks.see_again(view.landmark[seen], view.features, seen, T_map_color)
            known = self._landmarks.keyframes[-1].landmark if self._landmarks.keyframes else np.zeros(1, int)
            if len(seen) < self._features.keyframe_share * np.count_nonzero(known >= 0):
                view = self._landmarks.add_keyframe(view, tracked.keyframe)
                self._landmarks.forget_keypoints()
        self._last = view

    def forget(self) -> None:
        """Drop all landmarks and the previous frame."""
        self._landmarks, self._last = LandmarkMap(self._features.kept_keyframes), None

    def move(self, T_new_old: FloatArray) -> None:
        """Move landmarks and the previous frame with their keyframes, which moved in the map by (K, 4, 4)."""
        self._landmarks.move(T_new_old)
        self._last = None if self._last is None else self._last.moved(T_new_old)

    def _in_color(self, twist: FloatArray) -> FloatArray:
        return np.asarray(se3.adjoint(self._T_color_camera) @ twist)

    def _pose(self, found: Fix) -> KeypointPose | None:
        """The pose of a fix in the map; None if its covariance is singular up to rounding."""
        motion, view = found.motion, found.view
        assert motion.T_reference_current is not None
        assert motion.covariance is not None
        Ad = se3.adjoint(view.T_map_color @ se3.invert(motion.T_reference_current))
        T_map_camera = np.asarray(view.T_map_color @ self._T_color_camera)
        counts = (motion.matches, motion.inliers)
        own = np.asarray(Ad @ motion.covariance @ Ad.T)
        covariance = view.covariance + (KEYPOINT_CORRELATION - 1) * own
        covariance = (covariance + covariance.T) / 2
        if not (np.isfinite(covariance).all() and is_definite(covariance - _LEAST_SHARE * np.trace(covariance) * _ALL)):
            return None
        return KeypointPose(T_map_camera, covariance, *counts, KEYPOINT_CORRELATION * own, view)


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


@dataclass(frozen=True, slots=True, eq=False)
class KeypointPose:
    """The pose of a frame by its keypoints.

    Attributes:
        T_map_camera: (4, 4).
        covariance: (6, 6) of its left perturbation (v, ω), including that of the keyframe.
        matches: number of matched keypoints.
        inliers: number of matched keypoints that agree on the pose.
        motion_covariance: (6, 6) of the same perturbation, without that of the keyframe.
        view: the frame's keypoints, corrected for rolling shutter, and the landmarks that they show.
    """

    T_map_camera: FloatArray
    covariance: FloatArray
    matches: int
    inliers: int
    motion_covariance: FloatArray | None = None
    view: KeypointView | None = None

    @property
    def is_likely(self) -> bool:
        """Whether enough matches agree for a known place, rather than one that looks alike in parts."""
        return self.inliers >= _LIKELY_SHARE * self.matches

    @property
    def is_usable(self) -> bool:
        """Whether the pose is estimated jointly with surfaces: most matches agree, or too many for chance."""
        return self.inliers >= min(_CLEAR_INLIERS, _LIKELY_SHARE * self.matches)

    @property
    def is_clear(self) -> bool:
        """Whether keypoints count even if surfaces contradict them."""
        return self.inliers >= max(_CLEAR_INLIERS, _CLEAR_SHARE * self.matches)

    def agrees_with(self, T_map_camera: FloatArray) -> bool:
        """Whether a pose (4, 4) agrees, within fixed limits or within the covariance."""
        T = se3.invert(self.T_map_camera) @ T_map_camera
        off_m, off_rad = float(np.linalg.norm(T[:3, 3])), float(so3.angle(T[:3, :3]))
        off = se3.log(self.T_map_camera @ se3.invert(T_map_camera))
        is_within = off @ np.linalg.solve(self.covariance, off) < _AGREE_CHI2
        return bool(max(off_m / _AGREE_M, off_rad / _AGREE_RAD) < 1 or is_within)

    def motion_from(self, T_map_reference: FloatArray) -> MotionEstimate:
        """The motion against a reference at (4, 4)."""
        T_reference_map = se3.invert(T_map_reference)
        Ad = se3.adjoint(T_reference_map)
        counts = (None, self.matches, self.inliers)
        return MotionEstimate(T_reference_map @ self.T_map_camera, Ad @ self.covariance @ Ad.T, *counts)

    def information_from(self, T_map_reference: FloatArray) -> FloatArray:
        """Information (6, 6) of the left perturbation of the motion against a reference at (4, 4)."""
        Ad = se3.adjoint(se3.invert(T_map_reference))
        covariance = self.covariance if self.motion_covariance is None else self.motion_covariance
        return np.asarray(np.linalg.inv(Ad @ covariance @ Ad.T), float)


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """A frame with its estimated pose.

    Attributes:
        frame: on the ideal grid.
        T_map_camera: (4, 4).
        covariance: (6, 6) of the left perturbation (v, ω) of T_map_camera.
        motion: against the reference that located the frame.
        keyframe: the keyframe that the pose moves with.
        twist: (6,) velocity (v, ω) in the camera's own frame.
        overlap: the share of the frame that its reference shows at sufficient resolution.
        is_by_keyframe: whether that reference is a keyframe.
        residual: mean distance from planes in standard deviations, 1 for a perfect fit.
        keypoint_pose: the pose by keypoints, if they contribute.
        joint: the combination of surfaces and keypoints, if both contribute.
        turning_rad_s: (3,) angular velocity minus that at the reference, in the reference's frame.
        frame_error: (6, 6) covariance of the pose error by regions, in the frame's own axes: see `Locator.by_regions`.
            The combination of two references leaves it out.
    """

    frame: GridFrame
    T_map_camera: FloatArray
    covariance: FloatArray
    motion: MotionEstimate
    keyframe: KeyframeId
    twist: FloatArray = field(default_factory=lambda: np.zeros(6))
    overlap: float = 1.0
    is_by_keyframe: bool = True
    residual: float = 1.0
    keypoint_pose: KeypointPose | None = None
    joint: Joint | None = None
    turning_rad_s: FloatArray = field(default_factory=lambda: np.zeros(3))
    frame_error: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))

    def with_pose_error(self) -> Tracked:
        """The same with `frame_error` added to its covariances."""
        T, motion = self.motion.T_reference_current, self.motion
        if not self.frame_error.any() or T is None or motion.covariance is None:
            return self
        covariance = with_frame_error(self.covariance, self.T_map_camera, self.frame_error)
        motion = replace(motion, covariance=with_frame_error(motion.covariance, T, self.frame_error))
        return replace(self, covariance=covariance, motion=motion, frame_error=np.zeros((6, 6)))

    def moved(self, T_new_old: FloatArray) -> Tracked:
        """The same after its keyframe moved in the map by (4, 4) from the left."""
        T, covariance = moved(T_new_old, self.T_map_camera, self.covariance)
        return replace(self, T_map_camera=T, covariance=covariance)


@dataclass(frozen=True, slots=True, eq=False)
class DenseEstimate(CameraEstimate):
    """The estimate of dense odometry at a frame.

    Attributes:
        frame: on the ideal grid, corrected for rolling shutter; None without pose. See `DenseOdometry.surface`. It
            takes a megabyte, so drop it from estimates that are kept.
    """

    frame: GridFrame | None = field(default=None, kw_only=True)


def moved(T_new_old: FloatArray, T_map: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A pose (4, 4) and the covariance (6, 6) of its left perturbation after the map moved by (4, 4) there."""
    Ad = se3.adjoint(T_new_old)
    return np.asarray(se3.nearest(T_new_old @ T_map)), np.asarray(Ad @ covariance @ Ad.T)


@dataclass(frozen=True, slots=True, eq=False)
class PriorMotion:
    """The prior of a frame's motion from other sensors; each attribute is None if unknown.

    Attributes:
        T_last_frame: (4, 4) the motion since the last tracked frame.
        T_last_other: (4, 4) an alternative.
        twist: (6,) the camera's velocity (v, ω) in its own frame.
    """

    T_last_frame: FloatArray | None = None
    T_last_other: FloatArray | None = None
    twist: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """The predicted pose of a frame.

    Attributes:
        last: the last tracked frame.
        seconds: time from that frame to the predicted one.
        T_map_camera: predicted poses, each (4, 4); the first counts unless another fits clearly better.
        T_map_other: (4, 4) an alternative, which counts if grey values fit clearly better; or None.
        is_helped: whether the first one comes from another sensor rather than from constant velocity.
        keypoint_pose: the pose by keypoints, or None.
    """

    last: Tracked
    seconds: float
    T_map_camera: tuple[FloatArray, ...]
    T_map_other: FloatArray | None = None
    is_helped: bool = False
    keypoint_pose: KeypointPose | None = None

    def at(self, T_map_camera: FloatArray) -> Prediction:
        """The same with a better pose (4, 4)."""
        return replace(self, T_map_camera=(T_map_camera,))


def predict(last: Tracked, stamp_s: float, prior: PriorMotion) -> tuple[Prediction, FloatArray]:
    """The predicted pose of a frame after the last one, and the camera's velocity (6,) in the frame's own axes."""
    seconds, T_prior = stamp_s - last.frame.stamp_s, prior.T_last_frame
    is_near = 0 < seconds <= LONGEST_STEP_S
    speed = last.twist if is_near else np.zeros(6)  # after a gap the camera is expected at the same pose
    T_last_frame = se3.from_parts(so3.exp(speed[3:] * seconds), speed[:3] * seconds)
    poses = [last.T_map_camera @ T_last_frame] if T_prior is None or last.twist.any() else []
    if T_prior is not None:
        poses, T_last_frame = [last.T_map_camera @ T_prior, *poses], T_prior
    T_map_other = None if prior.T_last_other is None else last.T_map_camera @ prior.T_last_other
    ahead = Prediction(last, seconds, tuple(poses), T_map_other, is_helped=T_prior is not None)
    if is_near:
        return ahead, twist_between(np.eye(4), T_last_frame, seconds)
    return ahead, np.zeros(6) if prior.twist is None else prior.twist
