"""Compiled inner loops of dense alignment: residuals, weights and normal equations, a row of partial sums each.

A row is gone over in loops without branches, which the compiler does for many pixels at once; only the look-up in the
reference goes pixel by pixel. What is inlined here takes its liberties with rounding from its caller.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel

if TYPE_CHECKING:
    from wheelsight.geometry.arrays import Float32Array, FloatArray

# Columns of the partial sums of a row: of planes 21 of H's upper triangle and 6 of b, the same of grey, then these.
GREY_SUMS = 27
# Of each kind of residual: how many, the sum of |error| / σ, and of its weighted squares.
PLANE_COUNT, GREY_COUNT, PAIRS = 54, 57, 60
# Sums for the regression of exposure.
FIT_N, FIT_X, FIT_Y, FIT_XX, FIT_YY = 61, 62, 63, 64, 65
SUMS = 66

# Channels of a reference's pixel: the plane n·q = d and its depth, NaN where unknown; grey and its gradient a pixel.
NX, NY, NZ, OFFSET, DEPTH, GREY, ALONG_U, ALONG_V = range(8)
CHANNELS = 8

# What `how` holds, (10,) float32: gate in metres a metre of depth, scale of plane residuals, σ of grey, gain, offset,
# Huber's limit, weight of grey (0: depth alone), σ of the colour camera's place in pixels, the slope of grey a pixel
# below which it may be noise and tells nothing, and how much of a residual is taken for the frame's own noise.

# So many pixels side by side are done at once, by buffers whose size the compiler knows.
_STRETCH = 320
# Rows of the buffer of a stretch's moved points, and of the buffer of those of them that have a partner: point, depth
# and grey here, and the partner's channels.
_MX, _MY, _MZ, _MU, _MV, _MOVED = range(6)
_PX, _PY, _PZ, _HERE_Z, _HERE, _PARTNER, _PAIR = *range(6), 5 + CHANNELS
# Rows of the buffer in which residuals of one kind are collected.
_GX, _GY, _GZ, _J3, _J4, _J5, _ERROR, _ROOT, _LEVER, _RESIDUAL = range(10)


class Images(NamedTuple):
    """A level of a frame, and of the reference that it is aligned with.

    Attributes:
        depth_m, grey: (h, w) float32 of the frame; depth 0 and grey -1 where unknown.
        reference: (h, w, CHANNELS) float32.
        grid: (4,) fx, fy, cx, cy of both; float32, but for turns.
    """

    depth_m: Float32Array
    grey: Float32Array
    reference: Float32Array
    grid: Float32Array | FloatArray


@kernel(error_model="numpy", fastmath={"reassoc", "contract"})
def accumulate(images: Images, T_rows: Any, noise: Any, how: Any, stride: int, begin: int, end: int, sums: Any) -> None:
    """Normal equations of point-to-plane and photometric residuals over every `stride`th row of a frame.

    A point p of the frame goes to p' = T p in the reference frame and to the pixel there on which it falls. Its
    residuals are n·p' - d of the reference's plane at that pixel, and gain·I_reference + offset - I, both divided by
    their standard deviations. The tangent is (v, ω), from the left: ∂p'/∂ξ = [I, -[p']×] (Steinbrücker et al. 2011;
    Newcombe et al. 2011; Whelan et al. 2015, eqs. 3 to 7).

    Args:
        images: frame and reference.
        T_rows: (h, 3, 4) T_reference_frame of each row, which differ where a rolling shutter's speed is refined.
        noise: depth's constant and quadratic σ, near and far limit in metres.
        how: see above.
        begin, end: of the rows' numbers; number k is row k · stride.
        sums: (h // stride, SUMS) of float64, written row by row, so that the total does not depend on who did which.
    """
    depth_m, grey, reference, grid = images.depth_m, images.grey, images.reference, images.grid
    width = depth_m.shape[1]
    moved, pairs = np.empty((_MOVED, _STRETCH), np.float32), np.empty((_PAIR, _STRETCH), np.float32)
    residuals = np.empty((_RESIDUAL, _STRETCH), np.float32)
    x = ((np.arange(width) - grid[2]) / grid[0]).astype(np.float32)
    for k in range(begin, end):
        r = k * stride
        y, row = np.float32((r - grid[3]) / grid[1]), sums[k]
        row[:] = 0.0
        for first in range(0, width, _STRETCH):
            last = min(first + _STRETCH, width)
            here = depth_m[r, first:last]
            _move(here, x[first:last], y, T_rows[r], grid, moved)
            n = _pair(here, grey[r, first:last], reference, noise, moved, pairs)
            row[PAIRS] += n
            _meet_planes(pairs, n, noise, how, residuals)
            _weigh(pairs, residuals, n, how[5], row, PLANE_COUNT)
            _add(residuals, n, row[:GREY_SUMS])
            if how[6] > 0:
                _compare_grey(pairs, n, grid, how, residuals, row)
                _weigh(pairs, residuals, n, how[5], row, GREY_COUNT)
                _add(residuals, n, row[GREY_SUMS:])


@kernel(error_model="numpy", inline="always")
def _move(depth_m: Any, x: Any, y: Any, T: Any, grid: Any, moved: Any) -> None:
    """Points T p of a stretch of p = (x, y, 1)·z, and the pixels they fall on."""
    fx, fy, cx, cy = grid[0], grid[1], grid[2], grid[3]
    ax, bx, tx = T[0, 0], T[0, 1] * y + T[0, 2], T[0, 3]
    ay, by, ty = T[1, 0], T[1, 1] * y + T[1, 2], T[1, 3]
    az, bz, tz = T[2, 0], T[2, 1] * y + T[2, 2], T[2, 3]
    for c in range(len(x)):
        z = depth_m[c]
        px, py, pz = z * (ax * x[c] + bx) + tx, z * (ay * x[c] + by) + ty, z * (az * x[c] + bz) + tz
        moved[_MX, c], moved[_MY, c], moved[_MZ, c] = px, py, pz
        moved[_MU, c], moved[_MV, c] = fx * px / pz + cx, fy * py / pz + cy


@kernel(error_model="numpy", inline="always")
def _pair(depth_m: Any, grey: Any, reference: Any, noise: Any, moved: Any, pairs: Any) -> Any:
    """Collect the points that fall into the reference, each with the plane of the pixel it falls on and the grey there.

    Returns how many. No branches: which points do is known too late for the processor to guess.
    """
    one, half, near, far = np.float32(1), np.float32(0.5), noise[2], noise[3]
    last_u, last_v = np.float32(reference.shape[1] - 2), np.float32(reference.shape[0] - 2)
    n = 0
    for c in range(len(depth_m)):
        z, pz, u, v = depth_m[c], moved[_MZ, c], moved[_MU, c], moved[_MV, c]
        is_seen = (z >= near) & (z <= far) & (pz >= near) & (u >= one) & (u < last_u) & (v >= one) & (v < last_v)
        line, column = int(v + half) if is_seen else 0, int(u + half) if is_seen else 0
        pairs[_PX, n], pairs[_PY, n], pairs[_PZ, n] = moved[_MX, c], moved[_MY, c], pz
        pairs[_HERE_Z, n], pairs[_HERE, n] = z, grey[c]
        for k in range(GREY):
            pairs[_PARTNER + k, n] = reference[line, column, k]
        line, column = int(v) if is_seen else 0, int(u) if is_seen else 0
        s, t = u - np.float32(column), v - np.float32(line)
        for k in range(GREY, CHANNELS):
            above, below = reference[line, column, k], reference[line + 1, column, k]
            above += s * (reference[line, column + 1, k] - above)
            below += s * (reference[line + 1, column + 1, k] - below)
            pairs[_PARTNER + k, n] = above + t * (below - above)
        n += is_seen
    return n


@kernel(error_model="numpy", inline="always")
def _meet_planes(pairs: Any, n: int, noise: Any, how: Any, out: Any) -> None:
    """Gradients g = ∂error/∂p', errors and 1 / σ of n pairs as to the partners' planes; 0 where there is none.

    Both depths err along the ray; what counts of it is bounded where planes are grazed. How long a lever is, and how
    much a pair weighs, goes by where the point is once its own share of the error is taken off. By its noisy depth, all
    that are too far by chance would turn a frame more, and weigh less, than those that are too near.
    """
    zero, one, least = np.float32(0), np.float32(1), np.float32(0.04)
    constant, quadratic, gate, scale, own = noise[0], noise[1], how[0], how[1], how[9]
    for k in range(n):
        px, py, pz, z = pairs[_PX, k], pairs[_PY, k], pairs[_PZ, k], pairs[_HERE_Z, k]
        nx, ny, nz = pairs[_PARTNER + NX, k], pairs[_PARTNER + NY, k], pairs[_PARTNER + NZ, k]
        qz, along = pairs[_PARTNER + DEPTH, k], nx * px + ny * py + nz * pz
        error = along - pairs[_PARTNER + OFFSET, k]
        cosine2 = along * along / (px * px + py * py + pz * pz)
        cosine2 = cosine2 if cosine2 > least else least
        is_near = (abs(qz - pz) <= gate * (one + pz)) & (error == error)
        share = own * error / along
        lever = one - share if is_near & (abs(share) < gate) else one
        z, pz = lever * z, lever * pz
        here, there = constant + quadratic * z * z, constant + quadratic * pz * pz
        out[_GX, k], out[_GY, k], out[_GZ, k] = (
            nx if is_near else zero,
            ny if is_near else zero,
            nz if is_near else zero,
        )
        out[_ERROR, k], out[_LEVER, k] = error if is_near else zero, lever
        out[_ROOT, k] = one / (scale * np.sqrt((here * here + there * there) * cosine2)) if is_near else zero


@kernel(error_model="numpy", inline="always")
def _compare_grey(pairs: Any, n: int, grid: Any, how: Any, out: Any, row: Any) -> None:
    """Likewise of the grey values of n pairs; and sum up in the row what the regression of exposure needs."""
    zero, one = np.float32(0), np.float32(1)
    fx, fy, gate, sigma2, gain, offset = grid[0], grid[1], how[0], how[2] * how[2], how[3], how[4]
    limit, weight_of, misplaced2, least2 = how[5], how[6], how[7] * how[7], how[8] * how[8]
    s = sx = sy = sxx = syy = zero
    for k in range(n):
        px, py, pz, qz, here = pairs[_PX, k], pairs[_PY, k], pairs[_PZ, k], pairs[_PARTNER + DEPTH, k], pairs[_HERE, k]
        du, dv = pairs[_PARTNER + ALONG_U, k], pairs[_PARTNER + ALONG_V, k]
        there = pairs[_PARTNER + GREY, k]
        slope2 = du * du + dv * dv
        is_known = (abs(qz - pz) <= gate * (one + pz)) & (here >= zero) & (slope2 >= least2) & (there == there)
        there = there if is_known else zero
        gx, gy = gain * du * fx / pz if is_known else zero, gain * dv * fy / pz if is_known else zero
        error = gain * there + offset - here if is_known else zero
        root = weight_of / np.sqrt(sigma2 + misplaced2 * slope2) if is_known else zero
        out[_GX, k], out[_GY, k], out[_GZ, k] = gx, gy, -(gx * px + gy * py) / pz
        out[_ERROR, k], out[_ROOT, k], out[_LEVER, k] = error, root, one
        scaled = abs(error) * root
        weight = limit / (scaled if scaled > limit else limit) if is_known else zero
        s += weight
        sx += weight * there
        sy += weight * here
        sxx += weight * there * there
        syy += weight * here * here
    row[FIT_N] += s
    row[FIT_X] += sx
    row[FIT_Y] += sy
    row[FIT_XX] += sxx
    row[FIT_YY] += syy


@kernel(error_model="numpy", inline="always")
def _weigh(pairs: Any, residuals: Any, n: int, limit: Any, row: Any, place: int) -> None:
    """Turn n residuals into weighted Jacobians (g, p × g) and errors by Huber's weights; sum up in the row."""
    zero, one = np.float32(0), np.float32(1)
    count = total = squares = zero
    for k in range(n):
        lever, root = residuals[_LEVER, k], residuals[_ROOT, k]
        px, py, pz = lever * pairs[_PX, k], lever * pairs[_PY, k], lever * pairs[_PZ, k]
        scaled = abs(residuals[_ERROR, k]) * root
        weight = limit / (scaled if scaled > limit else limit)
        count += one if root > zero else zero
        total += scaled
        squares += weight * scaled * scaled
        root *= np.sqrt(weight)
        gx, gy, gz = root * residuals[_GX, k], root * residuals[_GY, k], root * residuals[_GZ, k]
        residuals[_GX, k], residuals[_GY, k], residuals[_GZ, k] = gx, gy, gz
        residuals[_J3, k], residuals[_J4, k] = py * gz - pz * gy, pz * gx - px * gz
        residuals[_J5, k], residuals[_ERROR, k] = px * gy - py * gx, root * residuals[_ERROR, k]
    row[place] += count
    row[place + 1] += total
    row[place + 2] += squares


@kernel(error_model="numpy", inline="always")
def _add(residuals: Any, n: int, row: Any) -> None:
    """Add the products of n Jacobians and errors to a row's sums: J is rows _GX to _J5."""
    at = 0
    for i in range(6):
        for j in range(i, 7):
            total = np.float32(0)
            for k in range(n):
                total += residuals[i, k] * residuals[j, k]
            if j < 6:
                row[at] += total
                at += 1
            else:
                row[21 + i] += total
