"""Compiled shadows: how much of the light of the lamps round about things hide from the points of a view.

A lamp is a level rectangle, and what stands in its light an upright box. From a point, the rays to all places of the
lamp make a pencil. A box hides a share of it: as much as its slab across each axis covers where the pencil is within
the box's heights, and no more than it covers in plan. Edges of boxes that lie along the lamp's are exact so, with their
penumbra. A round thing is taken for the box around it that faces the lamp.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import BoolArray, FloatArray, Int32Array
from wheelsight.simulation._light_kernels import Views, nine, turned

STRIDE_PX = 4
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
        boxes: (B, 8) x and y of the middle, lowest and highest z, cosine and sine of the yaw, half lengths.
        is_round: (B,) whether it is as one that faces whatever lamp it hides.
        geom: (B,) which geom it is, -1 for none that is seen.
        moving: (M,) those that can be anywhere.
        starts: (Y · X · K + 1,) where the list of each cell and lamp begins in `listed`.
        listed: (N,) those that stand still and may hide a lamp from a cell.
    """

    boxes: FloatArray
    is_round: BoolArray
    geom: Int32Array
    moving: Int32Array
    starts: Int32Array
    listed: Int32Array


class Shadowing(NamedTuple):
    """All that decides of shadows; `glows` (G,) tells geoms that have light of their own."""

    lamps: Lamps
    blockers: Blockers
    glows: BoolArray
    strength: float


@kernel(error_model="numpy")
def keep(view: Views, shadowing: Shadowing, out: Any) -> None:
    """Put into `out` (H, W) the share of each pixel's light that is left where lamps are hidden from it.

    Along a flat face it is found for each fourth pixel, and for those between where two of them differ.
    """
    geom, normal_world = view.geom, view.normal_world
    height, width = geom.shape
    for v in range(height):
        R = nine(view.T_world_camera[v])
        last = 0
        for u in range(width):
            if u % STRIDE_PX and u != width - 1 and _is_inside(v, u, geom, normal_world):
                continue
            out[v, u] = _kept(v, u, R, view, shadowing)
            is_alike = abs(out[v, u] - out[v, last]) < _ALIKE
            for between in range(last + 1, u):
                k = (between - last) / (u - last)
                if is_alike:
                    out[v, between] = (1 - k) * out[v, last] + k * out[v, u]
                else:
                    out[v, between] = _kept(v, between, R, view, shadowing)
            last = u


@kernel(error_model="numpy")
def _is_inside(v: int, u: int, geom: Any, normal_world: Any) -> Any:
    """Whether a pixel and the strided ones on both sides of it are all on the same flat face."""
    a = u - u % STRIDE_PX
    b = min(a + STRIDE_PX, geom.shape[1] - 1)
    for other in range(a, b + 1):
        if geom[v, other] != geom[v, u]:
            return False
    bend = abs(normal_world[v, a, 0] - normal_world[v, b, 0]) + abs(normal_world[v, a, 1] - normal_world[v, b, 1])
    return bend + abs(normal_world[v, a, 2] - normal_world[v, b, 2]) < 1e-3


@kernel(error_model="numpy")
def _kept(v: int, u: int, R: Any, view: Views, shadowing: Shadowing) -> Any:
    """The share of a pixel's light that is left."""
    g = view.geom[v, u]
    if g < 0 or shadowing.glows[g]:
        return 1.0
    n = (float(view.normal_world[v, u, 0]), float(view.normal_world[v, u, 1]), float(view.normal_world[v, u, 2]))
    z, ray = float(view.depth_m[v, u]), turned(R, (view.rays[v, u, 0], view.rays[v, u, 1], view.rays[v, u, 2]))
    p = (
        view.T_world_camera[v, 0, 3] + z * ray[0],
        view.T_world_camera[v, 1, 3] + z * ray[1],
        view.T_world_camera[v, 2, 3] + z * ray[2],
    )
    return 1 - shadowing.strength * hidden_at(p, n, g, shadowing.lamps, shadowing.blockers)


