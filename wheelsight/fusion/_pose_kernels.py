"""A PoseBelief's answer, and how it is corrected; numba over arrays and numbers.

T (1 + K, 4, 4), rest (17,) and P (n, n) are as `_pose_belief` lays them out.
"""

from __future__ import annotations

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import FloatArray, IntArray
from wheelsight.geometry.motion_kernels import adjoint, exp, times

_REST, _PLANE = 17, (0, 1, 5)


@kernel
def answered(
    T: FloatArray, rest: FloatArray, P: FloatArray, clock_s: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The pose now (4, 4) and its covariance (6, 6), the twist (3,) and its own, with stamps that are uncertain so."""
    Ad, late, at = adjoint(T[0]), np.zeros((6, 1)), len(P) - _REST
    for i in range(6):
        for j in range(3):
            late[i, 0] += Ad[i, _PLANE[j]] * rest[j] * clock_s
    return T[0].copy(), P[:6, :6] + times(late, late.T), rest[:3].copy(), P[at : at + 3, at : at + 3].copy()


@kernel
def correct(
    T: FloatArray, rest: FloatArray, P: FloatArray, PHt: FloatArray, S: FloatArray, residual: FloatArray, kept: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """T, rest and P after the Kalman update, of which the numbers `kept` of the state (k,) learn nothing."""
    gain: FloatArray = np.linalg.solve(S, np.ascontiguousarray(PHt.T)).T.astype(np.float64)
    lost = times(gain, PHt.T)
    less = (P + P.T - lost - lost.T) / 2  # what rounding makes askew would grow
    x = np.zeros(len(P))
    for i in range(len(P)):
        for j in range(len(residual)):
            x[i] += gain[i, j] * residual[j]
    for i in kept:
        x[i] = 0.0
        for j in kept:
            less[i, j] = P[i, j]
    T, rest = perturb(T, rest, x)
    return T, rest, less


@kernel
def perturb(T: FloatArray, rest: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """All poses perturbed, and the rest shifted, by x (n,)."""
    moved = np.empty_like(T)
    for i in range(len(T)):
        moved[i] = times(exp(x[6 * i : 6 * i + 6]), T[i])
    return moved, rest + x[6 * len(T) :]
