"""Compiled steps of Gauss–Newton: normal equations solved, the motion moved on, residual scales learned."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.odometry.dense._alignment_kernels import (
    FIT_N,
    FIT_X,
    FIT_XX,
    FIT_Y,
    FIT_YY,
    GREY_COUNT,
    GREY_SUMS,
    PLANE_COUNT,
    SUMS,
)

# Entries of `how`; see `accumulate`.
GATE, PLANE_SCALE, GREY_SIGMA, GAIN, OFFSET, HUBER, GREY_WEIGHT, COLOR_SIGMA, LEAST_SLOPE, OWN_NOISE = range(10)

# Mean absolute value of a standard normal variable.
MEAN_ABS = 0.7978845608028654
_PLANE_SCALES = (1.0, 4.0)
_GREY_SIGMAS = (3.0, 30.0)
_GAINS = (0.3, 3.0)
_FEWEST = 100


@kernel(error_model="numpy")
def advance(sums: Any, T: Any, how: Any, total: Any, T_held: Any, hold: Any) -> float:
    """One step: add up the rows' sums, move T (4, 4) in place, and adapt `how`. The largest part of the change.

    Args:
        sums: (rows, SUMS) as `accumulate` leaves them.
        T: (4, 4) T_reference_frame.
        how: as `accumulate` takes it; scales of residuals and exposure are learned from the residuals.
        total: (SUMS,) becomes the sum over rows.
        T_held, hold: where T is held (4, 4), and by how much information (6, 6) of its tangent.
    """
    total[:] = 0.0
    for r in range(sums.shape[0]):
        for k in range(SUMS):
            total[k] += sums[r, k]
    change = solve(total, hold, offset(T, T_held))
    move(change, T)
    _learn(total, how)
    return float(np.abs(change).max())


@kernel(error_model="numpy")
def offset(T: Any, T_held: Any) -> Any:
    """The tangent (6,) from T_held to T, to first order."""
    d, D = np.zeros(6), np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            D[i, j] = T[i, 0] * T_held[j, 0] + T[i, 1] * T_held[j, 1] + T[i, 2] * T_held[j, 2]
    for i in range(3):
        d[i] = T[i, 3] - D[i, 0] * T_held[0, 3] - D[i, 1] * T_held[1, 3] - D[i, 2] * T_held[2, 3]
    d[3], d[4], d[5] = (D[2, 1] - D[1, 2]) / 2, (D[0, 2] - D[2, 0]) / 2, (D[1, 0] - D[0, 1]) / 2
    return d


@kernel(error_model="numpy")
def solve(total: Any, hold: Any, held: Any) -> Any:
    """-H⁻¹ b (6,) by Cholesky, with information `hold` (6, 6) that says to undo `held` (6,).

    H is damped so slightly that only directions nobody saw feel it.
    """
    H, k, trace = np.empty((6, 6)), 0, 0.0
    x = -total[21:27] - total[GREY_SUMS + 21 : GREY_SUMS + 27]
    for i in range(6):
        for j in range(i, 6):
            H[i, j] = H[j, i] = total[k] + total[GREY_SUMS + k] + hold[i, j]
            k += 1
        for j in range(6):
            x[i] -= hold[i, j] * held[j]
        trace += H[i, i]
    for i in range(6):
        H[i, i] += 1e-9 * trace + 1e-12
    for i in range(6):
        for j in range(i):
            H[i, i] -= H[i, j] * H[i, j]
        H[i, i] = np.sqrt(max(H[i, i], 1e-12 * trace + 1e-300))
        for n in range(i + 1, 6):
            for j in range(i):
                H[n, i] -= H[n, j] * H[i, j]
            H[n, i] /= H[i, i]
    for i in range(6):
        for j in range(i):
            x[i] -= H[i, j] * x[j]
        x[i] /= H[i, i]
    for i in range(5, -1, -1):
        for j in range(i + 1, 6):
            x[i] -= H[j, i] * x[j]
        x[i] /= H[i, i]
    return x


@kernel(error_model="numpy")
def move(change: Any, T: Any) -> None:
    """T ← exp(change) T, with change (v, ω)."""
    angle2 = change[3] ** 2 + change[4] ** 2 + change[5] ** 2
    angle = np.sqrt(angle2)
    if angle < 1e-4:
        a, b, d = 1 - angle2 / 6, 0.5 - angle2 / 24, 1 / 6 - angle2 / 120
    else:
        a, b, d = np.sin(angle) / angle, (1 - np.cos(angle)) / angle2, (angle - np.sin(angle)) / (angle2 * angle)
    W = np.zeros((3, 3))
    W[0, 1], W[0, 2], W[1, 2] = -change[5], change[4], -change[3]
    W[1, 0], W[2, 0], W[2, 1] = change[5], -change[4], change[3]
    WW = _product(W, W)
    R, V = np.eye(3) + a * W + b * WW, np.eye(3) + b * W + d * WW
    moved = np.empty((3, 4))
    for i in range(3):
        for j in range(4):
            moved[i, j] = R[i, 0] * T[0, j] + R[i, 1] * T[1, j] + R[i, 2] * T[2, j]
        moved[i, 3] += V[i, 0] * change[0] + V[i, 1] * change[1] + V[i, 2] * change[2]
    T[:3] = moved


@kernel(error_model="numpy")
def place_rows(T: Any, T_previous_reference: Any, seconds: float, twist: Any, late_s: Any, T_rows: Any) -> None:
    """T_reference_frame (h, 3, 4) of each row, whose points the twist they were straightened by may have misplaced.

    Args:
        T: (4, 4) T_reference_frame of the middle row.
        T_previous_reference: (4, 4) of the camera at the frame before, `seconds` ago.
        twist: (6,) by which the frame was straightened.
        late_s: (h,) how long after the middle row each row was read.
    """
    step = _product(T_previous_reference, T)
    wrong = np.empty(6)
    wrong[:3] = step[:3, 3] / seconds - twist[:3]
    wrong[3:] = _turn(step) / seconds - twist[3:]
    M = np.zeros((4, 4))
    M[0, 1], M[0, 2], M[1, 2] = -wrong[5], wrong[4], -wrong[3]
    M[1, 0], M[2, 0], M[2, 1] = wrong[5], -wrong[4], wrong[3]
    M[:3, 3] = wrong[:3]
    change = _product(T, M)
    for r in range(len(late_s)):
        for i in range(3):
            for j in range(4):
                T_rows[r, i, j] = T[i, j] + late_s[r] * change[i, j]


@kernel(error_model="numpy")
def _turn(T: Any) -> Any:
    """Rotation vector (3,) of T; half a turn comes out as nothing, which no camera makes between frames."""
    axis = np.array([T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]])
    sine = 0.5 * np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    angle = np.arctan2(sine, 0.5 * (T[0, 0] + T[1, 1] + T[2, 2] - 1))
    return axis * (0.5 if sine < 1e-9 else 0.5 * angle / sine)


@kernel(error_model="numpy")
def _product(A: Any, B: Any) -> Any:
    """A B of small square matrices, without a library's start-up."""
    n = A.shape[0]
    C = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            for k in range(n):
                C[i, j] += A[i, k] * B[k, j]
    return C


