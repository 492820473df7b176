"""Errors of measured poses in a graph, whitened, with Jacobians: what both solvers and the gate mean by an error.

The error of an edge is log(T_first⁻¹ · T_second · T_measured⁻¹), the left perturbation by which the poses depart from
what was measured; that of a prior log(T · T_measured⁻¹).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from wheelsight.geometry import BoolArray, FloatArray, IntArray, se3, so3
from wheelsight.slam.graph import Prior, RelativePose

# Below, Taylor series of the Jacobian's coefficients are exact to 1e-13; above, so are the closed forms.
_SMALL_RAD = 0.3


class EdgeArrays(NamedTuple):
    """Edges as arrays: keyframes (E,), T_second_first (E, 4, 4) as measured, roots of information (E, 6, 6), loops."""

    first: IntArray
    second: IntArray
    T_measured_inverse: FloatArray
    whitening: FloatArray
    is_loop: BoolArray


def arrays_of(edges: Sequence[RelativePose]) -> EdgeArrays:
    """The same, laid side by side."""
    T = np.array([edge.T_first_second for edge in edges], float).reshape(-1, 4, 4)
    return EdgeArrays(
        np.array([edge.first for edge in edges], np.int64),
        np.array([edge.second for edge in edges], np.int64),
        se3.invert(T),
        whitening_of(np.array([edge.covariance for edge in edges], float).reshape(-1, 6, 6)),
        np.array([edge.is_loop for edge in edges], bool),
    )


def arrays_of_priors(priors: Sequence[Prior]) -> tuple[IntArray, FloatArray, FloatArray]:
    """Keyframes (P,), inverses of the poses (P, 4, 4), roots of information (P, 6, 6)."""
    T = np.array([prior.T_map_keyframe for prior in priors], float).reshape(-1, 4, 4)
    C = np.array([prior.covariance for prior in priors], float).reshape(-1, 6, 6)
    return np.array([prior.keyframe for prior in priors], np.int64), se3.invert(T), whitening_of(C)


def whitening_of(covariances: FloatArray) -> FloatArray:
    """W (..., 6, 6) with WᵀW = C⁻¹."""
    return np.linalg.inv(np.linalg.cholesky(covariances)) if len(covariances) else covariances


def edge_errors(T: FloatArray, edges: EdgeArrays) -> FloatArray:
    """Errors (E, 6) at poses (N, 4, 4), not whitened."""
    return se3.log(se3.invert(T[edges.first]) @ T[edges.second] @ edges.T_measured_inverse)


def edge_jacobians(T: FloatArray, edges: EdgeArrays, errors: FloatArray) -> FloatArray:
    """(E, 6, 6) of the errors by the second pose's left perturbation; by the first one's it is the negative."""
    return inverse_left_jacobian(errors) @ se3.adjoint(se3.invert(T[edges.first]))


def cauchy_loss(chi2: FloatArray, scale: float) -> FloatArray:
    """Half of squared whitened errors (...) under Cauchy's kernel: (c²/2) log(1 + χ²/c²)."""
    return np.asarray(scale**2 / 2 * np.log1p(chi2 / scale**2))


def inverse_left_jacobian(xi: FloatArray) -> FloatArray:
    """(..., 6, 6) with log(exp(δ) · exp(ξ)) ≈ ξ + J δ (Barfoot, State Estimation for Robotics, 7.86 and 7.95)."""
    J = so3.left_jacobian(xi[..., 3:])
    J_inverse = np.linalg.inv(J)
    found = np.zeros((*xi.shape[:-1], 6, 6))
    found[..., :3, :3] = found[..., 3:, 3:] = J_inverse
    found[..., :3, 3:] = -J_inverse @ _coupling(xi) @ J_inverse
    return found


def _coupling(xi: FloatArray) -> FloatArray:
    """Q (..., 3, 3), how turning moves what is moved."""
    V, W = so3.hat(xi[..., :3]), so3.hat(xi[..., 3:])
    angle = np.linalg.norm(xi[..., 3:], axis=-1)
    a, b, c = (factor[..., None, None] for factor in _factors(angle))
    WVW = W @ V @ W
    return np.asarray(
        V / 2 + a * (W @ V + V @ W + WVW) - b * (W @ W @ V + V @ W @ W - 3 * WVW) - c / 2 * (WVW @ W + W @ WVW)
    )


def _factors(angle: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients of Q: (φ − sin φ)/φ³, (1 − φ²/2 − cos φ)/φ⁴, and that less 3(φ − sin φ − φ³/6)/φ⁵."""
    s = angle**2
    a = 1 / 6 - s / 120 + s**2 / 5040 - s**3 / 362880 + s**4 / 39916800
    b = -1 / 24 + s / 720 - s**2 / 40320 + s**3 / 3628800 - s**4 / 479001600
    d = -1 / 120 + s / 5040 - s**2 / 362880 + s**3 / 39916800 - s**4 / 6227020800
    large = angle > _SMALL_RAD
    phi = np.where(large, angle, 1.0)
    a = np.where(large, (phi - np.sin(phi)) / phi**3, a)
    b = np.where(large, (1 - phi**2 / 2 - np.cos(phi)) / phi**4, b)
    d = np.where(large, (phi - np.sin(phi) - phi**3 / 6) / phi**5, d)
    return a, b, b - 3 * d
