"""Compiled inner loops that match surfels with what a frame saw: which fit, which fits best, and what is new.

Arrays are indexed in full, for views of their rows would be counted, which takes longer than the work. Images come
flat where one number tells a pixel. Numbers are float32: a literal beside one would make it float64, at twice the time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from wheelsight.mapping._block_kernels import CONFIDENCE, PAGE, RADIUS

# Of the kernels imported, so that numba's cache of this file's ends with theirs; a test tells when to renew it.
_COMPILED_IN = 0x85AFD1F0

_ZERO, _HALF = np.float32(0.0), np.float32(0.5)
# Order in which surfels are preferred to each other where several fit a pixel; added to a distance in pixels².
_UNSTABLE, _INACTIVE = np.float32(1.0), np.float32(2.0)
_NEAREST_M = np.float32(0.1)
# A surfel in front of free space loses half its confidence a frame, and is gone below this.
_GONE = np.float32(0.4)
_FREE_SIGMAS = np.float32(4.0)
# What each entry of `settings` is.
STABLE, GATE_SIGMAS, GATE_M, MIN_NORMAL_DOT, MIN_COSINE, FREE_M, DRIFT_M, FAR_M = range(8)
# What each entry of `noise` is.
CONSTANT, QUADRATIC, NEAR, FAR = range(4)
# What a reading is, in the world: point (3), variance along the normal, normal (3), weight; weight 0 is not fused.
READING, VARIANCE, WEIGHT = 8, 3, 7


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
    made_since_s: Any,
    shown_since_s: Any,
    since_s: Any,
    slots: Any,
    pixel: Any,
    rank: Any,
    counts: Any,
) -> None:
    """The surfels of pages `begin` to `end` that agree with what is seen where they fall in the image.

    Surfels that contradict free space lose confidence here, and unstable ones die when their time has come.

    Args:
        made_since_s, shown_since_s: unstable surfels first or last seen before are gone.
        since_s: surfels seen since then are active.
        slots, pixel: (entries,) of the candidates; those of page k from entry k·PAGE on. Pixels count row by row.
        rank: (entries,) the lower, the better it fits.
        counts: (pages, 2) how many candidates, and how many died.
    """
    height, width = depth_m.shape
    fx, fy, cx, cy = grid[0], grid[1], grid[2] + _HALF, grid[3] + _HALF
    for k in range(begin, end):
        entry, died = k * PAGE, 0
        for slot in range(pages[k] * PAGE, pages[k] * PAGE + page_fill[pages[k]]):
            confidence = geometry[slot, CONFIDENCE]
            if confidence <= 0:
                continue
            if confidence < settings[STABLE] and (seen_s[slot, 0] < made_since_s or seen_s[slot, 1] < shown_since_s):
                geometry[slot, CONFIDENCE] = _ZERO
                died += 1
                continue
            a, b, d = geometry[slot, 0] - T[0, 3], geometry[slot, 1] - T[1, 3], geometry[slot, 2] - T[2, 3]
            z = T[0, 2] * a + T[1, 2] * b + T[2, 2] * d
            u = fx * (T[0, 0] * a + T[1, 0] * b + T[2, 0] * d) / z + cx
            v = fy * (T[0, 1] * a + T[1, 1] * b + T[2, 1] * d) / z + cy
            if z < _NEAREST_M or not (0 <= u < width and 0 <= v < height):
                continue
            c, r = int(u), int(v)
            seen_z, p = depth_m[r, c], r * width + c
            if _agree(geometry, slot, reading, p, variance, settings):
                du, dv = u - np.float32(c) - _HALF, v - np.float32(r) - _HALF
                off = du * du + dv * dv + (_ZERO if confidence >= settings[STABLE] else _UNSTABLE)
                rank[entry] = off if seen_s[slot, 1] >= since_s else off + _INACTIVE
                slots[entry], pixel[entry] = slot, p
                entry += 1
            elif z < seen_z - settings[FREE_M]:
                margin = settings[FREE_M] + (_ZERO if seen_s[slot, 1] >= since_s else settings[DRIFT_M])
                margin += _FREE_SIGMAS * (noise[CONSTANT] + noise[QUADRATIC] * seen_z * seen_z)
                if _is_free(depth_m, r, c, z + margin):
                    halved = _HALF * confidence
                    geometry[slot, CONFIDENCE] = halved if halved >= _GONE else _ZERO
                    died += halved < _GONE
        counts[k, 0], counts[k, 1] = entry - k * PAGE, died


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _agree(geometry: Any, slot: Any, reading: Any, p: Any, variance: Any, settings: Any) -> Any:
    """Whether a surfel lies on the plane of pixel p's reading, and faces as it does."""
    along = _ZERO
    for k in range(3):
        along += reading[p, 4 + k] * (geometry[slot, k] - reading[p, k])
    reach = settings[GATE_SIGMAS] * np.sqrt(reading[p, VARIANCE] + variance[slot]) + settings[GATE_M]
    return (reading[p, WEIGHT] > 0) & faces(geometry, slot, reading, p, settings) & (abs(along) <= reach)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _is_free(depth_m: Any, r: Any, c: Any, beyond_m: Any) -> Any:
    """Whether all that is seen about a pixel lies beyond."""
    is_free = True
    for i in range(max(r - 1, 0), min(r + 2, depth_m.shape[0])):
        for j in range(max(c - 1, 0), min(c + 2, depth_m.shape[1])):
            is_free &= depth_m[i, j] > beyond_m
    return is_free


