"""A tour through a building that a wheelchair can drive: from room to room, by shortest ways, and back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import shapely
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from shapely.ops import substring

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, IntArray
from wheelsight_sim.drivers import Path2d, laps_of, smooth_path
from wheelsight_sim.robot import RobotModel
from wheelsight_sim.settings import FloorPlan
from wheelsight_sim.worlds.floor_plan_rooms import Doorway, FreeSpace, drawn

_ASKED_MARGIN_M = 0.107  # beside the chair: what `refuse_walls` asks for, and what walls may come through each other
SIDE_MARGIN_M = 0.11  # planned with
USUAL_WAY_M = 100.0
_SWEPT_MARGIN_M = 0.05  # a driver strays by centimetres
_GOALS_APART_M = (2.0, 5.0)
_MOST_GOALS = 14
_SMOOTHED_M = (0.3, 0.15, 0.05)
_OFF_LINE_M = 0.03
_DEARER = 1.05  # smooth ways may cost so much more than the cheapest
_ROOMY_STARTS, _MOST_STARTS = 3, 8
_LONG_ENOUGH = 0.5  # of what is wanted; else other starts are tried, too
_SAME_M = 0.03
_STREAM = 0x90
_POSES_APART_M = 0.1
_SHORTEST_M = 0.6
_AHEAD_M = 0.5


@dataclass(frozen=True, slots=True)
class Route:
    """Waypoints (N, 2) of a lap in `map`, metres; whether the last leads back to the first; how often it is driven."""

    waypoints: FloatArray
    is_loop: bool
    laps: int = 1

    @property
    def all_waypoints(self) -> FloatArray:
        """Of all laps, one after the other."""
        return np.tile(self.waypoints, (self.laps, 1))

    @property
    def length_m(self) -> float:
        """Of a lap, or of the way."""
        return float(self.line.length)

    def around(self, radius_m: float) -> shapely.Geometry:
        """All that is within a radius of the route; leg by leg, since buffers of ways to and fro have gaps."""
        ends = shapely.get_coordinates(self.line)
        return shapely.union_all(shapely.buffer(shapely.linestrings(np.stack([ends[:-1], ends[1:]], axis=1)), radius_m))

    @property
    def line(self) -> shapely.LineString:
        """Of a lap, or of the way."""
        return shapely.LineString(np.vstack([self.waypoints, self.waypoints[:1]]) if self.is_loop else self.waypoints)


@dataclass(frozen=True, slots=True)
class Body:
    """A robot from above: how far it reaches from the middle of its axle, metres."""

    front_m: float
    tail_m: float
    half_width_m: float

    @classmethod
    def of(cls, robot: RobotModel) -> Body:
        """The wheelchair's."""
        return cls(robot.length_m - robot.tail_m, robot.tail_m, robot.width_m / 2)

    @property
    def turning_m(self) -> float:
        """Radius of the circle that it needs to turn on the spot."""
        return float(np.hypot(self.front_m, self.half_width_m)) + _SWEPT_MARGIN_M

    def outlines(self, x_m: FloatArray, y_m: FloatArray, yaws_rad: FloatArray, margin_m: float) -> FloatArray:
        """Corners (N, 4, 2) at poses (N,), with a margin all round."""
        front, back, half = self.front_m + margin_m, -self.tail_m - margin_m, self.half_width_m + margin_m
        corners = np.array([(front, half), (back, half), (back, -half), (front, -half)])
        c, s = np.cos(yaws_rad)[:, None], np.sin(yaws_rad)[:, None]
        x = x_m[:, None] + c * corners[:, 0] - s * corners[:, 1]
        y = y_m[:, None] + s * corners[:, 0] + c * corners[:, 1]
        return np.stack([x, y], axis=-1)


