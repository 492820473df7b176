"""Costmap: free space, distance to obstacles and cost of each cell.

`StaticLayer` is the map with its edits. `LiveLayer` has the obstacles of recent depth images, cleared by ray casting.
`FloorNow` joins both at one moment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray, IntArray, PinholeCamera, se2
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.io.ros_map import FREE, OCCUPIED
from wheelsight.mapping.map_edits import MapEdits
from wheelsight.mapping.occupancy import OccupancyGrid, camera_over_floor
from wheelsight.navigation import costmap_kernels as kernels
from wheelsight.navigation.clearance_kernels import CostField
from wheelsight.navigation.costmap_kernels import Heights, Noise, Rules, View, any_left, mark_met, mark_passed, remember
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.settings import CostmapSettings, LiveLayerSettings

# Distance where nothing is occupied; infinite ones would become NaN between cells.
FARTHEST_M = 100.0
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
        resolution_m: side of a cell.
        origin: x and y in `map` of the corner of cell (0, 0).
        is_told: (H, W) free floor that is unseen, but that a person said is free; None for none.
    """

    state: ByteArray
    speed_m_s: Float32Array
    resolution_m: float
    origin: tuple[float, float]
    is_told: BoolArray | None = None

    @property
    def is_unseen(self) -> BoolArray:
        """(H, W) floor that no sensor has seen: unknown, or free only because a person said so."""
        return _unseen(self.state, self.is_told)

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
        _fill_holes(state, grid.resolution_m)
        return cls(state, edits.limits_m_s(edited, T_map_keyframe), grid.resolution_m, grid.origin)

    def window(self, xy: ArrayLike, size_m: float) -> StaticLayer:
        """Return a square around a place (2,), metres. Cells beyond the edges are unknown. It has no `is_told`."""
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
        is_told = None if self.is_told is None else np.pad(self.is_told, around)
        return StaticLayer(state, speed, size_m, origin, is_told)

    def with_floor(self, is_floor: BoolArray, *, is_told: bool = False) -> StaticLayer:
        """Return the layer with unknown cells (H, W) free; with `is_told`, because a person said so."""
        is_new = is_floor & (self.state == CellState.UNKNOWN)
        state = self.state.copy()
        state[is_new] = CellState.FREE
        told = self.is_told
        if is_told:
            told = is_new if told is None else told | is_new
        return StaticLayer(state, self.speed_m_s, self.resolution_m, self.origin, told)


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
        resolution_m: side of a cell.
        origin: x and y in metres of the corner of cell (0, 0).
        frame: `map` or `odom`.
        inscribed_m: inscribed radius of the footprint.
        settings: of the costmap.
        is_told: as in `StaticLayer`.
        dearness: (H, W) float32 factor of the cost of a metre; None for 1.
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
        """As in `StaticLayer`."""
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
        """Return the costmap in `map` of a static layer and of live obstacles.

        Args:
            static: of the map.
            footprint: its inscribed circle is where costs begin.
            settings: None for the defaults.
            live: obstacles in addition to those of the map.
            T_map_live: (3,) x, y, yaw of their frame in `map`.

        Raises:
            ArgumentError: `T_map_live` is not finite.
        """
        state = static.state
        if live is not None:
            at, state = np.asarray(T_map_live, float), state.copy()
            if at.shape != (3,) or not np.isfinite(at).all():
                raise ArgumentError(f"T_map_live is {at}", fix="x, y and yaw of the obstacles' frame in map, finite")
            x, y, yaw = (float(value) for value in at)
            of = kernels.Cells(live.resolution_m, *live.origin)
            to = kernels.Cells(static.resolution_m, *static.origin)
            T = x, y, np.cos(yaw), np.sin(yaw)
            kernels.mark_occupied(live.is_occupied, of, T, to, CellState.OCCUPIED.value, state)
        place = static.resolution_m, static.origin, "map"
        made = _made(state, static.speed_m_s, place, footprint.inscribed_m, settings or CostmapSettings())
        return replace(made, is_told=static.is_told)

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

    def _with_state(self, state: ByteArray) -> Costmap:
        """Return the costmap with other cell states (H, W)."""
        place = self.resolution_m, self.origin, self.frame
        made = _made(state, self.speed_m_s, place, self.inscribed_m, self.settings)
        return replace(made, dearness=self.dearness)

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
    falls = kernels.Falls(near_m, settings.inflation_m, settings.decay_per_m, settings.unknown_cost)
    cost = kernels.costs(state, is_lethal, distance_m, falls, CellState.UNKNOWN.value)
    return Costmap(state, is_lethal, distance_m, cost, speed_m_s, resolution_m, origin, frame, inscribed_m, settings)


