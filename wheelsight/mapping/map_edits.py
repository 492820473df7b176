"""`MapEdits` holds user annotations of a map: keep-out zones, speed zones, corrections and areas.

They are polygons on the floor, in a layer of their own, so that the map can be rebuilt below them. An edit anchored to
a keyframe moves with it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import shapely
from numpy.typing import ArrayLike

from wheelsight.core.errors import MapError
from wheelsight.core.files import StrPath, write_text
from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, IntArray, se3
from wheelsight.core.inputs import Kind
from wheelsight.core.keyframes import KeyframeId
from wheelsight.io.ros_map import FREE, OCCUPIED
from wheelsight.mapping.named_poses import (
    check_anchor,
    checked_name,
    free_names,
    keyframe_number,
    motion_of_anchor,
    name_given_twice,
    nearest_anchor,
    read_list,
    transferred,
)
from wheelsight.mapping.occupancy import CellKind, OccupancyGrid

# Older programs read files of version 1, which have no areas, and of version 2, which have no declared floor.
FORMAT, VERSION = "wheelsight-map-edits", 3
_FILE = Kind("edits of a map", most_mb=16, fix="give a file that MapEdits.save wrote")
# Far more than users draw: applying this many to a floor of 20 × 20 m takes some seconds.
_MOST_EDITS = 10_000
_FIELDS = ("kind", "polygon", "limit_m_s", "keyframe", "T_map_keyframe", "name")


class EditKind(StrEnum):
    """Kinds of edits."""

    KEEP_OUT = "keep_out"
    """Keep-out zone: occupied."""
    SPEED = "speed"
    """Speed zone, with a limit."""
    WIPED = "wiped"
    """Wrong obstacles and drop-offs of the map: free."""
    AREA = "area"
    """A named area, for use as a goal; the grid is unchanged."""
    FLOOR = "floor"
    """Floor that carries the robot, by the word of a person, though no depth comes back: free if unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class MapEdit:
    """An edit: a polygon on the floor.

    Attributes:
        polygon: (N, 2) corners in `map`, metres, in either orientation, not closed.
        limit_m_s: limit of a speed zone, metres per second; else None.
        T_map_keyframe: (4, 4) pose of the keyframe when the polygon was drawn, or None.
        name: name of an area, as in `NamedPose`; else None.

    Raises MapError if the polygon crosses itself, has no area or is beyond 1000 km; the limit is missing, not positive,
    or given for another kind; the name is missing, invalid, or given for another kind; a keyframe without its pose.
    """

    kind: EditKind
    polygon: FloatArray
    limit_m_s: float | None = None
    keyframe: KeyframeId | None = None
    T_map_keyframe: FloatArray | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "polygon", checked_corners(self.polygon))
        if (self.kind == EditKind.SPEED) != (self.limit_m_s is not None):
            raise MapError(
                f"limit_m_s is {self.limit_m_s} of {self.kind}", fix="speed zones have a limit, no others do"
            )
        if self.limit_m_s is not None and not 0 < self.limit_m_s < math.inf:
            raise MapError(f"limit_m_s is {self.limit_m_s:g}", fix="metres a second, over 0; or a keep-out zone")
        if (self.kind == EditKind.AREA) != (self.name is not None):
            raise MapError(f"name is {self.name!r} of {self.kind}", fix="areas have a name, no others do")
        if self.name is not None:
            object.__setattr__(self, "name", checked_name(self.name))
        check_anchor(self)

    def anchored(self, keyframe: KeyframeId, T_map_keyframe: ArrayLike) -> MapEdit:
        """Return the edit attached to a keyframe that is now at (4, 4)."""
        return replace(self, keyframe=keyframe, T_map_keyframe=np.array(T_map_keyframe, float))

    def attached_to_nearest(self, T_map_keyframe: ArrayLike, among: IntArray) -> MapEdit:
        """Return the edit attached to the nearest of keyframes `among` (N,), given poses (K, 4, 4) of all.

        The polygon stays where it is now. Without keyframes, the edit is attached to none.
        """
        return replace(self, **nearest_anchor(self.polygon.mean(axis=0), T_map_keyframe, among))

    def moved_to_now(self, T_map_keyframe: FloatArray) -> MapEdit:
        """Return the edit with its polygon at the current keyframe pose."""
        return replace(self, polygon=self.polygon_now(T_map_keyframe))

    def polygon_now(self, T_map_keyframe: ArrayLike) -> FloatArray:
        """Return the corners (N, 2) at the current keyframe pose, given poses (K, 4, 4) by number."""
        T_new_old = motion_of_anchor(self, T_map_keyframe)
        if T_new_old is None:
            return self.polygon
        corners = np.c_[self.polygon, np.zeros(len(self.polygon))]
        return np.asarray(se3.apply(T_new_old, corners)[:, :2])


