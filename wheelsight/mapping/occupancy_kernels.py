"""Compiled inner loops of occupancy: cells that the rays of a keyframe pass and hit, and their log-odds.

A keyframe has one observation of each cell and channel. Channel 0 is the ground, the last one is above the robot, and
those between are layers of height. A ray is straight in the map, and its height over the base's floor is linear along
it. So one matrix (3, 4) maps points of the camera to column and row in cells, and height in metres.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel

HIDDEN, PASSED, MET = 1, 2, 3
FLOOR, DROP = 1, 2
_THING = 3


class DepthRays(NamedTuple):
    """Depth (h, w) in metres, 0 where unknown, and the slopes x / z (w,) and y / z (h,) of its rays."""

    depth_m: Any
    slope_x: Any
    slope_y: Any


class Bands(NamedTuple):
    """Heights over the floor that separate channels, and limits of rays; see `OccupancySettings`."""

    resolution_m: float
    floor_m: float
    drop_m: float
    tilt_rad: float
    layer_m: float
    height_m: float
    overhang_m: float
    far_m: float
    bridged_m: float
    hidden_m: float


class OccupancyNoise(NamedTuple):
    """Standard deviation of a depth z, constant_m + quadratic_per_m · z², and the number of them that a ray leaves."""

    constant_m: float
    quadratic_per_m: float
    margin_sigmas: float


class Window(NamedTuple):
    """Observations of one keyframe in the cells around it.

    `seen` is (rows, columns, channels) uint8: FLOOR or DROP on the ground, HIDDEN, PASSED or MET elsewhere, or 0.
    `is_touched` (rows, columns) uint8 marks cells with any, `touched` (rows · columns, 2) lists them, and `count` (1,)
    is their number.
    """

    seen: Any
    is_touched: Any
    touched: Any
    count: Any


class Steps(NamedTuple):
    """Changes of log-odds and their limits, in steps of the table, all even.

    So 1 can only be a layer that was hidden and never observed.
    """

    met: int
    passed: int
    least: int
    most: int


@kernel(error_model="numpy")
def trace(rays: DepthRays, M: Any, bands: Bands, noise: OccupancyNoise, window: Window) -> None:
    """Mark the observations of one keyframe in a window.

    Args:
        rays: of the keyframe.
        M: (3, 4) maps points of the camera to column and row in the window, in cells, and height in metres.
        bands, noise: as in settings.
        window: an empty window.
    """
    begin, end = M[:, 3].copy(), np.empty(3)
    # Observation of the ray of the row above, its position, and its height.
    above, into = np.zeros(4), np.zeros(2)
    height, width = rays.depth_m.shape
    angle = abs(rays.slope_x[1] - rays.slope_x[0]) if width > 1 else 1.0
    ends = np.empty((height, width, 3))
    for v in range(height):
        for u in range(width):
            z = rays.depth_m[v, u]
            for i in range(3):
                ends[v, u, i] = begin[i] + z * (M[i, 0] * rays.slope_x[u] + M[i, 1] * rays.slope_y[v] + M[i, 2])
    for u in range(width):
        above[0] = 0
        for v in range(height):
            z = rays.depth_m[v, u]
            if not z > 0:
                above[0] = 0
                continue
            end[:] = ends[v, u]
            sigma_m = noise.constant_m + noise.quadratic_per_m * z * z
            margin_m = noise.margin_sigmas * sigma_m + bands.resolution_m
            _find_into(rays.depth_m[v], ends[v], u, angle * z / bands.resolution_m, begin, bands, into)
            _follow(window, begin, end, _needed_from(u, v, angle, bands) / z, margin_m, bands, above, into)


@kernel(error_model="numpy")
def _find_into(depth_m: Any, ends: Any, u: int, spacing: float, begin: Any, bands: Bands, into: Any) -> None:
    """Find how far to move a hit into its surface, half a cell, before its cell is marked.

    A cell with any part of a surface is half in front of it on average, and half beyond its edge, so that each side of
    a door would be half a cell too far out. The hit moves half a cell along the normal away from the camera, and along
    the surface until it is half a cell from its edges. The edge lies half-way to the first ray that passes. A thing
    that is narrower than a cell is marked in its middle.

    Args:
        depth_m, ends: (w,) of a row of rays, and (w, 3) their ends, column and row in cells, and height in metres.
        u: column of the hit.
        spacing: of neighbouring rays at its depth, in cells.
        into: (2,) is written, in cells.
    """
    into[:] = 0.0
    # Ends of the surface in this row to either side, up to a cell away, and how far they are if it ends there.
    bridged = bands.bridged_m / bands.resolution_m
    left, right, first, last = np.inf, np.inf, u, u
    for side in range(2):
        step, at, way = 2 * side - 1, u, 0.0
        while way < 1.0:
            to = at + step
            if not (0 <= to < len(ends)):
                way = np.inf  # it may go on beyond the image
                break
            gap = np.hypot(ends[to, 0] - ends[at, 0], ends[to, 1] - ends[at, 1])
            if not depth_m[to] > 0 or gap > bridged or abs(ends[to, 2] - ends[at, 2]) > bands.layer_m:
                break
            at, way = to, np.hypot(ends[to, 0] - ends[u, 0], ends[to, 1] - ends[u, 1])
        reach = way + spacing / 2 if way < 1.0 else np.inf
        if side == 0:
            left, first = reach, at
        else:
            right, last = reach, at
    tx, ty = ends[last, 0] - ends[first, 0], ends[last, 1] - ends[first, 1]
    length = np.hypot(tx, ty)
    if length < 0.25:
        return
    tx, ty = tx / length, ty / length
    half = 0.5 * (abs(tx) + abs(ty))  # of a cell's extent along the surface, and along its normal
    low, high = half - left, right - half
    along = (right - left) / 2 if low > high else min(max(0.0, low), high)
    # The normal (ty, -tx), turned away from the camera.
    inward = np.copysign(min(half, (left + right) / 2), (ends[u, 0] - begin[0]) * ty - (ends[u, 1] - begin[1]) * tx)
    into[0], into[1] = along * tx + inward * ty, along * ty - inward * tx


@kernel(error_model="numpy")
def _follow(
    window: Window, begin: Any, end: Any, needed: float, margin_m: float, bands: Bands, above: Any, into: Any
) -> None:
    """Mark the cells that a ray passes from a share of its length on, and its end, which is `above` of the next one.

    An obstacle is marked `into` (2,) farther, in cells; see `_find_into`.
    """
    way_m = bands.resolution_m * np.sqrt((end[0] - begin[0]) ** 2 + (end[1] - begin[1]) ** 2)
    tilt_m = bands.tilt_rad * min(way_m, bands.far_m)
    reach = 1.0 if way_m <= bands.far_m else bands.far_m / way_m
    is_drop = end[2] < -bands.drop_m - tilt_m and begin[2] > 0
    ends = begin[2] / (begin[2] - end[2]) if is_drop else 1.0
    a_metre = 1 / max(way_m, 1e-6)
    _pass(window, begin, end, needed, min(reach, ends - margin_m * a_metre), bands, PASSED)
    before, x_before, y_before, h_before = int(above[0]), above[1], above[2], above[3]
    above[0] = 0
    if ends > reach:
        return
    x, y = begin[0] + ends * (end[0] - begin[0]), begin[1] + ends * (end[1] - begin[1])
    above[1], above[2], above[3] = x, y, end[2]
    if is_drop or abs(end[2]) <= bands.floor_m + tilt_m:
        above[0] = what = DROP if is_drop else FLOOR
        _mark(window, x, y, 0, what)
        if before == what:
            _fill(window, x_before, y_before, x, y, 0, what)
    elif 0 < end[2] < bands.overhang_m:
        above[0] = _THING
        x, y = x + into[0], y + into[1]
        above[1], above[2] = x, y
        channel = _channel_at(end[2], bands, window.seen.shape[2])
        _mark(window, x, y, channel, MET)
        if needed < 1:
            _pass(window, begin, end, 1.0, 1 + bands.hidden_m * a_metre, bands, HIDDEN)
        gap_m = bands.resolution_m * np.sqrt((x - x_before) ** 2 + (y - y_before) ** 2)
        if before == _THING and gap_m <= bands.bridged_m and abs(end[2] - h_before) < bands.layer_m:
            _fill(window, x_before, y_before, x, y, channel, MET)


@kernel(error_model="numpy")
def _needed_from(u: int, v: int, angle: float, bands: Bands) -> float:
    """Return the depth from which on a ray passes cells that its neighbours do not pass.

    Every second column is needed up to where columns are a cell apart, every fourth up to half of that. For rows,
    layers replace cells.
    """
    every_u, every_v = 2, 2
    while every_u < 16 and u % every_u == 0:
        every_u *= 2
    while every_v < 16 and v % every_v == 0:
        every_v *= 2
    of_columns = bands.resolution_m / (angle * every_u) if every_u < 16 else 0.0
    of_rows = bands.layer_m / (angle * every_v) if every_v < 16 else 0.0
    return max(of_columns, of_rows)


@kernel(error_model="numpy")
def _touch(window: Window, row: int, column: int) -> None:
    if not window.is_touched[row, column]:
        window.is_touched[row, column] = 1
        n = window.count[0]
        window.touched[n, 0], window.touched[n, 1] = row, column
        window.count[0] = n + 1


@kernel(error_model="numpy")
def _mark(window: Window, x: float, y: float, channel: int, what: int) -> None:
    """Mark a cell; the observation with the higher number stays: a drop, or a hit."""
    row, column, seen = int(np.floor(y)), int(np.floor(x)), window.seen
    if 0 <= row < seen.shape[0] and 0 <= column < seen.shape[1] and seen[row, column, channel] < what:
        _touch(window, row, column)
        seen[row, column, channel] = what


@kernel(error_model="numpy")
def _fill(window: Window, x: float, y: float, to_x: float, to_y: float, channel: int, what: int) -> None:
    """Mark the cells between two neighbouring rays: an object there would hide the farther end.

    Between two hits of the floor is floor, between two rays below it none, and between close hits one object.
    """
    steps = int(np.ceil(2 * max(abs(to_x - x), abs(to_y - y))))
    for step in range(1, steps):
        share = step / steps
        _mark(window, x + share * (to_x - x), y + share * (to_y - y), channel, what)


@kernel(error_model="numpy")
def _channel_at(h_m: float, bands: Bands, channels: int) -> int:
    """Return the channel of a height over the floor; heights below `floor_m` are in the lowest layer."""
    top = (bands.height_m - bands.floor_m) / bands.layer_m
    return _channel(max((h_m - bands.floor_m) / bands.layer_m, 0.0), top, channels)


@kernel(error_model="numpy")
def _channel(layer: float, top: float, channels: int) -> int:
    """Return the channel of a height in layers over `floor_m`; the robot is `top` layers high."""
    return channels - 1 if layer >= top else min(1 + int(layer), channels - 2)


@kernel(error_model="numpy")
def _pass(window: Window, begin: Any, end: Any, at: float, until: float, bands: Bands, what: int) -> None:
    """Mark the cells on a ray from one share of its length to another (Amanatides & Woo 1987)."""
    dx, dy, dh = end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]
    # Only where it is within the bands.
    if dh > 0:
        at, until = max(at, (bands.floor_m - begin[2]) / dh), min(until, (bands.overhang_m - begin[2]) / dh)
    elif dh < 0:
        at, until = max(at, (bands.overhang_m - begin[2]) / dh), min(until, (bands.floor_m - begin[2]) / dh)
    elif not bands.floor_m <= begin[2] < bands.overhang_m:
        return
    if at >= until:
        return
    seen, is_touched, step_x, step_y = window.seen, window.is_touched, 1 if dx > 0 else -1, 1 if dy > 0 else -1
    x, y = begin[0] + at * dx, begin[1] + at * dy
    column, row = int(np.floor(x)), int(np.floor(y))
    a_cell_x = 1 / abs(dx) if dx != 0 else np.inf
    a_cell_y = 1 / abs(dy) if dy != 0 else np.inf
    next_x = at + ((column + 1 - x) if dx > 0 else (x - column)) * a_cell_x if dx != 0 else np.inf
    next_y = at + ((row + 1 - y) if dy > 0 else (y - row)) * a_cell_y if dy != 0 else np.inf
    rows, columns, channels = seen.shape
    top = (bands.height_m - bands.floor_m) / bands.layer_m
    base, climb = (begin[2] - bands.floor_m) / bands.layer_m, dh / bands.layer_m
    # Rounding must not put an end below the first layer.
    here = _channel(max(base + at * climb, 0.0), top, channels)
    while at < until:
        at = min(next_x, next_y, until)
        there = _channel(max(base + at * climb, 0.0), top, channels)
        if 0 <= row < rows and 0 <= column < columns:
            if not is_touched[row, column]:  # most are, and need no call
                _touch(window, row, column)
            _see(seen, row, column, here, there, what)
        here = there
        if next_x < next_y:
            column += step_x
            next_x += a_cell_x
        else:
            row += step_y
            next_y += a_cell_y


@kernel(error_model="numpy")
def _see(seen: Any, row: int, column: int, channel: int, last: int, what: int) -> None:
    """Mark the channels of a cell from one to another."""
    seen[row, column, channel] = max(seen[row, column, channel], what)
    while channel != last:
        channel += 1 if channel < last else -1
        seen[row, column, channel] = max(seen[row, column, channel], what)


@kernel(error_model="numpy")
def stand(window: Window, x: float, y: float, radius: float) -> None:
    """Mark floor, with free space above it, around the robot; all in cells."""
    seen = window.seen
    for row in range(max(int(y - radius), 0), min(int(y + radius) + 2, seen.shape[0])):
        for column in range(max(int(x - radius), 0), min(int(x + radius) + 2, seen.shape[1])):
            if (row + 0.5 - y) ** 2 + (column + 0.5 - x) ** 2 <= radius * radius:
                _mark(window, column + 0.5, row + 0.5, 0, FLOOR)
                for channel in range(1, seen.shape[2] - 1):
                    _mark(window, column + 0.5, row + 0.5, channel, PASSED)


@kernel(error_model="numpy")
def add(window: Window, log_odds: Any, row: int, column: int, steps: Steps) -> None:
    """Add the observations of one keyframe to a table, and clear the window.

    Args:
        window: as `trace` and `stand` leave it.
        log_odds: (R, C, channels) int8; on the ground, of existing floor.
        row, column: in the table of the window's first cell; the window lies within.
        steps: changes for a layer that is hit or passed.
    """
    channels = window.seen.shape[2]
    for n in range(window.count[0]):
        i, j = window.touched[n, 0], window.touched[n, 1]
        window.is_touched[i, j] = 0
        for channel in range(channels):
            what = window.seen[i, j, channel]
            if what == 0:
                continue
            window.seen[i, j, channel] = 0
            value = int(log_odds[row + i, column + j, channel])
            if channel == 0:
                # Missing floor is observed as reliably as existing floor.
                value += steps.met if what == FLOOR else -steps.met
                value = min(max(value, -steps.most), steps.most)
            elif what == HIDDEN:
                value = 1 if value == 0 else value
            else:
                value = 0 if value == 1 else value
                value += steps.met if what == MET else steps.passed
                value = min(max(value, steps.least), steps.most)
            log_odds[row + i, column + j, channel] = value
    window.count[0] = 0
