"""A robot among walls that a navigator drives: kinematic, a small depth camera, a stand-in for the localization."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.plain_rooms import RoomRobot, Walls
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import BoolArray, FloatArray
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.messages import Event
from wheelsight.navigation import KnownFloor, NavigationSettings, Navigator, PlanningResult, Transition, Worker


@dataclass
class StandInLocalization:
    """A localization that says where the robot truly is, or what `says` makes of that."""

    robot: RoomRobot
    says: Callable[[Estimate], Estimate] = lambda estimate: estimate
    keyframes: KeyframeStore | None = None
    recognised: int | None = None
    warnings: tuple[str, ...] = ()
    closed: list[bool] = field(default_factory=list)

    def process(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        C = 1e-6 * np.eye(6)
        return [
            (event, self.says(Estimate(event.stamp_s, Status.TRACKING, self.robot.T_map_base, C, body="base")))
            for event in events
        ]

    def close(self) -> None:
        self.closed.append(True)


@dataclass
class Ride:
    """A robot, a navigator, and what was seen of them on the way."""

    robot: RoomRobot
    localization: StandInLocalization
    navigator: Navigator
    transitions: list[Transition]
    clearance_m: float = np.inf

    @classmethod
    def of(
        cls,
        walls: Walls,
        pose: tuple[float, float, float],
        size_m: tuple[float, float],
        mapped: Walls | None = None,
        settings: NavigationSettings | None = None,
        planning: Worker[PlanningResult] | None = None,
    ) -> Ride:
        """In a room of a size, whose map has other walls where `mapped` is given."""
        robot, transitions = RoomRobot(walls, pose), list[Transition]()
        localization = StandInLocalization(robot)
        floor = KnownFloor((mapped or walls).grid(*size_m))
        chosen = settings or NavigationSettings(controller="pure_pursuit")
        how: dict[str, Any] = {"trusts_floor": True, "on_transition": transitions.append}
        navigator = Navigator(robot, localization, floor, chosen, planning=planning, **how)
        return cls(robot, localization, navigator, transitions)

    def go(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Steps, until the task is complete and the robot stands, or something else is so."""
        for _ in range(round(seconds / 0.05)):
            self.navigator.step()
            corners = self.navigator.footprint.at(self.robot.base.pose)
            self.clearance_m = min(self.clearance_m, self.robot.walls.clearance_m(corners))
            if (self.navigator.is_task_complete() and self.robot.base.stands) or until():
                return

    @property
    def states(self) -> list[str]:
        """That were entered, in order."""
        return [str(transition.after) for transition in self.transitions]


def is_near(pose: FloatArray, goal: Sequence[float], off_m: float = 0.12, off_rad: float = 0.12) -> BoolArray:
    off = pose - np.asarray(goal)
    return np.hypot(*off[:2]) < off_m and abs(np.angle(np.exp(1j * off[2]))) < off_rad
