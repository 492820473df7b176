"""What the live layer keeps of somebody who has left where no camera looks: a behaviour's clearing forgets it."""

from __future__ import annotations

import pytest
from narrowing import not_none
from navigation.rooms import Ride, Walls, is_near, walls_about

from wheelsight.navigation import NavigationReason, NavigationSettings, NavigatorSettings
from wheelsight.navigation.costmap_settings import LiveLayerSettings
from wheelsight.navigation.senses import Senses

SIZE_M = (8.0, 6.0)
OPEN = (*walls_about(*SIZE_M), ((4.0, 0.0), (4.0, 2.3)), ((4.0, 3.7), (4.0, 6.0)))
IN_THE_DOOR = ((4.0, 2.3), (4.0, 3.7))
BEGIN, AWAY, BEYOND = (1.5, 3.0, 0.0), (1.5, 3.0, 3.1), (6.0, 3.0, 0.0)
# Longer than somebody who walks by, shorter than what settles.
STOOD_S = 4.0


def ride_past_a_ghost() -> Ride:
    """Somebody stood in the only door, and left it when the robot had turned its camera away; then it is to go there.

    By itself the layer would keep that for an hour.
    """
    settings = NavigationSettings(
        controller="pure_pursuit", live=LiveLayerSettings(stays=1000.0), navigator=NavigatorSettings(tries=3)
    )
    ride = Ride.of(Walls.of(*OPEN, IN_THE_DOOR), BEGIN, SIZE_M, Walls.of(*OPEN), settings)
    ride.go(STOOD_S)
    ride.navigator.go_to_pose(AWAY)
    ride.go(20.0)
    assert not_none(ride.navigator.result).has_arrived
    ride.robot.walls = Walls.of(*OPEN)
    ride.transitions.clear()
    ride.navigator.go_to_pose(BEYOND)
    ride.go(60.0)
    return ride


def test_a_ghost_in_the_only_door_is_forgotten_after_a_behaviour() -> None:
    ride = ride_past_a_ghost()
    result = not_none(ride.navigator.result)
    assert result.has_arrived
    assert is_near(ride.robot.base.pose, BEYOND)
    assert result.recoveries == 1
    assert ride.states[:3] == ["planning", "recovering", "planning"]
    assert ride.clearance_m > 0


def test_without_that_it_bars_the_door(monkeypatch: pytest.MonkeyPatch) -> None:
    """So the test above is about the clearing, and nothing else."""
    monkeypatch.setattr(Senses, "clear", lambda self, *, only_ahead=False: None)
    ride = ride_past_a_ghost()
    result = not_none(ride.navigator.result)
    assert (result.has_arrived, result.reason) == (False, NavigationReason.NO_PLAN)
    assert result.recoveries == 3
    assert ride.robot.base.pose[0] < 2.0
