"""`MapEdits` holds annotations of a map by people: keep-out zones, slow zones, corrections and areas. They are
polygons on the floor and move with keyframes.
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

from wheelsight.core.errors import ArgumentError, MapError
from wheelsight.core.files import StrPath, write_text
from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, IntArray, se3
from wheelsight.core.inputs import Kind
from wheelsight.core.keyframes import KeyframeId
from wheelsight.io.ros_map import FREE, OCCUPIED
from wheelsight.mapping.named_poses import checked_name, free_names, name_given_twice, read_list
from wheelsight.mapping.occupancy import CellKind, OccupancyGrid

# MapEdits: what a person says of a map: where not to drive, where to drive slowly, what is not there, and areas.
#
# They are a layer of their own: the map can be made anew below them. One that is anchored at a keyframe moves with
# it.


# Programs that know no areas read version 1: they refuse what has any, and read all else.
FORMAT, VERSION, VERSION_WITHOUT_AREAS = "wheelsight-map-edits", 2, 1
_FILE = Kind("edits of a map", most_mb=16, fix="give a file that MapEdits.save wrote")
# Far more than people draw: to apply so many to a floor of 20 × 20 m takes some seconds.
_MOST_EDITS = 10_000
_FIELDS = ("kind", "polygon", "limit_m_s", "keyframe", "T_map_keyframe", "name")


class EditKind(StrEnum):
    """What an edit says."""

    KEEP_OUT = "keep_out"
    """Nobody drives there: occupied."""
    SPEED = "speed"
    """Nobody drives faster there than its limit."""
    WIPED = "wiped"
    """Obstacles and drop-offs that the map has there are none: free."""
    AREA = "area"
    """It is called so, as a goal may be; all else is as it was."""


@dataclass(frozen=True, slots=True, eq=False)
class MapEdit:
    """One edit: a polygon on the floor.

    Attributes:
        kind: what it says.
        polygon: (N, 2) corners in `map`, metres, in either direction, not closed.
        limit_m_s: of a speed zone, metres a second; else None.
        keyframe: with which it moves, or None.
        T_map_keyframe: (4, 4) where that was when the polygon was drawn, or None.
        name: of an area, as `NamedPose` has it; else None.

    Raises:
        MapError: a polygon that crosses itself, has no surface or lies beyond 1000 km; a limit that is missing, not
            over 0, or of another kind; a name that is missing, none, or of another kind; a keyframe without its pose.
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
        if (self.keyframe is None) != (self.T_map_keyframe is None):
            raise MapError("an anchor is a keyframe and its pose", fix="give both, or neither")
        if self.T_map_keyframe is not None and not se3.is_valid(self.T_map_keyframe):
            raise MapError(f"the pose of keyframe {self.keyframe} is no rigid motion", fix="give SE(3), (4, 4)")

    def anchored(self, keyframe: KeyframeId, T_map_keyframe: ArrayLike) -> MapEdit:
        """The same, which from now on moves with a keyframe that is at (4, 4) now."""
        return replace(self, keyframe=keyframe, T_map_keyframe=np.array(T_map_keyframe, float))

    def hung_on_nearest(self, T_map_keyframe: ArrayLike, among: IntArray) -> MapEdit:
        """The same, which from now on moves with the nearest of some keyframes (N,), of poses (K, 4, 4) of all.

        Its polygon is where it is now; without any keyframe it stays there.
        """
        if not len(among):
            return replace(self, keyframe=None, T_map_keyframe=None)
        table = np.asarray(T_map_keyframe, float)
        off_m = np.linalg.norm(table[among, :2, 3] - self.polygon.mean(axis=0), axis=1)
        nearest = int(among[np.argmin(off_m)])
        return self.anchored(KeyframeId(nearest), table[nearest])

    def polygon_now(self, T_map_keyframe: ArrayLike) -> FloatArray:
        """(N, 2) corners where its keyframe is by now, of poses (K, 4, 4) by number."""
        if self.keyframe is None or self.T_map_keyframe is None:
            return self.polygon
        table = np.asarray(T_map_keyframe, float)
        if self.keyframe >= len(table) or not np.isfinite(table[self.keyframe]).all():
            raise ArgumentError(f"there is no pose of keyframe {self.keyframe}", fix="give those of the edits' map")
        T_new_old = table[self.keyframe] @ se3.invert(self.T_map_keyframe)
        corners = np.c_[self.polygon, np.zeros(len(self.polygon))]
        return np.asarray(se3.apply(T_new_old, corners)[:, :2])


