"""Compiled inner loops of surfel fusion: data association, updates, new surfels, and motion with keyframes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.mapping.block_kernels import CONFIDENCE, PAGE, RADIUS, STRAY_M, InView, Pages, SurfelArrays, SurfelCells

# Data association: surfels are matched with pixels, and pixels without a surfel are new.
#
# Arrays are indexed in full: views of their rows would be reference-counted, which takes longer than the work. Images
# are flat where pixels have one index. Numbers are float32: a literal beside one would make it float64, at twice the
# time.

_ZERO, _HALF = np.float32(0.0), np.float32(0.5)
# Rank of surfels if several fit a pixel; added to a distance in pixels².
_UNSTABLE, _INACTIVE = np.float32(1.0), np.float32(2.0)
_NEAREST_M = np.float32(0.1)
# Entries of `since_s`.
_MADE, _SHOWN, _ACTIVE = range(3)
# Rows of the buffer of a page's surfels: position (3), depth, and squared distance from the pixel's centre.
_PLACE, _Z, _OFF, _OUTSIDE = 5, 3, 4, np.int32(-1)
# Entries of `noise`.
CONSTANT, QUADRATIC, NEAR, FAR = range(4)
# A reading in the map: point (3), variance along the normal, normal (3), weight; weight 0 is not fused.
READING, VARIANCE, WEIGHT = 8, 3, 7


class Camera(NamedTuple):
    """Pose and intrinsics of a camera, all float32.

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


class FrameReadings(NamedTuple):
    """Readings of a frame.

    Attributes:
        depth_m: (h, w).
        reading: (h·w, READING) of each pixel, in the map.
        radius: (h·w,) radius of a surfel of the pixel's reading.
        color: (h·w, 3), or (0, 3) without colour.
        grey: (h·w,).
        stamp_s: of the frame.
        frames: number of frames that it counts as.
        since_s: (3,) unstable surfels first seen before the first, or last seen before the second, have expired; those
            seen since the third are active.
    """

    depth_m: Any
    reading: Any
    radius: Any
    color: Any
    grey: Any
    stamp_s: Any
    frames: Any
    since_s: Any


class FusionRules(NamedTuple):
    """Rules of fusion, all float32; without a source they were chosen.

    Attributes:
        stable_confidence, far_m, laid_m: of the settings and the sensor; the last two are the largest distances at
            which surfels are fused and added.
    """

    stable_confidence: Any
    far_m: Any
    laid_m: Any
    most_confidence: Any = 100.0  # frames: a surface seen for long can still change
    gone_confidence: Any = 0.4  # a surfel in free space loses half of its confidence per frame, and goes below this
    # Frames over which colour is averaged: lamps and lenses shade a point differently from each viewpoint. Simulator:
    # docs/decisions/dense-alignment.md.
    color_frames: Any = 4.0
    most_readings: Any = 50.0  # that count for a position: it is never better known than poses are
    # Surfels are averaged this much farther than they are added: otherwise only readings of a wall there that err
    # towards the camera would count. Simulator: docs/decisions/dense-alignment.md.
    averaged_sigmas: Any = 6.0
    gate_sigmas: Any = 3.0  # largest distance of consistent readings along the normal, and gate_m for errors of poses
    gate_m: Any = 0.01
    disk_cosine: Any = 0.35  # least cosine that enlarges a disk: one at a grazing angle would be too long
    gap_m: Any = 0.02  # no disk is added this close to a stable surfel's centre
    fine_enough: Any = 1.5  # a disk larger than a reading's by this factor is too coarse to cover it
    free_m: Any = 0.05  # a surfel this far in front of a measurement, plus free_sigmas, is removed
    free_sigmas: Any = 4.0
    drift_m: Any = 0.1  # added to it for surfels outside the active window
    min_normal_dot: Any = np.cos(np.radians(40.0))  # largest angle between consistent normals
    # Surfaces seen at a larger angle are not fused. Simulator: docs/decisions/dense-alignment.md.
    min_cosine: Any = np.cos(np.radians(84.5))
    least_cosine2: Any = 0.2**2  # of a plane's viewing angle, where the depth error is projected on its normal


class Candidates(NamedTuple):
    """Surfels that fit the readings of their pixels.

    Attributes:
        slots, pixel: (entries,); those of page k from entry k·PAGE on. Pixels count row by row.
        rank: (entries,) rank, lower is better.
        counts: (pages, 4) candidates, and dead ones; later, chosen ones, and those that died then.
        chosen: (h·w,) entry of the best one, -1 for none.
    """

    slots: Any
    pixel: Any
    rank: Any
    counts: Any
    chosen: Any


@kernel(error_model="numpy")
def find_candidates(
    begin: Any,
    end: Any,
    view: InView,
    surfels: SurfelArrays,
    seen: FrameReadings,
    camera: Camera,
    rules: FusionRules,
    out: Candidates,
) -> None:
    """Find the surfels of pages `begin` to `end` that agree with the readings of their pixels.

    Surfels in free space lose confidence here, and expired unstable ones die.
    """
    # Read from the tuples once: each access would be reference-counted.
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
    """Compute the pixels `where` a page's surfels lie, -1 outside, depth, and squared distance from the centre."""
    # Read once: the compiler cannot know that writing to buffers does not change them.
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
def _agree(geometry: Any, slot: Any, reading: Any, p: Any, variance: Any, rules: FusionRules) -> Any:
    """Return whether a surfel lies on the plane of pixel p's reading, with a consistent normal."""
    along = _ZERO
    for k in range(3):
        along += reading[p, 4 + k] * (geometry[slot, k] - reading[p, k])
    is_near = abs(along) <= _gate(reading, p, variance, slot, rules)
    return (reading[p, WEIGHT] > 0) & faces(geometry, slot, reading, p, rules) & is_near


@kernel(inline="always", error_model="numpy")
def _is_free(depth_m: Any, p: Any, z: Any, aside_m: Any, noise: Any, rules: FusionRules) -> Any:
    """Return whether all depth around pixel p is clearly behind a depth z; `aside_m` is a further margin."""
    r, c, is_free = p // depth_m.shape[1], p % depth_m.shape[1], True
    sigma = deviation(noise, depth_m[r, c])
    beyond_m = z + rules.free_m + aside_m + rules.free_sigmas * sigma
    for i in range(max(r - 1, 0), min(r + 2, depth_m.shape[0])):
        for j in range(max(c - 1, 0), min(c + 2, depth_m.shape[1])):
            is_free &= depth_m[i, j] > beyond_m
    return is_free


@kernel(error_model="numpy")
def choose(begin: Any, end: Any, width: Any, pixel: Any, rank: Any, counts: Any, best: Any, chosen: Any) -> None:
    """Choose the entry of the best candidate for each pixel of rows `begin` to `end`, -1 for none: (h·w,)."""
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
    begin: Any,
    end: Any,
    found: Candidates,
    surfels: SurfelArrays,
    seen: FrameReadings,
    pitch: Any,
    rules: FusionRules,
    is_new: Any,
) -> None:
    """Mark the pixels of rows `begin` to `end` whose reading no surfel covers: (h, w) of bool.

    Surfels are searched within the radius of a surfel of the reading.
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
    near: Any, found: Candidates, surfels: SurfelArrays, reading: Any, size_m: Any, shape: Any, rules: FusionRules
) -> Any:
    """Return whether a surfel chosen for a pixel nearby covers a reading."""
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
    geometry: Any, slot: Any, variance: Any, reading: Any, p: Any, radius_m: Any, wide_m: Any, rules: FusionRules
) -> Any:
    """Return whether a surfel agrees with a reading near the centre of its disk, so that no other one is needed.

    Near is a pixel's width, and `gap_m` if the surfel is stable and hardly coarser than that of the reading. Otherwise
    each lap of the same place would fill gaps between disks of earlier laps.
    """
    radius = geometry[slot, RADIUS]
    is_settled = (geometry[slot, CONFIDENCE] >= rules.stable_confidence) & (radius <= rules.fine_enough * radius_m)
    near_m = min(max(wide_m, _HALF * radius, rules.gap_m if is_settled else _ZERO), radius)
    along, across2 = apart(geometry, slot, reading, p)
    is_on_it = (across2 <= near_m * near_m) & (abs(along) <= _gate(reading, p, variance, slot, rules))
    return is_on_it & faces(geometry, slot, reading, p, rules)


@kernel(inline="always", error_model="numpy")
def _gate(reading: Any, p: Any, variance: Any, slot: Any, rules: FusionRules) -> Any:
    """Return the largest distance, along the normal, of a reading consistent with a surfel."""
    return rules.gate_sigmas * np.sqrt(reading[p, VARIANCE] + variance[slot]) + rules.gate_m


@kernel(inline="always", error_model="numpy")
def deviation(noise: Any, z: Any) -> Any:
    """Return the standard deviation of a depth z."""
    return noise[CONSTANT] + noise[QUADRATIC] * z * z


@kernel(inline="always", error_model="numpy")
def faces(geometry: Any, slot: Any, others: Any, other: Any, rules: FusionRules) -> Any:
    """Return whether the normals of a surfel and of another surfel or reading are consistent."""
    cosine = _ZERO
    for k in range(4, 7):
        cosine += geometry[slot, k] * others[other, k]
    return cosine >= rules.min_normal_dot


@kernel(inline="always", error_model="numpy")
def apart(geometry: Any, slot: Any, others: Any, other: Any) -> Any:
    """Return the distance of a surfel from another one or a reading along the other's normal, and squared across it."""
    along = distance2 = _ZERO
    for k in range(3):
        off = geometry[slot, k] - others[other, k]
        along += others[other, 4 + k] * off
        distance2 += off * off
    return along, distance2 - along * along


