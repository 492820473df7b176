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

# Views that a frame may be aligned with: keyframes, and what a map looks like from where the camera is expected.


# So many keyframes, those used last, are held ready; of others depth and grey alone, of which they are made in 5 ms.
_AT_HAND = 6


@dataclass(eq=False)
class KnownView:
    """A view with a pose.

    Attributes:
        keyframe: of the store, with which the pose moves: itself, or another that it was found by.
        reference: what frames are aligned with.
        covariance: (6, 6) of the left perturbation (v, ω) of its pose.
        features: of the colour camera, rows straightened, where it is to be recognised by them; or None.
        turning_rad_s: (3,) how fast the camera turned there, in its own frame; nothing for a map's view.
    """

    keyframe: KeyframeId
    reference: Reference
    covariance: FloatArray
    features: Features | None = None
    turning_rad_s: FloatArray = field(default_factory=lambda: np.zeros(3))

    def with_motion(self, covariance: FloatArray) -> FloatArray:
        """The covariance (6, 6) of a pose that lies off this one by a motion with its covariance (6, 6)."""
        Ad = se3.adjoint(self.reference.T_map_reference)
        return np.asarray(self.covariance + Ad @ covariance @ Ad.T)

    def distance_m(self, T_map_camera: FloatArray) -> float:
        """How far a view from there (4, 4) is from this one; a turn by a radian counts as 1.5 m."""
        return float(se3.view_shift_m(se3.invert(self.reference.T_map_reference) @ T_map_camera))

    def move(self, T_new_old: FloatArray) -> None:
        """To where its keyframe has moved by (4, 4), from the left, in the map."""
        reference = self.reference
        reference.T_map_reference, self.covariance = moved(T_new_old, reference.T_map_reference, self.covariance)


