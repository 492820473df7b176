"""Rigid motions in the plane: SE(2) as 3×3 matrices, in batches of any shape (`...`).

Same conventions as `se3`: tangents (v, ω) = (vx, vy, ω), perturbations from the left.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.geometry.arrays import FloatArray


def wrap_angle(angle_rad: ArrayLike) -> FloatArray:
    """Angles (...) brought into [-π, π] by atan2 (Trinh et al., Fig. 3)."""
    angle_rad = np.asarray(angle_rad, float)
    return np.asarray(np.arctan2(np.sin(angle_rad), np.cos(angle_rad)))


def from_parts(x: ArrayLike, y: ArrayLike, yaw_rad: ArrayLike) -> FloatArray:
    """Motions (..., 3, 3) of x, y (...) in metres and yaw (...) in radians."""
    x, y, yaw_rad = np.broadcast_arrays(*(np.asarray(a, float) for a in (x, y, yaw_rad)))
    c, s, o = np.cos(yaw_rad), np.sin(yaw_rad), np.zeros(np.shape(x))
    return np.stack([c, -s, x, s, c, y, o, o, o + 1], axis=-1).reshape((*c.shape, 3, 3))


def to_parts(T: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """x, y in metres and yaw in [-π, π] radians, each (...), of motions (..., 3, 3)."""
    T = np.asarray(T, float)
    return T[..., 0, 2], T[..., 1, 2], np.arctan2(T[..., 1, 0], T[..., 0, 0])


def exp(xi: ArrayLike) -> FloatArray:
    """Motions (..., 3, 3) of tangents (..., 3), (vx, vy, ω): an arc of constant curvature."""
    vx, vy, omega = np.moveaxis(np.asarray(xi, float), -1, 0)
    sine, cosine = _arc_factors(omega)
    return from_parts(sine * vx - cosine * vy, cosine * vx + sine * vy, omega)


def log(T: ArrayLike) -> FloatArray:
    """Tangents (..., 3), (vx, vy, ω), of motions (..., 3, 3); ω lies in [-π, π]."""
    x, y, omega = to_parts(T)
    sine, cosine = _arc_factors(omega)
    norm = sine**2 + cosine**2
    return np.stack([(sine * x + cosine * y) / norm, (sine * y - cosine * x) / norm, omega], axis=-1)


def compose(*motions: ArrayLike) -> FloatArray:
    """The product (..., 3, 3) of motions, left to right: `compose(T_a_b, T_b_c)` is `T_a_c`."""
    return np.asarray(reduce(np.matmul, (np.asarray(T, float) for T in motions)))


def invert(T: ArrayLike) -> FloatArray:
    """`T_b_a` (..., 3, 3) of `T_a_b` (..., 3, 3)."""
    x, y, yaw_rad = to_parts(T)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return from_parts(-c * x - s * y, s * x - c * y, -yaw_rad)


def apply(T: ArrayLike, p: ArrayLike) -> FloatArray:
    """Points (..., N, 2) moved by motions (..., 3, 3): `p_a = apply(T_a_b, p_b)`."""
    T, p = np.asarray(T, float), np.asarray(p, float)
    return np.asarray(p @ np.swapaxes(T[..., :2, :2], -1, -2) + T[..., None, :2, 2])


def _arc_factors(omega: FloatArray) -> tuple[FloatArray, FloatArray]:
    """sin(ω)/ω and (1 - cos(ω))/ω, exact down to zero."""
    return np.sinc(omega / np.pi), omega / 2 * np.sinc(omega / (2 * np.pi)) ** 2
