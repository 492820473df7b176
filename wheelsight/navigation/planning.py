"""Planning: asks for plans by what is known now, and says when another is needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import FloatArray, se2
from wheelsight.navigation.blocked_ways import BlockedWays
from wheelsight.navigation.cautious_planner import CautiousPlanner
from wheelsight.navigation.costmap import Costmap
from wheelsight.navigation.floor_now import FloorNow
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.goals import Goals
from wheelsight.navigation.navigator_settings import NavigationSettings
from wheelsight.navigation.plan_values import PathPlanner, Plan, PlanFailure, PlanReason
from wheelsight.navigation.plan_view import PlanView
from wheelsight.navigation.route_planner import to_go_m
from wheelsight.navigation.senses import Senses
from wheelsight.navigation.workers import Worker, WorkerInStep

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
