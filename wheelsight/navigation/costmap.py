"""Costmap: free space, distance to obstacles and cost of each cell.

`StaticLayer` is the map with its edits, from a `Floor`: a map of an earlier session, or one that grows on the way.
`LiveObstacles` are those of recent depth images. `FloorNow` joins both at one moment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import pairwise
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray, IntArray, se2
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.core.robots import Localization
from wheelsight.core.threads import Worker, WorkerInStep
from wheelsight.io.ros_map import FREE, OCCUPIED
from wheelsight.mapping import EditKind, MapEdits, OccupancyGrid, OccupancyMapper, OccupancySettings
from wheelsight.navigation import costmap_kernels as kernels
from wheelsight.navigation.clearance_kernels import CostField
from wheelsight.navigation.settings import FLOOR_SILENT_S, CostmapSettings, Footprint

# Distance where nothing is occupied; infinite ones would become NaN between cells.
FARTHEST_M = 100.0
# Decrease of the cost around obstacles, exp(-decay · distance): at 0.3 m a quarter is left.
_DECAY_PER_M = 5.0
# Area of a caster's print: rays would have hit anything that stands on less floor.
_HOLE_M2 = 0.02


class CellState(IntEnum):
    """State of a cell for a planner."""

    FREE = 0
    UNKNOWN = 1
    OCCUPIED = 2


@dataclass(frozen=True, slots=True, eq=False)
class StaticLayer:
    """A map with its edits, made once per map.

    Attributes:
        state: (H, W) uint8 of `CellState`.
        speed_m_s: (H, W) float32 speed limits of zones, infinite elsewhere.
        origin: x and y in `map` of the corner of cell (0, 0).
        is_assumed: (H, W) free floor that is unseen, but that a person said is free; None for none.
    """

    state: ByteArray
    speed_m_s: Float32Array
    resolution_m: float
    origin: tuple[float, float]
    is_assumed: BoolArray | None = None

    @property
    def is_unseen(self) -> BoolArray:
        """(H, W) floor that no sensor has seen: unknown, or free only because a person said so."""
        return _unseen(self.state, self.is_assumed)

    @classmethod
    def of(cls, grid: OccupancyGrid, edits: MapEdits | None = None, T_map_keyframe: ArrayLike = ()) -> StaticLayer:
        """Return the layer of a map and its edits. `T_map_keyframe` and errors are those of `MapEdits.applied`."""
        edits = edits or MapEdits()
        edited = edits.applied(grid, T_map_keyframe)
        occupancy = edited.occupancy
        state = np.full(occupancy.shape, CellState.UNKNOWN, np.uint8)
        state[occupancy == FREE] = CellState.FREE
        # Values between free and occupied are unknown.
        state[occupancy >= OCCUPIED] = CellState.OCCUPIED
        # Small unknown areas with free floor all around are free: rays miss single cells, and each would keep a robot
        # away by its own width. An area counts as small if no object could stand there unseen.
        is_unknown = (state == CellState.UNKNOWN).astype(np.uint8)
        _, labels, about, _ = cv2.connectedComponentsWithStats(is_unknown, connectivity=8)
        is_small = np.asarray(about)[:, cv2.CC_STAT_AREA] * grid.resolution_m**2 <= _HOLE_M2
        beside = cv2.dilate((state == CellState.OCCUPIED).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        is_small[np.unique(np.asarray(labels)[beside])] = False
        is_small[0] = False
        state[is_small[np.asarray(labels)]] = CellState.FREE
        return cls(state, edits.limits_m_s(edited, T_map_keyframe), grid.resolution_m, grid.origin)

    def window(self, xy: ArrayLike, size_m: float) -> StaticLayer:
        """Return a square around a place (2,), metres. Cells beyond the edges are unknown. It has no `is_assumed`."""
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
        """Return (N,) `CellState` at points (N, 2); unknown beyond the edges."""
        at = np.floor((np.asarray(xy, float) - self.origin) / self.resolution_m).astype(np.int64)[:, ::-1]
        inside = ((at >= 0) & (at < self.state.shape)).all(axis=1)
        found = np.full(len(at), CellState.UNKNOWN, np.uint8)
        found[inside] = self.state[at[inside, 0], at[inside, 1]]
        return found

    def grown(self, bounds: ArrayLike) -> StaticLayer:
        """Return the layer, extended by unknown cells to include the low and high corners (2, 2) of a box, metres."""
        size_m, (height, width) = self.resolution_m, self.state.shape
        corners = (np.asarray(bounds, float) - self.origin) / size_m
        left, bottom = np.maximum(-np.floor(corners[0]), 0).astype(int)
        right, top = np.maximum(np.ceil(corners[1]) - (width, height), 0).astype(int)
        around = (int(bottom), int(top)), (int(left), int(right))
        state = np.pad(self.state, around, constant_values=int(CellState.UNKNOWN))
        speed = np.pad(self.speed_m_s, around, constant_values=np.inf)
        origin = float(self.origin[0] - left * size_m), float(self.origin[1] - bottom * size_m)
        is_assumed = None if self.is_assumed is None else np.pad(self.is_assumed, around)
        return StaticLayer(state, speed, size_m, origin, is_assumed)

    def with_floor(self, is_floor: BoolArray, *, is_assumed: bool = False) -> StaticLayer:
        """Return the layer with unknown cells (H, W) free; with `is_assumed`, because a person said so."""
        is_new = is_floor & (self.state == CellState.UNKNOWN)
        state = self.state.copy()
        state[is_new] = CellState.FREE
        assumed = self.is_assumed
        if is_assumed:
            assumed = is_new if assumed is None else assumed | is_new
        return StaticLayer(state, self.speed_m_s, self.resolution_m, self.origin, assumed)


@dataclass(frozen=True, slots=True, eq=False)
class Costmap:
    """Square cells of the floor along the axes of a frame. The robot may not leave it.

    Attributes:
        state: (H, W) uint8 of `CellState`; row 0 has the least y.
        is_lethal: (H, W) cells where no part of the robot may be: occupied, or unknown if that is forbidden.
        distance_m: (H, W) float32 from each cell's centre to that of the nearest lethal one; 0 in these.
        cost: (H, W) float32 from 0, free, to 1, where the centre of rotation can never be. Between them it falls with
            the distance to obstacles.
        speed_m_s: (H, W) float32 speed limits of zones, infinite elsewhere.
        origin: x and y in metres of the corner of cell (0, 0).
        frame: `map` or `odom`.
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
    is_assumed: BoolArray | None = None

    @property
    def is_unseen(self) -> BoolArray:
        """As in `StaticLayer`."""
        return _unseen(self.state, self.is_assumed)

    @classmethod
    def of(
        cls,
        static: StaticLayer,
        footprint: Footprint,
        settings: CostmapSettings | None = None,
        live: LiveObstacles | None = None,
        T_map_live: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Costmap:
        """Return the costmap in `map` of a static layer and of live obstacles.

        Args:
            footprint: its inscribed circle is where costs begin.
            live: obstacles in addition to those of the map.
            T_map_live: (3,) x, y, yaw of their frame in `map`.

        Raises ArgumentError if `T_map_live` is not finite.
        """
        state = static.state
        if live is not None:
            at, state = np.asarray(T_map_live, float), state.copy()
            if at.shape != (3,) or not np.isfinite(at).all():
                raise ArgumentError(f"T_map_live is {at}", fix="x, y and yaw of the obstacles' frame in map, finite")
            x, y, yaw = (float(value) for value in at)
            of = kernels.CellFrame(live.resolution_m, *live.origin)
            to = kernels.CellFrame(static.resolution_m, *static.origin)
            T = x, y, np.cos(yaw), np.sin(yaw)
            # A live cell beside an obstacle of the map is that obstacle, seen with the errors of cells and pose: both
            # would make a door narrower at each side, by two cells where a live one lies across two. The collision
            # monitor has all points.
            is_known = (static.state == CellState.OCCUPIED).astype(np.uint8)
            near = cv2.dilate(is_known, np.ones((3, 3), np.uint8))
            is_beside = (near > 0) & (static.state != CellState.UNKNOWN)
            beside = replace(static, state=np.where(is_beside, CellState.OCCUPIED, CellState.FREE).astype(np.uint8))
            occupied = np.argwhere(live.is_occupied)
            middles = live.origin + (occupied[:, ::-1] + 0.5) * live.resolution_m
            is_mapped = beside.state_at(se2.apply(se2.from_parts(x, y, yaw), middles)) == CellState.OCCUPIED
            is_new = live.is_occupied.copy()
            is_new[tuple(occupied[is_mapped].T)] = False
            kernels.mark_occupied(is_new, of, T, to, CellState.OCCUPIED.value, state)
        place = static.resolution_m, static.origin, "map"
        made = _made(state, static.speed_m_s, place, footprint.inscribed_m, settings or CostmapSettings())
        return replace(made, is_assumed=static.is_assumed)

    @property
    def field(self) -> CostField:
        """The costmap as controllers use it."""
        return CostField(self.distance_m, self.cost, self.resolution_m, self.origin, self.speed_m_s)

    @classmethod
    def of_live(cls, live: LiveObstacles, footprint: Footprint, settings: CostmapSettings | None = None) -> Costmap:
        """Return the costmap in the frame of live obstacles, without a map: all other cells are free."""
        state = np.where(live.is_occupied, CellState.OCCUPIED, CellState.FREE).astype(np.uint8)
        speed = np.full(state.shape, np.inf, np.float32)
        place = live.resolution_m, live.origin, live.frame
        return _made(state, speed, place, footprint.inscribed_m, settings or CostmapSettings())

    def standing_at(self, footprint: Footprint, pose: ArrayLike) -> Costmap:
        """Return the costmap with the unknown floor under a robot at a pose (3,) free."""
        corners = footprint.at(pose)
        low = np.maximum(self.cells_at(corners.min(axis=0)), 0)
        high = np.minimum(self.cells_at(corners.max(axis=0)) + 1, self.state.shape)
        if (low >= high).any():
            return self
        rows, columns = (np.arange(a, b) for a, b in zip(low.tolist(), high.tolist(), strict=True))
        cells = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)
        away = self.middle_of(cells) - np.asarray(pose, float)[:2]
        c, s = np.cos(np.asarray(pose, float)[2]), np.sin(np.asarray(pose, float)[2])
        # All cells that the outline touches: a cell's corners are half a diagonal off its middle.
        grown = footprint.padded(self.resolution_m * np.sqrt(0.5))
        below = grown.contains(away @ np.array([[c, -s], [s, c]]))
        cut = slice(low[0], high[0]), slice(low[1], high[1])
        unknown = below & (self.state[cut] == CellState.UNKNOWN)
        if not unknown.any():
            return self
        state = self.state.copy()
        state[cut][unknown] = CellState.FREE
        return self._with_state(state)

    def with_unknown_free(self) -> Costmap:
        """Return the costmap with all unknown floor free."""
        state = np.where(self.state == CellState.UNKNOWN, CellState.FREE, self.state).astype(np.uint8)
        return self._with_state(state)

    def window(self, bounds: ArrayLike) -> Costmap:
        """Return a view of the cells between two corners (2, 2), as far as there are any; its outside is forbidden."""
        low, high = np.sort(np.asarray(bounds, float), axis=0)
        first, last = np.clip(self.cells_at([low, high]), 0, np.array(self.state.shape) - 1)
        cut = slice(first[0], last[0] + 1), slice(first[1], last[1] + 1)
        x, y = (self.origin + first[::-1] * self.resolution_m).tolist()
        speed = self.speed_m_s[cut] if self.speed_m_s.shape == self.state.shape else self.speed_m_s
        grids = {"state": self.state, "is_lethal": self.is_lethal, "distance_m": self.distance_m, "cost": self.cost}
        cuts = {name: np.ascontiguousarray(grid[cut]) for name, grid in grids.items()}
        assumed = None if self.is_assumed is None else self.is_assumed[cut]
        return replace(self, **cuts, speed_m_s=speed, origin=(x, y), is_assumed=assumed)  # type: ignore[arg-type]

    def _with_state(self, state: ByteArray) -> Costmap:
        """Return the costmap with other cell states (H, W)."""
        place = self.resolution_m, self.origin, self.frame
        return _made(state, self.speed_m_s, place, self.inscribed_m, self.settings)

    def cells_at(self, xy: ArrayLike) -> IntArray:
        """Return (..., 2) row and column of points (..., 2); they may lie outside."""
        cells = (np.asarray(xy, float) - self.origin) / self.resolution_m
        return np.floor(cells[..., ::-1]).astype(np.int64)

    def middle_of(self, cells: ArrayLike) -> FloatArray:
        """Return (..., 2), the centres of cells (..., 2) of row and column."""
        return np.asarray((np.asarray(cells, float)[..., ::-1] + 0.5) * self.resolution_m + self.origin)


