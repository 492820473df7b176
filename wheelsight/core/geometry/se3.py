"""Rigid motions and rotations in space: SE(3) as 4×4 and SO(3) as 3×3 matrices, in batches of any shape (`...`).

Conventions: `T_a_b` maps points of frame b into frame a: `p_a = T_a_b @ p_b`, so
`T_odom_base @ T_base_camera` cancels by eye. Tangents are ξ = (v, ω), translation first.
Perturbations multiply from the left, `T = exp(δ) @ T_mean`, and a pose's 6×6 covariance is that of δ.
"""

from __future__ import annotations

import math
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from wheelsight.core.geometry.arrays import FloatArray

# At this depth, usual indoors, a turn changes a view as much as the same distance.
_METRES_A_RADIAN = 1.5
_BOTTOM = np.array([0.0, 0.0, 0.0, 1.0])
_UNIT, _RELATIVE = np.eye(3), 1e-5
# Largest error of two decimals; more is another mistake.
_ROUNDED = 0.03
# Rounding makes motions less rigid, and their inverses twice as much; below this they stay.
_RIGID = 1e-12
_SMALL_ANGLE_RAD = 1e-4
_NO_SINE = 1e-12


def from_parts(R: ArrayLike, t: ArrayLike) -> FloatArray:
    """Motions (..., 4, 4) of rotations (..., 3, 3) and translations (..., 3) in metres."""
    R, t = np.asarray(R, float), np.asarray(t, float)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def from_quaternion(t: ArrayLike, quaternion_xyzw: ArrayLike) -> FloatArray:
    """Motions (..., 4, 4) of translations (..., 3) in metres and quaternions (..., 4), xyzw."""
    return from_parts(rotation_of_quaternion(quaternion_xyzw), t)


def from_plane(x: ArrayLike, y: ArrayLike, yaw_rad: ArrayLike) -> FloatArray:
    """Motions (..., 4, 4) in the plane z = 0, of x, y (...) in metres and yaw (...) in radians about z."""
    x, y, yaw_rad = (np.asarray(a, float) for a in (x, y, yaw_rad))
    T = np.zeros((*np.broadcast(x, y, yaw_rad).shape, 4, 4))
    T[..., 0, 0] = T[..., 1, 1] = np.cos(yaw_rad)
    T[..., 1, 0] = np.sin(yaw_rad)
    T[..., 0, 1] = -T[..., 1, 0]
    T[..., 0, 3], T[..., 1, 3] = x, y
    T[..., 2, 2] = T[..., 3, 3] = 1.0
    return T


def exp(xi: ArrayLike) -> FloatArray:
    """Motions (..., 4, 4) of tangents (..., 6), (v, ω) in metres and radians."""
    v, omega = np.split(np.asarray(xi, float), 2, axis=-1)
    T = np.zeros((*omega.shape[:-1], 4, 4))
    T[..., :3, :3], T[..., :3, 3] = rotation(omega), (left_jacobian(omega) @ v[..., None])[..., 0]
    T[..., 3, 3] = 1.0
    return T


def log(T: ArrayLike) -> FloatArray:
    """Tangents (..., 6), (v, ω), of motions (..., 4, 4); the rotation's angle is at most π."""
    T = np.asarray(T, float)
    omega = rotation_vector(T[..., :3, :3])
    v = np.linalg.solve(left_jacobian(omega), T[..., :3, 3, None])[..., 0]
    return np.concatenate([v, omega], axis=-1)


def adjoint(T: ArrayLike) -> FloatArray:
    """Ad (..., 6, 6) with `T @ exp(ξ) @ invert(T) == exp(Ad @ ξ)`, of motions (..., 4, 4)."""
    T = np.asarray(T, float)
    R = T[..., :3, :3]
    Ad = np.zeros((*T.shape[:-2], 6, 6))
    Ad[..., :3, :3] = Ad[..., 3:, 3:] = R
    if T.ndim == 2:  # in plain numbers, as `hat`
        x, y, z = T[:3, 3].tolist()
        Ad[:3, 3:] = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ R
    else:
        Ad[..., :3, 3:] = hat(T[..., :3, 3]) @ R
    return Ad


