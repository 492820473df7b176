"""Planning: asks for plans by what is known now, and says when another is needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import FloatArray, se2
from wheelsight.navigation.blocked_ways import BlockedWays
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.goals import Goals
from wheelsight.navigation.navigator_settings import NavigationSettings
from wheelsight.navigation.plan_values import Plan, PlanFailure
from wheelsight.navigation.route_planner import RoutePlanner
from wheelsight.navigation.senses import Senses
from wheelsight.navigation.workers import Worker, WorkerInStep


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """What came of a plan that was asked for.

    Attributes:
        found: a plan, or why there is none; None where no goal is left.
        T_map_odom: (3,) of when it was asked for.
        passes_hidden: whether it leads over floor beside the robot that no camera has looked at, since none leads to
            that goal past it.
    """

    found: Plan | PlanFailure | None
    T_map_odom: FloatArray
    passes_hidden: bool = False


class Planning:
    """Plans of one robot, made by a worker.

    Args:
        senses: of the robot.
        footprint, settings: of the robot.
        worker: that plans; None: in step, in the time that the settings state. Whoever made it closes it.
    """

    def __init__(
        self, senses: Senses, footprint: Footprint, settings: NavigationSettings, worker: Worker[Planned] | None
    ) -> None:
        self._senses, self._settings = senses, settings
        self._planner = RoutePlanner(footprint, settings)
        self._worker: Worker[Planned] = worker or WorkerInStep(settings.navigator.planning_s)
        self._blocked = BlockedWays(settings.blocked)

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
        pose, T_map_odom, avoids = where.state.pose, where.T_map_odom, self._senses.avoids_hidden
        blocked = self._blocked
        first, plain = (self._senses.costmap_of(avoids_hidden=is_first and avoids) for is_first in (True, False))

        def plan() -> Planned:
            costmap = blocked.on(first(), now_s)
            ahead = goals.upcoming(pose, costmap)
            if not ahead:
                return Planned(None, T_map_odom)
            found = self._planner.plan(costmap, pose, ahead)
            if avoids and (isinstance(found, PlanFailure) or found.goal_change):
                other = self._planner.plan(blocked.on(plain(), now_s), pose, ahead)
                if isinstance(other, Plan) and (isinstance(found, PlanFailure) or not other.goal_change):
                    return Planned(other, T_map_odom, passes_hidden=True)
            return Planned(found, T_map_odom)

        self._worker.ask(plan, now_s)

    def answer(self, now_s: float) -> Planned | None:
        """The newest plan, once; None while it is being made."""
        return self._worker.answer(now_s)

    def drop(self) -> None:
        """Want none any more."""
        self._worker.drop()

    def why_anew(self, plan: Plan, T_map_odom: FloatArray, now_s: float) -> str:
        """Why another plan is needed than one that was made with (3,); empty where it is not.

        Where it is blocked is remembered: the next plans lead elsewhere if they can.
        """
        where, s = self._senses.where, self._settings.navigator
        assert where.odom_pose is not None
        now, then = (se2.from_parts(*T) @ se2.from_parts(*where.odom_pose) for T in (where.T_map_odom, T_map_odom))
        x, y, turn = se2.to_parts(se2.invert(then) @ now)
        if np.hypot(x, y) > s.jump_m or abs(turn) > s.jump_rad:
            return "the map has moved below it"
        blocked = self._blocked_at(plan, s.check_m)
        if blocked is None:
            return ""
        self._blocked = self._blocked.with_place(blocked[:2], now_s)
        return "something is in the way"

    def is_free(self, plan: Plan, reach_m: float) -> bool:
        """Whether nothing that stands is in the way on so much of a plan, from where the robot is."""
        return self._blocked_at(plan, reach_m) is None

    def _blocked_at(self, plan: Plan, reach_m: float) -> FloatArray | None:
        local, state = self._senses.local(is_standing=True), self._senses.where.state
        assert local is not None
        assert state is not None
        return self._planner.blocked_at(local, plan, state.pose, reach_m)
