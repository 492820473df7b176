"""Poses of frames by known views: `ViewCache` has the views, and `KeypointTracker` tracks keypoints between them.

`Locator` estimates the pose of a frame from known views, and excludes moving regions. `Prediction` and `Tracked` are
the predicted and the estimated state of a frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.camera_errors import frame_covariance
from wheelsight.core.estimates import (
    DEGENERATE_SCALE,
    CameraEstimate,
    MotionEstimate,
    Reason,
    TrackingState,
    with_frame_error,
)
from wheelsight.core.geometry import BoolArray, FloatArray, se3, so3
from wheelsight.core.geometry.motion_kernels import is_definite
from wheelsight.core.keyframes import KeyframeFeatures, KeyframeId, ReferenceModel
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.threads import Stopwatch
from wheelsight.vision.dense.alignment import (
    CORRELATION,
    LEVELS,
    Aligner,
    DenseAlignment,
    Gridder,
    GridFrame,
    Joint,
    KeypointMotion,
    MotionPrior,
    PreviousPose,
    Reference,
    ReferenceMaker,
    SurfaceWeight,
    judge,
)
from wheelsight.vision.dense.alignment_kernels import add_regions
from wheelsight.vision.dense.settings import DenseSettings
from wheelsight.vision.features.tracking import (
    LONGEST_STEP_S,
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
        fastest: limits on speed and angular speed, m/s and rad/s.
    """

    def __init__(
        self,
        calibration: Calibration,
        *,
        has_landmarks: bool = True,
        fastest: tuple[float, float] = (np.inf, np.inf),
    ) -> None:
        # 500 keypoints save 3 ms a frame, but lose rotations of 18 degrees between frames (docs/decisions/features.md).
        features = FeatureSettings()
        depth, straight = calibration.cameras[1], None
        if not calibration.is_registered and depth.has_distortion:  # images of a separate depth camera are undistorted
            straight = maps_without_lens(depth)
            calibration = replace(calibration, depth=replace(depth, distortion=(0.0,) * 5))
        self._T_color_camera = calibration.T_color_camera
        self._shutter_s, self._color_height = calibration.rolling_shutter_s, calibration.cameras[0].height
        self._noise, self._color_sigma_px = calibration.depth_noise, calibration.color_sigma_px
        self._has_landmarks, self._fastest = has_landmarks, fastest
        self._extractor = FeatureExtractor(calibration, features, straight)
        self._by_view = ViewTracker(calibration, Stopwatch(), features.seed)
        self._by_landmarks = MapTracker(calibration, features.local_keyframes)
        self._features = features
        self._landmarks = LandmarkMap(features.kept_keyframes)
        self._last: KeypointView | None = None
        self._trials = 0

    def extract(self, frame: RgbdFrame) -> Features:
        """The keypoints of a frame, not corrected for rolling shutter."""
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
        relocation: see `CameraEstimate`.
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
    relocation: FloatArray | None = None

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
        return ahead, se3.twist_between(np.eye(4), T_last_frame, seconds)
    return ahead, np.zeros(6) if prior.twist is None else prior.twist


# Uncertainty of the predicted speed, m/s, which unseen directions get; its share for a base on wheels to move sideways,
# rise or tilt (simulator: docs/decisions/dense-alignment.md).
PRIOR_SIGMA_M_S, _NONHOLONOMIC_SHARE = 0.5, 0.15
# Share of a frame's resolution that a keyframe must have to show it. Along a corridor a frame errs by 3 mm with half of
# it, and by 1 mm with this share, where keypoints are recognised (simulator: docs/decisions/dense-alignment.md).
_FINENESS = 0.8


