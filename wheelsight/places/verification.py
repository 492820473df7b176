"""`PlaceVerifier` verifies a place candidate geometrically and returns the relative pose.

`intrusion` measures contradictions of free space: surfaces of one view in space that the other one saw through. Objects
that were moved cause them, and so do walls of another place. A free-standing object has an outline with more depth
behind it, while a wall across a corridor meets the side walls. It is also in one view only: misaligned surfaces intrude
in both.
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
from wheelsight.core.camera_errors import frame_covariance, place_errors
from wheelsight.core.estimates import Reason, with_frame_error
from wheelsight.core.geometry import FloatArray, IntArray, se3, so3
from wheelsight.core.geometry.motion_kernels import is_definite
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures, KeyframeId
from wheelsight.core.settings import RecognitionSettings
from wheelsight.places.recognition import SeenView, ViewMaker
from wheelsight.vision.dense.alignment import (
    CORRELATION,
    LEVELS,
    Aligner,
    Judgement,
    KeypointMotion,
    Level,
    MotionPrior,
    ReferenceMaker,
    SurfaceWeight,
    judge,
)
from wheelsight.vision.features.tracking import Alignment, PointPairs, find_motion, match_all, refine_motion

# One in this many common points is used for camera errors, and at least this many are needed.
_EVERY, _LEAST = 4, 10
_MAX_HAMMING = 64  # bits by which descriptors of one point may differ
# Standard deviation of a keypoint's pixel at a middle scale, by `keypoint_sigma_px`.
_KEYPOINT_PX = 1.0
# Largest number of RANSAC's iterations: of views from far apart one match in ten is right, and three must be. 0.1³ of
# 4000 is 4, so one is found in 98 %.
_ITERATIONS = 4000
# Keypoints that must agree on a motion before surfaces are compared: at wrong places 6 and 7 often agree. From two real
# recordings: docs/decisions/recognition-and-sessions.md.
_MIN_INLIERS = 8
# Keypoints that must agree, or their share of those matched, to count along directions that surfaces do not show: fewer
# fit the next door of a corridor too. 63 to 96 % agree at the right place, 19 to 26 % in another stretch of a corridor
# (simulator: docs/decisions/features.md).
_CLEAR_INLIERS, _CLEAR_SHARE = 40, 0.5
_CORRELATION = 20.0  # number of neighbouring keypoints that err as one, as `KEYPOINT_CORRELATION`
# Largest motion by surfaces away from the few keypoints. Chosen.
_AGREE_M, _AGREE_RAD = 0.15, 0.12
# Share of the view's points that must find a surface of the keyframe: with less, an edge of a table fits many places
# (docs/decisions/recognition-and-sessions.md). Largest mean residual, in standard deviations of the sensor.
_MIN_OVERLAP, _MAX_RESIDUAL = 0.15, 5.0
# Depth within which points belong to one surface: a distance, a share of the depth, by which real cameras err, and
# standard deviations of depth; and the pixels of the coarsest level within which the nearest depth is the surface.
# Chosen.
_SURFACE_M, _SURFACE_SHARE, _SURFACE_SIGMAS, _SURFACE_PX = 0.06, 0.03, 3.0, 1
# Largest share of the points visible in both views that may intrude into free space, such as people and moved chairs;
# chosen. Largest share of free-standing objects, such as a person close by: as much must support the place.
_MAX_INTRUDING, _MAX_FREE = 0.12, 0.5
# Standard deviations of a place by surfaces seen from apart, beyond the errors of single frames and of the camera's
# points. freiburg1_desk against motion capture: docs/decisions/loops-and-graph.md.
_REGISTRATION_SIGMA_M, _REGISTRATION_SIGMA_RAD = 0.01, 0.01
_UNSEEN_SIGMA_M = 10.0  # standard deviation along unobserved directions, with turns as distances at 2 m; chosen
# Directions of six that may be unobserved: a corridor leaves one; a single plane leaves three, and is no place.
_MOST_UNSEEN = 2


class Refusal(StrEnum):
    """Reason why a candidate is refused."""

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
        T_keyframe_camera: (4, 4) pose of the view.
        covariance: (6, 6) of the left perturbation (v, ω) of `T_keyframe_camera`.
        shared: (6, 6) part of it that is the view's own error, common to all keyframes.
        degenerate: (K, 6) unit vectors of (v, ω · 2 m) along which the pose is unobserved, as along a corridor. The
            covariance there is 10 m.
        matches, inliers: number of matched keypoints, and of those that agree.
        intruding: share of the points visible in both views that intrude into the other's free space.
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
        """Whether all directions are observed."""
        return not len(self.degenerate)


@dataclass(frozen=True, slots=True)
class RefusedPlace:
    """A refused candidate.

    Attributes:
        matches, inliers: as in `VerifiedPlace`, as far as computed.
    """

    keyframe: KeyframeId
    reason: Refusal
    matches: int = 0
    inliers: int = 0


class PlaceVerifier:
    """Compares a view with candidates one by one: keypoints, then surfaces, then free space.

    Attributes:
        refusals: number of refusals by reason.
    """

    def __init__(
        self, calibration: Calibration, settings: RecognitionSettings | None = None, views: ViewMaker | None = None
    ) -> None:
        self._seed = (settings or RecognitionSettings()).seed
        self._views = views or ViewMaker(calibration)
        dense = self._views.settings
        self._calibration, self._noise = calibration, calibration.depth_noise
        self._of_frame = frame_covariance(calibration)
        sigmas = [_REGISTRATION_SIGMA_M] * 3 + [_REGISTRATION_SIGMA_RAD] * 3
        self._of_registration = np.diag(np.square(sigmas))
        self._sigma_xy = float(np.hypot(_KEYPOINT_PX, calibration.color_sigma_px))
        self._sigma_xy *= np.sqrt(2) / calibration.cameras[0].fx
        self._maker = ReferenceMaker(self._noise)
        self._aligner = Aligner(calibration, dense, self._views.gridder, self._maker)
        self.refusals: Counter[Refusal] = Counter()

    def verify(
        self, view: SeenView, candidate: KeyframeId, keyframe: Keyframe | SeenView
    ) -> VerifiedPlace | RefusedPlace:
        """Return the pose of a view relative to a candidate, or the reason why it shows another place."""
        matched = self._matched(view.features, keyframe.features)
        T_camera_keyframe = find_motion(matched, self._seed, _MIN_INLIERS, _ITERATIONS)
        if isinstance(T_camera_keyframe, Reason):
            return self._refused(candidate, _REFUSALS[T_camera_keyframe], len(matched))
        found = refine_motion(matched, T_camera_keyframe)
        if not found.inliers >= _MIN_INLIERS:
            return self._refused(candidate, Refusal.TOO_FEW_INLIERS, len(matched))
        other = self._views.of_keyframe(keyframe) if isinstance(keyframe, Keyframe) else keyframe
        view, other = self._views.of_one_size(view, other)
        counts = (len(matched), found.inliers)
        judged = self._align(view, other, found, len(matched))
        if judged.reason is not None:
            return self._refused(candidate, _REFUSALS[judged.reason], *counts)
        if len(judged.degenerate) > _MOST_UNSEEN:
            return self._refused(candidate, Refusal.DEGENERATE, *counts)
        T_keyframe_camera = se3.nearest(judged.T_reference_frame)
        T_by_keypoints = se3.invert(found.T_current_reference)
        T_off = se3.invert(T_by_keypoints) @ T_keyframe_camera
        off_m, off_rad = float(np.linalg.norm(T_off[:3, 3])), float(so3.angle(T_off[:3, :3]))
        if off_m > _AGREE_M or off_rad > _AGREE_RAD:
            return self._refused(candidate, Refusal.CONTRADICTED, *counts)
        seen = (other.grid.levels[LEVELS - 1], view.grid.levels[LEVELS - 1])
        space = intrusion(*seen, T_keyframe_camera, self._noise)
        if space.share > _MAX_INTRUDING or space.free_share > _MAX_FREE:
            return self._refused(candidate, Refusal.INTRUDES, *counts)
        shared = with_frame_error(np.zeros((6, 6)), T_keyframe_camera, self._of_frame)
        # Points of the view, in the frame of the keyframe, whose surface the keyframe shows too. Systematic errors of
        # them grow with the distance between both views.
        points, surface_m, within_m, _, _ = _met(seen[1], seen[0], T_keyframe_camera, self._noise)
        points = points[np.abs(points[:, 2] - surface_m) <= within_m][::_EVERY]
        if len(points) < _LEAST:
            return self._refused(candidate, Refusal.DEGENERATE, *counts)
        off = place_errors(self._calibration, T_keyframe_camera, points)
        systematic = np.asarray(self._of_frame + self._of_registration + off.T @ off)
        covariance = systematic + judged.covariance + shared
        covariance = (covariance + covariance.T) / 2
        if not (np.isfinite(covariance).all() and is_definite(covariance)):
            # A poorly observed direction has such a large variance that rounding hides all others.
            return self._refused(candidate, Refusal.DEGENERATE, *counts)
        return VerifiedPlace(candidate, T_keyframe_camera, covariance, shared, judged.degenerate, *counts, space.share)

    def _matched(self, seen: KeyframeFeatures, known: KeyframeFeatures | None) -> PointPairs:
        """Return the keyframe's points with their observations in the view."""
        none = np.zeros((0, 3))
        points, known_points = seen.points, none if known is None else known.points
        here, there = np.flatnonzero(points[:, 2] > 0), np.flatnonzero(known_points[:, 2] > 0)
        if known is None or not len(here) or not len(there):
            return PointPairs(none, none[:, :2], none[:, 0], none[:, 0], none[:, 0])
        pairs = match_all(known.descriptors[there], seen.descriptors[here], _MAX_HAMMING)
        p_keyframe, p_camera = known_points[there[pairs.first]], points[here[pairs.second]]
        z_m = p_camera[:, 2].copy()
        sigma_m = np.hypot(self._noise.sigma_m(p_keyframe[:, 2]), self._noise.sigma_m(z_m))
        return PointPairs(p_keyframe, p_camera[:, :2] / z_m[:, None], z_m, np.full(len(z_m), self._sigma_xy), sigma_m)

    def _align(self, view: SeenView, other: SeenView, found: Alignment, matches: int) -> Judgement:
        """Align the view by surfaces and keypoints together.

        With few keypoints, the wrong place may fit too: the next door of a corridor, the next desk of a row. Then a
        direction that surfaces do not constrain stays unknown.
        """
        T_keyframe_camera = se3.invert(found.T_current_reference)
        Ad = se3.adjoint(T_keyframe_camera)
        information = np.linalg.inv(_CORRELATION * Ad @ found.covariance @ Ad.T)
        by_keypoints = KeypointMotion(T_keyframe_camera, np.asarray(information, float))
        reference = self._maker.of_frame(other.grid, np.eye(4))
        aligned = self._aligner.align(view.grid, reference, T_keyframe_camera, keypoints=by_keypoints)
        is_clear = found.inliers >= min(_CLEAR_INLIERS, _CLEAR_SHARE * matches)
        # Both are weighted by their distance; see `SurfaceWeight`.
        joint = SurfaceWeight().meet(aligned.T_reference_frame, aligned.claimed / CORRELATION, by_keypoints)
        surfaces = aligned.information / joint.factor
        # Surfaces constrain these directions however far they are off.
        hinted, information = aligned.information - surfaces, surfaces
        if is_clear:
            hinted = hinted + (_CORRELATION - 1) * CORRELATION * by_keypoints.information
            information = information + CORRELATION * by_keypoints.information
        both = replace(aligned, T_reference_frame=joint.T_reference_frame, information=information, hinted=hinted)
        return judge(both, MotionPrior(T_keyframe_camera, _UNSEEN_SIGMA_M), _MIN_OVERLAP, _MAX_RESIDUAL)

    def _refused(self, candidate: KeyframeId, reason: Refusal, matches: int, inliers: int = 0) -> RefusedPlace:
        self.refusals[reason] += 1
        return RefusedPlace(candidate, reason, matches, inliers)


