"""Where a frame is: aligned with an earlier view, then with the landmarks of near keyframes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import MotionEstimate, Reason
from wheelsight.geometry import FloatArray, se3
from wheelsight.odometry.features import _kernels
from wheelsight.odometry.features.alignment import Alignment, PointPairs, find_motion, refine_motion
from wheelsight.odometry.features.estimate import MatchedPixels
from wheelsight.odometry.features.extraction import Features, straighten
from wheelsight.odometry.features.landmarks import LandmarkMap, View
from wheelsight.odometry.features.matching import Matches, match_all, match_near
from wheelsight.odometry.features.settings import FeatureSettings
from wheelsight.odometry.stopwatch import Stopwatch
from wheelsight.odometry.velocity import twist_between


@dataclass(frozen=True, slots=True, eq=False)
class Fix:
    """A located frame.

    Attributes:
        view: the frame with its pose.
        motion: of the colour camera against the reference that gave the pose.
        matched: the pixels matched on the way.
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
    """What both ways of locating a frame share."""

    def __init__(self, calibration: Calibration, settings: FeatureSettings) -> None:
        self._color, _ = calibration.cameras
        self._shutter_s = calibration.rolling_shutter_s
        self._settings = settings

    def straighten(self, raw: Features, velocity: FloatArray) -> Features:
        """A frame's features as if all rows were exposed at once, of a camera moving at `velocity` (6,)."""
        return straighten(raw, velocity, self._shutter_s, self._color.height)

    def _project(self, p_color: FloatArray) -> FloatArray:
        """Undistorted pixels (N, 2) of points (N, 3); NaN outside the image or behind the camera."""
        color = self._color
        return np.asarray(_kernels.project(p_color, color.fx, color.fy, color.cx, color.cy, color.width, color.height))

    def _pixels(self, features: Features) -> FloatArray:
        """Undistorted, straightened pixels (N, 2)."""
        return features.xy * (self._color.fx, self._color.fy) + (self._color.cx, self._color.cy)

    def _judge(self, found: Alignment) -> Reason | None:
        """Why an alignment is no answer, or None."""
        if found.inliers < self._settings.min_inliers:
            return Reason.TOO_FEW_INLIERS
        variance_m = np.linalg.eigvalsh(found.covariance[:3, :3])[-1]
        variance_rad = np.linalg.eigvalsh(found.covariance[3:, 3:])[-1]
        weak = variance_m > self._settings.max_sigma_m**2 or variance_rad > self._settings.max_sigma_rad**2
        return Reason.DEGENERATE if weak else None


class ViewTracker(_Tracker):
    """Aligns a frame with one earlier view: the paper's way."""

    def __init__(self, calibration: Calibration, settings: FeatureSettings, watch: Stopwatch) -> None:
        super().__init__(calibration, settings)
        self._watch = watch

    def track(
        self, raw: Features, reference: View, velocity: FloatArray, expected: FloatArray | None, trial: int
    ) -> Fix | MotionEstimate:
        """Locate a frame by its motion against `reference`, or say why not.

        Args:
            raw: the frame's features, rows not straightened.
            reference: a view with a pose.
            velocity: (6,) of the colour camera at the frame, as far as known.
            expected: (4, 4) T_reference_current of the colour camera, if somebody knows.
            trial: makes RANSAC's seed differ from frame to frame.
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
        """Pairs (reference, current); the reference's have depth."""
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
        """Both ends of a pair were measured, so their variances add."""
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
    """Aligns a frame, roughly located, with the landmarks around it."""

    def track(self, raw: Features, rough: Fix, last: View, landmarks: LandmarkMap) -> Fix | MotionEstimate:
        """Locate a frame against the map, starting from a rough fix; or say why not."""
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
        """Numbers (M,) of the landmarks found, the pairs, and the keypoints (M,) that show them."""
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
        """A landmark seen n times is as uncertain as the mean of n readings."""
        points, _, sightings = landmarks.get(numbers)
        growth = np.sqrt(1 + 1 / sightings)
        sigma_xy, sigma_m = growth * features.sigma_px[seen] / self._color.fx, growth * features.sigma_m[seen]
        return PointPairs(points, features.xy[seen], features.depth_m[seen], sigma_xy, sigma_m)

    def _fix(
        self, features: Features, landmark: np.ndarray, found: Alignment, rough: Fix, matches: int, keyframe: View
    ) -> Fix:
        """The map drifted as far as its newest keyframe; the frame's own uncertainty comes on top."""
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
