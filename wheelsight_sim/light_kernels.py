"""Compiled lighting: what lamps, windows and all round about send to a point, and what shadows hide."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import BoolArray, Float32Array, FloatArray, Int32Array
from wheelsight_sim.texture_kernels import cover, hash_unit, stripes

_SPILL = 0.25
_SEAM_M = 0.10
_CORNER_M = 0.3
_STRIDE_PX = 4


class View(NamedTuple):
    """What rays from the camera's pixels hit, one through the centre of each, row by row at the time of its reading.

    Attributes:
        depth_m: (H, W) true depth along the camera's z axis; 0 where nothing was hit.
        geom: (H, W) index of the MJCF geom that was hit, -1 where none was.
        normal_world: (H, W, 3) outward unit normals in the world; 0 where nothing was hit.
        T_world_camera: (H, 4, 4) the camera's pose as each row was read.
        rays: (H, W, 3) what a depth of 1 m adds to the camera's origin, in the camera frame (z = 1).
    """

    depth_m: Float32Array
    geom: Int32Array
    normal_world: Float32Array
    T_world_camera: FloatArray
    rays: FloatArray


class Lighting(NamedTuple):
    """The light of a building.

    Attributes:
        tints: (3, 3) rows: light from all round, of lamps, of windows; columns: red, green, blue.
        sun: (3,) unit vector towards the windows.
        grid: (6,) x and y of the tables' first cell, size of a cell in `flux` and in `clearance`, distance between
            the layers of `flux`, height of the ceiling, metres.
        flux: (Z, Y, X, 4) vector towards the lamps, as long as they are bright, and the sum of their brightness.
        clearance: (2, Y, X) metres to what stands on the floor, and to what stands there and is tall.
        lattice: (5,) lamps in ceilings of panels: pitch, half lengths in x and y, glow, seed of their ages.
        lamps: (L, 6) all lamps: position, power, half lengths in x and y.
    """

    tints: FloatArray
    sun: FloatArray
    grid: FloatArray
    flux: Float32Array
    clearance: Float32Array
    lattice: FloatArray
    lamps: FloatArray


@kernel(error_model="numpy")
def lamp_power(i: int, j: int, seed: int) -> Any:
    """Relative brightness of a lamp of the ceiling's lattice: they have aged, and some are switched off."""
    draw = hash_unit(i, j, seed)
    return 0.2 if draw < 0.12 else 0.8 + 0.3 * draw


@kernel(error_model="numpy")
def lamp_at(x: float, y: float, wx: float, wy: float, lattice: Any) -> Any:
    """Mean glow of a footprint on a ceiling of panels: `lattice` is pitch, half lengths in x, y, glow, seed."""
    pitch, half_x, half_y, seed = lattice[0], lattice[1], lattice[2], int(lattice[4])
    i, j = math.floor(x / pitch), math.floor(y / pitch)
    a, b = x - (i + 0.5) * pitch, y - (j + 0.5) * pitch
    share = cover(a, -half_x, half_x, wx) * cover(b, -half_y, half_y, wy)
    if share <= 0:
        return 0.0
    tubes = 0.75 + 0.5 * stripes(a - 0.25 * half_x, 0.5 * half_x, 0.25 * half_x, wx)
    return share * lattice[3] * lamp_power(i, j, seed) * tubes


@kernel(error_model="numpy")
def nine(R: Any) -> Any:
    """A matrix (3, 3) as nine numbers, row by row, which stay in registers."""
    return R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2]


@kernel(error_model="numpy")
def turned(R: Any, v: Any) -> Any:
    """R v of a matrix as nine numbers and a vector as three."""
    return (
        R[0] * v[0] + R[1] * v[1] + R[2] * v[2],
        R[3] * v[0] + R[4] * v[1] + R[5] * v[2],
        R[6] * v[0] + R[7] * v[1] + R[8] * v[2],
    )


