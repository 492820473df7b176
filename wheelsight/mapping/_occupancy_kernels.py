"""Compiled inner loops of occupancy: what a keyframe's rays pass and meet, and what that says of each cell.

Of each cell a keyframe tells one thing a channel. Channel 0 is the ground, the last one what hangs above the robot, and
those between are layers of height. A ray is straight in the map and its height over the base's floor is linear along
it, so that one matrix (3, 4) takes points of the camera to column and row in cells, and height in metres.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel

PASSED, MET = 1, 2
FLOOR, DROP = 1, 2
_NONE = -1.0e9


class DepthRays(NamedTuple):
    """Depth (h, w) in metres, 0 where unknown, and the slopes x / z (w,) and y / z (h,) of its rays."""

    depth_m: Any
    slope_x: Any
    slope_y: Any


class Bands(NamedTuple):
    """Heights over the floor by which things are told apart, and what else rays go by; see `OccupancySettings`."""

    resolution_m: float
    floor_m: float
    drop_m: float
    tilt_rad: float
    layer_m: float
    height_m: float
    overhang_m: float
    far_m: float


class Noise(NamedTuple):
    """Standard deviation of a depth z: constant_m + quadratic_per_m · z²; and before how many a ray frees nothing."""

    constant_m: float
    quadratic_per_m: float
    margin_sigmas: float


class Window(NamedTuple):
    """What one keyframe sees of the cells about it.

    `seen` is (rows, columns, channels) uint8: FLOOR or DROP on the ground, PASSED or MET elsewhere, or 0. `is_touched`
    (rows, columns) uint8 tells where any is, and `touched` (rows · columns, 2) lists these cells; `count` (1,) of them.
    """

    seen: Any
    is_touched: Any
    touched: Any
    count: Any


class Steps(NamedTuple):
    """By what log-odds change, and between what they stay; in the units of the table."""

    met: int
    passed: int
    least: int
    most: int


@kernel
def trace(rays: DepthRays, M: Any, bands: Bands, noise: Noise, window: Window) -> None:
    """Mark in a window what one keyframe sees.

    Args:
        rays: of the keyframe.
        M: (3, 4) that takes points of the camera to column and row in the window, in cells, and height in metres.
        bands, noise: as in settings.
        window: of nothing.
    """
    begin, end = M[:, 3].copy(), np.empty(3)
    height, width = rays.depth_m.shape
    angle = abs(rays.slope_x[1] - rays.slope_x[0]) if width > 1 else 1.0
    for u in range(width):
        # Where the ray of the row above met the floor, if it did.
        x_before, y_before = _NONE, _NONE
        for v in range(height):
            x_last, y_last, x_before = x_before, y_before, _NONE
            z = rays.depth_m[v, u]
            if not z > 0:
                continue
            for i in range(3):
                end[i] = begin[i] + z * (M[i, 0] * rays.slope_x[u] + M[i, 1] * rays.slope_y[v] + M[i, 2])
            way_m = bands.resolution_m * np.hypot(end[0] - begin[0], end[1] - begin[1])
            tilt_m = bands.tilt_rad * min(way_m, bands.far_m)
            reach = 1.0 if way_m <= bands.far_m else bands.far_m / way_m
            is_drop, ends = end[2] < -bands.drop_m - tilt_m and begin[2] > 0, 1.0
            if is_drop:
                ends = begin[2] / (begin[2] - end[2])
                if ends <= reach:
                    _ground(window, begin[0] + ends * (end[0] - begin[0]), begin[1] + ends * (end[1] - begin[1]), DROP)
            sigma_m = noise.constant_m + noise.quadratic_per_m * z * z
            margin = (noise.margin_sigmas * sigma_m + bands.resolution_m) / max(way_m, 1e-6)
            _pass(window, begin, end, _needed_from(u, v, angle, bands) / z, min(reach, ends - margin), bands)
            if is_drop or reach < 1.0:
                continue
            if end[2] <= bands.floor_m + tilt_m:
                _ground(window, end[0], end[1], FLOOR)
                if x_last > _NONE:
                    _fill(window, x_last, y_last, end)
                x_before, y_before = end[0], end[1]
            else:
                _meet(window, end, bands)


@kernel
def _needed_from(u: int, v: int, angle: float, bands: Bands) -> float:
    """The depth from which on a ray passes what its neighbours do not pass.

    Every second column does up to where these lie a cell apart, every fourth up to half of that; of rows, where they
    lie a layer apart.
    """
    every_u, every_v = 2, 2
    while every_u < 16 and u % every_u == 0:
        every_u *= 2
    while every_v < 16 and v % every_v == 0:
        every_v *= 2
    of_columns = bands.resolution_m / (angle * every_u) if every_u < 16 else 0.0
    of_rows = bands.layer_m / (angle * every_v) if every_v < 16 else 0.0
    return max(of_columns, of_rows)


@kernel
def _touch(window: Window, row: int, column: int) -> None:
    if not window.is_touched[row, column]:
        window.is_touched[row, column] = 1
        n = window.count[0]
        window.touched[n, 0], window.touched[n, 1] = row, column
        window.count[0] = n + 1


@kernel
def _ground(window: Window, x: float, y: float, what: int) -> None:
    """A drop stays one."""
    row, column, seen = int(np.floor(y)), int(np.floor(x)), window.seen
    if 0 <= row < seen.shape[0] and 0 <= column < seen.shape[1] and seen[row, column, 0] < what:
        _touch(window, row, column)
        seen[row, column, 0] = what


@kernel
def _fill(window: Window, x: float, y: float, end: Any) -> None:
    """Between two neighbouring rays that meet the floor there is floor: what stands there would hide the farther."""
    steps = int(np.ceil(2 * max(abs(end[0] - x), abs(end[1] - y))))
    for step in range(1, steps):
        share = step / steps
        _ground(window, x + share * (end[0] - x), y + share * (end[1] - y), FLOOR)


@kernel
def _channel(layer: float, top: float, channels: int) -> int:
    """Of a height in layers over `floor_m`, where the robot is `top` layers high."""
    return channels - 1 if layer >= top else min(1 + int(layer), channels - 2)


@kernel
def _meet(window: Window, end: Any, bands: Bands) -> None:
    """Above the floor's tolerance, which grows with distance, all is an obstacle, however low."""
    row, column, seen = int(np.floor(end[1])), int(np.floor(end[0])), window.seen
    if 0 <= row < seen.shape[0] and 0 <= column < seen.shape[1] and end[2] < bands.overhang_m:
        top = (bands.height_m - bands.floor_m) / bands.layer_m
        _touch(window, row, column)
        seen[row, column, _channel((end[2] - bands.floor_m) / bands.layer_m, top, seen.shape[2])] = MET


