"""Costmap: where a robot may drive, how far obstacles are, and what driving near to them costs; as a value."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import ArgumentError
from wheelsight.geometry import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from wheelsight.mapping.map_edits import MapEdits
from wheelsight.mapping.occupancy import OccupancyGrid
from wheelsight.navigation import _costmap_kernels as kernels
from wheelsight.navigation.costmap_settings import CostmapSettings
from wheelsight.navigation.fields import CostField
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.live_layer import LiveObstacles
from wheelsight.ros_map import FREE, OCCUPIED

# Where nothing is occupied, distances are so many metres; infinite ones turn into NaN between cells.
FARTHEST_M = 100.0
# A caster's print: what stood on so little floor would have been met by rays.
_HOLE_M2 = 0.02


class CellState(IntEnum):
    """What a cell is for a planner."""

    FREE = 0
    UNKNOWN = 1
    OCCUPIED = 2


@dataclass(frozen=True, slots=True, eq=False)
class StaticLayer:
    """What a map says with its edits, made once for a map.

    Attributes:
        state: (H, W) uint8 of `CellState`.
        speed_m_s: (H, W) float32 fastest speed in zones, infinite elsewhere.
        resolution_m: side of a cell.
        origin: x and y in `map` of the corner of cell (0, 0).
        is_told: (H, W) free floor that nobody has seen: somebody said so. None: none is.
    """

    state: ByteArray
    speed_m_s: Float32Array
    resolution_m: float
    origin: tuple[float, float]
    is_told: BoolArray | None = None

    @property
    def is_unseen(self) -> BoolArray:
        """(H, W) floor of which nothing is known, or by what somebody said alone."""
        return _unseen(self.state, self.is_told)

    @classmethod
    def of(cls, grid: OccupancyGrid, edits: MapEdits | None = None, T_map_keyframe: ArrayLike = ()) -> StaticLayer:
        """Of a map and what people said of it. `T_map_keyframe` and what it raises: as `MapEdits.applied`."""
        edits = edits or MapEdits()
        edited = edits.applied(grid, T_map_keyframe)
        occupancy = edited.occupancy
        state = np.full(occupancy.shape, CellState.UNKNOWN, np.uint8)
        state[occupancy == FREE] = CellState.FREE
        # Between free and occupied nobody is sure: that is unknown.
        state[occupancy >= OCCUPIED] = CellState.OCCUPIED
        _fill_holes(state, grid.resolution_m)
        return cls(state, edits.limits_m_s(edited, T_map_keyframe), grid.resolution_m, grid.origin)

    def window(self, xy: ArrayLike, size_m: float) -> StaticLayer:
        """A square of it about a place (2,), metres; beyond its edges all is unknown. What was told is seen there."""
        side = math.ceil(size_m / self.resolution_m)
        column, row = np.floor((np.asarray(xy, float) - self.origin) / self.resolution_m).astype(int) - side // 2
        low = np.clip([row, column], 0, self.state.shape)
        high = np.clip([row + side, column + side], 0, self.state.shape)
        state = np.full((side, side), CellState.UNKNOWN, np.uint8)
        speed = np.full((side, side), np.inf, np.float32)
        of = slice(low[0], high[0]), slice(low[1], high[1])
        to = slice(low[0] - row, high[0] - row), slice(low[1] - column, high[1] - column)
        state[to], speed[to] = self.state[of], self.speed_m_s[of]
        origin = self.origin[0] + column * self.resolution_m, self.origin[1] + row * self.resolution_m
        return StaticLayer(state, speed, self.resolution_m, (float(origin[0]), float(origin[1])))

    def state_at(self, xy: ArrayLike) -> ByteArray:
        """(N,) `CellState` at points (N, 2); beyond its edges all is unknown."""
        at = np.floor((np.asarray(xy, float) - self.origin) / self.resolution_m).astype(np.int64)[:, ::-1]
        inside = ((at >= 0) & (at < self.state.shape)).all(axis=1)
        found = np.full(len(at), CellState.UNKNOWN, np.uint8)
        found[inside] = self.state[at[inside, 0], at[inside, 1]]
        return found

    def grown(self, bounds: ArrayLike) -> StaticLayer:
        """By unknown cells until it holds the low and the high corner (2, 2) of a box, metres."""
        size_m, (height, width) = self.resolution_m, self.state.shape
        corners = (np.asarray(bounds, float) - self.origin) / size_m
        left, bottom = np.maximum(-np.floor(corners[0]), 0).astype(int)
        right, top = np.maximum(np.ceil(corners[1]) - (width, height), 0).astype(int)
        around = (int(bottom), int(top)), (int(left), int(right))
        state = np.pad(self.state, around, constant_values=int(CellState.UNKNOWN))
        speed = np.pad(self.speed_m_s, around, constant_values=np.inf)
        origin = float(self.origin[0] - left * size_m), float(self.origin[1] - bottom * size_m)
        is_told = None if self.is_told is None else np.pad(self.is_told, around)
        return StaticLayer(state, speed, size_m, origin, is_told)

    def with_floor(self, is_floor: BoolArray, *, is_told: bool = False) -> StaticLayer:
        """The same, with cells (H, W) known to be free of which nothing else is known; or somebody only said so."""
        is_new = is_floor & (self.state == CellState.UNKNOWN)
        state = self.state.copy()
        state[is_new] = CellState.FREE
        told = self.is_told
        if is_told:
            told = is_new if told is None else told | is_new
        return StaticLayer(state, self.speed_m_s, self.resolution_m, self.origin, told)


@dataclass(frozen=True, slots=True, eq=False)
class Costmap:
    """The floor in square cells, along the axes of its frame. What lies outside of it is forbidden.

    Attributes:
        state: (H, W) uint8 of `CellState`; row 0 is the least y.
        is_lethal: (H, W) no part of the robot may be there: occupied, or unknown where that is forbidden.
        distance_m: (H, W) float32 from each cell's centre to that of the nearest lethal one; 0 in these.
        cost: (H, W) float32 from 0, free, to 1, where the centre of rotation can never be; between, it falls with
            distance to obstacles.
        speed_m_s: (H, W) float32 fastest speed in zones, infinite elsewhere.
        resolution_m: side of a cell.
        origin: x and y in metres of the corner of cell (0, 0).
        frame: `map` or `odom`.
        inscribed_m: of the footprint that it was made for.
        settings: by which it was made.
        is_told: as of `StaticLayer`.
        dearness: (H, W) float32 how many times as much a metre costs; None: once.
    """

    state: ByteArray
    is_lethal: BoolArray
    distance_m: Float32Array
    cost: Float32Array
    speed_m_s: Float32Array
    resolution_m: float
    origin: tuple[float, float]
    frame: str
    inscribed_m: float
    settings: CostmapSettings
    is_told: BoolArray | None = None
    dearness: Float32Array | None = None

    @property
    def is_unseen(self) -> BoolArray:
        """As of `StaticLayer`."""
        return _unseen(self.state, self.is_told)

    @classmethod
    def of(
        cls,
        static: StaticLayer,
        footprint: Footprint,
        settings: CostmapSettings | None = None,
        live: LiveObstacles | None = None,
        T_map_live: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Costmap:
        """In the frame `map`: of a map, and of what the camera sees by now.

        Args:
            static: of the map.
            footprint: whose inscribed circle costs begin at.
            settings: or the defaults.
            live: obstacles; they add to the map's, and free none of them.
            T_map_live: (3,) x, y, yaw of their frame in `map`.

        Raises ArgumentError where that is not finite.
        """
        state = static.state
        if live is not None:
            state = state.copy()
            _put(live, np.asarray(T_map_live, float), static, state)
        place = static.resolution_m, static.origin, "map"
        made = _made(state, static.speed_m_s, place, footprint.inscribed_m, settings or CostmapSettings())
        return replace(made, is_told=static.is_told)

    @property
    def field(self) -> CostField:
        """As controllers take it."""
        return CostField(self.distance_m, self.cost, self.resolution_m, self.origin, self.speed_m_s)

    @classmethod
    def of_live(cls, live: LiveObstacles, footprint: Footprint, settings: CostmapSettings | None = None) -> Costmap:
        """In the frame of live obstacles, where no map is: what shows none is free."""
        state = np.where(live.is_occupied, CellState.OCCUPIED, CellState.FREE).astype(np.uint8)
        speed = np.full(state.shape, np.inf, np.float32)
        place = live.resolution_m, live.origin, live.frame
        return _made(state, speed, place, footprint.inscribed_m, settings or CostmapSettings())

    def standing_at(self, footprint: Footprint, pose: ArrayLike) -> Costmap:
        """The same where a robot stands at a pose (3,): floor below it that nobody has seen is there."""
        corners = footprint.at(pose)
        low = np.maximum(self.cells_at(corners.min(axis=0)), 0)
        high = np.minimum(self.cells_at(corners.max(axis=0)) + 1, self.state.shape)
        if (low >= high).any():
            return self
        rows, columns = (np.arange(a, b) for a, b in zip(low.tolist(), high.tolist(), strict=True))
        cells = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)
        away = self.middle_of(cells) - np.asarray(pose, float)[:2]
        c, s = np.cos(np.asarray(pose, float)[2]), np.sin(np.asarray(pose, float)[2])
        # Whatever the outline touches: a cell's corners are half a diagonal off its middle.
        grown = footprint.padded(self.resolution_m * np.sqrt(0.5))
        below = grown.contains(away @ np.array([[c, -s], [s, c]]))
        cut = slice(low[0], high[0]), slice(low[1], high[1])
        unknown = below & (self.state[cut] == CellState.UNKNOWN)
        if not unknown.any():
            return self
        state = self.state.copy()
        state[cut][unknown] = CellState.FREE
        place = self.resolution_m, self.origin, self.frame
        made = _made(state, self.speed_m_s, place, self.inscribed_m, self.settings)
        return replace(made, dearness=self.dearness)

    def with_unknown_free(self) -> Costmap:
        """The same as if all unknown floor were free."""
        state = np.where(self.state == CellState.UNKNOWN, CellState.FREE, self.state).astype(np.uint8)
        place = self.resolution_m, self.origin, self.frame
        made = _made(state, self.speed_m_s, place, self.inscribed_m, self.settings)
        return replace(made, dearness=self.dearness)

    def cells_at(self, xy: ArrayLike) -> IntArray:
        """(..., 2) row and column of points (..., 2); they may lie outside."""
        cells = (np.asarray(xy, float) - self.origin) / self.resolution_m
        return np.floor(cells[..., ::-1]).astype(np.int64)

    def middle_of(self, cells: ArrayLike) -> FloatArray:
        """(..., 2) of the middles of cells (..., 2) of row and column."""
        return np.asarray((np.asarray(cells, float)[..., ::-1] + 0.5) * self.resolution_m + self.origin)


def _made(
    state: ByteArray,
    speed_m_s: Float32Array,
    place: tuple[float, tuple[float, float], str],
    inscribed_m: float,
    settings: CostmapSettings,
) -> Costmap:
    """Of the states of cells."""
    resolution_m, origin, frame = place
    is_lethal = state == CellState.OCCUPIED
    if settings.unknown == "forbidden":
        is_lethal |= state == CellState.UNKNOWN
    distance_m = distances_m(is_lethal, resolution_m)
    # To the nearest edge of a cell, as seen along a row or column.
    near_m = 0.5 * resolution_m + inscribed_m
    falls = kernels.Falls(near_m, settings.inflation_m, settings.decay_per_m, settings.unknown_cost)
    cost = kernels.costs(state, is_lethal, distance_m, falls, CellState.UNKNOWN.value)
    return Costmap(state, is_lethal, distance_m, cost, speed_m_s, resolution_m, origin, frame, inscribed_m, settings)


def _unseen(state: ByteArray, is_told: BoolArray | None) -> BoolArray:
    is_unknown = state == CellState.UNKNOWN
    return np.asarray(is_unknown if is_told is None else is_unknown | (is_told & (state == CellState.FREE)))


def _fill_holes(state: ByteArray, resolution_m: float) -> None:
    """Count as free what is unknown, has only free floor about it, and is too small for anything that hides from view.

    Rays miss single cells, of which each would keep a robot away by its own width.
    """
    is_unknown = (state == CellState.UNKNOWN).astype(np.uint8)
    _, labels, about, _ = cv2.connectedComponentsWithStats(is_unknown, connectivity=8)
    is_small = np.asarray(about)[:, cv2.CC_STAT_AREA] * resolution_m**2 <= _HOLE_M2
    beside = cv2.dilate((state == CellState.OCCUPIED).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    is_small[np.unique(np.asarray(labels)[beside])] = False
    is_small[0] = False
    state[is_small[np.asarray(labels)]] = CellState.FREE


def distances_m(is_lethal: BoolArray, resolution_m: float) -> Float32Array:
    """(H, W) exact, from each cell's centre to that of the nearest of some cells; `FARTHEST_M` where there is none."""
    if not is_lethal.any():
        return np.full(is_lethal.shape, FARTHEST_M, np.float32)
    cells = cv2.distanceTransform((~is_lethal).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(np.minimum(cells * resolution_m, FARTHEST_M), np.float32)


def _put(live: LiveObstacles, T_map_live: FloatArray, static: StaticLayer, state: ByteArray) -> None:
    """Mark all cells in which any sixteenth of an occupied cell has its middle."""
    if T_map_live.shape != (3,) or not np.isfinite(T_map_live).all():
        raise ArgumentError(f"T_map_live is {T_map_live}", fix="x, y and yaw of the obstacles' frame in map, finite")
    x, y, yaw = (float(value) for value in T_map_live)
    of = kernels.Cells(live.resolution_m, *live.origin)
    to = kernels.Cells(static.resolution_m, *static.origin)
    kernels.mark_occupied(live.is_occupied, of, (x, y, np.cos(yaw), np.sin(yaw)), to, CellState.OCCUPIED.value, state)
