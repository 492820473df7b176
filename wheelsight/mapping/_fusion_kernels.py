"""Compiled inner loops of fusion: which surfel a pixel saw, what that teaches it, and which surfels are new or gone.

After Keller et al. 2013, "Real-time 3D reconstruction in dynamic scenes using point-based fusion", section 4. Every
pass goes either over entries (surfels in view, each by one thread) or over rows of the image, reads only what earlier
passes wrote, and takes entries in their order, so that nothing depends on how many threads share the work.

Numbers are float32 throughout: a literal beside one would make it float64, at twice the time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from wheelsight.mapping._block_kernels import CONFIDENCE, PAGE, RADIUS, STRAY_M

# Of the kernels imported, so that numba's cache of this file's ends with theirs; a test tells when to renew it.
_COMPILED_IN = 0x61C70905

_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
# Order in which surfels are preferred to each other where several fit a pixel; added to a distance in pixels².
_UNSTABLE, _INACTIVE = np.float32(1.0), np.float32(2.0)
_NEAREST_M = np.float32(0.1)
# A surfel in front of free space loses half its confidence a frame, and is gone below this.
_GONE = np.float32(0.4)
_FREE_SIGMAS = np.float32(4.0)
# Beyond, more sightings change nothing: what is seen for long can still change.
MOST_CONFIDENCE = np.float32(100.0)
_COLOR_MEMORY = np.float32(20.0)
# A position is never better known than poses are: no more than so many readings count.
_MOST_READINGS = np.float32(50.0)
_LEAST_COSINE2, _LEAST_COSINE = np.float32(0.04), np.float32(0.35)
_LEAST_VARIANCE = np.float32(1e-8)
# What each entry of `settings` is.
STABLE, GATE_SIGMAS, GATE_M, MIN_NORMAL_DOT, MIN_COSINE, FREE_M, DRIFT_M, FAR_M = range(8)
# What each entry of `noise` is.
_CONSTANT, _QUADRATIC, _NEAR, _FAR = range(4)
# What a reading is, in the world: point (3), variance along the normal, normal (3), weight; weight 0 is not fused.
READING, _VARIANCE, _WEIGHT = 8, 3, 7


@njit(cache=True, nogil=True, error_model="numpy")
def read(
    begin: Any,
    end: Any,
    depth_m: Any,
    normal: Any,
    weight: Any,
    T: Any,
    ray_x: Any,
    ray_y: Any,
    pitch: Any,
    noise: Any,
    settings: Any,
    reading: Any,
    radius: Any,
) -> None:
    """Readings (h, w, READING) of rows `begin` to `end` in the world, and the radius (h, w) a surfel would have.

    Depth errs along the ray; what of it counts is its share along the normal, bounded where planes are grazed. The
    radius is that of a disk that covers a pixel on its plane: z / (f·|cos|), after Whelan et al. 2015, III.A.

    Args:
        weight: (h, w) of a reading by its place in the image. pitch: 1 / f.
        T: (4, 4) T_world_camera.
    """
    for r in range(begin, end):
        y = ray_y[r]
        for c in range(depth_m.shape[1]):
            out, n, z, x = reading[r, c], normal[r, c], depth_m[r, c], ray_x[c]
            out[_WEIGHT] = _ZERO
            if not (noise[_NEAR] <= z <= min(noise[_FAR], settings[FAR_M])):
                continue
            along, ray2 = -(n[0] * x + n[1] * y + n[2]), x * x + y * y + _ONE
            cosine = along / np.sqrt(ray2)
            if not cosine >= settings[MIN_COSINE]:
                continue
            for k in range(3):
                out[k] = (T[k, 0] * x + T[k, 1] * y + T[k, 2]) * z + T[k, 3]
                out[4 + k] = T[k, 0] * n[0] + T[k, 1] * n[1] + T[k, 2] * n[2]
            sigma = noise[_CONSTANT] + noise[_QUADRATIC] * z * z
            out[_VARIANCE] = max(sigma * sigma * max(along * along, _LEAST_COSINE2), _LEAST_VARIANCE)
            out[_WEIGHT] = weight[r, c]
            radius[r, c] = z * pitch / max(cosine, _LEAST_COSINE)


@njit(cache=True, nogil=True, error_model="numpy")
def find_candidates(
    begin: Any,
    end: Any,
    pages: Any,
    page_fill: Any,
    geometry: Any,
    seen_s: Any,
    variance: Any,
    depth_m: Any,
    reading: Any,
    T: Any,
    grid: Any,
    noise: Any,
    settings: Any,
    dead_before_s: Any,
    since_s: Any,
    pixel: Any,
    rank: Any,
    died: Any,
) -> None:
    """Where the surfels of pages `begin` to `end` fall in the image, and whether they agree with what is seen there.

    Surfels that contradict free space lose confidence here, and unstable ones die when their time has come.

    Args:
        dead_before_s: unstable surfels first seen before are gone. since_s: surfels seen since then are active.
        pixel: (entries,) the pixel, counted row by row; -1 out of sight.
        rank: (entries,) the lower, the better it fits; infinite where it does not.
        died: (pages,) how many.
    """
    height, width = depth_m.shape
    fx, fy, cx, cy = grid[0], grid[1], grid[2] + _HALF, grid[3] + _HALF
    for k in range(begin, end):
        died[k] = 0
        for i in range(PAGE):
            entry, slot = k * PAGE + i, pages[k] * PAGE + i
            pixel[entry], rank[entry] = -1, np.inf
            s = geometry[slot]
            if i >= page_fill[pages[k]] or s[CONFIDENCE] <= 0:
                continue
            if s[CONFIDENCE] < settings[STABLE] and seen_s[slot, 0] < dead_before_s:
                s[CONFIDENCE] = _ZERO
                died[k] += 1
                continue
            a, b, d = s[0] - T[0, 3], s[1] - T[1, 3], s[2] - T[2, 3]
            z = T[0, 2] * a + T[1, 2] * b + T[2, 2] * d
            if z < _NEAREST_M:
                continue
            u = fx * (T[0, 0] * a + T[1, 0] * b + T[2, 0] * d) / z + cx
            v = fy * (T[0, 1] * a + T[1, 1] * b + T[2, 1] * d) / z + cy
            if not (0 <= u < width and 0 <= v < height):
                continue
            c, r = int(u), int(v)
            seen_z = depth_m[r, c]
            if not seen_z > 0:
                continue
            if _agrees(s, reading[r, c], variance[slot], settings):
                du, dv = u - np.float32(c) - _HALF, v - np.float32(r) - _HALF
                off = du * du + dv * dv + (_ZERO if s[CONFIDENCE] >= settings[STABLE] else _UNSTABLE)
                rank[entry] = off if seen_s[slot, 1] >= since_s else off + _INACTIVE
                pixel[entry] = r * width + c
            elif z < seen_z - settings[FREE_M]:
                margin = settings[FREE_M] + (_ZERO if seen_s[slot, 1] >= since_s else settings[DRIFT_M])
                margin += _FREE_SIGMAS * (noise[_CONSTANT] + noise[_QUADRATIC] * seen_z * seen_z)
                if _is_free(depth_m, r, c, z + margin):
                    s[CONFIDENCE] *= _HALF
                    if s[CONFIDENCE] < _GONE:
                        s[CONFIDENCE] = _ZERO
                        died[k] += 1


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _agrees(s: Any, m: Any, variance: Any, settings: Any) -> Any:
    """Whether a surfel lies on the plane of a reading, and faces as it does."""
    if not m[_WEIGHT] > 0 or m[4] * s[4] + m[5] * s[5] + m[6] * s[6] < settings[MIN_NORMAL_DOT]:
        return False
    distance = m[4] * (s[0] - m[0]) + m[5] * (s[1] - m[1]) + m[6] * (s[2] - m[2])
    return abs(distance) <= settings[GATE_SIGMAS] * np.sqrt(m[_VARIANCE] + variance) + settings[GATE_M]


@njit(cache=True, nogil=True, error_model="numpy")
def _is_free(depth_m: Any, r: Any, c: Any, beyond_m: Any) -> Any:
    """Whether all that is seen about a pixel lies beyond."""
    for i in range(max(r - 1, 0), min(r + 2, depth_m.shape[0])):
        for j in range(max(c - 1, 0), min(c + 2, depth_m.shape[1])):
            if not depth_m[i, j] > beyond_m:
                return False
    return True


@njit(cache=True, nogil=True)
def choose(begin: Any, end: Any, width: Any, pixel: Any, rank: Any, best: Any, chosen: Any) -> None:
    """The best candidate's entry for each pixel of rows `begin` to `end`, -1 where there is none: (h, w)."""
    best[begin:end] = np.inf
    chosen[begin:end] = -1
    low, high = begin * width, end * width
    ranks, entries = best.reshape(-1), chosen.reshape(-1)
    for entry in range(len(pixel)):
        p = pixel[entry]
        if low <= p < high and rank[entry] < ranks[p]:
            ranks[p], entries[p] = rank[entry], entry


