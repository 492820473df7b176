"""MapEdits: what a person says of a map: where not to drive, where to drive slowly, and what is not there.

They are a layer of their own: the map can be made anew below them. One that is anchored at a keyframe moves with it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike

from wheelsight.errors import ArgumentError, MapError
from wheelsight.files import StrPath, write_text
from wheelsight.geometry import BoolArray, Float32Array, FloatArray, IntArray, se3
from wheelsight.inputs import Kind
from wheelsight.keyframes import KeyframeId
from wheelsight.mapping.json_lists import read_list
from wheelsight.mapping.occupancy import CellKind, OccupancyGrid

FORMAT, VERSION = "wheelsight-map-edits", 1
_FILE = Kind("edits of a map", most_mb=16, fix="give a file that MapEdits.save wrote")
_FIELDS = ("kind", "polygon", "limit_m_s", "keyframe", "T_map_keyframe")
_SMALLEST_AREA_M2 = 1e-6
_FARTHEST_M = 1e6


class EditKind(StrEnum):
    """What an edit says."""

    KEEP_OUT = "keep_out"
    """Nobody drives there: occupied."""
    SPEED = "speed"
    """Nobody drives faster there than its limit."""
    WIPED = "wiped"
    """Obstacles and drop-offs that the map has there are none: free."""


@dataclass(frozen=True, slots=True, eq=False)
class MapEdit:
    """One edit: a polygon on the floor.

    Attributes:
        kind: what it says.
        polygon: (N, 2) corners in `map`, metres, in either direction, not closed.
        limit_m_s: of a speed zone, metres a second; else None.
        keyframe: with which it moves, or None.
        T_map_keyframe: (4, 4) where that was when the polygon was drawn, or None.

    Raises:
        MapError: a polygon that crosses itself, has no surface or lies beyond 1000 km; a limit that is missing, not
            over 0, or of another kind; a keyframe without its pose.
    """

    kind: EditKind
    polygon: FloatArray
    limit_m_s: float | None = None
    keyframe: KeyframeId | None = None
    T_map_keyframe: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "polygon", _corners(self.polygon))
        if (self.kind == EditKind.SPEED) != (self.limit_m_s is not None):
            raise MapError(
                f"limit_m_s is {self.limit_m_s} of {self.kind}", fix="speed zones have a limit, no others do"
            )
        if self.limit_m_s is not None and not 0 < self.limit_m_s < math.inf:
            raise MapError(f"limit_m_s is {self.limit_m_s:g}", fix="metres a second, over 0; or a keep-out zone")
        if (self.keyframe is None) != (self.T_map_keyframe is None):
            raise MapError("an anchor is a keyframe and its pose", fix="give both, or neither")
        if self.T_map_keyframe is not None and not se3.is_valid(self.T_map_keyframe):
            raise MapError(f"the pose of keyframe {self.keyframe} is no rigid motion", fix="give SE(3), (4, 4)")

    def anchored(self, keyframe: KeyframeId, T_map_keyframe: ArrayLike) -> MapEdit:
        """The same, which from now on moves with a keyframe that is at (4, 4) now."""
        return replace(self, keyframe=keyframe, T_map_keyframe=np.array(T_map_keyframe, float))

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
    """All edits of a map, in the order in which they were made: where they overlap, the last one counts."""

    edits: tuple[MapEdit, ...] = ()

    def __len__(self) -> int:
        return len(self.edits)

    def applied(self, grid: OccupancyGrid, T_map_keyframe: ArrayLike = ()) -> OccupancyGrid:
        """A grid with what they say of its cells; speed zones say nothing of these.

        A keep-out zone has every cell that it touches, what is wiped those whose middles lie in it. Beyond the grid
        nothing is said.

        Args:
            grid: of the same map.
            T_map_keyframe: (K, 4, 4) where keyframes are by now, by number; needed where any edit is anchored.

        Raises:
            ArgumentError: the pose of an anchor is missing.
        """
        for edit in self.edits:
            polygon = edit.polygon_now(T_map_keyframe)
            if edit.kind == EditKind.KEEP_OUT:
                grid = grid.changed(_cells(grid, polygon, is_generous=True), CellKind.KEEP_OUT)
            elif edit.kind == EditKind.WIPED:
                grid = grid.changed(_cells(grid, polygon) & (grid.kind >= CellKind.OBSTACLE), CellKind.FREE)
        return grid

    def limits_m_s(self, grid: OccupancyGrid, T_map_keyframe: ArrayLike = ()) -> Float32Array:
        """(H, W) how fast one may drive in each cell of a grid; infinite where no zone says. Raises as `applied`."""
        limits = np.full(grid.kind.shape, np.inf, np.float32)
        for edit in self.edits:
            if edit.limit_m_s is not None:
                limits[_cells(grid, edit.polygon_now(T_map_keyframe), is_generous=True)] = edit.limit_m_s
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
            if edit.keyframe is None and is_same_frame:
                carried.append(edit)
            elif edit.keyframe is not None and numbers[edit.keyframe] >= 0:
                carried.append(replace(edit, keyframe=KeyframeId(int(numbers[edit.keyframe]))))
            elif len(kept):
                is_lost = edit.keyframe is not None and not np.isfinite(table[edit.keyframe]).all()
                drawn = edit.polygon if is_lost else edit.polygon_now(table)
                now = replace(edit, polygon=drawn, keyframe=None, T_map_keyframe=None)
                off_m = np.linalg.norm(table[kept, :2, 3] - now.polygon.mean(axis=0), axis=1)
                nearest = int(kept[np.argmin(off_m)])
                carried.append(now.anchored(KeyframeId(int(numbers[nearest])), table[nearest]))
        return MapEdits(tuple(carried))

    def save(self, path: StrPath) -> None:
        """Write them as JSON, atomically. Raises OutputError."""
        document = {"format": FORMAT, "version": VERSION, "edits": [_told(edit) for edit in self.edits]}
        write_text(path, json.dumps(document, indent=1) + "\n")

    @classmethod
    def load(cls, path: StrPath) -> MapEdits:
        """Read what `save` wrote. Raises MapError: it is missing, no such file, newer, or an edit is wrong."""
        path = Path(path)
        listed = read_list(path, _FILE, (FORMAT, VERSION), "edits")
        edits = []
        for number, fields in enumerate(listed):
            try:
                edits.append(_edit(fields))
            except MapError as error:
                raise MapError(f"edit {number}: {error.problem}", path=path, fix=error.fix) from error
        return cls(tuple(edits))


def _told(edit: MapEdit) -> dict[str, Any]:
    T = None if edit.T_map_keyframe is None else edit.T_map_keyframe.tolist()
    values = (edit.kind.value, edit.polygon.tolist(), edit.limit_m_s, edit.keyframe, T)
    return {name: value for name, value in zip(_FIELDS, values, strict=True) if value is not None}


def _edit(fields: Any) -> MapEdit:
    """Raises MapError."""
    if not isinstance(fields, dict) or not set(fields) <= set(_FIELDS):
        raise MapError("is no edit", fix=f"its fields are {', '.join(_FIELDS)}")
    kinds = [kind.value for kind in EditKind]
    if fields.get("kind") not in kinds:
        raise MapError(f"kind is {fields.get('kind')!r}", fix=f"one of {', '.join(kinds)}")
    limit, keyframe, T = (fields.get(name) for name in _FIELDS[2:])
    if limit is not None and (isinstance(limit, bool) or not isinstance(limit, int | float)):
        raise MapError(f"limit_m_s is {limit!r}", fix="metres a second")
    if keyframe is not None and (type(keyframe) is not int or keyframe < 0):
        raise MapError(f"keyframe is {keyframe!r}", fix="the number of a keyframe")
    number = None if keyframe is None else KeyframeId(keyframe)
    pose = None if T is None else _numbers(T, "T_map_keyframe", (4, 4))
    polygon = _numbers(fields.get("polygon"), "polygon", (-1, 2))
    return MapEdit(EditKind(fields["kind"]), polygon, limit, number, pose)


def _numbers(value: Any, name: str, shape: Sequence[int]) -> FloatArray:
    try:
        found = np.array(value, float)
        is_right = found.ndim == 2 and all(want in (-1, have) for want, have in zip(shape, found.shape, strict=True))
    except (TypeError, ValueError):
        is_right = False
    if not is_right:
        raise MapError(f"{name} is no table of numbers", fix=f"{shape[1]} numbers a row")
    return found


def _corners(polygon: ArrayLike) -> FloatArray:
    """Raises MapError for corners that make no polygon."""
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


def _cells(grid: OccupancyGrid, polygon: FloatArray, *, is_generous: bool = False) -> BoolArray:
    """(H, W) cells whose middles lie in a polygon; with `is_generous`, those that it touches."""
    inside = np.zeros(grid.kind.shape, bool)
    low = np.maximum(grid.cells_at(polygon.min(axis=0)), 0)
    high = np.minimum(grid.cells_at(polygon.max(axis=0)) + 1, grid.kind.shape)
    if (low >= high).any():
        return inside
    rows, columns = (np.arange(a, b) for a, b in zip(low.tolist(), high.tolist(), strict=True))
    cells = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)
    shape, (x, y) = shapely.Polygon(polygon), np.moveaxis(grid.middle_of(cells), -1, 0)
    shapely.prepare(shape)
    if is_generous:
        half = 0.5 * grid.resolution_m
        found = shapely.intersects(shape, shapely.box(x - half, y - half, x + half, y + half))
    else:
        found = shapely.contains_xy(shape, x, y)
    inside[low[0] : high[0], low[1] : high[1]] = found
    return inside