def plan_route(
    space: FreeSpace, doorways: Sequence[Doorway], robot: RobotModel, seed: int, plan: FloorPlan, least_m: float
) -> Route:
    """A closed tour from room to room, or one way where there is no place to turn.

    Doorways are passed straight, and the seed decides which rooms are visited. `plan` says where it begins, and about
    how long a lap is, else up to USUAL_WAY_M; with rooms too few for `least_m` a tour is driven again.

    Raises:
        ConfigError: a start where the robot does not fit, or nowhere to go.
    """
    rng, start = np.random.default_rng([seed, _STREAM]), plan.start
    body = Body.of(robot)
    ground = DrivableGrid.of(space, body.half_width_m + SIDE_MARGIN_M, None if start is None else start[:2])
    wanted_m = USUAL_WAY_M if plan.way_m is None else plan.way_m
    planners = [_Planner(ground, body, tuple(doorways), first, start) for first in _starts(ground, body, rng, start)]
    route: Route | None = None
    for planner in planners:
        # A room whose door is too narrow to turn into is no place to begin; another is.
        tour = planner.tour(rng, wanted_m)
        if tour is not None and (route is None or tour.length_m > route.length_m):
            route = tour
        if route is not None and route.length_m >= _LONG_ENOUGH * wanted_m:
            break
    route = route or planners[0].one_way(wanted_m)
    if not route.is_loop:
        return route
    # A tour of 90 m is near enough to 100; what is much shorter is driven again.
    laps = max(math.ceil(least_m / route.length_m), round((plan.way_m or 0.0) / route.length_m), 1)
    return replace(route, laps=laps)


def _starts(
    ground: DrivableGrid, body: Body, rng: np.random.Generator, start: tuple[float, float, float] | None
) -> list[tuple[int, int]]:
    """Rows and columns where the robot may begin, the best first. Raises ConfigError where it does not fit there."""
    if start is not None:
        row, column = ground.space.cells_at(np.array(start[:2])).tolist()
        x_m, y_m, yaw_rad = np.array(start)[:, None]
        around = body.outlines(x_m, y_m, yaw_rad, _SWEPT_MARGIN_M)
        if not ground.is_open[row, column] or not shapely.covers(ground.space.shape, shapely.polygons(around[0])):
            where = f"x = {start[0]:g}, y = {start[1]:g} m"
            problem = f"--start {where} is too near to a wall, or off the floor"
            raise ConfigError(problem, fix="the plan.png of a drive without it shows the floor")
        return [(row, column)]
    roomiest_m = float((ground.away_m * ground.is_open).max())
    goals = _goals(ground, min(body.turning_m, roomiest_m))
    best = rng.permutation(goals[:_ROOMY_STARTS])
    return [(int(row), int(column)) for row, column in [*best, *goals[_ROOMY_STARTS:_MOST_STARTS]]]


def _goals(ground: DrivableGrid, room_m: float) -> IntArray:
    """Cells (N, 2) that are `room_m` from walls, the roomiest first, some metres from each other."""
    space = ground.space
    cells = np.argwhere((ground.is_open > 0) & (ground.away_m >= room_m))
    order = np.argsort(-ground.away_m[cells[:, 0], cells[:, 1]], kind="stable")
    cells = cells[order]
    apart = np.clip(np.sqrt(space.shape.area) / 4, *_GOALS_APART_M) / space.cell_m
    goals: list[IntArray] = []
    while len(cells):
        goals.append(cells[0])
        cells = cells[np.hypot(*(cells - cells[0]).T) >= apart]
    return np.array(goals, int).reshape(-1, 2)