@njit(cache=True, nogil=True, error_model="numpy")
def find_new(
    begin: Any,
    end: Any,
    pages: Any,
    geometry: Any,
    chosen: Any,
    depth_m: Any,
    reading: Any,
    pitch: Any,
    settings: Any,
    is_new: Any,
) -> None:
    """Which pixels of rows `begin` to `end` saw something that no surfel stands for: (h, w) of bool."""
    height, width = chosen.shape
    for r in range(begin, end):
        for c in range(width):
            is_new[r, c] = chosen[r, c] < 0 and reading[r, c, _WEIGHT] > 0
            if not is_new[r, c]:
                continue
            for i in range(max(r - 1, 0), min(r + 2, height)):
                for j in range(max(c - 1, 0), min(c + 2, width)):
                    if chosen[i, j] >= 0 and is_new[r, c]:
                        s = geometry[pages[chosen[i, j] // PAGE] * PAGE + chosen[i, j] % PAGE]
                        if _covers(s, reading[r, c], depth_m[r, c] * pitch, settings):
                            is_new[r, c] = False


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _covers(s: Any, m: Any, size_m: Any, settings: Any) -> Any:
    """Whether a surfel faces as a reading does and lies on it within a pixel's size, so that no other is needed."""
    if m[4] * s[4] + m[5] * s[5] + m[6] * s[6] < settings[MIN_NORMAL_DOT]:
        return False
    a, b, d = m[0] - s[0], m[1] - s[1], m[2] - s[2]
    along = m[4] * a + m[5] * b + m[6] * d
    reach = min(max(size_m, _HALF * s[RADIUS]), s[RADIUS])
    return a * a + b * b + d * d - along * along <= reach * reach and abs(along) <= s[RADIUS] + s[RADIUS]


@njit(cache=True, nogil=True, error_model="numpy")
def update(
    begin: Any,
    end: Any,
    pages: Any,
    geometry: Any,
    look: Any,
    seen_s: Any,
    variance: Any,
    page_cell: Any,
    cell_xyz: Any,
    cell_seen_s: Any,
    block_m: Any,
    chosen: Any,
    reading: Any,
    radius: Any,
    color: Any,
    grey: Any,
    stamp_s: Any,
    counts: Any,
) -> None:
    """Average what the pixels of rows `begin` to `end` saw into their surfels; `counts` (h, 2) matched and died.

    A surfel moves along the reading's normal only: across it, it would be drawn to pixels' centres. Both are weighted
    by what is known of them, 1/variance.
    """
    for r in range(begin, end):
        counts[r, 0] = counts[r, 1] = 0
        for c in range(chosen.shape[1]):
            if chosen[r, c] < 0:
                continue
            slot = pages[chosen[r, c] // PAGE] * PAGE + chosen[r, c] % PAGE
            s, m = geometry[slot], reading[r, c]
            counts[r, 0] += 1
            before = max(variance[slot], m[_VARIANCE] / _MOST_READINGS)
            share = before / (before + m[_VARIANCE] / m[_WEIGHT])
            variance[slot] = before * (_ONE - share)
            off = share * (m[4] * (m[0] - s[0]) + m[5] * (m[1] - s[1]) + m[6] * (m[2] - s[2]))
            length2 = _ZERO
            for k in range(3):
                s[k] += off * m[4 + k]
                s[4 + k] += share * (m[4 + k] - s[4 + k])
                length2 += s[4 + k] * s[4 + k]
            scale = _ONE / np.sqrt(length2)
            for k in range(3):
                s[4 + k] *= scale
            s[RADIUS] += share * min(radius[r, c] - s[RADIUS], _ZERO)
            paint(look[slot], color[r, c], grey[r, c], m[_WEIGHT] / (min(s[CONFIDENCE], _COLOR_MEMORY) + m[_WEIGHT]))
            s[CONFIDENCE] = min(s[CONFIDENCE] + m[_WEIGHT], MOST_CONFIDENCE)
            seen_s[slot, 1] = stamp_s
            cell = page_cell[slot // PAGE]
            cell_seen_s[cell] = stamp_s
            if _has_left(s, cell_xyz[cell], block_m):
                s[CONFIDENCE] = _ZERO
                counts[r, 1] += 1


@njit(cache=True, nogil=True, inline="always")
def paint(look: Any, color: Any, grey: Any, share: Any) -> None:
    """Average colour (3,) and grey into a surfel's, as far as they are known."""
    if color[0] >= 0:
        for k in range(3):
            look[k] = color[k] if look[k] < 0 else look[k] + share * (color[k] - look[k])
    if grey >= 0:
        look[3] = grey if look[3] < 0 else look[3] + share * (grey - look[3])


@njit(cache=True, nogil=True, inline="always")
def _has_left(s: Any, xyz: Any, block_m: Any) -> Any:
    """Whether a surfel strayed too far from its block to be found there."""
    stray = 0.0
    for k in range(3):
        stray = max(stray, xyz[k] * block_m - s[k], s[k] - (xyz[k] + 1) * block_m)
    return stray > STRAY_M


@njit(cache=True, nogil=True, error_model="numpy")
def merge(
    begin: Any,
    end: Any,
    width: Any,
    pages: Any,
    geometry: Any,
    seen_s: Any,
    variance: Any,
    pixel: Any,
    rank: Any,
    chosen: Any,
    settings: Any,
    counts: Any,
) -> None:
    """Merge into each chosen surfel of rows `begin` to `end` those at its pixel that are its like; `counts` (h,)."""
    counts[begin:end] = 0
    low, high = begin * width, end * width
    entries = chosen.reshape(-1)
    for entry in range(len(pixel)):
        p = pixel[entry]
        if not low <= p < high or rank[entry] == np.inf or entries[p] == entry:
            continue
        other = entries[p]
        slot, kept = pages[entry // PAGE] * PAGE + entry % PAGE, pages[other // PAGE] * PAGE + other % PAGE
        s, t = geometry[slot], geometry[kept]
        if t[CONFIDENCE] <= 0 or not _are_alike(s, t, variance[slot] + variance[kept], settings):
            continue
        t[CONFIDENCE] = min(t[CONFIDENCE] + s[CONFIDENCE], MOST_CONFIDENCE)
        t[RADIUS] = min(t[RADIUS], s[RADIUS])
        seen_s[kept, 0] = min(seen_s[kept, 0], seen_s[slot, 0])
        seen_s[kept, 1] = max(seen_s[kept, 1], seen_s[slot, 1])
        s[CONFIDENCE] = _ZERO
        counts[p // width] += 1


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _are_alike(s: Any, t: Any, variance: Any, settings: Any) -> Any:
    """Whether two surfels stand for one spot of one surface: closer than half the smaller one's radius across it."""
    if s[4] * t[4] + s[5] * t[5] + s[6] * t[6] < settings[MIN_NORMAL_DOT]:
        return False
    a, b, d = s[0] - t[0], s[1] - t[1], s[2] - t[2]
    along = t[4] * a + t[5] * b + t[6] * d
    reach = _HALF * min(s[RADIUS], t[RADIUS])
    is_near = a * a + b * b + d * d - along * along <= reach * reach
    return is_near and abs(along) <= settings[GATE_SIGMAS] * np.sqrt(variance) + settings[GATE_M]


@njit(cache=True, nogil=True)
def make_new(
    is_new: Any,
    reading: Any,
    radius: Any,
    color: Any,
    grey: Any,
    stamp_s: Any,
    geometry: Any,
    look: Any,
    seen_s: Any,
    variance: Any,
) -> None:
    """Surfels of the pixels marked, row by row."""
    i = 0
    for r in range(is_new.shape[0]):
        for c in range(is_new.shape[1]):
            if not is_new[r, c]:
                continue
            m = reading[r, c]
            geometry[i] = m
            geometry[i, RADIUS], geometry[i, CONFIDENCE] = radius[r, c], m[_WEIGHT]
            look[i, 0], look[i, 1], look[i, 2], look[i, 3] = color[r, c, 0], color[r, c, 1], color[r, c, 2], grey[r, c]
            seen_s[i, 0] = seen_s[i, 1] = stamp_s
            variance[i] = m[_VARIANCE] / m[_WEIGHT]
            i += 1