@kernel(error_model="numpy")
def hidden_at(p: Any, n: Any, own: int, lamps: Lamps, blockers: Blockers) -> Any:
    """Share of the light of the brightest lamps that does not reach p, with normal n, on the geom `own`."""
    rows, columns, count = lamps.brightest.shape
    column = min(max(int((p[0] - lamps.grid[0]) / lamps.grid[2]), 0), columns - 1)
    row = min(max(int((p[1] - lamps.grid[1]) / lamps.grid[2]), 0), rows - 1)
    # The least bright one does not count, others by how much they are brighter: no seam where cells take other lamps.
    last, least = lamps.brightest[row, column, count - 1], 0.0
    if last >= 0:
        least = lamps.lamps[last, 3] * light_of(_towards(p, lamps.lamps[last]), (0.0, 0.0, 1.0))
    lost, whole = 0.0, _ELSEWHERE
    for k in range(count):
        lamp = lamps.brightest[row, column, k]
        if lamp < 0:
            break
        d, power = _towards(p, lamps.lamps[lamp]), lamps.lamps[lamp, 3]
        light = power * light_of(d, n)
        if light > 0 and last >= 0:
            light *= max(1 - least / (power * light_of(d, (0.0, 0.0, 1.0))), 0.0)
        if light > 0:
            half = (lamps.lamps[lamp, 4], lamps.lamps[lamp, 5])
            walled, hidden = _hidden(p, d, half, own, (row * columns + column) * count + k, blockers)
            lost, whole = lost + light * (1 - walled) * hidden, whole + light * (1 - walled)
    return lost / whole


@kernel(error_model="numpy")
def _towards(p: Any, lamp: Any) -> Any:
    return lamp[0] - p[0], lamp[1] - p[1], lamp[2] - p[2]


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


@kernel(error_model="numpy")
def _hidden(p: Any, d: Any, half: Any, own: int, entry: int, blockers: Blockers) -> Any:
    """Shares of one lamp that walls hide, and all else; `entry` tells its list of what stands still."""
    walled, hidden = 0.0, 0.0
    for i in range(blockers.starts[entry], blockers.starts[entry + 1]):
        b = blockers.listed[i]
        if blockers.geom[b] == own:
            continue
        share = covered(p, d, half, blockers.boxes[b], blockers.is_round[b])
        if blockers.boxes[b, 3] > p[2] + d[2] - _TO_CEILING_M:
            walled += share
            if walled >= 1:
                return 1.0, 0.0
        else:
            hidden += share
    level = np.sqrt(d[0] * d[0] + d[1] * d[1])
    for b in blockers.moving:
        box = blockers.boxes[b]
        x, y, reach = box[0] - p[0], box[1] - p[1], level + half[0] + half[1] + box[6] + box[7]
        if blockers.geom[b] != own and x * x + y * y < reach * reach:
            hidden += covered(p, d, half, blockers.boxes[b], blockers.is_round[b])
    return walled, min(hidden, 1.0)


@kernel(error_model="numpy")
def covered(p: Any, d: Any, half: Any, box: Any, is_round: bool) -> Any:
    """Share of a lamp, `half` (2) its half lengths and d away from p, that a box hides from there."""
    enters, leaves = max((box[2] - p[2]) / d[2], 0.0), min((box[3] - p[2]) / d[2], 1.0)
    if box[3] < p[2] + _ABOVE_M or enters >= leaves:
        return 0.0
    c, s = box[4], box[5]
    if is_round:
        level = np.sqrt(d[0] * d[0] + d[1] * d[1])
        c, s = (d[0] / level, d[1] / level) if level > _THIN else (1.0, 0.0)
    x, y = p[0] - box[0], p[1] - box[1]
    x, y = c * x + s * y, c * y - s * x
    dx, dy = c * d[0] + s * d[1], c * d[1] - s * d[0]
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
    for row in range(rows):
        for column in range(columns):
            kept = 0
            out[row, column, :] = -1
            for k in range(count):
                lamp = lamps.brightest[row, column, k]
                if lamp < 0 or kept == out.shape[2]:
                    break
                if _is_seen(row, column, k, lamps, blockers):
                    out[row, column, kept] = lamp
                    kept += 1


@kernel
def _is_seen(row: int, column: int, k: int, lamps: Lamps, blockers: Blockers) -> bool:
    columns, count = lamps.brightest.shape[1:]
    place = lamps.lamps[lamps.brightest[row, column, k]]
    for i in range(18):
        x = lamps.grid[0] + (column + 0.5 * (i % 3)) * lamps.grid[2]
        y = lamps.grid[1] + (row + 0.5 * (i // 3 % 3)) * lamps.grid[2]
        p = (x, y, 0.05 + 1.5 * (i // 9))
        d = _towards(p, place)
        entry = (row * columns + column) * count + k
        if d[2] > _LEAST_RISE_M and _hidden(p, d, (place[4], place[5]), -1, entry, blockers)[0] < 1:
            return True
    return False


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