# Fusion: readings of pixels, updates of surfels, and new surfels.
#
# After Keller et al. 2013, "Real-time 3D reconstruction in dynamic scenes using point-based fusion", section 4. Each
# pass visits pages of surfels in view or rows of the image. It reads only what earlier passes wrote, and visits surfels
# in order, so that results do not depend on how pages and rows are split.

_ONE = np.float32(1.0)
_LEAST_VARIANCE = np.float32(1e-8)


class Home(NamedTuple):
    """Cells of pages: number (pages,), position in edges (cells, 3), last time seen (cells,), and the edge."""

    page_cell: Any
    xyz: Any
    seen_s: Any
    block_m: Any


@kernel(error_model="numpy")
def read(
    begin: Any, end: Any, seen: FrameReadings, normal: Any, weight: Any, camera: Camera, rules: FusionRules
) -> None:
    """Compute readings (h·w, READING) of rows `begin` to `end` in the map, and the radius (h·w,) of a surfel of each.

    The depth error is along the ray. It is projected on the normal, bounded for grazed planes. The radius is that of a
    disk that covers a pixel on its plane: z / (f·|cos|), after Whelan et al. 2015, III.A.

    Args:
        seen: to be filled in.
        weight: (h, w) of a reading by its position in the image.
    """
    # Read from the tuples once: each access would be reference-counted.
    depth_m, reading, radius, T = seen.depth_m, seen.reading, seen.radius, camera.T
    ray_x, ray_y, pitch, noise = camera.ray_x, camera.ray_y, camera.pitch, camera.noise
    far_m = min(noise[FAR], rules.laid_m + rules.averaged_sigmas * deviation(noise, rules.laid_m))
    for r in range(begin, end):
        y = ray_y[r]
        for c in range(depth_m.shape[1]):
            p, z, x = r * depth_m.shape[1] + c, depth_m[r, c], ray_x[c]
            reading[p, WEIGHT] = _ZERO
            nx, ny, nz = normal[r, c, 0], normal[r, c, 1], normal[r, c, 2]
            along, ray2 = -(nx * x + ny * y + nz), x * x + y * y + _ONE
            cosine = along / np.sqrt(ray2)
            if not (noise[NEAR] <= z <= far_m and cosine >= rules.min_cosine):
                continue
            for k in range(3):
                reading[p, k] = (T[k, 0] * x + T[k, 1] * y + T[k, 2]) * z + T[k, 3]
                reading[p, 4 + k] = T[k, 0] * nx + T[k, 1] * ny + T[k, 2] * nz
            sigma = deviation(noise, z)
            reading[p, VARIANCE] = max(sigma * sigma * max(along * along, rules.least_cosine2), _LEAST_VARIANCE)
            reading[p, WEIGHT] = weight[r, c]
            radius[p] = z * pitch / max(cosine, rules.disk_cosine)


@kernel(inline="always", error_model="numpy")
def _paint(look: Any, slot: Any, share: Any, color: Any, grey: Any, p: Any) -> None:
    """Average a share of a pixel's colour and grey into a surfel's, or copy it if that has none."""
    if len(color) > 0 and color[p, 0] >= 0:
        for i in range(3):
            before = look[slot, i]
            look[slot, i] = color[p, i] if before < 0 else before + share * (color[p, i] - before)
    if grey[p] >= 0:
        before = look[slot, 3]
        look[slot, 3] = grey[p] if before < 0 else before + share * (grey[p] - before)