def position_covariance(T: ArrayLike, covariance: ArrayLike) -> FloatArray:
    """Covariance (..., 3, 3) of positions of poses (..., 4, 4), from (..., 6, 6) of left perturbations (v, ω).

    These move a position p by v + ω × p: J Σ Jᵀ with J = (I, −p̂).
    """
    p, C = np.asarray(T, float)[..., :3, 3], np.asarray(covariance, float)
    J = np.concatenate([np.broadcast_to(np.eye(3), (*p.shape[:-1], 3, 3)), -hat(p)], axis=-1)
    return np.asarray(J @ C @ np.swapaxes(J, -1, -2))


def compose(*motions: ArrayLike) -> FloatArray:
    """The product (..., 4, 4) of motions, left to right: `compose(T_a_b, T_b_c)` is `T_a_c`."""
    return np.asarray(reduce(np.matmul, (np.asarray(T, float) for T in motions)))


def invert(T: ArrayLike) -> FloatArray:
    """`T_b_a` (..., 4, 4) of `T_a_b` (..., 4, 4), by transposing the rotation."""
    T = np.asarray(T, float)
    Rt, inverse = np.swapaxes(T[..., :3, :3], -1, -2), np.zeros(T.shape)
    inverse[..., :3, :3], inverse[..., :3, 3] = Rt, -(Rt @ T[..., :3, 3, None])[..., 0]
    inverse[..., 3, 3] = 1.0
    return inverse


def apply(T: ArrayLike, p: ArrayLike) -> FloatArray:
    """Points (..., N, 3) moved by motions (..., 4, 4): `p_a = apply(T_a_b, p_b)`."""
    T, p = np.asarray(T, float), np.asarray(p, float)
    return np.asarray(p @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3])


def interpolate(T_start: ArrayLike, T_end: ArrayLike, share: ArrayLike) -> FloatArray:
    """Motions (..., 4, 4) a share (...) of the way along the geodesic (screw) from start to end."""
    T_start = np.asarray(T_start, float)
    xi = log(np.asarray(T_end, float) @ invert(T_start))
    return np.asarray(exp(np.asarray(share, float)[..., None] * xi) @ T_start)


def view_shift_m(T: ArrayLike) -> FloatArray:
    """Displacement (...) of a camera's view by motions (..., 4, 4), metres; a radian counts as 1.5 m."""
    T = np.asarray(T, float)
    return np.asarray(np.linalg.norm(T[..., :3, 3], axis=-1) + _METRES_A_RADIAN * angle(T[..., :3, :3]))


def twist_between(T_map_before: FloatArray, T_map_now: FloatArray, seconds: float) -> FloatArray:
    """Mean velocity (6,) of a camera between two poses, (v, ω) per second in its own frame."""
    T_before_now = invert(T_map_before) @ T_map_now
    return np.concatenate([T_before_now[:3, 3], rotation_vector(T_before_now[:3, :3])]) / seconds


def nearest(T: ArrayLike) -> FloatArray:
    """The rigid motions (..., 4, 4) nearest to matrices (..., 4, 4) with rounding errors."""
    T = np.asarray(T, float)
    rigid = np.zeros(T.shape)
    rigid[..., :3, :3], rigid[..., :3, 3], rigid[..., 3, 3] = nearest_rotation(T[..., :3, :3]), T[..., :3, 3], 1.0
    return rigid


def is_valid(T: ArrayLike, tolerance: float = 1e-6) -> bool:
    """Whether every matrix of (..., 4, 4) is finite and a rigid motion within `tolerance`."""
    T = np.asarray(T, float)
    if T.shape[-2:] != (4, 4) or not np.isfinite(T).all():
        return False
    R = T[..., :3, :3]
    if (np.abs(R) > 2 + tolerance).any():  # squares of huge numbers would overflow
        return False
    # As `np.allclose` with its relative tolerance, which takes three times as long.
    orthonormal = (np.abs(R @ np.swapaxes(R, -1, -2) - _UNIT) <= tolerance + _RELATIVE * _UNIT).all()
    bottom = (np.abs(T[..., 3, :] - _BOTTOM) <= tolerance + _RELATIVE * _BOTTOM).all()
    return bool(orthonormal and bottom and (np.linalg.det(R) > 0).all())