class Locator:
    """Estimates the pose of a frame by alignment with known views.

    Args:
        calibration: of the cameras; gives the error that all pixels of a frame share.
        settings: the uncertainty of predictions and the limits on speed.
        aligner: aligns a frame with one view.
        views: the known views.
        watch: counts the time of "align".

    Attributes:
        of_frame: covariance (6, 6) in the camera's frame of the error that all pixels of a frame share.
        weight: the weight of surfaces relative to keypoints.
    """

    def __init__(
        self, calibration: Calibration, settings: DenseSettings, aligner: Aligner, views: ViewCache, watch: Stopwatch
    ) -> None:
        self._settings, self._aligner, self._views, self._watch = settings, aligner, views, watch
        self.of_frame, self._noise = frame_covariance(calibration), calibration.depth_noise
        self.weight = SurfaceWeight()

    def locate(self, grid: GridFrame, ahead: Prediction, state: TrackingState) -> Tracked | MotionEstimate:
        """The frame by the first view that fits, together with keypoints, or the reason why none does.

        The alignment starts at the pose by keypoints, or at the best of the predicted poses.
        """
        failure: MotionEstimate | None = None
        for place, view in enumerate(self._views.around(ahead.T_map_camera[0], ahead.last, state)):
            is_elsewhere = place > 0 and state.is_lost
            begun = (view.reference.T_map_reference,) if is_elsewhere else ahead.T_map_camera
            found = self.by_view(grid, view, ahead, begun)
            if isinstance(found, Tracked):
                return self._refined(found, view, ahead, state)
            failure = failure or found
        assert failure is not None
        return failure

    def by_view(
        self,
        grid: GridFrame,
        view: KnownView,
        ahead: Prediction,
        begun: Sequence[FloatArray],
        *,
        is_held: bool = False,
    ) -> Tracked | MotionEstimate:
        """The frame aligned with one view from the best of some poses T_map_camera, or the reason of the failure.

        Args:
            grid: the frame.
            view: to align with.
            ahead: the prediction; its poses are the prior of directions that the view does not constrain.
            begun: initial poses, each (4, 4).
            is_held: whether constant velocity counts as a prior of the alignment too.
        """
        reference, seconds = view.reference, ahead.seconds
        T_reference_map = se3.invert(reference.T_map_reference)
        is_near = seconds <= LONGEST_STEP_S
        previous = PreviousPose(T_reference_map @ ahead.last.T_map_camera, seconds) if is_near else None
        sigma_m = PRIOR_SIGMA_M_S * max(seconds, 1e-3)
        # Constant velocity is no prior by default: a pose that noise pulls away must show as a leap.
        held_m = sigma_m if ahead.is_helped or is_held else np.inf, _NONHOLONOMIC_SHARE * sigma_m
        with self._watch.stage("align"):
            keypoints, pose = None, ahead.keypoint_pose
            if pose is not None and pose.is_usable:
                information = pose.information_from(reference.T_map_reference)
                keypoints = KeypointMotion(T_reference_map @ pose.T_map_camera, information)
            used, start = self._start(grid, reference, [T_reference_map @ T for T in begun], keypoints)
            starts = [start]
            if ahead.T_map_other is not None:
                starts.append(self._aligner.turn(grid, reference, T_reference_map @ ahead.T_map_other))
            found = self._aligner.align_clearest(
                used, reference, starts, previous, held_m, keypoints, self.weight.factor
            )
        joint = None
        if keypoints is not None:
            found, joint = self._joined(found, keypoints)
        first, *others = [T_reference_map @ T for T in ahead.T_map_camera]
        judged = judge(found, MotionPrior(first, sigma_m, tuple(others)))
        T_map_camera = se3.nearest(reference.T_map_reference @ judged.T_reference_frame)
        reason = judged.reason or implausible(ahead.last, T_map_camera, seconds, self._settings)
        if reason is not None:
            return MotionEstimate.failed(reason, found.pairs, found.planes)
        twist = previous.twist_to(judged.T_reference_frame) if previous else grid.twist
        turning = judged.T_reference_frame[:3, :3] @ twist[3:] - view.turning_rad_s
        counts = (None, found.pairs, found.planes, judged.degenerate)
        spread = with_frame_error(judged.covariance, judged.T_reference_frame, self.of_frame)
        frame_error, fitting = self.by_regions(
            grid, view.reference, judged.T_reference_frame, is_helped=ahead.is_helped
        )
        motion = MotionEstimate(judged.T_reference_frame, spread, *counts, fitting)
        fine = fine_share(grid, judged.T_reference_frame, _FINENESS)
        fit = (found.planes / max(found.points, 1) * fine, view in self._views.keyframes, found.residual)
        covariance = view.with_motion(spread)
        tracked = Tracked(grid, T_map_camera, covariance, motion, view.keyframe, twist, *fit, frame_error=frame_error)
        return replace(tracked, joint=joint, turning_rad_s=turning)

    def by_regions(
        self, grid: GridFrame, reference: Reference, T_reference_frame: FloatArray, *, is_helped: bool
    ) -> tuple[FloatArray, float | None]:
        """The pose error T_reference_frame (4, 4) by the regions of a frame.

        With a prior by other sensors (`is_helped`) the error is 0: they contradict a camera that follows a person, as
        long as its covariance is not enlarged (docs/decisions/dense-alignment.md).

        Returns:
            Covariance (6, 6) of the error in the frame's own axes, with rotations as distances at 2 m; 0 if most
            regions agree with the pose. Then the share of regions that agree, or None if too few are compared.
        """
        error_m, fitting = misfits(grid, reference, T_reference_frame, self._noise).pose_error()
        error_m = 0.0 if is_helped else error_m
        return np.diag((error_m / DEGENERATE_SCALE) ** 2), fitting

    def _start(
        self, grid: GridFrame, reference: Reference, expected: list[FloatArray], keypoints: KeypointMotion | None
    ) -> tuple[GridFrame, FloatArray]:
        """The frame without moving regions, and the initial pose (4, 4): by keypoints, or the best predicted one."""
        if keypoints is None:
            return grid, self._aligner.start(grid, reference, expected)
        start = self._aligner.nearest(grid, reference, [keypoints.T_reference_frame, *expected])
        moving = misfits(grid, reference, start, self._noise).moving
        return without(grid, moving) if moving.any() else grid, start

    def _joined(self, found: DenseAlignment, keypoints: KeypointMotion) -> tuple[DenseAlignment, Joint]:
        """An alignment combined with keypoints; their difference gives the covariance of surfaces."""
        joint = self.weight.meet(found.T_reference_frame, found.claimed / CORRELATION, keypoints)
        combined = replace(
            found,
            T_reference_frame=joint.T_reference_frame,
            information=found.information / joint.factor + CORRELATION * keypoints.information,
            compared=found.compared / joint.factor + CORRELATION * keypoints.information,
            hinted=(KEYPOINT_CORRELATION - 1) * CORRELATION * keypoints.information,
        )
        return combined, joint

    def _refined(self, found: Tracked, by: KnownView, ahead: Prediction, state: TrackingState) -> Tracked:
        """A pose by the map, replaced by one against the previous frame if only that constrains all directions.

        The texture of a bare wall fades in a map. If neither constrains all directions, constant velocity becomes a
        prior, because marks that match each other's places pull the pose along the wall.
        """
        if not self._views.has_model or state.failures or found.motion.shows_all:
            return found
        for view, is_held in [(self._views.of_frame(ahead.last), False), (by, True)][: 1 if ahead.is_helped else 2]:
            again = self.by_view(found.frame, view, ahead, ahead.T_map_camera, is_held=is_held)
            if isinstance(again, Tracked) and (is_held or again.motion.shows_all):
                return again
        return found