@kernel(error_model="numpy")
def point(v: int, u: int, R: Any, view: View) -> Any:
    """What a pixel shows in the world, as three numbers; R is its row's orientation as nine."""
    z, ray = float(view.depth_m[v, u]), turned(R, three(view.rays, v, u))
    T = view.T_world_camera
    return T[v, 0, 3] + z * ray[0], T[v, 1, 3] + z * ray[1], T[v, 2, 3] + z * ray[2]


@kernel(error_model="numpy")
def light_row(v: int, view: View, light: Lighting, out: Any) -> None:
    """Irradiance over π into row v of `out` (H, W, 3); `view` and `light` as for `paint_rows`.

    Light changes slowly: along a flat face it is computed for each fourth pixel, and between them interpolated.
    """
    geom, normal_world = view.geom, view.normal_world
    tints, sun, grid, flux, clearance, _, _ = light
    width = geom.shape[1]
    R = nine(view.T_world_camera[v])
    last, is_flat = -1, False
    for u in range(width):
        is_flat = _is_flat(v, u, geom, normal_world) if u % _STRIDE_PX == 1 else is_flat
        if geom[v, u] < 0 or (is_flat and u % _STRIDE_PX and u != width - 1):
            continue
        n = three(normal_world, v, u)
        shade, lamp, window = light_at(point(v, u, R, view), n, sun, grid, flux, clearance)
        for c in range(3):
            out[v, u, c] = tinted(c, shade, lamp, window, tints)
        # What was left out since the last one lies between the two.
        for between in range(last + 1, u):
            k = (between - last) / (u - last)
            if last >= 0 and geom[v, between] >= 0:
                for c in range(3):
                    out[v, between, c] = (1 - k) * out[v, last, c] + k * out[v, u, c]
        last = u


@kernel(error_model="numpy")
def tinted(c: int, shade: float, lamp: float, window: float, tints: Any) -> Any:
    """What comes in one of three colours of the light that `light_at` shows."""
    return shade * (tints[0, c] + tints[1, c] * lamp + tints[2, c] * window)


@kernel(error_model="numpy")
def _is_flat(v: int, u: int, geom: Any, normal_world: Any) -> Any:
    """Whether a pixel and the strided ones on both sides of it are all on the same flat face."""
    a = u - u % _STRIDE_PX
    b = min(a + _STRIDE_PX, geom.shape[1] - 1)
    for other in range(a, b + 1):
        if geom[v, other] != geom[v, u]:
            return False
    bend = abs(normal_world[v, a, 0] - normal_world[v, b, 0]) + abs(normal_world[v, a, 1] - normal_world[v, b, 1])
    return bend + abs(normal_world[v, a, 2] - normal_world[v, b, 2]) < 1e-3


@kernel(error_model="numpy", inline="always")
def light_at(p: Any, n: Any, sun: Any, grid: Any, flux: Any, clearance: Any) -> Any:
    """Shade 0 to 1 of the light from all round, light of lamps, and of windows, at p with normal n (Lambert)."""
    a, b = (p[0] - grid[0]) / grid[2], (p[1] - grid[1]) / grid[2]
    c = p[2] / grid[4]
    a, b, c = _inside(a, flux.shape[2]), _inside(b, flux.shape[1]), _inside(c, flux.shape[0])
    # Without sign: numba looks whether an index counts from the end, which would take a third of the time.
    i, j, k = np.uintp(a), np.uintp(b), np.uintp(c)
    a, b, c = a - i, b - j, c - k
    facing, spill = 0.0, 0.0
    for layer in range(np.uintp(2)):
        for row in range(np.uintp(2)):
            share = (c if layer else 1 - c) * (b if row else 1 - b)
            for column in range(np.uintp(2)):
                weight = share * (a if column else 1 - a)
                x, y, z = k + layer, j + row, i + column
                facing += weight * (n[0] * flux[x, y, z, 0] + n[1] * flux[x, y, z, 1] + n[2] * flux[x, y, z, 2])
                spill += weight * flux[x, y, z, 3]
    window = max(0.0, n[0] * sun[0] + n[1] * sun[1] + n[2] * sun[2])
    return _shade(p, n, grid, clearance), max(facing, 0.0) + _SPILL * spill, window