def why_invalid(T: ArrayLike, tolerance: float = 1e-6) -> tuple[str, str] | None:
    """The problem and the fix of a (4, 4) that is no rigid motion within `tolerance`, or None."""
    T = np.asarray(T, float)
    if T.shape == (4, 4) and is_valid(T, tolerance):
        return None
    if T.shape != (4, 4):
        return f"it is of shape {T.shape}, not (4, 4)", "rotation and translation in three rows, then 0 0 0 1"
    if not np.isfinite(T).all():
        return "it has numbers that are not finite", "give only what is known"
    if not np.allclose(T[3], _BOTTOM, atol=tolerance):
        if np.allclose(T[:, 3], _BOTTOM, atol=tolerance):
            return "its translation stands in the last row", "transpose it: the translation is the last column"
        return f"its last row is {' '.join(f'{x:g}' for x in T[3])}, not 0 0 0 1", "give [[R, t], [0, 0, 0, 1]]"
    return _why_no_rotation(T[:3, :3], tolerance)


def _why_no_rotation(R: FloatArray, tolerance: float) -> tuple[str, str]:
    product = R @ R.T
    scale = float(np.sqrt(np.trace(product) / 3))
    if np.allclose(product, np.eye(3), atol=tolerance):
        return "its rotation mirrors, determinant -1", "turn one axis around: x, y, z of each frame are right-handed"
    off = float(np.abs(product - np.eye(3)).max())
    if off < _ROUNDED:
        return (
            f"its rotation is orthonormal within {off:.1g}, not {tolerance:g}",
            "give more digits, or wheelsight.core.geometry.se3.nearest(T)",
        )
    if np.allclose(product, scale**2 * np.eye(3), atol=tolerance * scale**2):
        return f"its rotation is scaled by {scale:g}", f"divide the three by three by {scale:g}"
    return "its rotation is not orthonormal", "its columns are the axes of the second frame, in the first, of length 1"


def renormalized(T: ArrayLike) -> FloatArray:
    """Motions (..., 4, 4) without accumulated rounding errors; rigid ones stay to the bit."""
    T = np.asarray(T, float)
    R = T[..., :3, :3]
    off = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(-1, -2))
    return T if (off < _RIGID).all() else np.where((off < _RIGID)[..., None, None], T, nearest(T))


def hat(omega: ArrayLike) -> FloatArray:
    """Skew matrices (..., 3, 3) with `hat(a) @ b == cross(a, b)`, of vectors (..., 3)."""
    omega = np.asarray(omega, float)
    if omega.ndim == 1:
        x, y, z = omega.tolist()
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    x, y, z = np.moveaxis(omega, -1, 0)
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape((*x.shape, 3, 3))


def rotation(omega: ArrayLike) -> FloatArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), radians."""
    omega = np.asarray(omega, float)
    matrices = Rotation.from_rotvec(omega.reshape(-1, 3)).as_matrix()
    return np.asarray(matrices.reshape((*omega.shape[:-1], 3, 3)))


def rotation_vector(R: ArrayLike) -> FloatArray:
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


def rotation_of_quaternion(quaternion_xyzw: ArrayLike) -> FloatArray:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4), xyzw, of any non-zero norm."""
    q = np.asarray(quaternion_xyzw, float)
    return np.asarray(Rotation.from_quat(q.reshape(-1, 4)).as_matrix().reshape((*q.shape[:-1], 3, 3)))


def to_quaternion(R: ArrayLike) -> FloatArray:
    """Unit quaternions (..., 4), xyzw with w ≥ 0, of rotation matrices (..., 3, 3)."""
    R = np.asarray(R, float)
    quaternions = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(canonical=True)
    return np.asarray(quaternions.reshape((*R.shape[:-2], 4)))


def nearest_rotation(M: ArrayLike) -> FloatArray:
    """The rotations (..., 3, 3) nearest to matrices (..., 3, 3) in the Frobenius norm (by SVD)."""
    U, _, Vt = np.linalg.svd(np.asarray(M, float))
    signs = np.ones((*U.shape[:-2], 3))
    signs[..., 2] = np.sign(np.linalg.det(U @ Vt))
    return np.asarray((U * signs[..., None, :]) @ Vt)


def left_jacobian(omega: ArrayLike) -> FloatArray:
    """J (..., 3, 3) with `rotation(ω + δ) ≈ rotation(J δ) @ rotation(ω)`, of rotation vectors (..., 3).

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
