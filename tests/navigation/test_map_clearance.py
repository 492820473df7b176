"""Behaviours keep clear of what the map has, whatever the camera sees of it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from navigation.rooms import Ride
from patched import patched

from benchmarks.plain_rooms import Walls, walls_about
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.navigation import Costmap, Footprint, NavigationSettings, NavigationState, StaticLayer
from wheelsight.navigation.behaviours import keeps_clear
from wheelsight.navigation.costmap import CellState
from wheelsight.navigation.settings import BehaviourSettings, outline_of

constants = patched({"behaviours._REFUSED_S": 0.5})
CELL_M = 0.05
CHAIR = Footprint.rectangle(0.8, 0.3, 0.6)
LEFT, RIGHT, BACK, ON = (VelocityCommand(*one) for one in ((0.0, 0.4), (0.0, -0.4), (-0.1, 0.0), (0.3, 0.0)))


def beside_a_counter(away_m: float, state: CellState = CellState.OCCUPIED) -> tuple[Costmap, FloatArray]:
    """The chair looks along x; to its right, so far from its side, all is a counter."""
    cells = np.full((160, 160), CellState.FREE, np.uint8)
    cells[:60] = state
    layer = StaticLayer(cells, np.full(cells.shape, np.inf, np.float32), CELL_M, (0.0, 0.0))
    return Costmap.of(layer, CHAIR), np.array([4.0, 3.0 + away_m + 0.3, 0.0])


def clear(away_m: float, command: VelocityCommand, state: CellState = CellState.OCCUPIED) -> bool:
    costmap, pose = beside_a_counter(away_m, state)
    return keeps_clear(costmap, outline_of(CHAIR), pose, command)


@pytest.mark.parametrize("command", [LEFT, RIGHT])
def test_beside_a_counter_it_turns_to_no_side(command: VelocityCommand) -> None:
    assert not clear(0.1, command)
    assert clear(0.6, command)


def test_along_it_goes_on() -> None:
    assert clear(0.1, ON)
    assert clear(0.1, BACK)


def test_nearer_than_it_should_be_it_may_stay_and_leave_but_come_no_nearer() -> None:
    costmap, pose = beside_a_counter(0.03)
    away = pose + [0.0, 0.0, np.pi / 2]
    away[1] = 3.0 + 0.03 + 0.3  # its back to the counter
    outline = outline_of(CHAIR)
    assert clear(0.03, STOP)
    assert keeps_clear(costmap, outline, away, ON)
    assert not keeps_clear(costmap, outline, away, BACK)


def test_floor_that_no_one_has_seen_is_no_obstacle() -> None:
    assert clear(0.1, LEFT, CellState.UNKNOWN)


def test_who_is_lost_where_the_map_lets_it_turn_to_no_side_backs_up_to_look() -> None:
    """It took up another way to look in each period, twenty a second, and did none of them."""
    room = walls_about(8.0, 6.0)
    mapped = *room, ((1.9, 2.62), (3.2, 2.62)), ((1.9, 3.38), (3.2, 3.38))
    hasty = NavigationSettings(behaviours=BehaviourSettings(wait_s=0.5, search_m=0.0))
    ride = Ride.of(Walls.of(*room), (2.2, 3.0, 0.0), (8.0, 6.0), Walls.of(*mapped), hasty)
    vague = np.diag([4.0, 4.0, 1e-6, 1e-6, 1e-6, 0.01])
    ride.localization.says = lambda estimate: replace(estimate, status=Status.COASTING, covariance=vague)
    ride.navigator.go_to_pose((6.0, 3.0, 0.0))
    ride.go(12.0, until=lambda: ride.robot.base.pose[0] < 2.0)
    searches = [one for one in ride.transitions if one.after is NavigationState.RECOVERING]
    assert ride.robot.base.pose[0] < 2.0
    assert 2 <= len(searches) <= 5
    assert all(b.stamp_s - a.stamp_s > 0.2 for a, b in pairwise(searches))


@pytest.mark.parametrize(("away_m", "may"), [(0.03, False), (1.0, True)])
def test_backward_it_goes_to_no_floor_that_is_unknown(away_m: float, may: bool) -> None:
    """All behind the chair is unknown, from so far behind it on."""
    cells = np.full((160, 160), CellState.FREE, np.uint8)
    cells[:, :60] = CellState.UNKNOWN
    layer = StaticLayer(cells, np.full(cells.shape, np.inf, np.float32), CELL_M, (0.0, 0.0))
    costmap, pose = Costmap.of(layer, CHAIR), np.array([3.0 + away_m + 0.3, 4.0, 0.0])
    how = costmap, outline_of(CHAIR), pose, BACK
    assert keeps_clear(*how, minds_unknown=True) is may
    assert keeps_clear(*how)
