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
from wheelsight.navigation.footprint import Footprint, outline_of
from wheelsight.navigation.path_smoothing import Drivable, any_angle, centred, driven, shortened
from wheelsight.navigation.planner_kernels import (
    NOTHING_LEFT,
    TOO_MANY,
    Tree,
    cost_to_go_kernel,
    descend,
    search,
    way_to,
)
from wheelsight.navigation.settings import PlannerSettings

# Planner: a way that a footprint can drive, from a costmap, a start and a goal.
#
# First the cheapest way over the cells is made straight, rounded and held against the footprint. Where the footprint
# does not pass along it, places and headings are searched, guided by what is left to go over the cells; then that way
# is made shorter. So narrow doors cost time only where there are any.


_DIMENSIONS = (2, 3)
_ROUNDS = 4
# To say why there is no plan takes another one at most, and no long one: about a second on a small computer.
_MOST_STATES_TO_EXPLAIN = 50_000
# Widths are halved so often until the narrowest place is known: 20 m to a millimetre.
_HALVINGS = 14
# Places, by chance, at which no robot of any use fails to fit everywhere; and how many are looked at before the next.
_PLACES_TRIED, _AT_ONCE = 1000, 200
_ABOUT_UNKNOWN = "map it, or --set navigation.costmap.unknown=costly lets plans lead there"


