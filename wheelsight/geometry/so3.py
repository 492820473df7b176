"""Rotations in space: SO(3) as 3×3 matrices, in batches of any shape (`...`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from wheelsight.geometry._types import FloatArray

_SMALL_ANGLE_RAD = 1e-4


def hat(omega: ArrayLike) -> FloatArray:
    """Skew matrices (..., 3, 3) with `hat(a) @ b == cross(a, b)`, of vectors (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(omega, float), -1, 0)
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
    vectors = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(vectors.reshape((*R.shape[:-2], 3)))


def angle(R: ArrayLike) -> FloatArray:
    """Angles (...) in radians, 0 to π, of rotation matrices (..., 3, 3)."""
    R = np.asarray(R, float)
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
    theta = np.linalg.norm(omega, axis=-1)[..., None, None]
    first = 0.5 * np.sinc(theta / (2 * np.pi)) ** 2  # (1 - cos θ) / θ² without its cancellation
    small = theta < _SMALL_ANGLE_RAD
    t = np.where(small, 1.0, theta)
    second = np.where(small, 1 / 6 - theta**2 / 120, (t - np.sin(t)) / t**3)
    W = hat(omega)
    return np.asarray(np.eye(3) + first * W + second * (W @ W))
