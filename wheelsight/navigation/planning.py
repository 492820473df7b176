"""Planning: requests plans and decides when to replan. It plans through several poses, prefers observed floor, and
avoids ways that were blocked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.core.geometry import FloatArray, se2
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.navigation.costmap import Costmap, FloorNow
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.goals import Goals
from wheelsight.navigation.path_smoothing import Drivable
from wheelsight.navigation.planner import OwnPlanner, PathPlanner, Plan, PlanFailure, Planner, PlanReason
from wheelsight.navigation.senses import Senses
from wheelsight.navigation.settings import BlockedSettings, NavigationSettings
from wheelsight.navigation.surroundings import PlanView
from wheelsight.navigation.workers import Worker, WorkerInStep

# Planning: asks for plans by what is known now, and says when another is needed.


# A robot that drives by an older plan stops when the new one takes longer than this, and goes on when it comes. In a
# flat a plan takes 0.1 to 0.25 s, over 1000 × 1000 cells 0.8 s. A limit by the longest plan before let the motors turn
# for 0.67 s on a busy computer; 0.6 s is the most.
_SILENT_S = 0.4
# The first plan of a map has none before it to compare with; the largest map takes a small computer 4 s.
_FIRST_S = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """What came of a plan that was asked for.

    Attributes:
        found: a plan, or why there is none; None where no goal is left.
        T_map_odom: (3,) of when it was asked for.
        passes_hidden: whether it leads over floor that no camera will have looked at by then, since none leads to that
            goal past it.
    """

    found: Plan | PlanFailure | None
    T_map_odom: FloatArray
    passes_hidden: bool = False


@dataclass(frozen=True, slots=True)
class Look:
    """What a look at a plan that is driven shows.

    Attributes:
        why: another is needed; empty where none is.
        is_free: whether it is free as far as it is driven until another is there.
    """

    why: str
    is_free: bool


class Planning:
    """Plans of one robot, made by a worker.

    Args:
        senses: of the robot.
        footprint, settings: of the robot.
        worker: that plans; None: in step, in the time that the settings state. Whoever made it closes it.
        own: see `RoutePlanner`.
    """

    def __init__(
        self,
        senses: Senses,
        footprint: Footprint,
        settings: NavigationSettings,
        worker: Worker[Planned] | None,
        own: PathPlanner | None = None,
    ) -> None:
        self._senses, self._settings, self._footprint = senses, settings, footprint
        self._planner = CautiousPlanner(footprint, settings, PlanView(footprint, senses.eye), own)
        self._worker: Worker[Planned] = worker or WorkerInStep(settings.navigator.planning_s)
        self._blocked = BlockedWays(settings.blocked, free_visits=int(senses.floor.is_fixed))
        self._asked_s, self._longest_s = 0.0, 0.0

    def is_silent(self, now_s: float) -> bool:
        """Whether a plan was asked for and takes longer than a robot may drive by an older one."""
        return self.is_asked and now_s - self._asked_s > _SILENT_S

    def is_lost(self, now_s: float, most_s: float) -> bool:
        """Whether a robot that stands for a plan waits for it in vain: longer than `most_s` and than plans take."""
        longest_s = max(most_s, 2 * self._longest_s) if self._longest_s else _FIRST_S
        return self.is_asked and now_s - self._asked_s > longest_s

    @property
    def is_asked(self) -> bool:
        """Whether a plan is to come."""
        return self._worker.is_asked

    @property
    def is_busy(self) -> bool:
        """Whether one is being made, be it wanted still or not: goals stay as they are until then."""
        return self._worker.is_busy

    def ask(self, goals: Goals, now_s: float) -> None:
        """For a plan from where the robot is now, which is known; one that was asked for before is wanted no more."""
        where = self._senses.where
        assert where.state is not None
        pose, blocked, floor = where.state.pose, self._blocked, self._senses.floor_now()
        hidden = floor.hidden if self._senses.avoids_hidden else floor.hidden[:0]

        def avoiding(avoided: FloatArray) -> Costmap:
            return blocked.on(floor.costmap(avoided), now_s)

        def plan() -> Planned:
            costmap = avoiding(hidden[:0, :2])
            ahead = goals.upcoming(pose, costmap)
            if not ahead:
                return Planned(None, floor.T_map_odom)
            made = self._planner.plan(costmap, avoiding, hidden, pose, ahead)
            found = self._judged(made.found, costmap, floor, pose, ahead[-1])
            return Planned(found, floor.T_map_odom, made.is_blind)

        self._asked_s = now_s
        self._worker.ask(plan, now_s)

    def answer(self, now_s: float) -> Planned | None:
        """The newest plan, once; None while it is being made."""
        planned = self._worker.answer(now_s)
        if planned is not None:
            self._longest_s = max(self._longest_s, now_s - self._asked_s)
        return planned

    def drop(self) -> None:
        """Want none any more."""
        self._worker.drop()

    def look(self, plan: Plan, T_map_odom: FloatArray, now_s: float) -> Look:
        """At the next metres of a plan that was made with (3,).

        Where it is blocked is remembered: the next plans lead elsewhere if they can.
        """
        where, s = self._senses.where, self._settings.navigator
        assert where.odom_pose is not None
        now, then = (se2.from_parts(*T) @ se2.from_parts(*where.odom_pose) for T in (where.T_map_odom, T_map_odom))
        x, y, turn = se2.to_parts(se2.invert(then) @ now)
        if np.hypot(x, y) > s.jump_m or abs(turn) > s.jump_rad:
            return Look("the map has moved below it", self.is_free(plan, s.onward_m))
        blocked = self._blocked_at(plan, s.check_m)
        if blocked is not None:
            self._blocked = self._blocked.with_place(blocked[:2], now_s)
            is_free = self._is_far(plan, blocked) and self._blind_at(plan, s.onward_m) is None
            return Look("something is in the way", is_free)
        blind = self._blind_at(plan, s.check_m)
        if blind is not None:
            return Look("its camera will not have looked at the floor there", self._is_far(plan, blind))
        return Look("", is_free=True)

    def is_free(self, plan: Plan, reach_m: float) -> bool:
        """Whether nothing that stands is in the way on so much of a plan, from where the robot is."""
        return self._blocked_at(plan, reach_m) is None and self._blind_at(plan, reach_m) is None

    def _is_far(self, plan: Plan, at: FloatArray) -> bool:
        """Whether a pose of a plan comes later than what must be free to drive on."""
        state = self._senses.where.state
        assert state is not None
        return to_go_m(plan, state.pose) - to_go_m(plan, at) > self._settings.navigator.onward_m

    def why_no_goal(self, goal: FloatArray) -> str:
        """Why no plan can end at a goal (3,), by a map of before alone; empty where one may, or where the map grows."""
        floor = self._senses.floor
        if not floor.is_fixed:
            return ""
        mapped = Costmap.of(floor.layer, self._footprint, self._settings.costmap)
        failure = self._planner.route.why_no_room_near(mapped, goal)
        return "" if failure is None else f"{failure.reason}: {failure.detail}"

    def _judged(
        self, found: Plan | PlanFailure, costmap: Costmap, floor: FloorNow, pose: FloatArray, goal: FloatArray
    ) -> Plan | PlanFailure:
        """What was found in a costmap from a pose (3,) to a goal (3,); where the map alone forbids it, that is said.

        Then no waiting helps. In a map that grows it may, and what the camera met besides the map may go.
        """
        if isinstance(found, Plan) or found.reason.is_for_good or not self._senses.floor.is_fixed:
            return found
        mapped, route = Costmap.of(floor.layer, floor.footprint, floor.settings), self._planner.route
        if found.reason in (PlanReason.START_OCCUPIED, PlanReason.START_UNKNOWN, PlanReason.START_OUTSIDE):
            why = route.why_no_room(mapped)
            return PlanFailure(PlanReason.NO_ROOM_IN_MAP, why) if why else found
        is_of_place = found.reason in (PlanReason.GOAL_OCCUPIED, PlanReason.GOAL_UNKNOWN)
        if is_of_place and (in_wall := route.why_no_room_near(mapped, goal)) is not None:
            return in_wall
        is_as_mapped = np.array_equal(costmap.is_lethal, mapped.is_lethal)
        alone = found if is_as_mapped else route.plan(mapped, pose, [goal])
        hopeless = PlanReason.UNREACHABLE, PlanReason.GOAL_OCCUPIED, PlanReason.GOAL_UNKNOWN
        if isinstance(alone, Plan) or alone.reason not in hopeless:
            return found
        return PlanFailure(PlanReason.NO_WAY_IN_MAP, route.why_no_way(mapped, pose, goal))

    def _blocked_at(self, plan: Plan, reach_m: float) -> FloatArray | None:
        local, pose = self._here()
        return self._planner.route.blocked_at(local, plan, pose, reach_m)

    def _blind_at(self, plan: Plan, reach_m: float) -> FloatArray | None:
        if not self._senses.avoids_hidden:
            return None
        local, pose = self._here()
        return self._planner.blind_at(local, self._senses.hidden(), plan, pose, reach_m)

    def _here(self) -> tuple[Costmap, FloatArray]:
        """What stands about the robot, and where that is (3,)."""
        local, state = self._senses.local(for_plans=True), self._senses.where.state
        assert local is not None
        assert state is not None
        return local, state.pose


# RoutePlanner: one plan through several poses, and whether what is left of it is still free.


class RoutePlanner:
    """Plans for one robot.

    Args:
        footprint, settings: of the robot.
        own: a user's planner, in place of the built-in one.
    """

    def __init__(self, footprint: Footprint, settings: NavigationSettings, own: PathPlanner | None = None) -> None:
        self._footprint, self._settings = footprint, settings
        self._rules = settings.drivable
        self._planner = Planner(footprint, self._rules, settings.limits)
        self._path_planner: PathPlanner = self._planner if own is None else OwnPlanner(own)

    def plan(self, costmap: Costmap, start: FloatArray, goals: Sequence[FloatArray]) -> Plan | PlanFailure:
        """A plan from a pose (3,) through poses (3,) in their order; a yaw of NaN is any heading.

        Poses on the way that cannot be reached are left out; the last one cannot.
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
        return plans[0] if len(plans) == 1 else _joined(plans)

    def why_no_room_near(self, costmap: Costmap, goal: FloatArray) -> PlanFailure | None:
        """See `Planner.why_no_room_near`; of a goal in what stands in the costmap or is unknown, as of a map's wall."""
        failure = self._planner.why_no_room_near(costmap, goal)
        if failure is None or failure.reason is PlanReason.GOAL_OUTSIDE:
            return failure
        is_unknown = failure.reason is PlanReason.GOAL_UNKNOWN
        what = "unknown floor" if is_unknown else "a wall, a thing or forbidden floor"
        return PlanFailure(PlanReason.GOAL_IN_WALL, f"{what} is at ({goal[0]:.2f}, {goal[1]:.2f}) m")

    def why_no_way(self, costmap: Costmap, start: FloatArray, goal: FloatArray) -> str:
        """See `Planner.why_no_way`."""
        return self._planner.why_no_way(costmap, start, goal)

    def why_no_room(self, costmap: Costmap) -> str:
        """See `Planner.why_no_room`."""
        return self._planner.why_no_room(costmap)

    def blocked_at(self, costmap: Costmap, plan: Plan, pose: FloatArray, reach_m: float) -> FloatArray | None:
        """The first pose (3,) of so much of a plan, from a pose (3,) on, where the footprint does not pass; or None."""
        drivable = Drivable.of(costmap, self._footprint, self._rules, self._settings.limits)
        ahead = ahead_of(plan, pose, reach_m)
        inside = ((costmap.cells_at(ahead[:, :2]) >= 0) & (costmap.cells_at(ahead[:, :2]) < costmap.state.shape)).all(1)
        blocked = ahead[inside][~drivable.is_free(ahead[inside])]
        return blocked[0] if len(blocked) else None