class _Planner:
    """Plans ways from one start."""

    def __init__(
        self,
        ground: DrivableGrid,
        body: Body,
        doorways: Sequence[Doorway],
        first: tuple[int, int],
        start: tuple[float, float, float] | None,
    ) -> None:
        self._ground, self._body, self._doorways = ground, body, doorways
        self._first, self._start = first, start

    def tour(self, rng: np.random.Generator, wanted_m: float) -> Route | None:
        """Closed through places near the start where the robot can turn; None where there are too few of them.

        Places that it could not reach without touching a wall are left out.
        """
        if self._ground.away_m[self._first] < self._body.turning_m:
            return None
        ways = self._ground.ways(limit=wanted_m)
        found = [ways.from_cell(self._first)]
        goals = _goals(self._ground, self._body.turning_m)
        reach = found[0][0][ways.index[goals[:, 0], goals[:, 1]]]
        is_apart = np.hypot(*(goals - self._first).T) * self._ground.space.cell_m > _SHORTEST_M
        goals = rng.permutation(goals[(reach < wanted_m / 2) & is_apart])[:_MOST_GOALS]
        stops = [self._first, *[(int(row), int(column)) for row, column in goals]]
        found += [ways.from_cell(stop) for stop in stops[1:]]
        numbers = [int(ways.index[stop]) for stop in stops]
        between = np.array([[costs[k] for k in numbers] for costs, _ in found])
        kept = list(range(len(stops)))
        while len(kept) > 1:
            order = [kept[k] for k in _order(between[np.ix_(kept, kept)], wanted_m)]
            legs = [self._waypoints(ways.way(found[a][1], stops[b])) for a, b in pairwise([*order, order[0]])]
            lap = np.concatenate([leg[:-1] for leg in legs])
            # Where a doorway's lane ends at a stop, leaving it begins where coming to it ended.
            while len(lap) > 2:
                same = np.flatnonzero(np.hypot(*(np.roll(lap, -1, axis=0) - lap).T) <= _SAME_M)
                if not len(same):
                    break
                lap = np.delete(lap, same[-1], axis=0)
            lap = lap if len(lap) > 2 else np.insert(lap, 1, lap.mean(axis=0), axis=0)
            route = Route(self._headed(lap), is_loop=True)
            touched = _touched(self._ground.space, self._body, route)
            if not len(touched):
                return route
            # The stop, not the first, on the way to or from which the robot touches a wall.
            apart = [shapely.distance(shapely.LineString(leg), shapely.Point(touched[0])) for leg in legs]
            leg = int(np.argmin(apart))
            ends = [order[leg], order[(leg + 1) % len(order)]]
            from_begin, from_end = (np.hypot(*(legs[leg][k] - touched[0])) for k in (0, -1))
            nearer = ends[0] if from_begin < from_end else ends[1]
            kept.remove(nearer if nearer != order[0] else next(end for end in ends if end != order[0]))
        return None

    def one_way(self, wanted_m: float) -> Route:
        """To the farthest cell, from the start or, where that is free, from the cell farthest from it.

        It is the longest part on which the robot touches no wall. Raises ConfigError where there is none.
        """
        ways = self._ground.ways(limit=np.inf)
        costs, before = ways.from_cell(self._first)
        end = ways.farthest(costs)
        if self._start is None:
            costs, before = ways.from_cell(end)
            end = ways.farthest(costs)
        waypoints = self._headed(self._waypoints(ways.way(before, end)))
        line = shapely.LineString(waypoints)
        touched = _touched(self._ground.space, self._body, Route(waypoints, is_loop=False))
        along_m = np.sort(shapely.line_locate_point(line, shapely.points(touched)))
        begins = np.array([0.0, *(along_m + _POSES_APART_M)])
        ends = np.array([*(along_m - _POSES_APART_M), line.length])
        best = 0 if self._start is not None else int(np.argmax(ends - begins))
        begin_m, end_m = float(begins[best]), float(min(ends[best], begins[best] + wanted_m))
        if end_m - begin_m < _SHORTEST_M:
            problem = "there is no way from the start on which the robot does not touch a wall"
            raise ConfigError(problem, fix="begin elsewhere with --start x,y,yaw")
        return Route(shapely.get_coordinates(substring(line, begin_m, end_m)), is_loop=False)

    def _headed(self, waypoints: FloatArray) -> FloatArray:
        """The waypoints; where a start was asked for, first that place exactly, and a short leg in its direction."""
        if self._start is None:
            return waypoints
        x_m, y_m, yaw_rad = self._start
        ahead = (x_m + _AHEAD_M * math.cos(yaw_rad), y_m + _AHEAD_M * math.sin(yaw_rad))
        return np.vstack([[(x_m, y_m), ahead], waypoints[1:]])

    def _waypoints(self, cells: IntArray) -> FloatArray:
        """(N, 2) in `map`: the way through cells (M, 2), straight through doorways and smooth elsewhere."""
        line = self._ground.space.middle_of(cells)
        along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
        # The doorways that a line (N, 2) goes through, with the number of the point before each.
        string = shapely.LineString(line) if len(line) > 1 else shapely.Point(line[0])
        found = []
        for doorway in self._doorways:
            if shapely.intersects(string, shapely.LineString([doorway.left, doorway.right])):
                ahead = (line - doorway.middle) @ doorway.onward
                near = np.hypot(*(line - doorway.middle).T)
                changes = np.flatnonzero((np.diff(np.sign(ahead)) != 0) & (near[1:] < doorway.width_m))
                found += [(int(change), doorway) for change in changes[:1]]
        crossed = sorted(found, key=lambda crossing: crossing[0])
        pieces, begin_m, entry = [], 0.0, np.empty((0, 2))
        for k, (at, doorway) in enumerate(crossed):
            side = 1 if (line[at] - doorway.middle) @ doorway.onward > 0 else -1
            room_before = (along_m[at] - (along_m[crossed[k - 1][0]] if k else 0.0)) / (2 if k else 1)
            after = along_m[crossed[k + 1][0]] if k + 1 < len(crossed) else along_m[-1]
            room_after = (after - along_m[at]) / (2 if k + 1 < len(crossed) else 1)
            before_m = min(self._ground.lane_m(doorway, side), room_before)
            after_m = min(self._ground.lane_m(doorway, -side), room_after)
            ends = doorway.middle + np.array([side * before_m, -side * after_m])[:, None] * doorway.onward
            inner = line[(along_m > begin_m) & (along_m < along_m[at] - before_m)]
            pieces.append(self._smooth(np.concatenate([entry, inner, ends[:1]])))
            begin_m, entry = along_m[at] + after_m, ends[1:]
        pieces.append(self._smooth(np.concatenate([entry, line[along_m > begin_m]] if crossed else [line])))
        # Without waypoints that hardly differ from the one before; the last stays.
        waypoints = np.concatenate(pieces)
        kept = [0]
        for k in range(1, len(waypoints)):
            if np.hypot(*(waypoints[k] - waypoints[kept[-1]])) > _SAME_M:
                kept.append(k)
        if len(kept) > 1:
            kept[-1] = len(waypoints) - 1
        return np.asarray(waypoints[kept])

    def _smooth(self, line: FloatArray) -> FloatArray:
        """A way (N, 2) made smooth, as far as it stays on open ground, and thinned; its ends stay where they are."""
        if len(line) < 3:
            return line
        cell_m = self._ground.space.cell_m
        for smoothed_m in _SMOOTHED_M:
            sigma = smoothed_m / cell_m
            n = min(len(line) - 1, int(4 * sigma))
            # Reflected about its ends, so that they stay.
            longer = np.concatenate([2 * line[0] - line[n:0:-1], line, 2 * line[-1] - line[-2 : -n - 2 : -1]])
            eased = gaussian_filter1d(longer, sigma, axis=0)[n : n + len(line)]
            eased[0], eased[-1] = line[0], line[-1]
            thinned = shapely.get_coordinates(shapely.simplify(shapely.LineString(eased), _OFF_LINE_M))
            if self._ground.price(thinned) <= _DEARER * self._ground.price(line):
                return np.asarray(thinned)
        return np.asarray(shapely.get_coordinates(shapely.simplify(shapely.LineString(line), 1e-6)))


