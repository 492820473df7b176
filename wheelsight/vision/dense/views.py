"""Views that a frame can be aligned with, `KeypointTracker`, and the predicted and estimated state of a tracked
frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.camera_errors import with_frame_error
from wheelsight.core.estimates import CameraEstimate, MotionEstimate
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.geometry.motion_kernels import is_definite
from wheelsight.core.keyframes import KeyframeFeatures, KeyframeId, ReferenceModel
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.dense.alignment import Joint
from wheelsight.vision.dense.pyramid import Gridder, GridFrame, Reference, ReferenceMaker
from wheelsight.vision.dense.settings import DenseSettings, VerificationSettings
from wheelsight.vision.features.extraction import FeatureExtractor, Features, FeatureSettings, keypoint_sigma_px
from wheelsight.vision.features.tracking import Fix, LandmarkMap, MapTracker, View, ViewTracker
from wheelsight.vision.tracking_state import LONGEST_STEP_S, Stopwatch, TrackingState, maps_without_lens, twist_between

# Number of keyframes, the most recently used, with pyramids in memory. A pyramid is recomputed in 5 ms.
_IN_MEMORY = 6


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


class Views:
    """The known views that frames can be aligned with: a cache of keyframes, and the prediction of a map.

    Args:
        settings: the size of the cache, and how long a prediction is used.
        gridder, maker: give the ideal grid, and references on it.
        watch: counts the time of "predict".
        model: predicts views; default none.

    Attributes:
        keyframes: the least recently used first.
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
        self._model = model
        self._prediction: tuple[KnownView | None, int] = None, 0
        self.keyframes: list[KnownView] = []

    @property
    def has_model(self) -> bool:
        """Whether a map predicts views."""
        return self._model is not None

    def refer_to(self, model: ReferenceModel | None) -> None:
        """Replace the model that predicts views; None for none."""
        if model is not self._model:
            self._model, self._prediction = model, (None, 0)

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

    def around(self, T_map_camera: FloatArray, state: TrackingState) -> Iterator[KnownView]:
        """The model's prediction, then the last keyframe; after failures the nearest; once lost, older ones in turn."""
        for keyframe in self.keyframes[:-_IN_MEMORY]:
            keyframe.reference.forget()
        if self._model is not None:
            yield self._predicted(self._model, T_map_camera, afresh=state.failures > 0)
        yield self.keyframes[-1]
        if state.failures:
            yield self.nearest(T_map_camera)
        yield from self._older(state)

    def candidates(self, T_map_camera: FloatArray, state: TrackingState) -> list[KnownView]:
        """Keyframes that a frame may show: the nearest, the last, and, once lost, older ones in turn."""
        keyframes = [self.nearest(T_map_camera), self.keyframes[-1], *self._older(state)]
        return list(dict.fromkeys(keyframes))

    def _older(self, state: TrackingState) -> Iterator[KnownView]:
        if state.is_lost:
            yield self.keyframes[-1 - state.failures % len(self.keyframes)]

    def _predicted(self, model: ReferenceModel, T_map_camera: FloatArray, *, afresh: bool) -> KnownView:
        """The model's prediction near a pose (4, 4); it is reused for some frames while the camera is near."""
        known, served = self._prediction
        is_near = known is not None and known.distance_m(T_map_camera) < self._settings.predicted_way_m
        if known is None or afresh or not is_near or served >= self._settings.predicted_frames:
            with self._watch.stage("predict"):
                view = model.predict(T_map_camera, self._gridder.intrinsics, self._gridder.shape)
                reference = self._maker.of_view(view, T_map_camera, self._gridder.intrinsics)
            nearest = self.nearest(T_map_camera)
            known, served = KnownView(nearest.keyframe, reference, nearest.covariance), 0
        self._prediction = known, served + 1
        return known


# A variance below this share of the trace is a rounding error.
_LEAST_SHARE, _ALL = 1e-12, np.eye(6)