@njit(cache=True, nogil=True, error_model="numpy")
def choose(begin: Any, end: Any, width: Any, pixel: Any, rank: Any, counts: Any, best: Any, chosen: Any) -> None:
    """The best candidate's entry for each pixel of rows `begin` to `end`, -1 where there is none: (h·w,)."""
    low, high = begin * width, end * width
    best[low:high] = np.inf
    chosen[low:high] = -1
    for k in range(len(counts)):
        for entry in range(k * PAGE, k * PAGE + counts[k, 0]):
            p = pixel[entry]
            if low <= p < high and rank[entry] < best[p]:
                best[p], chosen[p] = rank[entry], entry


@njit(cache=True, nogil=True, error_model="numpy")
def find_new(
    begin: Any,
    end: Any,
    slots: Any,
    geometry: Any,
    chosen: Any,
    depth_m: Any,
    reading: Any,
    pitch: Any,
    settings: Any,
    is_new: Any,
) -> None:
    """Which pixels of rows `begin` to `end` saw something that no surfel stands for: (h, w) of bool."""
    height, width = depth_m.shape
    for r in range(begin, end):
        for c in range(width):
            p = r * width + c
            wanted = chosen[p] < 0 and reading[p, WEIGHT] > 0
            if wanted:
                for i in range(max(r - 1, 0), min(r + 2, height)):
                    for q in range(i * width + max(c - 1, 0), i * width + min(c + 2, width)):
                        if wanted and chosen[q] >= 0:
                            wanted = not _covers(
                                geometry, slots[chosen[q]], reading, p, depth_m[r, c] * pitch, settings
                            )
            is_new[r, c] = wanted


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _covers(geometry: Any, slot: Any, reading: Any, p: Any, size_m: Any, settings: Any) -> Any:
    """Whether a surfel faces as a reading does and lies on it within a pixel's size, so that no other is needed."""
    radius = geometry[slot, RADIUS]
    reach = min(max(size_m, _HALF * radius), radius)
    along, across2 = apart(geometry, slot, reading, p)
    is_near = (across2 <= reach * reach) & (abs(along) <= radius + radius)
    return is_near & faces(geometry, slot, reading, p, settings)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def faces(geometry: Any, slot: Any, others: Any, other: Any, settings: Any) -> Any:
    """Whether the normals of a surfel and of another surfel or reading agree."""
    cosine = _ZERO
    for k in range(4, 7):
        cosine += geometry[slot, k] * others[other, k]
    return cosine >= settings[MIN_NORMAL_DOT]


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def apart(geometry: Any, slot: Any, others: Any, other: Any) -> Any:
    """How far a surfel is from another surfel or reading, along the other's normal, and squared, across it."""
    along = distance2 = _ZERO
    for k in range(3):
        off = geometry[slot, k] - others[other, k]
        along += others[other, 4 + k] * off
        distance2 += off * off
    return along, distance2 - along * along