@kernel(error_model="numpy")
def _learn(total: Any, how: Any) -> None:
    """Learn from the residuals how large they are, and how the exposure has changed."""
    if total[PLANE_COUNT] > _FEWEST:
        scale = how[PLANE_SCALE] * total[PLANE_COUNT + 1] / total[PLANE_COUNT] / MEAN_ABS
        how[PLANE_SCALE] = min(max(scale, _PLANE_SCALES[0]), _PLANE_SCALES[1])
    if total[GREY_COUNT] <= _FEWEST or how[GREY_WEIGHT] <= 0:
        return
    ratio = total[GREY_COUNT + 1] / total[GREY_COUNT] / MEAN_ABS / how[GREY_WEIGHT]
    how[GREY_SIGMA] = min(max(how[GREY_SIGMA] * ratio, _GREY_SIGMAS[0]), _GREY_SIGMAS[1])
    moments = total[FIT_N], total[FIT_X], total[FIT_Y], total[FIT_XX], total[FIT_YY]
    how[GAIN], how[OFFSET] = fit_exposure(moments, how[GAIN])


@kernel(error_model="numpy")
def fit_exposure(moments: Any, gain: float) -> Any:
    """Gain and offset by which grey there becomes grey here: as bright, and as rich in contrast.

    Not by least squares: these find less gain the worse the images lie on each other, down to where none of the
    contrast is left that would bring them there. The gain stays as before if grey is all alike.

    `moments`: weighted sums of 1, there, here, there², here².
    """
    n, x, y, xx, yy = moments
    there, here = n * xx - x * x, n * yy - y * y
    if min(there, here) > 1e-3 * n * n:
        gain = min(max(np.sqrt(here / there), _GAINS[0]), _GAINS[1])
    return gain, (y - gain * x) / n
