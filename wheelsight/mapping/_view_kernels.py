"""Compiled inner loops that show surfels from a pose: oriented disks, those of the nearest surface blended.

Rows are shared among threads, and each takes the disks in their order, so that no pixel depends on how many there are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from wheelsight.mapping._block_kernels import CONFIDENCE, PAGE, RADIUS

# Of the kernels imported, so that numba's cache of this file's ends with theirs; a test tells when to renew it.
_COMPILED_IN = 0xC716153B

_ZERO, _QUARTER, _ONE = np.float32(0.0), np.float32(0.25), np.float32(1.0)
# Unstable surfels show only where no stable one does: they rank as if so far away.
BEHIND_M = np.float32(1000.0)
# Disks no farther apart than this, a metre of depth and in all, are of one surface.
_BLEND, _BLEND_M = np.float32(0.012), np.float32(0.006)
_NEAREST_M = np.float32(0.1)
_LARGEST_PX = np.float32(24.0)
# No disk is smaller than this in pixels, or pixels would fall between disks that were seen from nearer.
_SMALLEST_PX = np.float32(0.75)
_LEAST_COSINE = np.float32(0.05)
_RIM = np.float32(1.001)
# What a disk is in the camera's frame: slopes x/z, y/z of its middle, the quadratic form (3) of slopes that is 1 at its
# rim, n·p, weight; then what a pixel averages: normal (3), whether grey is known, grey, red, green, blue (0 if not).
DISK, _FORM, _PLANE, _WEIGHT = 16, 2, 5, 6
_NORMAL, _PAINTED, _GREY, _RED = 8, 11, 12, 13
# Of a pixel: rank of the nearest disk, weight, weighted depth; and apart, weighted, the last half of a disk.
NEAR, _RANK, _TOTAL, _DEPTH = 3, 0, 1, 2
SUMS = 8


@njit(cache=True, nogil=True, error_model="numpy")
def project_disks(
    begin: Any,
    end: Any,
    pages: Any,
    page_fill: Any,
    geometry: Any,
    look: Any,
    seen_s: Any,
    T: Any,
    grid: Any,
    width: Any,
    height: Any,
    far_m: Any,
    stable: Any,
    least: Any,
    since_s: Any,
    disk: Any,
    bound: Any,
    count: Any,
) -> None:
    """The surfels of pages `begin` to `end` that face the camera, as disks.

    Page k's stable ones are from entry k·PAGE on, and its unstable ones before entry (k + 1)·PAGE.

    Args:
        T: (4, 4) T_world_camera, float32. grid: fx, fy, cx, cy, float32.
        stable: confidence from which surfels are stable. least: confidence from which they are shown.
        since_s: surfels not seen since are left out.
        disk: (entries, DISK) float32. bound: (entries, 4) int16 first and last row, first and last column.
        count: (pages, 2) of stable and unstable disks.
    """
    fx, fy, cx, cy = grid[0], grid[1], grid[2], grid[3]
    for k in range(begin, end):
        low, high = k * PAGE, (k + 1) * PAGE
        for slot in range(pages[k] * PAGE, pages[k] * PAGE + page_fill[pages[k]]):
            confidence = geometry[slot, CONFIDENCE]
            if confidence < least or confidence <= 0 or seen_s[slot, 1] < since_s:
                continue
            a, b, d = geometry[slot, 0] - T[0, 3], geometry[slot, 1] - T[1, 3], geometry[slot, 2] - T[2, 3]
            p, q, s = geometry[slot, 4], geometry[slot, 5], geometry[slot, 6]
            z, facing = T[0, 2] * a + T[1, 2] * b + T[2, 2] * d, -(a * p + b * q + d * s)
            if z < _NEAREST_M or z > far_m or facing < _LEAST_COSINE * z:
                continue
            x, y = (T[0, 0] * a + T[1, 0] * b + T[2, 0] * d) / z, (T[0, 1] * a + T[1, 1] * b + T[2, 1] * d) / z
            nx, ny = T[0, 0] * p + T[1, 0] * q + T[2, 0] * s, T[0, 1] * p + T[1, 1] * q + T[2, 1] * s
            radius = max(geometry[slot, RADIUS], _SMALLEST_PX * z * z / (fx * min(facing, z)))
            xx, xy, yy = _form(x, y, nx, ny, -facing, z, radius)
            det = xx * yy - _QUARTER * xy * xy
            top, bottom = _covered(fy * y + cy, fy * np.sqrt(xx / det), height)
            left, right = _covered(fx * x + cx, fx * np.sqrt(yy / det), width)
            if top > bottom or left > right:
                continue
            entry = low if confidence >= stable else high - 1
            low, high = (low + 1, high) if confidence >= stable else (low, high - 1)
            bound[entry, 0], bound[entry, 1], bound[entry, 2], bound[entry, 3] = top, bottom, left, right
            disk[entry, 0], disk[entry, 1], disk[entry, _PLANE], disk[entry, _WEIGHT] = x, y, -facing, confidence
            disk[entry, _FORM], disk[entry, _FORM + 1], disk[entry, _FORM + 2] = xx, xy, yy
            disk[entry, _NORMAL], disk[entry, _NORMAL + 1] = nx, ny
            disk[entry, _NORMAL + 2] = T[0, 2] * p + T[1, 2] * q + T[2, 2] * s
            known = _ONE if look[slot, 3] >= 0 else _ZERO
            disk[entry, _PAINTED], disk[entry, _GREY] = known, known * look[slot, 3]
            for i in range(3):
                disk[entry, _RED + i] = known * look[slot, i]
        count[k, 0], count[k, 1] = low - k * PAGE, (k + 1) * PAGE - high


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _covered(middle: Any, half: Any, size: Any) -> Any:
    """First and last row or column of `size` of the box about a disk; its half size is an ellipse's, by its form."""
    half = min(half, _LARGEST_PX)
    return max(int(np.ceil(middle - half)), 0), min(int(np.floor(middle + half)), size - 1)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _form(x: Any, y: Any, nx: Any, ny: Any, plane: Any, z: Any, radius: Any) -> Any:
    """The squared distance on the plane, over radius², of slopes (dx, dy) beside the middle's: of dx², dx·dy, dy².

    To first order the plane's depth changes by dz = g·dx + h·dy, and a point by (z·dx + x·dz, z·dy + y·dz, dz).
    """
    g, h = -z * z * nx / plane, -z * z * ny / plane
    ray2, scale = x * x + y * y + _ONE, _ONE / (radius * radius)
    xx = scale * (z * z + (x * z + x * z) * g + ray2 * g * g)
    xy = (scale + scale) * (z * (x * h + y * g) + ray2 * g * h)
    return xx, xy, scale * (z * z + (y * z + y * z) * h + ray2 * h * h)