@kernel(error_model="numpy")
def update(
    begin: Any,
    end: Any,
    found: Candidates,
    surfels: SurfelArrays,
    home: Home,
    camera: Camera,
    seen: FrameReadings,
    rules: FusionRules,
) -> None:
    """Average readings into the chosen candidates of pages `begin` to `end`.

    A surfel moves along the reading's normal only: across it, it would be drawn to the centres of pixels. Both are
    weighted by 1/variance. Surfels are visited in their order in memory.

    Confidence counts frames, not weights as in Keller et al.: surfels at the edge would need four times as many.
    """
    slots, pixel, chosen, counts = found.slots, found.pixel, found.chosen, found.counts
    geometry, look, seen_s, variance = surfels.geometry, surfels.look, surfels.seen_s, surfels.variance
    page_cell, cell_xyz, cell_seen_s, block_m = home.page_cell, home.xyz, home.seen_s, home.block_m
    reading, radius, color, grey = seen.reading, seen.radius, seen.color, seen.grey
    T, noise, stamp_s, frames = camera.T, camera.noise, seen.stamp_s, seen.frames
    for k in range(begin, end):
        matched = died = 0
        for entry in range(k * PAGE, k * PAGE + counts[k, 0]):
            p, slot = pixel[entry], slots[entry]
            if chosen[p] != entry:
                continue
            matched += 1
            confidence = geometry[slot, CONFIDENCE]
            share = _learn(geometry, slot, variance, reading, p, T, noise, rules.most_readings)
            geometry[slot, RADIUS] += share * min(radius[p] - geometry[slot, RADIUS], _ZERO)
            _paint(look, slot, _ONE / (min(confidence, rules.color_frames) + _ONE), color, grey, p)
            seen_s[slot, 1] = stamp_s
            cell = page_cell[slot // PAGE]
            cell_seen_s[cell] = stamp_s
            has_left = _has_left(geometry, slot, cell_xyz, cell, block_m)
            geometry[slot, CONFIDENCE] = _ZERO if has_left else min(confidence + frames, rules.most_confidence)
            died += has_left
        counts[k, 2], counts[k, 3] = matched, died


@kernel(inline="always", error_model="numpy")
def _learn(geometry: Any, slot: Any, variance: Any, reading: Any, p: Any, T: Any, noise: Any, most: Any) -> Any:
    """Move and turn a surfel by the reading of pixel p; return the share of the reading.

    The reading has the weight of the surfel's depth: by its own depth, readings that err towards the camera would weigh
    more. At most `most` readings count.
    """
    there = here = _ZERO
    for i in range(3):
        there += T[i, 2] * (geometry[slot, i] - T[i, 3])
        here += T[i, 2] * (reading[p, i] - T[i, 3])
    usual = deviation(noise, there) / deviation(noise, here)
    spread = usual * usual * reading[p, VARIANCE]
    before = max(variance[slot], spread / most)
    share = before / (before + spread / reading[p, WEIGHT])
    variance[slot] = before * (_ONE - share)
    off = length2 = _ZERO
    for i in range(3):
        off += share * reading[p, 4 + i] * (reading[p, i] - geometry[slot, i])
    for i in range(3):
        geometry[slot, i] += off * reading[p, 4 + i]
        geometry[slot, 4 + i] += share * (reading[p, 4 + i] - geometry[slot, 4 + i])
        length2 += geometry[slot, 4 + i] * geometry[slot, 4 + i]
    scale = _ONE / np.sqrt(length2)
    for i in range(3):
        geometry[slot, 4 + i] *= scale
    return share


@kernel(inline="always")
def _has_left(geometry: Any, slot: Any, cell_xyz: Any, cell: Any, block_m: Any) -> Any:
    """Return whether a surfel is too far from its block to be found there."""
    has_left, reach = False, 0.5 * block_m + STRAY_M
    for k in range(3):
        has_left |= abs(geometry[slot, k] - (cell_xyz[cell, k] + 0.5) * block_m) > reach
    return has_left


@kernel(error_model="numpy")
def merge(
    begin: Any, end: Any, width: Any, found: Candidates, surfels: SurfelArrays, rules: FusionRules, merged: Any
) -> None:
    """Merge duplicates, which are other candidates of a pixel, into the chosen surfels of rows `begin` to `end`.

    `merged`: (h,) their number; that of all these rows is at the first.
    """
    slots, pixel, counts, chosen = found.slots, found.pixel, found.counts, found.chosen
    geometry, seen_s, variance = surfels.geometry, surfels.seen_s, surfels.variance
    merged[begin:end] = 0
    low, high = begin * width, end * width
    for k in range(len(counts)):
        for entry in range(k * PAGE, k * PAGE + counts[k, 0]):
            p = pixel[entry]
            if not low <= p < high or chosen[p] == entry:
                continue
            slot, kept = slots[entry], slots[chosen[p]]
            confidence = geometry[kept, CONFIDENCE]
            if confidence > 0 and _are_alike(geometry, slot, kept, variance, rules):
                geometry[kept, CONFIDENCE] = min(confidence + geometry[slot, CONFIDENCE], rules.most_confidence)
                geometry[kept, RADIUS] = min(geometry[kept, RADIUS], geometry[slot, RADIUS])
                seen_s[kept, 0] = min(seen_s[kept, 0], seen_s[slot, 0])
                seen_s[kept, 1] = max(seen_s[kept, 1], seen_s[slot, 1])
                geometry[slot, CONFIDENCE] = _ZERO
                merged[begin] += 1


@kernel(inline="always", error_model="numpy")
def _are_alike(geometry: Any, slot: Any, kept: Any, variance: Any, rules: FusionRules) -> Any:
    """Return whether two surfels are duplicates: on one surface, closer than half the smaller radius across it."""
    along, across2 = apart(geometry, slot, geometry, kept)
    reach = _HALF * min(geometry[slot, RADIUS], geometry[kept, RADIUS])
    gate = rules.gate_sigmas * np.sqrt(variance[slot] + variance[kept]) + rules.gate_m
    is_near = (across2 <= reach * reach) & (abs(along) <= gate)
    return is_near & faces(geometry, slot, geometry, kept, rules)


@kernel(error_model="numpy")
def make_new(is_new: Any, seen: FrameReadings, new: SurfelArrays) -> None:
    """Make surfels of the marked pixels (h·w,), row by row; the caller sets their keyframe."""
    reading, radius, color, grey = seen.reading, seen.radius, seen.color, seen.grey
    geometry, look, seen_s, variance, i = new.geometry, new.look, new.seen_s, new.variance, 0
    for p in range(len(is_new)):
        if not is_new[p]:
            continue
        for k in range(READING):
            geometry[i, k] = reading[p, k]
        geometry[i, RADIUS], geometry[i, CONFIDENCE] = radius[p], seen.frames
        for k in range(3):
            look[i, k] = color[p, k] if len(color) > 0 else -_ONE
        look[i, 3] = grey[p]
        seen_s[i, 0] = seen_s[i, 1] = seen.stamp_s
        variance[i] = reading[p, VARIANCE] / reading[p, WEIGHT]
        i += 1


@kernel
def move(
    begin: Any,
    end: Any,
    T_new_old: Any,
    has_moved: Any,
    surfels: SurfelArrays,
    pages: Pages,
    cells: SurfelCells,
    left: Any,
) -> None:
    """Move the surfels of pages `begin` to `end` with their keyframes, and mark in `left` those that left their cell.

    Args:
        T_new_old: (K + 1, 4, 4) by keyframe; the last is for surfels without one of these.
        has_moved: (K + 1,).
        left: (slots,) bool, all False.
    """
    # Read from the tuples once: each access would be reference-counted.
    geometry, keyframe, block_m, cell_xyz = surfels.geometry, surfels.keyframe, cells.block_m, cells.xyz
    fill, page_cell, known = pages.fill, pages.cell, len(has_moved) - 1
    for page in range(begin, end):
        cell = page_cell[page]
        for slot in range(page * PAGE, page * PAGE + fill[page]):
            k = keyframe[slot] if 0 <= keyframe[slot] < known else known
            if not has_moved[k] or geometry[slot, CONFIDENCE] <= 0:
                continue
            x, y, z = geometry[slot, 0], geometry[slot, 1], geometry[slot, 2]
            a, b, c = geometry[slot, 4], geometry[slot, 5], geometry[slot, 6]
            for i in range(3):
                r, s, t = T_new_old[k, i, 0], T_new_old[k, i, 1], T_new_old[k, i, 2]
                geometry[slot, i] = T_new_old[k, i, 3] + r * x + s * y + t * z
                geometry[slot, 4 + i] = r * a + s * b + t * c
            # With a margin: a floor between two blocks would change between them at each loop.
            left[slot] = _has_left(geometry, slot, cell_xyz, cell, block_m)
