"""Compiled inner loops that match surfels with what a frame saw: which fit, which fits best, and what is new.

Arrays are indexed in full, for views of their rows would be counted, which takes longer than the work. Images come
flat where one number tells a pixel. Numbers are float32: a literal beside one would make it float64, at twice the time.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.mapping._block_kernels import CONFIDENCE, PAGE, RADIUS, InView, SurfelArrays

_ZERO, _HALF = np.float32(0.0), np.float32(0.5)
# Order in which surfels are preferred to each other where several fit a pixel; added to a distance in pixels².
_UNSTABLE, _INACTIVE = np.float32(1.0), np.float32(2.0)
_NEAREST_M = np.float32(0.1)
# What each entry of `since_s` is.
_MADE, _SHOWN, _ACTIVE = range(3)
# Rows of the buffer of a page's surfels: where they are (3), how deep, and how far off their pixel's middle, squared.
_PLACE, _Z, _OFF, _OUTSIDE = 5, 3, 4, np.int32(-1)
# What each entry of `noise` is.
CONSTANT, QUADRATIC, NEAR, FAR = range(4)
# What a reading is, in the map: point (3), variance along the normal, normal (3), weight; weight 0 is not fused.
READING, VARIANCE, WEIGHT = 8, 3, 7


class Camera(NamedTuple):
    """Where a camera is and how it sees, all float32.

    Attributes:
        T: (4, 4) T_map_camera.
        grid: (4,) fx, fy, cx, cy.
        ray_x, ray_y: (w,), (h,) slopes of columns and rows.
        pitch: 1 / f.
        noise: (4,) of depth; see the constants.
    """

    T: Any
    grid: Any
    ray_x: Any
    ray_y: Any
    pitch: Any
    noise: Any


class Seen(NamedTuple):
    """What a frame saw.

    Attributes:
        depth_m: (h, w).
        reading: (h·w, READING) what each pixel says of the map.
        radius: (h·w,) that a surfel of the pixel's reading would have.
        color: (h·w, 3), or (0, 3) where the frame has none.
        grey: (h·w,).
        stamp_s: of the frame.
        frames: how many it counts as.
        since_s: (3,) unstable surfels first seen before the first of these, or last seen before the second, are gone;
            surfels seen since the third are active.
    """

    depth_m: Any
    reading: Any
    radius: Any
    color: Any
    grey: Any
    stamp_s: Any
    frames: Any
    since_s: Any


class Rules(NamedTuple):
    """`SurfelSettings` as kernels read them, all float32, by their names there; and what is reckoned of them.

    Attributes:
        min_normal_dot, min_cosine: of normals that agree, and of the angle at which a surface is seen.
        laid_m: how far surfels are laid.
        least_cosine2: the square of least_cosine.
    """

    stable_confidence: Any
    most_confidence: Any
    gone_confidence: Any
    color_frames: Any
    most_readings: Any
    far_m: Any
    averaged_sigmas: Any
    gate_sigmas: Any
    gate_m: Any
    disk_cosine: Any
    gap_m: Any
    fine_enough: Any
    free_m: Any
    free_sigmas: Any
    drift_m: Any
    min_normal_dot: Any
    min_cosine: Any
    laid_m: Any
    least_cosine2: Any


class Candidates(NamedTuple):
    """Surfels that fit what is seen where they fall in the image.

    Attributes:
        slots, pixel: (entries,); those of page k from entry k·PAGE on. Pixels count row by row.
        rank: (entries,) the lower, the better it fits.
        counts: (pages, 4) how many, and how many died; of these, later, how many were chosen, and how many died then.
        chosen: (h·w,) the best one's entry, -1 where there is none.
    """

    slots: Any
    pixel: Any
    rank: Any
    counts: Any
    chosen: Any


@kernel(error_model="numpy")
def find_candidates(
    begin: Any, end: Any, view: InView, surfels: SurfelArrays, seen: Seen, camera: Camera, rules: Rules, out: Candidates
) -> None:
    """The surfels of pages `begin` to `end` that agree with what is seen where they fall in the image.

    Surfels that contradict free space lose confidence here, and unstable ones die when their time has come.
    """
    # Taken out of their tuples once: each time would be counted.
    pages, page_fill, slots, pixel, rank = view.pages, view.fill, out.slots, out.pixel, out.rank
    geometry, seen_s, variance = surfels.geometry, surfels.seen_s, surfels.variance
    depth_m, reading, T, grid, noise = seen.depth_m, seen.reading, camera.T, camera.grid, camera.noise
    since_s, stable, gone = seen.since_s, rules.stable_confidence, rules.gone_confidence
    seen_m, place, where = depth_m.reshape(-1), np.empty((_PLACE, PAGE), np.float32), np.empty(PAGE, np.int32)
    for k in range(begin, end):
        first, fill, entry, died = pages[k] * PAGE, page_fill[pages[k]], k * PAGE, 0
        _place(geometry, first, fill, T, grid, depth_m.shape, place, where)
        for i in range(fill):
            slot, p, confidence = first + i, where[i], geometry[first + i, CONFIDENCE]
            if confidence <= 0:
                continue
            is_stable, is_active = confidence >= stable, seen_s[slot, 1] >= since_s[_ACTIVE]
            if not is_stable and (seen_s[slot, 0] < since_s[_MADE] or seen_s[slot, 1] < since_s[_SHOWN]):
                geometry[slot, CONFIDENCE] = _ZERO
                died += 1
            elif p >= 0 and _agree(geometry, slot, reading, p, variance, rules):
                worse = (_ZERO if is_stable else _UNSTABLE) + (_ZERO if is_active else _INACTIVE)
                slots[entry], pixel[entry], rank[entry] = slot, p, place[_OFF, i] + worse
                entry += 1
            elif p >= 0 and place[_Z, i] < seen_m[p] - rules.free_m:
                aside_m = _ZERO if is_active else rules.drift_m
                if _is_free(depth_m, p, place[_Z, i], aside_m, noise, rules):
                    geometry[slot, CONFIDENCE] = _HALF * confidence if _HALF * confidence >= gone else _ZERO
                    died += geometry[slot, CONFIDENCE] <= 0
        out.counts[k, 0], out.counts[k, 1] = entry - k * PAGE, died


@kernel(inline="always", error_model="numpy")
def _place(geometry: Any, first: Any, fill: Any, T: Any, grid: Any, shape: Any, place: Any, where: Any) -> None:
    """The pixels `where` a page's surfels fall, -1 outside; how deep, and how far from the pixel's middle, squared."""
    # Read once: the compiler cannot know that they stay as they are while buffers are written.
    fx, fy, cx, cy = grid[0], grid[1], grid[2] + _HALF, grid[3] + _HALF
    ax, ay, az, bx, by, bz = T[0, 0], T[1, 0], T[2, 0], T[0, 1], T[1, 1], T[2, 1]
    dx, dy, dz, tx, ty, tz = T[0, 2], T[1, 2], T[2, 2], T[0, 3], T[1, 3], T[2, 3]
    height, width = np.float32(shape[0]), np.float32(shape[1])
    for i in range(fill):
        for k in range(3):
            place[k, i] = geometry[first + i, k]
    for i in range(fill):
        a, b, d = place[0, i] - tx, place[1, i] - ty, place[2, i] - tz
        z = dx * a + dy * b + dz * d
        u, v = fx * (ax * a + ay * b + az * d) / z + cx, fy * (bx * a + by * b + bz * d) / z + cy
        is_seen = (z >= _NEAREST_M) & (u >= _ZERO) & (u < width) & (v >= _ZERO) & (v < height)
        u, v = u if is_seen else _ZERO, v if is_seen else _ZERO
        c, r = np.int32(u), np.int32(v)
        du, dv = u - np.float32(c) - _HALF, v - np.float32(r) - _HALF
        where[i] = r * np.int32(shape[1]) + c if is_seen else _OUTSIDE
        place[_Z, i], place[_OFF, i] = z, du * du + dv * dv


@kernel(inline="always", error_model="numpy")
def _agree(geometry: Any, slot: Any, reading: Any, p: Any, variance: Any, rules: Rules) -> Any:
    """Whether a surfel lies on the plane of pixel p's reading, and faces as it does."""
    along = _ZERO
    for k in range(3):
        along += reading[p, 4 + k] * (geometry[slot, k] - reading[p, k])
    is_near = abs(along) <= _gate(reading, p, variance, slot, rules)
    return (reading[p, WEIGHT] > 0) & faces(geometry, slot, reading, p, rules) & is_near


