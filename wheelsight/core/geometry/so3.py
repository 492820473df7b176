"""Rotations in space: SO(3) as 3×3 matrices, in batches of any shape (`...`)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from wheelsight.core.geometry.arrays import FloatArray

_SMALL_ANGLE_RAD = 1e-4
_NO_SINE = 1e-12


def hat(omega: ArrayLike) -> FloatArray:
    """Skew matrices (..., 3, 3) with `hat(a) @ b == cross(a, b)`, of vectors (..., 3)."""
    omega = np.asarray(omega, float)
    if omega.ndim == 1:
        x, y, z = omega.tolist()
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    x, y, z = np.moveaxis(omega, -1, 0)
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape((*x.shape, 3, 3))


def exp(omega: ArrayLike) -> FloatArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), radians."""
    omega = np.asarray(omega, float)
    matrices = Rotation.from_rotvec(omega.reshape(-1, 3)).as_matrix()
    return np.asarray(matrices.reshape((*omega.shape[:-1], 3, 3)))


def log(R: ArrayLike) -> FloatArray:
    """Rotation vectors (..., 3) in radians, of angle at most π, of rotation matrices (..., 3, 3)."""
    R = np.asarray(R, float)
    if R.ndim == 2:
        x, y, z, w = _quaternion_of(R)
        sine = math.sqrt(x * x + y * y + z * z)
        scale = 2 * math.atan2(sine, w) / sine if sine > _NO_SINE else 2.0
        return np.array([scale * x, scale * y, scale * z])
    vectors = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(vectors.reshape((*R.shape[:-2], 3)))


def angle(R: ArrayLike) -> FloatArray:
    """Angles (...) in radians, 0 to π, of rotation matrices (..., 3, 3)."""
    R = np.asarray(R, float)
    if R.ndim == 2:
        x, y, z, w = _quaternion_of(R)
        return np.asarray(2 * math.atan2(math.sqrt(x * x + y * y + z * z), w))
    return np.asarray(Rotation.from_matrix(R.reshape(-1, 3, 3)).magnitude().reshape(R.shape[:-2]))


def from_quaternion(quaternion_xyzw: ArrayLike) -> FloatArray:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4), xyzw, of any non-zero norm."""
    q = np.asarray(quaternion_xyzw, float)
    return np.asarray(Rotation.from_quat(q.reshape(-1, 4)).as_matrix().reshape((*q.shape[:-1], 3, 3)))


def to_quaternion(R: ArrayLike) -> FloatArray:
    """Unit quaternions (..., 4), xyzw with w ≥ 0, of rotation matrices (..., 3, 3)."""
    R = np.asarray(R, float)
    quaternions = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(canonical=True)
    return np.asarray(quaternions.reshape((*R.shape[:-2], 4)))


def nearest(M: ArrayLike) -> FloatArray:
    """The rotations (..., 3, 3) nearest to matrices (..., 3, 3) in the Frobenius norm (by SVD)."""
    U, _, Vt = np.linalg.svd(np.asarray(M, float))
    signs = np.ones((*U.shape[:-2], 3))
    signs[..., 2] = np.sign(np.linalg.det(U @ Vt))
    return np.asarray((U * signs[..., None, :]) @ Vt)


def left_jacobian(omega: ArrayLike) -> FloatArray:
    """J (..., 3, 3) with `exp(ω + δ) ≈ exp(J δ) exp(ω)`, of rotation vectors (..., 3).

    Closed form of Barfoot, State Estimation for Robotics (2017), eq. 7.77; series near zero.
    """
    omega = np.asarray(omega, float)
    if omega.ndim == 1:  # in plain numbers, as `_quaternion_of`
        x, y, z = omega.tolist()
        W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        angle_rad = math.sqrt(x * x + y * y + z * z)
        a, b = 0.5, 1 / 6 - angle_rad**2 / 120
        if angle_rad >= _SMALL_ANGLE_RAD:
            a, b = 2 * (math.sin(angle_rad / 2) / angle_rad) ** 2, (angle_rad - math.sin(angle_rad)) / angle_rad**3
        return np.asarray(np.eye(3) + a * W + b * (W @ W))
    W, theta = hat(omega), np.linalg.norm(omega, axis=-1)[..., None, None]
    first = 0.5 * np.sinc(theta / (2 * np.pi)) ** 2  # (1 - cos θ) / θ² without its cancellation
    small = theta < _SMALL_ANGLE_RAD
    t = np.where(small, 1.0, theta)
    second = np.where(small, 1 / 6 - theta**2 / 120, (t - np.sin(t)) / t**3)
    return np.asarray(np.eye(3) + first * W + second * (W @ W))


def _quaternion_of(R: FloatArray) -> tuple[float, float, float, float]:
    """x, y, z, w with w ≥ 0 of one rotation (3, 3), from its largest part (Shepperd 1978).

    In plain numbers, because arrays take fifty times as long for a single rotation. Raises ValueError for a mirrored
    one, as for batches.
    """
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    if a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) <= 0:
        raise ValueError(f"a matrix is mirrored, and no rotation:\n{R}")
    trace = a + e + i
    if trace >= max(a, e, i):
        q = (h - f, c - g, d - b, 1 + trace)
    elif a >= e and a >= i:
        q = (1 + 2 * a - trace, b + d, c + g, h - f)
    elif e >= i:
        q = (b + d, 1 + 2 * e - trace, f + h, c - g)
    else:
        q = (c + g, f + h, 1 + 2 * i - trace, d - b)
    norm = math.copysign(math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2), q[3])
    return q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm
