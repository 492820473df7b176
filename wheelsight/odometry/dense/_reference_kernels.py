"""Compiled inner loops that make references: normals, gradients, and all that a look-up needs side by side."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.odometry.dense._alignment_kernels import ALONG_U, ALONG_V, DEPTH, GREY, NX, NY, NZ, OFFSET

_NAN = np.float32(np.nan)
_FEWEST = np.float32(6)
# So far a lens and a depth camera's window spread the rim of what stands before a surface.
_BOUNDARY_PX = 2
# Squared cosine to the ray below which neighbours are too far apart in depth for a normal. Beyond what sensors measure:
# of a floor that were cut off nearer, only the places would be left that noise tilts, and lifts, towards the camera.
_GRAZED = np.float32(0.01)
# Normals of so many pixels side by side are fitted at once: no branches, and sums that stay close at hand.
_STRETCH = 128
# Sums over a window, of u, v beside its middle and d, by how much inverse depth is more than there.
_S, _SU, _SV, _SUU, _SVV, _SUV, _SD, _SUD, _SVD, _SDD = range(10)
_SUMS = 10


@kernel(error_model="numpy")
def pack(depth_m: Any, normal: Any, grey: Any, grid: Any, boundary: Any, begin: int, end: int, out: Any) -> None:
    """Rows `begin` to `end` of a reference's pixels (h, w, CHANNELS), NaN where something is unknown.

    Args:
        depth_m, normal, grey: (h, w), 0 where unknown; (h, w, 3), 0 where unknown; (h, w), -1 where unknown.
        grid: fx, fy, cx, cy.
        boundary: (3,) by how much what stands before a surface must be nearer to make an occlusion boundary; see
            `_step`. Grey beside one has no gradient: it moves as what stands before does.
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
            if _is_at_boundary(depth_m, r, c, boundary):
                out[r, c, ALONG_U] = out[r, c, ALONG_V] = _NAN


@kernel(error_model="numpy", inline="always")
def _is_at_boundary(depth_m: Any, r: int, c: int, boundary: Any) -> Any:
    """Whether something stands before the surface within `_BOUNDARY_PX`, by more than a step `boundary`.

    On a plane inverse depth is linear: what is nearer on one side than it is farther on the other is another surface.
    """
    height, width = depth_m.shape
    if min(r, c) < _BOUNDARY_PX or r >= height - _BOUNDARY_PX or c >= width - _BOUNDARY_PX:
        return False
    z, two, found = depth_m[r, c], np.float32(2), False
    limit = _step(boundary, z)
    for i, j in ((0, 1), (1, 0), (1, 1), (1, -1)):
        one = depth_m[r + _BOUNDARY_PX * i, c + _BOUNDARY_PX * j]
        other = depth_m[r - _BOUNDARY_PX * i, c - _BOUNDARY_PX * j]
        found |= (one > 0) & (other > 0) & (z * (z / one + z / other - two) > limit)
    return found


@kernel(error_model="numpy", inline="always")
def _step(step: Any, z: Any) -> Any:
    """A step (3,) in depth, in metres at a depth z: metres, a share of z, and metres a square metre of it."""
    return step[0] + z * (step[1] + step[2] * z)


@kernel(error_model="numpy")
def normals(depth_m: Any, grid: Any, radius: int, step: Any, bend: Any, begin: int, end: int, out: Any) -> None:
    """Unit normals (h, w, 3) towards the camera by least squares of inverse depth over a window; 0 where none.

    On a plane inverse depth is linear in the pixel, 1/z = a·u + b·v + c, so the normal follows from its slopes
    (Badino et al., ICRA 2011, fit the same model). The window is (2·radius + 1)², on one surface only, without its
    middle, whose noise is much the pixel's own: a normal that turns with the noise of the point it stands on makes
    every wall pull towards the camera, by 2 to 4 mm in a corridor seen by a Kinect.

    Args:
        step: (3,) by which neighbours on one surface may differ; see `_step`.
        bend: (2,) what a surface may be off its plane, RMS: metres, and metres a square metre of depth.
    """
    (height, width), core = depth_m.shape, radius // 2
    out[begin:end] = 0
    sums, found = np.empty((_SUMS, _STRETCH), np.float32), np.empty((3, _STRETCH), np.float32)
    for r in range(max(begin, radius), min(end, height - radius)):
        for first in range(radius, width - radius, _STRETCH):
            n = min(_STRETCH, width - radius - first)
            here = depth_m[r, first : first + n]
            sums[:] = 0
            for i in range(-radius, radius + 1):
                for j in range(-radius, radius + 1):
                    if max(abs(i), abs(j)) <= core:
                        continue
                    _sum_up(here, depth_m[r + i, first + j : first + j + n], step, i, j, sums)
            _solve(here, sums, grid, bend, r, first, found)
            for c in range(n):
                for k in range(3):
                    out[r, first + c, k] = found[k, c]


@kernel(error_model="numpy", inline="always")
def _sum_up(here: Any, there: Any, step: Any, i: int, j: int, sums: Any) -> None:
    """Add to the windows' sums what their pixels i rows and j columns from the middle, `there`, tell of its surface.

    A limit that noise reaches would pick those neighbours that err as the middle does.
    """
    zero, one, u, v = np.float32(0), np.float32(1), np.float32(j), np.float32(i)
    for c in range(len(here)):
        z, near = here[c], there[c]
        is_like = (near > 0) & (abs(near - z) < _step(step, z))
        known = one if is_like else zero
        d = (z - near) / (z * near) if is_like else zero
        sums[_S, c] += known
        sums[_SU, c] += u * known
        sums[_SV, c] += v * known
        sums[_SUU, c] += u * u * known
        sums[_SVV, c] += v * v * known
        sums[_SUV, c] += u * v * known
        sums[_SD, c] += d
        sums[_SUD, c] += u * d
        sums[_SVD, c] += v * d
        sums[_SDD, c] += d * d


@kernel(error_model="numpy", inline="always")
def _solve(here: Any, sums: Any, grid: Any, bend: Any, r: int, first: int, found: Any) -> None:
    """Normals (3, n) of the pixels `here`, from column `first` of row r on, by the sums over their windows."""
    zero, one, y = np.float32(0), np.float32(1), np.float32((r - grid[3]) / grid[1])
    for c in range(len(here)):
        z, s, su, sv, sd = here[c], sums[_S, c], sums[_SU, c], sums[_SV, c], sums[_SD, c]
        suu, svv, suv = sums[_SUU, c] - su * su / s, sums[_SVV, c] - sv * sv / s, sums[_SUV, c] - su * sv / s
        sud, svd, sdd = sums[_SUD, c] - su * sd / s, sums[_SVD, c] - sv * sd / s, sums[_SDD, c] - sd * sd / s
        det = suu * svv - suv * suv
        a, b = (svv * sud - suv * svd) / det, (suu * svd - suv * sud) / det
        sigma = bend[0] / (z * z) + bend[1]
        is_flat = (s >= _FEWEST) & (det >= one) & ((sdd - a * sud - b * svd) / s <= sigma * sigma)
        x = np.float32((first + c - grid[2]) / grid[0])
        nx, ny = grid[0] * a, grid[1] * b
        # Inverse depth of the plane, not of the pixel; in its units it is n·(x, y, 1).
        near = one / z + (sd - a * su - b * sv) / s
        nz = near - nx * x - ny * y
        square = nx * nx + ny * ny + nz * nz
        is_seen = is_flat & (near > zero) & (near * near >= _GRAZED * square * (x * x + y * y + one))
        scale = -one / np.sqrt(square)
        found[0, c] = scale * nx if is_seen else zero
        found[1, c] = scale * ny if is_seen else zero
        found[2, c] = scale * nz if is_seen else zero
