"""A robot that drives to and fro, and comes no farther, gets itself out, and gives up in the end."""

from __future__ import annotations

import numpy as np
from narrowing import not_none
from navigation.rooms import Ride
from patched import patched

from benchmarks.plain_rooms import Walls
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.navigation import (
    BehaviourSettings,
    MonitorReason,
    MonitorResult,
    MonitorState,
    NavigationReason,
    NavigationSettings,
    NavigationState,
    NavigatorSettings,
)
from wheelsight.navigation.clearance_kernels import CostField
from wheelsight.navigation.controllers import ControlResult, DrivenPath, MotionState

constants = patched({"navigator._LOITER_S": 1.5, "navigator._PROGRESS_M": 0.25})
ROOM = Walls.of(((0.0, 0.0), (8.0, 0.0)), ((7.99, 0.0), (7.99, 6.0)), ((8.0, 5.99), (0.0, 5.99)))
SETTINGS = NavigationSettings(navigator=NavigatorSettings(tries=1), behaviours=BehaviourSettings(wait_s=0.2))
HELD = NavigatorSettings(held_s=0.4)


class ToAndFro:
    """Within 0.3 m of where it begins, as where plans that follow each other lead to two sides."""

    def __init__(self) -> None:
        self.periods, self.way_m = 0, 0.0

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        """See `Controller.command`."""
        self.periods, self.way_m = self.periods + 1, self.way_m + abs(state.forward_m_s) * 0.05
        return ControlResult(VelocityCommand(0.2 if self.periods // 25 % 2 == 0 else -0.2, 0.0))


def test_way_that_leads_nowhere_is_no_progress() -> None:
    """By way alone, its tries began again every 0.25 m, and nothing ever held it."""
    ride = Ride.of(ROOM, (3.0, 3.0, 0.0), (8.0, 6.0), settings=SETTINGS)
    controller = ride.navigator._controller = ToAndFro()  # noqa: SLF001
    ride.navigator.go_to_pose((6.0, 3.0, 0.0))
    ride.go(6.0)
    result = not_none(ride.navigator.result)
    assert result.reason is NavigationReason.BLOCKED
    assert result.detail == "it comes no farther"
    assert result.recoveries == 1
    assert controller.way_m > 0.25
    assert np.abs(ride.robot.base.pose[:2] - (3.0, 3.0)).max() < 0.25


def test_floor_that_was_never_seen_is_not_waited_for_and_named() -> None:
    """It waited for it to be seen, and said that the controller found no way on, which only did not get on."""
    ride = Ride.of(ROOM, (3.0, 3.0, 0.0), (8.0, 6.0), settings=NavigationSettings(navigator=HELD))
    held = MonitorResult(STOP, MonitorState.STOPPED, MonitorReason.NEVER_SEEN)
    ride.navigator.monitor.check = lambda *asked, **how: held  # type: ignore[method-assign]
    ride.navigator.go_to_pose((6.0, 3.0, 0.0))
    ride.go(2.0, until=lambda: ride.navigator.state is NavigationState.RECOVERING)
    assert ride.transitions[-1].why == "floor that was never seen; back up, to see where its front was"
