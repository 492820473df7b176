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
    """

    T_reference_frame: FloatArray
    sigma_m: float


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
    information = found.information / np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE) / settings.correlation
    strength, directions = np.linalg.eigh(information)
    strength = np.maximum(strength, 0.0)
    weak = strength < settings.degenerate_sigma_m**-2
    variances = np.where(weak, prior.sigma_m**2, 1 / np.maximum(strength, 1e-12))
    covariance = (directions * variances) @ directions.T / np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE)
    T = found.T_reference_frame
    if weak.any():
        from_prior = DEGENERATE_SCALE * se3.log(T @ se3.invert(prior.T_reference_frame))
        seen = directions[:, ~weak]
        T = se3.exp(seen @ (seen.T @ from_prior) / DEGENERATE_SCALE) @ prior.T_reference_frame
    return Judgement(T, covariance, directions[:, weak].T, _reason(found, int(weak.sum()), settings))


def _reason(found: DenseAlignment, unseen: int, settings: DenseSettings) -> Reason | None:
    if found.planes < settings.min_overlap * found.points:
        return Reason.TOO_LITTLE_OVERLAP
    if found.residual > settings.max_residual:
        return Reason.POOR_FIT
    return Reason.DEGENERATE if unseen == 6 else None
