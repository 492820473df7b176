"""Compiled inner loops of dense alignment: residuals, weights and normal equations, a row of partial sums each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

# Columns of the partial sums of a row: 21 of H's upper triangle, 6 of b, then these.
# Of each kind of residual: how many, the sum of |error| / σ, and of its weighted squares.
PLANE_COUNT, GREY_COUNT, PAIRS = 27, 30, 33
# Sums for the regression of exposure.
FIT_N, FIT_X, FIT_Y, FIT_XX, FIT_XY = 34, 35, 36, 37, 38
SUMS = 39


@njit(cache=True, nogil=True)
def accumulate(
    depth_m: Any,
    grey: Any,
    reference_depth_m: Any,
    reference_normal: Any,
    reference_grey: Any,
    along_u: Any,
    along_v: Any,
    grid: Any,
    T_rows: Any,
    noise: Any,
    how: Any,
    begin: int,
    end: int,
    sums: Any,
) -> None:
    """Normal equations of point-to-plane and photometric residuals over rows `begin` to `end` of a frame.

    A point p of the frame goes to p' = T p in the reference frame and to the pixel there on which it falls. Its
    residuals are n·(p' - q), where q and n are the reference's point and normal at that pixel, and
    gain·I_reference + offset - I, both divided by their standard deviations. The tangent is (v, ω), from the left:
    ∂p'/∂ξ = [I, -[p']×] (Steinbrücker et al. 2011; Newcombe et al. 2011; Whelan et al. 2015, eqs. 3 to 7).

    Args:
        depth_m, grey: (h, w) of the frame.
        reference_depth_m, reference_normal, reference_grey: (h, w), (h, w, 3), (h, w) of the reference.
        along_u, along_v: (h, w) gradients of the reference's grey a pixel.
        grid: fx, fy, cx, cy of both.
        T_rows: (h, 3, 4) T_reference_frame of each row, which differ where a rolling shutter's speed is refined.
        noise: depth's constant and quadratic σ, near and far limit in metres.
        how: gate in metres a metre of depth, scale of plane residuals, σ of grey, gain, offset, Huber's limit, weight
            of grey (0: depth alone).
        sums: (h, SUMS) of float64, written row by row, so that the total does not depend on who did which row.
    """
    width = depth_m.shape[1]
    # Weighted Jacobians and errors of a row, so that the products are taken over many residuals at once.
    planes = np.empty((7, width), np.float32)
    greys = np.empty((7, width), np.float32)
    for r in range(begin, end):
        row = sums[r]
        row[:] = 0.0
        y, T = np.float32((r - grid[3]) / grid[1]), T_rows[r]
        plane_count = grey_count = 0
        for c in range(width):
            z = depth_m[r, c]
            if not noise[2] <= z <= noise[3]:
                continue
            x = np.float32((c - grid[2]) / grid[0])
            p = _moved(T, x, y, z)
            if p[2] < noise[2]:
                continue
            u, v = grid[0] * p[0] / p[2] + grid[2], grid[1] * p[1] / p[2] + grid[3]
            if not (1 <= u < width - 2 and 1 <= v < depth_m.shape[0] - 2):
                continue
            row[PAIRS] += 1
            column, line = int(u + np.float32(0.5)), int(v + np.float32(0.5))
            qz = reference_depth_m[line, column]
            if qz <= 0 or abs(qz - p[2]) > how[0] * (1 + p[2]):
                continue
            n = reference_normal[line, column]
            if n[2] != 0:
                qx, qy = (column - grid[2]) / grid[0] * qz, (line - grid[3]) / grid[1] * qz
                error = n[0] * (p[0] - qx) + n[1] * (p[1] - qy) + n[2] * (p[2] - qz)
                sigma = how[1] * _plane_sigma(noise, z, qz, n, p)
                _put(planes, plane_count, p, n[0], n[1], n[2], error, sigma, how[5], row, PLANE_COUNT)
                plane_count += 1
            if how[6] > 0 and grey[r, c] >= 0:
                there, du, dv = _look(reference_grey, along_u, along_v, u, v)
                if there >= 0:
                    gx, gy = how[3] * du * grid[0] / p[2], how[3] * dv * grid[1] / p[2]
                    gz = -(gx * p[0] + gy * p[1]) / p[2]
                    error = how[3] * there + how[4] - grey[r, c]
                    weight = _put(greys, grey_count, p, gx, gy, gz, error, how[2] / how[6], how[5], row, GREY_COUNT)
                    grey_count += 1
                    _fit(row, weight, there, grey[r, c])
        _add(planes, plane_count, row)
        _add(greys, grey_count, row)


@njit(cache=True, nogil=True, inline="always")
def _moved(T: Any, x: Any, y: Any, z: Any) -> Any:
    """T p of the point p = (x, y, 1)·z."""
    return (
        np.float32(z * (T[0, 0] * x + T[0, 1] * y + T[0, 2]) + T[0, 3]),
        np.float32(z * (T[1, 0] * x + T[1, 1] * y + T[1, 2]) + T[1, 3]),
        np.float32(z * (T[2, 0] * x + T[2, 1] * y + T[2, 2]) + T[2, 3]),
    )


@njit(cache=True, nogil=True, inline="always")
def _plane_sigma(noise: Any, z: Any, qz: Any, n: Any, p: Any) -> Any:
    """Standard deviation of a plane residual, whose two depths err along the ray; bounded where planes are grazed."""
    here, there = noise[0] + noise[1] * z * z, noise[0] + noise[1] * qz * qz
    along = n[0] * p[0] + n[1] * p[1] + n[2] * p[2]
    cosine2 = max(along * along / (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]), np.float32(0.04))
    return np.sqrt((here * here + there * there) * cosine2)


@njit(cache=True, nogil=True, inline="always")
def _look(image: Any, along_u: Any, along_v: Any, u: Any, v: Any) -> Any:
    """Grey and its gradient between pixels; grey is -1 where a neighbour is unknown."""
    c, r = int(u), int(v)
    a, b, d, e = image[r, c], image[r, c + 1], image[r + 1, c], image[r + 1, c + 1]
    if a < 0 or b < 0 or d < 0 or e < 0:
        return np.float32(-1), np.float32(0), np.float32(0)
    s, t = np.float32(u - c), np.float32(v - r)
    one = np.float32(1)
    wa, wb, wd, we = (one - s) * (one - t), s * (one - t), (one - s) * t, s * t
    return (
        wa * a + wb * b + wd * d + we * e,
        wa * along_u[r, c] + wb * along_u[r, c + 1] + wd * along_u[r + 1, c] + we * along_u[r + 1, c + 1],
        wa * along_v[r, c] + wb * along_v[r, c + 1] + wd * along_v[r + 1, c] + we * along_v[r + 1, c + 1],
    )


@njit(cache=True, nogil=True, inline="always")
def _put(
    buffer: Any, k: int, p: Any, gx: Any, gy: Any, gz: Any, error: Any, sigma: Any, limit: Any, row: Any, place: int
) -> Any:
    """Write J and error, with Huber's weight, as column k; count and sum up in the row. The weight."""
    scaled = abs(error) / sigma
    weight = np.float32(1.0) if scaled <= limit else np.float32(limit / scaled)
    root = np.float32(np.sqrt(weight) / sigma)
    buffer[0, k], buffer[1, k], buffer[2, k] = root * gx, root * gy, root * gz
    buffer[3, k] = root * (p[1] * gz - p[2] * gy)
    buffer[4, k] = root * (p[2] * gx - p[0] * gz)
    buffer[5, k] = root * (p[0] * gy - p[1] * gx)
    buffer[6, k] = root * error
    row[place] += 1
    row[place + 1] += scaled
    row[place + 2] += weight * scaled * scaled
    return weight


