"""Compiled inner loops that make references: normals, gradients, and all that a look-up needs side by side."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from wheelsight.odometry.dense._alignment_kernels import ALONG_U, ALONG_V, DEPTH, GREY, NX, NY, NZ, OFFSET

# Of the kernels imported, so that numba's cache of this file's ends with theirs; a test tells when to renew it.
_COMPILED_IN = 0x567BB853

_NAN = np.float32(np.nan)
_FEWEST = 6
# Squared cosine to the ray below which neighbours are too far apart in depth for a normal.
_GRAZED = np.float32(0.04)


@njit(cache=True, nogil=True, error_model="numpy")
def pack(depth_m: Any, normal: Any, grey: Any, grid: Any, begin: int, end: int, out: Any) -> None:
    """Rows `begin` to `end` of a reference's pixels (h, w, CHANNELS), NaN where something is unknown.

    Args:
        depth_m, normal, grey: (h, w), 0 where unknown; (h, w, 3), 0 where unknown; (h, w), -1 where unknown.
        grid: fx, fy, cx, cy.
    """
    height, width = depth_m.shape
    half = np.float32(0.5)
    for r in range(begin, end):
        y = np.float32((r - grid[3]) / grid[1])
        for c in range(width):
            z, x = depth_m[r, c], np.float32((c - grid[2]) / grid[0])
            nx, ny, nz = normal[r, c, 0], normal[r, c, 1], normal[r, c, 2]
            out[r, c, NX], out[r, c, NY], out[r, c, NZ] = nx, ny, nz
            out[r, c, OFFSET] = z * (nx * x + ny * y + nz) if nz != 0 else _NAN
            out[r, c, DEPTH] = z if z > 0 else _NAN
            out[r, c, GREY] = out[r, c, ALONG_U] = out[r, c, ALONG_V] = _NAN
            if grey[r, c] >= 0:
                out[r, c, GREY] = grey[r, c]
            if 0 < c < width - 1 and grey[r, c - 1] >= 0 and grey[r, c + 1] >= 0:
                out[r, c, ALONG_U] = half * (grey[r, c + 1] - grey[r, c - 1])
            if 0 < r < height - 1 and grey[r - 1, c] >= 0 and grey[r + 1, c] >= 0:
                out[r, c, ALONG_V] = half * (grey[r + 1, c] - grey[r - 1, c])


@njit(cache=True, nogil=True, error_model="numpy")
def normals(depth_m: Any, grid: Any, radius: int, jump: Any, bend: Any, begin: int, end: int, out: Any) -> None:
    """Unit normals (h, w, 3) towards the camera by least squares of inverse depth over a window; 0 where none.

    On a plane inverse depth is linear in the pixel, 1/z = a·u + b·v + c, so the normal follows from its slopes
    (Badino et al., ICRA 2011, fit the same model). The window is (2·radius + 1)², on one surface only.

    Args:
        jump: share of a depth by which neighbours on one surface may differ.
        bend: (2,) what a surface may be off its plane, RMS: metres, and metres a square metre of depth.
    """
    height, width = depth_m.shape
    one = np.float32(1)
    for r in range(begin, end):
        y = np.float32((r - grid[3]) / grid[1])
        for c in range(width):
            out[r, c, 0] = out[r, c, 1] = out[r, c, 2] = np.float32(0)
            z = depth_m[r, c]
            if z <= 0 or r < radius or c < radius or r >= height - radius or c >= width - radius:
                continue
            a, b, rest = _slopes(depth_m, r, c, radius, jump * z)
            sigma = bend[0] / (z * z) + bend[1]
            if not rest <= sigma * sigma:
                continue
            x = np.float32((c - grid[2]) / grid[0])
            nx, ny = grid[0] * a, grid[1] * b
            nz = one / z - nx * x - ny * y
            square = nx * nx + ny * ny + nz * nz
            # n·(x, y, 1) is 1 / z in these units.
            if one < _GRAZED * square * z * z * (x * x + y * y + one):
                continue
            length = np.sqrt(square)
            out[r, c, 0], out[r, c, 1], out[r, c, 2] = -nx / length, -ny / length, -nz / length


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _slopes(depth_m: Any, r: int, c: int, radius: int, limit: Any) -> Any:
    """Slopes of inverse depth along u and v about a pixel, and what of its variance they leave; NaN for too few."""
    zero, one = np.float32(0), np.float32(1)
    z = depth_m[r, c]
    here = one / z
    suu = svv = suv = su = sv = s = sud = svd = sd = sdd = zero
    for i in range(-radius, radius + 1):
        v = np.float32(i)
        for j in range(-radius, radius + 1):
            near, u = depth_m[r + i, c + j], np.float32(j)
            if near > 0 and abs(near - z) < limit:
                d = one / near - here
                suu, svv, suv = suu + u * u, svv + v * v, suv + u * v
                su, sv, s = su + u, sv + v, s + one
                sud, svd, sd, sdd = sud + u * d, svd + v * d, sd + d, sdd + d * d
    suu, svv, suv = suu - su * su / s, svv - sv * sv / s, suv - su * sv / s
    sud, svd, sdd = sud - su * sd / s, svd - sv * sd / s, sdd - sd * sd / s
    det = suu * svv - suv * suv
    if s < _FEWEST or det < one:
        return zero, zero, _NAN
    a, b = (svv * sud - suv * svd) / det, (suu * svd - suv * sud) / det
    return a, b, (sdd - a * sud - b * svd) / s
