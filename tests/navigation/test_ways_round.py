"""Before a long way round a robot waits once: somebody who stands in a door is gone sooner than that way is driven."""

from __future__ import annotations

from narrowing import not_none
from navigation.rooms import Ride, is_near

from benchmarks.plain_rooms import Walls, walls_about
from wheelsight.navigation import BehaviourSettings, NavigationSettings

SIZE_M = (8.0, 12.0)
ROOM = walls_about(*SIZE_M)
FAR_DOOR = ((4.0, 3.7), (4.0, 9.0)), ((4.0, 10.6), (4.0, 12.0))
TWO_DOORS = (*ROOM, ((4.0, 0.0), (4.0, 2.3)), *FAR_DOOR)
ONE_DOOR = (*ROOM, ((4.0, 0.0), (4.0, 3.7)), *FAR_DOOR)
BEGIN, GOAL = (1.2, 3.0, 0.0), (6.0, 3.0, 0.0)
NEAR_M, FAR_M = 5.2, 12.0


def ride_to_a_door_that_shuts(wait_s: float = 3.0) -> Ride:
    settings = NavigationSettings(controller="pure_pursuit", behaviours=BehaviourSettings(wait_s=wait_s))
    ride = Ride.of(Walls.of(*ONE_DOOR), BEGIN, SIZE_M, Walls.of(*TWO_DOORS), settings)
    ride.navigator.go_to_pose(GOAL)
    ride.go(20.0, until=lambda: waits(ride) > 0)
    return ride


def waits(ride: Ride) -> int:
    return sum(one.why.startswith("wait, rather than go") for one in ride.transitions)


def test_a_door_that_opens_again_is_driven_through() -> None:
    ride = ride_to_a_door_that_shuts()
    assert waits(ride) == 1
    begun_s = ride.robot.now_s
    ride.robot.walls = Walls.of(*TWO_DOORS)
    ride.go(2.5)
    assert ride.robot.base.stands
    ride.go(40.0)
    result = not_none(ride.navigator.result)
    assert result.has_arrived
    assert is_near(ride.robot.base.pose, GOAL)
    assert result.way_m < NEAR_M
    assert ride.robot.now_s - begun_s < 25.0


def test_a_door_that_stays_shut_is_gone_round_after_one_wait() -> None:
    ride = ride_to_a_door_that_shuts(wait_s=0.5)
    assert waits(ride) == 1
    ride.go(120.0)
    result = not_none(ride.navigator.result)
    assert result.has_arrived
    assert result.way_m > FAR_M
    assert waits(ride) == 1
    assert ride.clearance_m > 0


def test_to_another_goal_nothing_is_round() -> None:
    """From a goal near by to one far off: the second plan is longer than what is left of the first."""
    ride = Ride.of(Walls.of(*TWO_DOORS), BEGIN, SIZE_M)
    ride.navigator.go_through_poses([(2.2, 3.0, 0.0), (6.0, 9.8, 0.0)])
    ride.go(90.0)
    assert not_none(ride.navigator.result).has_arrived
    assert waits(ride) == 0