@njit(cache=True, nogil=True, inline="always")
def _fit(row: Any, weight: Any, there: Any, here: Any) -> None:
    """What the regression of grey here on grey there needs."""
    row[FIT_N] += weight
    row[FIT_X] += weight * there
    row[FIT_Y] += weight * here
    row[FIT_XX] += weight * there * there
    row[FIT_XY] += weight * there * here


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _add(buffer: Any, count: int, row: Any) -> None:
    """Add the products of a buffer's first `count` columns to a row's sums."""
    k = 0
    for i in range(6):
        for j in range(i, 6):
            total = np.float32(0.0)
            for n in range(count):
                total += buffer[i, n] * buffer[j, n]
            row[k] += total
            k += 1
    for i in range(6):
        total = np.float32(0.0)
        for n in range(count):
            total += buffer[i, n] * buffer[6, n]
        row[21 + i] += total


@njit(cache=True, nogil=True)
def accumulate_turn(
    grey: Any, reference_grey: Any, along_u: Any, along_v: Any, grid: Any, R: Any, limit: float, sums: Any
) -> None:
    """Normal equations of a pure rotation R_reference_frame (3, 3) by grey values alone (Whelan et al. 2015, IV.B).

    Args:
        limit: Huber's limit in grey levels.
        sums: (11,) H's upper triangle (6), b (3), count, sum of absolute errors.
    """
    height, width = grey.shape
    sums[:] = 0.0
    for r in range(height):
        for c in range(width):
            here = grey[r, c]
            if here < 0:
                continue
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
            there = reference_grey[line, column]
            if there < 0:
                continue
            error = there - here
            weight = 1.0 if abs(error) <= limit else limit / abs(error)
            gx, gy = along_u[line, column] * grid[0] / pz, along_v[line, column] * grid[1] / pz
            gz = -(gx * px + gy * py) / pz
            a, b, d = py * gz - pz * gy, pz * gx - px * gz, px * gy - py * gx
            sums[0] += weight * a * a
            sums[1] += weight * a * b
            sums[2] += weight * a * d
            sums[3] += weight * b * b
            sums[4] += weight * b * d
            sums[5] += weight * d * d
            sums[6] += weight * a * error
            sums[7] += weight * b * error
            sums[8] += weight * d * error
            sums[9] += 1
            sums[10] += abs(error)