@njit(cache=True, nogil=True, error_model="numpy")
def blend(
    begin: Any, end: Any, ray_x: Any, ray_y: Any, disk: Any, bound: Any, count: Any, near: Any, sums: Any
) -> None:
    """Weighted sums of the stable disks on the surface nearest to each pixel of rows `begin` to `end`.

    A disk that is clearly nearer than what was summed so far begins the sum anew; one clearly farther is left out.

    Args:
        ray_x, ray_y: (w,), (h,) slopes of columns and rows, float32.
        near: (h, w, NEAR). sums: (h, w, SUMS).
    """
    sums[begin:end], near[begin:end] = 0, 0
    near[begin:end, :, _RANK] = np.inf
    for k in range(len(count)):
        for entry in range(k * PAGE, k * PAGE + count[k, 0]):
            _add_disk(entry, _ZERO, disk, bound, begin, end, ray_x, ray_y, near, sums)


@njit(cache=True, nogil=True, error_model="numpy")
def fill_in(
    begin: Any, end: Any, ray_x: Any, ray_y: Any, disk: Any, bound: Any, count: Any, near: Any, sums: Any
) -> None:
    """Once all rows are blended, add the unstable disks where no stable one is, but for those in whose middle one is.

    Args: as of `blend`.
    """
    for k in range(len(count)):
        for entry in range((k + 1) * PAGE - count[k, 1], (k + 1) * PAGE):
            r, c = (bound[entry, 0] + bound[entry, 1]) // 2, (bound[entry, 2] + bound[entry, 3]) // 2
            if near[r, c, _RANK] >= BEHIND_M:
                _add_disk(entry, BEHIND_M, disk, bound, begin, end, ray_x, ray_y, near, sums)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _add_disk(
    entry: Any, behind_m: Any, disk: Any, bound: Any, begin: Any, end: Any, ray_x: Any, ray_y: Any, near: Any, sums: Any
) -> None:
    """Add a disk to its pixels' sums, unless they have what ranks before all that are so far behind."""
    low, high = max(bound[entry, 0], begin), min(bound[entry, 1] + 1, end)
    left, right = max(bound[entry, 2], 0), bound[entry, 3] + 1
    middle_x, middle_y, nx = disk[entry, 0], disk[entry, 1], disk[entry, _NORMAL]
    xx, xy, yy = disk[entry, _FORM], disk[entry, _FORM + 1], disk[entry, _FORM + 2]
    for r in range(low, high):
        dy = ray_y[r] - middle_y
        across, part = disk[entry, _NORMAL + 1] * ray_y[r] + disk[entry, _NORMAL + 2], yy * dy * dy
        for c in range(left, right):
            nearest, dx = near[r, c, _RANK], ray_x[c] - middle_x
            if nearest < behind_m:
                continue
            rim = dx * (xx * dx + xy * dy) + part
            z = disk[entry, _PLANE] / (nx * ray_x[c] + across)
            rank, reach = z + behind_m, _BLEND * z + _BLEND_M
            if (rim > _ONE) | (rank > nearest + reach):
                continue
            kept = _ZERO if rank < nearest - reach else _ONE
            weight = disk[entry, _WEIGHT] * (_RIM - rim) * (_RIM - rim)
            near[r, c, _RANK] = min(nearest, rank)
            near[r, c, _TOTAL] = kept * near[r, c, _TOTAL] + weight
            near[r, c, _DEPTH] = kept * near[r, c, _DEPTH] + weight * z
            for i in range(SUMS):
                sums[r, c, i] = kept * sums[r, c, i] + weight * disk[entry, _NORMAL + i]