@kernel
def _pass(window: Window, begin: Any, end: Any, at: float, until: float, bands: Bands) -> None:
    """Mark what a ray passes from one share of its way to another, cell by cell (Amanatides & Woo 1987)."""
    dx, dy, dh = end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]
    # Only where it is within the bands.
    if dh > 0:
        at, until = max(at, (bands.floor_m - begin[2]) / dh), min(until, (bands.overhang_m - begin[2]) / dh)
    elif dh < 0:
        at, until = max(at, (bands.overhang_m - begin[2]) / dh), min(until, (bands.floor_m - begin[2]) / dh)
    elif not bands.floor_m <= begin[2] < bands.overhang_m:
        return
    seen, step_x, step_y = window.seen, 1 if dx > 0 else -1, 1 if dy > 0 else -1
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
            _touch(window, row, column)
            for channel in range(min(here, there), max(here, there) + 1):
                if seen[row, column, channel] == 0:
                    seen[row, column, channel] = PASSED
        here = there
        if next_x < next_y:
            column += step_x
            next_x += a_cell_x
        else:
            row += step_y
            next_y += a_cell_y


@kernel
def stand(window: Window, x: float, y: float, radius: float) -> None:
    """Mark floor, and nothing above it, about where the robot stands; all in cells."""
    seen = window.seen
    for row in range(max(int(y - radius), 0), min(int(y + radius) + 2, seen.shape[0])):
        for column in range(max(int(x - radius), 0), min(int(x + radius) + 2, seen.shape[1])):
            if (row + 0.5 - y) ** 2 + (column + 0.5 - x) ** 2 <= radius * radius:
                _ground(window, column + 0.5, row + 0.5, FLOOR)
                for channel in range(1, seen.shape[2] - 1):
                    seen[row, column, channel] = max(seen[row, column, channel], PASSED)


@kernel
def add(window: Window, log_odds: Any, row: int, column: int, steps: Steps) -> None:
    """Add what one keyframe saw to a table, and clear the window.

    Args:
        window: as `trace` and `stand` leave it.
        log_odds: (R, C, channels) int8; on the ground, of a floor that is there.
        row, column: in the table of the window's first cell; the window lies within.
        steps: of a layer that is met or passed.
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
                # That the floor is missing is as surely seen as that it is there.
                value += steps.met if what == FLOOR else -steps.met
                value = min(max(value, -steps.most), steps.most)
            else:
                value += steps.met if what == MET else steps.passed
                value = min(max(value, steps.least), steps.most)
            log_odds[row + i, column + j, channel] = value
    window.count[0] = 0