def to_go_m(plan: Plan, pose: FloatArray) -> float:
    """Along a plan from the place next to (3,) to its end."""
    rest = plan.poses[_nearest(plan, pose) :, :2]
    return float(np.hypot(*np.diff(rest, axis=0).T).sum())


def ahead_of(plan: Plan, pose: FloatArray, reach_m: float) -> FloatArray:
    """(N, 3) poses of a plan that come next, as far as so many metres along it."""
    rest = plan.poses[_nearest(plan, pose) :]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rest[:, :2], axis=0).T))])
    return np.asarray(rest[along <= reach_m])


def _nearest(plan: Plan, pose: FloatArray) -> int:
    """Of places alike, as where a way crosses itself, the one whose heading is nearer, and then the later one."""
    apart = np.hypot(*(plan.poses[:, :2] - pose[:2]).T)
    off = np.abs(wrap_angle(plan.poses[:, 2] - pose[2]))
    # A half turn counts as much as a metre.
    score = apart + off / np.pi
    return int(len(score) - 1 - score[::-1].argmin())


def _joined(plans: Sequence[Plan]) -> Plan:
    last = plans[-1]
    return replace(
        last,
        poses=np.concatenate([plan.poses for plan in plans]),
        directions=np.concatenate([plan.directions for plan in plans]),
        length_m=sum(plan.length_m for plan in plans),
        least_clearance_m=min(plan.least_clearance_m for plan in plans),
        cost=sum(plan.cost for plan in plans),
        states=sum(plan.states for plan in plans),
    )