class Views:
    """What is known of the place, as views to align with.

    Args:
        settings: how many keyframes are kept, and for how long one prediction serves.
        gridder, maker: give the ideal grid, and references on it.
        watch: counts the time of "predict".
        model: what predicts a view, if anything does.

    Attributes:
        keyframes: the one used longest ago first.
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
        """Whether a map predicts what is to be seen."""
        return self._model is not None

    def refer_to(self, model: ReferenceModel | None) -> None:
        """From now on, have a model predict views, or none."""
        if model is not self._model:
            self._model, self._prediction = model, (None, 0)

    def move(self, T_new_old: FloatArray) -> None:
        """Keyframes have moved by (N, 4, 4), by number; the map has moved too, and is asked anew what it looks like."""
        for view in self.keyframes:
            view.move(T_new_old[view.keyframe])
        self.expect_nothing()

    def expect_nothing(self) -> None:
        """What was predicted is forgotten: for elsewhere, or for keyframes where they were."""
        self._prediction = None, 0

    def keep(self, keyframe: KnownView) -> list[KnownView]:
        """Keep a keyframe, or let it count as the newest again; answers with the oldest ones, which go."""
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
        """The keyframe whose view is nearest to one from there (4, 4)."""
        T_map_keyframe = np.array([keyframe.reference.T_map_reference for keyframe in self.keyframes])
        return self.keyframes[int(np.argmin(se3.view_shift_m(se3.invert(T_map_keyframe) @ T_map_camera)))]

    def lack(self, found: Tracked, *, is_helped: bool) -> bool:
        """Whether a frame is to become a keyframe: the last one shows too little of it; beside a map, by the way."""
        if not self.has_model:
            # Alone, a frame that only the one before could place is none: people's backs would carry the camera along.
            is_settled = found.is_by_keyframe or not is_helped
            return found.overlap < self._settings.keyframe_overlap or not is_settled
        nearest = self.nearest(found.T_map_camera)
        return nearest.distance_m(found.T_map_camera) > self._settings.keyframe_way_m

    def around(self, T_map_camera: FloatArray, state: TrackingState) -> Iterator[KnownView]:
        """What the model predicts, then the newest keyframe; after failures the nearest; once lost, others in turn."""
        for keyframe in self.keyframes[:-_AT_HAND]:
            keyframe.reference.forget()
        if self._model is not None:
            yield self._predicted(self._model, T_map_camera, afresh=state.failures > 0)
        yield self.keyframes[-1]
        if state.failures:
            yield self.nearest(T_map_camera)
        yield from self._in_turn(state)

    def familiar(self, T_map_camera: FloatArray, state: TrackingState) -> list[KnownView]:
        """Keyframes that a frame may show: the nearest, the newest, and once lost an older one in turn."""
        keyframes = [self.nearest(T_map_camera), self.keyframes[-1], *self._in_turn(state)]
        return list(dict.fromkeys(keyframes))

    def _in_turn(self, state: TrackingState) -> Iterator[KnownView]:
        if state.is_lost:
            yield self.keyframes[-1 - state.failures % len(self.keyframes)]

    def _predicted(self, model: ReferenceModel, T_map_camera: FloatArray, *, afresh: bool) -> KnownView:
        """What the model looks like from there; one view serves for some frames, while the camera is near."""
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


# KeypointTracker: where frames are by their keypoints, frame by frame and wherever a keyframe is seen again.


# A variance that is a smaller share of all is what rounding left.
_LEAST_SHARE, _ALL = 1e-12, np.eye(6)


class KeypointTracker:
    """Finds frames by ORB keypoints: against the frame before, then against the landmarks of near keyframes (Zhang, 3).

    It carries quick turns and shows far things, where surfaces alone are lost. Surfaces that are alike under a motion,
    such as walls, floors and backs of people, fit just as well where the camera is not; keypoints of the wrong place
    hardly ever agree on one motion.

    Args:
        calibration: of the cameras.
        settings: when keypoints count.
        has_landmarks: else frames are found by the frame before alone.
        threads: with more than one, keypoints are looked for beside other work.
        fastest: metres and radians a second that the camera moves at most.
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
        self._asked = 0
        self._pool = ThreadPoolExecutor(1, "wheelsight-keypoints") if threads > 1 else None

    def look(self, frame: RgbdFrame) -> Future[Features]:
        """The keypoints of a frame, as soon as they are found."""
        if self._pool is not None:
            return self._pool.submit(self._look, frame)
        found: Future[Features] = Future()
        found.set_result(self._look(frame))
        return found

    def _look(self, frame: RgbdFrame) -> Features:
        if self._straight is not None:
            map_u, map_v = self._straight
            depth_m = cv2.remap(frame.depth_m, map_u, map_v, cv2.INTER_NEAREST)
            frame = replace(frame, depth_m=np.asarray(depth_m, np.float32))
        return self._extractor.extract(frame)

    def straightened(self, features: Features, twist: FloatArray) -> Features:
        """As if all rows were read at once, of a camera whose velocity (6,) in its own frame is known."""
        return self._by_view.straighten(features, self._in_color(twist))

    def kept(self, features: Features) -> KeyframeFeatures:
        """Straightened features as a keyframe has them: their points in the camera's frame."""
        points = se3.apply(se3.invert(self._T_color_camera), features.points)
        points[~features.has_depth] = 0.0
        return KeyframeFeatures(features.px, points, features.descriptors)

    def recalled(self, stamp_s: float, kept: KeyframeFeatures) -> Features:
        """What `kept` made of features that have depth; on which level each was found is not known by then."""
        has_depth = kept.points[:, 2] > 0
        points = se3.apply(self._T_color_camera, kept.points[has_depth])
        z_m = points[:, 2].copy()
        level = np.full(len(z_m), self._features.pyramid_levels // 2)
        sigmas = np.hypot(keypoint_sigma_px(level, self._features), self._color_sigma_px), self._noise.sigma_m(z_m)
        told = kept.px[has_depth], level, kept.descriptors[has_depth]
        return Features(stamp_s, *told, points[:, :2] / z_m[:, None], z_m, *sigmas)

    def track(self, features: Features, twist: FloatArray) -> KeypointPose | None:
        """Where a frame is by the one before and the landmarks around; None where they tell nothing.

        Args:
            features: of the frame, rows not straightened.
            twist: (6,) the camera's expected velocity in its own frame.
        """
        if self._last is None:
            return None
        self._asked += 1
        found = self._by_view.track(features, self._last, self._in_color(twist), None, self._asked)
        if not isinstance(found, Fix):
            return None
        if self._is_too_fast(found, self._last, features.stamp_s - self._last.features.stamp_s):
            return None
        if self._has_landmarks:
            refined = self._by_landmarks.track(features, found, self._last, self._landmarks)
            found = refined if isinstance(refined, Fix) else found
        return self._pose(found)

    def recognise(self, features: Features, keyframes: Iterable[KnownView], twist: FloatArray) -> KeypointPose | None:
        """Where a frame is by the first keyframe that it shows; None where it shows none."""
        self._asked += 1
        for keyframe in keyframes:
            view = self._view(keyframe)
            if view is not None:
                found = self._by_view.track(features, view, self._in_color(twist), None, self._asked)
                told = self._pose(found) if isinstance(found, Fix) else None
                if told is not None:
                    return told
        return None

    def remember(self, tracked: Tracked, features: Features) -> None:
        """Take a frame, whose pose is known by now, as the last one; landmarks that it shows are seen once more.

        Where it shows few of those known last, what it shows beside them becomes landmarks.
        """
        told = tracked.told
        T_map_color = tracked.T_map_camera @ se3.invert(self._T_color_camera)
        if told is not None and told.view is not None:
            view = replace(told.view, T_map_color=T_map_color, covariance=tracked.covariance, keyframe=tracked.keyframe)
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
        """No landmark is known any more, nor a last frame."""
        self._landmarks, self._last = LandmarkMap(self._features), None

    def move(self, T_new_old: FloatArray) -> None:
        """Landmarks and the last frame go with their keyframes, which have moved in the map by (K, 4, 4)."""
        self._landmarks.move(T_new_old)
        self._last = None if self._last is None else self._last.moved(T_new_old)

    def _is_too_fast(self, found: Fix, last: View, seconds: float) -> bool:
        """Whether no camera goes so far in so short a time: paint that repeats agrees a period farther on, too."""
        T = se3.invert(last.T_map_color) @ found.view.T_map_color
        way_m, turn_rad = float(np.linalg.norm(T[:3, 3])), float(so3.angle(T[:3, :3]))
        return seconds > 0 and (way_m > self._fastest[0] * seconds or turn_rad > self._fastest[1] * seconds)

    def _in_color(self, twist: FloatArray) -> FloatArray:
        return np.asarray(se3.adjoint(self._T_color_camera) @ twist)

    def _pose(self, found: Fix) -> KeypointPose | None:
        """None where keypoints lie so that they do not tell all of the motion, and rounding hides how sure it is."""
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
    """A calibration whose depth camera has no lens of its own, and the maps that bring depth there, if it had one."""
    depth = calibration.cameras[1]
    if calibration.is_registered or not depth.has_distortion:
        return calibration, None
    return replace(calibration, depth=replace(depth, distortion=(0.0,) * 5)), maps_without_lens(depth)


# KeypointPose: what keypoints tell of a frame, and how far that counts.


@dataclass(frozen=True, slots=True, eq=False)
class KeypointPose:
    """Where a frame is by its keypoints.

    Attributes:
        T_map_camera: (4, 4).
        covariance: (6, 6) of its left perturbation (v, ω), that of the keyframe included.
        matches: keypoints that were matched; inliers: those that agree.
        settings: when it counts.
            Neighbouring keypoints err alike, as neighbouring pixels do: `correlation` of them count as one.
        motion_covariance: (6, 6) of the same perturbation, that of the keyframe left out.
        view: the frame's keypoints, rows straightened, and the landmarks that they show.
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
        """Whether it is a place that was seen before rather than one that looks alike in parts."""
        return self.inliers >= self.settings.likely_share * self.matches

    @property
    def is_usable(self) -> bool:
        """Whether it is estimated together with surfaces: most agree, or so many that they are no chance."""
        return self.is_likely or self.inliers >= self.settings.clear_inliers

    @property
    def is_clear(self) -> bool:
        """Whether keypoints are to be believed even where surfaces say otherwise."""
        return self.inliers >= max(self.settings.clear_inliers, self.settings.clear_share * self.matches)

    def agrees_with(self, T_map_camera: FloatArray) -> bool:
        """Whether a pose (4, 4) is as near as two ways to find one leave them."""
        limits = self.settings
        T = se3.invert(self.T_map_camera) @ T_map_camera
        off_m, off_rad = float(np.linalg.norm(T[:3, 3])), float(so3.angle(T[:3, :3]))
        off = se3.log(self.T_map_camera @ se3.invert(T_map_camera))
        is_within = off @ np.linalg.solve(self.covariance, off) < limits.agree_chi2
        return bool(max(off_m / limits.agree_m, off_rad / limits.agree_rad) < 1 or is_within)

    def motion_from(self, T_map_reference: FloatArray) -> MotionEstimate:
        """As a motion against a reference at (4, 4)."""
        T_reference_map = se3.invert(T_map_reference)
        Ad = se3.adjoint(T_reference_map)
        counts = (None, self.matches, self.inliers)
        return MotionEstimate(T_reference_map @ self.T_map_camera, Ad @ self.covariance @ Ad.T, *counts)

    def information_from(self, T_map_reference: FloatArray) -> FloatArray:
        """Information (6, 6) of the left perturbation of its motion against a reference at (4, 4)."""
        Ad = se3.adjoint(se3.invert(T_map_reference))
        covariance = self.covariance if self.motion_covariance is None else self.motion_covariance
        return np.asarray(np.linalg.inv(Ad @ covariance @ Ad.T), float)


# Tracked: a frame whose pose is known, and what is answered of it.


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """A frame with its pose.

    Attributes:
        frame: on the ideal grid.
        T_map_camera: (4, 4).
        covariance: (6, 6) of the left perturbation (v, ω) of that.
        motion: against the reference that the pose was found by.
        keyframe: on which the pose hangs: it moves with that one.
        twist: (6,) velocity (v, ω) in the camera's own frame.
        overlap: the share of the frame that its reference shows finely enough.
        is_by_keyframe: whether that reference is a keyframe.
        residual: how far off its planes are in the mean, 1 for a perfect fit.
        told: what keypoints say, where the pose goes by them too.
        joint: how surfaces and keypoints met, where they did.
        turning_rad_s: (3,) how much faster the camera turned than at its reference, in that one's frame.
        doubt: (6, 6) in the frame's own axes, what most of the view has against the pose: see `Locator.by_regions`.
            Which of two references tells the pose better is weighed without it.
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
    told: KeypointPose | None = None
    joint: Joint | None = None
    turning_rad_s: FloatArray = field(default_factory=lambda: np.zeros(3))
    doubt: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))

    def doubted(self) -> Tracked:
        """The same, as uncertain as what most of the view has against it says."""
        T, motion = self.motion.T_reference_current, self.motion
        if not self.doubt.any() or T is None or motion.covariance is None:
            return self
        covariance = with_frame_error(self.covariance, self.T_map_camera, self.doubt)
        motion = replace(motion, covariance=with_frame_error(motion.covariance, T, self.doubt))
        return replace(self, covariance=covariance, motion=motion, doubt=np.zeros((6, 6)))

    def moved(self, T_new_old: FloatArray) -> Tracked:
        """The same after its keyframe has moved by (4, 4), from the left, in the map."""
        T, covariance = moved(T_new_old, self.T_map_camera, self.covariance)
        return replace(self, T_map_camera=T, covariance=covariance)