def fine_share(frame: GridFrame, T_reference_frame: FloatArray, least: float) -> float:
    """The share of a frame's points that its reference saw at `least` times the frame's resolution."""
    points, _, _ = frame.levels[-1].points()
    there = points @ T_reference_frame[2, :3] + T_reference_frame[2, 3]
    return float(np.count_nonzero(points[:, 2] >= least * there) / max(len(points), 1))


def implausible(last: Tracked, T_map_camera: FloatArray, seconds: float, settings: DenseSettings) -> Reason | None:
    """`Reason.IMPLAUSIBLE_MOTION` if the pose (4, 4) exceeds the limits on speed, else None."""
    T = se3.invert(last.T_map_camera) @ T_map_camera
    fast = np.linalg.norm(T[:3, 3]) > settings.max_speed_m_s * seconds
    turning = so3.angle(T[:3, :3]) > settings.max_turn_rad_s * seconds
    return Reason.IMPLAUSIBLE_MOTION if fast or turning else None


# Moving regions. Robust weights of single pixels fail if a person fills a fifth of the view: each pixel has a vote, and
# a person has much texture. Here each region has one vote. A region is excluded if its points lie clearly farther from
# known surfaces than those of the median region (cf. Scona et al., StaticFusion, ICRA 2018, who weigh clusters).

