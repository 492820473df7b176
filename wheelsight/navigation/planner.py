"""Planner: returns a path for the robot's footprint from a costmap, a start and a goal, or a PlanFailure."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.checks import answer_of
from wheelsight.core.errors import ArgumentError, PartError
from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, Int32Array, IntArray
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.core.robots import RobotLimits
from wheelsight.navigation.clearance_kernels import Outline, clearances_at
from wheelsight.navigation.costmap import CellState, Costmap
from wheelsight.navigation.path_smoothing import Drivable, any_angle, driven
from wheelsight.navigation.planner_kernels import (
    NOTHING_LEFT,
    TOO_MANY,
    SearchTree,
    cost_to_go_kernel,
    descend,
    passable_costs,
    search,
    way_to,
)
from wheelsight.navigation.settings import Footprint, PlannerSettings, outline_of

# Limits of time and memory of a search: 90 MB, ten seconds or more; and of the plan that explains a failure, about a
# second on a small computer.
_MOST_STATES, _MOST_STATES_TO_EXPLAIN = 800_000, 50_000
# Bisections for the narrowest width: 20 m to a millimetre.
_HALVINGS = 14
# Random places tried before the robot is said to fit nowhere, and how many of them at once.
_PLACES_TRIED, _AT_ONCE = 1000, 200
# A plan that is blocked within the first distance is repaired: it joins the old one the second behind that, by a way in
# a window with the third around it. The fourth bounds its length, as a factor of the old part, plus the second.
_REPAIR_M, _BEYOND_M, _AROUND_M, _DETOUR = 8.0, 2.0, 3.0, 1.3
_ABOUT_UNKNOWN = "map it, or --set navigation.costmap.unknown=costly lets plans lead there"


class Planner:
    """Finds paths for the footprint of one robot.

    It straightens and rounds the cheapest path over the cells, and checks it against the footprint. If that collides,
    it searches places and headings, guided by the cost to go over the cells, and shortens the result. So only narrow
    places take long.

    Args:
        limits: of the robot; a limit of zero excludes the motion from plans.
    """

    def __init__(
        self, footprint: Footprint, settings: PlannerSettings | None = None, limits: RobotLimits | None = None
    ) -> None:
        self.footprint, self.settings = footprint, settings or PlannerSettings()
        self.limits, self.most_states = limits or RobotLimits(), _MOST_STATES
        self._outline = outline_of(footprint)

    def why_no_room_near(self, costmap: Costmap, goal: ArrayLike) -> PlanFailure | None:
        """Return why no plan may end at or beside a goal (3,), even if it could be reached; None if one may.

        A yaw of NaN is any heading.
        """
        drivable = Drivable.of(costmap, self.footprint, self.settings, self.limits)
        # As if all cells were connected, since reachability does not matter here.
        anywhere = np.ones(costmap.state.shape, np.int32)
        found = goal_near(drivable, np.asarray(goal, float), anywhere, 1, self.settings)
        return None if isinstance(found, PlanGoal) else found

    def plan(self, costmap: Costmap, start: ArrayLike, goal: ArrayLike) -> Plan | PlanFailure:
        """Return a path from a start to a goal, or why there is none; it raises nothing for any start and goal.

        Args:
            start: (3,) x, y, yaw of `base`.
            goal: the same, or (2,) for any heading.
        """
        begin, end = np.array(start, float).ravel(), np.array(goal, float).ravel()
        if len(begin) != 3 or len(end) not in (2, 3) or not np.isfinite([*begin, *end]).all():
            return PlanFailure(PlanReason.INVALID, f"from {begin} to {end}")
        end = np.array([*end, math.nan][:3])
        if self.limits.forward_m_s == 0 and self.limits.backward_m_s == 0:
            return PlanFailure(PlanReason.STANDS, "forward_m_s and backward_m_s are 0")
        cell = costmap.cells_at(begin[:2])
        if not ((cell >= 0) & (cell < costmap.state.shape)).all():
            return PlanFailure(PlanReason.START_OUTSIDE, beyond(costmap, begin))
        stood = costmap.standing_at(self.footprint.padded(self.settings.margin_m), begin)
        drivable = Drivable.of(stood, self.footprint, self.settings, self.limits)
        out = way_out(drivable, self._outline, begin, self.settings)
        if out is None:
            nor = f"nor within {_ESCAPE_M:g} m"
            known = Drivable.of(stood.with_unknown_free(), self.footprint, self.settings, self.limits)
            if way_out(known, self._outline, begin, self.settings) is None:
                return PlanFailure(PlanReason.START_OCCUPIED, nor)
            return PlanFailure(PlanReason.START_UNKNOWN, f"{nor}; {_ABOUT_UNKNOWN}")
        found = self._from(drivable, out, end)
        if isinstance(found, Plan) or found.reason is not PlanReason.UNREACHABLE:
            return found
        # With only the least margin, no step of the search may be free, though a slight arc is.
        wide = way_out(drivable, self._outline, begin, self.settings, is_wide=True)
        again = found if wide is None or len(wide) == 1 else self._from(drivable, wide, end)
        return again if isinstance(again, Plan) else found

    def repaired(self, costmap: Costmap, plan: Plan, start: ArrayLike) -> Plan | None:
        """Return a plan that joins the rest of an earlier one behind what blocks it; None if a whole plan is needed.

        It plans from a start (3,) to `_BEYOND_M` behind the last blocked pose, in a window around that part.
        """
        begin = np.array(start, float)
        # Half a turn counts as much as a metre.
        off = np.hypot(*(plan.poses[:, :2] - begin[:2]).T) + np.abs(wrap_angle(plan.poses[:, 2] - begin[2])) / np.pi
        at = len(off) - 1 - int(off[::-1].argmin())
        rest, directions = plan.poses[at:], plan.directions[at:]
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rest[:, :2], axis=0).T))])
        drivable = Drivable.of(costmap, self.footprint, self.settings, self.limits)
        is_free = drivable.is_free(rest)
        blocked_m = float(along[~is_free].max(initial=0.0))
        if blocked_m > _REPAIR_M or not is_free[-1]:
            return None
        join = min(int(np.searchsorted(along, blocked_m + _BEYOND_M)), len(rest) - 1)
        places = np.concatenate([rest[: join + 1, :2], begin[None, :2]])
        bounds = np.array([places.min(axis=0) - _AROUND_M, places.max(axis=0) + _AROUND_M])
        part = self.plan(costmap.window(bounds), begin, rest[join])
        if not isinstance(part, Plan) or part.goal_change or part.length_m > _DETOUR * float(along[join]) + _BEYOND_M:
            return None
        left = np.column_stack([rest, directions])[join:]
        return replace(
            plan,
            poses=np.concatenate([part.poses, left[1:, :3]]),
            directions=np.concatenate([part.directions, directions[join + 1 :]]),
            length_m=part.length_m + float(along[-1] - along[join]),
            least_clearance_m=min(part.least_clearance_m, drivable.clearance_m(left[:, :3])),
            cost=part.cost + drivable.cost(np.ascontiguousarray(left)),
            states=part.states,
        )

    def why_no_way(self, costmap: Costmap, start: ArrayLike, goal: ArrayLike) -> str:
        """Return what in a costmap keeps the robot from a goal (3,) without a plan, with places and widths."""
        begin, end = np.array(start, float), np.array(goal, float)
        quick = Planner(self.footprint, self.settings, self.limits)
        quick.most_states = _MOST_STATES_TO_EXPLAIN
        if (costmap.is_lethal & (costmap.state == CellState.UNKNOWN)).any():
            found = quick.plan(costmap.with_unknown_free(), begin, end[:2] if np.isnan(end[-1]) else end)
            if isinstance(found, Plan):
                drivable = Drivable.of(costmap, self.footprint, self.settings, self.limits)
                at = found.poses[int(np.argmin(drivable.is_free(found.poses)))]
                return f"floor on the way there is unknown, first at ({at[0]:.2f}, {at[1]:.2f}) m; {_ABOUT_UNKNOWN}"
        narrowest = narrowest_place(costmap, begin[:2], end[:2], self.settings.goal_tolerance_m)
        if narrowest is None:
            return "walls or obstacles of the map enclose it"
        width_m, (x, y) = narrowest
        low, high = self.footprint.corners.min(axis=0), self.footprint.corners.max(axis=0)
        needs_m = float(high[1] - low[1]) + 2 * self.settings.margin_m
        where = f"the way there is {width_m:.2f} m wide at ({x:.2f}, {y:.2f}) m"
        if width_m < needs_m:
            return f"{where}, and the robot needs {needs_m:.2f} m"
        limits = self.limits.forward_m_s, self.limits.backward_m_s, self.limits.turn_rad_s
        forbidden = ", or its limits of 0 forbid it" if 0 in limits else ""
        return f"{where} at its narrowest; the robot, {high[0] - low[0]:.2f} m long, has no room to turn{forbidden}"

    def why_no_room(self, costmap: Costmap) -> str:
        """Return why the robot fits nowhere in a costmap, with sizes; empty if it fits at one of many random places."""
        drivable = Drivable.of(costmap, self.footprint, self.settings, self.limits)
        cells = np.argwhere(costmap.distance_m >= self.footprint.inscribed_m)
        cells = np.random.default_rng(0).permutation(cells)[:_PLACES_TRIED]
        for some in np.array_split(cells, max(len(cells) // _AT_ONCE, 1)):
            poses = np.column_stack([costmap.middle_of(some), np.full(len(some), math.nan)])
            if np.isfinite(tightness_of(drivable, poses)).any():
                return ""
        widest_m = max(2 * float(costmap.distance_m.max()) - costmap.resolution_m, 0.0)
        length_m, width_m = np.ptp(self.footprint.corners, axis=0)
        return f"the widest is {widest_m:.2f} m, and the robot is {length_m:.2f} m long and {width_m:.2f} m wide"

    def _from(self, drivable: Drivable, out: FloatArray, end: FloatArray) -> Plan | PlanFailure:
        """Plan from the end of a way out (N, 4) to a goal (3,), or beside it."""
        metre_cost = passable(drivable)
        # Labels from 1 of cells connected by their edges; 0 where blocked.
        _, found = cv2.connectedComponents(np.isfinite(metre_cost).astype(np.uint8), connectivity=4, ltype=cv2.CV_32S)
        labels = found.astype(np.int32)
        row, column = drivable.costmap.cells_at(out[-1, :2]).tolist()
        aim = goal_near(drivable, end, labels, int(labels[row, column]), self.settings)
        if isinstance(aim, PlanFailure):
            return aim
        return self._way(drivable, metre_cost, out, aim)

    def _way(self, drivable: Drivable, metre_cost: Float32Array, out: FloatArray, goal: PlanGoal) -> Plan | PlanFailure:
        """Plan from the end of a way out (N, 4) to a reachable goal."""
        costmap = drivable.costmap
        goal_row, goal_column = costmap.cells_at(goal.pose[:2]).tolist()
        known = cost_to_go(metre_cost, costmap.resolution_m, (goal_row, goal_column))
        row, column = costmap.cells_at(out[-1, :2]).tolist()
        if not np.isfinite(known[row, column]):
            return PlanFailure(PlanReason.UNREACHABLE, "walls or obstacles are between")
        way = descend(known, metre_cost, float(costmap.resolution_m), row, column)
        corners = any_angle(way, known, drivable, metre_cost)
        if len(corners) < 2:
            corners = np.repeat(corners, 2, axis=0)
        corners[0], corners[-1] = out[-1, :2], goal.pose[:2]
        poses, states = driven(corners, out[-1], goal.pose, drivable), 0
        if poses is None or drivable.tightness(poses[:, :3]).any():
            found = self._searched(drivable, known, out[-1], goal)
            if isinstance(found, PlanFailure):
                if poses is None:
                    return found
            else:
                searched, looked_at, end = found
                states = looked_at if poses is None or end is goal else 0
                # In tight places both may be free: take the cheaper one that ends at the requested goal.
                if poses is None or (end is goal and drivable.cost(searched) < drivable.cost(poses)):
                    poses, goal = searched, end
        poses = drivable.smooth(poses)
        poses = np.concatenate([out[:-1], poses])
        path = poses[:, :3].copy()
        path[:, 2] = wrap_angle(path[:, 2])
        steps = np.diff(path[:, :2], axis=0)
        return Plan(
            poses=path,
            directions=poses[:, 3].astype(np.int64),
            length_m=float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
            least_clearance_m=drivable.clearance_m(path),
            goal=path[-1].copy(),
            goal_change=goal.change,
            frame=drivable.costmap.frame,
            cost=drivable.cost(poses),
            states=states,
            goal_off_m=goal.off_m,
            goal_off_rad=goal.off_rad,
        )

    def _searched(
        self, drivable: Drivable, known: FloatArray, start: FloatArray, goal: PlanGoal
    ) -> tuple[FloatArray, int, PlanGoal] | PlanFailure:
        """Search places and headings.

        Returns:
            Poses (N, 4), the number of states, and the goal that they lead to: if the search does not reach the goal's
            heading, the state there with the nearest heading.
        """
        most = self.most_states
        slots = 1 << math.ceil(math.log2(2 * most))
        tree = SearchTree(
            pose=np.empty((most, 4)),
            cost=np.empty(most),
            link=np.empty((most, 2), np.int32),
            table=np.full(slots, -1, np.int32),
            is_closed=np.empty(most, np.uint8),
            keys=np.empty(most, np.int64),
        )
        how, last, count = search(
            drivable.cells, drivable.shape, drivable.rules, known, np.ascontiguousarray(start[:3]), goal.pose, tree
        )
        if how == NOTHING_LEFT:
            # The state near the goal with the nearest heading.
            reached = tree.pose[:count]
            near = np.flatnonzero(np.hypot(*(reached[:, :2] - goal.pose[:2]).T) <= drivable.rules.place_m)
            turned = [_turn(goal.pose[2], yaw) for yaw in reached[near, 2]]
            last = int(near[np.argmin(turned)]) if len(near) else -1
            if last < 0:
                none = f"of {count} places and headings that can be reached none leads there"
                return PlanFailure(PlanReason.UNREACHABLE, f"{none}: too narrow, or no room to turn")
            goal = beside(goal.pose, tree.pose[last, :3], "no path leads to the goal as requested")
        if how == TOO_MANY:
            return PlanFailure(PlanReason.GAVE_UP, f"after {count} places and headings")
        room = np.empty((1 << 16, 4))
        end = way_to(drivable.rules, tree, last, goal.pose, room)
        if end == 0:
            return PlanFailure(PlanReason.GAVE_UP, f"the way has more than {len(room)} poses")
        return room[:end].copy(), count, goal


def narrowest_place(
    costmap: Costmap, start: FloatArray, goal: FloatArray, near_m: float
) -> tuple[float, tuple[float, float]] | None:
    """Return the narrowest width of the widest path between two places (2,), in metres, and its place (x, y).

    Both ends count from the widest place within `near_m`. None if walls separate them.
    """
    here, there = _roomiest(costmap, start, near_m), _roomiest(costmap, goal, near_m)
    low_m, high_m = 0.0, float(min(costmap.distance_m[here], costmap.distance_m[there]))
    if high_m == 0 or not _are_joined(costmap.distance_m > 0, here, there):
        return None
    if not _are_joined(costmap.distance_m >= high_m, here, there):
        for _ in range(_HALVINGS):
            middle_m = (low_m + high_m) / 2
            is_wide = _are_joined(costmap.distance_m >= max(middle_m, 1e-6), here, there)
            low_m, high_m = (middle_m, high_m) if is_wide else (low_m, middle_m)
    else:
        low_m = high_m
    metre_cost = np.where(costmap.distance_m >= max(low_m, 1e-6), 1, np.inf).astype(np.float32)
    known = cost_to_go(metre_cost, costmap.resolution_m, there)
    way = descend(known, metre_cost, float(costmap.resolution_m), *here)
    row, column = way[int(np.argmin(costmap.distance_m[way[:, 0], way[:, 1]]))]
    x, y = costmap.middle_of([row, column]).tolist()
    return 2 * float(costmap.distance_m[row, column]) - costmap.resolution_m, (x, y)


def _roomiest(costmap: Costmap, xy: FloatArray, near_m: float) -> tuple[int, int]:
    """Return row and column of the cell near a place (2,) that is farthest from obstacles."""
    reach = int(near_m / costmap.resolution_m)
    row, column = np.clip(costmap.cells_at(xy), 0, np.array(costmap.state.shape) - 1).tolist()
    top, left = max(row - reach, 0), max(column - reach, 0)
    near = costmap.distance_m[top : row + reach + 1, left : column + reach + 1]
    down, right = np.unravel_index(int(np.argmax(near)), near.shape)
    return top + int(down), left + int(right)


def _are_joined(is_open: BoolArray, here: tuple[int, int], there: tuple[int, int]) -> bool:
    """Return whether two cells are connected by open cells."""
    _, labels = cv2.connectedComponents(is_open.astype(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    return bool(labels[here] == labels[there] > 0)


# Longest step between poses of a plan: a cell of a usual map, and a turn by 6°.
_STEP_M, _STEP_RAD = 0.05, 0.1
# Largest offset of a path's end from its goal: half of the tolerance of an arrival.
_AT_GOAL_M, _AT_GOAL_RAD = 0.05, 0.05


class PlanReason(StrEnum):
    """Why there is no plan."""

    INVALID = "start or goal is not a pose"
    START_OUTSIDE = "the robot is outside the map"
    START_OCCUPIED = "the robot stands where something is, and finds no way out"
    START_UNKNOWN = "the floor around the robot is unknown, and it finds no way out"
    GOAL_OUTSIDE = "the goal is outside the map"
    GOAL_UNKNOWN = "the floor at the goal is unknown"
    GOAL_OCCUPIED = "the robot does not fit at the goal, nor near to it"
    GOAL_IN_WALL = "the map has no room for the robot at the goal"
    STANDS = "its limits let the robot neither forward nor backward"
    UNREACHABLE = "no way leads to the goal"
    IN_THE_WAY = "something that the map does not have is in the only way"
    NO_WAY_IN_MAP = "no way leads to the goal by the map itself"
    NO_ROOM_IN_MAP = "the map has no place that is wide enough for the robot"
    GAVE_UP = "no way was found within the bounds of the search"
    PART = "the planner failed"

    @property
    def is_for_good(self) -> bool:
        """Whether the failure is final: waiting does not make a plan possible."""
        return self in (
            PlanReason.INVALID,
            PlanReason.GOAL_OUTSIDE,
            PlanReason.GOAL_IN_WALL,
            PlanReason.NO_WAY_IN_MAP,
            PlanReason.NO_ROOM_IN_MAP,
            PlanReason.STANDS,
            PlanReason.PART,
        )

    @property
    def is_of_goal(self) -> bool:
        """Whether another goal may have a plan."""
        return self in (
            PlanReason.GOAL_UNKNOWN,
            PlanReason.GOAL_OCCUPIED,
            PlanReason.GOAL_IN_WALL,
            PlanReason.UNREACHABLE,
            PlanReason.IN_THE_WAY,
            PlanReason.NO_WAY_IN_MAP,
            PlanReason.GAVE_UP,
        )


@dataclass(frozen=True, slots=True)
class PlanFailure:
    """A failure to plan: the robot must stop."""

    reason: PlanReason
    detail: str

    def __bool__(self) -> bool:
        """False."""
        return False


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A path that the footprint can drive.

    Attributes:
        poses: (N, 3) x, y, yaw of `base`, dense: between two of them no point of the robot moves farther than twice the
            least margin. A turn in place keeps x and y.
        directions: (N,) 1 if a pose is reached forward, -1 if backward; a turn in place keeps the one before.
        least_clearance_m: of the footprint over all poses, at most 0.5 m; 0 if the start is too near to an obstacle.
        goal: (3,) end of the path.
        goal_change: why the end differs from the requested goal; empty if it does not.
        frame: of the poses: `map` or `odom`.
        cost: in metres of free floor.
        states: number of states searched; 0 if the path over the cells sufficed.
        goal_off_m, goal_off_rad: distance of the end from the requested goal.
    """

    poses: FloatArray
    directions: IntArray
    length_m: float
    least_clearance_m: float
    goal: FloatArray
    goal_change: str
    frame: str
    cost: float
    states: int
    goal_off_m: float = 0.0
    goal_off_rad: float = 0.0

    def __bool__(self) -> bool:
        """True."""
        return True

    @classmethod
    def along(cls, places: ArrayLike, yaw: float | None = None, frame: str = "map") -> Plan:
        """Return a plan forward along places (N, 2) from the robot on, with a turn in place at each bend.

        Args:
            places: x, y, metres; N is 2 or more.
            yaw: heading at the end, radians; None for the direction of the last part.
            frame: of the places and of the costmap.

        Raises ArgumentError for other shapes, or numbers that are not finite.
        """
        xy = np.asarray(places, float)
        if xy.ndim != 2 or xy.shape[1] != 2 or not np.isfinite(xy).all():
            raise ArgumentError(f"places of shape {xy.shape}", fix="(N, 2) finite metres")
        steps = np.diff(xy, axis=0)
        xy = np.concatenate([xy[:1], xy[1:][np.hypot(*steps.T) > 1e-6]])
        if len(xy) < 2:
            raise ArgumentError("places that lead nowhere", fix="two places or more, apart")
        headings = np.arctan2(*np.diff(xy, axis=0).T[::-1])
        ends = np.stack([xy[:-1], xy[1:]], axis=1).reshape(-1, 2)
        poses = np.column_stack([ends, np.repeat(headings, 2)])
        if yaw is not None:
            poses = np.concatenate([poses, [[*xy[-1], float(yaw)]]])
        length_m = float(np.hypot(*np.diff(xy, axis=0).T).sum())
        return cls(poses, np.ones(len(poses), np.int64), length_m, math.nan, poses[-1].copy(), "", frame, length_m, 0)


