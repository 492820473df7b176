"""Robust least squares over pieces of a drive, with a covariance for errors that neighbouring pieces share.

Outliers lose their weight (Geman & McClure 1985; graduated as in Yang et al., RA-L 2020): the scale of the kernel
narrows to the spread of the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wheelsight.core.geometry import BoolArray, FloatArray

UNKNOWN_SIGMA = 1e3

_STEP = 0.01  # share of a parameter's bound, the scale of the solver

# Chosen, unless the line says otherwise.
_FIRST_SCALE, _LEAST_SCALE = 0.02, 5e-4  # initial and least spread, in metres and in radians
_NARROWING = (32.0, 8.0, 4.0, 2.0, 1.0, 1.0, 1.0)  # times the spread, step by step (after Yang et al. 2020)
_OUTLIER_CHI2 = 16.0  # χ² of 3, exceeded once in a thousand (computed)
_MOST_CLUSTERS = 25  # runs of neighbouring pieces, whose spread gives the covariance


class Problem(Protocol):
    """A least-squares problem of P parameters with residuals of M pieces of a drive."""

    @property
    def bounds(self) -> FloatArray:
        """(P,) largest absolute value of each parameter."""
        ...

    @property
    def prior_sigmas(self) -> FloatArray:
        """(P,) standard deviation of each parameter's prior, which is 0; `UNKNOWN_SIGMA` for no prior."""
        ...

    def residuals(self, values: FloatArray) -> FloatArray:
        """(M, 3) along and across each piece in metres, and in yaw in radians."""
        ...


@dataclass(frozen=True, eq=False)
class RobustFit:
    """Values (P,) with covariance (P, P), residuals (M, 3), weights (M,), and which pieces are outliers.

    `if_independent` (P, P) is the covariance for independent residuals of this spread.
    """

    values: FloatArray
    covariance: FloatArray
    if_independent: FloatArray
    residuals: FloatArray
    weights: FloatArray
    is_outlier: BoolArray


def robust_fit(problem: Problem, start: FloatArray) -> RobustFit:
    """Return the values for which most pieces agree, from the initial ones `start` (P,)."""
    values, scales = start, np.full(3, _FIRST_SCALE)
    weights = np.ones(len(problem.residuals(start)))
    for factor in _NARROWING:
        residuals = problem.residuals(values)
        if values is not start:
            scales = np.maximum(spread(residuals), _LEAST_SCALE)
        weights = robust_weights(((residuals / (factor * scales)) ** 2).sum(axis=1))
        values = _solve(problem, values, scales, weights)
    residuals = problem.residuals(values)
    is_outlier = ((residuals / scales) ** 2).sum(axis=1) > _OUTLIER_CHI2
    return RobustFit(values, *_covariances(problem, values, scales), residuals, weights, is_outlier)


def response(problem: Problem, found: RobustFit, moved: FloatArray) -> FloatArray:
    """Return the changes (K, P) of the values, to first order, by changes `moved` (K, M, 3) of the residuals."""
    scales = np.maximum(spread(found.residuals), _LEAST_SCALE)
    J = _jacobian(problem, found.values) / scales[None, :, None]
    weighted = found.weights[:, None, None] * J
    H = np.einsum("mip,miq->pq", weighted, J) + np.diag(problem.prior_sigmas**-2)
    return np.asarray(-np.linalg.solve(H, np.einsum("mip,kmi->pk", weighted, moved / scales)).T)


def larger(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the covariance (P, P) that is in no direction smaller than `a` or `b`."""
    L = np.linalg.cholesky(b)
    inverse = np.linalg.inv(L)
    values, directions = np.linalg.eigh(inverse @ a @ inverse.T)
    across = L @ directions
    return np.asarray((across * np.maximum(values, 1.0)) @ across.T)


def spread(residuals: FloatArray) -> FloatArray:
    """Return robust standard deviations (K,) of (M, K), by the median."""
    return np.asarray(1.4826 * np.median(np.abs(residuals), axis=0))


def _solve(problem: Problem, start: FloatArray, scales: FloatArray, weights: FloatArray) -> FloatArray:
    from scipy.optimize import least_squares

    root = np.sqrt(weights)[:, None] / scales

    def misfit(values: FloatArray) -> FloatArray:
        return np.concatenate([(root * problem.residuals(values)).ravel(), values / problem.prior_sigmas])

    bounds = problem.bounds
    within = start.clip(-0.99 * bounds, 0.99 * bounds)
    return np.asarray(least_squares(misfit, within, jac="3-point", bounds=(-bounds, bounds), x_scale=_STEP * bounds).x)


def robust_weights(chi2: FloatArray) -> FloatArray:
    """Return Geman and McClure's weights (M,) of squared residuals (M,) in units of their scale."""
    return np.asarray((_OUTLIER_CHI2 / (_OUTLIER_CHI2 + chi2)) ** 2)


def _covariances(problem: Problem, values: FloatArray, scales: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the robust cost's inverse Hessian on both sides of its gradient's spread (Huber 1967), and alone.

    Both (P, P). The gradient is summed over runs of neighbouring pieces, which share a pose and its error. The
    covariance for the least spread is added, so that data without noise hide no unobservable direction.
    """
    r = problem.residuals(values) / scales
    J = _jacobian(problem, values) / scales[None, :, None]
    chi2 = (r**2).sum(axis=1)
    w = robust_weights(chi2)
    slope = -4 * _OUTLIER_CHI2**2 / (_OUTLIER_CHI2 + chi2) ** 3
    H = np.einsum("mip,m,miq->pq", J, w, J)
    along = np.einsum("mip,mi->mp", J, r)
    robust = H + np.einsum("mp,m,mq->pq", along, slope, along)
    known = np.diag(problem.prior_sigmas**-2)
    if np.linalg.eigvalsh(robust + known)[0] < 0.1 * np.linalg.eigvalsh(H + known)[0]:
        robust = H
    inverse = np.linalg.inv(robust + known)
    size = -(-len(r) // _MOST_CLUSTERS)
    gradients = np.add.reduceat(w[:, None] * along, np.arange(0, len(r), size))
    groups = len(gradients)
    scatter = gradients.T @ gradients * groups / (groups - len(values))
    whole = J * (scales / _LEAST_SCALE)[None, :, None]
    floor = np.asarray(np.linalg.inv(np.einsum("mip,miq->pq", whole, whole) + known))
    return inverse @ scatter @ inverse + floor, inverse + floor


def _jacobian(problem: Problem, values: FloatArray) -> FloatArray:
    """Return derivatives (M, 3, P) of the residuals, by central differences."""
    steps = 1e-6 * np.eye(len(values))
    columns = [(problem.residuals(values + h) - problem.residuals(values - h)) / 2e-6 for h in steps]
    return np.stack(columns, axis=-1)