@dataclass(frozen=True, slots=True, eq=False)
class DenseEstimate(CameraEstimate):
    """What dense odometry answers at a frame.

    Attributes:
        frame: on the ideal grid, its rows straightened; None where it has no pose. See `DenseOdometry.surface`. It is
            a megabyte: who keeps estimates lets go of it.
    """

    frame: GridFrame | None = field(default=None, kw_only=True)


def moved(T_new_old: FloatArray, T_map: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A pose (4, 4) and the covariance (6, 6) of its left perturbation, after a motion (4, 4) of the map there."""
    Ad = se3.adjoint(T_new_old)
    return np.asarray(se3.nearest(T_new_old @ T_map)), np.asarray(Ad @ covariance @ Ad.T)


# Prediction: where a frame is to be expected before it is compared with anything.


@dataclass(frozen=True, slots=True, eq=False)
class PriorMotion:
    """What other sensors tell of a frame; each is None where they tell nothing.

    Attributes:
        T_last_frame: (4, 4) the motion since the frame tracked last.
        T_last_other: (4, 4) what that may be instead.
        twist: (6,) the camera's velocity (v, ω) in its own frame.
    """

    T_last_frame: FloatArray | None = None
    T_last_other: FloatArray | None = None
    twist: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Where a frame is expected.

    Attributes:
        last: the frame tracked last.
        T_map_camera: each (4, 4); the first counts unless another fits clearly better.
        T_map_other: (4, 4) where it may be instead, and is where grey values say so; or None.
        is_helped: whether it is another sensor that expects the first, rather than constant velocity.
        told: what keypoints say, or None.
    """

    last: Tracked
    T_map_camera: tuple[FloatArray, ...]
    T_map_other: FloatArray | None = None
    is_helped: bool = False
    told: KeypointPose | None = None

    def at(self, T_map_camera: FloatArray) -> Prediction:
        """The same, of a pose (4, 4) that is known better by now."""
        return replace(self, T_map_camera=(T_map_camera,))

    def seconds_to(self, stamp_s: float) -> float:
        """Since the frame tracked last."""
        return stamp_s - self.last.frame.stamp_s


def predict(last: Tracked, stamp_s: float, prior: PriorMotion) -> tuple[Prediction, FloatArray]:
    """Where a frame is expected after the last one, and its twist (6,)."""
    T_last_frame, T_prior = at_speed(last, stamp_s), prior.T_last_frame
    poses = [last.T_map_camera @ T_last_frame] if T_prior is None or last.twist.any() else []
    if T_prior is not None:
        poses, T_last_frame = [last.T_map_camera @ T_prior, *poses], T_prior
    T_map_other = None if prior.T_last_other is None else last.T_map_camera @ prior.T_last_other
    ahead = Prediction(last, tuple(poses), T_map_other, is_helped=T_prior is not None)
    return ahead, speed_of(T_last_frame, stamp_s - last.frame.stamp_s, prior.twist)


def at_speed(last: Tracked, stamp_s: float) -> FloatArray:
    """T_last_frame (4, 4) by constant velocity; after a longer gap, as if the camera had stood still."""
    seconds = stamp_s - last.frame.stamp_s
    twist = last.twist if 0 < seconds <= LONGEST_STEP_S else np.zeros(6)
    return se3.from_parts(so3.exp(twist[3:] * seconds), twist[:3] * seconds)


def speed_of(T_last_frame: FloatArray, seconds: float, told: FloatArray | None = None) -> FloatArray:
    """The velocity (6,) in its own frame that an expected motion (4, 4) means; after a gap, what is `told`, or 0."""
    if 0 < seconds <= LONGEST_STEP_S:
        return twist_between(np.eye(4), T_last_frame, seconds)
    return np.zeros(6) if told is None else told
