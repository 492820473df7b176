"""Natural cubic splines as weights of their knots' values, and sampled where files hold lines."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from wheelsight.geometry import FloatArray, PinholeCamera

_PIECES = 3


def cubic_weights(at: FloatArray, knots: FloatArray, derivative: int = 0) -> FloatArray:
    """What the value at each of the knots (K,), two or more, counts at (N,): (N, K); constant beyond the last ones.

    Or for the spline's derivative there.
    """
    spline = CubicSpline(knots, np.eye(len(knots)), bc_type="natural")
    inside = (at >= knots[0]) & (at <= knots[-1])
    found = np.asarray(spline(np.clip(at, knots[0], knots[-1]), derivative), float)
    return np.where(inside[:, None], found, 0.0) if derivative else found


def cubic_grid_weights(px: FloatArray, camera: PinholeCamera, grid: tuple[int, int]) -> FloatArray:
    """What each knot (rows · columns) of a grid over the image counts at pixels (N, 2): (N, rows · columns)."""
    down = cubic_weights(px[:, 1] / max(camera.height - 1, 1), np.linspace(0, 1, grid[0]))
    across = cubic_weights(px[:, 0] / max(camera.width - 1, 1), np.linspace(0, 1, grid[1]))
    return (down[:, :, None] * across[:, None, :]).reshape(len(px), -1)


def finer(values: FloatArray, most: int, axis: int = 0) -> FloatArray:
    """Values at evenly spread knots along an axis, and up to two between each: straight pieces in place of the spline.

    No more than `most` (at least as many as there are). Three pieces leave a ninth of what one would be off by.
    """
    count = values.shape[axis]
    pieces = max(min(_PIECES, (most - 1) // (count - 1)), 1)
    weights = cubic_weights(np.linspace(0, count - 1, pieces * (count - 1) + 1), np.arange(count, dtype=float))
    return np.moveaxis(np.tensordot(weights, values, axes=(1, axis)), 0, axis)