@kernel(inline="always", error_model="numpy")
def _is_free(depth_m: Any, p: Any, z: Any, aside_m: Any, noise: Any, rules: Rules) -> Any:
    """Whether all that is seen about pixel p lies behind a depth z, clearly; `aside_m` more for what rests."""
    r, c, is_free = p // depth_m.shape[1], p % depth_m.shape[1], True
    sigma = deviation(noise, depth_m[r, c])
    beyond_m = z + rules.free_m + aside_m + rules.free_sigmas * sigma
    for i in range(max(r - 1, 0), min(r + 2, depth_m.shape[0])):
        for j in range(max(c - 1, 0), min(c + 2, depth_m.shape[1])):
            is_free &= depth_m[i, j] > beyond_m
    return is_free


@kernel(error_model="numpy")
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


@kernel(error_model="numpy")
def find_new(
    begin: Any, end: Any, found: Candidates, surfels: SurfelArrays, seen: Seen, pitch: Any, rules: Rules, is_new: Any
) -> None:
    """Which pixels of rows `begin` to `end` saw something that no surfel stands for: (h, w) of bool.

    Others are looked for as far about a pixel as a surfel of its reading would reach.
    """
    depth_m, reading, radius, chosen = seen.depth_m, seen.reading, seen.radius, found.chosen
    width = depth_m.shape[1]
    for r in range(begin, end):
        for c in range(width):
            p = r * width + c
            is_new[r, c] = chosen[p] < 0 and reading[p, WEIGHT] > 0 and depth_m[r, c] <= rules.laid_m
            if is_new[r, c]:
                wide_m = depth_m[r, c] * pitch
                near = (r, c, max(np.int64(radius[p] / wide_m), 1))
                size_m = (radius[p], wide_m)
                is_new[r, c] = not _is_covered(near, found, surfels, reading, size_m, depth_m.shape, rules)