@kernel(error_model="numpy")
def _inside(index: float, count: int) -> Any:
    return min(max(index, 0.0), count - 1.001)


@kernel(error_model="numpy")
def _shade(p: Any, n: Any, grid: Any, clearance: Any) -> Any:
    """How open the surroundings are: little light gets to where walls, floor, ceiling and furniture meet."""
    if abs(n[2]) > 0.5 and (n[2] < 0 or p[2] > 0.05):
        return 1.0 if n[2] > 0 else 0.85
    tall = 0 if n[2] > 0.5 else 1
    reach = tall * _CORNER_M
    a, b = (p[0] + reach * n[0] - grid[0]) / grid[3], (p[1] + reach * n[1] - grid[1]) / grid[3]
    a, b = _inside(a, clearance.shape[2]), _inside(b, clearance.shape[1])
    i, j = int(a), int(b)
    a, b = a - i, b - j
    near = (1 - b) * ((1 - a) * clearance[tall, j, i] + a * clearance[tall, j, i + 1])
    near += b * ((1 - a) * clearance[tall, j + 1, i] + a * clearance[tall, j + 1, i + 1])
    if not tall:
        return 1 - 0.4 / (1 + (near / _SEAM_M) ** 2)
    shade = 1 - 0.3 * max(0.0, 1 - near / _CORNER_M) - 0.3 / (1 + (max(p[2], 0.0) / _SEAM_M) ** 2)
    return shade - 0.2 / (1 + (max(grid[5] - p[2], 0.0) / _SEAM_M) ** 2)


# A lamp is a level rectangle, and what stands in its light an upright box. From a point, the rays to all places of
# the lamp make a pencil. A box hides a share of it: as much as its slab across each axis covers where the pencil is
# within the box's heights, and no more than it covers in plan. Edges of boxes that lie along the lamp's are exact so,
# with their penumbra. A round thing is taken for the box around it that faces the lamp.


# Between two pixels whose shares differ by less, those of the pixels between are interpolated.
_ALIKE = 0.02
_LEAST_RISE_M = 0.05
_NEAREST_LAMP_M = 0.4
_TO_CEILING_M = 0.12  # below a lamp's height; what reaches higher is a wall
_ABOVE_M = 1e-3  # from which a box reaches over a point
_THIN = 1e-9
# Light that no lamp nearby sends: a sixth of what one in the ceiling sends to the floor right below. Chosen, so that
# what hardly faces any lamp has no shadow.
_ELSEWHERE = 0.02


class Lamps(NamedTuple):
    """All lamps, and which are the brightest at each place.

    Attributes:
        lamps: (L, 6) position, power, half lengths in x and y.
        grid: (3,) x and y of the first cell's corner, size of a cell, metres.
        brightest: (Y, X, K) of each cell, -1 for none.
    """

    lamps: FloatArray
    grid: FloatArray
    brightest: Int32Array


class Blockers(NamedTuple):
    """What can stand in the light.

    Attributes:
        boxes: (B, 10) x and y of the middle, lowest and highest z, cosine and sine of the yaw, half lengths; which geom
            it is, -1 for none that is seen; 1 if it is round, as one that faces whatever lamp it hides.
        moving: (M,) those that can be anywhere.
        starts: (Y · X · K + 1,) where the list of each cell and lamp begins in `listed`.
        listed: (N,) those that stand still and may hide a lamp from a cell.
    """

    boxes: FloatArray
    moving: Int32Array
    starts: Int32Array
    listed: Int32Array


class Shadowing(NamedTuple):
    """All that decides of shadows; `glows` (G,) shows geoms that have light of their own."""

    lamps: Lamps
    blockers: Blockers
    glows: BoolArray
    strength: float


