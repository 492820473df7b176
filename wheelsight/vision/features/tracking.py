"""Pose of a frame by its keypoints, relative to an earlier view or to a local map of landmarks. Matching, RANSAC
alignment and refinement follow.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import CameraEstimate, MotionEstimate, Reason
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, se3
from wheelsight.core.geometry.arrays import UInt64Array
from wheelsight.core.keyframes import KeyframeId
from wheelsight.vision.features.extraction import Features, FeatureSettings, straighten
from wheelsight.vision.features.feature_kernels import (
    Cells,
    Pairs,
    Triangles,
    nearest_both_ways,
    nearest_within,
    project,
    ransac,
    refine,
)
from wheelsight.vision.tracking_state import Stopwatch, twist_between


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
class View:
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

    def moved(self, T_new_old: FloatArray) -> View:
        """The same after keyframes moved in the map by (K, 4, 4)."""
        if self.keyframe is None:
            return self
        T, Ad = T_new_old[self.keyframe], se3.adjoint(T_new_old[self.keyframe])
        return replace(self, T_map_color=se3.renormalized(T @ self.T_map_color), covariance=Ad @ self.covariance @ Ad.T)


class LandmarkMap:
    """The local map of landmarks that frames are aligned with.

    A landmark stays as long as a keyframe of the map shows it; numbers are never reused.

    Attributes:
        keyframes: oldest first.
        numbers: (L,) of the landmarks, increasing.
        points: (L, 3) in the map, metres.
        descriptors: (L, 4) of the last observation.
        sightings: (L,) number of observations.
        made_by: (L,) the keyframes that created them; landmarks move with these.
    """

    def __init__(self, settings: FeatureSettings) -> None:
        self.keyframes: list[View] = []
        self.numbers: IntArray = np.zeros(0, np.int64)
        self.points: FloatArray = np.zeros((0, 3))
        self.descriptors: UInt64Array = np.zeros((0, 4), np.uint64)
        self.sightings: FloatArray = np.zeros(0)
        self.made_by: IntArray = np.zeros(0, np.int64)
        self._weight: FloatArray = np.zeros(0)
        self._last_keyframe: IntArray = np.zeros(0, np.int64)
        self._settings = settings
        self._forgotten = 0
        self._next_number = 0

    def add_keyframe(self, view: View, number: KeyframeId) -> View:
        """Add a view as a keyframe and return it; its keypoints with depth that show no landmark become landmarks."""
        features, landmark = view.features, view.landmark.copy()
        landmark[landmark >= 0] = np.where(self.holds(landmark[landmark >= 0]), landmark[landmark >= 0], -1)
        place = self._forgotten + len(self.keyframes)
        self._last_keyframe[self._rows(landmark[landmark >= 0])] = place
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
        if len(self.keyframes) > self._settings.kept_keyframes:
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
        distance_m = self._settings.view_distance_m
        ahead = views[:, :3, 3] + distance_m * views[:, :3, 2]
        here = T_map_color[:3, 3] + distance_m * T_map_color[:3, 2]
        chosen = np.zeros(len(self.keyframes), bool)
        chosen[np.argsort(np.linalg.norm(ahead - here, axis=1), kind="stable")[:count]] = True
        return self.numbers[chosen[self._last_keyframe - self._forgotten]]

    def get(self, numbers: IntArray) -> tuple[FloatArray, UInt64Array, FloatArray]:
        """Points (M, 3), descriptors (M, 4) and sightings (M,) of held landmarks (M,)."""
        rows = self._rows(numbers)
        return self.points[rows], self.descriptors[rows], self.sightings[rows]

    def holds(self, numbers: IntArray) -> BoolArray:
        """(M,) mask of landmarks that are in the map."""
        return np.isin(numbers, self.numbers, assume_unique=True)

    def see_again(self, numbers: IntArray, features: Features, seen: IntArray, T_map_color: FloatArray) -> None:
        """Average landmarks (M,) with the points of keypoints `seen` (M,), each weighted by 1/σ_z²."""
        rows = self._rows(numbers)
        self.descriptors[rows] = features.descriptors[seen]
        self.sightings[rows] += 1
        lifted = features.has_depth[seen]
        rows, seen = rows[lifted], seen[lifted]
        weight = features.sigma_m[seen] ** -2.0
        total = self._weight[rows] + weight
        p_map = se3.apply(T_map_color, features.points[seen])
        self.points[rows] += (weight / total)[:, None] * (p_map - self.points[rows])
        self._weight[rows] = total

    def _rows(self, numbers: IntArray) -> IntArray:
        return np.searchsorted(self.numbers, numbers)


@dataclass(frozen=True, slots=True, eq=False)
class Fix:
    """A located frame.

    Attributes:
        view: the frame with its pose.
        motion: of the colour camera against the reference that located it.
        matched: pixels matched with that reference.
    """

    view: View
    motion: MotionEstimate
    matched: MatchedPixels


def velocity_of(before: View, now: View, longest_s: float) -> FloatArray:
    """Mean velocity (6,), (v, ω) in the colour camera's own frame a second, between two views; 0 over a long gap."""
    seconds = now.features.stamp_s - before.features.stamp_s
    if not 0 < seconds <= longest_s:
        return np.zeros(6)
    return twist_between(before.T_map_color, now.T_map_color, seconds)