def _unseen(state: ByteArray, is_told: BoolArray | None) -> BoolArray:
    is_unknown = state == CellState.UNKNOWN
    return np.asarray(is_unknown if is_told is None else is_unknown | (is_told & (state == CellState.FREE)))


def _fill_holes(state: ByteArray, resolution_m: float) -> None:
    """Set small unknown areas free if all floor around them is free.

    Rays miss single cells, and each of them would keep a robot away by its own width. An area counts as small if no
    object could stand there unseen.
    """
    is_unknown = (state == CellState.UNKNOWN).astype(np.uint8)
    _, labels, about, _ = cv2.connectedComponentsWithStats(is_unknown, connectivity=8)
    is_small = np.asarray(about)[:, cv2.CC_STAT_AREA] * resolution_m**2 <= _HOLE_M2
    beside = cv2.dilate((state == CellState.OCCUPIED).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    is_small[np.unique(np.asarray(labels)[beside])] = False
    is_small[0] = False
    state[is_small[np.asarray(labels)]] = CellState.FREE


def distances_m(is_lethal: BoolArray, resolution_m: float) -> Float32Array:
    """Return (H, W), the exact distance from each centre to the nearest lethal one; `FARTHEST_M` without any."""
    if not is_lethal.any():
        return np.full(is_lethal.shape, FARTHEST_M, np.float32)
    cells = cv2.distanceTransform((~is_lethal).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(np.minimum(cells * resolution_m, FARTHEST_M), np.float32)


# An obstacle in view, but not in the images of `_LOOKED_S`, has no depth behind it: five images would clear it.
# Bearings have columns of a degree or two, and the edge of the view does not count.
_LOOKED_S, _COLUMNS, _WITHIN = 1.0, 32, 0.9


@dataclass(frozen=True, slots=True, eq=False)
class LiveObstacles:
    """Obstacles around a robot.

    Attributes:
        is_occupied: (N, N) row 0 has the least y.
        resolution_m: side of a cell.
        origin: x and y in metres of the corner of cell (0, 0).
        frame: of its axes: `odom` or `map`.
        stamp_s: of the newest image; None before the first.
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


class LiveLayer:
    """Cells around a robot with the obstacles of its camera, in layers of height.

    A cell is occupied from the first image that shows an obstacle in it. It is free once some images have seen through
    all its occupied layers. Outside the view it stays until the robot is half the layer's size away. An obstacle that
    was seen only briefly is removed sooner, as it may be a person. The robot's own place is free.

    Args:
        calibration: of the robot: its depth camera, and the mount of it over the floor.
        footprint: of the robot.
        settings: None for the defaults.
        frame: frame of the poses.

    Raises:
        CalibrationError: there is no camera.
        MapError: the mount of the camera is unknown.
    """

    def __init__(
        self,
        calibration: Calibration,
        footprint: Footprint,
        settings: LiveLayerSettings | None = None,
        frame: str = "odom",
    ) -> None:
        self._T_base_camera, self._noise = camera_over_floor(calibration), calibration.depth_noise
        _, self._camera = calibration.cameras
        self._slopes = np.ascontiguousarray(self._camera.rays()[..., :2], np.float32)
        self.settings, self.frame, self._footprint = settings or LiveLayerSettings(), frame, footprint
        heights = {name: getattr(self.settings, name) for name in Heights._fields if name != "pixels"}
        self._heights = Heights(**heights, pixels=max(1, round(self._camera.width / self.settings.columns)))
        side = math.ceil(self.settings.size_m / self.settings.resolution_m)
        layers = max(1, math.ceil((self.settings.height_m - self.settings.floor_m) / self.settings.layer_m))
        self._low: IntArray = np.zeros(2, np.int64)  # row and column of cell (0, 0), from the frame's origin
        self._left = np.zeros((side, side, layers + 1), np.uint8)
        self._seen = np.zeros_like(self._left)
        self._met_s = np.full((side, side, 2), (np.inf, -np.inf))  # first and last
        self._newest_s = -math.inf
        self._known: LiveObstacles | None = None  # cached; None after a change

    def is_due(self, stamp_s: float) -> bool:
        """Return whether `period_s` has passed since the last image, or the clock was set back."""
        return not 0 <= stamp_s - self._newest_s < self.settings.period_s

    def update(self, depth_m: ArrayLike, pose: ArrayLike, stamp_s: float) -> None:
        """Process a depth image.

        Args:
            depth_m: (H, W) metres; values that are not finite and over 0 have no depth.
            pose: (3,) x, y, yaw of `base` in the layer's frame at that time.
            stamp_s: time of the image.

        Raises:
            ArgumentError: the image has another size, or pose or stamp is not finite. The layer stays as it is.
        """
        depth, at = checked_depth(depth_m, self._camera), np.asarray(pose, float)
        if at.shape != (3,) or not np.isfinite(at).all() or not math.isfinite(stamp_s):
            raise ArgumentError(f"pose {at} at {stamp_s} s", fix="give x, y and yaw of the base, and when, finite")
        self._move_to(at)
        is_own = self._is_own(at)
        # From the camera to column and row in cells, and height.
        c, s = np.cos(at[2]), np.sin(at[2])
        T_frame_base = np.array([[c, -s, 0, at[0]], [s, c, 0, at[1]], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        M = np.asarray((T_frame_base @ self._T_base_camera)[:3])
        M[:2] /= self.settings.resolution_m
        M[:2, 3] -= self._low[::-1]
        view = View(depth, self._slopes, np.ascontiguousarray(M))
        noise = Noise(self._noise.constant_m, self._noise.quadratic_per_m, self.settings.margin_sigmas)
        mark_met(view, self._heights, is_own, self._seen)
        mark_passed(view, self._heights, noise, self._seen)
        # An image without depth removes nothing.
        forget_s = self.settings.forget_s if self._seen.any() else math.inf
        rules = Rules(self.settings.passes, forget_s, self.settings.stays)
        remember(self._seen, is_own, self._left, self._met_s, stamp_s, rules)
        self._newest_s, self._known = stamp_s, None

    def obstacles(self) -> LiveObstacles:
        """Return the current obstacles."""
        if self._known is None:
            size_m = self.settings.resolution_m
            y, x = (size_m * self._low).tolist()
            is_left = any_left(self._left)
            is_standing = is_left & (self._newest_s - self._met_s[..., 0] >= self.settings.standing_s)
            stamp_s = self._newest_s if math.isfinite(self._newest_s) else None
            self._known = LiveObstacles(is_left, size_m, (x, y), self.frame, stamp_s, is_standing)
        return self._known

    def clear(self, stood_s: float = math.inf) -> None:
        """Remove the obstacles that were seen for less time than `stood_s`; by default all."""
        self._left[~self._has_stood(stood_s)] = 0
        self._known = None

    def clear_ahead(self, stood_s: float, eye: ArrayLike, half_view_rad: float) -> None:
        """Remove such obstacles within a camera's view only. Real ones return with the next image.

        Args:
            stood_s: as in `clear`.
            eye: (3,) x, y and heading of the camera in the layer's frame.
            half_view_rad: half of its field of view.
        """
        x, y, yaw = map(float, np.asarray(eye, float))
        rows, columns = np.indices(self._left.shape[:2])
        size_m, (row, column) = self.settings.resolution_m, self._low.tolist()
        to_x, to_y = (columns + column + 0.5) * size_m - x, (rows + row + 0.5) * size_m - y
        is_ahead = np.abs(wrap_angle(np.arctan2(to_y, to_x) - yaw)) < half_view_rad
        self._left[is_ahead & ~self._has_stood(stood_s)] = 0
        self._known = None

    def _has_stood(self, stood_s: float) -> BoolArray:
        """Return (N, N) whether the obstacle of each cell was seen for at least `stood_s`."""
        return np.asarray(self._met_s[..., 1] - self._met_s[..., 0] >= stood_s)

    def not_seen_through(self, eye: ArrayLike, half_view_rad: float, near_m: float) -> FloatArray:
        """Return (N, 2) places of obstacles in view that no recent image shows, and that cannot be cleared.

        Nothing hides such an obstacle, but there is no depth behind it, as in front of a hall, a window or black
        surfaces. It stays, since glass and black objects give no depth themselves.

        Args:
            eye: (3,) x, y and heading of the camera in the layer's frame.
            half_view_rad: half of its field of view.
            near_m: distance of the nearest visible floor; nearer obstacles may be below the view.
        """
        x, y, yaw = map(float, np.asarray(eye, float))
        cells = np.argwhere(any_left(self._left))
        places = ((cells + self._low)[:, ::-1] + 0.5) * self.settings.resolution_m
        away_m = np.hypot(*(places - (x, y)).T)
        bearing = wrap_angle(np.arctan2(places[:, 1] - y, places[:, 0] - x) - yaw)
        is_met = self._newest_s - self._met_s[cells[:, 0], cells[:, 1], 1] <= _LOOKED_S
        column = np.clip((bearing / half_view_rad + 1) / 2 * _COLUMNS, 0, _COLUMNS - 1).astype(np.int64)
        hides_m = np.full(_COLUMNS, np.inf)
        np.minimum.at(hides_m, column[is_met], away_m[is_met])
        # Near the camera a cell is wider than a column.
        hides_m = np.minimum(hides_m, np.minimum(np.r_[hides_m[1:], np.inf], np.r_[np.inf, hides_m[:-1]]))
        is_looked_at = (np.abs(bearing) < _WITHIN * half_view_rad) & (away_m > near_m) & (away_m < self.settings.far_m)
        return np.asarray(places[~is_met & is_looked_at & (away_m < hides_m[column])])

    def wipe(self, ends: ArrayLike, radius_m: float) -> None:
        """Remove obstacles within a radius of a line between places (2, 2). Real ones return with the next image."""
        a, b = np.asarray(ends, float)
        cells = np.argwhere(any_left(self._left))
        places = ((cells + self._low)[:, ::-1] + 0.5) * self.settings.resolution_m
        share = np.clip((places - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-9), 0, 1)
        near = cells[np.hypot(*(places - a - share[:, None] * (b - a)).T) <= radius_m]
        self._left[near[:, 0], near[:, 1]] = 0
        self._known = None

    def _move_to(self, pose: FloatArray) -> None:
        """Move the window to a pose, by whole cells."""
        side = len(self._left)
        low = np.floor(pose[1::-1] / self.settings.resolution_m).astype(np.int64) - side // 2
        if (low == self._low).all():
            return
        moved, met_s = np.zeros_like(self._left), np.full_like(self._met_s, (np.inf, -np.inf))
        first, last = np.maximum(low, self._low), np.minimum(low, self._low) + side
        if (first < last).all():
            to, of = (tuple(slice(a, b) for a, b in zip(first - at, last - at, strict=True)) for at in (low, self._low))
            moved[to], met_s[to] = self._left[of], self._met_s[of]
        self._low, self._left, self._met_s = low, moved, met_s

    def _is_own(self, pose: FloatArray) -> BoolArray:
        """Return (N, N) cells that lie completely under the robot."""
        side, size_m = len(self._left), self.settings.resolution_m
        is_own = np.zeros((side, side), bool)
        outline = self._footprint.at(pose) / size_m - self._low[::-1]
        left, bottom = np.floor(outline.min(axis=0)).astype(int)
        right, top = np.ceil(outline.max(axis=0)).astype(int)
        corners = np.stack(np.meshgrid(np.arange(left, right + 1), np.arange(bottom, top + 1)), axis=-1)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        places = (corners + self._low[::-1]) * size_m - pose[:2]
        inside = self._footprint.contains(places @ np.array([[c, -s], [s, c]]))
        # The robot is in the middle of the layer, which is larger.
        is_own[bottom:top, left:right] = inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]
        return is_own


_NOWHERE: FloatArray = np.empty((0, 2))


@dataclass(frozen=True, slots=True, eq=False)
class FloorNow:
    """All that is known of the floor at one moment, as a value that any thread may use.

    Attributes:
        layer: static layer of the map.
        obstacles: of the live layer.
        T_map_odom: (3,) x, y, yaw of `odom` in `map`.
        hidden: (M, 3) x and y in the map of unseen floor near the robot, and how near the camera must look, metres.
        footprint: of the robot.
        settings: of costmaps.
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


def checked_depth(depth_m: ArrayLike, camera: PinholeCamera) -> Float32Array:
    """Return (H, W) metres, contiguous. Raises ArgumentError if the image has another size than the camera's."""
    depth = np.ascontiguousarray(depth_m, np.float32)
    if depth.shape != (camera.height, camera.width):
        fix = f"give {camera.height} rows of {camera.width}, as the calibration says"
        raise ArgumentError(f"a depth image of shape {depth.shape}", fix=fix)
    return depth