@kernel(error_model="numpy")
def keep(view: View, shadowing: Shadowing, out: Any) -> None:
    """Put into `out` (H, W) the share of each pixel's light that is left where lamps are hidden from it.

    Along a flat face it is found for each fourth pixel, and for those between where two of them differ.
    """
    seen, normal_world = view.geom, view.normal_world
    lamps, blockers, glows, strength = shadowing
    every, grid, brightest = lamps
    boxes, moving, starts, listed = blockers
    height, width = seen.shape
    for v in range(height):
        R = nine(view.T_world_camera[v])
        last, is_flat = 0, False
        for u in range(width):
            is_flat = _is_flat(v, u, seen, normal_world) if u % _STRIDE_PX == 1 else is_flat
            if is_flat and u % _STRIDE_PX and u != width - 1:
                continue
            # This pixel, then those between it and the last one.
            for at in range(u, last, -1) if u else range(1):
                k = (at - last) / max(u - last, 1)
                if at != u and abs(out[v, u] - out[v, last]) < _ALIKE:
                    out[v, at] = (1 - k) * out[v, last] + k * out[v, u]
                elif seen[v, at] < 0 or glows[seen[v, at]]:
                    out[v, at] = 1.0
                else:
                    p, n = point(v, at, R, view), three(normal_world, v, at)
                    lost = hidden_at((p, n, seen[v, at]), every, grid, brightest, boxes, moving, starts, listed)
                    out[v, at] = 1 - strength * lost
            last = u


@kernel(error_model="numpy")
def three(vectors: Any, v: int, u: int) -> Any:
    """A pixel's normal or ray as three numbers."""
    return float(vectors[v, u, 0]), float(vectors[v, u, 1]), float(vectors[v, u, 2])


# Rows of arrays are taken out as plain numbers, and arrays handed over one by one: else numba counts references to them
# for each pixel and box, atomically, which took more time than what is computed.
@kernel(error_model="numpy")
def eight(of: Any, i: int) -> Any:
    """A row of `Blockers.boxes`."""
    return of[i, 0], of[i, 1], of[i, 2], of[i, 3], of[i, 4], of[i, 5], of[i, 6], of[i, 7]


@kernel(error_model="numpy", inline="always")
def hidden_at(
    place: Any, every: Any, grid: Any, brightest: Any, boxes: Any, moving: Any, starts: Any, listed: Any
) -> Any:
    """Share of the brightest lamps' light that does not reach a place: a point, its normal and its geom."""
    p, n, own = place
    rows, columns, count = brightest.shape
    column = min(max(int((p[0] - grid[0]) / grid[2]), 0), columns - 1)
    row = min(max(int((p[1] - grid[1]) / grid[2]), 0), rows - 1)
    # The least bright one does not count, others by how much they are brighter: no seam where cells take other lamps.
    last, least = brightest[row, column, count - 1], 0.0
    if last >= 0:
        least = every[last, 3] * light_of(_towards(p, every, last), (0.0, 0.0, 1.0))
    lost, whole = 0.0, _ELSEWHERE
    for k in range(count):
        number = brightest[row, column, k]
        if number < 0:
            break
        d, power = _towards(p, every, number), every[number, 3]
        light = power * light_of(d, n)
        if light > 0 and last >= 0:
            light *= max(1 - least / (power * light_of(d, (0.0, 0.0, 1.0))), 0.0)
        if light > 0:
            entry, half = (row * columns + column) * count + k, (every[number, 4], every[number, 5])
            walled, hidden = _hidden((p, d, half), own, entry, boxes, moving, starts, listed)
            lost, whole = lost + light * (1 - walled) * hidden, whole + light * (1 - walled)
    return lost / whole


@kernel(error_model="numpy")
def _towards(p: Any, lamps: Any, i: int) -> Any:
    return lamps[i, 0] - p[0], lamps[i, 1] - p[1], lamps[i, 2] - p[2]


@kernel(error_model="numpy")
def light_of(d: Any, n: Any) -> Any:
    """Light on a surface with normal n of a lamp of power 1 that is d away, as `Lighting` has it."""
    square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    facing = n[0] * d[0] + n[1] * d[1] + n[2] * d[2]
    if d[2] < _LEAST_RISE_M or facing <= 0:
        return 0.0
    down = max(d[2], _NEAREST_LAMP_M)
    near = 0.3 + square
    return facing * down / (near * np.sqrt(near * square))