class _Tracker:
    """Base of `ViewTracker` and `MapTracker`."""

    def __init__(self, calibration: Calibration, settings: FeatureSettings) -> None:
        self._color, _ = calibration.cameras
        self._shutter_s = calibration.rolling_shutter_s
        self._settings = settings

    def straighten(self, raw: Features, velocity: FloatArray) -> Features:
        """A frame's features, corrected for rolling shutter by the camera's `velocity` (6,)."""
        return straighten(raw, velocity, self._shutter_s, self._color.height)

    def _project(self, p_color: FloatArray) -> FloatArray:
        """Undistorted pixels (N, 2) of points (N, 3); NaN outside the image or behind the camera."""
        color = self._color
        return np.asarray(project(p_color, color.fx, color.fy, color.cx, color.cy, color.width, color.height))

    def _pixels(self, features: Features) -> FloatArray:
        """Pixels (N, 2) without lens distortion and rolling shutter."""
        return features.xy * (self._color.fx, self._color.fy) + (self._color.cx, self._color.cy)

    def _judge(self, found: Alignment) -> Reason | None:
        """The reason to reject an alignment, or None."""
        if found.inliers < self._settings.min_inliers:
            return Reason.TOO_FEW_INLIERS
        variance_m = np.linalg.eigvalsh(found.covariance[:3, :3])[-1]
        variance_rad = np.linalg.eigvalsh(found.covariance[3:, 3:])[-1]
        weak = variance_m > self._settings.max_sigma_m**2 or variance_rad > self._settings.max_sigma_rad**2
        return Reason.DEGENERATE if weak else None


