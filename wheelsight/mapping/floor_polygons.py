"""Polygons on the floor of a map: which cells they have, and where in one of them there is most room."""

from __future__ import annotations

import cv2
import numpy as np
import shapely
from numpy.typing import ArrayLike

from wheelsight.errors import MapError
from wheelsight.geometry import BoolArray, FloatArray
from wheelsight.mapping.occupancy import OccupancyGrid
from wheelsight.ros_map import FREE

_SMALLEST_AREA_M2 = 1e-6
_FARTHEST_M = 1e6
# Of a generous zone each cell is a shape of some hundred bytes.
_CELLS_AT_ONCE = 100_000


def checked_corners(polygon: ArrayLike) -> FloatArray:
    """(N, 2) corners in metres, which cannot be changed. Raises MapError for corners that make no polygon."""
    corners = np.array(polygon, float)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise MapError("a polygon has fewer than three corners", fix="[[x, y], [x, y], [x, y], …] in metres")
    if not (np.abs(corners) < _FARTHEST_M).all():
        raise MapError("a polygon has corners that are no place on earth", fix="metres in the frame map")
    shape = shapely.Polygon(corners)
    if not shape.is_valid or shape.area < _SMALLEST_AREA_M2:
        raise MapError("a polygon crosses itself or has no surface", fix="give its corners in the order of its outline")
    corners.setflags(write=False)
    return corners


def cells_in(
    grid: OccupancyGrid, polygon: FloatArray, *, is_generous: bool = False
) -> tuple[tuple[slice, slice], BoolArray]:
    """Cells whose middles lie in a polygon (N, 2); with `is_generous`, those that it touches.

    Returns the rows and columns of the grid that the polygon reaches, and (h, w) which of these cells it has.
    """
    shape = shapely.Polygon(polygon)
    shapely.prepare(shape)
    low = np.clip(grid.cells_at(polygon.min(axis=0)), 0, grid.kind.shape)
    high = np.clip(grid.cells_at(polygon.max(axis=0)) + 1, low, grid.kind.shape)
    window = slice(*(int(end[0]) for end in (low, high))), slice(*(int(end[1]) for end in (low, high)))
    inside = np.zeros(high - low, bool)
    columns, half = np.arange(window[1].start, window[1].stop), 0.5 * grid.resolution_m
    at_once = max(_CELLS_AT_ONCE // max(len(columns), 1), 1)
    for begin in range(0, len(inside) if len(columns) else 0, at_once):
        rows = window[0].start + np.arange(begin, min(begin + at_once, len(inside)))
        x, y = np.moveaxis(grid.middle_of(np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)), -1, 0)
        if is_generous:
            found = shapely.intersects(shape, shapely.box(x - half, y - half, x + half, y + half))
        else:
            found = shapely.contains_xy(shape, x, y)
        inside[begin : begin + at_once] = found
    return window, inside


def roomiest_place(grid: OccupancyGrid, polygon: FloatArray) -> FloatArray | None:
    """The free place in a polygon that is farthest from the polygon's edge and from all that is not known to be free.

    To within a cell: of places that have as much room but for less than a cell, as along the middle of a corridor, it
    is the one that is nearest to the polygon's centroid.

    Args:
        grid: of the map.
        polygon: (N, 2) corners in `map`, metres.

    Returns (2,) x and y in `map`, the middle of a cell; None where the polygon has no free cell.
    """
    (rows, columns), inside = cells_in(grid, polygon)
    is_free = inside & (grid.occupancy[rows, columns] == FREE)
    if not is_free.any():
        return None
    # Beyond the polygon, and so beyond the grid, no room counts.
    padded = np.pad(is_free, 1).astype(np.uint8)
    room = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    middles = grid.middle_of(np.argwhere(is_free & (room > room.max() - 1)) + [rows.start, columns.start])
    centroid = shapely.Polygon(polygon).centroid
    off_m = np.linalg.norm(middles - [centroid.x, centroid.y], axis=1)
    return np.asarray(middles[np.argmin(off_m)])
