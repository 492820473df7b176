"""ORB keypoints of a frame, and its pose relative to an earlier view or a local map of landmarks, by matching, RANSAC
and refinement. `KeyframeMaker` turns a frame into a keyframe. `FeatureSettings` configures all of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError
from wheelsight.core.estimates import CameraEstimate, MotionEstimate, Reason
from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, IntArray, PinholeCamera, se3
from wheelsight.core.geometry.arrays import UInt64Array
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures, KeyframeId
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.settings import CHOSEN, Settings, setting
from wheelsight.core.threads import Stopwatch
from wheelsight.vision.image_kernels import (
    Cells,
    DepthImage,
    Pairs,
    Triangles,
    depth_at_keypoints,
    nearest_both_ways,
    nearest_within,
    project,
    ransac,
    refine,
)


class FeatureSettings(Settings):
    """Settings of feature odometry; unknown names are refused."""

    reference: Literal["keyframes", "previous"] = setting(
        "keyframes",
        "align with landmarks of near keyframes, or with the previous frame as in the paper",
        "Zhang, Fig. 3, for the previous frame; keyframes drift less",
    )
    seed: int = setting(0, "of RANSAC; one seed gives one trajectory", CHOSEN, ge=0, lt=2**32)
    keypoints: int = setting(1000, "kept in each frame, spread over the image", CHOSEN, ge=50, le=20_000)
    candidates: int = setting(2000, "detected before spreading", CHOSEN, ge=50, le=50_000)
    max_speed_m_s: float = setting(5.0, "a faster motion is implausible", CHOSEN, gt=0, le=100)
    max_turn_rad_s: float = setting(8.0, "a faster rotation is implausible", CHOSEN, gt=0, le=100)
    keyframe_share: float = setting(
        0.45, "of a keyframe's landmarks; if fewer are seen, a new keyframe is made", CHOSEN, gt=0, le=1
    )
    local_keyframes: int = setting(30, "nearest keyframes whose landmarks are searched", CHOSEN, gt=0, le=1000)
    kept_keyframes: int = setting(300, "held in memory; the oldest are dropped first", CHOSEN, gt=0, le=100_000)
    lost_after: int = setting(
        10,
        "consecutive failed frames after which the state is lost",
        "Zhang, Fig. 3, N; the paper names no figure",
        gt=0,
        le=1_000_000,
    )


# Over a longer gap in seconds the mean velocity says little about the velocity at the frame.
LONGEST_STEP_S = 0.35
# ORB: least grey difference of a corner's ring, and the same for an image with too few clear corners (Rublee et
# al. 2011; docs/decisions/features.md), and levels and scale factor of the image pyramid, as in OpenCV.
_FAST_THRESHOLD, _FAINT_THRESHOLD, PYRAMID_LEVELS, PYRAMID_SCALE = 20, 7, 8, 1.2
# Standard deviation of a keypoint's pixel on the full image, and its growth per level, less than that of the level's
# pixels (benchmarks.sensor on two Kinect recordings).
_SIGMA_PX, _SIGMA_GROWTH = 0.65, 1.12
_SPREAD_CELL_PX = 64  # cells in which keypoints compete when they are spread (docs/decisions/features.md)
# Largest difference of readings around a keypoint, as a share of the depth, at a Kinect's focal length in pixels or
# more. At less it grows in proportion: a slanted surface differs between pixels by its slope times the pixel's angle.
# Beyond is an edge. Chosen.
_DEPTH_JUMP, _DEPTH_JUMP_FOCAL_PX = 0.03, 525.0
# Assumed depth of keypoints without depth in the rolling-shutter correction; it only scales a small parallax.
_TYPICAL_DEPTH_M = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """N ORB keypoints of one frame, in the frame of the colour camera (Zhang, section 3.1).

    Attributes:
        stamp_s: time of the frame, seconds.
        px: (N, 2) detected pixels, with lens distortion.
        level: (N,) level of the image pyramid, each `PYRAMID_SCALE` times smaller than the previous one.
        descriptors: (N, 4) uint64, the 256 bits of ORB.
        xy: (N, 2) on the plane z = 1, without lens distortion and rolling shutter.
        depth_m: (N,) along the colour camera's z axis, 0 where it is unreliable.
        sigma_px, sigma_m: (N,) standard deviations of pixel and depth.
    """

    stamp_s: float
    px: FloatArray
    level: IntArray
    descriptors: UInt64Array
    xy: FloatArray
    depth_m: FloatArray
    sigma_px: FloatArray
    sigma_m: FloatArray

    def __len__(self) -> int:
        return len(self.px)

    def some(self, count: int) -> Features:
        """Copies of the first `count` keypoints."""
        return replace(
            self,
            px=self.px[:count].copy(),
            level=self.level[:count].copy(),
            descriptors=self.descriptors[:count].copy(),
            xy=self.xy[:count].copy(),
            depth_m=self.depth_m[:count].copy(),
            sigma_px=self.sigma_px[:count].copy(),
            sigma_m=self.sigma_m[:count].copy(),
        )

    @property
    def has_depth(self) -> BoolArray:
        """(N,) mask of keypoints with depth."""
        return self.depth_m > 0

    @property
    def points(self) -> FloatArray:
        """(N, 3) in the colour camera's frame, metres; zero without depth."""
        return np.column_stack([self.xy * self.depth_m[:, None], self.depth_m])