def _made(
    state: ByteArray,
    speed_m_s: Float32Array,
    place: tuple[float, tuple[float, float], str],
    inscribed_m: float,
    settings: CostmapSettings,
) -> Costmap:
    """Return the costmap of cell states."""
    resolution_m, origin, frame = place
    is_lethal = state == CellState.OCCUPIED
    if settings.unknown == "forbidden":
        is_lethal |= state == CellState.UNKNOWN
    distance_m = distances_m(is_lethal, resolution_m)
    # Distance to the nearest edge of a cell, along a row or column.
    near_m = 0.5 * resolution_m + inscribed_m
    falls = kernels.Falls(near_m, settings.inflation_m, _DECAY_PER_M, settings.unknown_cost)
    cost = kernels.costs(state, is_lethal, distance_m, falls, CellState.UNKNOWN.value)
    return Costmap(state, is_lethal, distance_m, cost, speed_m_s, resolution_m, origin, frame, inscribed_m, settings)


def _unseen(state: ByteArray, is_assumed: BoolArray | None) -> BoolArray:
    is_unknown = state == CellState.UNKNOWN
    return np.asarray(is_unknown if is_assumed is None else is_unknown | (is_assumed & (state == CellState.FREE)))


def distances_m(is_lethal: BoolArray, resolution_m: float) -> Float32Array:
    """Return (H, W), the exact distance from each centre to the nearest lethal one; `FARTHEST_M` without any."""
    if not is_lethal.any():
        return np.full(is_lethal.shape, FARTHEST_M, np.float32)
    cells = cv2.distanceTransform((~is_lethal).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(np.minimum(cells * resolution_m, FARTHEST_M), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class LiveObstacles:
    """Obstacles around a robot.

    Attributes:
        is_occupied: (N, N) row 0 has the least y.
        origin: x and y in metres of the corner of cell (0, 0).
        frame: of its axes: `odom` or `map`.
        is_standing: (N, N) those that were seen first some time ago, and not cleared since.
    """

    is_occupied: BoolArray
    resolution_m: float
    origin: tuple[float, float]
    frame: str
    stamp_s: float | None
    is_standing: BoolArray

    def standing(self) -> LiveObstacles:
        """Return the standing obstacles only, without people who may pass by."""
        return replace(self, is_occupied=self.is_standing)

    def with_points(self, points: FloatArray) -> LiveObstacles:
        """Return the obstacles with the cells of points (N, 2) in its frame occupied, too."""
        at = np.floor((points - self.origin) / self.resolution_m).astype(np.int64)[:, ::-1]
        at = at[((at >= 0) & (at < self.is_occupied.shape)).all(axis=1)]
        is_occupied, is_standing = self.is_occupied.copy(), self.is_standing.copy()
        is_occupied[at[:, 0], at[:, 1]] = is_standing[at[:, 0], at[:, 1]] = True
        return replace(self, is_occupied=is_occupied, is_standing=is_standing)


_NOWHERE: FloatArray = np.empty((0, 2))


@dataclass(frozen=True, slots=True, eq=False)
class FloorNow:
    """All that is known of the floor at one moment, as a value that any thread may use.

    Attributes:
        T_map_odom: (3,) x, y, yaw of `odom` in `map`.
        hidden: (M, 3) x and y in the map of unseen floor near the robot, and how near the camera must look, metres.
    """

    layer: StaticLayer
    obstacles: LiveObstacles
    T_map_odom: FloatArray
    hidden: FloatArray
    footprint: Footprint
    settings: CostmapSettings

    def costmap(self, avoided: FloatArray = _NOWHERE) -> Costmap:
        """Return its costmap in `map`, with further obstacles at (N, 2)."""
        T_odom_map = se2.invert(se2.from_parts(*self.T_map_odom))
        live = self.obstacles.with_points(se2.apply(T_odom_map, avoided)) if len(avoided) else self.obstacles
        return Costmap.of(self.layer, self.footprint, self.settings, live, self.T_map_odom)


# Half a cell: keyframes that moved by less show the same cells.
_LEAST_SHIFT_M = 0.025
# Spacing of the outlines that mark a path as floor.
_STAMP_M, _STAMP_RAD = 0.05, 0.1
# Margin of floor beside a driven outline. It exceeds the 4 cm of plans and controllers (`follow.margin_m`), as poses of
# a plan differ from driven ones.
_BESIDE_M = 0.05


class KnownFloor:
    """Floor of a fixed map, extended by the floor that the robot itself drives over.

    Args:
        T_map_keyframe: (K, 4, 4) poses of keyframes that edits are anchored to.
        driven: sections (K, 3) of x, y, yaw of an earlier drive, about straight between poses. Unknown floor under the
            outline there, and 5 cm beside it, is free.
        footprint: of that robot and of this one, whose own place is free too; None to mark neither.
        trusted_m: radius around the start, in sight of it, where unknown floor is free, because a person looked at it.
    """

    is_fixed = True  # obstacles besides those of the map are temporary

    # Declared floor (N, 2) in the map, and places (M, 2) of the axle on an earlier drive.
    declared: tuple[FloatArray, ...] = ()
    driven: FloatArray = np.empty((0, 2))

    def __init__(
        self,
        grid: OccupancyGrid,
        edits: MapEdits | None = None,
        T_map_keyframe: ArrayLike = (),
        driven: Sequence[FloatArray] = (),
        footprint: Footprint | None = None,
        trusted_m: float = 0.0,
    ) -> None:
        static, self.revision = StaticLayer.of(grid, edits, T_map_keyframe), 0
        listed = () if edits is None else edits.edits
        self.has_keep_out = any(edit.kind is EditKind.KEEP_OUT for edit in listed)
        self.declared = tuple(edit.polygon_now(T_map_keyframe) for edit in listed if edit.kind is EditKind.FLOOR)
        self.layer, self._footprint, self._trusted_m = static, footprint, trusted_m
        self._stood: FloatArray | None = None
        if footprint is not None and len(driven):
            # Poses at a spacing of a cell and a few degrees.
            poses = []
            for stretch in driven:
                poses.append(stretch[:1])
                for before, after in pairwise(stretch):
                    turn = float(wrap_angle(after[2] - before[2]))
                    count = 1 + int(max(np.hypot(*(after - before)[:2]) / _STAMP_M, abs(turn) / _STAMP_RAD))
                    poses.append(before + np.linspace(0, 1, count + 1)[1:, None] * [*(after - before)[:2], turn])
            self.driven = np.concatenate(poses)[:, :2]
            self.layer = _driven_over(static, np.concatenate(poses), footprint)

    def update(self, pose: FloatArray | None, now_s: float) -> None:
        """Mark the floor under the robot as free, and the trusted floor around its start."""
        if pose is None or self._footprint is None or (self._stood is not None and not _apart(pose, self._stood)):
            return
        layer = _driven_over(self.layer, pose[None], self._footprint)
        if self._stood is None and self._trusted_m:
            layer = layer.grown(pose[:2] + self._trusted_m * np.array([[-1.0], [1.0]]))
            layer = layer.with_floor(_in_sight(layer, pose[:2], self._trusted_m), is_assumed=True)
        self._stood = pose
        if layer is not self.layer:
            self.layer, self.revision = layer, self.revision + 1

    def is_silent(self, now_s: float) -> bool:
        """Return False, as nothing computes it."""
        return False


@dataclass(frozen=True, slots=True, eq=False)
class SeenFloor:
    """Floor that a camera has seen: as a map, and as a static layer."""

    grid: OccupancyGrid
    layer: StaticLayer


class GrowingFloor:
    """Floor from the keyframes of a localization, computed again when they move.

    It is free where the robot stood, and within a radius of its start, because a person looked at it.

    Args:
        trusted_m: radius around the start of free floor that the camera cannot see from there.
        holds: (N, 2) places that the layer must include, even unseen, such as a goal beyond all known floor.
        worker: computes the grid; None for at once. The caller closes it.

    Raises MapError if the calibration does not say where the camera sits on the base.
    """

    is_fixed = has_keep_out = False
    declared: tuple[FloatArray, ...] = ()
    driven: FloatArray = np.empty((0, 2))

    def __init__(
        self,
        localization: Localization,
        calibration: Calibration,
        footprint: Footprint,
        trusted_m: float = 0.0,
        settings: OccupancySettings | None = None,
        holds: ArrayLike = (),
        worker: Worker[SeenFloor] | None = None,
    ) -> None:
        self._localization, self._footprint, self._trusted_m = localization, footprint, trusted_m
        self._reached = np.array([[np.inf] * 2, [-np.inf] * 2])
        self._reach(np.asarray(holds, float).reshape(-1, 2))
        self._mapper = OccupancyMapper(calibration, settings)
        self._worker: Worker[SeenFloor] = worker or WorkerInStep()
        self._stood: list[FloatArray] = []
        self._stamped = 0
        self._marked: tuple[BoolArray, tuple[float, float]] | None = None
        self._trusted: tuple[tuple[StaticLayer, tuple[float, float], tuple[int, ...]], BoolArray] | None = None
        self._count, self._store_revision, self._asked_s = 0, -1, 0.0
        self.revision = 0
        self.grid = self._mapper.grid()
        self._seen = self.layer = StaticLayer.of(self.grid)

    def update(self, pose: FloatArray | None, now_s: float) -> None:
        """Update the layer. A grid of moved keyframes may take a second, and is used when it is ready."""
        has_moved = pose is not None and (not self._stood or _apart(pose, self._stood[-1]))
        if pose is not None and has_moved:
            self._stood.append(pose)
            self._reach(pose[None, :2])
        store = self._localization.keyframes
        known = self._count, self._store_revision
        if store is not None and not self._worker.is_asked and (len(store), store.revision) != known:
            self._count, self._store_revision, self._asked_s = len(store), store.revision, now_s

            def made() -> SeenFloor:
                self._mapper.update(store, _LEAST_SHIFT_M)
                grid = self._mapper.grid()
                return SeenFloor(grid, StaticLayer.of(grid))

            self._worker.ask(made, now_s)
        seen = self._worker.answer(now_s)
        if seen is not None:
            self.grid, self._seen = seen.grid, seen.layer
        elif not has_moved:
            return
        if self._stood:
            reach_m = max(self._footprint.circumscribed_m, self._trusted_m) + 0.1
            self.layer = self._with_stood(self._seen.grown(self._reached + [[-reach_m], [reach_m]]))
        else:
            self.layer = self._seen
        self.revision += 1

    def is_silent(self, now_s: float) -> bool:
        """Return whether the worker hangs."""
        return self._worker.is_asked and now_s - self._asked_s > FLOOR_SILENT_S

    def _reach(self, places: FloatArray) -> None:
        """Extend the bounds to include places (N, 2)."""
        if len(places):
            low, high = self._reached
            self._reached = np.array([np.minimum(low, places.min(axis=0)), np.maximum(high, places.max(axis=0))])

    def _with_stood(self, static: StaticLayer) -> StaticLayer:
        """Return the layer with the floor where the robot stood, and with the trusted floor."""
        is_stood = np.zeros(static.state.shape, bool)
        if self._marked is not None:
            # Both origins lie on the same grid of cells.
            before, origin = self._marked
            column, row = np.rint((np.array(origin) - static.origin) / static.resolution_m).astype(int)
            low = np.maximum([row, column], 0)
            high = np.minimum([row + before.shape[0], column + before.shape[1]], is_stood.shape)
            if (low < high).all():
                (top, left), (bottom, right) = low, high
                is_stood[top:bottom, left:right] = before[top - row : bottom - row, left - column : right - column]
        for pose in self._stood[self._stamped :]:
            _stamp(is_stood, static, pose, self._footprint)
        self._stamped, self._marked = len(self._stood), (is_stood, static.origin)
        known = static.with_floor(is_stood)
        if not self._trusted_m:
            return known
        # Cached, as it takes 16 ms.
        of = self._seen, static.origin, static.state.shape
        if self._trusted is None or self._trusted[0][0] is not self._seen or self._trusted[0][1:] != of[1:]:
            self._trusted = of, _in_sight(static, self._stood[0][:2], self._trusted_m)
        return known.with_floor(self._trusted[1], is_assumed=True)


Floor: TypeAlias = KnownFloor | GrowingFloor
"""The known part of the building's floor."""


def _driven_over(static: StaticLayer, poses: FloatArray, footprint: Footprint) -> StaticLayer:
    """Return the layer with floor at poses (N, 3), large enough to include it; the same object if nothing is new."""
    reach_m = footprint.circumscribed_m + 2 * _BESIDE_M
    bounds = np.array([poses[:, :2].min(axis=0) - reach_m, poses[:, :2].max(axis=0) + reach_m])
    high = np.array(static.origin) + np.array(static.state.shape[::-1]) * static.resolution_m
    is_inside = (bounds[0] >= static.origin).all() and (bounds[1] <= high).all()
    grown = static if is_inside else static.grown(bounds)
    is_stood = np.zeros(grown.state.shape, bool)
    for pose in poses:
        _stamp(is_stood, grown, pose, footprint)
    is_new = (is_stood & (grown.state == CellState.UNKNOWN)).any()
    return grown.with_floor(is_stood) if is_new else grown


def _apart(pose: FloatArray, other: FloatArray) -> bool:
    """Return whether the motion between two poses changes the floor that is covered."""
    return bool(np.hypot(*(pose[:2] - other[:2])) > _STAMP_M or abs(wrap_angle(pose[2] - other[2])) > _STAMP_RAD)


def _stamp(found: BoolArray, static: StaticLayer, pose: FloatArray, footprint: Footprint) -> None:
    """Mark the cells under an outline at a pose, with the margin beside it."""
    # All cells that the outline touches: a cell's corners are half a diagonal off its middle.
    outline = footprint.padded(_BESIDE_M + np.sqrt(0.5) * static.resolution_m)
    xy, reach_m = pose[:2], outline.circumscribed_m
    low = np.maximum(np.floor((xy - reach_m - static.origin) / static.resolution_m).astype(int), 0)
    high = np.ceil((xy + reach_m - static.origin) / static.resolution_m).astype(int)
    right, top = np.minimum(high, static.state.shape[::-1]).tolist()
    left, bottom = low.tolist()
    # Centres of the cells near the pose, relative to it.
    x, y = (
        (np.arange(a, b) + 0.5) * static.resolution_m + origin - at
        for a, b, origin, at in zip((left, bottom), (right, top), static.origin, xy, strict=True)
    )
    away = np.stack(np.meshgrid(x, y), axis=-1)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    found[bottom:top, left:right] |= outline.contains(away @ np.array([[c, -s], [s, c]]))


def _in_sight(static: StaticLayer, xy: FloatArray, reach_m: float) -> BoolArray:
    """Return (H, W), the unknown cells within `reach_m` of a place, with only unknown or free cells between."""
    found = np.zeros(static.state.shape, bool)
    cells, reach = (xy - np.array(static.origin)) / static.resolution_m, reach_m / static.resolution_m
    kernels.mark_in_sight(static.state, cells, reach, (int(CellState.UNKNOWN), int(CellState.OCCUPIED)), found)
    return found