_NOTHING = np.float32(1e6)
# Slices of pixels, and of their right, left, lower and upper neighbours.
_FIRST, _LAST, _ALL = slice(None, -1), slice(1, None), slice(None)
_NEIGHBOURS = (
    ((_ALL, _FIRST), (_ALL, _LAST)),
    ((_ALL, _LAST), (_ALL, _FIRST)),
    ((_FIRST, _ALL), (_LAST, _ALL)),
    ((_LAST, _ALL), (_FIRST, _ALL)),
)


class Intrusion(NamedTuple):
    """Counts of points: of `compared` ones that the other view could see, `intruding` ones are in its free space.

    `free` of the intruding ones belong to free-standing objects, in one of both views.
    """

    intruding: int
    compared: int
    free: int = 0

    @property
    def share(self) -> float:
        """Share of intruding points, without free-standing objects; 0 if nothing could be compared."""
        return (self.intruding - self.free) / max(self.compared - self.free, 1)

    @property
    def free_share(self) -> float:
        """Share of compared points on free-standing objects."""
        return self.free / max(self.compared, 1)


def intrusion(first: Level, second: Level, T_first_second: FloatArray, noise: DepthNoise) -> Intrusion:
    """Return the intrusion of both views' points into the other's free space; the second view is at (4, 4) in the
    first.
    """
    there = _one_way(second, first, T_first_second, noise)
    back = _one_way(first, second, se3.invert(T_first_second), noise)
    intruding, compared = there.intruding + back.intruding, there.compared + back.compared
    less, more = sorted((there, back), key=lambda way: way.free)
    is_one_sided = less.intruding <= _MAX_INTRUDING * less.compared
    return Intrusion(intruding, compared, more.free if is_one_sided else 0)


