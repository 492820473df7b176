"""Where a way was blocked the next plans lead elsewhere, as long as the way round is not much longer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none

from wheelsight.navigation import CellState, Costmap, Footprint, NavigationSettings, Plan, StaticLayer
from wheelsight.navigation.planning import BlockedWays, RoutePlanner

ROBOT, COST = Footprint.rectangle(0.8, 0.3, 0.6), 4.0
CELL_M = 0.05
START, GOAL, DOOR = np.array([1.5, 1.0, 0.0]), np.array([8.5, 1.0, 0.0]), np.array([5.0, 1.0])


def house(*, second_door_m: float | None) -> Costmap:
    """10 m × 8 m with a wall in the middle, a door at y = 1 m, and another one at a height."""
    state = np.full((160, 200), CellState.FREE, np.uint8)
    state[[0, -1]], state[:, [0, -1]] = CellState.OCCUPIED, CellState.OCCUPIED
    state[:, 98:102] = CellState.OCCUPIED
    for door_m in (1.0, second_door_m):
        if door_m is not None:
            state[round((door_m - 0.6) / CELL_M) : round((door_m + 0.6) / CELL_M), 98:102] = CellState.FREE
    free = np.full(state.shape, np.inf, np.float32)
    return Costmap.of(StaticLayer(state, free, CELL_M, (0.0, 0.0)), ROBOT)


def door_of(costmap: Costmap) -> float:
    """y where the plan passes the wall."""
    plan = RoutePlanner(ROBOT, NavigationSettings()).plan(costmap, START, [GOAL])
    assert isinstance(plan, Plan)
    return float(plan.poses[np.abs(plan.poses[:, 0] - 5.0).argmin(), 1])


@pytest.mark.parametrize(
    ("times", "after_s", "door_m"), [(0, 0, 1.0), (1, 1, 1.0), (2, 21, 4.0), (2, 201, 1.0), (3, 190, 4.0)]
)
def test_from_the_second_visit_on_the_other_door_is_taken_for_a_while(
    times: int, after_s: float, door_m: float
) -> None:
    ways = BlockedWays(free_visits=1)
    for n in range(times):
        ways = ways.with_place(DOOR, 20.0 * n)
    assert door_of(ways.on(house(second_door_m=4.0), after_s)) == pytest.approx(door_m, abs=0.5)


@pytest.mark.parametrize(("free_visits", "door_m"), [(0, 4.0), (1, 1.0)])
def test_in_a_map_that_grows_the_first_visit_counts(free_visits: int, door_m: float) -> None:
    ways = BlockedWays(free_visits).with_place(DOOR, 0.0)
    assert door_of(ways.on(house(second_door_m=4.0), 1.0)) == pytest.approx(door_m, abs=0.5)


def test_the_only_door_is_taken_however_often_it_was_blocked() -> None:
    ways = BlockedWays(free_visits=1)
    for n in range(15):
        ways = ways.with_place(DOOR, 11.0 * n)
    costmap = ways.on(house(second_door_m=None), 165.0)
    assert door_of(costmap) == pytest.approx(1.0, abs=0.3)
    assert not_none(costmap.dearness).max() == 1 + 3 * COST


def test_what_is_long_ago_is_forgotten() -> None:
    ways = BlockedWays(free_visits=1).with_place(DOOR, 0.0).with_place(DOOR, 170.0).with_place(DOOR, 181.0)
    assert [one[2] for one in ways.found] == [170.0, 181.0]
    costmap = house(second_door_m=4.0)
    assert ways.on(costmap, 400.0) is costmap
    assert BlockedWays(free_visits=1).on(costmap, 0.0) is costmap


def test_a_visit_counts_once_however_often_it_is_found_blocked() -> None:
    ways = BlockedWays(free_visits=1)
    for n in range(40):
        ways = ways.with_place(DOOR + (0.01 * n, 0.0), 1.0 * n)
    assert [one[2] for one in ways.found] == [39.0]
    assert ways.on(house(second_door_m=4.0), 40.0).dearness is None
    elsewhere = ways.with_place(DOOR - (2.0, 0.0), 40.0)
    assert [one[2] for one in elsewhere.found] == [39.0, 40.0]


def test_places_at_and_beyond_the_edge_are_no_error() -> None:
    ways = BlockedWays(free_visits=1)
    for stamp_s in (0.0, 20.0):
        ways = ways.with_place(np.array([0.0, 0.0]), stamp_s).with_place(np.array([-50.0, 70.0]), stamp_s)
    dear = not_none(ways.on(house(second_door_m=4.0), 21.0).dearness)
    assert dear[0, 0] == 1 + COST
    assert dear[30:, 30:].max() == 1.0


def test_floor_below_the_robot_that_nobody_has_seen_leaves_them_dear() -> None:
    costmap = house(second_door_m=4.0)
    state = costmap.state.copy()
    state[18:24, 28:40] = CellState.UNKNOWN
    ways = BlockedWays(free_visits=1).with_place(DOOR, 0.0).with_place(DOOR, 20.0)
    dear = ways.on(replace(costmap, state=state), 21.0)
    assert dear.standing_at(ROBOT, START) is not dear
    assert dear.standing_at(ROBOT, START).dearness is dear.dearness


def test_the_first_pose_that_is_blocked_is_told() -> None:
    planner = RoutePlanner(ROBOT, NavigationSettings())
    costmap = house(second_door_m=None)
    plan = planner.plan(costmap, START, [GOAL])
    assert isinstance(plan, Plan)
    assert planner.blocked_at(costmap, plan, START, 20.0) is None
    state = costmap.state.copy()
    state[:, 120:124] = CellState.OCCUPIED
    shut = Costmap.of(StaticLayer(state, costmap.speed_m_s, CELL_M, (0.0, 0.0)), ROBOT)
    blocked = not_none(planner.blocked_at(shut, plan, START, 20.0))
    assert blocked[0] == pytest.approx(6.0 - 0.8, abs=0.15)
    assert planner.blocked_at(shut, plan, START, 3.0) is None