@njit(cache=True, nogil=True, error_model="numpy")
def divide(begin: Any, end: Any, near: Any, sums: Any, depth_m: Any, normal: Any, grey: Any, colors: Any) -> None:
    """The means of rows `begin` to `end`: depth, normal, grey, and colour; 0, 0, -1, -1 where nothing is.

    `colors`: (h, w, 3), or of another shape where none is asked for.
    """
    with_color = colors.shape[:2] == grey.shape
    for r in range(begin, end):
        for c in range(grey.shape[1]):
            depth_m[r, c] = near[r, c, _DEPTH] / near[r, c, _TOTAL] if near[r, c, _TOTAL] > 0 else _ZERO
            length2 = _ZERO
            for i in range(3):
                length2 += sums[r, c, i] * sums[r, c, i]
            scale = _ONE / np.sqrt(length2) if length2 > 0 else _ZERO
            for i in range(3):
                normal[r, c, i] = sums[r, c, i] * scale
            painted = sums[r, c, _PAINTED - _NORMAL]
            grey[r, c] = sums[r, c, _GREY - _NORMAL] / painted if painted > 0 else -_ONE
            if with_color:
                for i in range(3):
                    colors[r, c, i] = sums[r, c, _RED - _NORMAL + i] / painted if painted > 0 else -_ONE