@kernel(error_model="numpy", inline="always")
def _hidden(way: Any, own: int, entry: int, boxes: Any, moving: Any, starts: Any, listed: Any) -> Any:
    """Shares of a lamp that walls hide, and all else, on a way: a point, the vector to the lamp, its half lengths."""
    p, d, half = way
    walled, hidden = 0.0, 0.0
    level = np.sqrt(d[0] * d[0] + d[1] * d[1])
    for i in range(starts[entry], starts[entry + 1]):
        b = listed[i]
        if boxes[b, 8] == own:
            continue
        box = eight(boxes, b)
        share = covered(p, d, level, half, box, boxes[b, 9] > 0)
        if box[3] > p[2] + d[2] - _TO_CEILING_M:
            walled += share
            if walled >= 1:
                break
        else:
            hidden += share
    for i in range(len(moving) if walled < 1 else 0):
        b = moving[i]
        if boxes[b, 8] != own:
            hidden += covered(p, d, level, half, eight(boxes, b), boxes[b, 9] > 0)
    return min(walled, 1.0), min(hidden, 1.0)


@kernel(error_model="numpy")
def covered(p: Any, d: Any, level: float, half: Any, box: Any, is_round: bool) -> Any:
    """Share of a lamp, `half` (2) its half lengths and d away from p, `level` in plan, that a box hides from there."""
    if box[3] < p[2] + _ABOVE_M or box[2] >= p[2] + d[2]:
        return 0.0
    c, s = box[4], box[5]
    if is_round:
        c, s = (d[0] / level, d[1] / level) if level > _THIN else (1.0, 0.0)
    x, y = p[0] - box[0], p[1] - box[1]
    x, y = c * x + s * y, c * y - s * x
    dx, dy = c * d[0] + s * d[1], c * d[1] - s * d[0]
    # Most boxes stand beside the pencil: this needs neither a root nor a quotient.
    if abs(y * dx - x * dy) > box[6] * abs(dy) + box[7] * abs(dx) + (half[0] + half[1]) * level:
        return 0.0
    enters, leaves = max((box[2] - p[2]) / d[2], 0.0), min((box[3] - p[2]) / d[2], 1.0)
    if enters >= leaves:
        return 0.0
    wide_x, wide_y = np.sqrt((half[0] * c) ** 2 + (half[1] * s) ** 2), np.sqrt((half[0] * s) ** 2 + (half[1] * c) ** 2)
    across_x = _across(x, dx, wide_x, box[6], enters, leaves)
    if across_x <= 0:
        return 0.0
    across = across_x * _across(y, dy, wide_y, box[7], enters, leaves)
    if across <= 0:
        return 0.0
    return min(across, _in_plan(x, y, dx, dy, wide_x, wide_y, box, leaves))


@kernel(error_model="numpy")
def _across(o: float, e: float, wide: float, half: float, enters: float, leaves: float) -> Any:
    """Share of a pencil that is in a slab of half a width `half` somewhere between two of its lengths.

    Its middle begins at o and goes on by e; at its end it reaches `wide` to both sides.
    """
    if e < 0:
        o, e = -o, -e
    first, last = o + enters * e, o + leaves * e
    if first - wide * enters >= half or last + wide * leaves <= -half:
        return 0.0
    before = 0.5 + 0.5 * (half - first) / max(wide * enters, _THIN)
    behind = 0.5 + 0.5 * (half + last) / max(wide * leaves, _THIN)
    return max(min(before, 1.0) + min(behind, 1.0) - 1.0, 0.0)