def _order(between: FloatArray, wanted_m: float) -> list[int]:
    """The stops of a closed tour in their order: each is put in where it makes the tour least longer."""
    order = [0]
    length_m = 0.0
    for k in range(1, len(between)):
        after = [*order[1:], order[0]]
        longer = [between[a, k] + between[k, b] - between[a, b] for a, b in zip(order, after, strict=True)]
        best = int(np.argmin(longer))
        if len(order) == 1 or length_m + longer[best] <= wanted_m:
            length_m += longer[best]
            order.insert(best + 1, k)
    return order


def swept_by(body: Body, route: Route, margin_m: float) -> shapely.Geometry:
    """Everything the robot passes over on a route, either way round, with a margin and circles where it turns."""
    parts = [route.around(body.half_width_m + SIDE_MARGIN_M + 0.03)]
    for path in _paths(route):
        poses = _poses(path)
        parts += list(shapely.polygons(body.outlines(*poses, margin_m)))
        parts += [shapely.Point(end).buffer(body.turning_m + margin_m) for end in (path.xy_m[0], path.xy_m[-1])]
    return shapely.union_all(parts)


def _touched(space: FreeSpace, body: Body, route: Route) -> FloatArray:
    """(N, 2) where the robot would touch a wall on the route, or come too near, driven either way round."""
    along = shapely.get_coordinates(shapely.segmentize(route.line, _POSES_APART_M / 2))
    boundary = space.shape.boundary
    shapely.prepare([boundary, space.shape])
    is_near = shapely.dwithin(boundary, shapely.points(along), body.half_width_m + _ASKED_MARGIN_M)
    touched = [along[is_near]]
    for path in _paths(route):
        x_m, y_m, yaws_rad = _poses(path)
        is_clear = shapely.covers(space.shape, shapely.polygons(body.outlines(x_m, y_m, yaws_rad, _SWEPT_MARGIN_M)))
        touched.append(np.stack([x_m, y_m], axis=-1)[~is_clear])
        # Where one path ends and another begins, the robot turns on the spot; a way's own ends are left out.
        ends = path.xy_m[[0, -1]] if route.is_loop else np.empty((0, 2))
        is_tight = shapely.dwithin(boundary, shapely.points(ends), body.turning_m - _SWEPT_MARGIN_M)
        touched.append(ends[is_tight])
    return np.concatenate(touched)