class FeatureExtractor:
    """Detects and describes keypoints spread over the image, with 3D points where depth is known.

    Args:
        calibration: of the cameras.
        settings: number of keypoints.
        straight: column and row of the depth image at each pixel without lens distortion, see `maps_without_lens`.

    Raises CalibrationError for an unregistered depth camera with lens distortion.
    """

    def __init__(
        self,
        calibration: Calibration,
        settings: FeatureSettings,
        straight: tuple[Float32Array, Float32Array] | None = None,
    ) -> None:
        if not calibration.is_registered and calibration.cameras[1].has_distortion:
            raise CalibrationError(
                "a distorted depth camera beside an unregistered colour camera is not supported",
                fix="undistort the depth images, or register them to colour",
            )
        self._settings, self._straight, self._noise = settings, straight, calibration.depth_noise
        (self._color, depth), T_color_camera = calibration.cameras, calibration.T_color_camera
        self._color_sigma_px = calibration.color_sigma_px
        self._depth = DepthImage(
            np.zeros((0, 0), np.float32),
            np.ascontiguousarray(T_color_camera[:3, :3]),
            T_color_camera[:3, 3].copy(),
            np.array([depth.fx, depth.fy, depth.cx, depth.cy]),
            calibration.is_registered,
            float(self._noise.near_m),
            float(self._noise.far_m),
            _DEPTH_JUMP * max(1.0, _DEPTH_JUMP_FOCAL_PX / depth.fx),
        )
        self._orb, self._faint = (
            cv2.ORB.create(settings.candidates, PYRAMID_SCALE, PYRAMID_LEVELS, fastThreshold=threshold)
            for threshold in (_FAST_THRESHOLD, _FAINT_THRESHOLD)
        )

    def extract(self, frame: RgbdFrame) -> Features:
        """The features of a frame, before the rolling-shutter correction (see `straighten`)."""
        if self._straight is not None:
            depth_m = cv2.remap(frame.depth_m, *self._straight, cv2.INTER_NEAREST)
            frame = replace(frame, depth_m=np.asarray(depth_m, np.float32))
        px, level, descriptors = self._keypoints(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY))
        xy = self._color.normalise(px)
        depth_m = depth_at_keypoints(self._depth._replace(depth_m=frame.depth_m), px, xy)
        sigma_px = np.hypot(keypoint_sigma_px(level), self._color_sigma_px)
        sigma_m = self._noise.constant_m + self._noise.quadratic_per_m * depth_m**2
        return Features(frame.stamp_s, px, level, descriptors, xy, depth_m, sigma_px, sigma_m)

    def _keypoints(self, grey: np.ndarray) -> tuple[FloatArray, IntArray, UInt64Array]:
        """Pixels (N, 2), pyramid levels (N,) and descriptors (N, 4), spread over the image."""
        candidates = self._orb.detect(grey, None)
        if len(candidates) < self._settings.keypoints // 2:
            candidates = self._faint.detect(grey, None)
        px = _pixels_of(candidates)
        strength = np.array([keypoint.response for keypoint in candidates], float)
        chosen = spread(px, strength, _SPREAD_CELL_PX, self._settings.keypoints)
        kept, descriptors = self._orb.compute(grey, [candidates[i] for i in chosen])
        level = np.array([keypoint.octave for keypoint in kept], np.int64)
        words = np.zeros((0, 4), np.uint64) if len(kept) == 0 else np.ascontiguousarray(descriptors).view(np.uint64)
        # OpenCV scales pixel indices of a level by the scale factor. The exact scale follows from the whole number of
        # pixels of a level, and the centre of pixel 0 moves too: 1.4 px at the far edge of 640.
        size = np.array([grey.shape[1], grey.shape[0]])
        scale = PYRAMID_SCALE ** level[:, None]
        px = np.asarray((_pixels_of(kept) / scale + 0.5) * (size / np.rint(size / scale)) - 0.5)
        return px, level, words


def _pixels_of(keypoints: Sequence[cv2.KeyPoint]) -> FloatArray:
    """Pixels (N, 2) of keypoints."""
    return np.array(cv2.KeyPoint.convert(keypoints), float).reshape(-1, 2)


def keypoint_sigma_px(level: ArrayLike) -> FloatArray:
    """Standard deviation (...) of a keypoint's pixel, detected on a pyramid level (...)."""
    return np.asarray(_SIGMA_PX * _SIGMA_GROWTH ** np.asarray(level, float))