@kernel(error_model="numpy")
def _in_plan(x: float, y: float, dx: float, dy: float, wide_x: float, wide_y: float, box: Any, leaves: float) -> Any:
    """Share of a pencil that a box's outline covers, seen from above."""
    level = np.sqrt(dx * dx + dy * dy)
    if level < _THIN:
        return 1.0
    a, b = dx / level, dy / level
    way = min(max(-(x * a + y * b) / level, 0.0), leaves)
    wide = way * np.sqrt((wide_x * b) ** 2 + (wide_y * a) ** 2)
    middle, reach = y * a - x * b, box[6] * abs(b) + box[7] * abs(a)
    if wide < _THIN:
        return 1.0 if abs(middle) < reach else 0.0
    share = (min(middle + wide, reach) - max(middle - wide, -reach)) / (2 * wide)
    return min(max(share, 0.0), 1.0)


@kernel
def brightest_lamps(lamps: FloatArray, grid: FloatArray, reach_m: float, out: Any) -> None:
    """Put the K brightest lamps on each cell's floor into `out` (Y, X, K), -1 where there are fewer within reach."""
    rows, columns, count = out.shape
    light = np.empty(count)
    for row in range(rows):
        for column in range(columns):
            x, y = grid[0] + (column + 0.5) * grid[2], grid[1] + (row + 0.5) * grid[2]
            light[:], out[row, column, :] = 0.0, -1
            for lamp in range(len(lamps)):
                d = (lamps[lamp, 0] - x, lamps[lamp, 1] - y, lamps[lamp, 2])
                if d[0] * d[0] + d[1] * d[1] > reach_m * reach_m:
                    continue
                new, number = lamps[lamp, 3] * light_of(d, (0.0, 0.0, 1.0)), lamp
                for k in range(count):
                    if new > light[k]:
                        light[k], new = new, light[k]
                        out[row, column, k], number = number, out[row, column, k]


