"""PlannerClient: requests plans to the goals of a task, and decides when to replan.

Plans lead through several poses and prefer floor that the camera can observe (`PlanView`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import FloatArray, se2
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.core.messages import VelocityCommand
from wheelsight.core.threads import Worker, WorkerInStep
from wheelsight.navigation.costmap import CellState, Costmap, FloorNow, StaticLayer
from wheelsight.navigation.costmap_kernels import Eye, Walls, first_blind, first_over
from wheelsight.navigation.path_smoothing import Drivable
from wheelsight.navigation.planner import OwnPlanner, PathPlanner, Plan, PlanFailure, Planner, PlanReason
from wheelsight.navigation.senses import CHECK_M, HIDDEN_M, LOCAL_M, Senses
from wheelsight.navigation.settings import FIRST_PLAN_S, SILENT_S, Footprint, NavigationSettings, sides_of

# Simulated duration of a plan over 1000 × 1000 cells, as simulated time stops meanwhile (issue 32).
PLANNING_S = 0.15
# Length of the path ahead that must be free to drive on while a new plan is computed: a stop from 1 m/s, and the way
# until the plan is ready.
ONWARD_M = 1.5
# Motion of the map below the robot that requires a new plan: a margin, and a turn.
_JUMP_M, _JUMP_RAD = 0.1, 0.06
# Rounds of planning; each avoids the unseen floor that the plan before would have crossed.
_ROUNDS = 5
_IN_WALL = "a wall, an obstacle or forbidden floor"


@dataclass(frozen=True, slots=True, eq=False)
class PlanningResult:
    """Answer to a request for a plan.

    Attributes:
        found: a plan, or the failure; None if no goal is left.
        T_map_odom: (3,) x, y, yaw of `odom` in `map` at the request.
        passes_hidden: whether it crosses floor that no camera will have seen by then, as no other plan exists.
    """

    found: Plan | PlanFailure | None
    T_map_odom: FloatArray
    passes_hidden: bool = False


class PlannerClient:
    """Requests the plans of one robot from a worker, and checks whether they stay valid.

    Args:
        worker: computes the plans; None for in step, with the duration that the settings give. The caller closes it.
    """

    def __init__(
        self,
        senses: Senses,
        footprint: Footprint,
        settings: NavigationSettings,
        worker: Worker[PlanningResult] | None,
        own: PathPlanner | None = None,
    ) -> None:
        self._senses, self._settings, self._footprint = senses, settings, footprint
        self._planner = CautiousPlanner(footprint, settings, PlanView(footprint, senses.eye), own)
        self._worker: Worker[PlanningResult] = worker or WorkerInStep(PLANNING_S)
        self._asked_s, self._longest_s = 0.0, 0.0

    def is_silent(self, now_s: float) -> bool:
        """Return whether a requested plan takes longer than a robot may drive an older one.

        One that is ready ends the silence, although only the next decision takes it.
        """
        return self.is_asked and now_s - self._asked_s > SILENT_S and not self._worker.has_answer(now_s)

    def is_lost(self, now_s: float, most_s: float) -> bool:
        """Return whether a requested plan takes longer than `most_s` and twice the longest plan so far."""
        longest_s = max(most_s, 2 * self._longest_s) if self._longest_s else FIRST_PLAN_S
        return self.is_asked and now_s - self._asked_s > longest_s

    @property
    def is_asked(self) -> bool:
        """Whether a plan is requested."""
        return self._worker.is_asked

    @property
    def is_busy(self) -> bool:
        """Whether a plan is being computed, even if it was dropped. Its goals must not change until then."""
        return self._worker.is_busy

    def ask(self, goals: Goals, now_s: float) -> None:
        """Request a plan from the current pose, which must be known. It replaces an earlier request."""
        where = self._senses.where
        assert where.state is not None
        pose, floor = where.state.pose, self._senses.floor_now()
        hidden = floor.hidden if self._senses.avoids_hidden else floor.hidden[:0]

        def plan() -> PlanningResult:
            costmap = floor.costmap(hidden[:0, :2])
            ahead = goals.upcoming(pose, costmap)
            if not ahead:
                return PlanningResult(None, floor.T_map_odom)
            made, is_blind = self._planner.plan(costmap, floor.costmap, hidden, pose, ahead)
            found = self._judged(made, costmap, floor, pose, ahead[-1])
            if isinstance(found, Plan) and found.goal_change and len(ahead) == 1 and self._senses.floor.is_fixed:
                mapped = Costmap.of(floor.layer, floor.footprint, floor.settings)
                in_wall = self._planner.route.why_in_wall(mapped, ahead[0])
                found = found if in_wall is None else in_wall
            return PlanningResult(found, floor.T_map_odom, is_blind)

        self._asked_s = now_s
        self._worker.ask(plan, now_s)

    def answer(self, now_s: float) -> PlanningResult | None:
        """Return the newest plan, once; None while it is computed."""
        planned = self._worker.answer(now_s)
        if planned is not None:
            self._longest_s = max(self._longest_s, now_s - self._asked_s)
        return planned

    def drop(self) -> None:
        """Drop the request."""
        self._worker.drop()

    def look(self, plan: Plan, T_map_odom: FloatArray) -> tuple[str, bool]:
        """Check the next metres of a plan.

        Args:
            T_map_odom: (3,) x, y, yaw of `odom` in `map` at its request.

        Returns:
            Why another plan is needed, empty if none is, and whether the part that is driven until then is free.
        """
        where = self._senses.where
        assert where.odom_pose is not None
        now, then = (se2.from_parts(*T) @ se2.from_parts(*where.odom_pose) for T in (where.T_map_odom, T_map_odom))
        x, y, turn = se2.to_parts(se2.invert(then) @ now)
        if np.hypot(x, y) > _JUMP_M or abs(turn) > _JUMP_RAD:
            return "the map has moved below it", self.is_free(plan, ONWARD_M)
        blocked = self._blocked_at(plan, CHECK_M)
        if blocked is not None:
            is_free = self._is_far(plan, blocked) and self._blind_at(plan, ONWARD_M) is None
            return "something is in the way", is_free
        blind = self._blind_at(plan, CHECK_M)
        if blind is not None:
            return "its camera will not have looked at the floor there", self._is_far(plan, blind)
        return "", True

    def is_free(self, plan: Plan, reach_m: float) -> bool:
        """Return whether no standing obstacle or unseen floor lies on the next `reach_m` metres of a plan."""
        return self._blocked_at(plan, reach_m) is None and self._blind_at(plan, reach_m) is None

    def _is_far(self, plan: Plan, at: FloatArray) -> bool:
        """Return whether a pose lies beyond the part of a plan that must be free to drive on."""
        state = self._senses.where.state
        assert state is not None
        return to_go_m(plan, state.pose) - to_go_m(plan, at) > ONWARD_M

    def why_no_goal(self, goal: FloatArray) -> str:
        """Return why no plan can end at a goal (3,), by a fixed map alone; empty if one can, or if the map grows."""
        floor = self._senses.floor
        if not floor.is_fixed:
            return ""
        mapped = Costmap.of(floor.layer, self._footprint, self._settings.costmap)
        failure = self._planner.route.why_no_room_near(mapped, goal)
        return "" if failure is None else f"{failure.reason}: {failure.detail}"

    def _judged(
        self, found: Plan | PlanFailure, costmap: Costmap, floor: FloorNow, pose: FloatArray, goal: FloatArray
    ) -> Plan | PlanFailure:
        """Replace a failure by one that is final if the map alone forbids the path: then waiting does not help.

        If it has a path, people or things are in the way: the failure says where, and the robot waits for them. In a
        growing map waiting may help, too.

        Args:
            pose, goal: (3,) in the map.
        """
        if isinstance(found, Plan) or found.reason.is_for_good or not self._senses.floor.is_fixed:
            return found
        mapped, route = Costmap.of(floor.layer, floor.footprint, floor.settings), self._planner.route
        if found.reason in (PlanReason.START_OCCUPIED, PlanReason.START_UNKNOWN, PlanReason.START_OUTSIDE):
            why = route.planner.why_no_room(mapped)
            return PlanFailure(PlanReason.NO_ROOM_IN_MAP, why) if why else found
        is_of_place = found.reason in (PlanReason.GOAL_OCCUPIED, PlanReason.GOAL_UNKNOWN)
        if is_of_place and (in_wall := route.why_no_room_near(mapped, goal)) is not None:
            return in_wall
        is_as_mapped = np.array_equal(costmap.is_lethal, mapped.is_lethal)
        alone = found if is_as_mapped else route.plan(mapped, pose, [goal])
        hopeless = PlanReason.UNREACHABLE, PlanReason.GOAL_OCCUPIED, PlanReason.GOAL_UNKNOWN
        if isinstance(alone, Plan) and found.reason is PlanReason.UNREACHABLE:
            return route.in_the_way(costmap, alone, pose)
        if isinstance(alone, Plan) or alone.reason not in hopeless:
            return found
        return PlanFailure(PlanReason.NO_WAY_IN_MAP, route.planner.why_no_way(mapped, pose, goal))

    def _blocked_at(self, plan: Plan, reach_m: float) -> FloatArray | None:
        """Return the first blocked pose (3,) within `reach_m` along a plan; None without any."""
        local, pose = self._here()
        return self._planner.route.blocked_at(local, plan, pose, reach_m)

    def _blind_at(self, plan: Plan, reach_m: float) -> FloatArray | None:
        """Return the first pose (3,) within `reach_m` along a plan that crosses unseen floor; None without any."""
        if not self._senses.avoids_hidden:
            return None
        local, pose = self._here()
        return self._planner.blind_at(local, self._senses.hidden(), plan, pose, reach_m)

    def _here(self) -> tuple[Costmap, FloatArray]:
        """Return the local costmap without people, and the robot's pose (3,)."""
        local, state = self._senses.local(for_plans=True), self._senses.where.state
        assert local is not None
        assert state is not None
        return local, state.pose