def spread(px: FloatArray, strength: FloatArray, cell_px: int, wanted: int) -> IntArray:
    """Indices of at most `wanted` keypoints (N, 2): the strongest of each cell, then the second strongest, …"""
    if len(px) <= wanted:
        return np.arange(len(px))
    column, row = np.asarray(px // cell_px, np.int64).T
    cell = row * (column.max() + 1) + column
    order = np.lexsort((-strength, cell))
    first_of_cell = np.searchsorted(cell[order], cell[order], side="left")
    rank = np.empty(len(px), np.int64)
    rank[order] = np.arange(len(px)) - first_of_cell
    return np.lexsort((-strength, rank))[:wanted]


def straighten(raw: Features, twist: FloatArray, rolling_shutter_s: float, height: int) -> Features:
    """The features corrected for rolling shutter, to the exposure time of the middle row.

    Args:
        raw: features as detected.
        twist: (6,) the camera's velocity (v, ω) per second in its own frame, which moves each point to the time of
            the middle row (Ringaby & Forssén, ICCV 2011, for Kinect scans).
        rolling_shutter_s: time from the first row to the last.
        height: number of rows.
    """
    if rolling_shutter_s == 0 or not twist.any():
        return raw
    late_s = (raw.px[:, 1] / height - 0.5) * rolling_shutter_s
    has_depth = raw.depth_m > 0
    depth_m = np.where(has_depth, raw.depth_m, _TYPICAL_DEPTH_M)
    p = np.column_stack([raw.xy * depth_m[:, None], depth_m])
    moved = p + late_s[:, None] * (twist[:3] + np.cross(twist[3:], p))
    return replace(raw, xy=moved[:, :2] / moved[:, 2:], depth_m=np.where(has_depth, moved[:, 2], 0.0))


def maps_without_lens(camera: PinholeCamera) -> tuple[Float32Array, Float32Array]:
    """Column and row (h, w) in a camera's images of each pixel of the undistorted image, for `cv2.remap`."""
    size = (camera.width, camera.height)
    maps = cv2.initUndistortRectifyMap(camera.K, np.array(camera.distortion), None, camera.K, size, cv2.CV_32FC1)
    return np.asarray(maps[0], np.float32), np.asarray(maps[1], np.float32)


class KeyframeMaker:
    """Makes keyframes of the frames of one camera, as an ideal camera at the pose of the depth camera sees them."""

    def __init__(self, calibration: Calibration) -> None:
        self._color, self._depth = calibration.cameras
        self._T_color_camera = calibration.T_color_camera
        self._rays = None if calibration.is_registered else self._depth.rays()
        self._maps = maps_without_lens(self._depth) if self._depth.has_distortion else None

    def keyframe(self, frame: RgbdFrame, features: Features) -> Keyframe:
        """The keyframe of a frame and its features; compression takes as long as tracking a frame."""
        depth_m, grey = frame.depth_m, np.asarray(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), np.uint8)
        if self._rays is not None:
            px, is_inside = self._color.project(se3.apply(self._T_color_camera, (self._rays * depth_m[..., None])))
            px = np.where((is_inside & (depth_m > 0))[..., None], px, -2.0).astype(np.float32)
            grey = np.asarray(cv2.remap(grey, px[..., 0], px[..., 1], cv2.INTER_LINEAR), np.uint8)
        elif self._maps is not None:
            depth_m = np.asarray(cv2.remap(depth_m, *self._maps, cv2.INTER_NEAREST), np.float32)
            grey = np.asarray(cv2.remap(grey, *self._maps, cv2.INTER_LINEAR), np.uint8)
        depth = self._depth
        intrinsics = np.array([depth.fx, depth.fy, depth.cx, depth.cy])
        p_camera = se3.apply(se3.invert(self._T_color_camera), features.points)
        points = np.where(features.has_depth[:, None], p_camera, 0.0)
        return Keyframe.of_images(
            frame.stamp_s,
            intrinsics,
            depth_m,
            grey.astype(np.float32),
            KeyframeFeatures(features.px, points, features.descriptors),
        )


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPixels:
    """Matched pixels of a frame and its reference.

    Attributes:
        reference_stamp_s: time of the reference frame, seconds.
        px, reference_px: (N, 2) in the two colour images.
        is_inlier: (N,) mask of pairs that agree with the estimated motion.
    """

    reference_stamp_s: float
    px: FloatArray
    reference_px: FloatArray
    is_inlier: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class FeatureEstimate(CameraEstimate):
    """The estimate of feature odometry at a frame, with its matched pixels.

    Attributes:
        matched: pixels matched with an earlier frame; None at a start or a failure.
    """

    matched: MatchedPixels | None = field(default=None, kw_only=True)


