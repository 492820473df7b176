"""CautiousPlanner: plans that lead over no floor before the robot's camera has looked there, if there are any."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.navigation.costmap import Costmap
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.navigator_settings import NavigationSettings
from wheelsight.navigation.plan_values import PathPlanner, Plan, PlanFailure
from wheelsight.navigation.plan_view import PlanView
from wheelsight.navigation.route_planner import RoutePlanner, ahead_of

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