@dataclass(frozen=True, slots=True, eq=False)
class MapEdits:
    """All edits of a map, at most 10 000, in the order in which they were made. Of overlapping edits, the last applies.

    Raises MapError if two areas have the same name, or there are too many edits.
    """

    edits: tuple[MapEdit, ...] = ()

    def __post_init__(self) -> None:
        if len(self.edits) > _MOST_EDITS:
            raise MapError(f"there are more than {_MOST_EDITS:,} edits", fix="remove some")
        twice = name_given_twice(self.area_names)
        if twice is not None:
            raise MapError(f"two areas are called {twice!r}", fix="each name once")

    def __len__(self) -> int:
        return len(self.edits)

    @property
    def areas(self) -> tuple[MapEdit, ...]:
        """Edits that are areas."""
        return tuple(edit for edit in self.edits if edit.kind == EditKind.AREA)

    @property
    def area_names(self) -> tuple[str, ...]:
        """Names of the areas, in order."""
        return tuple(sorted(area.name for area in self.areas if area.name is not None))

    def with_edit(self, edit: MapEdit) -> MapEdits:
        """Return edits with one more at the end; an area replaces the one with its name."""
        others = (one for one in self.edits if edit.name is None or one.name != edit.name)
        return MapEdits((*others, edit))

    def beside(self, other: MapEdits) -> MapEdits:
        """Return both. If both have an area with the same name, the other one's gets a number appended."""
        names = free_names((edit.name for edit in other.edits), self.area_names)
        renamed = [replace(edit, name=name) for edit, name in zip(other.edits, names, strict=True)]
        return MapEdits((*self.edits, *renamed))

    def applied(self, grid: OccupancyGrid, T_map_keyframe: ArrayLike = ()) -> OccupancyGrid:
        """Return a grid with the edits applied; speed zones and areas do not change cells.

        A keep-out zone changes every cell that it touches, a wiped polygon the cells with their centres in it. Outside
        the grid, edits have no effect.

        Args:
            grid: grid of the same map.
            T_map_keyframe: (K, 4, 4) current keyframe poses by number; needed if any edit is anchored.

        Raises ArgumentError if the pose of an anchor is missing.
        """
        kind, occupancy = grid.kind.copy(), grid.occupancy.copy()
        for edit in self.edits:
            if edit.kind == EditKind.KEEP_OUT:
                window, inside = cells_in(grid, edit.polygon_now(T_map_keyframe), is_generous=True)
                kind[window][inside], occupancy[window][inside] = CellKind.KEEP_OUT, OCCUPIED
            elif edit.kind == EditKind.WIPED:
                window, inside = cells_in(grid, edit.polygon_now(T_map_keyframe))
                inside &= kind[window] >= CellKind.OBSTACLE
                kind[window][inside], occupancy[window][inside] = CellKind.FREE, FREE
            elif edit.kind == EditKind.FLOOR:
                window, inside = cells_in(grid, edit.polygon_now(T_map_keyframe))
                inside &= (kind[window] == CellKind.UNKNOWN) | (kind[window] == CellKind.DROP_OFF)
                kind[window][inside], occupancy[window][inside] = CellKind.FREE, FREE
        return replace(grid, kind=kind, occupancy=occupancy)

    def limits_m_s(self, grid: OccupancyGrid, T_map_keyframe: ArrayLike = ()) -> Float32Array:
        """Return the speed limit (H, W) of each cell of a grid; infinite outside speed zones. Raises as `applied`."""
        limits = np.full(grid.kind.shape, np.inf, np.float32)
        for edit in self.edits:
            if edit.limit_m_s is not None:
                window, inside = cells_in(grid, edit.polygon_now(T_map_keyframe), is_generous=True)
                limits[window][inside] = edit.limit_m_s
        return limits

    def transferred(self, T_map_keyframe: ArrayLike, numbers: IntArray, *, is_same_frame: bool = True) -> MapEdits:
        """Return the edits for a map made of this one's keyframes.

        Edits of a removed keyframe are attached to the nearest remaining one; if its pose is unknown, as drawn.

        Args:
            T_map_keyframe: (K, 4, 4) poses of this map.
            numbers: (K,) number of each keyframe in the other map; -1 if removed.
            is_same_frame: if False, edits without a keyframe are attached to the nearest one, too.
        """
        return MapEdits(transferred(self.edits, T_map_keyframe, numbers, is_same_frame))

    def save(self, path: StrPath) -> None:
        """Write the edits as JSON, atomically. Raises OutputError."""
        kinds = {edit.kind for edit in self.edits}
        version = VERSION if EditKind.FLOOR in kinds else 2 if EditKind.AREA in kinds else 1
        listed = []
        for edit in self.edits:
            T = None if edit.T_map_keyframe is None else edit.T_map_keyframe.tolist()
            values = (edit.kind.value, edit.polygon.tolist(), edit.limit_m_s, edit.keyframe, T, edit.name)
            listed.append({name: value for name, value in zip(_FIELDS, values, strict=True) if value is not None})
        document = {"format": FORMAT, "version": version, "edits": listed}
        write_text(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n")

    @classmethod
    def load(cls, path: StrPath) -> MapEdits:
        """Read a file written by `save`. Raises MapError if it is missing, of another format or newer, or has an
        invalid edit.
        """
        path = Path(path)
        listed = read_list(path, _FILE, (FORMAT, VERSION), "edits")
        if len(listed) > _MOST_EDITS:
            problem = f"holds {len(listed):,} edits, more than {_MOST_EDITS:,}"
            raise MapError(problem, path=path, fix="is it the right file?")
        edits = []
        for number, fields in enumerate(listed):
            try:
                edits.append(_edit(fields))
            except MapError as error:
                raise MapError(f"edit {number}: {error.problem}", path=path, fix=error.fix) from error
        try:
            return cls(tuple(edits))
        except MapError as error:
            raise MapError(error.problem, path=path, fix=error.fix) from error


def _edit(fields: Any) -> MapEdit:
    """Return the edit of JSON fields. Raises MapError."""
    if not isinstance(fields, dict) or not set(fields) <= set(_FIELDS):
        raise MapError("is no edit", fix=f"its fields are {', '.join(_FIELDS)}")
    kinds = [kind.value for kind in EditKind]
    if fields.get("kind") not in kinds:
        raise MapError(f"kind is {fields.get('kind')!r}", fix=f"one of {', '.join(kinds)}")
    limit, keyframe, T, called = (fields.get(name) for name in _FIELDS[2:])
    if limit is not None and (isinstance(limit, bool) or not isinstance(limit, int | float)):
        raise MapError(f"limit_m_s is {limit!r}", fix="metres a second")
    number = keyframe_number(keyframe, "keyframe")
    pose = None if T is None else _numbers(T, "T_map_keyframe", (4, 4))
    polygon = _numbers(fields.get("polygon"), "polygon", (-1, 2))
    return MapEdit(EditKind(fields["kind"]), polygon, limit, number, pose, called)


def _numbers(value: Any, name: str, shape: Sequence[int]) -> FloatArray:
    try:
        found = np.array(value, float)
        is_right = found.ndim == 2 and all(want in (-1, have) for want, have in zip(shape, found.shape, strict=True))
    except (TypeError, ValueError):
        is_right = False
    if not is_right:
        raise MapError(f"{name} is not a table of numbers", fix=f"{shape[1]} numbers a row")
    return found


def checked_corners(polygon: ArrayLike) -> FloatArray:
    """Return read-only corners (N, 2) in metres. Raises MapError if they are not a polygon."""
    corners = np.array(polygon, float)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise MapError("a polygon has fewer than three corners", fix="[[x, y], [x, y], [x, y], …] in metres")
    if not (np.abs(corners) < _FARTHEST_M).all():
        raise MapError("a polygon has corners beyond 1000 km", fix="metres in the frame map")
    shape = shapely.Polygon(corners)
    if not shape.is_valid or shape.area < _SMALLEST_AREA_M2:
        raise MapError("a polygon crosses itself or has no surface", fix="give its corners in the order of its outline")
    corners.setflags(write=False)
    return corners


_SMALLEST_AREA_M2 = 1e-6
_FARTHEST_M = 1e6
# Number of cells processed at once: each cell of a generous zone is a shape of some hundred bytes.
_CELLS_AT_ONCE = 100_000


def cells_in(
    grid: OccupancyGrid, polygon: FloatArray, *, is_generous: bool = False
) -> tuple[tuple[slice, slice], BoolArray]:
    """Return the cells with centres in a polygon (N, 2), or with `is_generous` those that it touches.

    The result is the window of rows and columns that the polygon reaches, and (h, w) which of its cells are inside.
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
    """Return the free cell centre of a polygon that is farthest from its edge and from all cells not known to be free.

    Of cells with as much room, within a cell, as along the middle of a corridor, it is the one nearest to the polygon's
    centroid.

    Args:
        polygon: (N, 2) corners in `map`, metres.

    Returns (2,) x and y in `map`; None if the polygon has no free cell.
    """
    (rows, columns), inside = cells_in(grid, polygon)
    is_free = inside & (grid.occupancy[rows, columns] == FREE)
    if not is_free.any():
        return None
    # Cells outside the polygon, and outside the grid, count as occupied.
    padded = np.pad(is_free, 1).astype(np.uint8)
    room = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    middles = grid.middle_of(np.argwhere(is_free & (room > room.max() - 1)) + [rows.start, columns.start])
    centroid = shapely.Polygon(polygon).centroid
    off_m = np.linalg.norm(middles - [centroid.x, centroid.y], axis=1)
    return np.asarray(middles[np.argmin(off_m)])