@dataclass(frozen=True, slots=True, eq=False)
class KeypointView:
    """A frame with a known pose.

    Attributes:
        features: its keypoints.
        T_map_color: (4, 4) pose of the colour camera.
        covariance: (6, 6) of the left perturbation of that pose.
        landmark: (N,) number of the landmark that each keypoint shows, -1 for none.
        keyframe: the keyframe that the view moves with, or None.
    """

    features: Features
    T_map_color: FloatArray
    covariance: FloatArray
    landmark: IntArray
    keyframe: KeyframeId | None = None

    def moved(self, T_new_old: FloatArray) -> KeypointView:
        """The same after keyframes moved in the map by (K, 4, 4)."""
        if self.keyframe is None:
            return self
        T, Ad = T_new_old[self.keyframe], se3.adjoint(T_new_old[self.keyframe])
        return replace(self, T_map_color=se3.renormalized(T @ self.T_map_color), covariance=Ad @ self.covariance @ Ad.T)


# The view of a keyframe is near if the points at this distance before both cameras are; chosen.
_VIEW_DISTANCE_M = 2.0


class LandmarkMap:
    """The local map of landmarks that frames are aligned with.

    A landmark stays as long as a keyframe of the map shows it; numbers are never reused.

    Args:
        kept_keyframes: largest number of keyframes; the oldest are dropped first.

    Attributes:
        keyframes: oldest first.
        numbers: (L,) of the landmarks, increasing.
        points: (L, 3) in the map, metres.
        descriptors: (L, 4) of the last observation.
        sightings: (L,) number of observations.
        made_by: (L,) the keyframes that created them; landmarks move with these.
    """

    def __init__(self, kept_keyframes: int) -> None:
        self.keyframes: list[KeypointView] = []
        self.numbers: IntArray = np.zeros(0, np.int64)
        self.points: FloatArray = np.zeros((0, 3))
        self.descriptors: UInt64Array = np.zeros((0, 4), np.uint64)
        self.sightings: FloatArray = np.zeros(0)
        self.made_by: IntArray = np.zeros(0, np.int64)
        self._weight: FloatArray = np.zeros(0)
        self._last_keyframe: IntArray = np.zeros(0, np.int64)
        self._kept_keyframes = kept_keyframes
        self._forgotten = 0
        self._next_number = 0

    def add_keyframe(self, view: KeypointView, number: KeyframeId) -> KeypointView:
        """Add a view as a keyframe and return it; its keypoints with depth that show no landmark become landmarks."""
        features, landmark = view.features, view.landmark.copy()
        landmark[landmark >= 0] = np.where(self.holds(landmark[landmark >= 0]), landmark[landmark >= 0], -1)
        place = self._forgotten + len(self.keyframes)
        self._last_keyframe[np.searchsorted(self.numbers, landmark[landmark >= 0])] = place
        new = np.flatnonzero((landmark < 0) & features.has_depth)
        landmark[new] = self._next_number + np.arange(len(new))
        self._next_number += len(new)
        self.numbers = np.concatenate([self.numbers, landmark[new]])
        self.points = np.concatenate([self.points, se3.apply(view.T_map_color, features.points[new])])
        self.descriptors = np.concatenate([self.descriptors, features.descriptors[new]])
        self.sightings = np.concatenate([self.sightings, np.ones(len(new))])
        self._weight = np.concatenate([self._weight, features.sigma_m[new] ** -2.0])
        self._last_keyframe = np.concatenate([self._last_keyframe, np.full(len(new), place)])
        self.made_by = np.concatenate([self.made_by, np.full(len(new), number)])
        keyframe = replace(view, landmark=landmark, keyframe=number)
        self.keyframes.append(keyframe)
        if len(self.keyframes) > self._kept_keyframes:
            self.keyframes.pop(0)
            self._forgotten += 1
            kept = self._last_keyframe >= self._forgotten
            self.numbers, self.points, self.descriptors = self.numbers[kept], self.points[kept], self.descriptors[kept]
            self.sightings, self._weight = self.sightings[kept], self._weight[kept]
            self._last_keyframe, self.made_by = self._last_keyframe[kept], self.made_by[kept]
        return keyframe

    def forget_keypoints(self) -> None:
        """Drop the keypoints of all keyframes but the last; only their poses remain."""
        if len(self.keyframes) > 1:
            before = self.keyframes[-2]
            self.keyframes[-2] = replace(before, features=before.features.some(0), landmark=before.landmark[:0].copy())

    def move(self, T_new_old: FloatArray) -> None:
        """Move landmarks and views with their keyframes, which moved in the map by (K, 4, 4)."""
        self.keyframes[:] = [keyframe.moved(T_new_old) for keyframe in self.keyframes]
        self.points = se3.apply(T_new_old[self.made_by], self.points[:, None])[:, 0]

    def near(self, T_map_color: FloatArray, count: int) -> IntArray:
        """Numbers (M,) of landmarks last seen by the `count` keyframes whose view is nearest to a pose (4, 4)."""
        if len(self.keyframes) <= count:
            return self.numbers
        views = np.array([keyframe.T_map_color for keyframe in self.keyframes])
        ahead = views[:, :3, 3] + _VIEW_DISTANCE_M * views[:, :3, 2]
        here = T_map_color[:3, 3] + _VIEW_DISTANCE_M * T_map_color[:3, 2]
        chosen = np.zeros(len(self.keyframes), bool)
        chosen[np.argsort(np.linalg.norm(ahead - here, axis=1), kind="stable")[:count]] = True
        return self.numbers[chosen[self._last_keyframe - self._forgotten]]

    def get(self, numbers: IntArray) -> tuple[FloatArray, UInt64Array, FloatArray]:
        """Points (M, 3), descriptors (M, 4) and sightings (M,) of held landmarks (M,)."""
        rows = np.searchsorted(self.numbers, numbers)
        return self.points[rows], self.descriptors[rows], self.sightings[rows]

    def holds(self, numbers: IntArray) -> BoolArray:
        """(M,) mask of landmarks that are in the map."""
        return np.isin(numbers, self.numbers, assume_unique=True)

    def see_again(self, numbers: IntArray, features: Features, seen: IntArray, T_map_color: FloatArray) -> None:
        """Average landmarks (M,) with the points of keypoints `seen` (M,), each weighted by 1/σ_z²."""
        rows = np.searchsorted(self.numbers, numbers)
        self.descriptors[rows] = features.descriptors[seen]
        self.sightings[rows] += 1
        lifted = features.depth_m[seen] > 0
        rows, seen = rows[lifted], seen[lifted]
        weight = features.sigma_m[seen] ** -2.0
        total = self._weight[rows] + weight
        p_map = se3.apply(T_map_color, features.points[seen])
        self.points[rows] += (weight / total)[:, None] * (p_map - self.points[rows])
        self._weight[rows] = total