class KeypointTracker:
    """Locates frames by ORB keypoints: against the previous frame, then against landmarks of near keyframes (Zhang, 3).

    Keypoints follow quick turns and see distant structure, where surfaces alone fail. Surfaces that are invariant to a
    motion, such as walls, floors and backs of people, also fit at wrong poses. Keypoints of a wrong place hardly ever
    agree on one motion.

    Args:
        calibration: of the cameras.
        settings: thresholds of acceptance.
        has_landmarks: whether landmarks are used; else only the previous frame.
        threads: with more than one, keypoints are extracted in the background.
        fastest: limits on speed and angular speed, m/s and rad/s.
    """

    def __init__(
        self,
        calibration: Calibration,
        settings: VerificationSettings,
        *,
        has_landmarks: bool = True,
        threads: int = 1,
        fastest: tuple[float, float] = (np.inf, np.inf),
    ) -> None:
        features = FeatureSettings(keypoints=settings.keypoints, candidates=2 * settings.keypoints)
        calibration, self._straight = _without_lens(calibration)
        self._T_color_camera = calibration.T_color_camera
        self._noise, self._color_sigma_px = calibration.depth_noise, calibration.color_sigma_px
        self._settings, self._has_landmarks, self._fastest = settings, has_landmarks, fastest
        self._extractor = FeatureExtractor(calibration, features)
        self._by_view = ViewTracker(calibration, features, Stopwatch())
        self._by_landmarks = MapTracker(calibration, features)
        self._features = features
        self._landmarks = LandmarkMap(features)
        self._last: View | None = None
        self._trials = 0
        self._pool = ThreadPoolExecutor(1, "wheelsight-keypoints") if threads > 1 else None

    def look(self, frame: RgbdFrame) -> Future[Features]:
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
        return self._by_view.straighten(features, self._in_color(twist))

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
        level = np.full(len(z_m), self._features.pyramid_levels // 2)
        sigmas = np.hypot(keypoint_sigma_px(level, self._features), self._color_sigma_px), self._noise.sigma_m(z_m)
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
        if self._is_too_fast(found, self._last, features.stamp_s - self._last.features.stamp_s):
            return None
        if self._has_landmarks:
            refined = self._by_landmarks.track(features, found, self._last, self._landmarks)
            found = refined if isinstance(refined, Fix) else found
        return self._pose(found)

    def recognise(self, features: Features, keyframes: Iterable[KnownView], twist: FloatArray) -> KeypointPose | None:
        """The pose of a frame by the first of some keyframes that it shows; None if it shows none."""
        self._trials += 1
        for keyframe in keyframes:
            view = self._view(keyframe)
            if view is not None:
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
            view = View(straight, T_map_color, tracked.covariance, unknown, tracked.keyframe)
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
        self._landmarks, self._last = LandmarkMap(self._features), None

    def move(self, T_new_old: FloatArray) -> None:
        """Move landmarks and the previous frame with their keyframes, which moved in the map by (K, 4, 4)."""
        self._landmarks.move(T_new_old)
        self._last = None if self._last is None else self._last.moved(T_new_old)

    def _is_too_fast(self, found: Fix, last: View, seconds: float) -> bool:
        """Whether a pose exceeds the limits on speed: a repeated texture also agrees one period farther."""
        T = se3.invert(last.T_map_color) @ found.view.T_map_color
        way_m, turn_rad = float(np.linalg.norm(T[:3, 3])), float(so3.angle(T[:3, :3]))
        return seconds > 0 and (way_m > self._fastest[0] * seconds or turn_rad > self._fastest[1] * seconds)

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
        alike = self._settings.correlation
        covariance = view.covariance + (alike - 1) * own
        covariance = (covariance + covariance.T) / 2
        if not (np.isfinite(covariance).all() and is_definite(covariance - _LEAST_SHARE * np.trace(covariance) * _ALL)):
            return None
        return KeypointPose(T_map_camera, covariance, *counts, self._settings, alike * own, view)

    def _view(self, keyframe: KnownView) -> View | None:
        """A keyframe's features, with the colour camera's pose."""
        features = keyframe.features
        if features is None:
            return None
        T_map_color = keyframe.reference.T_map_reference @ se3.invert(self._T_color_camera)
        return View(features, T_map_color, keyframe.covariance, np.full(len(features), -1), keyframe.keyframe)


def _without_lens(calibration: Calibration) -> tuple[Calibration, Any]:
    """A calibration without distortion of a separate depth camera, and the maps that undistort its images or None."""
    depth = calibration.cameras[1]
    if calibration.is_registered or not depth.has_distortion:
        return calibration, None
    return replace(calibration, depth=replace(depth, distortion=(0.0,) * 5)), maps_without_lens(depth)


@dataclass(frozen=True, slots=True, eq=False)
class KeypointPose:
    """The pose of a frame by its keypoints.

    Attributes:
        T_map_camera: (4, 4).
        covariance: (6, 6) of its left perturbation (v, ω), including that of the keyframe.
        matches: number of matched keypoints.
        inliers: number of matched keypoints that agree on the pose.
        settings: thresholds of acceptance. Errors of neighbouring keypoints correlate: `correlation` count as one.
        motion_covariance: (6, 6) of the same perturbation, without that of the keyframe.
        view: the frame's keypoints, corrected for rolling shutter, and the landmarks that they show.
    """

    T_map_camera: FloatArray
    covariance: FloatArray
    matches: int
    inliers: int
    settings: VerificationSettings = field(default_factory=VerificationSettings)
    motion_covariance: FloatArray | None = None
    view: View | None = None

    @property
    def is_likely(self) -> bool:
        """Whether enough matches agree for a known place, rather than one that looks alike in parts."""
        return self.inliers >= self.settings.likely_share * self.matches

    @property
    def is_usable(self) -> bool:
        """Whether the pose is estimated jointly with surfaces: most matches agree, or too many for chance."""
        return self.is_likely or self.inliers >= self.settings.clear_inliers

    @property
    def is_clear(self) -> bool:
        """Whether keypoints count even if surfaces contradict them."""
        return self.inliers >= max(self.settings.clear_inliers, self.settings.clear_share * self.matches)

    def agrees_with(self, T_map_camera: FloatArray) -> bool:
        """Whether a pose (4, 4) agrees, within fixed limits or within the covariance."""
        limits = self.settings
        T = se3.invert(self.T_map_camera) @ T_map_camera
        off_m, off_rad = float(np.linalg.norm(T[:3, 3])), float(so3.angle(T[:3, :3]))
        off = se3.log(self.T_map_camera @ se3.invert(T_map_camera))
        is_within = off @ np.linalg.solve(self.covariance, off) < limits.agree_chi2
        return bool(max(off_m / limits.agree_m, off_rad / limits.agree_rad) < 1 or is_within)

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
        T_map_camera: predicted poses, each (4, 4); the first counts unless another fits clearly better.
        T_map_other: (4, 4) an alternative, which counts if grey values fit clearly better; or None.
        is_helped: whether the first one comes from another sensor rather than from constant velocity.
        keypoint_pose: the pose by keypoints, or None.
    """

    last: Tracked
    T_map_camera: tuple[FloatArray, ...]
    T_map_other: FloatArray | None = None
    is_helped: bool = False
    keypoint_pose: KeypointPose | None = None

    def at(self, T_map_camera: FloatArray) -> Prediction:
        """The same with a better pose (4, 4)."""
        return replace(self, T_map_camera=(T_map_camera,))

    def seconds_to(self, stamp_s: float) -> float:
        """Seconds from the last tracked frame to a time."""
        return stamp_s - self.last.frame.stamp_s


def predict(last: Tracked, stamp_s: float, prior: PriorMotion) -> tuple[Prediction, FloatArray]:
    """The predicted pose of a frame after the last one, and its twist (6,)."""
    T_last_frame, T_prior = at_speed(last, stamp_s), prior.T_last_frame
    poses = [last.T_map_camera @ T_last_frame] if T_prior is None or last.twist.any() else []
    if T_prior is not None:
        poses, T_last_frame = [last.T_map_camera @ T_prior, *poses], T_prior
    T_map_other = None if prior.T_last_other is None else last.T_map_camera @ prior.T_last_other
    ahead = Prediction(last, tuple(poses), T_map_other, is_helped=T_prior is not None)
    return ahead, speed_of(T_last_frame, stamp_s - last.frame.stamp_s, prior.twist)


def at_speed(last: Tracked, stamp_s: float) -> FloatArray:
    """T_last_frame (4, 4) by constant velocity; the identity after a gap."""
    seconds = stamp_s - last.frame.stamp_s
    twist = last.twist if 0 < seconds <= LONGEST_STEP_S else np.zeros(6)
    return se3.from_parts(so3.exp(twist[3:] * seconds), twist[:3] * seconds)


def speed_of(T_last_frame: FloatArray, seconds: float, twist: FloatArray | None = None) -> FloatArray:
    """The velocity (6,) in the frame's own axes of a predicted motion (4, 4); after a gap `twist`, or 0."""
    if 0 < seconds <= LONGEST_STEP_S:
        return twist_between(np.eye(4), T_last_frame, seconds)
    return np.zeros(6) if twist is None else twist
