"""`PlaceVerifier` verifies a place candidate by geometry and returns the relative pose. `intrusion` measures
contradictions of free space between two views.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import cv2
import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.camera_errors import frame_covariance, place_errors, with_frame_error
from wheelsight.core.estimates import Reason
from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, IntArray, se3, so3
from wheelsight.core.geometry.motion_kernels import is_definite
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures, KeyframeId
from wheelsight.core.settings import PlaceVerificationSettings, RecognitionSettings
from wheelsight.places.recognition import SeenView, ViewMaker
from wheelsight.vision.dense.alignment import Aligner, DenseAlignment, Judgement, Prior, SurfaceWeight, Told, judge
from wheelsight.vision.dense.pyramid import Level, ReferenceMaker
from wheelsight.vision.features.extraction import FeatureSettings
from wheelsight.vision.features.tracking import Alignment, PointPairs, find_motion, match_all, refine_motion

# PlaceVerifier: whether a view shows the place of a keyframe, by its geometry, and where it was seen from.


# Of the points that both views show, each so many-th tells what errors of the camera do, and so few tell nothing.
_EVERY, _LEAST = 4, 10


class Refusal(StrEnum):
    """Why a candidate was refused."""

    TOO_FEW_MATCHES = "too few keypoints are alike"
    TOO_FEW_INLIERS = "too few keypoints agree on a motion"
    TOO_LITTLE_OVERLAP = "surfaces overlap too little"
    POOR_FIT = "surfaces do not fit"
    DEGENERATE = "neither surfaces nor keypoints show the motion"
    CONTRADICTED = "surfaces lead away from keypoints"
    INTRUDES = "surfaces stand where the other view saw through"


_REFUSALS = {
    Reason.TOO_LITTLE_OVERLAP: Refusal.TOO_LITTLE_OVERLAP,
    Reason.POOR_FIT: Refusal.POOR_FIT,
    Reason.DEGENERATE: Refusal.DEGENERATE,
    Reason.TOO_FEW_MATCHES: Refusal.TOO_FEW_MATCHES,
    Reason.TOO_FEW_INLIERS: Refusal.TOO_FEW_INLIERS,
}


@dataclass(frozen=True, slots=True, eq=False)
class VerifiedPlace:
    """A view that shows the place of a keyframe.

    Attributes:
        keyframe: whose place it is.
        T_keyframe_camera: (4, 4) where the view was seen from.
        covariance: (6, 6) of the left perturbation (v, ω) of `T_keyframe_camera`.
        shared: (6, 6) what of that is the view's own error, which other keyframes would find too.
        degenerate: (K, 6) unit vectors of (v, ω · 2 m) along which the place is not known, as along a corridor; there
            the covariance is as large as `unseen_sigma_m`.
        matches, inliers: keypoints that are alike, and those of them that agree.
        intruding: share of what both could see that stands where the other saw through.
    """

    keyframe: KeyframeId
    T_keyframe_camera: FloatArray
    covariance: FloatArray
    shared: FloatArray
    degenerate: FloatArray
    matches: int
    inliers: int
    intruding: float

    @property
    def shows_all(self) -> bool:
        """Whether no direction is left unknown."""
        return not len(self.degenerate)


@dataclass(frozen=True, slots=True)
class RefusedPlace:
    """A candidate that is none, and why.

    Attributes:
        keyframe: the candidate.
        reason: against it.
        matches, inliers: as `VerifiedPlace` has them, as far as it came.
    """

    keyframe: KeyframeId
    reason: Refusal
    matches: int = 0
    inliers: int = 0


class PlaceVerifier:
    """Compares a view with candidates, one by one: keypoints, then surfaces, then free space.

    Args:
        calibration: of the camera that saw both.
        settings: or the defaults.
        views: makes views of that camera.

    Attributes:
        refusals: how often each reason has spoken against a candidate.
    """

    def __init__(
        self, calibration: Calibration, settings: RecognitionSettings | None = None, views: ViewMaker | None = None
    ) -> None:
        both = settings or RecognitionSettings()
        self._settings, self._seed = both.verification, both.seed
        self._views = views or ViewMaker(calibration)
        dense = self._views.settings
        limits = {"min_overlap": self._settings.min_overlap, "max_residual": self._settings.max_residual}
        self._dense = dense.model_copy(update=limits)
        self._features = FeatureSettings(
            min_inliers=self._settings.min_inliers, ransac_iterations=self._settings.iterations
        )
        self._calibration, self._noise = calibration, calibration.depth_noise
        self._of_frame = frame_covariance(calibration)
        sigmas = [self._settings.registration_sigma_m] * 3 + [self._settings.registration_sigma_rad] * 3
        self._of_registration = np.diag(np.square(sigmas))
        self._sigma_xy = float(np.hypot(self._settings.keypoint_px, calibration.color_sigma_px))
        self._sigma_xy *= np.sqrt(2) / calibration.cameras[0].fx
        self._maker = ReferenceMaker(self._noise, dense, self._views.rows)
        self._aligner = Aligner(calibration, dense, self._views.rows, self._views.gridder, self._maker)
        self.refusals: Counter[Refusal] = Counter()

    def verify(
        self, view: SeenView, candidate: KeyframeId, keyframe: Keyframe | SeenView
    ) -> VerifiedPlace | RefusedPlace:
        """Where a view was seen from, relative to a candidate, or why it shows another place."""
        matched = self._matched(view.features, keyframe.features)
        found = self._by_keypoints(matched)
        if isinstance(found, Refusal):
            return self._refused(candidate, found, len(matched))
        other = self._views.of_keyframe(keyframe) if isinstance(keyframe, Keyframe) else keyframe
        view, other = self._views.of_one_size(view, other)
        counts = (len(matched), found.inliers)
        judged = self._by_surfaces(view, other, found, len(matched))
        if judged.reason is not None:
            return self._refused(candidate, _REFUSALS[judged.reason], *counts)
        if len(judged.degenerate) > self._settings.most_unseen:
            return self._refused(candidate, Refusal.DEGENERATE, *counts)
        T_keyframe_camera = se3.nearest(judged.T_reference_frame)
        if self._is_led_away(se3.invert(found.T_current_reference), T_keyframe_camera):
            return self._refused(candidate, Refusal.CONTRADICTED, *counts)
        level = self._dense.levels - 1
        seen = (other.grid.levels[level], view.grid.levels[level])
        space = intrusion(*seen, T_keyframe_camera, self._noise, self._settings)
        if space.share > self._settings.max_intruding or space.free_share > self._settings.max_free:
            return self._refused(candidate, Refusal.INTRUDES, *counts)
        shared = with_frame_error(np.zeros((6, 6)), T_keyframe_camera, self._of_frame)
        covariance = self._of_both(*seen, T_keyframe_camera) + judged.covariance + shared
        covariance = (covariance + covariance.T) / 2
        if not (np.isfinite(covariance).all() and is_definite(covariance)):
            # A direction that surfaces hardly show has a variance so large that rounding it hides all others.
            return self._refused(candidate, Refusal.DEGENERATE, *counts)
        return VerifiedPlace(candidate, T_keyframe_camera, covariance, shared, judged.degenerate, *counts, space.share)

    def _of_both(self, other: Level, view: Level, T_keyframe_camera: FloatArray) -> FloatArray:
        """Covariance (6, 6) of what a pose is off by beyond noise and the view's own error; NaN where it is not known.

        What is wrong with the camera's points grows with the way between both views, since it is another there.
        """
        points = shown_points(view, other, T_keyframe_camera, self._noise, self._settings)[::_EVERY]
        if len(points) < _LEAST:
            return np.full((6, 6), np.nan)
        off = place_errors(self._calibration, T_keyframe_camera, points)
        return np.asarray(self._of_frame + self._of_registration + off.T @ off)

    def _refused(self, candidate: KeyframeId, reason: Refusal, matches: int, inliers: int = 0) -> RefusedPlace:
        self.refusals[reason] += 1
        return RefusedPlace(candidate, reason, matches, inliers)

    def _matched(self, seen: KeyframeFeatures, known: KeyframeFeatures | None) -> PointPairs:
        """Points of the keyframe, with what the view saw of them."""
        none = np.zeros((0, 3))
        points, known_points = seen.points, none if known is None else known.points
        here, there = np.flatnonzero(points[:, 2] > 0), np.flatnonzero(known_points[:, 2] > 0)
        if known is None or not len(here) or not len(there):
            return PointPairs(none, none[:, :2], none[:, 0], none[:, 0], none[:, 0])
        pairs = match_all(known.descriptors[there], seen.descriptors[here], self._settings.max_hamming)
        p_keyframe, p_camera = known_points[there[pairs.first]], points[here[pairs.second]]
        z_m = p_camera[:, 2].copy()
        sigma_m = np.hypot(self._noise.sigma_m(p_keyframe[:, 2]), self._noise.sigma_m(z_m))
        return PointPairs(p_keyframe, p_camera[:, :2] / z_m[:, None], z_m, np.full(len(z_m), self._sigma_xy), sigma_m)

    def _by_keypoints(self, matched: PointPairs) -> Alignment | Refusal:
        """The motion that most keypoints agree on."""
        T_camera_keyframe = find_motion(matched, self._features, self._seed)
        if isinstance(T_camera_keyframe, Reason):
            return _REFUSALS[T_camera_keyframe]
        found = refine_motion(matched, T_camera_keyframe, self._features)
        return found if found.inliers >= self._settings.min_inliers else Refusal.TOO_FEW_INLIERS

    def _by_surfaces(self, view: SeenView, other: SeenView, found: Alignment, matches: int) -> Judgement:
        """Where surfaces and keypoints together put the view.

        Few keypoints fit the wrong place too: a corridor's next door, a row's next desk. Then a direction that surfaces
        do not show is not known.
        """
        T_keyframe_camera = se3.invert(found.T_current_reference)
        Ad = se3.adjoint(T_keyframe_camera)
        information = np.linalg.inv(self._settings.correlation * Ad @ found.covariance @ Ad.T)
        told = Told(T_keyframe_camera, np.asarray(information, float))
        reference = self._maker.of_frame(other.grid, np.eye(4))
        aligned = self._aligner.align(view.grid, reference, T_keyframe_camera, told=told)
        is_clear = found.inliers >= min(self._settings.clear_inliers, self._settings.clear_share * matches)
        met = self._met(aligned, told, is_clear=is_clear)
        return judge(met, Prior(T_keyframe_camera, self._settings.unseen_sigma_m), self._dense)

    def _met(self, aligned: DenseAlignment, told: Told, *, is_clear: bool) -> DenseAlignment:
        """Both, weighed by how far they are apart; see `SurfaceWeight`."""
        correlation = self._dense.correlation
        weight = SurfaceWeight(self._dense.joint)
        joint = weight.meet(aligned.T_reference_frame, aligned.claimed / correlation, told)
        surfaces = aligned.information / joint.factor
        # What surfaces show, they show however far they are off.
        hinted, information = aligned.information - surfaces, surfaces
        if is_clear:
            hinted = hinted + (self._settings.correlation - 1) * correlation * told.information
            information = information + correlation * told.information
        return replace(aligned, T_reference_frame=joint.T_reference_frame, information=information, hinted=hinted)

    def _is_led_away(self, T_by_keypoints: FloatArray, T_keyframe_camera: FloatArray) -> bool:
        T = se3.invert(T_by_keypoints) @ T_keyframe_camera
        off_m, off_rad = float(np.linalg.norm(T[:3, 3])), float(so3.angle(T[:3, :3]))
        return off_m > self._settings.agree_m or off_rad > self._settings.agree_rad


# Free space: whether surfaces of one view stand where the other one saw through.
#
# Things that came or went between two views do so, and walls of another place. What stands free hides what is behind
# it, so it has an outline; a wall that closes a corridor meets its side walls. And it is in one view only: surfaces
# that are laid wrongly stand in each other's way in both.


_NOTHING = np.float32(1e6)
# Pixels, and those right, left, below and above of them.
_FIRST, _LAST, _ALL = slice(None, -1), slice(1, None), slice(None)
_NEIGHBOURS = (
    ((_ALL, _FIRST), (_ALL, _LAST)),
    ((_ALL, _LAST), (_ALL, _FIRST)),
    ((_FIRST, _ALL), (_LAST, _ALL)),
    ((_LAST, _ALL), (_FIRST, _ALL)),
)


class Intrusion(NamedTuple):
    """Of `compared` points that could be seen from there, how many stand where it was seen through: `intruding`.

    `free` of these are of things that stand free, in one of both views.
    """

    intruding: int
    compared: int
    free: int = 0

    @property
    def share(self) -> float:
        """Of what is no free thing; 0 where nothing could be compared."""
        return (self.intruding - self.free) / max(self.compared - self.free, 1)

    @property
    def free_share(self) -> float:
        """How much of what was compared is of things that stand free."""
        return self.free / max(self.compared, 1)


def intrusion(
    first: Level, second: Level, T_first_second: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> Intrusion:
    """Of both views' points against what the other one saw, if the second lies at (4, 4) off the first."""
    there = _one_way(second, first, T_first_second, noise, settings)
    back = _one_way(first, second, se3.invert(T_first_second), noise, settings)
    intruding, compared = there.intruding + back.intruding, there.compared + back.compared
    less, more = sorted((there, back), key=lambda way: way.free)
    is_one_sided = less.intruding <= settings.max_intruding * less.compared
    return Intrusion(intruding, compared, more.free if is_one_sided else 0)