@dataclass(frozen=True, slots=True, eq=False)
class Fix:
    """A located frame.

    Attributes:
        view: the frame with its pose.
        motion: of the colour camera against the reference that located it.
        matched: pixels matched with that reference.
    """

    view: KeypointView
    motion: MotionEstimate
    matched: MatchedPixels


def velocity_of(before: KeypointView, now: KeypointView) -> FloatArray:
    """Mean velocity (6,), (v, ω) in the colour camera's own frame a second, between two views; 0 over a long gap."""
    seconds = now.features.stamp_s - before.features.stamp_s
    if not 0 < seconds <= LONGEST_STEP_S:
        return np.zeros(6)
    return se3.twist_between(before.T_map_color, now.T_map_color, seconds)


# Number of point pairs that must agree on a motion, and its largest standard deviations; chosen.
MIN_INLIERS, _MAX_SIGMA_M, _MAX_SIGMA_RAD = 15, 0.10, 0.05
# Largest number of different bits of descriptors of one point, and the share of those of the second best descriptor
# nearby that the best must stay below, because textures repeat; chosen.
MAX_HAMMING, _DISTINCT_SHARE = 64, 0.9
# Search radius around a landmark's predicted pixel, and its factor where only the motion is predicted; chosen.
_SEARCH_RADIUS_PX, _PRIOR_RADII = 12.0, 3.0
# If fewer of the reference's points are found, the predicted motion is wrong, and all keypoints are searched; chosen.
_PRIOR_SHARE = 0.25


class _Tracker:
    """Base of `ViewTracker` and `MapTracker`."""

    def __init__(self, calibration: Calibration) -> None:
        self._color, _ = calibration.cameras
        self._shutter_s = calibration.rolling_shutter_s

    def _project(self, p_color: FloatArray) -> FloatArray:
        """Undistorted pixels (N, 2) of points (N, 3); NaN outside the image or behind the camera."""
        color = self._color
        return np.asarray(project(p_color, color.fx, color.fy, color.cx, color.cy, color.width, color.height))

    def _pixels(self, features: Features) -> FloatArray:
        """Pixels (N, 2) without lens distortion and rolling shutter."""
        return features.xy * (self._color.fx, self._color.fy) + (self._color.cx, self._color.cy)

    def _judge(self, found: Alignment) -> Reason | None:
        """The reason to reject an alignment, or None."""
        if found.inliers < MIN_INLIERS:
            return Reason.TOO_FEW_INLIERS
        variance_m = np.linalg.eigvalsh(found.covariance[:3, :3])[-1]
        variance_rad = np.linalg.eigvalsh(found.covariance[3:, 3:])[-1]
        weak = variance_m > _MAX_SIGMA_M**2 or variance_rad > _MAX_SIGMA_RAD**2
        return Reason.DEGENERATE if weak else None