def _paths(route: Route) -> list[Path2d]:
    """What a driver makes of the waypoints, either way round."""
    both = (route.waypoints, route.waypoints[::-1])
    return [path for waypoints in both for path in smooth_path(laps_of(waypoints, route.is_loop, 1))]


def _poses(path: Path2d) -> tuple[FloatArray, FloatArray, FloatArray]:
    """x, y and yaw (N,) along a path."""
    along_m = np.arange(0, path.length_m, _POSES_APART_M)
    x_m, y_m = (np.interp(along_m, path.along_m, column) for column in path.xy_m.T)
    return x_m, y_m, np.interp(along_m, path.along_m, path.yaws_rad)


# A metre beside a wall costs as much as five in the open: drivers keep to the middle of corridors.
_WALL_COST, _COMFORTABLE_M = 4.0, 0.9
# A wheelchair's footplates are 0.8 m ahead of its axle, and in the doorway before that has turned. It turns before,
# and has as much again to come straight.
_LANE_M = 1.6
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))


@dataclass(frozen=True, eq=False)
class DrivableGrid:
    """Cells on which the middle of a robot's axle can be.

    Attributes:
        space: the floor.
        is_open: (R, C) uint8, 1 for such cells; all can be reached from each other.
        away_m: (R, C) metres to the nearest wall.
        cost: (R, C) of a metre there, at least 1.
    """

    space: FreeSpace
    is_open: ByteArray
    away_m: Float32Array
    cost: Float32Array

    @classmethod
    def of(cls, space: FreeSpace, half_width_m: float, start: tuple[float, float] | None = None) -> DrivableGrid:
        """The part that is `half_width_m` from every wall and joined to a place, else the largest; may be empty."""
        is_open = drawn(space.shape.buffer(-half_width_m), space.plan, space.grid.shape, is_generous=True)
        away_m = space.distance_m()
        cost = 1 + _WALL_COST * np.maximum(1 - away_m / _COMFORTABLE_M, 0)
        _, labels, facts, _ = cv2.connectedComponentsWithStats(is_open, connectivity=8)
        part = 1 + int(np.argmax(facts[1:, cv2.CC_STAT_AREA])) if len(facts) > 1 else -1
        if start is not None:
            row, column = space.cells_at(np.array(start)).tolist()
            part = int(labels[row, column]) or -1
        return cls(space, (labels == part).astype(np.uint8), away_m, cost.astype(np.float32))

    def lane_m(self, doorway: Doorway, side: int) -> float:
        """How far straight out of a doorway, on its left (1) or right (-1), one can drive, up to _LANE_M."""
        steps_m = np.arange(0.0, _LANE_M + 1e-9, self.space.cell_m / 2)
        cells = self.space.cells_at(doorway.middle + side * steps_m[:, None] * doorway.onward)
        closed = np.flatnonzero(self.is_open[cells[:, 0], cells[:, 1]] == 0)
        return float(steps_m[max(closed[0] - 1, 0)]) if len(closed) else _LANE_M

    def price(self, waypoints: FloatArray) -> float:
        """What a way through waypoints (N, 2) costs; infinite where it leaves open ground."""
        line = shapely.segmentize(shapely.LineString(waypoints), self.space.cell_m / 2)
        points = shapely.get_coordinates(line)
        cells = self.space.cells_at((points[1:] + points[:-1]) / 2)
        if not self.is_open[cells[:, 0], cells[:, 1]].all():
            return np.inf
        return float(self.cost[cells[:, 0], cells[:, 1]] @ np.hypot(*np.diff(points, axis=0).T))

    def ways(self, limit: float) -> Ways:
        """What finds shortest ways of up to that cost."""
        rows, columns = np.nonzero(self.is_open)
        height, width = self.is_open.shape
        index = np.full(self.is_open.shape, -1, np.int64)
        index[rows, columns] = np.arange(len(rows))
        ends, weights = [], []
        for down, right in _STEPS:
            r, c = rows + down, columns + right
            fits = (r < height) & (c >= 0) & (c < width)
            a, r, c = np.flatnonzero(fits), r[fits], c[fits]
            b = index[r, c]
            a, b = a[b >= 0], b[b >= 0]
            length_m = self.space.cell_m * np.hypot(down, right)
            ends.append(np.stack([a, b]))
            price = self.cost[rows, columns]
            weights.append(length_m * (price[a] + price[b]) / 2)
        a, b = np.concatenate(ends, axis=1)
        graph = coo_array((np.concatenate(weights), (a, b)), shape=(len(rows), len(rows))).tocsr()
        return Ways(self, index, np.stack([rows, columns], axis=-1), graph, limit)


