"""Compiled inner loops of what frame and reference both show of a motion: products of the one's and the other's.

A pixel tells a motion by its plane's normal and by its slope of grey. Both come with noise, which shows motions that
nothing shows; but the noise of two images is independent, so that in products of one's Jacobians with the other's it
averages out, as does what only one of both shows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.odometry.dense._alignment_kernels import ALONG_U, ALONG_V, DEPTH, GREY, NX, NY, NZ, OFFSET

if TYPE_CHECKING:
    from wheelsight.geometry.arrays import Float32Array, FloatArray

# Columns of the sums of a row: upper triangle of the information, and how many points fell into the reference.
POINTS = 21
SHOWN = 22
# Beyond them, of slopes alone: the upper triangle of what the reference's show by themselves.
COMPARED = SHOWN + 21
# What each entry of `how` is: gate in metres a metre of depth, scale of plane residuals, σ of grey, gain, Huber's
# limit, weight of grey, σ of the colour camera's place in pixels.
_GATE, _SCALE, _SIGMA, _GAIN, _HUBER, _WEIGHT, _MISPLACED = range(7)
_LEAST_COSINE2 = 0.04


class BothViews(NamedTuple):
    """What a frame and its reference show, at one level.

    Attributes:
        depth_m: (h, w) float32 of the frame, 0 where unknown.
        own, reference: (h, w, CHANNELS) float32 of the frame and of the reference.
        grid: (4,) fx, fy, cx, cy of both.
    """

    depth_m: Float32Array
    own: Float32Array
    reference: Float32Array
    grid: FloatArray


@kernel(error_model="numpy")
def show_planes(both: BothViews, T: Any, noise: Any, how: Any, begin: int, end: int, sums: Any) -> None:
    """What planes of rows `begin` to `end` tell in both views, of the tangent (v, ω) from the left of T.

    Args:
        both: frame and reference.
        T: (4, 4) T_reference_frame.
        noise: depth's constant and quadratic σ, near and far limit in metres.
        how: see above.
        sums: (h, SHOWN or more) float64, written row by row.
    """
    depth_m, own, reference, grid = both.depth_m, both.own, both.reference, both.grid
    here, there = np.empty(6), np.empty(6)
    for r in range(begin, end):
        sums[r] = 0.0
        for c in range(depth_m.shape[1]):
            is_seen, px, py, pz, z, u, v = _moved(depth_m, r, c, reference, grid, T, noise)
            if not is_seen:
                continue
            sums[r, POINTS] += 1
            line, column = int(v + 0.5), int(u + 0.5)
            qz, error = reference[line, column, DEPTH], -reference[line, column, OFFSET]
            nx, ny, nz = reference[line, column, NX], reference[line, column, NY], reference[line, column, NZ]
            error += nx * px + ny * py + nz * pz
            ox, oy, oz = own[r, c, NX], own[r, c, NY], own[r, c, NZ]
            is_known = error + own[r, c, OFFSET] == error + own[r, c, OFFSET]  # not NaN
            if not (is_known and abs(qz - pz) <= how[_GATE] * (1 + pz)):
                continue
            cosine2 = max((nx * px + ny * py + nz * pz) ** 2 / (px * px + py * py + pz * pz), _LEAST_COSINE2)
            sigma2 = (noise[0] + noise[1] * z * z) ** 2 + (noise[0] + noise[1] * qz * qz) ** 2
            root = 1 / (how[_SCALE] * np.sqrt(sigma2 * cosine2))
            weight = root * root * how[_HUBER] / max(abs(error) * root, how[_HUBER])
            _jacobian(px, py, pz, nx, ny, nz, there)
            _turn(T, ox, oy, oz, px, py, pz, here)
            _add(here, there, weight, sums[r])


@kernel(error_model="numpy")
def show_slopes(both: BothViews, T: Any, noise: Any, how: Any, begin: int, end: int, sums: Any) -> None:
    """What slopes of grey tell in both views; arguments as of `show_planes`, but for `sums` (h, COMPARED)."""
    depth_m, own, reference, grid = both.depth_m, both.own, both.reference, both.grid
    here, there = np.empty(6), np.empty(6)
    fx, fy, gain = grid[0], grid[1], how[_GAIN]
    for r in range(begin, end):
        sums[r] = 0.0
        y = (r - grid[3]) / fy
        for c in range(depth_m.shape[1]):
            is_seen, px, py, pz, z, u, v = _moved(depth_m, r, c, reference, grid, T, noise)
            if not is_seen:
                continue
            sums[r, POINTS] += 1
            qz = _between(reference, u, v, DEPTH)
            du, dv = _between(reference, u, v, ALONG_U), _between(reference, u, v, ALONG_V)
            eu, ev = own[r, c, ALONG_U], own[r, c, ALONG_V]
            total = du + dv + eu + ev + _between(reference, u, v, GREY)
            if not (abs(qz - pz) <= how[_GATE] * (1 + pz) and total == total):
                continue
            x, slope2 = (c - grid[2]) / fx, du * du + dv * dv
            weight = how[_WEIGHT] ** 2 / (how[_SIGMA] ** 2 + how[_MISPLACED] ** 2 * slope2)
            gx, gy = gain * du * fx / pz, gain * dv * fy / pz
            _jacobian(px, py, pz, gx, gy, -(gx * px + gy * py) / pz, there)
            hx, hy = eu * fx / z, ev * fy / z
            _turn(T, hx, hy, -(hx * x + hy * y), px, py, pz, here)
            _add(here, there, weight, sums[r])
            _add(there, there, weight, sums[r, SHOWN:])


@kernel(error_model="numpy", inline="always")
def _moved(depth_m: Any, r: Any, c: Any, reference: Any, grid: Any, T: Any, noise: Any) -> Any:
    """Whether a pixel's point falls into the reference, the point there, its depth here, and the pixel there."""
    z, fx, fy = float(depth_m[r, c]), grid[0], grid[1]
    x, y = z * (c - grid[2]) / fx, z * (r - grid[3]) / fy
    px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    is_seen = noise[2] <= z <= noise[3] and pz >= noise[2]
    u, v = (fx * px / pz + grid[2], fy * py / pz + grid[3]) if is_seen else (0.0, 0.0)
    is_inside = 1 <= u < reference.shape[1] - 2 and 1 <= v < reference.shape[0] - 2
    return is_seen and is_inside, px, py, pz, z, u, v