class CautiousPlanner:
    """Plans paths that cross only floor that the robot's camera sees before, if there are any."""

    def __init__(
        self, footprint: Footprint, settings: NavigationSettings, view: PlanView, own: PathPlanner | None = None
    ) -> None:
        self._footprint, self._settings, self._view = footprint, settings, view
        self.route = RoutePlanner(footprint, settings, own)

    def plan(
        self,
        costmap: Costmap,
        avoiding: Callable[[FloatArray], Costmap],
        hidden: FloatArray,
        pose: FloatArray,
        goals: Sequence[FloatArray],
    ) -> tuple[Plan | PlanFailure, bool]:
        """Return a plan from a pose (3,) through goals, or the failure.

        Args:
            avoiding: returns the same costmap with more obstacles at (N, 2).
            hidden: (M, 3) unseen floor as in `FloorNow`; empty if it does not matter.

        Returns:
            It, and whether it crosses floor near the robot that no camera will have seen by then, as none avoids it.
        """
        found = plain = self.route.plan(costmap, pose, goals)
        if isinstance(plain, PlanFailure):
            return plain, False
        avoided = hidden[:0, :2]
        for _ in range(_ROUNDS):
            if isinstance(found, PlanFailure) or (found.goal_change and found is not plain):
                break
            blind = self.blind_at(costmap, hidden, found, pose, LOCAL_M / 2)
            if blind is None:
                return found, False
            reach_m = self._footprint.circumscribed_m + self._settings.follow.margin_m
            near = np.hypot(*(hidden[:, :2] - blind[:2]).T) < reach_m
            avoided = np.concatenate([avoided, hidden[near, :2]])
            found = self.route.plan(avoiding(avoided), pose, goals)
        # Unseen floor farther away becomes visible on the way.
        near_m = self._footprint.circumscribed_m + HIDDEN_M
        return plain, self.blind_at(costmap, hidden, plain, pose, near_m) is not None

    def blind_at(
        self, costmap: Costmap, hidden: FloatArray, plan: Plan, pose: FloatArray, reach_m: float
    ) -> FloatArray | None:
        """Return the first pose (3,) within `reach_m` along a plan that crosses unseen floor; None without any."""
        ahead = ahead_of(plan, pose, reach_m)
        blind = self._view.first_blind(np.concatenate([pose[None], ahead]), hidden, costmap)
        return None if blind is None else np.asarray(ahead[max(blind - 1, 0)])