@dataclass(frozen=True, eq=False)
class Ways:
    """The graph of open cells.

    Attributes:
        ground: whose cells.
        index: (R, C) number of each open cell, -1 for others.
        cells: (N, 2) row and column of each number.
        graph: what a step between two costs.
        limit: no way costs more.
    """

    ground: DrivableGrid
    index: IntArray
    cells: IntArray
    graph: Any
    limit: float

    def from_cell(self, cell: tuple[int, int]) -> tuple[FloatArray, IntArray]:
        """Costs (N,) of the ways from a cell to all others, infinite beyond the limit, and the cells before (N,)."""
        number = int(self.index[cell])
        costs, before = dijkstra(self.graph, False, number, return_predecessors=True, limit=self.limit)
        return np.asarray(costs), np.asarray(before)

    def way(self, before: IntArray, end: tuple[int, int]) -> IntArray:
        """Cells (M, 2) from where `before` began to `end`."""
        numbers = [int(self.index[end])]
        while before[numbers[-1]] >= 0:
            numbers.append(int(before[numbers[-1]]))
        return np.asarray(self.cells[numbers[::-1]])

    def farthest(self, costs: FloatArray) -> tuple[int, int]:
        """The cell of which costs (N,) are greatest, but finite."""
        row, column = self.cells[int(np.argmax(np.where(np.isfinite(costs), costs, -1)))].tolist()
        return row, column
