"""Compiled inner loops that show surfels from a pose: oriented disks, those of the nearest surface blended.

Rows are shared among threads, and each takes the disks in their order, so that no pixel depends on how many there are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from wheelsight.mapping._block_kernels import CONFIDENCE, PAGE, RADIUS

# Of the kernels imported, so that numba's cache of this file's ends with theirs; a test tells when to renew it.
_COMPILED_IN = 0x61C70905

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
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
# rim, n·p, normal (3), rank's addend, weight, red, green, blue, grey.
DISK, _FORM, _PLANE, _N, _ADDEND, _WEIGHT, _RED, _GREY = 15, 2, 5, 6, 9, 10, 11, 14
# Sums of a pixel: weight, depth, normal (3), grey, weight of those with grey, rank of the nearest; then colour.
SUMS, _DEPTH, _NORMAL, _SUM_GREY, _PAINTED, _RANK = 8, 1, 2, 5, 6, 7


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
    """The surfels of pages `begin` to `end` that face the camera, as disks; those of page k from entry k·PAGE on.

    Args:
        T: (4, 4) T_world_camera, float32. grid: fx, fy, cx, cy, float32.
        stable: confidence from which surfels are stable. least: confidence from which they are shown.
        since_s: surfels not seen since are left out.
        disk: (entries, DISK) float32. bound: (entries, 4) int16 first and last row, first and last column.
        count: (pages,) of disks.
    """
    fx, fy, cx, cy = grid[0], grid[1], grid[2], grid[3]
    for k in range(begin, end):
        entry = k * PAGE
        for slot in range(pages[k] * PAGE, pages[k] * PAGE + page_fill[pages[k]]):
            s = geometry[slot]
            if s[CONFIDENCE] < least or s[CONFIDENCE] <= 0 or seen_s[slot, 1] < since_s:
                continue
            a, b, d = s[0] - T[0, 3], s[1] - T[1, 3], s[2] - T[2, 3]
            z = T[0, 2] * a + T[1, 2] * b + T[2, 2] * d
            facing = -(a * s[4] + b * s[5] + d * s[6])
            if z < _NEAREST_M or z > far_m or facing < _LEAST_COSINE * z:
                continue
            x, y = T[0, 0] * a + T[1, 0] * b + T[2, 0] * d, T[0, 1] * a + T[1, 1] * b + T[2, 1] * d
            u, v, scale = fx * x / z + cx, fy * y / z + cy, fx / z
            nx = T[0, 0] * s[4] + T[1, 0] * s[5] + T[2, 0] * s[6]
            ny = T[0, 1] * s[4] + T[1, 1] * s[5] + T[2, 1] * s[6]
            nz = T[0, 2] * s[4] + T[1, 2] * s[5] + T[2, 2] * s[6]
            radius = max(s[RADIUS], _SMALLEST_PX * z / (scale * min(facing, z)))
            # Seen along its ray, a disk is as wide as its shadow on the image plane, but for what perspective adds.
            half_u = min(scale * radius * np.sqrt(max(_ONE - nx * nx, _ZERO)), _LARGEST_PX)
            half_v = min(scale * radius * np.sqrt(max(_ONE - ny * ny, _ZERO)), _LARGEST_PX)
            top, bottom = max(int(np.ceil(v - half_v)), 0), min(int(np.floor(v + half_v)), height - 1)
            left, right = max(int(np.ceil(u - half_u)), 0), min(int(np.floor(u + half_u)), width - 1)
            if top > bottom or left > right:
                continue
            bound[entry, 0], bound[entry, 1], bound[entry, 2], bound[entry, 3] = top, bottom, left, right
            e, paint = disk[entry], look[slot]
            _set_form(e, x / z, y / z, nx, ny, -facing, z, radius)
            e[_PLANE], e[_N], e[_N + 1], e[_N + 2] = -facing, nx, ny, nz
            e[_ADDEND] = _ZERO if s[CONFIDENCE] >= stable else BEHIND_M
            e[_WEIGHT] = s[CONFIDENCE]
            e[_RED], e[_RED + 1], e[_RED + 2], e[_GREY] = paint[0], paint[1], paint[2], paint[3]
            entry += 1
        count[k] = entry - k * PAGE


@njit(cache=True, nogil=True, error_model="numpy")
def blend(
    begin: Any,
    end: Any,
    ray_x: Any,
    ray_y: Any,
    disk: Any,
    bound: Any,
    count: Any,
    sums: Any,
    colors: Any,
) -> None:
    """Weighted sums (h, w, SUMS) of the disks on the surface nearest to each pixel of rows `begin` to `end`.

    A disk that is clearly nearer than what was summed so far begins the sum anew; one clearly farther is left out.

    Args:
        ray_x, ray_y: (w,), (h,) slopes of columns and rows, float32.
        colors: (h, w, 3) sums of colour too; of another shape where none is asked for.
    """
    with_color = colors.shape[:2] == sums.shape[:2]
    sums[begin:end] = 0
    for r in range(begin, end):
        for c in range(sums.shape[1]):
            sums[r, c, _RANK] = np.inf
    for k in range(len(count)):
        for entry in range(k * PAGE, k * PAGE + count[k]):
            low, high = max(bound[entry, 0], begin), min(bound[entry, 1], end - 1)
            left, right = bound[entry, 2], bound[entry, 3] + 1
            e = disk[entry]
            for r in range(low, high + 1):
                y, dy = ray_y[r], ray_y[r] - e[1]
                across, part = e[_N + 1] * y + e[_N + 2], e[_FORM + 2] * dy * dy
                for c in range(left, right):
                    dx = ray_x[c] - e[0]
                    rim = dx * (e[_FORM] * dx + e[_FORM + 1] * dy) + part
                    if rim <= _ONE:
                        z = e[_PLANE] / (e[_N] * ray_x[c] + across)
                        _add(sums[r, c], e, z, e[_WEIGHT] * (_RIM - rim) * (_RIM - rim), colors, with_color, r, c)


@njit(cache=True, nogil=True, inline="always")
def _set_form(e: Any, x: Any, y: Any, nx: Any, ny: Any, plane: Any, z: Any, radius: Any) -> None:
    """The middle's slopes, and the squared distance from it on the plane, over radius², of slopes (dx, dy) beside.

    To first order the plane's depth changes by dz = g·dx + h·dy, and a point by (z·dx + x·dz, z·dy + y·dz, dz).
    """
    g, h = -z * z * nx / plane, -z * z * ny / plane
    ray2 = x * x + y * y + _ONE
    scale = _ONE / (radius * radius)
    e[0], e[1] = x, y
    e[_FORM] = scale * (z * z + (x * z + x * z) * g + ray2 * g * g)
    e[_FORM + 1] = (scale + scale) * (z * (x * h + y * g) + ray2 * g * h)
    e[_FORM + 2] = scale * (z * z + (y * z + y * z) * h + ray2 * h * h)


@njit(cache=True, nogil=True, inline="always")
def _add(total: Any, e: Any, z: Any, weight: Any, colors: Any, with_color: Any, r: Any, c: Any) -> None:
    """Add a disk that a pixel sees at depth z to what it saw before."""
    rank, reach = z + e[_ADDEND], _BLEND * z + _BLEND_M
    if rank > total[_RANK] + reach:
        return
    if rank < total[_RANK] - reach:
        total[:] = 0
        total[_RANK] = rank
        if with_color:
            colors[r, c] = 0
    total[_RANK] = min(total[_RANK], rank)
    total[0] += weight
    total[_DEPTH] += weight * z
    total[_NORMAL] += weight * e[_N]
    total[_NORMAL + 1] += weight * e[_N + 1]
    total[_NORMAL + 2] += weight * e[_N + 2]
    if e[_GREY] >= 0:
        total[_PAINTED] += weight
        total[_SUM_GREY] += weight * e[_GREY]
        if with_color:
            for i in range(3):
                colors[r, c, i] += weight * e[_RED + i]


@njit(cache=True, nogil=True, error_model="numpy")
def divide(begin: Any, end: Any, sums: Any, depth_m: Any, normal: Any, grey: Any, colors: Any) -> None:
    """The means of rows `begin` to `end`: depth, normal, grey, and colour in place; 0, 0, -1, -1 where nothing is."""
    with_color = colors.shape[:2] == grey.shape
    for r in range(begin, end):
        for c in range(grey.shape[1]):
            total = sums[r, c]
            painted = total[_PAINTED] > 0
            depth_m[r, c] = total[_DEPTH] / total[0] if total[0] > 0 else _ZERO
            a, b, d = total[_NORMAL], total[_NORMAL + 1], total[_NORMAL + 2]
            length2 = a * a + b * b + d * d
            scale = _ONE / np.sqrt(length2) if length2 > 0 else _ZERO
            normal[r, c, 0], normal[r, c, 1], normal[r, c, 2] = a * scale, b * scale, d * scale
            grey[r, c] = total[_SUM_GREY] / total[_PAINTED] if painted else -_ONE
            if with_color:
                for i in range(3):
                    colors[r, c, i] = colors[r, c, i] / total[_PAINTED] if painted else -_ONE