@dataclass(frozen=True, slots=True, eq=False)
class MapEdits:
    """All edits of a map, 10 000 at most, in the order in which they were made: of those that overlap the last counts.

    Raises:
        MapError: two areas of one name, or too many edits.
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
        """Those that are areas."""
        return tuple(edit for edit in self.edits if edit.kind == EditKind.AREA)

    @property
    def area_names(self) -> tuple[str, ...]:
        """Of the areas, in order."""
        return tuple(sorted(area.name for area in self.areas if area.name is not None))

    def with_edit(self, edit: MapEdit) -> MapEdits:
        """With one more at the end; an area takes the place of the one that has its name."""
        others = (one for one in self.edits if edit.name is None or one.name != edit.name)
        return MapEdits((*others, edit))

    def beside(self, other: MapEdits) -> MapEdits:
        """Both; where both have an area of a name, this one's keeps it, and the other's gets a number behind it."""
        names = free_names((edit.name for edit in other.edits), self.area_names)
        renamed = [replace(edit, name=name) for edit, name in zip(other.edits, names, strict=True)]
        return MapEdits((*self.edits, *renamed))

    def applied(self, grid: OccupancyGrid, T_map_keyframe: ArrayLike = ()) -> OccupancyGrid:
        """A grid with what they say of its cells; speed zones and areas say nothing of these.

        A keep-out zone has every cell that it touches, what is wiped those whose middles lie in it. Beyond the grid
        nothing is said.

        Args:
            grid: of the same map.
            T_map_keyframe: (K, 4, 4) where keyframes are by now, by number; needed where any edit is anchored.

        Raises:
            ArgumentError: the pose of an anchor is missing.
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
        return replace(grid, kind=kind, occupancy=occupancy)

    def limits_m_s(self, grid: OccupancyGrid, T_map_keyframe: ArrayLike = ()) -> Float32Array:
        """(H, W) how fast one may drive in each cell of a grid; infinite where no zone says. Raises as `applied`."""
        limits = np.full(grid.kind.shape, np.inf, np.float32)
        for edit in self.edits:
            if edit.limit_m_s is not None:
                window, inside = cells_in(grid, edit.polygon_now(T_map_keyframe), is_generous=True)
                limits[window][inside] = edit.limit_m_s
        return limits

    def carried(self, T_map_keyframe: ArrayLike, numbers: IntArray, *, is_same_frame: bool = True) -> MapEdits:
        """The edits for a map that is made of this one's keyframes.

        Those whose keyframe goes hang on the nearest one that stays; where nobody knows where it was, as drawn.

        Args:
            T_map_keyframe: (K, 4, 4) of this map.
            numbers: (K,) the number of each in the other map; -1 where it goes.
            is_same_frame: else what hangs on no keyframe is hung on the nearest one, too.
        """
        table, kept = np.asarray(T_map_keyframe, float), np.flatnonzero(numbers >= 0)
        carried = []
        for edit in self.edits:
            # A file may name keyframes that its map never had.
            number = -1 if edit.keyframe is None or edit.keyframe >= len(numbers) else int(numbers[edit.keyframe])
            if edit.keyframe is None and is_same_frame:
                carried.append(edit)
            elif number >= 0:
                carried.append(replace(edit, keyframe=KeyframeId(number)))
            elif len(kept):
                is_lost = edit.keyframe is not None and not np.isfinite(table[edit.keyframe : edit.keyframe + 1]).any()
                now = replace(edit, polygon=edit.polygon if is_lost else edit.polygon_now(table))
                hung = now.hung_on_nearest(table, kept)
                assert hung.keyframe is not None
                carried.append(replace(hung, keyframe=KeyframeId(int(numbers[hung.keyframe]))))
        return MapEdits(tuple(carried))

    def save(self, path: StrPath) -> None:
        """Write them as JSON, atomically. Raises OutputError."""
        version = VERSION if self.areas else VERSION_WITHOUT_AREAS
        document = {"format": FORMAT, "version": version, "edits": [_told(edit) for edit in self.edits]}
        write_text(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n")

    @classmethod
    def load(cls, path: StrPath) -> MapEdits:
        """Read what `save` wrote. Raises MapError: it is missing, no such file, newer, or an edit is wrong."""
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


def _told(edit: MapEdit) -> dict[str, Any]:
    T = None if edit.T_map_keyframe is None else edit.T_map_keyframe.tolist()
    values = (edit.kind.value, edit.polygon.tolist(), edit.limit_m_s, edit.keyframe, T, edit.name)
    return {name: value for name, value in zip(_FIELDS, values, strict=True) if value is not None}


def _edit(fields: Any) -> MapEdit:
    """Raises MapError."""
    if not isinstance(fields, dict) or not set(fields) <= set(_FIELDS):
        raise MapError("is no edit", fix=f"its fields are {', '.join(_FIELDS)}")
    kinds = [kind.value for kind in EditKind]
    if fields.get("kind") not in kinds:
        raise MapError(f"kind is {fields.get('kind')!r}", fix=f"one of {', '.join(kinds)}")
    limit, keyframe, T, called = (fields.get(name) for name in _FIELDS[2:])
    if limit is not None and (isinstance(limit, bool) or not isinstance(limit, int | float)):
        raise MapError(f"limit_m_s is {limit!r}", fix="metres a second")
    if keyframe is not None and (type(keyframe) is not int or keyframe < 0):
        raise MapError(f"keyframe is {keyframe!r}", fix="the number of a keyframe")
    number = None if keyframe is None else KeyframeId(keyframe)
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
        raise MapError(f"{name} is no table of numbers", fix=f"{shape[1]} numbers a row")
    return found


# Polygons on the floor of a map: which cells they have, and where in one of them there is most room.


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