class PathPlanner(Protocol):
    """Finds a path over a costmap, as `Planner` does. `Navigator` accepts any other one as `planner`.

    The navigator checks the path ahead while it drives, and plans again if an obstacle is there. The collision monitor
    applies to all commands, so a path through a wall ends before the wall.
    """

    def plan(self, costmap: Costmap, start: FloatArray, goal: FloatArray) -> Plan | PlanFailure:
        """Return a plan from a start to a goal, or why there is none; `Plan.along` makes one from places.

        The call may come from another thread than the control of the robot. It comes several times per plan: once per
        intermediate goal, and again with unseen floor as obstacles. An exception, an answer of another type, or numbers
        that are not finite end the task with `PlanReason.PART`.

        Args:
            costmap: `state` and `is_lethal` (H, W), and `distance_m` to obstacles; do not write to it.
            start: (3,) x, y, yaw of `base` in the frame of the costmap.
            goal: (3,) in that frame, or (2,) for any heading.
        """
        ...


class OwnPlanner:
    """Wraps a user's planner and checks its answers. An invalid answer becomes a `PlanFailure`."""

    def __init__(self, part: PathPlanner) -> None:
        self._part = part

    def plan(self, costmap: Costmap, start: FloatArray, goal: FloatArray) -> Plan | PlanFailure:
        """Return the checked plan, with dense poses, and with its offset from the goal."""
        name = f"{type(self._part).__name__}.plan"
        try:
            found = answer_of(self._part, "plan", costmap, start.copy(), goal.copy())
        except PartError as error:
            return PlanFailure(PlanReason.PART, error.problem)
        if isinstance(found, PlanFailure):
            return found
        if not isinstance(found, Plan):
            return PlanFailure(PlanReason.PART, f"{name} answered {type(found).__name__}, not a Plan or PlanFailure")
        try:
            poses, directions = np.asarray(found.poses, float), np.asarray(found.directions, np.int64)
        except (TypeError, ValueError) as error:
            return PlanFailure(PlanReason.PART, f"{name} answered a plan without numbers: {error}")
        if poses.ndim != 2 or poses.shape[1] != 3 or not len(poses) or directions.shape != (len(poses),):
            of = f"poses of shape {poses.shape} and directions of shape {directions.shape}"
            return PlanFailure(PlanReason.PART, f"{name} answered {of}, not (N, 3) and (N,)")
        if not np.isfinite(poses).all():
            return PlanFailure(PlanReason.PART, f"{name} answered poses that are not finite")
        # Poses between, so that no step is long.
        made, ways = [poses[:1]], [directions[:1]]
        for before, after, direction in zip(poses[:-1], poses[1:], directions[1:], strict=True):
            way, turn = after[:2] - before[:2], float(wrap_angle(after[2] - before[2]))
            steps = max(math.ceil(np.hypot(*way) / _STEP_M), math.ceil(abs(turn) / _STEP_RAD), 1)
            share = np.arange(1, steps + 1)[:, None] / steps
            made.append(np.column_stack([before[:2] + share * way, wrap_angle(before[2] + share[:, 0] * turn)]))
            ways.append(np.full(steps, direction))
        poses, directions = np.concatenate(made), np.concatenate(ways)
        end = poses[-1].copy()
        off_m = float(np.hypot(*(end[:2] - goal[:2])))
        off_rad = 0.0 if len(goal) < 3 else float(abs(wrap_angle(end[2] - goal[2])))
        change = found.goal_change
        if not change and (off_m > _AT_GOAL_M or off_rad > _AT_GOAL_RAD):
            change = f"{name} leads beside the goal: {off_m:.2f} m and {np.degrees(off_rad):.0f}° beside it"
        length_m = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
        return replace(
            found,
            poses=poses,
            directions=directions,
            length_m=length_m,
            goal=end,
            goal_change=change,
            frame=costmap.frame,
            goal_off_m=off_m,
            goal_off_rad=off_rad,
        )


