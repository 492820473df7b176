"""Two answers about one stretch: whether they say the same, and what they say together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.estimates import DEGENERATE_SCALE
from wheelsight.geometry import FloatArray, se3
from wheelsight.places.verification import VerifiedPlace
from wheelsight.settings import PlaceVerificationSettings


def distance_chi2(
    first: VerifiedPlace, second: VerifiedPlace, T_first_second: FloatArray, covariance: FloatArray
) -> float:
    """How far apart two answers about one view are, as χ² of 6 numbers.

    Args:
        first: by one keyframe.
        second: by another.
        T_first_second: (4, 4) of the second keyframe in the first one's frame, as the map has them.
        covariance: (6, 6) of its left perturbation.
    """
    off, spread = _apart(first, second, T_first_second, covariance)
    return float(off @ np.linalg.solve(spread[0] + spread[1], off))


def joined(
    first: VerifiedPlace,
    second: VerifiedPlace,
    T_first_second: FloatArray,
    covariance: FloatArray,
    settings: PlaceVerificationSettings,
) -> VerifiedPlace | None:
    """Both as one about the first keyframe, or None where they contradict each other; see `distance_chi2`.

    What the view itself is off by is in both, and stays. A direction is unknown where neither knows it.
    """
    off, (own, others) = _apart(first, second, T_first_second, covariance)
    total = own + others
    if off @ np.linalg.solve(total, off) > settings.agree_chi2:
        return None
    T = se3.exp(own @ np.linalg.solve(total, off)) @ first.T_keyframe_camera
    spread = own - own @ np.linalg.solve(total, own)
    together = 0.5 * (spread + spread.T) + first.shared
    return replace(
        first,
        T_keyframe_camera=T,
        covariance=together,
        degenerate=_unknown(together, settings.unseen_sigma_m),
        matches=first.matches + second.matches,
        inliers=first.inliers + second.inliers,
        intruding=max(first.intruding, second.intruding),
    )


def _apart(
    first: VerifiedPlace, second: VerifiedPlace, T_first_second: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """How far (6,) the second pose is off the first, and what both err by themselves, (6, 6) each."""
    T_second = T_first_second @ second.T_keyframe_camera
    Ad = se3.adjoint(T_first_second)
    others = covariance + Ad @ (second.covariance - second.shared) @ Ad.T
    off = se3.log(T_second @ se3.invert(first.T_keyframe_camera))
    return off, (first.covariance - first.shared, others)


def _unknown(covariance: FloatArray, unseen_sigma_m: float) -> FloatArray:
    """Unit vectors (K, 6) of (v, ω · 2 m) along which a covariance is about as large as that of what is not seen."""
    variances, directions = np.linalg.eigh(covariance * np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE))
    return np.asarray(directions[:, variances > (0.5 * unseen_sigma_m) ** 2].T)