class RoutePlanner:
    """Computes one plan through several poses, and checks whether the rest of it is free."""

    def __init__(self, footprint: Footprint, settings: NavigationSettings, own: PathPlanner | None = None) -> None:
        self._footprint, self._settings = footprint, settings
        self._rules = settings.drivable
        self.planner = Planner(footprint, self._rules, settings.limits)
        self._path_planner: PathPlanner = self.planner if own is None else OwnPlanner(own)

    def plan(self, costmap: Costmap, start: FloatArray, goals: Sequence[FloatArray]) -> Plan | PlanFailure:
        """Return a plan from a pose (3,) through poses (3,) in order; a yaw of NaN is any heading.

        It skips intermediate poses that cannot be reached, but not the last one.
        """
        plans: list[Plan] = []
        begin = start
        for number, goal in enumerate(goals):
            found = self._path_planner.plan(costmap, begin, goal[:2] if np.isnan(goal[2]) else goal)
            if isinstance(found, Plan):
                plans.append(found)
                begin = found.poses[-1]
            elif number == len(goals) - 1 or found.reason is PlanReason.PART:
                return found
        if len(plans) == 1:
            return plans[0]
        return replace(
            plans[-1],
            poses=np.concatenate([plan.poses for plan in plans]),
            directions=np.concatenate([plan.directions for plan in plans]),
            length_m=sum(plan.length_m for plan in plans),
            least_clearance_m=min(plan.least_clearance_m for plan in plans),
            cost=sum(plan.cost for plan in plans),
            states=sum(plan.states for plan in plans),
        )

    def why_in_wall(self, costmap: Costmap, goal: FloatArray) -> PlanFailure | None:
        """Return the failure `GOAL_IN_WALL` for a goal (2,) or (3,) in an obstacle of a map, thin or thick."""
        row, column = costmap.cells_at(goal[:2]).tolist()
        is_inside = 0 <= row < costmap.state.shape[0] and 0 <= column < costmap.state.shape[1]
        if is_inside and costmap.state[row, column] == CellState.OCCUPIED:
            return PlanFailure(PlanReason.GOAL_IN_WALL, f"{_IN_WALL} is at ({goal[0]:.2f}, {goal[1]:.2f}) m")
        return None

    def why_no_room_near(self, costmap: Costmap, goal: FloatArray) -> PlanFailure | None:
        """Return the failure `GOAL_IN_WALL` for a goal in an obstacle or on unknown floor of a map; None if one may.

        Beside a wall one may: the plan then ends as near as the robot fits.
        """
        failure = self.why_in_wall(costmap, goal)
        if failure is not None:
            return failure
        failure = self.planner.why_no_room_near(costmap, goal)
        if failure is None or failure.reason is PlanReason.GOAL_OUTSIDE:
            return failure
        is_unknown = failure.reason is PlanReason.GOAL_UNKNOWN
        what = "unknown floor" if is_unknown else _IN_WALL
        return PlanFailure(PlanReason.GOAL_IN_WALL, f"{what} is at ({goal[0]:.2f}, {goal[1]:.2f}) m")

    def in_the_way(self, costmap: Costmap, alone: Plan, pose: FloatArray) -> PlanFailure:
        """Return the failure of a robot at (3,) whose way by the map alone has something in it."""
        at = self.blocked_at(costmap, alone, pose, math.inf)
        where = "" if at is None else f" at ({at[0]:.2f}, {at[1]:.2f}) m"
        return PlanFailure(PlanReason.IN_THE_WAY, f"it waits for room{where}")

    def blocked_at(self, costmap: Costmap, plan: Plan, pose: FloatArray, reach_m: float) -> FloatArray | None:
        """Return the first pose (3,) within `reach_m` along a plan where the footprint collides; None without any."""
        drivable = Drivable.of(costmap, self._footprint, self._rules, self._settings.limits)
        ahead = ahead_of(plan, pose, reach_m)
        inside = ((costmap.cells_at(ahead[:, :2]) >= 0) & (costmap.cells_at(ahead[:, :2]) < costmap.state.shape)).all(1)
        blocked = ahead[inside][~drivable.is_free(ahead[inside])]
        return blocked[0] if len(blocked) else None


