"""Floor: source of a navigator's static layer, either a map from an earlier session or one that grows on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.mapping import EditKind, MapEdits, OccupancyGrid, OccupancyMapper, OccupancySettings
from wheelsight.navigation.costmap import CellState, StaticLayer
from wheelsight.navigation.costmap_kernels import mark_in_sight
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.localization import Localization
from wheelsight.navigation.workers import Worker, WorkerInStep

# Half a cell: keyframes that moved by less show the same cells.
_LEAST_SHIFT_M = 0.025
# Longest computation of a grid before its worker counts as hanging; an hour's keyframes take a second.
_SILENT_S = 10.0
# Spacing of the outlines that mark a path as floor.
_STAMP_M, _STAMP_RAD = 0.05, 0.1
# Margin of floor beside a driven outline. It exceeds the 4 cm of plans and controllers (follow.margin_m), as poses of
# a plan differ from driven ones.
_BESIDE_M = 0.05


class Floor(Protocol):
    """Known part of the building's floor."""

    @property
    def revision(self) -> int:
        """Number that changes with the layer."""

    @property
    def layer(self) -> StaticLayer:
        """Static layer in the frame `map`."""

    @property
    def is_fixed(self) -> bool:
        """Whether it comes from an earlier session, so that obstacles besides it are temporary."""

    @property
    def has_keep_out(self) -> bool:
        """Whether it has a keep-out zone, which no camera sees."""

    def update(self, pose: FloatArray | None, now_s: float) -> None:
        """Update it for a robot at (3,) in the map; called once per period, so it must be fast."""

    def is_silent(self, now_s: float) -> bool:
        """Return whether its computation hangs."""


class KnownFloor:
    """Floor of a fixed map, extended by the floor that the robot itself drives over.

    Args:
        grid: of the map.
        edits: edits of the map by people.
        T_map_keyframe: (K, 4, 4) poses of keyframes that edits are anchored to.
        driven: sections (K, 3) of x, y, yaw of an earlier drive, about straight between poses. Unknown floor under the
            outline there, and 5 cm beside it, is free.
        footprint: of that robot and of this one, whose own place is free too; None to mark neither.
        trusted_m: radius around the start, in sight of it, where unknown floor is free, because a person looked at it.
    """

    is_fixed = True

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
        self.has_keep_out = edits is not None and any(edit.kind is EditKind.KEEP_OUT for edit in edits.edits)
        self.layer, self._footprint, self._trusted_m = static, footprint, trusted_m
        self._stood: FloatArray | None = None
        if footprint is not None and len(driven):
            self.layer = _driven_over(static, np.concatenate([_densely(stretch) for stretch in driven]), footprint)

    def update(self, pose: FloatArray | None, now_s: float) -> None:
        """Mark the floor under the robot as free, and the trusted floor around its start."""
        if pose is None or self._footprint is None or (self._stood is not None and not _apart(pose, self._stood)):
            return
        layer = _driven_over(self.layer, pose[None], self._footprint)
        if self._stood is None and self._trusted_m:
            layer = layer.grown(pose[:2] + self._trusted_m * np.array([[-1.0], [1.0]]))
            layer = layer.with_floor(_in_sight(layer, pose[:2], self._trusted_m), is_told=True)
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
        localization: source of the keyframes.
        calibration: of the robot.
        footprint: of the robot.
        trusted_m: radius around the start of free floor that the camera cannot see from there.
        settings: of occupancy; None for the defaults.
        holds: (N, 2) places that the layer must include, even unseen, such as a goal beyond all known floor.
        worker: computes the grid; None for at once. The caller closes it.

    Attributes:
        grid: grid of the camera alone.

    Raises:
        MapError: the calibration does not say where the camera sits on the base.
    """

    is_fixed = has_keep_out = False

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
        self._look(now_s)
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
        return self._worker.is_asked and now_s - self._asked_s > _SILENT_S

    def _look(self, now_s: float) -> None:
        """Request a new grid if keyframes changed and none is requested."""
        store = self._localization.keyframes
        if store is None or self._worker.is_asked:
            return
        if len(store) == self._count and store.revision == self._store_revision:
            return
        self._count, self._store_revision, self._asked_s = len(store), store.revision, now_s

        def made() -> SeenFloor:
            self._mapper.update(store, _LEAST_SHIFT_M)
            grid = self._mapper.grid()
            return SeenFloor(grid, StaticLayer.of(grid))

        self._worker.ask(made, now_s)

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
            _paste(is_stood, before, np.rint((np.array(origin) - static.origin) / static.resolution_m).astype(int))
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
        return known.with_floor(self._trusted[1], is_told=True)


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


def _densely(stretch: FloatArray) -> FloatArray:
    """Return (N, 3) poses of a path, interpolated to a spacing of a cell and a few degrees."""
    poses = [stretch[:1]]
    for before, after in pairwise(stretch):
        turn = float(wrap_angle(after[2] - before[2]))
        count = 1 + int(max(np.hypot(*(after - before)[:2]) / _STAMP_M, abs(turn) / _STAMP_RAD))
        poses.append(before + np.linspace(0, 1, count + 1)[1:, None] * [*(after - before)[:2], turn])
    return np.concatenate(poses)


def _paste(into: BoolArray, part: BoolArray, at: IntArray) -> None:
    """Copy one grid into another at column and row (2,), as far as it lies within."""
    (column, row), (height, width) = at, part.shape
    low = np.maximum([row, column], 0)
    high = np.minimum([row + height, column + width], into.shape)
    if (low < high).all():
        into[low[0] : high[0], low[1] : high[1]] = part[
            low[0] - row : high[0] - row, low[1] - column : high[1] - column
        ]


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
    mark_in_sight(static.state, cells, reach, (int(CellState.UNKNOWN), int(CellState.OCCUPIED)), found)
    return found