@kernel(error_model="numpy")
def _is_covered(
    near: Any, found: Candidates, surfels: SurfelArrays, reading: Any, size_m: Any, shape: Any, rules: Rules
) -> Any:
    """Whether one of the surfels chosen for pixels near a reading's makes another one needless there."""
    (r, c, reach), (radius_m, wide_m), (height, width) = near, size_m, shape
    slots, chosen, geometry, variance = found.slots, found.chosen, surfels.geometry, surfels.variance
    for i in range(max(r - reach, 0), min(r + reach + 1, height)):
        for j in range(max(c - reach, 0), min(c + reach + 1, width)):
            entry = chosen[i * width + j]
            if entry >= 0 and _covers(
                geometry, slots[entry], variance, reading, r * width + c, radius_m, wide_m, rules
            ):
                return True
    return False


@kernel(inline="always", error_model="numpy")
def _covers(
    geometry: Any, slot: Any, variance: Any, reading: Any, p: Any, radius_m: Any, wide_m: Any, rules: Rules
) -> Any:
    """Whether a surfel agrees with a reading and has it on its disk, so near its middle that no other is needed.

    Near is a pixel's width, and the gap that may stay if the surfel is stable and hardly coarser than what the
    reading's would be: what one lap leaves between disks, laps of the same place would else fill for ever.
    """
    radius = geometry[slot, RADIUS]
    is_settled = (geometry[slot, CONFIDENCE] >= rules.stable_confidence) & (radius <= rules.fine_enough * radius_m)
    near_m = min(max(wide_m, _HALF * radius, rules.gap_m if is_settled else _ZERO), radius)
    along, across2 = apart(geometry, slot, reading, p)
    is_on_it = (across2 <= near_m * near_m) & (abs(along) <= _gate(reading, p, variance, slot, rules))
    return is_on_it & faces(geometry, slot, reading, p, rules)


@kernel(inline="always", error_model="numpy")
def _gate(reading: Any, p: Any, variance: Any, slot: Any, rules: Rules) -> Any:
    """How far from a surfel, along the normal, a reading still agrees with it."""
    return rules.gate_sigmas * np.sqrt(reading[p, VARIANCE] + variance[slot]) + rules.gate_m


@kernel(inline="always", error_model="numpy")
def deviation(noise: Any, z: Any) -> Any:
    """The standard deviation of a depth z."""
    return noise[CONSTANT] + noise[QUADRATIC] * z * z


@kernel(inline="always", error_model="numpy")
def faces(geometry: Any, slot: Any, others: Any, other: Any, rules: Rules) -> Any:
    """Whether the normals of a surfel and of another surfel or reading agree."""
    cosine = _ZERO
    for k in range(4, 7):
        cosine += geometry[slot, k] * others[other, k]
    return cosine >= rules.min_normal_dot


@kernel(inline="always", error_model="numpy")
def apart(geometry: Any, slot: Any, others: Any, other: Any) -> Any:
    """How far a surfel is from another surfel or reading, along the other's normal, and squared, across it."""
    along = distance2 = _ZERO
    for k in range(3):
        off = geometry[slot, k] - others[other, k]
        along += others[other, 4 + k] * off
        distance2 += off * off
    return along, distance2 - along * along