def to_go_m(plan: Plan, pose: FloatArray) -> float:
    """Return the distance along a plan from the pose nearest to (3,) to its end."""
    rest = plan.poses[_nearest(plan, pose) :, :2]
    return float(np.hypot(*np.diff(rest, axis=0).T).sum())


def ahead_of(plan: Plan, pose: FloatArray, reach_m: float) -> FloatArray:
    """Return the next poses (N, 3) of a plan, within `reach_m` along it."""
    rest = plan.poses[_nearest(plan, pose) :]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rest[:, :2], axis=0).T))])
    return np.asarray(rest[along <= reach_m])


def _nearest(plan: Plan, pose: FloatArray) -> int:
    """Return the index of the nearest pose by place and heading; of equal ones, as at a crossing, the last."""
    apart = np.hypot(*(plan.poses[:, :2] - pose[:2]).T)
    off = np.abs(wrap_angle(plan.poses[:, 2] - pose[2]))
    # Half a turn counts as much as a metre.
    score = apart + off / np.pi
    return int(len(score) - 1 - score[::-1].argmin())


# Poses of a plan between a frame and its use, about 0.1 m.
_LAG = 2


class PlanView:
    """Tests whether the camera sees the floor along a plan before the robot drives over it.

    Unseen floor beside a robot blocks a turn into it, but not a path that comes round and faces it.
    """

    def __init__(self, footprint: Footprint, eye: Eye) -> None:
        self._sides, self._eye = sides_of(footprint), eye

    def first_blind(self, poses: FloatArray, hidden: FloatArray, costmap: Costmap) -> int | None:
        """Return the index of the first pose over hidden floor that no earlier pose observes; None without any.

        Args:
            poses: (N, 3) x, y, yaw of `base`, dense, in the frame of the costmap; the robot is at the first.
            hidden: (M, 3) x and y of unseen floor, and how near the camera must look to observe it, metres.
            costmap: its obstacles hide what is behind them.
        """
        points, slack_m = np.ascontiguousarray(hidden[:, :2]), np.ascontiguousarray(hidden[:, 2])
        ways, over = np.ascontiguousarray(poses, float), np.empty(len(points), np.int64)
        first_over(ways, points, self._sides, over)
        is_met = over < len(ways)
        is_there = np.ascontiguousarray(costmap.state == CellState.OCCUPIED)
        walls = Walls(is_there, costmap.resolution_m, costmap.origin)
        found = int(first_blind(ways, points[is_met], slack_m[is_met], over[is_met], self._eye, walls, _LAG))
        return found if found < len(ways) else None


