"""Compiled Gauss–Newton of a turn and a change of exposure by grey values alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.odometry.dense._alignment_kernels import ALONG_U, ALONG_V, GREY, Images
from wheelsight.odometry.dense._step_kernels import fit_exposure, move

# Sums over pixels: H's upper triangle, b, how many and the sum of absolute errors, then the regression of exposure.
B, COUNT, ABSOLUTE, FIT, TURN_SUMS = 6, 9, 10, 11, 16
_STEPS, _SMALL_TURN = 8, 5e-4
# Huber's limit in grey levels of the reference, and the share of an image's pixels that must be seen in both.
_LIMIT, _LEAST_SHARE = 20.0, 0.3


@kernel(error_model="numpy")
def find_turn(images: Images, T: Any, exposure: Any) -> None:
    """Better rotation of T_reference_frame and exposure (gain, offset) in place; the best on the way is kept.

    The exposure is found before the first step: a step of it looks like any motion else.

    Args: as of `accumulate_turn`.
    """
    best, sums, tried = np.inf, np.empty(TURN_SUMS), T.copy()
    accumulate_turn(images, tried, exposure, np.inf, sums)
    _learn(sums, exposure)
    for _ in range(_STEPS):
        accumulate_turn(images, tried, exposure, exposure[0] * _LIMIT, sums)
        if sums[COUNT] < _LEAST_SHARE * images.grey.size or sums[ABSOLUTE] / sums[COUNT] > best:
            return
        best = sums[ABSOLUTE] / sums[COUNT]
        T[:] = tried
        change = _solve(sums)
        if np.abs(change).max() < _SMALL_TURN:
            return
        move(change, tried)
        tried[:3, 3] = T[:3, 3]
        _learn(sums, exposure)


@kernel(error_model="numpy")
def accumulate_turn(images: Images, T: Any, exposure: Any, limit: float, sums: Any) -> None:
    """Normal equations of a rotation on the spot, R ← exp(ω) R, by grey values alone (Whelan et al. 2015, IV.B).

    There the frame before is the reference, and images are turned as if all were far away. A keyframe may lie metres
    back: points are therefore placed by their depth and the expected way, and only those without depth far away.
    The error is gain·I_reference + offset - I.

    Args:
        images: frame and reference; their grid is float64.
        T: (4, 4) T_reference_frame.
        exposure: (2,) gain and offset.
        limit: Huber's limit in grey levels.
        sums: (TURN_SUMS,).
    """
    depth_m, grey, reference, grid = images.depth_m, images.grey, images.reference, images.grid
    height, width = grey.shape
    gain, offset = exposure[0], exposure[1]
    sums[:] = 0.0
    for r in range(height):
        for c in range(width):
            x, y = (c - grid[2]) / grid[0], (r - grid[3]) / grid[1]
            near = 1.0 / depth_m[r, c] if depth_m[r, c] > 0 else 0.0
            qx, qy, qz = _turned(T, x, y)
            px, py, pz = qx + near * T[0, 3], qy + near * T[1, 3], qz + near * T[2, 3]
            if pz < 0.1:
                continue
            u, v = grid[0] * px / pz + grid[2], grid[1] * py / pz + grid[3]
            if not (1 <= u < width - 2 and 1 <= v < height - 2):
                continue
            column, line = int(u + 0.5), int(v + 0.5)
            here, there = grey[r, c], reference[line, column, GREY]
            gx = gain * reference[line, column, ALONG_U] * grid[0] / pz
            gy = gain * reference[line, column, ALONG_V] * grid[1] / pz
            if here < 0 or np.isnan(there + gx + gy):
                continue
            error = gain * there + offset - here
            weight = 1.0 if abs(error) <= limit else limit / abs(error)
            _add((qx, qy, qz), (gx, gy, -(gx * px + gy * py) / pz), error, weight, sums)
            _add_exposure(there, here, weight, sums)


@kernel(error_model="numpy", inline="always")
def _turned(T: Any, x: Any, y: Any) -> Any:
    """The ray (x, y, 1), turned."""
    qx = T[0, 0] * x + T[0, 1] * y + T[0, 2]
    qy = T[1, 0] * x + T[1, 1] * y + T[1, 2]
    qz = T[2, 0] * x + T[2, 1] * y + T[2, 2]
    return qx, qy, qz


@kernel(error_model="numpy", inline="always")
def _add_exposure(there: Any, here: Any, weight: Any, sums: Any) -> None:
    """One pixel's share in the regression of exposure."""
    sums[FIT] += weight
    sums[FIT + 1] += weight * there
    sums[FIT + 2] += weight * here
    sums[FIT + 3] += weight * there * there
    sums[FIT + 4] += weight * here * here


@kernel(error_model="numpy", inline="always")
def _add(q: Any, g: Any, error: Any, weight: Any, sums: Any) -> None:
    """One pixel's share in the normal equations: J = q × g."""
    (qx, qy, qz), (gx, gy, gz) = q, g
    a, b, d = qy * gz - qz * gy, qz * gx - qx * gz, qx * gy - qy * gx
    sums[0] += weight * a * a
    sums[1] += weight * a * b
    sums[2] += weight * a * d
    sums[3] += weight * b * b
    sums[4] += weight * b * d
    sums[5] += weight * d * d
    sums[B] += weight * a * error
    sums[B + 1] += weight * b * error
    sums[B + 2] += weight * d * error
    sums[COUNT] += 1
    sums[ABSOLUTE] += abs(error)


@kernel(error_model="numpy")
def _learn(sums: Any, exposure: Any) -> None:
    if sums[FIT] > 0:
        moments = sums[FIT], sums[FIT + 1], sums[FIT + 2], sums[FIT + 3], sums[FIT + 4]
        exposure[0], exposure[1] = fit_exposure(moments, exposure[0])


@kernel(error_model="numpy")
def _solve(sums: Any) -> Any:
    """-H⁻¹ b as a twist (0, ω) (6,), by cofactors; H is damped a little, for a plain wall shows no turn."""
    damping = 1e-6 * (sums[0] + sums[3] + sums[5]) + 1e-9
    a, b, c, d, e, f = sums[0] + damping, sums[1], sums[2], sums[3] + damping, sums[4], sums[5] + damping
    A, B_, C, D, E, F = d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b
    x, y, z = sums[B], sums[B + 1], sums[B + 2]
    det = a * A + b * B_ + c * C
    change = np.zeros(6)
    change[3] = -(A * x + B_ * y + C * z) / det
    change[4] = -(B_ * x + D * y + E * z) / det
    change[5] = -(C * x + E * y + F * z) / det
    return change
