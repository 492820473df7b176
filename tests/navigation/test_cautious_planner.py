"""Plans that look before they go, and what is said where there is none."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from navigation.floors import CHAIR, room
from navigation.floors import costmap_of as floor_of
from navigation.test_plan_view import EYE

from wheelsight.core.geometry import FloatArray
from wheelsight.navigation import CellState, Costmap, NavigationSettings, Plan, PlanFailure, StaticLayer
from wheelsight.navigation.planning import CautiousPlanner, PlanView, RoutePlanner

SETTINGS, VIEW = NavigationSettings(), PlanView(CHAIR, EYE)
PLANNER = CautiousPlanner(CHAIR, SETTINGS, VIEW)
START, TO_THE_LEFT = np.array([5.0, 5.0, 0.0]), np.array([5.0, 8.0, np.pi / 2])
ROOM = floor_of(room(10, 10))


def hidden_about(bearings: tuple[float, float], far_m: float) -> FloatArray:
    """(M, 3) beside the robot between two bearings, beyond its outline."""
    steps = np.arange(-far_m, far_m, 0.05)
    away = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    bearing = np.arctan2(away[:, 1], away[:, 0])
    is_there = (bearing > bearings[0]) & (bearing < bearings[1]) & (np.hypot(*away.T) < far_m)
    is_there &= ~CHAIR.padded(0.1).contains(away)
    return np.column_stack([away[is_there] + START[:2], np.full(is_there.sum(), 0.1)])


def avoiding(points: FloatArray, costmap: Costmap = ROOM) -> Costmap:
    state = costmap.state.copy()
    rows, columns = costmap.cells_at(points).T
    state[rows, columns] = CellState.OCCUPIED
    return Costmap.of(StaticLayer(state, costmap.speed_m_s, costmap.resolution_m, costmap.origin), CHAIR)


class Made(NamedTuple):
    """A plan or failure, and whether it crosses floor that the camera will not have seen."""

    found: Plan | PlanFailure
    is_blind: bool


def planned(hidden: FloatArray, costmap: Costmap = ROOM) -> Made:
    return Made(*PLANNER.plan(costmap, lambda points: avoiding(points, costmap), hidden, START, [TO_THE_LEFT]))


def test_it_goes_so_that_it_looks_there_first() -> None:
    hidden = hidden_about((0.5, 2.6), 2.0)
    plain, cautious = planned(hidden[:0]), planned(hidden)
    assert isinstance(plain.found, Plan)
    assert isinstance(cautious.found, Plan)
    assert VIEW.first_blind(plain.found.poses, hidden, ROOM) is not None
    assert VIEW.first_blind(cautious.found.poses, hidden, ROOM) is None
    assert not cautious.is_blind
    assert cautious.found.length_m < 3 * plain.found.length_m
    np.testing.assert_allclose(cautious.found.goal, TO_THE_LEFT, atol=1e-6)


def test_where_none_looks_there_first_the_first_one_counts_and_it_is_said() -> None:
    """It stands in the middle of floor that no one looked at, and nothing shows it any."""
    hidden = hidden_about((-np.pi, np.pi), 3.0)
    hidden[:, 2] = 0.0
    blind_eye = EYE._replace(far_m=0.1)
    planner = CautiousPlanner(CHAIR, SETTINGS, PlanView(CHAIR, blind_eye))
    made = Made(*planner.plan(ROOM, avoiding, hidden, START, [TO_THE_LEFT]))
    plain = Made(*PLANNER.plan(ROOM, avoiding, hidden[:0], START, [TO_THE_LEFT]))
    assert isinstance(made.found, Plan)
    assert isinstance(plain.found, Plan)
    assert made.is_blind
    assert made.found.length_m == pytest.approx(plain.found.length_m)


def test_what_is_blind_farther_off_is_left_for_later() -> None:
    """A bend that the robot will see from nearer by."""
    hidden = square_about(TO_THE_LEFT[:2] + (0.0, -1.0), 0.4)
    planner = CautiousPlanner(CHAIR, SETTINGS, PlanView(CHAIR, EYE._replace(far_m=0.1)))
    made = Made(*planner.plan(ROOM, lambda points: avoiding(points), hidden, START, [TO_THE_LEFT]))
    assert isinstance(made.found, Plan)
    assert not made.is_blind


def square_about(middle: FloatArray, half_m: float) -> FloatArray:
    """(M, 3) a square of hidden floor."""
    steps = np.arange(-half_m, half_m, 0.05)
    places = np.stack(np.meshgrid(*(steps + at for at in middle)), axis=-1).reshape(-1, 2)
    return np.column_stack([places, np.zeros(len(places))])


def test_why_there_is_none_is_said() -> None:
    goal = np.array([50.0, 5.0, 0.0])
    made = Made(*PLANNER.plan(ROOM, avoiding, hidden_about((0.5, 2.6), 2.0), START, [goal]))
    assert not made.found
    assert not made.is_blind


def test_the_first_pose_that_is_blocked_is_found() -> None:
    planner, goal = RoutePlanner(CHAIR, SETTINGS), np.array([8.0, 5.0, 0.0])
    plan = planner.plan(ROOM, START, [goal])
    assert isinstance(plan, Plan)
    assert planner.blocked_at(ROOM, plan, START, 20.0) is None
    wall = np.column_stack([np.full(200, 7.0), np.linspace(0.1, 9.9, 200)])
    blocked = planner.blocked_at(avoiding(wall), plan, START, 20.0)
    assert blocked is not None
    front_m = CHAIR.corners[:, 0].max()
    assert blocked[0] == pytest.approx(7.0 - front_m, abs=0.15)
    assert planner.blocked_at(avoiding(wall), plan, START, 0.5) is None
