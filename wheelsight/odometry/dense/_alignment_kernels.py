"""Compiled inner loops of dense alignment: residuals, weights and normal equations, a row of partial sums each.

A row is gone over in short loops, each of which the compiler can do for many pixels at once; only the look-up in the
reference goes pixel by pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

# Columns of the partial sums of a row: of planes 21 of H's upper triangle and 6 of b, the same of grey, then these.
GREY_SUMS = 27
# Of each kind of residual: how many, the sum of |error| / σ, and of its weighted squares.
PLANE_COUNT, GREY_COUNT, PAIRS = 54, 57, 60
# Sums for the regression of exposure.
FIT_N, FIT_X, FIT_Y, FIT_XX, FIT_XY = 61, 62, 63, 64, 65
SUMS = 66

# Channels of a reference's pixel: the plane n·q = d and its depth, NaN where unknown; grey and its gradient a pixel.
NX, NY, NZ, OFFSET, DEPTH, GREY, ALONG_U, ALONG_V = range(8)
CHANNELS = 8

# Rows of the buffer in which residuals of one kind are collected.
_PX, _PY, _PZ, _GX, _GY, _GZ, _ERROR, _ROOT, _J3, _J4, _J5 = range(11)
# Rows of the buffer for a row's moved points.
_MX, _MY, _MZ, _MU, _MV = range(5)


@njit(cache=True, nogil=True, error_model="numpy")
def accumulate(
    depth_m: Any,
    grey: Any,
    reference: Any,
    grid: Any,
    T_rows: Any,
    noise: Any,
    how: Any,
    stride: int,
    begin: int,
    end: int,
    sums: Any,
) -> None:
    """Normal equations of point-to-plane and photometric residuals over every `stride`th row of a frame.

    A point p of the frame goes to p' = T p in the reference frame and to the pixel there on which it falls. Its
    residuals are n·p' - d of the reference's plane at that pixel, and gain·I_reference + offset - I, both divided by
    their standard deviations. The tangent is (v, ω), from the left: ∂p'/∂ξ = [I, -[p']×] (Steinbrücker et al. 2011;
    Newcombe et al. 2011; Whelan et al. 2015, eqs. 3 to 7).

    Args:
        depth_m, grey: (h, w) of the frame; depth 0 and grey -1 where unknown.
        reference: (h, w, CHANNELS).
        grid: fx, fy, cx, cy of both.
        T_rows: (h, 3, 4) T_reference_frame of each row, which differ where a rolling shutter's speed is refined.
        noise: depth's constant and quadratic σ, near and far limit in metres.
        how: gate in metres a metre of depth, scale of plane residuals, σ of grey, gain, offset, Huber's limit, weight
            of grey (0: depth alone), σ of the colour camera's place in pixels, and the slope of grey a pixel below
            which it may be the image's noise and tells nothing.
        begin, end: of the rows' numbers; number k is row k · stride.
        sums: (h // stride, SUMS) of float64, written row by row, so that the total does not depend on who did which.
    """
    width = depth_m.shape[1]
    moved = np.empty((5, width), np.float32)
    planes, greys = np.empty((11, width), np.float32), np.empty((11, width), np.float32)
    x = ((np.arange(width) - grid[2]) / grid[0]).astype(np.float32)
    for k in range(begin, end):
        r, row = k * stride, sums[k]
        row[:] = 0.0
        _move(depth_m[r], x, np.float32((r - grid[3]) / grid[1]), T_rows[r], grid, moved)
        plane_count, grey_count = _look_up(depth_m[r], grey[r], reference, grid, noise, how, moved, planes, greys, row)
        _weigh(planes, plane_count, how[5], row, PLANE_COUNT)
        _weigh(greys, grey_count, how[5], row, GREY_COUNT)
        _add(planes, plane_count, row[:GREY_SUMS])
        _add(greys, grey_count, row[GREY_SUMS:])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _move(depth_m: Any, x: Any, y: Any, T: Any, grid: Any, moved: Any) -> None:
    """Points T p of a row of p = (x, y, 1)·z, and the pixels they fall on."""
    for axis in range(3):
        a, b, t = T[axis, 0], T[axis, 1] * y + T[axis, 2], T[axis, 3]
        out = moved[axis]
        for c in range(len(x)):
            out[c] = depth_m[c] * (a * x[c] + b) + t
    depth_there, across, down = moved[_MZ], moved[_MX], moved[_MY]
    u, v = moved[_MU], moved[_MV]
    fx, fy, cx, cy = grid[0], grid[1], grid[2], grid[3]
    for c in range(len(x)):
        u[c] = fx * across[c] / depth_there[c] + cx
    for c in range(len(x)):
        v[c] = fy * down[c] / depth_there[c] + cy


@njit(cache=True, nogil=True, error_model="numpy")
def _look_up(
    depth_m: Any,
    grey: Any,
    reference: Any,
    grid: Any,
    noise: Any,
    how: Any,
    moved: Any,
    planes: Any,
    greys: Any,
    row: Any,
) -> Any:
    """Collect the residuals of a row: points, gradients g = ∂error/∂p', errors, and 1 / σ. How many of each kind."""
    height, width = reference.shape[0], reference.shape[1]
    one, half = np.float32(1), np.float32(0.5)
    near, far, gate = noise[2], noise[3], how[0]
    last_u, last_v = np.float32(width - 2), np.float32(height - 2)
    pairs = plane_count = grey_count = 0
    for c in range(len(depth_m)):
        z, pz, u, v = depth_m[c], moved[_MZ, c], moved[_MU, c], moved[_MV, c]
        if not (near <= z <= far and pz >= near and one <= u < last_u and one <= v < last_v):
            continue
        pairs += 1
        line, column = int(v + half), int(u + half)
        qz = reference[line, column, DEPTH]
        if not abs(qz - pz) <= gate * (one + pz):
            continue
        px, py = moved[_MX, c], moved[_MY, c]
        nx, ny, nz = reference[line, column, NX], reference[line, column, NY], reference[line, column, NZ]
        along = nx * px + ny * py + nz * pz
        error = along - reference[line, column, OFFSET]
        if not np.isnan(error):
            root = _plane_root(noise, how[1], z, qz, along * along / (px * px + py * py + pz * pz))
            _put(planes, plane_count, px, py, pz, nx, ny, nz, error, root)
            plane_count += 1
        if how[6] > 0 and grey[c] >= 0:
            grey_count += _put_grey(greys, grey_count, px, py, pz, u, v, grey[c], reference, grid, how)
    row[PAIRS] = pairs
    _fit(greys, grey_count, how[5], row)
    return plane_count, grey_count


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _put_grey(
    to: Any, k: int, px: Any, py: Any, pz: Any, u: Any, v: Any, here: Any, reference: Any, grid: Any, how: Any
) -> int:
    """Collect the photometric residual of a pixel as number k; 0 where there is none, else 1."""
    there, du, dv = _between(reference, u, v)
    slope2 = du * du + dv * dv
    if not slope2 >= how[8] * how[8] or np.isnan(there):
        return 0
    gx, gy = how[3] * du * grid[0] / pz, how[3] * dv * grid[1] / pz
    root = how[6] / np.sqrt(how[2] * how[2] + how[7] * how[7] * slope2)
    _put(to, k, px, py, pz, gx, gy, -(gx * px + gy * py) / pz, how[3] * there + how[4] - here, root)
    to[_J3, k], to[_J4, k] = there, here
    return 1


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _plane_root(noise: Any, scale: Any, z: Any, qz: Any, cosine2: Any) -> Any:
    """1 / σ of a plane residual, whose two depths err along the ray; bounded where planes are grazed."""
    here, there = noise[0] + noise[1] * z * z, noise[0] + noise[1] * qz * qz
    return np.float32(1) / (scale * np.sqrt((here * here + there * there) * max(cosine2, np.float32(0.04))))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _between(reference: Any, u: Any, v: Any) -> Any:
    """Grey and its gradient between four pixels; NaN where one is unknown."""
    c, r = int(u), int(v)
    s, t, one = u - np.float32(c), v - np.float32(r), np.float32(1)
    wa, wb, wd, we = (one - s) * (one - t), s * (one - t), (one - s) * t, s * t
    return (
        wa * reference[r, c, GREY]
        + wb * reference[r, c + 1, GREY]
        + wd * reference[r + 1, c, GREY]
        + we * reference[r + 1, c + 1, GREY],
        wa * reference[r, c, ALONG_U]
        + wb * reference[r, c + 1, ALONG_U]
        + wd * reference[r + 1, c, ALONG_U]
        + we * reference[r + 1, c + 1, ALONG_U],
        wa * reference[r, c, ALONG_V]
        + wb * reference[r, c + 1, ALONG_V]
        + wd * reference[r + 1, c, ALONG_V]
        + we * reference[r + 1, c + 1, ALONG_V],
    )


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _put(to: Any, k: int, px: Any, py: Any, pz: Any, gx: Any, gy: Any, gz: Any, error: Any, root: Any) -> None:
    to[_PX, k], to[_PY, k], to[_PZ, k] = px, py, pz
    to[_GX, k], to[_GY, k], to[_GZ, k] = gx, gy, gz
    to[_ERROR, k], to[_ROOT, k] = error, root


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _fit(greys: Any, count: int, limit: Any, row: Any) -> None:
    """What the regression of grey here on grey there needs, of the two greys left in the buffer."""
    n = x = y = xx = xy = np.float32(0)
    for k in range(count):
        weight = limit / max(abs(greys[_ERROR, k]) * greys[_ROOT, k], limit)
        there, here = greys[_J3, k], greys[_J4, k]
        n += weight
        x += weight * there
        y += weight * here
        xx += weight * there * there
        xy += weight * there * here
    row[FIT_N], row[FIT_X], row[FIT_Y], row[FIT_XX], row[FIT_XY] = n, x, y, xx, xy


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _weigh(buffer: Any, count: int, limit: Any, row: Any, place: int) -> None:
    """Turn collected residuals into weighted Jacobians (g, p × g) and errors by Huber's weights; sum up in the row."""
    px, py, pz, gx, gy, gz = buffer[_PX], buffer[_PY], buffer[_PZ], buffer[_GX], buffer[_GY], buffer[_GZ]
    error, root = buffer[_ERROR], buffer[_ROOT]
    total = squares = np.float32(0)
    for k in range(count):
        scaled = abs(error[k]) * root[k]
        weight = limit / max(scaled, limit)
        total += scaled
        squares += weight * scaled * scaled
        root[k] *= np.sqrt(weight)
    for k in range(count):
        gx[k] *= root[k]
    for k in range(count):
        gy[k] *= root[k]
    for k in range(count):
        gz[k] *= root[k]
    for k in range(count):
        error[k] *= root[k]
    a, b, d = buffer[_J3], buffer[_J4], buffer[_J5]
    for k in range(count):
        a[k] = py[k] * gz[k] - pz[k] * gy[k]
    for k in range(count):
        b[k] = pz[k] * gx[k] - px[k] * gz[k]
    for k in range(count):
        d[k] = px[k] * gy[k] - py[k] * gx[k]
    row[place], row[place + 1], row[place + 2] = count, total, squares


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _add(buffer: Any, count: int, row: Any) -> None:
    """Add the products of a buffer's Jacobians and errors to a row's sums."""
    k = 0
    for i in range(6):
        of_i = buffer[_GX + i if i < 3 else _J3 + i - 3]
        for j in range(i, 6):
            of_j = buffer[_GX + j if j < 3 else _J3 + j - 3]
            total = np.float32(0)
            for n in range(count):
                total += of_i[n] * of_j[n]
            row[k] += total
            k += 1
        total = np.float32(0)
        for n in range(count):
            total += of_i[n] * buffer[_ERROR, n]
        row[21 + i] += total