def shown_share(
    seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> float:
    """Share of what one view sees whose surfaces another one, from which it lies at (4, 4), shows too; 0 of nothing."""
    points, surface_m, within_m, _, count = _met(seen, by, T_by_seen, noise, settings)
    return int(np.count_nonzero(np.abs(points[:, 2] - surface_m) <= within_m)) / max(count, 1)


def shown_points(
    seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> FloatArray:
    """Points (N, 3) in the frame of one view whose surfaces another one, which lies at (4, 4) off it, shows too."""
    points, surface_m, within_m, _, _ = _met(seen, by, T_by_seen, noise, settings)
    return np.asarray(points[np.abs(points[:, 2] - surface_m) <= within_m])


def _one_way(
    seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> Intrusion:
    """Points that lie behind what was seen are hidden, and tell nothing."""
    points, surface_m, within_m, pixels, _ = _met(seen, by, T_by_seen, noise, settings)
    z_m = points[:, 2]
    is_compared, intrudes = z_m < surface_m + within_m, z_m < surface_m - within_m
    compared, intruding = (np.zeros(seen.depth_m.size, bool) for _ in range(2))
    compared[pixels[is_compared]], intruding[pixels[intrudes]] = True, True
    shape = seen.depth_m.shape
    free = _free_pixels(seen.depth_m, intruding.reshape(shape), compared.reshape(shape), noise, settings)
    return Intrusion(int(np.count_nonzero(intrudes)), int(np.count_nonzero(is_compared)), free)


def _free_pixels(
    depth_m: Float32Array,
    intruding: BoolArray,
    compared: BoolArray,
    noise: DepthNoise,
    settings: PlaceVerificationSettings,
) -> int:
    """How many intruding pixels are of patches most of whose border is an outline, behind which there is more.

    A neighbour that was not compared and is no farther may be of the same thing, so it tells nothing.
    """
    count, label = cv2.connectedComponents(intruding.astype(np.uint8), connectivity=4)
    outline, attached = np.zeros(count, np.int64), np.zeros(count, np.int64)
    within_m = settings.free_m + settings.free_share * depth_m + settings.free_sigmas * noise.sigma_m(depth_m)
    for here, beside in _NEIGHBOURS:
        borders = (label[here] > 0) & (label[beside] == 0) & (depth_m[beside] > 0)
        is_behind = depth_m[beside] > (depth_m + within_m)[here]
        outline += np.bincount(label[here][borders & is_behind], minlength=count)
        attached += np.bincount(label[here][borders & ~is_behind & compared[beside]], minlength=count)
    return int(np.bincount(label.ravel(), minlength=count)[outline > attached].sum())


def _met(
    seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, int]:
    """Points (P, 3) in the other view's frame that fall where it saw a surface; its depths (P,), within how many metres
    both are one, and the points' pixels, counted row by row; and how many points there are in all.
    """
    points, rows, columns = seen.points()
    points, pixels = points @ T_by_seen[:3, :3].T + T_by_seen[:3, 3], rows * seen.depth_m.shape[1] + columns
    count, is_before = len(points), points[:, 2] > noise.near_m
    points, pixels = points[is_before], pixels[is_before]
    fx, fy, cx, cy = by.intrinsics
    u, v = np.rint(points[:, :2] / points[:, 2:] * (fx, fy) + (cx, cy)).astype(np.int64).T
    height, width = by.depth_m.shape
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    u, v, points, pixels = u[inside], v[inside], points[inside], pixels[inside]
    nearest_m, is_known = _nearest(by.depth_m, settings.free_px)[v, u], by.depth_m[v, u] > 0
    surface_m, points, pixels = nearest_m[is_known].astype(float), points[is_known], pixels[is_known]
    sigma_m = np.hypot(noise.sigma_m(surface_m), noise.sigma_m(points[:, 2]))
    within_m = settings.free_m + settings.free_share * surface_m + settings.free_sigmas * sigma_m
    return points, surface_m, within_m, pixels, count


def _nearest(depth_m: Float32Array, radius_px: int) -> Float32Array:
    """The nearest depth (h, w) within so many pixels: at an outline a point may belong to either side."""
    far = np.where(depth_m > 0, depth_m, _NOTHING)
    return np.asarray(cv2.erode(far, np.ones((2 * radius_px + 1,) * 2, np.uint8)), np.float32)