class ViewTracker(_Tracker):
    """Aligns a frame with one earlier view, as Zhang does."""

    def __init__(self, calibration: Calibration, settings: FeatureSettings, watch: Stopwatch) -> None:
        super().__init__(calibration, settings)
        self._watch = watch

    def track(
        self, raw: Features, reference: View, velocity: FloatArray, expected: FloatArray | None, trial: int
    ) -> Fix | MotionEstimate:
        """The frame located by its motion against `reference`, or the reason of the failure.

        Args:
            raw: the frame's features, not corrected for rolling shutter.
            reference: a view with a pose.
            velocity: (6,) predicted velocity of the colour camera at the frame.
            expected: (4, 4) predicted T_reference_current of the colour camera, or None.
            trial: changes RANSAC's seed from frame to frame.
        """
        features = self.straighten(raw, velocity)
        with self._watch.stage("match"):
            matches = self._match(features, reference.features, expected)
        with self._watch.stage("align"):
            pairs = self._pairs(features, reference.features, matches)
            seed = self._settings.seed * 1_000_003 + trial
            T = find_motion(pairs, self._settings, seed)
            if isinstance(T, Reason):
                return MotionEstimate.failed(T, len(pairs))
            found = refine_motion(pairs, T, self._settings)
            if self._shutter_s:
                T_map_color = reference.T_map_color @ se3.invert(found.T_current_reference)
                guess = View(raw, T_map_color, reference.covariance, reference.landmark)
                better = velocity_of(reference, guess, self._settings.longest_step_s)
                features = self.straighten(raw, better if better.any() else velocity)
                pairs = self._pairs(features, reference.features, matches)
                found = refine_motion(pairs, found.T_current_reference, self._settings)
        if reason := self._judge(found):
            return MotionEstimate.failed(reason, len(pairs), found.inliers)
        return self._fix(features, reference, matches, found)

    def _match(self, features: Features, reference: Features, expected: FloatArray | None) -> Matches:
        """Matches (reference, current) of keypoints; the reference's have depth."""
        lifted = np.flatnonzero(reference.has_depth)
        descriptors, limit = reference.descriptors[lifted], self._settings.max_hamming
        matches = None
        if expected is not None:
            expected_px = self._project(se3.apply(se3.invert(expected), reference.points[lifted]))
            radius_px = self._settings.prior_radii * self._settings.search_radius_px
            matches = match_near(
                expected_px, descriptors, self._pixels(features), features.descriptors, radius_px, self._settings
            )
            matches = matches if len(matches.first) > self._settings.prior_share * len(lifted) else None
        if matches is None:
            matches = match_all(descriptors, features.descriptors, limit)
        return Matches(lifted[matches.first], matches.second)

    def _pairs(self, features: Features, reference: Features, matches: Matches) -> PointPairs:
        """Point pairs of matches; the variances of both measurements add."""
        i, j = matches
        sigma_px = np.hypot(reference.sigma_px[i], features.sigma_px[j])
        sigma_m = np.hypot(reference.sigma_m[i], features.sigma_m[j])
        return PointPairs(reference.points[i], features.xy[j], features.depth_m[j], sigma_px / self._color.fx, sigma_m)

    def _fix(self, features: Features, reference: View, matches: Matches, found: Alignment) -> Fix:
        T_reference_current = se3.invert(found.T_current_reference)
        Ad = se3.adjoint(T_reference_current)
        motion_covariance = Ad @ found.covariance @ Ad.T
        Ad_map = se3.adjoint(reference.T_map_color)
        view = View(
            features,
            reference.T_map_color @ T_reference_current,
            reference.covariance + Ad_map @ motion_covariance @ Ad_map.T,
            np.full(len(features), -1),
            reference.keyframe,
        )
        inliers = found.inliers
        motion = MotionEstimate(T_reference_current, motion_covariance, None, len(matches.first), inliers)
        px, reference_px = features.px[matches.second], reference.features.px[matches.first]
        return Fix(view, motion, MatchedPixels(reference.features.stamp_s, px, reference_px, found.is_inlier))


