"""A robot that people or things are in the way of waits for them, by time, and says where; then it gives up."""

from __future__ import annotations

import re

import numpy as np
import pytest
from narrowing import not_none
from navigation.rooms import Ride, is_near
from patched import patched

from benchmarks.plain_rooms import Walls, walls_about
from wheelsight.navigation import BehaviourSettings, NavigationReason, NavigationSettings, NavigatorSettings
from wheelsight.navigation.perception import Person

constants = patched({"behaviours._LOOK": (0.2, -0.4, 0.2), "behaviours._BACK_M": 0.05})
ROOM = walls_about(8.0, 6.0)
DOOR = (*ROOM, ((4.0, 0.0), (4.0, 2.3)), ((4.0, 3.7), (4.0, 6.0)))
CROWD = (*DOOR, ((4.0, 2.3), (4.0, 3.7)))
BEGIN, GOAL = (1.5, 3.0, 0.0), (6.0, 3.0, 0.0)
WALKER = Person(np.array([4.0, 3.0]), np.array([0.0, 0.5]), np.eye(4), 0.3)
TRIES_S = 8.0  # longer than one try takes


def ride_to_a_full_door(monkeypatch: pytest.MonkeyPatch, patience_s: float, *, by_people: bool) -> Ride:
    navigator = NavigatorSettings(tries=1, held_s=0.5, patience_s=patience_s)
    behaviours = BehaviourSettings(wait_s=0.5)
    settings = NavigationSettings(controller="pure_pursuit", navigator=navigator, behaviours=behaviours)
    ride = Ride.of(Walls.of(*CROWD), BEGIN, (8.0, 6.0), Walls.of(*DOOR), settings)
    monkeypatch.setattr(ride.navigator.senses, "people", lambda now_s: (WALKER,) if by_people else ())
    ride.navigator.go_to_pose(GOAL)
    return ride


def test_people_in_the_only_door_are_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = ride_to_a_full_door(monkeypatch, 60.0, by_people=True)
    ride.go(TRIES_S)
    assert not ride.navigator.is_task_complete()
    ride.robot.walls = Walls.of(*DOOR)
    monkeypatch.setattr(ride.navigator.senses, "people", lambda now_s: ())
    ride.go(40.0)
    result = not_none(ride.navigator.result)
    assert result.has_arrived
    assert is_near(ride.robot.base.pose, GOAL)
    assert any("until people have gone" in transition.why for transition in result.transitions)


@pytest.mark.parametrize("by_people", [True, False])
def test_patience_ends_with_the_place_of_what_was_in_the_only_way(
    monkeypatch: pytest.MonkeyPatch, by_people: bool
) -> None:
    ride = ride_to_a_full_door(monkeypatch, TRIES_S, by_people=by_people)
    ride.go(30.0)
    result = not_none(ride.navigator.result)
    assert result.reason is NavigationReason.BLOCKED
    assert result.time_s > TRIES_S
    whys = "; ".join(transition.why for transition in result.transitions)
    words = re.search(r"in the only way: it waits for room at \((\d\.\d+), (\d\.\d+)\) m", whys)
    at = [float(number) for number in not_none(words).groups()]
    # Where the robot's front first meets it.
    assert 3.0 < at[0] < 4.2
    assert at[1] == pytest.approx(3.0, abs=0.7)