# Distance between the poses of a recorded path that are kept, and at which one counts as passed.
_THROUGH_M, _PASSED_M = 1.5, 0.7


class Goals(Protocol):
    """Destinations of one task."""

    @property
    def name(self) -> str:
        """Name in words."""

    @property
    def left(self) -> int:
        """Number of goals left, as far as is known."""

    @property
    def is_asked_for(self) -> bool:
        """Whether the user requested these places, so that stopping beside them is not an arrival."""

    def upcoming(self, pose: FloatArray, costmap: Costmap) -> tuple[FloatArray, ...]:
        """Return the poses (3,) of the next plan, with a stop at the last one only; empty if the task is complete.

        The call comes for each plan, even to the same goal, and maybe from another thread. No other method is called
        until it returns. A yaw of NaN is any heading.
        """

    def is_met(self, pose: FloatArray, layer: StaticLayer) -> bool:
        """Return whether the next goal is complete, wherever the robot is now."""

    def taken(self) -> None:
        """Record that the robot uses the answer for these goals: a plan, or a failure."""

    def reached(self) -> None:
        """Record that the last of the used goals is reached."""

    def missed(self) -> bool:
        """Record that no path leads there; return whether the task continues without it."""


@dataclass(frozen=True, slots=True, eq=False)
class ByHand:
    """No destinations: velocity commands from outside, such as of a joystick, in place of plans.

    Attributes:
        commands: returns the present command, each period; None once no more come.
        is_stick: whether they are shares of a stick's way, from -1 to 1, and help may change them (`SharedControl`).
    """

    commands: Callable[[], VelocityCommand | None]
    is_stick: bool = False
    name: str = "by hand"
    left: int = 0
    is_asked_for: bool = False

    def upcoming(self, pose: FloatArray, costmap: Costmap) -> tuple[FloatArray, ...]:
        """See `Goals`."""
        return ()

    def is_met(self, pose: FloatArray, layer: StaticLayer) -> bool:
        """See `Goals`."""
        return False

    def taken(self) -> None:
        """See `Goals`."""

    def reached(self) -> None:
        """See `Goals`."""

    def missed(self) -> bool:
        """See `Goals`."""
        return False


