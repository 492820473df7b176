"""Compiled inner loops of fusion: what pixels say, what that teaches the surfels they saw, and which begin.

After Keller et al. 2013, "Real-time 3D reconstruction in dynamic scenes using point-based fusion", section 4. Every
pass, and those of matching, goes either over pages of surfels in view or over rows of the image, each by one thread,
reads only what earlier passes wrote, and takes surfels in their order, so that nothing depends on how many threads
share the work. Arrays are indexed and numbers kept as in matching.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.mapping._block_kernels import CONFIDENCE, PAGE, RADIUS, STRAY_M, SurfelArrays
from wheelsight.mapping._match_kernels import (
    FAR,
    NEAR,
    READING,
    VARIANCE,
    WEIGHT,
    Camera,
    Candidates,
    Rules,
    Seen,
    apart,
    deviation,
    faces,
)

_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
_LEAST_VARIANCE = np.float32(1e-8)


class Home(NamedTuple):
    """The cells that pages belong to: (pages,) which, (cells, 3) where in edges, (cells,) seen last, and their edge."""

    page_cell: Any
    xyz: Any
    seen_s: Any
    block_m: Any


@kernel(error_model="numpy")
def read(begin: Any, end: Any, seen: Seen, normal: Any, weight: Any, camera: Camera, rules: Rules) -> None:
    """Readings (h·w, READING) of rows `begin` to `end` in the map, and the radius (h·w,) a surfel would have.

    Depth errs along the ray; what of it counts is its share along the normal, bounded where planes are grazed. The
    radius is that of a disk that covers a pixel on its plane: z / (f·|cos|), after Whelan et al. 2015, III.A.

    Args:
        seen: to be filled in.
        weight: (h, w) of a reading by its place in the image.
    """
    # Taken out of their tuples once: each time would be counted.
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
    """Average a share of what a pixel saw of colour and grey into a surfel's, or all of it where that has none."""
    if len(color) > 0 and color[p, 0] >= 0:
        for i in range(3):
            before = look[slot, i]
            look[slot, i] = color[p, i] if before < 0 else before + share * (color[p, i] - before)
    if grey[p] >= 0:
        before = look[slot, 3]
        look[slot, 3] = grey[p] if before < 0 else before + share * (grey[p] - before)


@kernel(error_model="numpy")
def update(
    begin: Any, end: Any, found: Candidates, surfels: SurfelArrays, home: Home, camera: Camera, seen: Seen, rules: Rules
) -> None:
    """Average into the chosen among the candidates of pages `begin` to `end` what their pixels saw.

    A surfel moves along the reading's normal only: across it, it would be drawn to pixels' centres. Both are weighted
    by what is known of them, 1/variance. Surfels are taken in their order in memory, for pixels are fewer.

    Confidence counts frames, wherever in the image they saw a surfel: by weights, as Keller et al. add them up, what
    passes along the rim would need four times as many.
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
    """Move and turn a surfel by the reading of pixel p; the share by which.

    The reading weighs as is usual at the surfel's depth: by its own, what errs towards the camera would weigh more. No
    more than the `most` readings count.
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
    """Whether a surfel strayed too far from its block to be found there."""
    has_left, reach = False, 0.5 * block_m + STRAY_M
    for k in range(3):
        has_left |= abs(geometry[slot, k] - (cell_xyz[cell, k] + 0.5) * block_m) > reach
    return has_left


@kernel(error_model="numpy")
def merge(
    begin: Any, end: Any, width: Any, found: Candidates, surfels: SurfelArrays, rules: Rules, merged: Any
) -> None:
    """Merge into each chosen surfel of rows `begin` to `end` the candidates of its pixel that are its like.

    `merged`: (h,) how many; of all these rows at the first.
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
def _are_alike(geometry: Any, slot: Any, kept: Any, variance: Any, rules: Rules) -> Any:
    """Whether two surfels stand for one spot of one surface: closer than half the smaller one's radius across it."""
    along, across2 = apart(geometry, slot, geometry, kept)
    reach = _HALF * min(geometry[slot, RADIUS], geometry[kept, RADIUS])
    gate = rules.gate_sigmas * np.sqrt(variance[slot] + variance[kept]) + rules.gate_m
    is_near = (across2 <= reach * reach) & (abs(along) <= gate)
    return is_near & faces(geometry, slot, geometry, kept, rules)


@kernel(error_model="numpy")
def make_new(is_new: Any, seen: Seen, new: SurfelArrays) -> None:
    """Surfels of the pixels (h·w,) marked, row by row; who calls knows their keyframe."""
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