REGION_ROWS, REGION_COLUMNS = 6, 8  # regions of a view; chosen
# A region moves if it lies this many times as far from known surfaces as the median region, and at least this many
# standard deviations of depth; chosen.
_ODD_FACTOR, _ODD_SIGMAS = 2.5, 3.0
_MOST_MOVING = 0.4  # share of the regions; if more would be excluded, the pose is wrong
_MIN_POINTS, _MIN_REGIONS = 20, 12  # points that a region needs at the coarsest level, and regions to judge any


@dataclass(frozen=True, slots=True, eq=False)
class Misfits:
    """The distance of each region (rows, columns) of a frame from known surfaces, at one pose.

    Attributes:
        sigmas: mean distance of its points, in standard deviations of depth.
        metres: mean distance of its points along the surfaces' normals.
        is_compared: whether enough of its points lie on a known surface.
    """

    sigmas: FloatArray
    metres: FloatArray
    is_compared: BoolArray

    @property
    def moving(self) -> BoolArray:
        """(rows, columns) whether a region moves; none if many would, because then the pose is wrong."""
        compared = int(np.count_nonzero(self.is_compared))
        if compared < _MIN_REGIONS:
            return np.zeros(self.sigmas.shape, bool)
        usual = float(np.median(self.sigmas[self.is_compared]))
        moves = self.is_compared & (self.sigmas > max(_ODD_FACTOR * usual, _ODD_SIGMAS))
        return np.zeros_like(moves) if int(np.count_nonzero(moves)) > _MOST_MOVING * compared else moves

    def pose_error(self) -> tuple[float, float | None]:
        """The error of the pose in metres, and the share of compared regions that agree with it.

        The error is the median region's distance if many regions contradict the pose, else 0. Agreement of most pixels
        and keypoints does not prove a pose: a person close by has most of both. The share is None if too few regions
        are compared.
        """
        compared = int(np.count_nonzero(self.is_compared))
        if compared < _MIN_REGIONS:
            return 0.0, None
        off = int(np.count_nonzero(self.is_compared & (self.sigmas > _ODD_SIGMAS)))
        error_m = float(np.median(self.metres[self.is_compared])) if off > _MOST_MOVING * compared else 0.0
        return error_m, 1 - off / compared


def without(frame: GridFrame, regions: BoolArray) -> GridFrame:
    """The frame without the depth of some regions (rows, columns), so that alignment ignores them."""
    levels = []
    for level in frame.levels:
        height, width = level.depth_m.shape
        is_out = cv2.resize(regions.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
        levels.append(replace(level, depth_m=np.where(is_out, np.float32(0), level.depth_m)))
    return replace(frame, levels=tuple(levels))


def misfits(frame: GridFrame, reference: Reference, T_reference_frame: FloatArray, noise: DepthNoise) -> Misfits:
    """The distance of regions from known planes for a frame at T_reference_frame (4, 4), at the coarsest level.

    A point whose depth differs from the known surface counts as `MOST_SIGMAS` away. A point without a known surface
    does not count.
    """
    level, seen = frame.levels[LEVELS - 1], reference.scales.levels[LEVELS - 1]
    sums = np.zeros((3, REGION_ROWS, REGION_COLUMNS))
    limits = np.array([noise.constant_m, noise.quadratic_per_m, noise.near_m])
    add_regions(level.depth_m, seen.pixels, level.intrinsics, np.ascontiguousarray(T_reference_frame), limits, sums)
    points = np.maximum(sums[0], 1)
    return Misfits(sums[1] / points, sums[2] / points, sums[0] >= _MIN_POINTS)