class Planner:
    """Plans for one robot.

    Args:
        footprint: of the robot.
        settings: or the defaults.
        limits: of the robot: what one of zero forbids is in no plan.
    """

    def __init__(
        self, footprint: Footprint, settings: PlannerSettings | None = None, limits: RobotLimits | None = None
    ) -> None:
        self.footprint, self.settings = footprint, settings or PlannerSettings()
        self.limits = limits or RobotLimits()
        self._outline = outline_of(footprint)

    def has_room(self, costmap: Costmap, poses: ArrayLike) -> BoolArray:
        """(N,) whether the footprint fits at poses (N, 3) with the wanted margin."""
        drivable = Drivable.of(costmap, self.footprint, self.settings, self.limits)
        return np.asarray(drivable.tightness(np.asarray(poses, float)) == 0)

    def why_no_room_near(self, costmap: Costmap, goal: ArrayLike) -> PlanFailure | None:
        """Why no plan may end at a goal (3,) or beside it, whatever is between; None where one may.

        A yaw of NaN is any heading.
        """
        drivable = Drivable.of(costmap, self.footprint, self.settings, self.limits)
        # As if all cells were joined: which of them can be reached is not asked.
        anywhere = np.ones(costmap.state.shape, np.int32)
        found = goal_near(drivable, np.asarray(goal, float), anywhere, 1, self.settings)
        return None if isinstance(found, Goal) else found

    def plan(self, costmap: Costmap, start: ArrayLike, goal: ArrayLike) -> Plan | PlanFailure:
        """A way from where the robot stands to a goal.

        What anybody may ask for is answered by a reason, and raises nothing.

        Args:
            costmap: in the frame of start and goal.
            start: (3,) x, y, yaw of `base`.
            goal: likewise; or (2,), where any heading will do.
        """
        begin, end = np.array(start, float).ravel(), np.array(goal, float).ravel()
        if len(begin) != 3 or len(end) not in _DIMENSIONS or not np.isfinite([*begin, *end]).all():
            return PlanFailure(PlanReason.INVALID, f"from {begin} to {end}")
        end = np.array([*end, math.nan][:3])
        if self.limits.forward_m_s == 0 and self.limits.backward_m_s == 0:
            return PlanFailure(PlanReason.STANDS, "forward_m_s and backward_m_s are 0")
        if not _is_inside(costmap, begin):
            return PlanFailure(PlanReason.START_OUTSIDE, beyond(costmap, begin))
        stood = costmap.standing_at(self.footprint.padded(self.settings.margin_m), begin)
        drivable = Drivable.of(stood, self.footprint, self.settings, self.limits)
        out = way_out(drivable, self._outline, begin, self.settings)
        if out is None:
            return self._stuck(stood, begin)
        found = self._from(drivable, out, end)
        if isinstance(found, Plan) or found.reason is not PlanReason.UNREACHABLE:
            return found
        # With the least margin alone, it may stand where no step of the search lets it turn, though a slight arc does.
        wide = way_out(drivable, self._outline, begin, self.settings, is_wide=True)
        again = found if wide is None or len(wide) == 1 else self._from(drivable, wide, end)
        return again if isinstance(again, Plan) else found

    def _stuck(self, costmap: Costmap, begin: FloatArray) -> PlanFailure:
        """Why there is no way out from where the robot stands (3,): things, or floor that is unknown."""
        known = Drivable.of(costmap.with_unknown_free(), self.footprint, self.settings, self.limits)
        nor = f"nor within {self.settings.escape_m:g} m"
        if way_out(known, self._outline, begin, self.settings) is None:
            return PlanFailure(PlanReason.START_OCCUPIED, nor)
        return PlanFailure(PlanReason.START_UNKNOWN, f"{nor}; {_ABOUT_UNKNOWN}")

    def why_no_way(self, costmap: Costmap, start: ArrayLike, goal: ArrayLike) -> str:
        """What of a costmap keeps the robot from a goal (3,) to which there is no plan, with places and widths."""
        begin, end = np.array(start, float), np.array(goal, float)
        rules = self.settings.model_copy(update={"most_states": _MOST_STATES_TO_EXPLAIN})
        quick = Planner(self.footprint, rules, self.limits)
        if (costmap.is_lethal & (costmap.state == CellState.UNKNOWN)).any():
            found = quick.plan(costmap.with_unknown_free(), begin, end[:2] if np.isnan(end[-1]) else end)
            if isinstance(found, Plan):
                drivable = Drivable.of(costmap, self.footprint, self.settings, self.limits)
                at = found.poses[int(np.argmin(drivable.is_free(found.poses)))]
                return f"floor on the way there is unknown, first at ({at[0]:.2f}, {at[1]:.2f}) m; {_ABOUT_UNKNOWN}"
        narrowest = narrowest_place(costmap, begin[:2], end[:2], self.settings.goal_tolerance_m)
        if narrowest is None:
            return "walls or things of the map are all round it"
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
        """Why the robot fits nowhere in a costmap, with sizes; empty where it fits at any of many places."""
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
        """To a goal (3,) from where a way out (N, 4) ends."""
        metre_cost = passable(drivable)
        labels = components(metre_cost)
        row, column = drivable.costmap.cells_at(out[-1, :2]).tolist()
        aim = goal_near(drivable, end, labels, int(labels[row, column]), self.settings)
        if isinstance(aim, PlanFailure):
            return aim
        return self._way(drivable, metre_cost, out, aim)

    def _way(self, drivable: Drivable, metre_cost: Float32Array, out: FloatArray, goal: Goal) -> Plan | PlanFailure:
        """From where a way out (N, 4) ends."""
        costmap = drivable.costmap
        goal_row, goal_column = costmap.cells_at(goal.pose[:2]).tolist()
        known = cost_to_go(metre_cost, costmap.resolution_m, (goal_row, goal_column))
        row, column = costmap.cells_at(out[-1, :2]).tolist()
        if not np.isfinite(known[row, column]):
            return PlanFailure(PlanReason.UNREACHABLE, "walls or things are between")
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
                # Both may pass, where it is tight: then the cheaper one that ends as it was asked.
                if poses is None or (end is goal and drivable.cost(searched) < drivable.cost(poses)):
                    poses, goal = searched, end
        poses = centred(shortened(poses, drivable), drivable, _ROUNDS)
        poses = np.concatenate([out[:-1], poses])
        return _plan(drivable, poses, goal, states)

    def _searched(
        self, drivable: Drivable, known: FloatArray, start: FloatArray, goal: Goal
    ) -> tuple[FloatArray, int, Goal] | PlanFailure:
        """Poses (N, 4) by the search over places and headings, how many it looked at, and the goal they lead to.

        Where none leads to it by its heading, that is the place with the nearest heading that it comes to.
        """
        most = self.settings.most_states
        slots = 1 << math.ceil(math.log2(2 * most))
        tree = Tree(
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
            last = nearest_heading(tree.pose[:count], goal.pose, drivable.rules.place_m)
            if last < 0:
                none = f"of {count} places and headings that can be reached none leads there"
                return PlanFailure(PlanReason.UNREACHABLE, f"{none}: too narrow, or no room to turn")
            goal = beside(goal.pose, tree.pose[last, :3], "no way leads to the goal as it is asked")
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
    """How wide, in metres, the widest way from one place (2,) to another is at its narrowest, and where (x, y) that is.

    Both ends count from the roomiest place near to them. None where walls are between.
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
    """Row and column near a place (2,) that are farthest from anything."""
    reach = int(near_m / costmap.resolution_m)
    row, column = np.clip(costmap.cells_at(xy), 0, np.array(costmap.state.shape) - 1).tolist()
    top, left = max(row - reach, 0), max(column - reach, 0)
    near = costmap.distance_m[top : row + reach + 1, left : column + reach + 1]
    down, right = np.unravel_index(int(np.argmax(near)), near.shape)
    return top + int(down), left + int(right)


def _are_joined(is_open: BoolArray, here: tuple[int, int], there: tuple[int, int]) -> bool:
    _, labels = cv2.connectedComponents(is_open.astype(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    return bool(labels[here] == labels[there] > 0)


def _is_inside(costmap: Costmap, pose: FloatArray) -> bool:
    cell = costmap.cells_at(pose[:2])
    return bool(((cell >= 0) & (cell < costmap.state.shape)).all())


def _plan(drivable: Drivable, poses: FloatArray, goal: Goal, states: int) -> Plan:
    way = poses[:, :3].copy()
    way[:, 2] = wrap_angle(way[:, 2])
    steps = np.diff(way[:, :2], axis=0)
    end = way[-1].copy()
    return Plan(
        poses=way,
        directions=poses[:, 3].astype(np.int64),
        length_m=float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
        least_clearance_m=drivable.clearance_m(way),
        goal=end,
        goal_change=goal.change,
        frame=drivable.costmap.frame,
        cost=drivable.cost(poses),
        states=states,
        goal_off_m=goal.off_m,
        goal_off_rad=goal.off_rad,
    )


# PathPlanner, and what it answers: Plan or PlanFailure.


# Between two poses of a plan nothing moves farther: a cell of the usual map; and a turn in place by 6°.
_STEP_M, _STEP_RAD = 0.05, 0.1
# A path that ends farther beside its goal leads elsewhere: half of what counts as an arrival.
_AT_GOAL_M, _AT_GOAL_RAD = 0.05, 0.05


class PlanReason(StrEnum):
    """Why there is no plan."""

    INVALID = "start or goal is no pose"
    START_OUTSIDE = "the robot is outside the map"
    START_OCCUPIED = "the robot stands where something is, and finds no way out"
    START_UNKNOWN = "the floor about the robot is unknown, and it finds no way out"
    GOAL_OUTSIDE = "the goal is outside the map"
    GOAL_UNKNOWN = "nobody has seen the floor at the goal"
    GOAL_OCCUPIED = "the robot does not fit at the goal, nor near to it"
    GOAL_IN_WALL = "the map has no room for the robot at the goal, nor near to it"
    STANDS = "its limits let the robot neither forward nor backward"
    UNREACHABLE = "no way leads to the goal"
    NO_WAY_IN_MAP = "no way leads to the goal by the map itself"
    NO_ROOM_IN_MAP = "the map has no place that is wide enough for the robot"
    GAVE_UP = "no way was found within the bounds of the search"
    PART = "the planner failed"

    @property
    def is_for_good(self) -> bool:
        """Whether nothing that passes by itself makes a plan possible."""
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
            PlanReason.NO_WAY_IN_MAP,
            PlanReason.GAVE_UP,
        )


@dataclass(frozen=True, slots=True)
class PlanFailure:
    """That there is no plan: the robot is to stand.

    Attributes:
        reason: why.
        detail: the same for people, with figures.
    """

    reason: PlanReason
    detail: str

    def __bool__(self) -> bool:
        """False."""
        return False


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A way that the footprint can drive, from where the robot stands.

    Attributes:
        poses: (N, 3) x, y, yaw of `base`, dense: between two of them no point of the robot moves farther than twice the
            least margin. In a turn in place x and y stay as they are.
        directions: (N,) 1 where a pose is reached forward, -1 backward; in a turn in place as before it.
        length_m: of the way of the centre of rotation.
        least_clearance_m: of the footprint, over all poses, at most 0.5 m; 0 where it had to get out.
        goal: (3,) where it ends.
        goal_change: why that is not the goal that was asked for; empty where it is.
        frame: of the poses: `map` or `odom`.
        cost: in metres of free floor.
        states: how many places and headings were searched; 0 where the way over the cells did.
        goal_off_m, goal_off_rad: how far that is beside the goal that was asked for.
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
        """A plan forward along places (N, 2) from the robot on, with a turn in place at each bend.

        Args:
            places: x, y, metres; N is 2 or more.
            yaw: heading at the end, radians; None: as the last piece leads.
            frame: of the places, as of the costmap.

        Raises:
            ArgumentError: other shapes, or numbers that are not finite.
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
    """Finds a way over a costmap; `Planner` is the built-in one, and `Navigator` takes another as `planner`.

    What it answers is driven as any plan is: the navigator looks at the way ahead and asks again where something
    stands there, and the collision monitor has the last word. A path through a wall ends before the wall.
    """

    def plan(self, costmap: Costmap, start: FloatArray, goal: FloatArray) -> Plan | PlanFailure:
        """A plan from where the robot stands to a goal, or why there is none; `Plan.along` makes one of places.

        It is called in another thread than the control of a real robot, and several times for one plan: for each
        goal on the way, and with obstacles added where no camera will have looked. An exception, another type, or
        numbers that are not finite end the task with the reason `PlanReason.PART`.

        Args:
            costmap: `state` and `is_lethal` (H, W), `distance_m` to what stands; not to be written to.
            start: (3,) x, y, yaw of `base` in the frame of the costmap.
            goal: (3,) in that frame; or (2,), where any heading will do.
        """
        ...


class OwnPlanner:
    """A `PathPlanner` whose answers are checked; a failure of the part is a `PlanFailure`."""

    def __init__(self, part: PathPlanner) -> None:
        self._part = part

    def plan(self, costmap: Costmap, start: FloatArray, goal: FloatArray) -> Plan | PlanFailure:
        """See `PathPlanner`; poses are as dense as the navigator needs, and an end beside the goal is called so."""
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
        poses, directions = _dense(poses, directions)
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


def _dense(poses: FloatArray, directions: IntArray) -> tuple[FloatArray, IntArray]:
    """Poses (N, 3) and directions (N,) with so many between that no step is long."""
    made, ways = [poses[:1]], [directions[:1]]
    for before, after, direction in zip(poses[:-1], poses[1:], directions[1:], strict=True):
        way, turn = after[:2] - before[:2], float(wrap_angle(after[2] - before[2]))
        steps = max(math.ceil(np.hypot(*way) / _STEP_M), math.ceil(abs(turn) / _STEP_RAD), 1)
        share = np.arange(1, steps + 1)[:, None] / steps
        made.append(np.column_stack([before[:2] + share * way, wrap_angle(before[2] + share[:, 0] * turn)]))
        ways.append(np.full(steps, direction))
    return np.concatenate(made), np.concatenate(ways)


# Where plans begin and end: a start that gets out of what it stands in, and a goal at which the footprint fits.


# Curvatures of ways out, 1/m, for both directions.
_BENDS = (0.0, 0.1, -0.1, 0.2, -0.2, 0.5, -0.5, 1.5, -1.5)
# Along them no margin covers what lies between two poses: metres from one to the next.
_ESCAPE_STEP_M, _BACKWARD = 0.01, 1.5
_TURN_STEPS = 3
# Of a first arc, the places at which a second one begins.
_SHARES = 3
_ANY_HEADINGS = 16


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """Where a plan is to end: pose (3,), its heading NaN where any will do; why it is not what was asked for, and by
    how much, metres and radians.
    """

    pose: FloatArray
    change: str
    off_m: float = 0.0
    off_rad: float = 0.0


def passable(drivable: Drivable) -> Float32Array:
    """(H, W) the least that a metre costs; infinite where the centre of rotation can be at no point of the cell.

    Where the inscribed circle alone is tight, whatever the heading, that is counted, too.
    """
    costmap, rules = drivable.costmap, drivable.rules
    slack_m = (0.5 - math.sqrt(0.5)) * costmap.resolution_m
    metre_cost, last = drivable.cells.metre_cost.copy(), len(drivable.margins_m) - 1
    for k, margin_m in enumerate(drivable.margins_m):
        is_nearer = costmap.distance_m < drivable.footprint.inscribed_m + margin_m + slack_m
        # The next outline may be free.
        tight = math.inf if k == last else rules.tight * ((k + 1) / last) ** 2
        metre_cost[is_nearer] = drivable.cells.metre_cost[is_nearer] + np.float32(tight)
    metre_cost[costmap.is_lethal] = np.inf
    return np.asarray(metre_cost, np.float32)


def components(metre_cost: Float32Array) -> Int32Array:
    """(H, W) from 1 on, of cells that are joined by their edges; 0 where blocked."""
    _, labels = cv2.connectedComponents(np.isfinite(metre_cost).astype(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    return labels.astype(np.int32)


def way_out(
    drivable: Drivable, outline: Outline, start: FloatArray, settings: PlannerSettings, *, is_wide: bool = False
) -> FloatArray | None:
    """(N, 4) a short way on which the robot comes free of what it stands in or too near to; None where none is found.

    One arc or turn, else two of them. Until it has come free nothing is nearer than at first by more than
    `escape_nearer_m`: as controllers, which drive it, have it. Where it stands free, the way is that pose alone.
    `is_wide`: free is where the wanted margin is.
    """
    pose, most = np.array([[*start, 1.0]]), 0.0 if is_wide else 1.0
    if drivable.tightness(pose[:, :3])[0] <= most:
        return pose
    here_m = float(_clearances(drivable, outline, pose, settings)[0])
    if here_m < -settings.escape_depth_m:
        return None
    least_m = min(settings.margin_m, here_m - settings.escape_nearer_m)
    dense = replace(drivable, rules=drivable.rules._replace(step_m=_ESCAPE_STEP_M))

    def passed(begin: FloatArray, arc: tuple[float, float]) -> FloatArray:
        """A way with as much of an arc behind it as may be, until it comes free."""
        poses = np.r_[begin, dense.arc(begin[-1], *arc)[1:]]
        is_free = drivable.tightness(poses[:, :3]) <= most
        clear_m = _clearances(drivable, outline, poses, settings)
        has_come = np.maximum.accumulate(clear_m >= settings.margin_m + settings.escape_nearer_m)
        is_nearer = clear_m < np.where(has_come, settings.margin_m, least_m)
        is_nearer[0] = False
        ends = [*(np.flatnonzero(is_free)[:1] + 1), *np.flatnonzero(is_nearer)[:1], len(poses)]
        return np.asarray(poses[: int(min(ends))])

    arcs = [arc for arc in _arcs(settings) if drivable.may(*arc)]
    first = [passed(pose, arc) for arc in arcs]
    begins = [way[: 1 + share * (len(way) - 1) // _SHARES] for way in first for share in range(1, _SHARES + 1)]
    second = (passed(begin, arc) for begin in begins if len(begin) > 1 for arc in arcs)
    free = ([way for way in ways if drivable.tightness(way[-1:, :3])[0] <= most] for ways in (first, second))
    found = next((ways for ways in free if ways), [])
    return min(found, key=lambda way: _long_m(way, drivable.rules.reach_m), default=None)


def _arcs(settings: PlannerSettings) -> list[tuple[float, float]]:
    """Ways and turns that a robot may get out by."""
    arcs = [(sense * settings.escape_m, sense * settings.escape_m * b) for sense in (1, -1) for b in _BENDS]
    return [*arcs, *((0.0, sense * math.pi) for sense in (1, -1))]


def _long_m(way: FloatArray, reach_m: float) -> float:
    """Of a way (N, 4), turns by what a corner moves; where the robot can go ahead, it does."""
    steps_m = np.hypot(*np.diff(way[:, :2], axis=0).T) + reach_m * np.abs(np.diff(way[:, 2]))
    return float((steps_m * np.where(way[1:, 3] < 0, _BACKWARD, 1.0)).sum())


def _clearances(drivable: Drivable, outline: Outline, poses: FloatArray, settings: PlannerSettings) -> FloatArray:
    """(N,) of the footprint at poses (N, 4), as controllers have it; below 0 within."""
    found = np.empty(len(poses))
    least_m = settings.margin_m + settings.escape_nearer_m
    clearances_at(drivable.costmap.field, outline, np.ascontiguousarray(poses[:, :3]), least_m, found)
    return found


def goal_near(
    drivable: Drivable, goal: FloatArray, labels: Int32Array, label: int, settings: PlannerSettings
) -> Goal | PlanFailure:
    """The goal (3,), or where the footprint does not fit there, the best pose in a component of cells where it does.

    That is the nearest one, where clearance costs something, too. Poses are tried on a grid of the costmap's cells, and
    three headings to each side; a heading's radian counts as a metre.
    """
    costmap = drivable.costmap
    row, column = costmap.cells_at(goal[:2]).tolist()
    if not (0 <= row < labels.shape[0] and 0 <= column < labels.shape[1]):
        return PlanFailure(PlanReason.GOAL_OUTSIDE, beyond(costmap, goal))
    if np.isfinite(tightness_of(drivable, goal[None])[0]):
        if labels[row, column] == label:
            return Goal(goal, "")
        where = f"({goal[0]:.2f}, {goal[1]:.2f}) m"
        return PlanFailure(PlanReason.UNREACHABLE, f"{where} is free, and walls or things are all round it")
    is_unknown = costmap.is_lethal[row, column] and costmap.state[row, column] == CellState.UNKNOWN
    poses, off = _around(goal, costmap.resolution_m, settings)
    cells = costmap.cells_at(poses[:, :2])
    inside = ((cells >= 0) & (cells < labels.shape)).all(axis=1)
    near = np.zeros(len(poses), bool)
    near[inside] = labels[cells[inside, 0], cells[inside, 1]] == label
    poses, off = poses[near], off[near]
    tight = tightness_of(drivable, poses)
    # One that keeps clear is better than one that is nearer by a little, and hard to get to.
    score = off + 2 * settings.wanted_margin_m * tight
    if len(poses) and np.isfinite(score).any():
        return beside(goal, poses[int(np.argmin(score))], "the robot does not fit at the goal")
    reason = PlanReason.GOAL_UNKNOWN if is_unknown else PlanReason.GOAL_OCCUPIED
    return PlanFailure(reason, f"nor does it fit within {settings.goal_tolerance_m:g} m that can be reached")


def beyond(costmap: Costmap, pose: FloatArray) -> str:
    """That a pose lies outside of a costmap, and where that ends."""
    low, high = costmap.middle_of([-0.5, -0.5]), costmap.middle_of(np.array(costmap.state.shape) - 0.5)
    reaches = f"which reaches from ({low[0]:.2f}, {low[1]:.2f}) to ({high[0]:.2f}, {high[1]:.2f}) m"
    return f"({pose[0]:.2f}, {pose[1]:.2f}) m is beyond the map's edge, {reaches}"


def beside(goal: FloatArray, pose: FloatArray, why: str) -> Goal:
    """Another pose (3,) in the place of a goal (3,), and by how much it is another."""
    away_m, turned = float(np.hypot(*(pose - goal)[:2])), _turn(goal[2], pose[2])
    return Goal(pose.copy(), f"{why}: {away_m:.2f} m and {math.degrees(turned):.0f}° beside it", away_m, turned)


def nearest_heading(poses: FloatArray, goal: FloatArray, reach_m: float) -> int:
    """Which of poses (N, 4) so near to a goal's place is turned least against it (3,); -1: none is near."""
    near = np.flatnonzero(np.hypot(*(poses[:, :2] - goal[:2]).T) <= reach_m)
    turned = [_turn(goal[2], yaw) for yaw in poses[near, 2]]
    return int(near[np.argmin(turned)]) if len(near) else -1


def _turn(one: float, other: float) -> float:
    return 0.0 if math.isnan(one) else abs(math.remainder(float(one - other), 2 * math.pi))


def tightness_of(drivable: Drivable, poses: FloatArray) -> FloatArray:
    """(N,) as `Drivable.tightness` at poses (N, 3); of any heading, at the best of some."""
    if not np.isnan(poses[:, 2]).any():
        return drivable.tightness(poses)
    yaws = np.arange(_ANY_HEADINGS) * 2 * np.pi / _ANY_HEADINGS
    tried = np.stack([np.c_[poses[:, :2], np.full(len(poses), yaw)] for yaw in yaws])
    return np.asarray(drivable.tightness(tried.reshape(-1, 3)).reshape(len(yaws), -1).min(axis=0))


def _around(goal: FloatArray, step_m: float, settings: PlannerSettings) -> tuple[FloatArray, FloatArray]:
    """Poses (N, 3) within tolerance of a goal, and how far off each is (N,)."""
    count = int(settings.goal_tolerance_m / step_m)
    steps = step_m * np.arange(-count, count + 1)
    shares = np.arange(-_TURN_STEPS, _TURN_STEPS + 1) / _TURN_STEPS
    turns = np.zeros(1) if math.isnan(goal[2]) else settings.goal_tolerance_rad * shares
    offsets = np.stack(np.meshgrid(steps, steps, turns, indexing="ij"), axis=-1).reshape(-1, 3)
    away_m = np.hypot(offsets[:, 0], offsets[:, 1])
    kept = away_m <= settings.goal_tolerance_m
    return goal + offsets[kept], (away_m + np.abs(offsets[:, 2]))[kept]


# Cost-to-go: what the cheapest way from each cell to a goal costs.


def cost_to_go(metre_cost: Float32Array, resolution_m: float, goal: tuple[int, int]) -> FloatArray:
    """(H, W) of the cheapest ways along 8 neighbours to a cell; infinite where none leads there.

    A step costs its length times the mean of what a metre costs in both cells; none cuts the corner of a blocked cell.

    Args:
        metre_cost: (H, W) at least 1; infinite where blocked.
        resolution_m: side of a cell.
        goal: row and column.

    Raises:
        ArgumentError: a goal outside, or costs below 1 or NaN.
    """
    if metre_cost.ndim != 2 or not all(0 <= at < size for at, size in zip(goal, metre_cost.shape, strict=True)):
        raise ArgumentError(f"cell {goal} of {metre_cost.shape}", fix="give row and column of a cell")
    # Below 1 cells would be settled too early.
    if not (metre_cost >= 1).all() or not 0 < resolution_m < np.inf:
        raise ArgumentError("a metre that costs less than 1, or nothing that is a number", fix="infinite where blocked")
    costs = np.ascontiguousarray(metre_cost, np.float32)
    return np.asarray(cost_to_go_kernel(costs, float(resolution_m), np.array([goal]), np.zeros(1)))
