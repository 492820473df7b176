"""Compiled: cells under a footprint, and how far it is from cells that are occupied.

A cell is a square, and it is under a footprint where the two share more than an edge. In each row of cells a convex
outline covers one stretch, and sums along rows tell how many of its cells are occupied.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel

# In cells: what only touches is not under it.
_TOUCH = 1e-9
OUTSIDE = 1 << 30
_HALF_DIAGONAL = 0.7071068


class Cells(NamedTuple):
    """The cells that a footprint is held against.

    Attributes:
        sums: (H, W + 1) int32, how many cells left of each corner are occupied, row by row.
        distance_m: (H, W) float32 from each cell's centre to that of the nearest occupied one.
        metre_cost: (H, W) float32 what a metre costs: 1 or more.
        resolution_m: side of a cell.
        x0, y0: of the corner of cell (0, 0), metres.
    """

    sums: Any
    distance_m: Any
    metre_cost: Any
    resolution_m: float
    x0: float
    y0: float


class Shape(NamedTuple):
    """A footprint with its margins.

    Attributes:
        outlines: (K, N, 2) corners, from the outline that is to be free where there is room, to the one that has to be.
        inscribed_m: of the last.
        middle_x, middle_y, around_m: of the disc in `base` that holds the first.
    """

    outlines: Any
    inscribed_m: float
    middle_x: float
    middle_y: float
    around_m: float


@kernel(error_model="numpy")
def count_under(cells: Cells, corners: Any, x: float, y: float, yaw: float) -> Any:
    """How many occupied cells lie under an outline (N, 2) at a pose; OUTSIDE where it reaches beyond the cells."""
    rows, columns = cells.distance_m.shape
    n, c, s = len(corners), np.cos(yaw), np.sin(yaw)
    u, v = np.empty(n), np.empty(n)
    low, high = np.inf, -np.inf
    for k in range(n):
        u[k] = (x + c * corners[k, 0] - s * corners[k, 1] - cells.x0) / cells.resolution_m
        v[k] = (y + s * corners[k, 0] + c * corners[k, 1] - cells.y0) / cells.resolution_m
        low, high = min(low, v[k]), max(high, v[k])
        if not (u[k] >= -_TOUCH and u[k] <= columns + _TOUCH):
            return OUTSIDE
    if not (low >= -_TOUCH and high <= rows + _TOUCH):
        return OUTSIDE
    found = 0
    for row in range(max(int(np.floor(low + _TOUCH)), 0), min(int(np.ceil(high - _TOUCH)), rows)):
        left, right = _stretch(u, v, row + _TOUCH, row + 1 - _TOUCH)
        first, after = max(int(np.floor(left + _TOUCH)), 0), min(int(np.ceil(right - _TOUCH)), columns)
        if after > first:
            found += cells.sums[row, after] - cells.sums[row, first]
    return found


@kernel(error_model="numpy")
def _stretch(u: Any, v: Any, low: float, high: float) -> Any:
    """From where to where a convex outline reaches between two heights."""
    left, right, before = np.inf, -np.inf, len(u) - 1
    for k in range(len(u)):
        if low <= v[k] <= high:
            left, right = min(left, u[k]), max(right, u[k])
        rise = v[k] - v[before]
        for height in (low, high):
            if (v[k] - height) * (v[before] - height) < 0:
                at = u[before] + (u[k] - u[before]) * (height - v[before]) / rise
                left, right = min(left, at), max(right, at)
        before = k
    return left, right


@kernel(error_model="numpy")
def cell_of(cells: Cells, x: float, y: float) -> Any:
    """Row and column of a point; -1 and -1 outside."""
    row = int(np.floor((y - cells.y0) / cells.resolution_m))
    column = int(np.floor((x - cells.x0) / cells.resolution_m))
    rows, columns = cells.distance_m.shape
    if row < 0 or column < 0 or row >= rows or column >= columns:
        return -1, -1
    return row, column


@kernel(error_model="numpy")
def tightness(cells: Cells, shape: Shape, x: float, y: float, yaw: float) -> Any:
    """0 where the widest outline is free, 1 where the narrowest alone is, between by which one is; infinite: none."""
    row, column = cell_of(cells, x, y)
    # From a point to the nearest occupied square it is this much less, or more, than from centre to centre.
    slack_m = _HALF_DIAGONAL * cells.resolution_m
    if row < 0 or cells.distance_m[row, column] < shape.inscribed_m + 0.5 * cells.resolution_m - slack_m:
        return np.inf
    c, s = np.cos(yaw), np.sin(yaw)
    at_x, at_y = x + c * shape.middle_x - s * shape.middle_y, y + s * shape.middle_x + c * shape.middle_y
    row, column = cell_of(cells, at_x, at_y)
    if row >= 0 and cells.distance_m[row, column] > shape.around_m + 2 * slack_m:
        edge_m = min(row, column, cells.distance_m.shape[0] - 1 - row, cells.distance_m.shape[1] - 1 - column)
        if edge_m * cells.resolution_m > shape.around_m:
            return 0.0
    last = len(shape.outlines) - 1
    if count_under(cells, shape.outlines[last], x, y, yaw) > 0:
        return np.inf
    for k in range(last):
        if count_under(cells, shape.outlines[k], x, y, yaw) == 0:
            return k / last
    return 1.0


@kernel(error_model="numpy")
def tightnesses(cells: Cells, shape: Shape, poses: Any, found: Any) -> None:
    """`tightness` of each of poses (N, 3)."""
    for k in range(len(poses)):
        found[k] = tightness(cells, shape, poses[k, 0], poses[k, 1], poses[k, 2])


@kernel(error_model="numpy")
def counts_under(cells: Cells, corners: Any, poses: Any, found: Any) -> None:
    """`count_under` of each of poses (N, 3)."""
    for k in range(len(poses)):
        found[k] = count_under(cells, corners, poses[k, 0], poses[k, 1], poses[k, 2])


@kernel(error_model="numpy")
def least_clearance(cells: Cells, corners: Any, poses: Any, most_m: float) -> Any:
    """Metres from an outline at any of poses (N, 3) to the nearest occupied square, at most `most_m`; 0 within."""
    least, size_m = most_m, cells.resolution_m
    rows, columns = cells.distance_m.shape
    n = len(corners)
    placed, reach_m = np.empty((n, 2)), 0.0
    for k in range(n):
        reach_m = max(reach_m, np.hypot(corners[k, 0], corners[k, 1]))
    for p in range(len(poses)):
        x, y, yaw = poses[p, 0], poses[p, 1], poses[p, 2]
        row, column = cell_of(cells, x, y)
        if row < 0 or count_under(cells, corners, x, y, yaw) > 0:
            return 0.0
        if cells.distance_m[row, column] - 2 * _HALF_DIAGONAL * size_m > reach_m + least:
            continue
        c, s = np.cos(yaw), np.sin(yaw)
        for k in range(n):
            placed[k, 0] = (x + c * corners[k, 0] - s * corners[k, 1] - cells.x0) / size_m
            placed[k, 1] = (y + s * corners[k, 0] + c * corners[k, 1] - cells.y0) / size_m
        window = int((reach_m + least) / size_m) + 2
        for i in range(max(row - window, 0), min(row + window + 1, rows)):
            for j in range(max(column - window, 0), min(column + window + 1, columns)):
                if cells.distance_m[i, j] == 0:
                    least = min(least, size_m * _apart(placed, j, i))
    return least


@kernel(error_model="numpy")
def _apart(placed: Any, left: int, low: int) -> Any:
    """Cells from an outline to the unit square with that lower left corner, which are apart."""
    least, before = np.inf, len(placed) - 1
    for k in range(len(placed)):
        x, y = placed[k, 0], placed[k, 1]
        least = min(least, np.hypot(max(left - x, x - left - 1, 0.0), max(low - y, y - low - 1, 0.0)))
        bx, by = placed[before, 0], placed[before, 1]
        wx, wy = x - bx, y - by
        length2 = wx * wx + wy * wy
        for corner in range(4):
            px, py = left + corner % 2, low + corner // 2
            share = min(max(((px - bx) * wx + (py - by) * wy) / length2, 0.0), 1.0)
            least = min(least, np.hypot(bx + share * wx - px, by + share * wy - py))
        before = k
    return least
