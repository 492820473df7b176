"""Compiled inner loops that make references: normals, gradients, and all that a look-up needs side by side."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from wheelsight.odometry.dense._alignment_kernels import ALONG_U, ALONG_V, DEPTH, GREY, NX, NY, NZ, OFFSET

_NAN = np.float32(np.nan)


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
def normals(depth_m: Any, grid: Any, radius: int, jump: float, begin: int, end: int, out: Any) -> None:
    """Unit normals (h, w, 3) towards the camera by least squares of inverse depth over a window; 0 where none.

    On a plane inverse depth is linear in the pixel, 1/z = a·u + b·v + c, so the normal follows from its slopes
    (Badino et al., ICRA 2011, fit the same model). The window is (2·radius + 1)², on one surface only.
    """
    height, width = depth_m.shape
    for r in range(begin, end):
        for c in range(width):
            out[r, c, 0] = out[r, c, 1] = out[r, c, 2] = np.float32(0.0)
            z = depth_m[r, c]
            if z <= 0 or r < radius or c < radius or r >= height - radius or c >= width - radius:
                continue
            suu = svv = suv = su = sv = s = sud = svd = sd = np.float32(0.0)
            limit = np.float32(jump) * z
            for i in range(-radius, radius + 1):
                for j in range(-radius, radius + 1):
                    near = depth_m[r + i, c + j]
                    if near > 0 and abs(near - z) < limit:
                        d = np.float32(1.0) / near - np.float32(1.0) / z
                        suu += j * j
                        svv += i * i
                        suv += i * j
                        su += j
                        sv += i
                        s += np.float32(1.0)
                        sud += j * d
                        svd += i * d
                        sd += d
            if s < 6:
                continue
            suu, svv, suv = suu - su * su / s, svv - sv * sv / s, suv - su * sv / s
            sud, svd = sud - su * sd / s, svd - sv * sd / s
            det = suu * svv - suv * suv
            if det < np.float32(1.0):
                continue
            a, b = (svv * sud - suv * svd) / det, (suu * svd - suv * sud) / det
            x, y = (c - grid[2]) / grid[0], (r - grid[3]) / grid[1]
            nx, ny = grid[0] * a, grid[1] * b
            nz = (np.float32(1.0) / z) - nx * x - ny * y
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            out[r, c, 0], out[r, c, 1], out[r, c, 2] = -nx / length, -ny / length, -nz / length
