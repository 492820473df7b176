"""A robot that does not know its place in the map looks for it slowly, and never into a thing: docs/safety.md."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none
from navigation.rooms import Ride

from benchmarks.plain_rooms import Walls, walls_about
from wheelsight.core.estimates import Status
from wheelsight.navigation import (
    BehaviourSettings,
    MonitorState,
    NavigationReason,
    NavigationSettings,
    NavigatorSettings,
)

SIZE_M, BEGIN = (8.0, 6.0), (1.5, 3.0, 0.0)
ROOM = walls_about(*SIZE_M)
# Where most room is, seen from the begin, and not in the map.
ACROSS = ((3.4, 1.0), (3.4, 5.0))
# A whole turn at 0.4 rad/s, 1.5 m at 0.2 m/s after a turn to there, and some of the next whole turn.
UNTIL_THE_SECOND_TURN_S = 34.0
SLOW = NavigatorSettings(lost_s=60.0)


def ride_of_one_that_begins(walls: tuple, behaviours: BehaviourSettings | None = None) -> Ride:
    settings = NavigationSettings(navigator=SLOW, behaviours=behaviours or BehaviourSettings())
    ride = Ride.of(Walls.of(*walls), BEGIN, SIZE_M, Walls.of(*ROOM), settings)
    ride.localization.says = lambda estimate: replace(estimate, status=Status.INITIALIZING)
    ride.navigator.go_to_pose((6.0, 3.0, 0.0))
    return ride


@pytest.mark.parametrize("walls", [ROOM, (*ROOM, ACROSS)], ids=["an empty room", "a wall across"])
def test_it_drives_no_farther_and_no_faster_than_the_page_says(walls: tuple) -> None:
    behaviours = BehaviourSettings()
    ride = ride_of_one_that_begins(walls)
    fastest_m_s, off_m = 0.0, 0.0
    for _ in range(round(UNTIL_THE_SECOND_TURN_S / 0.05)):
        ride.go(0.05)
        fastest_m_s = max(fastest_m_s, abs(ride.robot.base.forward_m_s))
        off_m = max(off_m, float(np.hypot(*(ride.robot.base.pose[:2] - BEGIN[:2]))))
    assert 0.3 < off_m < behaviours.search_m + 0.1
    assert fastest_m_s < 0.2 + 0.02
    assert ride.clearance_m > 0.04


def test_with_no_way_to_search_it_only_turns() -> None:
    ride = ride_of_one_that_begins(ROOM, BehaviourSettings(search_m=0.0))
    ride.go(40.0)
    assert np.hypot(*(ride.robot.base.pose[:2] - BEGIN[:2])) < 0.05
    assert any("look for a known place" in one.why for one in ride.transitions)


def test_before_wheels_were_heard_it_stands_and_says_so_in_the_end() -> None:
    ride = ride_of_one_that_begins(ROOM)
    ride.localization.says = lambda estimate: replace(
        estimate, status=Status.INITIALIZING, T_odom_body=None, covariance=None
    )
    ride.go(2.0)
    assert not_none(ride.navigator.feedback.monitor).state is MonitorState.STOPPED
    ride.go(70.0)
    assert ride.robot.base.pose == pytest.approx(np.array(BEGIN), abs=1e-6)
    result = ride.navigator.result
    assert result is not None
    assert result.reason is NavigationReason.LOST