@kernel
def drop_hidden(lamps: Lamps, blockers: Blockers, out: Any) -> None:
    """Put those of a cell's lamps into `out` (Y, X, K) that some place in the cell sees a part of; -1 for the rest.

    Of nine places over the cell, at two heights each, none sees a lamp in another room.
    """
    rows, columns, count = lamps.brightest.shape
    boxes, moving, starts, listed = blockers
    for row in range(rows):
        for column in range(columns):
            kept = 0
            out[row, column, :] = -1
            for k in range(count):
                lamp = lamps.brightest[row, column, k]
                if lamp < 0 or kept == out.shape[2]:
                    break
                entry, half = (row * columns + column) * count + k, (lamps.lamps[lamp, 4], lamps.lamps[lamp, 5])
                for i in range(18):
                    x = lamps.grid[0] + (column + 0.5 * (i % 3)) * lamps.grid[2]
                    y = lamps.grid[1] + (row + 0.5 * (i // 3 % 3)) * lamps.grid[2]
                    p = (x, y, 0.05 + 1.5 * (i // 9))
                    d = _towards(p, lamps.lamps, lamp)
                    if d[2] <= _LEAST_RISE_M:
                        continue
                    if _hidden((p, d, half), -1, entry, boxes, moving, starts, listed)[0] < 1:
                        out[row, column, kept] = lamp
                        kept += 1
                        break


@kernel
def list_blockers(lamps: Lamps, boxes: FloatArray, still: Int32Array, starts: Any, listed: Any) -> int:
    """Fill `starts` and, as far as it is long enough, `listed` of `Blockers`; returns how long it must be.

    Listed is what comes near to a line from the cell's middle to the lamp's, as near as both are large.
    """
    rows, columns, count = lamps.brightest.shape
    size, found = lamps.grid[2], 0
    for entry in range(rows * columns * count):
        starts[entry] = found
        row, column = entry // count // columns, entry // count % columns
        lamp = lamps.brightest[row, column, entry % count]
        if lamp < 0:
            continue
        x, y = lamps.grid[0] + (column + 0.5) * size, lamps.grid[1] + (row + 0.5) * size
        place = lamps.lamps[lamp]
        wide = max(0.7072 * size, np.sqrt(place[4] ** 2 + place[5] ** 2))
        for b in still:
            if boxes[b, 2] < place[2] and _is_near(x, y, place[0] - x, place[1] - y, boxes[b], wide):
                if found < len(listed):
                    listed[found] = b
                found += 1
    starts[rows * columns * count] = found
    return found


@kernel
def _is_near(x: float, y: float, dx: float, dy: float, box: Any, wide: float) -> bool:
    """Whether a line in plan comes into a box that is `wide` larger to all sides."""
    c, s = box[4], box[5]
    ox, oy = c * (x - box[0]) + s * (y - box[1]), c * (y - box[1]) - s * (x - box[0])
    ex, ey = c * dx + s * dy, c * dy - s * dx
    enters, leaves = 0.0, 1.0
    for o, e, half in ((ox, ex, box[6] + wide), (oy, ey, box[7] + wide)):
        if abs(e) < _THIN:
            if abs(o) > half:
                return False
            continue
        first, second = (-half - o) / e, (half - o) / e
        enters, leaves = max(enters, min(first, second)), min(leaves, max(first, second))
    return enters <= leaves


_NEAREST_M = 0.05
_SHADE_M = 0.1  # behind what stands in the light before it is shaded; a cell of a pane is as wide


class Panes(NamedTuple):
    """Windows that the sun stands behind.

    Attributes:
        middle: (P, 3).
        axes: (P, 3, 3) across, along and through the pane, as rows.
        half_m: (P, 2) half lengths across and along.
        reach_m: (P, A, B) how far sunlight comes from each cell of a pane before it meets something.
    """

    middle: FloatArray
    axes: FloatArray
    half_m: FloatArray
    reach_m: Float32Array


@kernel(error_model="numpy")
def shine_in(view: View, panes: Panes, towards: FloatArray, out: Any) -> None:
    """Put the cosine of the sun's incidence into `out` (H, W) where it comes through a pane, else 0.

    `towards` (3,) is the unit vector to the sun.
    """
    depth_m, normal_world = view.depth_m, view.normal_world
    height, width = depth_m.shape
    x, y, z = towards
    for v in range(height):
        R = nine(view.T_world_camera[v])
        for u in range(width):
            out[v, u] = 0.0
            facing = normal_world[v, u, 0] * x + normal_world[v, u, 1] * y + normal_world[v, u, 2] * z
            if facing <= 0 or depth_m[v, u] <= 0:
                continue
            p0, p1, p2 = point(v, u, R, view)
            if _is_reached(p0, p1, p2, panes, towards):
                out[v, u] = facing


@kernel(error_model="numpy")
def _is_reached(p0: float, p1: float, p2: float, panes: Panes, towards: FloatArray) -> bool:
    """Whether the way from a point to the sun goes through a pane."""
    middle, axes, half_m, reach_m = panes
    cells_across, cells_along = reach_m.shape[1:]
    for k in range(len(middle)):
        a0, a1, a2 = middle[k, 0] - p0, middle[k, 1] - p1, middle[k, 2] - p2
        along = axes[k, 2, 0] * towards[0] + axes[k, 2, 1] * towards[1] + axes[k, 2, 2] * towards[2]
        if abs(along) < 1e-3:
            continue
        way_m = (axes[k, 2, 0] * a0 + axes[k, 2, 1] * a1 + axes[k, 2, 2] * a2) / along
        if way_m < _NEAREST_M:
            continue
        b0, b1, b2 = way_m * towards[0] - a0, way_m * towards[1] - a1, way_m * towards[2] - a2
        across = axes[k, 0, 0] * b0 + axes[k, 0, 1] * b1 + axes[k, 0, 2] * b2
        if abs(across) >= half_m[k, 0]:
            continue
        along_m = axes[k, 1, 0] * b0 + axes[k, 1, 1] * b1 + axes[k, 1, 2] * b2
        if abs(along_m) >= half_m[k, 1]:
            continue
        i = min(int((across / half_m[k, 0] + 1) * 0.5 * cells_across), cells_across - 1)
        j = min(int((along_m / half_m[k, 1] + 1) * 0.5 * cells_along), cells_along - 1)
        if way_m < reach_m[k, i, j] + _SHADE_M:
            return True
    return False