class ViewTracker(_Tracker):
    """Aligns a frame with one earlier view, as Zhang does."""

    def __init__(self, calibration: Calibration, watch: Stopwatch, seed: int) -> None:
        super().__init__(calibration)
        self._watch, self._seed = watch, seed

    def track(
        self, raw: Features, reference: KeypointView, velocity: FloatArray, expected: FloatArray | None, trial: int
    ) -> Fix | MotionEstimate:
        """The frame located by its motion against `reference`, or the reason of the failure.

        Keypoints are searched around the pixels that the predicted motion gives, then, if that fails, everywhere.

        Args:
            raw: the frame's features, not corrected for rolling shutter.
            reference: a view with a pose.
            velocity: (6,) predicted velocity of the colour camera at the frame.
            expected: (4, 4) predicted T_reference_current of the colour camera; default by the velocity.
            trial: changes RANSAC's seed from frame to frame.
        """
        seconds = raw.stamp_s - reference.features.stamp_s
        if expected is None and velocity.any() and 0 < seconds <= LONGEST_STEP_S:
            expected = se3.exp(velocity * seconds)
        found = self._located(raw, reference, velocity, expected, trial)
        if expected is None or isinstance(found, Fix):
            return found
        return self._located(raw, reference, velocity, None, trial)

    def _located(
        self, raw: Features, reference: KeypointView, velocity: FloatArray, expected: FloatArray | None, trial: int
    ) -> Fix | MotionEstimate:
        features = straighten(raw, velocity, self._shutter_s, self._color.height)
        with self._watch.stage("match"):
            matches = self._match(features, reference.features, expected)
        with self._watch.stage("align"):
            pairs = self._pairs(features, reference.features, matches)
            T = find_motion(pairs, self._seed * 1_000_003 + trial, MIN_INLIERS)
            if isinstance(T, Reason):
                return MotionEstimate.failed(T, len(pairs))
            found = refine_motion(pairs, T)
            if self._shutter_s:
                T_map_color = reference.T_map_color @ se3.invert(found.T_current_reference)
                guess = KeypointView(raw, T_map_color, reference.covariance, reference.landmark)
                better = velocity_of(reference, guess)
                better = better if better.any() else velocity
                features = straighten(raw, better, self._shutter_s, self._color.height)
                pairs = self._pairs(features, reference.features, matches)
                found = refine_motion(pairs, found.T_current_reference)
        if reason := self._judge(found):
            return MotionEstimate.failed(reason, len(pairs), found.inliers)
        return self._fix(features, reference, matches, found)

    def _match(self, features: Features, reference: Features, expected: FloatArray | None) -> Matches:
        """Matches (reference, current) of keypoints; the reference's have depth."""
        lifted = np.flatnonzero(reference.depth_m > 0)
        descriptors, matches = reference.descriptors[lifted], None
        if expected is not None:
            expected_px = self._project(se3.apply(se3.invert(expected), reference.points[lifted]))
            radius_px = _PRIOR_RADII * _SEARCH_RADIUS_PX
            matches = match_near(expected_px, descriptors, self._pixels(features), features.descriptors, radius_px)
            matches = matches if len(matches.first) > _PRIOR_SHARE * len(lifted) else None
        if matches is None:
            matches = match_all(descriptors, features.descriptors)
        return Matches(lifted[matches.first], matches.second)

    def _pairs(self, features: Features, reference: Features, matches: Matches) -> PointPairs:
        """Point pairs of matches; the variances of both measurements add."""
        i, j = matches
        sigma_px = np.hypot(reference.sigma_px[i], features.sigma_px[j])
        sigma_m = np.hypot(reference.sigma_m[i], features.sigma_m[j])
        return PointPairs(reference.points[i], features.xy[j], features.depth_m[j], sigma_px / self._color.fx, sigma_m)

    def _fix(self, features: Features, reference: KeypointView, matches: Matches, found: Alignment) -> Fix:
        T_reference_current = se3.invert(found.T_current_reference)
        Ad = se3.adjoint(T_reference_current)
        motion_covariance = Ad @ found.covariance @ Ad.T
        Ad_map = se3.adjoint(reference.T_map_color)
        view = KeypointView(
            features,
            reference.T_map_color @ T_reference_current,
            reference.covariance + Ad_map @ motion_covariance @ Ad_map.T,
            np.full(len(features), -1),
            reference.keyframe,
        )
        motion = MotionEstimate(T_reference_current, motion_covariance, None, len(matches.first), found.inliers)
        px, reference_px = features.px[matches.second], reference.features.px[matches.first]
        return Fix(view, motion, MatchedPixels(reference.features.stamp_s, px, reference_px, found.is_inlier))


