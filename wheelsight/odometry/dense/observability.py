"""Whether an alignment is an answer, how certain it is, and which directions of motion it cannot tell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.estimates import DEGENERATE_SCALE, Reason
from wheelsight.geometry import FloatArray, se3
from wheelsight.odometry.dense.alignment import DenseAlignment
from wheelsight.odometry.dense.settings import DenseSettings


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is expected of a motion before the images are compared.

    Attributes:
        T_reference_frame: (4, 4).
        sigma_m: standard deviation in every direction, turns as ways at 2 m.
        others: each (4, 4), what else may be expected if the first turns out to be wrong.
    """

    T_reference_frame: FloatArray
    sigma_m: float
    others: tuple[FloatArray, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """An alignment as an answer, or the reason why it is none.

    Attributes:
        T_reference_frame: (4, 4); along `degenerate` directions the prior's.
        covariance: (6, 6) of its left perturbation (v, ω); along `degenerate` directions the prior's.
        degenerate: (K, 6) unit vectors of (v, ω · 2 m) that the view does not show, 0 ≤ K ≤ 6.
        reason: None for an answer.
    """

    T_reference_frame: FloatArray
    covariance: FloatArray
    degenerate: FloatArray
    reason: Reason | None = None


def judge(found: DenseAlignment, prior: Prior, settings: DenseSettings) -> Judgement:
    """Judge an alignment; directions in which it is less certain than `degenerate_sigma_m` keep the prior's motion.

    Eigenvectors of the information tell them (Zhang, Kaess & Singh, ICRA 2016: solution remapping).
    """
    scale = np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE) * settings.correlation
    information = found.information / scale
    shown = information if found.hinted is None else information + found.hinted / scale
    strength, directions = np.linalg.eigh(shown)
    weak = strength < settings.degenerate_sigma_m**-2
    compared = found.compared / scale + (shown - information)
    weak |= strength < settings.confirmed_share * (directions * (compared @ directions)).sum(axis=0)
    strength = np.maximum((directions * (information @ directions)).sum(axis=0), 0.0)
    variances = np.where(weak, prior.sigma_m**2, 1 / np.maximum(strength, 1e-12))
    covariance = (directions * variances) @ directions.T / np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE)
    T = found.T_reference_frame
    if weak.any():
        seen = directions[:, ~weak]
        T_prior, shift = _nearest_prior(T, prior, seen, settings)
        T = se3.exp(seen @ shift / DEGENERATE_SCALE) @ T_prior
    return Judgement(T, covariance, directions[:, weak].T, _reason(found, int(weak.sum()), settings))


def _nearest_prior(
    T: FloatArray, prior: Prior, seen: FloatArray, settings: DenseSettings
) -> tuple[FloatArray, FloatArray]:
    """The prior (4, 4), and how far T is from it along what is `seen` (6, K): what is wrong there is nowhere right."""
    priors = (prior.T_reference_frame, *prior.others)
    shifts = [seen.T @ (DEGENERATE_SCALE * se3.log(T @ se3.invert(T_prior))) for T_prior in priors]
    off_m = np.array([np.linalg.norm(shift) for shift in shifts])
    best = int(np.argmin(off_m))
    if off_m[0] < settings.degenerate_sigma_m or off_m[best] > settings.other_prior_share * off_m[0]:
        best = 0
    return priors[best], shifts[best]


def _reason(found: DenseAlignment, unseen: int, settings: DenseSettings) -> Reason | None:
    if found.planes < settings.min_overlap * found.points:
        return Reason.TOO_LITTLE_OVERLAP
    if found.residual > settings.max_residual:
        return Reason.POOR_FIT
    return Reason.DEGENERATE if unseen == 6 else None