# Longest path away from an obstacle that the robot stands too near to; the largest depth of an obstacle inside its
# outline that counts as a pose error; and how much nearer such a path may lead than the robot stands. Controllers
# follow it with twice that.
_ESCAPE_M, _ESCAPE_DEPTH_M, _NEARER_M = 1.2, 0.15, 0.01
# Deviation from an occupied goal's heading within which a plan may end.
_GOAL_TOLERANCE_RAD = 0.35
# Curvatures of the arcs that leave a tight place, 1/m, in both directions.
_BENDS = (0.0, 0.1, -0.1, 0.2, -0.2, 0.5, -0.5, 1.5, -1.5)
# Spacing of poses on these arcs, where no margin covers the space between; and the cost of driving backward.
_ESCAPE_STEP_M, _BACKWARD = 0.01, 1.5
# Headings to each side of a goal's that are tried.
_TURN_STEPS = 3
# Places on a first arc at which a second one begins.
_SHARES = 3
# Headings that stand for any heading.
_ANY_HEADINGS = 16


@dataclass(frozen=True, slots=True, eq=False)
class PlanGoal:
    """Goal of a plan.

    Attributes:
        pose: (3,) x, y, yaw; a yaw of NaN is any heading.
        change: why it differs from the requested goal; empty if it does not.
        off_m, off_rad: distance from the requested goal.
    """

    pose: FloatArray
    change: str
    off_m: float = 0.0
    off_rad: float = 0.0


