"""Compiled Gauss–Newton of a turn and a change of exposure by grey values alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from wheelsight.odometry.dense._alignment_kernels import ALONG_U, ALONG_V, GREY
from wheelsight.odometry.dense._step_kernels import fit_exposure, move

# Of the kernels imported, so that numba's cache of this file's ends with theirs; a test tells when to renew it.
_COMPILED_IN = 0x3E24710C

# Sums over pixels: H's upper triangle, b, how many and the sum of absolute errors, then the regression of exposure.
B, COUNT, ABSOLUTE, FIT, TURN_SUMS = 6, 9, 10, 11, 16
_STEPS, _SMALL_TURN = 8, 5e-4
# Huber's limit in grey levels of the reference, and the share of an image's pixels that must be seen in both.
_LIMIT, _LEAST_SHARE = 20.0, 0.3


@njit(cache=True, nogil=True, error_model="numpy")
def find_turn(grey: Any, reference: Any, grid: Any, R: Any, exposure: Any) -> None:
    """Better R_reference_frame (3, 3) and the frame's exposure (gain, offset) in place; the best on the way is kept.

    The exposure is found before the first step: a step of it looks like any motion else.

    Args: as of `accumulate_turn`.
    """
    T, best, sums = np.eye(4), np.inf, np.empty(TURN_SUMS)
    T[:3, :3] = R
    accumulate_turn(grey, reference, grid, T, exposure, np.inf, sums)
    _learn(sums, exposure)
    for _ in range(_STEPS):
        accumulate_turn(grey, reference, grid, T, exposure, exposure[0] * _LIMIT, sums)
        if sums[COUNT] < _LEAST_SHARE * grey.size or sums[ABSOLUTE] / sums[COUNT] > best:
            return
        best = sums[ABSOLUTE] / sums[COUNT]
        R[:] = T[:3, :3]
        change = _solve(sums)
        if np.abs(change).max() < _SMALL_TURN:
            return
        move(change, T)
        _learn(sums, exposure)


@njit(cache=True, nogil=True, error_model="numpy")
def accumulate_turn(grey: Any, reference: Any, grid: Any, R: Any, exposure: Any, limit: float, sums: Any) -> None:
    """Normal equations of a pure rotation R_reference_frame by grey values alone (Whelan et al. 2015, IV.B).

    The error is gain·I_reference + offset - I.

    Args:
        grey: (h, w) of the frame, -1 where unknown.
        reference: (h, w, CHANNELS).
        grid: fx, fy, cx, cy of both.
        R: (3, 3) or larger.
        exposure: (2,) gain and offset.
        limit: Huber's limit in grey levels.
        sums: (TURN_SUMS,).
    """
    height, width = grey.shape
    gain, offset = exposure[0], exposure[1]
    sums[:] = 0.0
    for r in range(height):
        for c in range(width):
            x, y = (c - grid[2]) / grid[0], (r - grid[3]) / grid[1]
            px = R[0, 0] * x + R[0, 1] * y + R[0, 2]
            py = R[1, 0] * x + R[1, 1] * y + R[1, 2]
            pz = R[2, 0] * x + R[2, 1] * y + R[2, 2]
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
            _add(px, py, pz, gx, gy, error, weight, sums)
            sums[FIT] += weight
            sums[FIT + 1] += weight * there
            sums[FIT + 2] += weight * here
            sums[FIT + 3] += weight * there * there
            sums[FIT + 4] += weight * there * here


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _add(px: Any, py: Any, pz: Any, gx: Any, gy: Any, error: Any, weight: Any, sums: Any) -> None:
    """One pixel's share in the normal equations: J = p × g."""
    gz = -(gx * px + gy * py) / pz
    a, b, d = py * gz - pz * gy, pz * gx - px * gz, px * gy - py * gx
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


@njit(cache=True, nogil=True, error_model="numpy")
def _learn(sums: Any, exposure: Any) -> None:
    if sums[FIT] > 0:
        moments = sums[FIT], sums[FIT + 1], sums[FIT + 2], sums[FIT + 3], sums[FIT + 4]
        exposure[0], exposure[1] = fit_exposure(moments, exposure[0])


@njit(cache=True, nogil=True, error_model="numpy")
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