class PoseGoals:
    """Poses one after another, with a stop at each.

    Args:
        goals: each (3,) x, y, yaw in the map, or (2,) for any heading.

    Raises ArgumentError if there is no goal, or one is not finite.
    """

    is_asked_for = True

    def __init__(self, goals: Sequence[ArrayLike], name: str = "") -> None:
        self._left = [checked_goal(goal) for goal in goals]
        if not self._left:
            raise ArgumentError("no goal", fix="give one pose at least")
        self.name = name or (words_of(self._left[0]) if len(self._left) == 1 else f"{len(self._left)} goals")

    @property
    def left(self) -> int:
        """See `Goals`."""
        return len(self._left)

    def upcoming(self, pose: FloatArray, costmap: Costmap) -> tuple[FloatArray, ...]:
        """See `Goals`."""
        return tuple(self._left[:1])

    def is_met(self, pose: FloatArray, layer: StaticLayer) -> bool:
        """Return False: the robot must drive to each pose."""
        return False

    def taken(self) -> None:
        """Do nothing: the goals are the same for each plan."""

    def reached(self) -> None:
        """See `Goals`."""
        self._left.pop(0)

    def missed(self) -> bool:
        """Return False: all poses are required."""
        return False


class RecordedPath(PoseGoals):
    """A path that was driven before, without a stop but at its end.

    Args:
        way: (N, 3) x, y, yaw in the map.

    Raises ArgumentError if there are no poses, or one is not finite.
    """

    def __init__(self, way: ArrayLike, name: str = "a recorded way") -> None:
        poses = np.asarray(way, float)
        if poses.ndim != 2 or poses.shape[1] != 3 or not len(poses) or not np.isfinite(poses).all():
            raise ArgumentError(f"a way of shape {poses.shape}", fix="give (N, 3) of x, y, yaw, finite")
        self._left = [poses[0]]
        for pose in poses[1:-1]:
            if np.hypot(*(pose[:2] - self._left[-1][:2])) >= _THROUGH_M:
                self._left.append(pose)
        if len(poses) > 1:
            self._left.append(poses[-1])
        self.name = name

    def upcoming(self, pose: FloatArray, costmap: Costmap) -> tuple[FloatArray, ...]:
        """Return all poses that are not passed yet; see `Goals`."""
        self._pass(pose)
        return tuple(self._left)

    def is_met(self, pose: FloatArray, layer: StaticLayer) -> bool:
        """Drop passed poses, and return False: the robot must drive to the end. Later plans do not return to them."""
        self._pass(pose)
        return False

    def _pass(self, pose: FloatArray) -> None:
        """Drop passed poses in order, so that a later pose at a crossing stays."""
        # One assignment at the end, as another thread may plan.
        left = self._left
        while len(left) > 1 and np.hypot(*(left[0][:2] - pose[:2])) < _PASSED_M:
            left = left[1:]
        self._left = left

    def reached(self) -> None:
        """See `Goals`."""
        self._left.clear()

    def missed(self) -> bool:
        """Skip a pose that is blocked, but not the end; see `Goals`."""
        if len(self._left) > 1:
            self._left.pop(0)
            return True
        return False


def words_of(pose: FloatArray) -> str:
    """Return a pose in words."""
    yaw = "" if np.isnan(pose[2]) else f", {np.degrees(pose[2]):.0f}°"
    return f"({pose[0]:.2f}, {pose[1]:.2f}) m{yaw}"


def checked_goal(goal: ArrayLike) -> FloatArray:
    """Return (3,) of a pose (3,) or place (2,), with a yaw of NaN. Raises ArgumentError if it is neither."""
    pose = np.array(goal, float).ravel()
    if len(pose) not in (2, 3) or not np.isfinite(pose).all():
        raise ArgumentError(f"a goal of {pose}", fix="give x, y and yaw in the map, metres and radians, or x and y")
    return np.array([*pose, np.nan][:3])
