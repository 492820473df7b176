"""Compiled exp, log, adjoint and left Jacobian of single motions, and checks of covariances.

`geometry.se3` has the first four for batches, and takes a hundred times as long for a single motion.
"""

from __future__ import annotations

import math

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import FloatArray

_MOST_TERMS = 40
_METRES_A_RADIAN = 1.5  # as in `se3.view_shift_m`


@kernel
def times(A: FloatArray, B: FloatArray) -> FloatArray:
    """The product of small matrices of any layout."""
    C = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            for j in range(B.shape[1]):
                C[i, j] += A[i, k] * B[k, j]
    return C


@kernel
def times_transposed(A: FloatArray, B: FloatArray) -> FloatArray:
    """A Bᵀ of small matrices: a product with a view would compile `times` for its layout too."""
    C = np.zeros((A.shape[0], B.shape[0]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            for j in range(B.shape[0]):
                C[i, j] += A[i, k] * B[j, k]
    return C


@kernel
def sandwiched(A: FloatArray, C: FloatArray) -> FloatArray:
    """A C Aᵀ of small matrices."""
    return times_transposed(times(A, C), A)


@kernel
def _hat(x: float, y: float, z: float) -> FloatArray:
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@kernel
def _square(W: FloatArray, i: int, j: int) -> float:
    """Entry of W @ W for W (3, 3)."""
    entry: float = W[i, 0] * W[0, j] + W[i, 1] * W[1, j] + W[i, 2] * W[2, j]
    return entry


@kernel
def exp(xi: FloatArray) -> FloatArray:
    """T (4, 4) of a tangent (6,), (v, ω)."""
    W = _hat(xi[3], xi[4], xi[5])
    angle = math.sqrt(xi[3] ** 2 + xi[4] ** 2 + xi[5] ** 2)
    a, b, c = 1 - angle**2 / 6, 0.5 - angle**2 / 24, 1 / 6 - angle**2 / 120
    if angle > 1e-3:
        half = math.sin(angle / 2) / angle
        a, b, c = math.sin(angle) / angle, 2 * half**2, (angle - math.sin(angle)) / angle**3
    T = np.zeros((4, 4))
    T[0, 0] = T[1, 1] = T[2, 2] = T[3, 3] = 1.0
    for i in range(3):
        for j in range(3):
            W2 = _square(W, i, j)
            T[i, j] += a * W[i, j] + b * W2
            T[i, 3] += (b * W[i, j] + c * W2 + (1.0 if i == j else 0.0)) * xi[j]
    return T


@kernel
def log(T: FloatArray) -> FloatArray:
    """Tangent (6,) of T (4, 4); the angle is at most π."""
    x, y, z, w = _quaternion(T)
    sine = math.sqrt(x * x + y * y + z * z)
    angle = 2 * math.atan2(sine, w)
    scale = angle / sine if sine > 1e-12 else 2.0
    xi = np.zeros(6)
    xi[3], xi[4], xi[5] = scale * x, scale * y, scale * z
    W = _hat(xi[3], xi[4], xi[5])
    b = 1 / 12 + angle**2 / 720
    if angle > 1e-2:
        b = (1 - angle / 2 / math.tan(angle / 2)) / angle**2 if angle < math.pi else 1 / math.pi**2
    for i in range(3):
        for j in range(3):
            xi[i] += ((1.0 if i == j else 0.0) - 0.5 * W[i, j] + b * _square(W, i, j)) * T[j, 3]
    return xi


@kernel
def view_shift_m(T: FloatArray) -> float:
    """Displacement of a camera's view by T (4, 4), metres; a radian counts as 1.5 m."""
    x, y, z, w = _quaternion(T)
    way_m = math.sqrt(T[0, 3] ** 2 + T[1, 3] ** 2 + T[2, 3] ** 2)
    return way_m + _METRES_A_RADIAN * 2 * math.atan2(math.sqrt(x * x + y * y + z * z), w)


@kernel
def _quaternion(T: FloatArray) -> tuple[float, float, float, float]:
    """x, y, z, w with w ≥ 0 of the rotation of T, from its largest part (Shepperd 1978)."""
    trace = T[0, 0] + T[1, 1] + T[2, 2]
    if trace > max(T[0, 0], T[1, 1], T[2, 2]):
        x, y, z, w = T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1], 1 + trace
    elif T[0, 0] >= T[1, 1] and T[0, 0] >= T[2, 2]:
        x, y, z, w = 1 + 2 * T[0, 0] - trace, T[0, 1] + T[1, 0], T[0, 2] + T[2, 0], T[2, 1] - T[1, 2]
    elif T[1, 1] >= T[2, 2]:
        x, y, z, w = T[0, 1] + T[1, 0], 1 + 2 * T[1, 1] - trace, T[1, 2] + T[2, 1], T[0, 2] - T[2, 0]
    else:
        x, y, z, w = T[0, 2] + T[2, 0], T[1, 2] + T[2, 1], 1 + 2 * T[2, 2] - trace, T[1, 0] - T[0, 1]
    length = math.sqrt(x**2 + y**2 + z**2 + w**2) * (1.0 if w >= 0 else -1.0)
    return x / length, y / length, z / length, w / length


@kernel
def adjoint(T: FloatArray) -> FloatArray:
    """Ad (6, 6) of T (4, 4)."""
    Ad = np.zeros((6, 6))
    W = _hat(T[0, 3], T[1, 3], T[2, 3])
    for i in range(3):
        for j in range(3):
            Ad[i, j] = Ad[i + 3, j + 3] = T[i, j]
            Ad[i, j + 3] = W[i, 0] * T[0, j] + W[i, 1] * T[1, j] + W[i, 2] * T[2, j]
    return Ad


@kernel
def inverse_adjoint(T: FloatArray) -> FloatArray:
    """Ad (6, 6) of the inverse of T (4, 4)."""
    return adjoint(inverse(T))


@kernel
def inverse(T: FloatArray) -> FloatArray:
    """T_b_a (4, 4) of T_a_b (4, 4)."""
    back = np.zeros((4, 4))
    back[3, 3] = 1.0
    for i in range(3):
        for j in range(3):
            back[i, j] = T[j, i]
            back[i, 3] -= T[j, i] * T[j, 3]
    return back


@kernel
def renormalized(T: FloatArray) -> FloatArray:
    """The rigid motion (4, 4) nearest to T (4, 4), which is nearly one: an error of 1e-4 becomes 1e-15.

    Two steps of Newton's for the polar decomposition (Higham 1986), which need no singular values.
    """
    near = T.copy()
    for _ in range(2):
        R = near[:3, :3].copy()
        cube = times(times_transposed(R, R), R)
        for i in range(3):
            for j in range(3):
                near[i, j] = 1.5 * R[i, j] - 0.5 * cube[i, j]
    return near


@kernel
def carried(T_a_b: FloatArray, covariance: FloatArray) -> FloatArray:
    """Transform a covariance (6, 6) of a left perturbation from frame b to frame a."""
    return sandwiched(adjoint(T_a_b), covariance)


@kernel
def is_motion(T: FloatArray) -> bool:
    """Whether T (4, 4) is a rigid motion, and finite."""
    if not np.isfinite(T).all():
        return False
    worst = max(abs(T[3, 0]), abs(T[3, 1]), abs(T[3, 2]), abs(T[3, 3] - 1))
    turned = 0.0  # the determinant
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        turned += T[0, i] * (T[1, j] * T[2, k] - T[1, k] * T[2, j])
    for i in range(3):
        for j in range(3):
            product = T[i, 0] * T[j, 0] + T[i, 1] * T[j, 1] + T[i, 2] * T[j, 2]
            worst = max(worst, abs(product - (1.0 if i == j else 0.0)))
    return worst < 1e-6 and turned > 0


@kernel
def is_covariance(C: FloatArray) -> bool:
    """Whether C (n, n) is finite, symmetric, and has no negative eigenvalue, to rounding."""
    most, asymmetry, symmetric = 0.0, 0.0, np.empty(C.shape)
    for i in range(len(C)):
        for j in range(len(C)):
            if not math.isfinite(C[i, j]):
                return False
            most, asymmetry = max(most, abs(C[i, j])), max(asymmetry, abs(C[i, j] - C[j, i]))
            symmetric[i, j] = (C[i, j] + C[j, i]) / 2
    least: float = np.linalg.eigvalsh(symmetric)[0]
    return asymmetry <= 1e-6 * most and least >= -1e-9 * most


@kernel
def is_pose(T: FloatArray, C: FloatArray) -> bool:
    """Whether T (4, 4) is a rigid motion and C (6, 6) a covariance."""
    return is_motion(T) and is_covariance(C)


@kernel
def is_definite(C: FloatArray) -> bool:
    """Whether C (n, n), symmetric, has only positive eigenvalues."""
    least: float = np.linalg.eigvalsh(C)[0]
    return least > 0


@kernel
def chi_squared(residual: FloatArray, S: FloatArray) -> float:
    """rᵀ S⁻¹ r of a residual (m,) with its covariance (m, m)."""
    weighed = np.linalg.solve(S, residual)
    chi2 = 0.0
    for i in range(len(residual)):
        chi2 += residual[i] * weighed[i]
    return chi2


@kernel
def between(
    T_before: FloatArray, C_before: FloatArray, T_now: FloatArray, C_now: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return T (4, 4) from one pose to the next, and the growth of their covariances (6, 6), in the frame before."""
    T_before_odom = inverse(T_before)
    return times(T_before_odom, T_now), carried(T_before_odom, C_now - C_before)


@kernel
def step_between(
    T_before: FloatArray, C_before: FloatArray, T_now: FloatArray, C_now: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return ξ (6,) from one pose to the next, and the growth of their covariances, without negative eigenvalues."""
    T, grown = between(T_before, C_before, T_now, C_now)
    strength, axes = np.linalg.eigh((grown + grown.T) / 2)
    axes_by_rows = axes.copy()  # LAPACK's are stored by columns
    return log(T), times_transposed(axes_by_rows * np.maximum(strength, 0.0), axes_by_rows)


@kernel
def left_jacobian(xi: FloatArray) -> FloatArray:
    """J (6, 6) with exp(ξ + δ) ≈ exp(J δ) exp(ξ): the series of ad(ξ)ⁿ / (n + 1)!, which converges for every ξ."""
    ad, W, V = np.zeros((6, 6)), _hat(xi[3], xi[4], xi[5]), _hat(xi[0], xi[1], xi[2])
    for i in range(3):
        for j in range(3):
            ad[i, j], ad[3 + i, 3 + j], ad[i, 3 + j] = W[i, j], W[i, j], V[i, j]
    J, term = np.eye(6), np.eye(6)
    for n in range(1, _MOST_TERMS):
        term, is_last = times(term, ad), True
        for i in range(6):
            for j in range(6):
                term[i, j] /= n + 1
                J[i, j] += term[i, j]
                is_last &= abs(term[i, j]) < 1e-15
        if is_last:
            break
    return J
