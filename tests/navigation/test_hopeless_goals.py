"""What no waiting helps: a goal in a wall or outside, a shut door, limits of zero; it stands, and says why, at once."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import grids
import numpy as np
import pytest
from narrowing import not_none
from navigation.rooms import Ride
from patched import patched

from benchmarks.plain_rooms import CELL_M, Walls, walls_about
from wheelsight.core.errors import ArgumentError
from wheelsight.core.estimates import Status
from wheelsight.core.robots import RobotLimits
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import (
    BehaviourSettings,
    FootprintSettings,
    KnownFloor,
    NavigationReason,
    NavigationResult,
    NavigationSettings,
    Navigator,
    NavigatorSettings,
    PlanFailure,
    PlanningResult,
    PlanReason,
    WorkerInStep,
)
from wheelsight.navigation.planning import Goals, PoseGoals

SIZE_M, BEGIN, GOAL, NEAR = (8.0, 6.0), (1.5, 3.0, 0.0), (6.0, 3.0, 0.0), (2.5, 3.0, 0.0)
ROOM = walls_about(*SIZE_M)
SHUT = (*ROOM, ((4.0, 0.0), (4.0, 6.0)))
CORRIDOR = (*ROOM, ((0.0, 2.0), (8.0, 2.0)), ((0.0, 4.0), (8.0, 4.0)))
# So thick that nothing within the planner's reach of its middle is free.
PILLAR = tuple(((x, 2.0), (x, 4.0)) for x in np.arange(5.0, 7.0, 0.05))
# A wall as homes have it: beside it the robot fits.
THIN = ((5.0, 2.0), (5.0, 4.0))
HASTY = NavigatorSettings(tries=1, held_s=1.0, lost_s=8.0)
QUICK = BehaviourSettings(wait_s=0.5)
quick = patched({"behaviours._LOOK": (0.2, -0.4, 0.2), "behaviours._SEARCH_RAD": 0.3})
TURNS_ALONE = RobotLimits(forward_m_s=0, backward_m_s=0)
ALL_ZERO = RobotLimits(forward_m_s=0, backward_m_s=0, turn_rad_s=0)
AT_ONCE_S = 0.5


def ride_of(walls: tuple = ROOM, mapped: tuple | None = None, **chosen: Any) -> Ride:
    settings = NavigationSettings(controller="pure_pursuit", **chosen)
    return Ride.of(Walls.of(*walls), BEGIN, SIZE_M, None if mapped is None else Walls.of(*mapped), settings)


def end_of(ride: Ride, seconds: float) -> NavigationResult:
    """Of a task that ends by then, without arrival and with the robot standing."""
    ride.go(seconds)
    result = not_none(ride.navigator.result)
    assert not result
    assert result.detail
    assert ride.robot.base.stands
    return result


NO_ROOM = "the map has no room for the robot at the goal"
IN_WALL = f"{NO_ROOM}: a wall, an obstacle or forbidden floor is at (5.00, 3.00) m"


@pytest.mark.parametrize(
    ("walls", "goal", "why"),
    [
        pytest.param((*ROOM, *PILLAR), (6.0, 3.0, 0.0), NO_ROOM, id="in a pillar"),
        pytest.param((*ROOM, *PILLAR), (6.0, 3.0), NO_ROOM, id="in a pillar, of any heading"),
        pytest.param((*ROOM, THIN), (5.0, 3.0, 0.0), IN_WALL, id="in a wall"),
        pytest.param((*ROOM, THIN), (5.0, 3.0), IN_WALL, id="in a wall, of any heading"),
        pytest.param(ROOM, (7.999, 3.0, 0.0), NO_ROOM, id="in the map's edge"),
        pytest.param(ROOM, (9.0, 3.0, 0.0), "outside the map", id="outside"),
        pytest.param(ROOM, (-1e9, 3.0), "outside the map", id="far outside"),
    ],
)
def test_where_the_map_has_no_room_it_says_so_at_once_and_does_not_move(
    walls: tuple, goal: tuple[float, ...], why: str
) -> None:
    ride = ride_of(walls)
    assert why in ride.navigator.why_no_goal(goal)
    assert ride.navigator.why_no_goal(NEAR) == ""
    ride.navigator.go_to_pose(goal)
    result = end_of(ride, 5.0)
    assert result.reason is NavigationReason.NO_PLAN
    assert why in result.detail
    assert result.recoveries == 0
    assert result.time_s < AT_ONCE_S
    assert tuple(ride.robot.base.pose) == BEGIN


def test_what_stands_there_and_not_in_the_map_may_go_and_is_waited_for() -> None:
    across = ((3.3, 2.0), (3.3, 4.0))
    ride = ride_of((*CORRIDOR, across), mapped=CORRIDOR, navigator=HASTY, behaviours=QUICK)
    ride.navigator.go_to_pose((3.5, 3.0, 0.0))
    result = end_of(ride, 30.0)
    assert any("the robot does not fit at the goal, nor near to it" in one.why for one in result.transitions)
    assert not any("the map has no room" in one.why for one in result.transitions)
    assert result.recoveries > 0
    assert ride.clearance_m > 0.02


def test_behind_a_door_that_the_map_has_shut_it_gives_up_where_it_began() -> None:
    ride = ride_of(SHUT, navigator=HASTY, behaviours=QUICK)
    ride.navigator.go_to_pose(GOAL)
    result = end_of(ride, 20.0)
    assert result.reason is NavigationReason.NO_PLAN
    assert result.detail.startswith("no way leads to the goal by the map itself")
    assert "walls or obstacles of the map enclose it" in result.detail
    ends_at_once(ride, result)


def ends_at_once(ride: Ride, result: NavigationResult) -> None:
    """Without a move."""
    assert result.recoveries == 0
    assert result.time_s < AT_ONCE_S
    assert tuple(ride.robot.base.pose) == BEGIN


def doorway(width_m: float) -> tuple:
    """In a wall across the room, about its middle."""
    return (*ROOM, ((4.0, 0.0), (4.0, 3.0 - width_m / 2)), ((4.0, 3.0 + width_m / 2), (4.0, 6.0)))


def wide(width_m: float, length_m: float = 1.1) -> FootprintSettings:
    return FootprintSettings(front_m=length_m - 0.3, back_m=0.3, width_m=width_m)


@pytest.mark.parametrize(
    ("door_m", "robot_m"), grids.mostly_slow([(0.55, 0.6), (0.35, 0.6), (1.9, 2.2)], quick=[(0.35, 0.6)])
)
def test_who_is_wider_than_the_door_hears_how_wide_both_are_and_where(door_m: float, robot_m: float) -> None:
    # Nor does it fit through sideways.
    ride = ride_of(doorway(door_m), footprint=wide(robot_m, max(1.1, door_m + 0.2)))
    ride.navigator.go_to_pose(GOAL)
    result = end_of(ride, 5.0)
    assert result.reason is NavigationReason.NO_PLAN
    found = not_none(
        re.search(r"is ([\d.]+) m wide at \(([\d.]+), ([\d.]+)\) m, and the robot needs ([\d.]+) m", result.detail)
    )
    wide_m, x, y, needs_m = map(float, found.groups())
    assert abs(wide_m - door_m) < 0.11
    assert 0.04 < needs_m - robot_m < 0.12
    assert np.hypot(x - 4.0, y - 3.0) < 0.15
    ends_at_once(ride, result)


@pytest.mark.slow
@pytest.mark.parametrize("goal", [GOAL, GOAL[:2]], ids=["with its heading", "of any heading"])
def test_who_fits_through_the_door_drives(goal: tuple[float, ...]) -> None:
    ride = ride_of(doorway(0.9))
    ride.navigator.go_to_pose(goal)
    ride.go(40.0)
    assert not_none(ride.navigator.result).has_arrived


def test_where_there_is_no_room_to_turn_it_says_that() -> None:
    """A corridor of 0.9 m with a bend, and a chair 1.9 m long."""
    corridor = (
        ((0.0, 3.45), (5.45, 3.45)),
        ((0.0, 2.55), (4.55, 2.55)),
        ((5.45, 3.45), (5.45, 0.0)),
        ((4.55, 2.55), (4.55, 0.0)),
    )
    ride = ride_of((*ROOM, *corridor), footprint=wide(0.6, 1.9))
    ride.navigator.go_to_pose((5.0, 1.0))
    result = end_of(ride, 5.0)
    assert result.reason is NavigationReason.NO_PLAN
    assert "has no room to turn" in result.detail
    assert "1.90 m long" in result.detail
    ends_at_once(ride, result)


@pytest.mark.parametrize("goal", [GOAL, (4.0, 3.0)], ids=["behind it", "in it"])
def test_unknown_floor_in_between_is_called_unknown(goal: tuple[float, ...]) -> None:
    ride = Ride.of(Walls.of(*ROOM), BEGIN, SIZE_M, settings=NavigationSettings(controller="pure_pursuit"))
    grid = Walls.of(*ROOM).grid(*SIZE_M)
    kind = np.where(grid.occupancy == 0, CellKind.FREE, CellKind.OBSTACLE).astype(np.uint8)
    kind[:, round(3.0 / CELL_M) : round(5.0 / CELL_M)] = CellKind.UNKNOWN
    unknown = KnownFloor(OccupancyGrid.of_kinds(kind, kind == CellKind.FREE, CELL_M, (0.0, 0.0)))
    ride.navigator = Navigator(ride.robot, ride.localization, unknown, ride.navigator.settings, trusts_floor=True)
    ride.navigator.go_to_pose(goal)
    result = end_of(ride, 5.0)
    assert result.reason is NavigationReason.NO_PLAN
    assert "unknown" in result.detail
    if goal is GOAL:
        first = not_none(re.search(r"unknown, first at \(([\d.]+), [\d.]+\) m", result.detail))
        assert 2.0 < float(first[1]) < 3.1
        assert "navigation.costmap.unknown=costly" in result.detail
    ends_at_once(ride, result)


@pytest.mark.slow
def test_who_is_larger_than_any_room_hears_that_at_once() -> None:
    width_m, length_m = 1.5, 1.6
    narrow = (*ROOM, *(((0.0, y), (8.0, y)) for y in np.r_[0.5:2.4:0.05, 3.6:5.5:0.05]))
    ride = ride_of(narrow, footprint=wide(width_m, length_m))
    ride.navigator.go_to_pose(GOAL)
    result = end_of(ride, 5.0)
    assert result.reason is NavigationReason.NO_PLAN
    assert result.detail.startswith("the map has no place that is wide enough for the robot: the widest is 1.")
    assert f"{length_m:.2f} m long and {width_m:.2f} m wide" in result.detail
    ends_at_once(ride, result)


class Scripted(WorkerInStep[PlanningResult]):
    """Answers plans by a list."""

    def __init__(self, *reasons: PlanReason) -> None:
        super().__init__()
        self.reasons = list(reasons)

    def answer(self, now_s: float) -> PlanningResult | None:
        if super().answer(now_s) is None:
            return None
        reason = self.reasons.pop(0) if len(self.reasons) > 1 else self.reasons[0]
        return PlanningResult(PlanFailure(reason, f"number {len(self.reasons)}"), np.zeros(3))


@pytest.mark.parametrize("last", [PlanReason.START_OCCUPIED, PlanReason.UNREACHABLE])
def test_the_first_reason_is_not_lost_behind_what_came_of_getting_out(last: PlanReason) -> None:
    ride = ride_of(navigator=HASTY, behaviours=QUICK)
    worker = Scripted(PlanReason.UNREACHABLE, last)
    ride = Ride.of(Walls.of(*ROOM), BEGIN, SIZE_M, settings=ride.navigator.settings, planning=worker)
    ride.navigator.go_to_pose(GOAL)
    result = end_of(ride, 20.0)
    assert result.recoveries == HASTY.tries
    assert result.detail.startswith("no way leads to the goal")
    assert ("at last the robot stands where something is" in result.detail) is (last is PlanReason.START_OCCUPIED)


@pytest.mark.parametrize("goal", [(np.nan, 1.0, 0.0), (1.0, np.inf), (1.0, 2.0, np.nan)])
def test_what_is_no_number_is_refused_while_it_drives_and_the_drive_goes_on(goal: tuple[float, ...]) -> None:
    ride = ride_of()
    with pytest.raises(ArgumentError, match="goal"):
        ride.navigator.go_to_pose(goal)
    ride.go(0.5)
    assert tuple(ride.robot.base.pose) == BEGIN
    ride.navigator.go_to_pose(NEAR)
    ride.go(1.0)
    with pytest.raises(ArgumentError, match="goal"):
        ride.navigator.go_to_pose(goal)
    ride.go(20.0)
    assert not_none(ride.navigator.result).has_arrived


class OneAfterAnother(PoseGoals):
    """Goes on without a goal that is not reached."""

    def missed(self) -> bool:
        self.reached()
        return bool(self.left)


@pytest.mark.parametrize("goals", [OneAfterAnother, PoseGoals], ids=["may be left out", "wanted, all of them"])
def test_of_several_goals_one_in_a_wall_is_left_out_or_ends_it(goals: type[PoseGoals]) -> None:
    ride = ride_of((*ROOM, *PILLAR))
    several: Goals = goals([GOAL, NEAR])
    ride.navigator.begin(several)
    ride.go(30.0)
    result = not_none(ride.navigator.result)
    assert result.recoveries == 0
    assert result.has_arrived is (goals is OneAfterAnother)
    assert result.has_arrived or result.time_s < AT_ONCE_S


@pytest.mark.parametrize("is_lost", [False, True], ids=["it knows where it is", "lost"])
@pytest.mark.parametrize("limits", [TURNS_ALONE, ALL_ZERO], ids=["may turn", "all zero"])
@pytest.mark.parametrize("explores", [False, True], ids=["to a pose", "explores"])
def test_who_may_not_drive_is_refused_at_once(explores: bool, limits: RobotLimits, is_lost: bool) -> None:
    ride = ride_of(limits=limits)
    if is_lost:
        ride.localization.says = lambda estimate: replace(estimate, status=Status.INITIALIZING)
    ride.navigator.explore() if explores else ride.navigator.go_to_pose(GOAL)
    result = end_of(ride, 5.0)
    assert result.reason is NavigationReason.NO_PLAN
    assert "limits let the robot neither forward nor backward" in result.detail
    assert result.time_s < AT_ONCE_S
    assert tuple(ride.robot.base.pose) == BEGIN


@pytest.mark.parametrize("status", [Status.INITIALIZING, Status.LOST])
def test_who_may_not_turn_does_not_drive_about_to_find_out_where_it_is(status: Status) -> None:
    """It would drive over floor that no turn has shown."""
    ride = ride_of(limits=RobotLimits(turn_rad_s=0))
    ride.localization.says = lambda estimate: replace(estimate, status=status)
    ride.navigator.go_to_pose(GOAL)
    result = end_of(ride, 10.0)
    assert result.reason is NavigationReason.LOST
    assert "turn_rad_s is 0" in result.detail
    assert result.time_s < BehaviourSettings().wait_s + AT_ONCE_S
    assert tuple(ride.robot.base.pose) == BEGIN


def test_who_may_not_turn_goes_on_when_it_knows_where_it_is_by_then() -> None:
    ride = ride_of(limits=RobotLimits(turn_rad_s=0))
    ride.localization.says = lambda estimate: (
        replace(estimate, status=Status.INITIALIZING) if estimate.stamp_s < 2.0 else estimate
    )
    ride.navigator.go_to_pose(NEAR)
    ride.go(20.0)
    assert not_none(ride.navigator.result).has_arrived


@pytest.mark.parametrize(
    ("limits", "goal"),
    [
        (RobotLimits(turn_rad_s=0), (4.0, 4.5, 1.0)),
        (RobotLimits(forward_m_s=0, turn_rad_s=0), NEAR),
        (RobotLimits(forward_m_s=0, turn_rad_s=0), (2.5, 4.0)),
    ],
    ids=["no turn, to the side", "backward alone, ahead", "backward alone, to the side"],
)
def test_where_limits_leave_no_way_it_says_that_none_leads_there(limits: RobotLimits, goal: tuple[float, ...]) -> None:
    ride = ride_of(limits=limits, navigator=HASTY, behaviours=QUICK)
    ride.navigator.go_to_pose(goal)
    result = end_of(ride, 20.0)
    assert result.reason is NavigationReason.NO_PLAN
    assert "no way leads to the goal" in result.detail
    assert abs(ride.robot.base.pose[2]) < 1e-6


def test_who_may_not_drive_forward_never_does() -> None:
    ride = ride_of(limits=RobotLimits(forward_m_s=0), navigator=HASTY, behaviours=QUICK)
    ride.navigator.go_to_pose(NEAR)
    fastest_m_s = -np.inf

    def drives() -> bool:
        nonlocal fastest_m_s
        fastest_m_s = max(fastest_m_s, ride.robot.base.forward_m_s)
        return False

    ride.go(60.0, until=drives)
    assert fastest_m_s < 1e-6
    result = not_none(ride.navigator.result)
    assert result.has_arrived or result.reason in (NavigationReason.NO_PLAN, NavigationReason.BLOCKED)
    assert ride.robot.base.stands
