"""RoutePlanner: one plan through several poses, and whether what is left of it is still free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.geometry.se2 import wrap_angle
from wheelsight.navigation._drivable import Drivable
from wheelsight.navigation.costmap import Costmap
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.navigator_settings import NavigationSettings
from wheelsight.navigation.plan_values import OwnPlanner, PathPlanner, Plan, PlanFailure, PlanReason
from wheelsight.navigation.planner import Planner


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