def shown_share(seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise) -> float:
    """Return the share of one view's points whose surface another view shows too; 0 without points.

    `T_by_seen` (4, 4) maps the first view's points into the other one.
    """
    points, surface_m, within_m, _, count = _met(seen, by, T_by_seen, noise)
    return int(np.count_nonzero(np.abs(points[:, 2] - surface_m) <= within_m)) / max(count, 1)


def _one_way(seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise) -> Intrusion:
    """Return the intrusion of one view's points. Points behind what the other one saw are hidden, and not compared.

    Free-standing are patches whose border is mostly an outline with more depth behind it. A neighbour that was not
    compared and is not farther may be part of the same object, and is ignored.
    """
    points, surface_m, within_m, pixels, _ = _met(seen, by, T_by_seen, noise)
    z_m, depth_m = points[:, 2], seen.depth_m
    is_compared, intrudes = z_m < surface_m + within_m, z_m < surface_m - within_m
    compared, intruding = np.zeros(depth_m.shape, bool), np.zeros(depth_m.shape, bool)
    compared.reshape(-1)[pixels[is_compared]], intruding.reshape(-1)[pixels[intrudes]] = True, True
    count, label = cv2.connectedComponents(intruding.astype(np.uint8), connectivity=4)
    outline, attached = np.zeros(count, np.int64), np.zeros(count, np.int64)
    behind_m = _SURFACE_M + _SURFACE_SHARE * depth_m + _SURFACE_SIGMAS * noise.sigma_m(depth_m)
    for here, beside in _NEIGHBOURS:
        borders = (label[here] > 0) & (label[beside] == 0) & (depth_m[beside] > 0)
        is_behind = depth_m[beside] > (depth_m + behind_m)[here]
        outline += np.bincount(label[here][borders & is_behind], minlength=count)
        attached += np.bincount(label[here][borders & ~is_behind & compared[beside]], minlength=count)
    free = int(np.bincount(label.ravel(), minlength=count)[outline > attached].sum())
    return Intrusion(int(np.count_nonzero(intrudes)), int(np.count_nonzero(is_compared)), free)


def _met(
    seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, int]:
    """Project points into the other view, and keep those at pixels with known depth.

    Returns points (P, 3) in the other view's frame; its depths (P,); tolerances (P,) in metres within which both are
    one surface; pixel indices (P,) in the first view; and the number of all points.
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
    # The nearest depth within `_SURFACE_PX` pixels: at an outline, a point may belong to either side.
    far = np.where(by.depth_m > 0, by.depth_m, _NOTHING)
    window = np.ones((2 * _SURFACE_PX + 1,) * 2, np.uint8)
    nearest_m = np.asarray(cv2.erode(far, window), np.float32)[v, u]
    is_known = by.depth_m[v, u] > 0
    surface_m, points, pixels = nearest_m[is_known].astype(float), points[is_known], pixels[is_known]
    sigma_m = np.hypot(noise.sigma_m(surface_m), noise.sigma_m(points[:, 2]))
    within_m = _SURFACE_M + _SURFACE_SHARE * surface_m + _SURFACE_SIGMAS * sigma_m
    return points, surface_m, within_m, pixels, count
