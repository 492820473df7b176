"""PlaceVerifier: whether a view shows the place of a keyframe, by its geometry, and where it was seen from."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import Reason
from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.geometry.motion_kernels import is_definite
from wheelsight.keyframes import Keyframe, KeyframeFeatures, KeyframeId
from wheelsight.odometry.camera_errors import place_errors
from wheelsight.odometry.dense.alignment import Aligner, DenseAlignment
from wheelsight.odometry.dense.grid import Level
from wheelsight.odometry.dense.joint import SurfaceWeight, Told
from wheelsight.odometry.dense.observability import Judgement, Prior, judge
from wheelsight.odometry.dense.reference import ReferenceMaker
from wheelsight.odometry.features.alignment import Alignment, PointPairs, find_motion, refine_motion
from wheelsight.odometry.features.matching import match_all
from wheelsight.odometry.features.settings import FeatureSettings
from wheelsight.odometry.frame_error import frame_covariance, with_frame_error
from wheelsight.places.free_space import intrusion, shown_points
from wheelsight.places.views import SeenView, ViewMaker
from wheelsight.settings import RecognitionSettings

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