# CautiousPlanner: plans that lead over no floor before the robot's camera has looked there, if there are any.


# Each keeps away from where the one before would have gone blindly.
_ROUNDS = 5


@dataclass(frozen=True, slots=True, eq=False)
class CautiousPlan:
    """What was found.

    Attributes:
        found: a plan, or why there is none.
        is_blind: whether it leads over floor beside the robot that no camera will have looked at by then, since none
            leads past it.
    """

    found: Plan | PlanFailure
    is_blind: bool = False


class CautiousPlanner:
    """Of one robot.

    Args:
        footprint, settings: of the robot.
        view: what its camera looks at on the way.
        own: see `RoutePlanner`.
    """

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
    ) -> CautiousPlan:
        """From a pose (3,) through goals.

        Args:
            costmap: of what stands.
            avoiding: makes the same with obstacles at (N, 2) besides.
            hidden: (M, 3) as `FloorNow`; empty where it does not matter.
            pose, goals: as `RoutePlanner.plan`.
        """
        found = plain = self.route.plan(costmap, pose, goals)
        if isinstance(plain, PlanFailure):
            return CautiousPlan(plain)
        avoided = hidden[:0, :2]
        for _ in range(_ROUNDS):
            if isinstance(found, PlanFailure) or (found.goal_change and found is not plain):
                break
            blind = self.blind_at(costmap, hidden, found, pose, self._settings.navigator.local_m / 2)
            if blind is None:
                return CautiousPlan(found)
            reach_m = self._footprint.circumscribed_m + self._settings.follow.margin_m
            near = np.hypot(*(hidden[:, :2] - blind[:2]).T) < reach_m
            avoided = np.concatenate([avoided, hidden[near, :2]])
            found = self.route.plan(avoiding(avoided), pose, goals)
        # What is farther off is seen from nearer by.
        near_m = self._footprint.circumscribed_m + self._settings.navigator.hidden_m
        return CautiousPlan(plain, self.blind_at(costmap, hidden, plain, pose, near_m) is not None)

    def blind_at(
        self, costmap: Costmap, hidden: FloatArray, plan: Plan, pose: FloatArray, reach_m: float
    ) -> FloatArray | None:
        """The first pose (3,) of so much of a plan, from a pose (3,) on, that goes over what was not looked at."""
        ahead = ahead_of(plan, pose, reach_m)
        blind = self._view.first_blind(np.concatenate([pose[None], ahead]), hidden, costmap)
        return None if blind is None else np.asarray(ahead[max(blind - 1, 0)])


