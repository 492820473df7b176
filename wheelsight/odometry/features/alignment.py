"""The motion between two sets of matched points: RANSAC over closed-form alignment, then refinement (Zhang, 3.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.estimates import Reason
from wheelsight.geometry import BoolArray, FloatArray, se3
from wheelsight.odometry.features import _kernels
from wheelsight.odometry.features.settings import FeatureSettings


@dataclass(frozen=True, slots=True, eq=False)
class PointPairs:
    """N points known in a reference frame and what the current frame saw of them.

    Attributes:
        p_reference: (N, 3) metres.
        xy: (N, 2) seen on the plane z = 1.
        depth_m: (N,) seen, 0 where there is none.
        sigma_xy: (N,) of `xy`.
        sigma_m: (N,) of `depth_m`.
    """

    p_reference: FloatArray
    xy: FloatArray
    depth_m: FloatArray
    sigma_xy: FloatArray
    sigma_m: FloatArray

    def __len__(self) -> int:
        return len(self.p_reference)

    def observed(self) -> _kernels.Pairs:
        """The same for kernels: with 1/σ, which is 0 for depth that is not there."""
        scale_m = np.where(self.depth_m > 0, 1 / np.maximum(self.sigma_m, 1e-6), 0.0)
        return _kernels.Pairs(self.p_reference, self.xy, self.depth_m, 1 / self.sigma_xy, scale_m)


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """What refinement found.

    Attributes:
        T_current_reference: (4, 4).
        covariance: (6, 6) of the left perturbation (v, ω) of `T_current_reference`.
        is_inlier: (N,) which pairs agree with it.
    """

    T_current_reference: FloatArray
    covariance: FloatArray
    is_inlier: BoolArray

    @property
    def inliers(self) -> int:
        """How many pairs agree."""
        return int(np.count_nonzero(self.is_inlier))


def find_motion(pairs: PointPairs, settings: FeatureSettings, seed: int) -> FloatArray | Reason:
    """T_current_reference (4, 4) by RANSAC over triples of pairs with depth, or why there is none."""
    usable = pairs.depth_m > 0
    if np.count_nonzero(usable) < settings.min_inliers:
        return Reason.TOO_FEW_MATCHES
    with_depth = _kernels.Pairs(*(values[usable] for values in pairs.observed()))
    rules = _kernels.Triangles(settings.triangle_m, settings.triangle_change_m, settings.triangle_change_share)
    R, t, agreeing = _kernels.ransac(with_depth, rules, settings.ransac_chi2, settings.ransac_iterations, seed)
    return se3.from_parts(R, t) if agreeing >= settings.min_inliers else Reason.TOO_FEW_INLIERS


def refine_motion(pairs: PointPairs, T_current_reference: FloatArray, settings: FeatureSettings) -> Alignment:
    """The motion that minimises the robust, noise-weighted distance of all pairs, starting from one near it.

    Pixel and depth are weighted each by its σ (depth's grows with z²), which weights the 3D–3D distance of Zhang's
    section 3.2 by the points' true, elongated uncertainty. Pairs without depth count by their pixels alone.
    """
    R, t = np.ascontiguousarray(T_current_reference[:3, :3]), T_current_reference[:3, 3].copy()
    R, t, H, squares = _kernels.refine(R, t, pairs.observed(), settings.inlier_chi2, settings.refinement_steps)
    return Alignment(se3.from_parts(R, t), _covariance(H), squares < settings.inlier_chi2)


def _covariance(H: FloatArray) -> FloatArray:
    """The inverse of an information matrix; directions it says nothing about get 10⁶ (m², rad²), never infinity."""
    values, vectors = np.linalg.eigh(H)
    return np.asarray((vectors / np.maximum(values, 1e-6)) @ vectors.T)
