"""Rooms and doorways of a floor plan: free space falls apart where it is narrow, by a watershed of the way to walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from wheelsight.geometry import BoolArray, Float32Array, FloatArray, Int32Array
from wheelsight.simulation.worlds.floor_plan._free_space import FreeSpace

# Doors have 0.7 to 1.2 m between their jambs (DIN 18101), in scans up to 1.4.
_NARROWEST_M, _WIDEST_M = 0.65, 1.4
# What opens behind a doorway is wider than it: half a room's width over half the doorway's.
_OPENS_BY_M = 0.2
_LOOK_M = 0.9  # within which it opens
_JAMB_M = 0.3  # of wall beside a doorway; less is a pillar, or furniture
_THICKEST_M = 0.6
_APART_M = 0.8
_STRIDE = 2  # of cells that rooms are told by


@dataclass(frozen=True, slots=True)
class Doorway:
    """A gap in a wall that a door fits in.

    Attributes:
        left, right: its jambs in `map`, metres, in the middle of the wall.
        thickness_m: of the wall.
    """

    left: tuple[float, float]
    right: tuple[float, float]
    thickness_m: float

    @property
    def width_m(self) -> float:
        """Between the jambs."""
        return float(np.hypot(self.right[0] - self.left[0], self.right[1] - self.left[1]))

    @property
    def middle(self) -> tuple[float, float]:
        """Between the jambs, metres."""
        return (self.left[0] + self.right[0]) / 2, (self.left[1] + self.right[1]) / 2

    @property
    def yaw_rad(self) -> float:
        """Of the direction from left to right."""
        return float(np.arctan2(self.right[1] - self.left[1], self.right[0] - self.left[0]))

    @property
    def onward(self) -> FloatArray:
        """(2,) unit vector through the doorway, to the left of whoever looks from its left jamb to the right one."""
        return np.array([-np.sin(self.yaw_rad), np.cos(self.yaw_rad)])


@dataclass(frozen=True, eq=False)
class Rooms:
    """The parts of a floor between its narrow places.

    Attributes:
        labels: (R', C') int32, the room of every second cell in each direction, -1 where none is.
        doorways: between them.
    """

    labels: Int32Array
    doorways: tuple[Doorway, ...]

    def room_at(self, space: FreeSpace, xy_map: FloatArray) -> Int32Array:
        """(...) the room of points (..., 2) in `map`, -1 for none."""
        cells = np.minimum(space.cells_at(xy_map) // _STRIDE, np.array(self.labels.shape) - 1)
        return np.asarray(self.labels[cells[..., 0], cells[..., 1]], np.int32)


def find_rooms(space: FreeSpace) -> Rooms:
    """The rooms of a floor, and the doorways where they meet."""
    away_m = space.distance_m()
    labels, saddles = _basins(away_m[::_STRIDE, ::_STRIDE])
    boundary = space.shape.boundary
    found: list[Doorway] = []
    for cell in saddles:
        place = space.middle_of(np.array(cell) * _STRIDE)
        doorway = _doorway_at(space, boundary, away_m, place)
        if doorway is not None and all(np.hypot(*np.subtract(doorway.middle, d.middle)) > _APART_M for d in found):
            found.append(doorway)
    return Rooms(labels, tuple(found))


def _basins(away_m: Float32Array) -> tuple[Int32Array, list[tuple[int, int]]]:
    """Labels (R, C) of the basins around the roomiest places, and the cells (row, column) where two of them meet.

    Cells are flooded from the roomiest on; basins that meet join, unless both are wider by _OPENS_BY_M than where
    they meet, and that is as narrow as a doorway.
    """
    rows, columns = away_m.shape
    flat = np.pad(away_m, 1).ravel()
    width = columns + 2
    order = np.flatnonzero(flat)[np.argsort(-flat[flat > 0], kind="stable")].tolist()
    values = flat.tolist()
    label = [-1] * len(flat)
    parent: list[int] = []
    peak: list[float] = []
    saddles: list[int] = []
    around = (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1)

    def root(k: int) -> int:
        while parent[k] != k:
            parent[k] = parent[parent[k]]
            k = parent[k]
        return k

    for cell in order:
        near = {root(label[cell + step]) for step in around if label[cell + step] >= 0}
        if not near:
            label[cell] = len(parent)
            parent.append(len(parent))
            peak.append(values[cell])
            continue
        best, *others = sorted(near, key=lambda k: -peak[k])
        label[cell] = best
        for other in others:
            if peak[other] >= values[cell] + _OPENS_BY_M and 2 * values[cell] <= _WIDEST_M:
                saddles.append(cell)
            else:
                parent[other] = best
    names = np.array([root(k) for k in range(len(parent))] + [-1], np.int32)
    labels = names[np.array(label)].reshape(rows + 2, width)[1:-1, 1:-1]
    return np.asarray(labels, np.int32), [(cell // width - 1, cell % width - 1) for cell in saddles]


def _doorway_at(
    space: FreeSpace, boundary: shapely.Geometry, away_m: Float32Array, place: FloatArray
) -> Doorway | None:
    """The doorway around a place, if it is one: jambs of wall, wider on both sides."""
    near = shapely.intersection(boundary, shapely.Point(place).buffer(_WIDEST_M))
    if near.is_empty:
        return None
    left = _nearest(near, place)
    across = (place - left) / max(float(np.hypot(*(place - left))), 1e-9)
    onward = np.array([-across[1], across[0]])
    # The other jamb lies about opposite: within 45° of the line from the first through the place.
    reach = 2 * _WIDEST_M
    wedge = shapely.Polygon([place, place + reach * (across + onward), place + reach * (across - onward)])
    opposite = shapely.intersection(near, wedge)
    if opposite.is_empty:
        return None
    right = _nearest(opposite, left)
    width_m = float(np.hypot(*(right - left)))
    if not _NARROWEST_M <= width_m <= _WIDEST_M:
        return None
    across = (right - left) / width_m
    onward = np.array([-across[1], across[0]])
    middle = (left + right) / 2
    both = middle + _LOOK_M * np.array([onward, -onward])
    cells = space.cells_at(both)
    if (away_m[cells[:, 0], cells[:, 1]] < width_m / 2 + _OPENS_BY_M / 2).any():
        return None
    return _in_wall(space, middle, across, width_m)


def _in_wall(space: FreeSpace, middle: FloatArray, across: FloatArray, width_m: float) -> Doorway | None:
    """The doorway of that width, with the thickness of the wall on both of its sides; None where there is no wall."""
    onward = np.array([-across[1], across[0]])
    depths_m = np.arange(-_THICKEST_M, _THICKEST_M + 0.01, space.cell_m / 2)
    out_m = np.arange(width_m / 2 + space.cell_m, width_m / 2 + _JAMB_M, space.cell_m)
    sides = np.concatenate([out_m, -out_m])
    places = middle + depths_m[:, None, None] * onward + sides[None, :, None] * across
    cells = space.cells_at(places)
    is_wall: BoolArray = (space.grid[cells[..., 0], cells[..., 1]] == 0).all(axis=1)
    centre = len(depths_m) // 2
    if not is_wall[centre - 1 : centre + 2].any():
        return None
    first = last = centre - 1 + int(np.argmax(is_wall[centre - 1 : centre + 2]))
    while first > 0 and is_wall[first - 1]:
        first -= 1
    while last + 1 < len(depths_m) and is_wall[last + 1]:
        last += 1
    thickness_m = float(depths_m[last] - depths_m[first]) + space.cell_m / 2
    if thickness_m > _THICKEST_M:
        return None
    middle = middle + onward * float(depths_m[first] + depths_m[last]) / 2
    left, right = middle - across * width_m / 2, middle + across * width_m / 2
    return Doorway((float(left[0]), float(left[1])), (float(right[0]), float(right[1])), max(thickness_m, 0.08))


def _nearest(shape: shapely.Geometry, place: FloatArray) -> FloatArray:
    """The point (2,) of a shape nearest to a place."""
    return np.array(shapely.shortest_line(shapely.Point(place), shape).coords[-1])