def passable(drivable: Drivable) -> Float32Array:
    """Return (H, W), the least cost of a metre; infinite where the centre of rotation cannot be anywhere in the cell.

    It includes the extra cost of tight places where the inscribed circle is tight at any heading.
    """
    slack_m, last = (0.5 - math.sqrt(0.5)) * drivable.costmap.resolution_m, len(drivable.margins_m) - 1
    least_m = drivable.footprint.inscribed_m + drivable.margins_m + slack_m
    # Where the widest outlines do not fit, the next one may.
    tight = drivable.rules.tight * (np.arange(1, last + 2) / max(last, 1)) ** 2
    tight[last] = math.inf
    lethal = np.ascontiguousarray(drivable.costmap.is_lethal)
    return np.asarray(passable_costs(drivable.cells, lethal, least_m.astype(np.float32), tight.astype(np.float32)))


def way_out(
    drivable: Drivable, outline: Outline, start: FloatArray, settings: PlannerSettings, *, is_wide: bool = False
) -> FloatArray | None:
    """Return a short path (N, 4) on which the robot gets clear of obstacles near it; None without any.

    It is one arc or turn, else two. Until it is clear, nothing comes nearer than at first by more than
    `_NEARER_M`. At a clear start it is that pose alone.

    Args:
        start: (3,) x, y, yaw.
        is_wide: whether clear means the wanted margin instead of the least one.
    """
    pose, most = np.array([[*start, 1.0]]), 0.0 if is_wide else 1.0
    if drivable.tightness(pose[:, :3])[0] <= most:
        return pose
    here_m = float(_clearances(drivable, outline, pose, settings)[0])
    if here_m < -_ESCAPE_DEPTH_M:
        return None
    least_m = min(settings.margin_m, here_m - _NEARER_M)
    dense = replace(drivable, rules=drivable.rules._replace(step_m=_ESCAPE_STEP_M))

    def passed(begin: FloatArray, arc: tuple[float, float]) -> FloatArray:
        """Extend a path by an arc until it is clear, or as far as it is allowed."""
        poses = np.r_[begin, dense.arc(begin[-1], *arc)[1:]]
        is_free = drivable.tightness(poses[:, :3]) <= most
        clear_m = _clearances(drivable, outline, poses, settings)
        has_come = np.maximum.accumulate(clear_m >= settings.margin_m + _NEARER_M)
        is_nearer = clear_m < np.where(has_come, settings.margin_m, least_m)
        is_nearer[0] = False
        ends = [*(np.flatnonzero(is_free)[:1] + 1), *np.flatnonzero(is_nearer)[:1], len(poses)]
        return np.asarray(poses[: int(min(ends))])

    bends = [(sense * _ESCAPE_M, sense * _ESCAPE_M * b) for sense in (1, -1) for b in _BENDS]
    arcs = [arc for arc in [*bends, (0.0, math.pi), (0.0, -math.pi)] if drivable.may(*arc)]
    first = [passed(pose, arc) for arc in arcs]
    begins = [way[: 1 + share * (len(way) - 1) // _SHARES] for way in first for share in range(1, _SHARES + 1)]
    second = (passed(begin, arc) for begin in begins if len(begin) > 1 for arc in arcs)
    free = ([way for way in ways if drivable.tightness(way[-1:, :3])[0] <= most] for ways in (first, second))
    found = next((ways for ways in free if ways), [])

    def length_m(way: FloatArray) -> float:
        """Return the length of a path, with turns by the motion of a corner, and with backward parts longer."""
        steps_m = np.hypot(*np.diff(way[:, :2], axis=0).T) + drivable.rules.reach_m * np.abs(np.diff(way[:, 2]))
        return float((steps_m * np.where(way[1:, 3] < 0, _BACKWARD, 1.0)).sum())

    return min(found, key=length_m, default=None)


def _clearances(drivable: Drivable, outline: Outline, poses: FloatArray, settings: PlannerSettings) -> FloatArray:
    """Return (N,) clearances of the footprint at poses (N, 4), as for controllers; negative inside an obstacle."""
    found = np.empty(len(poses))
    least_m = settings.margin_m + _NEARER_M
    clearances_at(drivable.costmap.field, outline, np.ascontiguousarray(poses[:, :3]), least_m, found)
    return found


def goal_near(
    drivable: Drivable, goal: FloatArray, labels: Int32Array, label: int, settings: PlannerSettings
) -> PlanGoal | PlanFailure:
    """Return a goal (3,), or the best reachable pose near it if the footprint does not fit there.

    That is the nearest one, with a cost of low clearance; a radian counts as a metre. Poses are tried on the costmap's
    grid, with three headings to each side.

    Args:
        goal: (3,) x, y, yaw; a yaw of NaN is any heading.
        labels: (H, W) number of the connected component of each cell; 0 where blocked.
        label: of the component where the robot is.
    """
    costmap = drivable.costmap
    row, column = costmap.cells_at(goal[:2]).tolist()
    if not (0 <= row < labels.shape[0] and 0 <= column < labels.shape[1]):
        return PlanFailure(PlanReason.GOAL_OUTSIDE, beyond(costmap, goal))
    if np.isfinite(tightness_of(drivable, goal[None])[0]):
        if labels[row, column] == label:
            return PlanGoal(goal, "")
        where = f"({goal[0]:.2f}, {goal[1]:.2f}) m"
        return PlanFailure(PlanReason.UNREACHABLE, f"{where} is free, but walls or obstacles enclose it")
    is_unknown = costmap.is_lethal[row, column] and costmap.state[row, column] == CellState.UNKNOWN
    # Poses within the tolerance, and their offsets.
    step_m = costmap.resolution_m
    count = int(settings.goal_tolerance_m / step_m)
    steps = step_m * np.arange(-count, count + 1)
    shares = np.arange(-_TURN_STEPS, _TURN_STEPS + 1) / _TURN_STEPS
    turns = np.zeros(1) if math.isnan(goal[2]) else _GOAL_TOLERANCE_RAD * shares
    offsets = np.stack(np.meshgrid(steps, steps, turns, indexing="ij"), axis=-1).reshape(-1, 3)
    away_m = np.hypot(offsets[:, 0], offsets[:, 1])
    kept = away_m <= settings.goal_tolerance_m
    poses, off = goal + offsets[kept], (away_m + np.abs(offsets[:, 2]))[kept]
    cells = costmap.cells_at(poses[:, :2])
    inside = ((cells >= 0) & (cells < labels.shape)).all(axis=1)
    near = np.zeros(len(poses), bool)
    near[inside] = labels[cells[inside, 0], cells[inside, 1]] == label
    poses, off = poses[near], off[near]
    tight = tightness_of(drivable, poses)
    # A pose with clearance is better than one slightly nearer that is hard to reach.
    score = off + 2 * settings.wanted_margin_m * tight
    if len(poses) and np.isfinite(score).any():
        return beside(goal, poses[int(np.argmin(score))], "the robot does not fit at the goal")
    reason = PlanReason.GOAL_UNKNOWN if is_unknown else PlanReason.GOAL_OCCUPIED
    return PlanFailure(reason, f"nor does it fit within {settings.goal_tolerance_m:g} m that can be reached")


def beyond(costmap: Costmap, pose: FloatArray) -> str:
    """Return a message that a pose lies outside a costmap, with its bounds."""
    low, high = costmap.middle_of([-0.5, -0.5]), costmap.middle_of(np.array(costmap.state.shape) - 0.5)
    reaches = f"which reaches from ({low[0]:.2f}, {low[1]:.2f}) to ({high[0]:.2f}, {high[1]:.2f}) m"
    return f"({pose[0]:.2f}, {pose[1]:.2f}) m is beyond the map's edge, {reaches}"


def beside(goal: FloatArray, pose: FloatArray, why: str) -> PlanGoal:
    """Return a pose (3,) as a replacement of a goal (3,), with its offset."""
    away_m, turned = float(np.hypot(*(pose - goal)[:2])), _turn(goal[2], pose[2])
    return PlanGoal(pose.copy(), f"{why}: {away_m:.2f} m and {math.degrees(turned):.0f}° beside it", away_m, turned)


def _turn(one: float, other: float) -> float:
    """Return the angle between two yaws; 0 if the first is NaN."""
    return 0.0 if math.isnan(one) else abs(math.remainder(float(one - other), 2 * math.pi))


def tightness_of(drivable: Drivable, poses: FloatArray) -> FloatArray:
    """Return (N,) as `Drivable.tightness` at poses (N, 3); for a yaw of NaN, the best of several headings."""
    if not np.isnan(poses[:, 2]).any():
        return drivable.tightness(poses)
    yaws = np.arange(_ANY_HEADINGS) * 2 * np.pi / _ANY_HEADINGS
    tried = np.stack([np.c_[poses[:, :2], np.full(len(poses), yaw)] for yaw in yaws])
    return np.asarray(drivable.tightness(tried.reshape(-1, 3)).reshape(len(yaws), -1).min(axis=0))


def cost_to_go(metre_cost: Float32Array, resolution_m: float, goal: tuple[int, int]) -> FloatArray:
    """Return (H, W), the cost of the cheapest 8-connected path from each cell to a goal; infinite if there is none.

    A step costs its length times the mean of both cells' costs. It may not cut the corner of a blocked cell.

    Args:
        metre_cost: (H, W) cost of a metre, at least 1; infinite where blocked.
        resolution_m: side of a cell.
        goal: row and column.

    Raises ArgumentError if the goal is outside, or a cost is below 1 or NaN.
    """
    if metre_cost.ndim != 2 or not all(0 <= at < size for at, size in zip(goal, metre_cost.shape, strict=True)):
        raise ArgumentError(f"cell {goal} of {metre_cost.shape}", fix="give row and column of a cell")
    # With costs below 1, cells would be settled too early.
    if not (metre_cost >= 1).all() or not 0 < resolution_m < np.inf:
        raise ArgumentError("a metre that costs less than 1, or nothing that is a number", fix="infinite where blocked")
    costs = np.ascontiguousarray(metre_cost, np.float32)
    return np.asarray(cost_to_go_kernel(costs, float(resolution_m), np.array([goal]), np.zeros(1)))