# BlockedWays: where plans turned out to be blocked a while ago, so that the next ones lead elsewhere where they can.
#
# What blocks a way is seen from close by alone: things behind others, floor that no camera has looked at, a gap that
# is too narrow by a cell. From farther off it looks free again, and the shortest way leads back.


# So many times at one place count, not more: it may be the only way.
_MOST = 3


@dataclass(frozen=True, slots=True)
class BlockedWays:
    """Places, and when each was found.

    Attributes:
        settings: how dear ways are there, and for how long.
        free_visits: so many count for nothing: in a map of before it may have been somebody who stood there.
        found: (x, y, stamp) in the map, one for each visit, at its end.
    """

    settings: BlockedSettings
    free_visits: int = 0
    found: tuple[tuple[float, float, float], ...] = ()

    def with_place(self, xy: FloatArray, now_s: float) -> BlockedWays:
        """And a way was found to be blocked with the axle at (2,)."""
        kept = tuple(one for one in self.found if self._is_another_visit(one, xy, now_s))
        return replace(self, found=(*kept, (float(xy[0]), float(xy[1]), now_s)))

    def on(self, costmap: Costmap, now_s: float) -> Costmap:
        """The same costmap, on which ways cost more there."""
        times = np.zeros(costmap.state.shape, np.float32)
        reach = int(np.ceil(self.settings.radius_m / costmap.resolution_m))
        for x, y, stamp_s in self.found:
            if now_s - stamp_s >= self.settings.seconds:
                continue
            row, column = costmap.cells_at((x, y)).tolist()
            low = np.clip([row - reach, column - reach], 0, times.shape)
            high = np.clip([row + reach + 1, column + reach + 1], 0, times.shape)
            rows, columns = (np.arange(a, b) for a, b in zip(low.tolist(), high.tolist(), strict=True))
            is_near = np.hypot(*np.meshgrid(rows - row, columns - column, indexing="ij")) <= reach
            times[low[0] : high[0], low[1] : high[1]] += is_near
        if times.max(initial=0) <= self.free_visits:
            return costmap
        return replace(
            costmap, dearness=1 + np.float32(self.settings.cost) * np.clip(times - self.free_visits, 0, _MOST)
        )

    def _is_another_visit(self, one: tuple[float, float, float], xy: FloatArray, now_s: float) -> bool:
        x, y, stamp_s = one
        age_s = now_s - stamp_s
        is_here = np.hypot(x - xy[0], y - xy[1]) <= self.settings.radius_m
        return age_s < self.settings.seconds and not (is_here and age_s < self.settings.visit_s)
