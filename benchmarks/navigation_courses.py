"""Courses in a known map: where a robot begins, to which goals it goes, and what stands on its way that no map has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import cv2
import numpy as np
import shapely

from benchmarks.box_worlds import Box
from benchmarks.session_starts import Building, FirstDay, beside_nearest
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import Costmap, KnownFloor, NavigationSettings, Plan, Planner, planar_pose
from wheelsight.navigation.path_smoothing import Drivable
from wheelsight.slam.maps import MapFolder, driven_way, occupancy_of
from wheelsight_sim import SimulationSettings
from wheelsight_sim.clearance import footprints
from wheelsight_sim.simulate import world_of

ROUND_M = 0.05
_HEADINGS, _TRIES = 8, 200
_LEAST_WAY_M = 1.0
# Things keep so far from starts and goals, which would else be taken.
_OFF_GOALS_M, _ASIDE_M = 1.3, 0.4
_SIDES_M, _HEIGHTS_M = (0.2, 0.5), (0.4, 1.2)


@dataclass(frozen=True, eq=False)
class Course:
    """In the map.

    Attributes:
        start: (3,) where the robot begins.
        goals: each (3,), one after another.
        ways_m: length of the shortest way to each from the one before, with the things on it.
        things: that the map does not know, as they lie in it.
    """

    start: FloatArray
    goals: tuple[FloatArray, ...]
    ways_m: tuple[float, ...]
    things: tuple[Box, ...]


class KnownBuilding:
    """The map of the first day, as a navigator takes it."""

    def __init__(self, building: Building, day: FirstDay, settings: NavigationSettings) -> None:
        self.building, self.day, self.settings = building, day, settings
        self.footprint = settings.footprint.outline
        folder = MapFolder.open(day.folder)
        self._grid, self._driven = occupancy_of(folder), driven_way(folder)
        folder.close()
        self.planner = Planner(self.footprint, settings.drivable, settings.limits)

    @cached_property
    def floor(self) -> KnownFloor:
        """As the robot has it."""
        return KnownFloor(self._grid, driven=self._driven, footprint=self.footprint)

    @cached_property
    def costmap(self) -> Costmap:
        """Of it."""
        return Costmap.of(self.floor.layer, self.footprint, self.settings.costmap)

    @cached_property
    def _drivable(self) -> Drivable:
        """Where the outline fits in it."""
        planner = self.planner
        return Drivable.of(self.costmap, planner.footprint, planner.settings, planner.limits)

    @cached_property
    def _extent_m(self) -> FloatArray:
        """(2, 2) least and greatest x and y of the building on its first day, in the world."""
        things = footprints(world_of(SimulationSettings(**self.building.where)))
        return np.reshape(shapely.union_all([thing.polygon for thing in things]).bounds, (2, 2))

    def costmap_with(self, things: tuple[Box, ...]) -> Costmap:
        """As it would be if the map knew them."""
        if not things:
            return self.costmap
        grid = grid_with(self._grid, things)
        floor = KnownFloor(grid, driven=self._driven, footprint=self.footprint)
        return Costmap.of(floor.layer, self.footprint, self.settings.costmap)

    def world_pose(self, pose: FloatArray) -> FloatArray:
        """(3,) where a pose of the map truly is, beside its nearest keyframe."""
        return planar_pose(beside_nearest(se3.from_plane(*pose), self.day.T_map_base, self.day.T_world_base))

    def map_pose(self, T_world_base: FloatArray) -> FloatArray:
        """(3,) in the map of a true pose (4, 4), beside its nearest keyframe."""
        return planar_pose(beside_nearest(T_world_base, self.day.T_world_base, self.day.T_map_base))

    def world_box(self, box: Box) -> Box:
        """Where a thing of the map truly is."""
        x, y, yaw = self.world_pose(np.array([box.x_m, box.y_m, box.yaw_rad])).tolist()
        return Box(x, y, box.length_m, box.width_m, box.height_m, yaw)

    def pose(self, rng: np.random.Generator, around_m: float = 0.0) -> FloatArray:
        """A pose at which the outline fits with the wanted margin, and with so much room about the axle.

        Candidates are drawn in the building, not from the cells of the map: two versions, whose maps differ by some
        cells, get the same goals where both can go there.
        """
        least_m = max(self.footprint.inscribed_m + self.settings.drivable.wanted_margin_m, around_m)
        low, high = self._extent_m
        while True:
            x, y = rng.uniform(low, high).tolist()
            yaws = rng.permutation(_HEADINGS) * 2 * np.pi / _HEADINGS - np.pi
            row, column = self.costmap.cells_at(self.map_pose(se3.from_plane(x, y, 0.0))[None, :2])[0].tolist()
            rows, columns = self.costmap.distance_m.shape
            if not (0 <= row < rows and 0 <= column < columns) or self.costmap.is_lethal[row, column]:
                continue
            if self.costmap.distance_m[row, column] <= least_m:
                continue
            tries = np.array([self.map_pose(se3.from_plane(x, y, float(yaw))) for yaw in yaws])
            free = np.flatnonzero(self._drivable.tightness(tries) == 0)
            if len(free):
                return np.asarray(tries[free[0]])

    def way(self, costmap: Costmap, start: FloatArray, goal: FloatArray) -> Plan | None:
        """The plan, if the goal can be reached as it is."""
        plan = self.planner.plan(costmap, start, goal)
        return plan if isinstance(plan, Plan) and not plan.goal_change and plan.length_m > _LEAST_WAY_M else None

    def ways(self, costmap: Costmap, stops: Sequence[FloatArray]) -> list[Plan]:
        """From each stop to the next; none where one cannot be reached, which takes the planner seconds to say."""
        found = []
        for here, there in pairwise(stops):
            plan = self.way(costmap, here, there)
            if plan is None:
                return []
            found.append(plan)
        return found

    def goal_from(self, start: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, Plan]:
        """A goal that the map says can be reached from a pose, and the plan by the map alone."""
        while True:
            goal = self.pose(rng)
            plan = self.way(self.costmap, start, goal)
            if plan is not None:
                return goal, plan

    def course(self, rng: np.random.Generator, goals: int, things: int) -> Course:
        """Goals one after another, and so many things on the ways there that leave another way to each."""
        start = self.pose(rng, self.footprint.circumscribed_m + ROUND_M)
        found, ways = [start], list[Plan]()
        for of_goal in rng.spawn(goals):  # where one goal cannot be reached, the others stay the same
            goal, plan = self.goal_from(found[-1], of_goal)
            found.append(goal)
            ways.append(plan)
        placed: tuple[Box, ...] = ()
        lengths = tuple(way.length_m for way in ways)
        for _ in range(_TRIES if things else 0):
            tried = thing_on([way.poses for way in ways], found, rng)
            if tried is None:
                continue
            around = self.ways(self.costmap_with((*placed, tried)), found)
            if around:
                placed, lengths = (*placed, tried), tuple(way.length_m for way in around)
            if len(placed) == things:
                break
        return Course(start, tuple(found[1:]), lengths, placed)


def grid_with(grid: OccupancyGrid, things: Sequence[Box]) -> OccupancyGrid:
    """The same with things on it, cell by cell that they touch."""
    marked = np.zeros(grid.kind.shape, np.uint8)
    for thing in things:
        cells = (thing.corners_m - grid.origin) / grid.resolution_m - 0.5
        cv2.fillPoly(marked, [np.rint(cells).astype(np.int32)], 1)
    return grid.changed(marked.astype(bool), CellKind.OBSTACLE)


def thing_on(ways: list[FloatArray], stops: list[FloatArray], rng: np.random.Generator) -> Box | None:
    """A thing somewhere on ways (N, 3), a little aside; None where it would be too near to a start or goal."""
    way = ways[rng.integers(len(ways))]
    x, y, yaw = way[rng.integers(len(way))].tolist()
    aside_m = float(rng.uniform(-_ASIDE_M, _ASIDE_M))
    x, y = x - aside_m * np.sin(yaw), y + aside_m * np.cos(yaw)
    if min(float(np.hypot(x - stop[0], y - stop[1])) for stop in stops) < _OFF_GOALS_M:
        return None
    length_m, width_m = (float(side) for side in rng.uniform(*_SIDES_M, 2))
    return Box(
        float(x), float(y), length_m, width_m, float(rng.uniform(*_HEIGHTS_M)), float(rng.uniform(-np.pi, np.pi))
    )