class MapTracker(_Tracker):
    """Aligns a frame with an approximate pose with the landmarks around it."""

    def track(self, raw: Features, rough: Fix, last: View, landmarks: LandmarkMap) -> Fix | MotionEstimate:
        """The frame located in the map, starting at a rough fix, or the reason of the failure."""
        numbers, pairs, seen = self._find_landmarks(rough.view, landmarks)
        if len(pairs) < self._settings.min_inliers:
            return MotionEstimate.failed(Reason.TOO_FEW_MATCHES, len(pairs))
        found = refine_motion(pairs, se3.invert(rough.view.T_map_color), self._settings)
        features = rough.view.features
        if self._shutter_s:
            guess = View(raw, se3.invert(found.T_current_reference), last.covariance, last.landmark)
            velocity = velocity_of(last, guess, self._settings.longest_step_s)
            features = self.straighten(raw, velocity) if velocity.any() else features
            pairs = self._pairs(numbers, features, seen, landmarks)
            found = refine_motion(pairs, found.T_current_reference, self._settings)
        if reason := self._judge(found):
            return MotionEstimate.failed(reason, len(pairs), found.inliers)
        landmark = np.full(len(features), -1)
        landmark[seen[found.is_inlier]] = numbers[found.is_inlier]
        return self._fix(features, landmark, found, rough, len(pairs), landmarks.keyframes[-1])

    def _find_landmarks(self, rough: View, landmarks: LandmarkMap) -> tuple[np.ndarray, PointPairs, np.ndarray]:
        """Numbers (M,) of matched landmarks, their point pairs, and the keypoints (M,) that show them."""
        numbers = landmarks.near(rough.T_map_color, self._settings.local_keyframes)
        points, descriptors, _ = landmarks.get(numbers)
        expected_px = self._project(se3.apply(se3.invert(rough.T_map_color), points))
        visible = np.flatnonzero(np.isfinite(expected_px[:, 0]))
        features = rough.features
        matches = match_near(
            expected_px[visible],
            descriptors[visible],
            self._pixels(features),
            features.descriptors,
            self._settings.search_radius_px,
            self._settings,
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
        self, features: Features, landmark: np.ndarray, found: Alignment, rough: Fix, matches: int, keyframe: View
    ) -> Fix:
        """The fix of an alignment; its covariance is that of the last keyframe plus that of the alignment."""
        T_map_color = se3.invert(found.T_current_reference)
        Ad = se3.adjoint(T_map_color)
        in_map = Ad @ found.covariance @ Ad.T
        view = View(features, T_map_color, keyframe.covariance + in_map, landmark, rough.view.keyframe)
        T_keyframe_map = se3.invert(keyframe.T_map_color)
        Ad_keyframe = se3.adjoint(T_keyframe_map)
        covariance = Ad_keyframe @ in_map @ Ad_keyframe.T
        inliers = found.inliers
        motion = MotionEstimate(T_keyframe_map @ T_map_color, covariance, None, matches, inliers)
        return Fix(view, motion, rough.matched)


# Cell size of the grid that `match_near` searches.
_CELL_PX = 16


class Matches(NamedTuple):
    """M pairs: indices (M,) into the first set and (M,) into the second."""

    first: IntArray
    second: IntArray


def match_all(first: UInt64Array, second: UInt64Array, max_hamming: int) -> Matches:
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
    settings: FeatureSettings,
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
    found = nearest_within(expected_px, expected, seen, radius_px, settings.max_hamming, settings.distinct_share)
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
    """

    T_current_reference: FloatArray
    covariance: FloatArray
    is_inlier: BoolArray

    @property
    def inliers(self) -> int:
        """Number of pairs that agree."""
        return int(np.count_nonzero(self.is_inlier))


def find_motion(pairs: PointPairs, settings: FeatureSettings, seed: int) -> FloatArray | Reason:
    """T_current_reference (4, 4) by RANSAC over triples of pairs with depth, or the reason of the failure."""
    usable = pairs.depth_m > 0
    if np.count_nonzero(usable) < settings.min_inliers:
        return Reason.TOO_FEW_MATCHES
    with_depth = Pairs(*(values[usable] for values in pairs.observed()))
    rules = Triangles(settings.triangle_m, settings.triangle_change_m, settings.triangle_change_share)
    R, t, agreeing = ransac(with_depth, rules, settings.ransac_chi2, settings.ransac_iterations, seed)
    return se3.from_parts(R, t) if agreeing >= settings.min_inliers else Reason.TOO_FEW_INLIERS


def refine_motion(pairs: PointPairs, T_current_reference: FloatArray, settings: FeatureSettings) -> Alignment:
    """The motion that minimises the robust, noise-weighted distance of all pairs, from an initial guess (4, 4).

    Pixel and depth are each weighted by their σ (depth's grows with z²), which weights the 3D–3D distance of Zhang's
    section 3.2 by the elongated covariance of points. Pairs without depth count by their pixels alone.
    """
    R, t = np.ascontiguousarray(T_current_reference[:3, :3]), T_current_reference[:3, 3].copy()
    R, t, H, squares = refine(R, t, pairs.observed(), settings.inlier_chi2, settings.refinement_steps)
    # Unconstrained directions get a variance of 10⁶ (m², rad²) rather than infinity.
    values, vectors = np.linalg.eigh(H)
    covariance = np.asarray((vectors / np.maximum(values, 1e-6)) @ vectors.T)
    return Alignment(se3.from_parts(R, t), covariance, squares < settings.inlier_chi2)