@kernel(error_model="numpy", inline="always")
def _between(reference: Any, u: Any, v: Any, channel: int) -> Any:
    """A channel between four pixels."""
    line, column = int(v), int(u)
    s, t = u - column, v - line
    above = (1 - s) * reference[line, column, channel] + s * reference[line, column + 1, channel]
    below = (1 - s) * reference[line + 1, column, channel] + s * reference[line + 1, column + 1, channel]
    return (1 - t) * above + t * below


@kernel(error_model="numpy", inline="always")
def _turn(T: Any, gx: Any, gy: Any, gz: Any, px: Any, py: Any, pz: Any, out: Any) -> None:
    """The Jacobian of a gradient in the frame at the point p in the reference."""
    ax = T[0, 0] * gx + T[0, 1] * gy + T[0, 2] * gz
    ay = T[1, 0] * gx + T[1, 1] * gy + T[1, 2] * gz
    az = T[2, 0] * gx + T[2, 1] * gy + T[2, 2] * gz
    _jacobian(px, py, pz, ax, ay, az, out)


@kernel(error_model="numpy", inline="always")
def _jacobian(px: Any, py: Any, pz: Any, gx: Any, gy: Any, gz: Any, out: Any) -> None:
    """(g, p × g): of g·p by the tangent from the left."""
    out[0], out[1], out[2] = gx, gy, gz
    out[3], out[4], out[5] = py * gz - pz * gy, pz * gx - px * gz, px * gy - py * gx


@kernel(error_model="numpy", inline="always")
def _add(here: Any, there: Any, weight: Any, row: Any) -> None:
    """Add the symmetric part of a product of Jacobians to the upper triangle."""
    at, half = 0, 0.5 * weight
    for i in range(6):
        for j in range(i, 6):
            row[at] += half * (here[i] * there[j] + here[j] * there[i])
            at += 1
