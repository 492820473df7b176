"""`align_points` returns the rigid motion that best aligns two point sets, in closed form (Kabsch 1976, Umeyama
1991). `interpolate_at` returns poses between stamps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import DegenerateGeometryError
from wheelsight.core.geometry import se3
from wheelsight.core.geometry.arrays import FloatArray

# Zhang section 3.2 leaves out the case that the best orthogonal matrix is a reflection, by noise or a mirrored set: the
# nearest rotation replaces it.

# A singular value of the covariance below this share of the largest is as good as zero: the points lie on a line.
_SINGULAR_SHARE = 1e-9
# Below this share of the next one, the points lie near a plane: off it a fifth as far as across.
_FLAT_SHARE = 0.05
# A cosine or a correlation from which orientations, or points off the plane, determine which side of it is up.
_CLEARLY = 0.5
# Points nearer together than this share of their distance from the origin differ by rounding only.
_ROUNDING_SHARE = 1e-12


def align_points(p_a: ArrayLike, p_b: ArrayLike, weights: ArrayLike | None = None) -> FloatArray:
    """`T_a_b` (4, 4) that minimises Σ wᵢ ‖p_aᵢ − T_a_b p_bᵢ‖² (Zhang, section 3.2).

    Args:
        p_a: points (N, 3) in frame a, metres.
        p_b: the same points (N, 3) in frame b, in the same order.
        weights: one non-negative weight a pair (N,); None: equal.

    Raises:
        DegenerateGeometryError: fewer than three pairs, points on one line or in one place, a mirrored set
            that several rotations fit equally well, or values not finite.
    """
    return align_points_with_scale(p_a, p_b, weights, with_scale=False)[0]


def align_points_with_scale(
    p_a: ArrayLike,
    p_b: ArrayLike,
    weights: ArrayLike | None = None,
    with_scale: bool = True,
    like: ArrayLike | None = None,
) -> tuple[FloatArray, float]:
    """`T_a_b` (4, 4) and scale s that minimise Σ wᵢ ‖p_aᵢ − (s R p_bᵢ + t)‖² (Umeyama, eqs. 40–42).

    Points near one plane fit well by two rotations: one of them flips the plane onto its mirror image, and the points
    off the plane do not decide between them.

    Args:
        p_a, p_b, weights: as for `align_points`, and so are the errors.
        with_scale: off, s is 1.
        like: (3, 3) about R, such as a mean of R_a R_bᵀ over poses, which may decide the side of a plane.
    """
    p_a, p_b, w = _checked(p_a, p_b, weights)
    mean_a, mean_b = w @ p_a, w @ p_b
    q_a, q_b = p_a - mean_a, p_b - mean_b
    covariance = q_a.T @ (w[:, None] * q_b)
    U, singular, Vt = np.linalg.svd(covariance)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    if _in_one_place(p_a, q_a, w) or _in_one_place(p_b, q_b, w):
        raise DegenerateGeometryError("matched points lie in one place, so the rotation is free")
    smallest_allowed = _SINGULAR_SHARE * singular[0]
    if singular[1] <= smallest_allowed:
        raise DegenerateGeometryError("matched points lie on one line, so the rotation about it is free")
    if signs[2] < 0 and singular[1] - singular[2] <= smallest_allowed:
        raise DegenerateGeometryError("matched points are mirrored, and several rotations fit them equally well")
    is_flat = singular[2] <= _FLAT_SHARE * singular[1] or singular[1] <= _FLAT_SHARE**2 * singular[0]
    if like is not None and is_flat:
        up_a, up_b = U[:, 2] * signs[2], Vt[2]
        h_a, h_b = q_a @ up_a, q_b @ up_b
        spread = float(np.sqrt((w @ h_a**2) * (w @ h_b**2)))
        heights_agree = spread > 0 and float(w @ (h_a * h_b)) / spread > _CLEARLY
        if not heights_agree and up_a @ np.asarray(like, float) @ up_b < -_CLEARLY:
            signs[1:] *= -1
    R_a_b = (U * signs) @ Vt
    scale = float(singular @ signs / (w @ (q_b**2).sum(axis=1))) if with_scale else 1.0
    return se3.from_parts(R_a_b, mean_a - scale * R_a_b @ mean_b), scale


def _checked(p_a: ArrayLike, p_b: ArrayLike, weights: ArrayLike | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    p_a, p_b = np.asarray(p_a, float), np.asarray(p_b, float)
    if p_a.shape != p_b.shape or p_a.ndim != 2 or p_a.shape[1] != 3:
        raise ValueError(f"matched points must be two arrays (N, 3), not {p_a.shape} and {p_b.shape}")
    w = np.ones(len(p_a)) if weights is None else np.asarray(weights, float)
    if w.shape != (len(p_a),) or (w < 0).any():
        raise ValueError("weights must be one non-negative number a pair")
    if len(p_a) < 3 or np.count_nonzero(w) < 3:
        raise DegenerateGeometryError(f"{len(p_a)} matched points cannot determine a motion; three are needed")
    if not (np.isfinite(p_a).all() and np.isfinite(p_b).all() and np.isfinite(w).all()):
        raise DegenerateGeometryError("matched points hold values that are not finite")
    return p_a, p_b, w / w.sum()


def _in_one_place(p: FloatArray, q: FloatArray, w: FloatArray) -> bool:
    """Whether points p (N, 3), q once centred, do not differ by more than rounding."""
    return bool(np.sqrt(w @ (q**2).sum(axis=1)) <= _ROUNDING_SHARE * np.abs(p[w > 0]).max())


def interpolate_at(stamps_s: ArrayLike, T: ArrayLike, wanted_s: ArrayLike, max_gap_s: float = np.inf) -> FloatArray:
    """Motions (M, 4, 4) at stamps (M,), along the geodesic between neighbours of (N,) stamps, (N, 4, 4) motions.

    NaN at stamps outside the range, or between neighbours more than `max_gap_s` apart.
    """
    stamps_s, T = np.asarray(stamps_s, float), np.asarray(T, float)
    wanted_s = np.atleast_1d(np.asarray(wanted_s, float))
    result = np.full((len(wanted_s), 4, 4), np.nan)
    if len(stamps_s) == 0:
        return result
    after = np.searchsorted(stamps_s, wanted_s, side="left").clip(0, len(stamps_s) - 1)
    exact = stamps_s[after] == wanted_s
    result[exact] = T[after[exact]]
    before = (after - 1).clip(0)
    gap_s = stamps_s[after] - stamps_s[before]
    between = ~exact & (stamps_s[before] < wanted_s) & (wanted_s < stamps_s[after]) & (gap_s <= max_gap_s)
    i, j = before[between], after[between]
    if len(i) == 1:
        # Single motions use plain numbers, because a batch of one takes four times as long.
        i, j = i[0], j[0]
    if np.size(i):
        result[between] = se3.interpolate(T[i], T[j], np.squeeze((wanted_s[between] - stamps_s[i]) / gap_s[between]))
    return result