class MapTracker(_Tracker):
    """Aligns a frame with an approximate pose with the landmarks of the nearest `local_keyframes`."""

    def __init__(self, calibration: Calibration, local_keyframes: int) -> None:
        super().__init__(calibration)
        self._local_keyframes = local_keyframes

    def track(self, raw: Features, rough: Fix, last: KeypointView, landmarks: LandmarkMap) -> Fix | MotionEstimate:
        """The frame located in the map, starting at a rough fix, or the reason of the failure."""
        numbers, pairs, seen = self._find_landmarks(rough.view, landmarks)
        if len(pairs) < MIN_INLIERS:
            return MotionEstimate.failed(Reason.TOO_FEW_MATCHES, len(pairs))
        found = refine_motion(pairs, se3.invert(rough.view.T_map_color))
        features = rough.view.features
        if self._shutter_s:
            guess = KeypointView(raw, se3.invert(found.T_current_reference), last.covariance, last.landmark)
            velocity = velocity_of(last, guess)
            if velocity.any():
                features = straighten(raw, velocity, self._shutter_s, self._color.height)
            pairs = self._pairs(numbers, features, seen, landmarks)
            found = refine_motion(pairs, found.T_current_reference)
        if reason := self._judge(found):
            return MotionEstimate.failed(reason, len(pairs), found.inliers)
        landmark = np.full(len(features), -1)
        landmark[seen[found.is_inlier]] = numbers[found.is_inlier]
        return self._fix(features, landmark, found, rough, len(pairs), landmarks.keyframes[-1])

    def _find_landmarks(self, rough: KeypointView, landmarks: LandmarkMap) -> tuple[np.ndarray, PointPairs, np.ndarray]:
        """Numbers (M,) of matched landmarks, their point pairs, and the keypoints (M,) that show them."""
        numbers = landmarks.near(rough.T_map_color, self._local_keyframes)
        points, descriptors, _ = landmarks.get(numbers)
        expected_px = self._project(se3.apply(se3.invert(rough.T_map_color), points))
        visible = np.flatnonzero(np.isfinite(expected_px[:, 0]))
        features = rough.features
        matches = match_near(
            expected_px[visible],
            descriptors[visible],
            self._pixels(features),
            features.descriptors,
            _SEARCH_RADIUS_PX,
        )
        numbers = numbers[visible[matches.first]]
        return numbers, self._pairs(numbers, features, matches.second, landmarks), matches.second

    def _pairs(self, numbers: np.ndarray, features: Features, seen: np.ndarray, landmarks: LandmarkMap) -> PointPairs:
        """Point pairs of landmarks and keypoints; a landmark seen n times has the variance of a mean of n."""
        points, _, sightings = landmarks.get(numbers)
        growth = np.sqrt(1 + 1 / sightings)
        sigma_xy, sigma_m = growth * features.sigma_px[seen] / self._color.fx, growth * features.sigma_m[seen]
        return PointPairs(points, features.xy[seen], features.depth_m[seen], sigma_xy, sigma_m)

    def _fix(
        self,
        features: Features,
        landmark: np.ndarray,
        found: Alignment,
        rough: Fix,
        matches: int,
        keyframe: KeypointView,
    ) -> Fix:
        """The fix of an alignment; its covariance is that of the last keyframe plus that of the alignment."""
        T_map_color = se3.invert(found.T_current_reference)
        Ad = se3.adjoint(T_map_color)
        in_map = Ad @ found.covariance @ Ad.T
        view = KeypointView(features, T_map_color, keyframe.covariance + in_map, landmark, rough.view.keyframe)
        T_keyframe_map = se3.invert(keyframe.T_map_color)
        Ad_keyframe = se3.adjoint(T_keyframe_map)
        covariance = Ad_keyframe @ in_map @ Ad_keyframe.T
        motion = MotionEstimate(T_keyframe_map @ T_map_color, covariance, None, matches, found.inliers)
        return Fix(view, motion, rough.matched)


# Cell size of the grid that `match_near` searches.
_CELL_PX = 16


class Matches(NamedTuple):
    """M pairs: indices (M,) into the first set and (M,) into the second."""

    first: IntArray
    second: IntArray


def match_all(first: UInt64Array, second: UInt64Array, max_hamming: int = MAX_HAMMING) -> Matches:
    """Pairs of descriptors (N, 4) and (M, 4), mutual nearest neighbours within `max_hamming` bits (Zhang, 3.1)."""
    nearest, distance, nearest_back = nearest_both_ways(first, second)
    i = np.flatnonzero((nearest >= 0) & (distance <= max_hamming))
    i = i[nearest_back[nearest[i]] == i]
    return Matches(i, nearest[i])


def match_near(
    expected_px: FloatArray,
    expected: UInt64Array,
    px: FloatArray,
    descriptors: UInt64Array,
    radius_px: float,
    max_hamming: int = MAX_HAMMING,
) -> Matches:
    """Pairs of predicted keypoints (N, 2), (N, 4) and detected ones (M, 2), (M, 4) within a radius, each used once.

    Predicted pixels that are NaN match nothing.
    """
    if len(px) == 0 or len(expected_px) == 0:
        return Matches(np.zeros(0, np.int64), np.zeros(0, np.int64))
    columns, rows = np.maximum(px.max(axis=0), 0).astype(np.int64) // _CELL_PX + 1
    cell = px.clip(0).astype(np.int64) // _CELL_PX
    number = cell[:, 1] * columns + cell[:, 0]
    order = np.argsort(number, kind="stable")
    starts = np.searchsorted(number[order], np.arange(columns * rows + 1))
    seen = Cells(px, descriptors, order, starts, int(columns), int(rows), _CELL_PX)
    found = nearest_within(expected_px, expected, seen, radius_px, max_hamming, _DISTINCT_SHARE)
    i = np.flatnonzero(found >= 0)
    return Matches(i, found[i])


