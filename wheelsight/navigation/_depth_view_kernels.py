"""Compiled: what a depth image shows of the floor and of things on it, by bearing and by cell, seen from the base."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel


class Rays(NamedTuple):
    """Of each pixel (h, w): where a point at depth 1 lies from the camera along the base's axes, and its bearing.

    Attributes:
        ways: (h, w, 3) float32.
        columns: (h, w) int16 number of the bearing, -1 outside of the view that all rows share.
        camera: (3,) where the camera sits in the base.
    """

    ways: Any
    columns: Any
    camera: Any


class Heights(NamedTuple):
    """By what floor and things are told apart, metres; as `LiveLayerSettings` has it."""

    floor_m: float
    drop_m: float
    tilt_rad: float
    height_m: float
    far_m: float


class Shown(NamedTuple):
    """What was found.

    Attributes:
        floor: (columns, bins) uint8, whether a bearing shows floor so far from the camera.
        cells: (n, n, 3) of things: pixels, sums of x and y in the base.
        tops: (n, n, k) the k highest of a cell's pixels over the floor, the highest first.
        measured: (columns,) pixels with a depth.
        bin_m, cell_m: side of a bin and of a cell.
    """

    floor: Any
    cells: Any
    tops: Any
    measured: Any
    bin_m: float
    cell_m: float


@kernel(error_model="numpy")
def look(depth_m: Any, rays: Rays, heights: Heights, shown: Shown) -> None:
    """Sort the pixels of a depth image (h, w) in metres; where it is not finite and over 0, nothing was measured."""
    rows, columns = depth_m.shape
    bins = shown.floor.shape[1]
    for v in range(rows):
        for u in range(columns):
            z, column = depth_m[v, u], rays.columns[v, u]
            if column < 0 or not (z > 0 and z < np.inf):
                continue
            shown.measured[column] += 1
            dx, dy, dz = z * rays.ways[v, u, 0], z * rays.ways[v, u, 1], z * rays.ways[v, u, 2]
            h, way_m = rays.camera[2] + dz, np.hypot(dx, dy)
            tilt_m = heights.tilt_rad * way_m
            if h < -heights.drop_m - tilt_m and rays.camera[2] > 0:
                share = rays.camera[2] / (rays.camera[2] - h)
                dx, dy, way_m = share * dx, share * dy, share * way_m
            elif abs(h) <= heights.floor_m + tilt_m:
                at = int(way_m / shown.bin_m)
                if at < bins:
                    shown.floor[column, at] = 1
                continue
            elif not (0 < h < heights.height_m):
                continue
            if way_m <= heights.far_m:
                _put(shown, rays.camera[0] + dx, rays.camera[1] + dy, h)


@kernel(error_model="numpy")
def _put(shown: Shown, x: float, y: float, height_m: float) -> None:
    side = shown.cells.shape[0]
    row, column = int(np.floor(y / shown.cell_m)) + side // 2, int(np.floor(x / shown.cell_m)) + side // 2
    if 0 <= row < side and 0 <= column < side:
        shown.cells[row, column, 0] += 1
        shown.cells[row, column, 1] += x
        shown.cells[row, column, 2] += y
        top = height_m
        for k in range(shown.tops.shape[2]):
            if top > shown.tops[row, column, k]:
                top, shown.tops[row, column, k] = shown.tops[row, column, k], top