@dataclass(frozen=True, slots=True, eq=False)
class PointPairs:
    """N points in a reference frame with their observations in the current frame.

    Attributes:
        p_reference: (N, 3) metres.
        xy: (N, 2) observed on the plane z = 1.
        depth_m: (N,) observed, 0 where unknown.
        sigma_xy: (N,) standard deviation of `xy`.
        sigma_m: (N,) standard deviation of `depth_m`.
    """

    p_reference: FloatArray
    xy: FloatArray
    depth_m: FloatArray
    sigma_xy: FloatArray
    sigma_m: FloatArray

    def __len__(self) -> int:
        return len(self.p_reference)

    def observed(self) -> Pairs:
        """The same for kernels, with 1/σ in place of σ; it is 0 for unknown depth."""
        scale_m = np.where(self.depth_m > 0, 1 / np.maximum(self.sigma_m, 1e-6), 0.0)
        return Pairs(self.p_reference, self.xy, self.depth_m, 1 / self.sigma_xy, scale_m)


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The result of `refine_motion`.

    Attributes:
        T_current_reference: (4, 4).
        covariance: (6, 6) of the left perturbation (v, ω) of `T_current_reference`.
        is_inlier: (N,) mask of pairs that agree with it.
        inliers: number of them.
    """

    T_current_reference: FloatArray
    covariance: FloatArray
    is_inlier: BoolArray
    inliers: int


# Most iterations of RANSAC, fewer if most pairs agree, and χ² of a pair that agrees with a hypothesis: large, because
# three noisy points make a rough one; chosen.
_RANSAC_ITERATIONS, _RANSAC_CHI2 = 300, 36.0
# Least side in metres of the three points of a hypothesis, to determine a rotation; by how much, in metres and as a
# share of its length, a side may differ between both frames if the points correspond; chosen.
_TRIANGLES = Triangles(0.05, 0.05, 0.03)
# χ² of a pair that agrees with a motion, of three numbers, 99.9 %, and most Gauss-Newton steps.
INLIER_CHI2, _REFINEMENT_STEPS = 16.3, 8


def find_motion(
    pairs: PointPairs, seed: int, min_inliers: int = MIN_INLIERS, iterations: int = _RANSAC_ITERATIONS
) -> FloatArray | Reason:
    """T_current_reference (4, 4) by RANSAC over triples of pairs with depth, or the reason of the failure."""
    usable = pairs.depth_m > 0
    if np.count_nonzero(usable) < min_inliers:
        return Reason.TOO_FEW_MATCHES
    with_depth = Pairs(*[values[usable] for values in pairs.observed()])
    R, t, agreeing = ransac(with_depth, _TRIANGLES, _RANSAC_CHI2, iterations, seed)
    return se3.from_parts(R, t) if agreeing >= min_inliers else Reason.TOO_FEW_INLIERS


def refine_motion(pairs: PointPairs, T_current_reference: FloatArray) -> Alignment:
    """The motion that minimises the robust, noise-weighted distance of all pairs, from an initial guess (4, 4).

    Pixel and depth are each weighted by their σ (depth's grows with z²), which weights the 3D–3D distance of Zhang's
    section 3.2 by the elongated covariance of points. Pairs without depth count by their pixels alone.
    """
    R, t = np.ascontiguousarray(T_current_reference[:3, :3]), T_current_reference[:3, 3].copy()
    R, t, H, squares = refine(R, t, pairs.observed(), INLIER_CHI2, _REFINEMENT_STEPS)
    # Unconstrained directions get a variance of 10⁶ (m², rad²) rather than infinity.
    values, vectors = np.linalg.eigh(H)
    covariance = np.asarray((vectors / np.maximum(values, 1e-6)) @ vectors.T)
    is_inlier = squares < INLIER_CHI2
    return Alignment(se3.from_parts(R, t), covariance, is_inlier, int(np.count_nonzero(is_inlier)))


class Pace:
    """Predicts the camera's motion at constant velocity, for when the wheels slip."""

    def __init__(self) -> None:
        self._before: tuple[float, FloatArray] | None = None
        self._last: tuple[float, FloatArray] | None = None

    def add(self, stamp_s: float, T_map_camera: FloatArray) -> None:
        """Add the pose (4, 4) of a tracked frame."""
        self._before, self._last = self._last, (stamp_s, T_map_camera)

    def moved(self, T_new_old: FloatArray) -> None:
        """Apply a correction (4, 4) of the map, from the left."""
        self._before, self._last = (pose and (pose[0], T_new_old @ pose[1]) for pose in (self._before, self._last))

    def expect(self, stamp_s: float) -> FloatArray | None:
        """Return T_last_current (4, 4) at constant velocity; None if the velocity is unknown or too old."""
        if self._before is None or self._last is None:
            return None
        seconds, since_s = self._last[0] - self._before[0], stamp_s - self._last[0]
        if not (0 < seconds <= LONGEST_STEP_S and 0 < since_s <= LONGEST_STEP_S):
            return None
        return se3.exp(se3.log(se3.invert(self._before[1]) @ self._last[1]) * (since_s / seconds))
