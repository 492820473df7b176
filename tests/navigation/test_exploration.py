"""Exploration: it looks at borders of what is known, wide and near ones first, and ends where none can be reached."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.navigation import Costmap, Exploration, Footprint, NavigationSettings, StaticLayer
from wheelsight.navigation.costmap import CellState
from wheelsight.navigation.exploration import frontiers
from wheelsight.navigation.navigator_settings import ExplorationSettings

CELL_M, NEAR_M = 0.1, 1.0
CHAIR = Footprint.rectangle(0.8, 0.3, 0.6)
SETTINGS = NavigationSettings(exploration=ExplorationSettings(turns=0))
MIDDLE = np.array([4.0, 4.0, 0.0])


def layer_of(state: np.ndarray) -> StaticLayer:
    return StaticLayer(state, np.full(state.shape, np.inf, np.float32), CELL_M, (0.0, 0.0))


def costmap_of(state: np.ndarray) -> Costmap:
    return Costmap.of(layer_of(state), CHAIR)


def room() -> np.ndarray:
    """8 × 8 m, walled in, all of it seen; unknown beyond."""
    state = np.full((120, 120), CellState.UNKNOWN, np.uint8)
    state[:81, :81] = CellState.OCCUPIED
    state[1:80, 1:80] = CellState.FREE
    return state


def open_to(state: np.ndarray, low_m: float, high_m: float) -> np.ndarray:
    """With an opening in the wall at x = 8 m."""
    state = state.copy()
    state[round(low_m / CELL_M) : round(high_m / CELL_M), 79:81] = CellState.FREE
    return state


def test_where_all_is_seen_there_is_nothing_to_do() -> None:
    explorer = Exploration(CHAIR, SETTINGS, NEAR_M)
    assert explorer.upcoming(MIDDLE, costmap_of(room())) == ()
    assert explorer.left == 0


def test_a_door_is_a_border() -> None:
    found = frontiers(costmap_of(open_to(room(), 3.0, 4.5)), 0.6)
    assert len(found) == 1
    assert found[0].size_m == pytest.approx(1.5, abs=0.15)
    assert found[0].middle == pytest.approx((8.05, 3.75), abs=0.15)


def test_it_looks_at_a_border_from_where_its_camera_sees_it() -> None:
    explorer = Exploration(CHAIR, SETTINGS, NEAR_M)
    (view,) = explorer.upcoming(MIDDLE, costmap_of(open_to(room(), 3.0, 4.5)))
    away = np.array([8.05, 3.75]) - view[:2]
    assert NEAR_M <= np.hypot(*away) <= SETTINGS.exploration.far_m + 0.1
    assert np.arctan2(away[1], away[0]) == pytest.approx(view[2], abs=0.1)


def test_the_wide_one_first_and_a_slit_never() -> None:
    state = open_to(open_to(room(), 1.0, 1.3), 4.0, 6.5)
    explorer = Exploration(CHAIR, SETTINGS, NEAR_M)
    (view,) = explorer.upcoming(MIDDLE, costmap_of(state))
    assert explorer.left == 1
    assert view[2] > 0


def test_what_cannot_be_reached_is_not_looked_at() -> None:
    state = room()
    state[:81, 60] = CellState.OCCUPIED
    explorer = Exploration(CHAIR, SETTINGS, NEAR_M)
    assert explorer.upcoming(MIDDLE, costmap_of(open_to(state, 3.0, 4.5))) == ()


def test_a_border_that_stays_is_left_in_the_end() -> None:
    explorer = Exploration(CHAIR, SETTINGS, NEAR_M)
    costmap = costmap_of(open_to(room(), 3.0, 4.5))
    views: list[np.ndarray] = []
    for _ in range(SETTINGS.exploration.tries):
        views.append(explorer.upcoming(MIDDLE, costmap)[0])
        explorer.taken()
        explorer.reached()
    assert explorer.upcoming(MIDDLE, costmap) == ()
    # The second look is another: from there it saw no more.
    off = views[1] - views[0]
    assert np.hypot(*off[:2]) >= SETTINGS.exploration.same_m or abs(off[2]) > SETTINGS.exploration.same_rad


def test_one_that_no_way_leads_to_is_looked_at_from_elsewhere_and_then_left() -> None:
    explorer = Exploration(CHAIR, SETTINGS, NEAR_M)
    costmap = costmap_of(open_to(room(), 3.0, 4.5))
    views: list[np.ndarray] = []
    for _ in range(SETTINGS.exploration.tries):
        views += explorer.upcoming(MIDDLE, costmap)
        explorer.taken()
        assert explorer.missed()
    assert np.hypot(*(views[0] - views[1])[:2]) > 0.1
    assert explorer.upcoming(MIDDLE, costmap) == ()


def test_first_it_turns_once_around() -> None:
    explorer = Exploration(CHAIR, NavigationSettings(), NEAR_M)
    costmap, yaws = costmap_of(room()), [0.0]
    for _ in range(NavigationSettings().exploration.turns):
        (goal,) = explorer.upcoming(np.array([4.0, 4.0, yaws[-1]]), costmap)
        assert goal[:2] == pytest.approx((4.0, 4.0))
        yaws.append(float(goal[2]))
        explorer.taken()
        explorer.reached()
    steps = np.angle(np.exp(1j * np.diff(yaws)))
    assert steps.sum() == pytest.approx(2 * np.pi)
    assert explorer.upcoming(MIDDLE, costmap) == ()


def test_a_border_is_looked_at_from_near_its_view_and_no_nearer() -> None:
    explorer = Exploration(CHAIR, SETTINGS, NEAR_M)
    costmap, layer = costmap_of(open_to(room(), 3.0, 4.5)), layer_of(open_to(room(), 3.0, 4.5))
    (view,) = explorer.upcoming(MIDDLE, costmap)
    explorer.taken()
    assert explorer.is_met(view + [0.2, 0.0, 0.2], layer)
    assert not explorer.is_met(view + [0.5, 0.0, 0.0], layer)
    assert not explorer.is_met(view + [0.0, 0.0, 0.5], layer)


def test_a_border_that_was_seen_on_the_way_needs_no_look() -> None:
    explorer = Exploration(CHAIR, SETTINGS, NEAR_M)
    before = open_to(room(), 3.0, 4.5)
    explorer.upcoming(MIDDLE, costmap_of(before))
    explorer.taken()
    after = before.copy()
    after[20:60, 79:100] = CellState.FREE
    assert not explorer.is_met(MIDDLE, layer_of(before))
    assert explorer.is_met(MIDDLE, layer_of(after))
    assert not explorer.is_met(MIDDLE, layer_of(before[:, :81]))


def test_first_it_turns_all_around_exactly() -> None:
    explorer = Exploration(CHAIR, NavigationSettings(exploration=ExplorationSettings(turns=3)), NEAR_M)
    (view,) = explorer.upcoming(MIDDLE, costmap_of(room()))
    assert not explorer.is_met(view, layer_of(room()))


def test_of_two_alike_it_looks_at_the_one_before_it_first() -> None:
    state = np.pad(open_to(room(), 3.2, 4.8), ((0, 0), (40, 0)), constant_values=CellState.UNKNOWN)
    state[32:48, 40:42] = CellState.FREE  # another opening, in the wall at x = 4 m
    for yaw in (0.0, np.pi):
        explorer = Exploration(CHAIR, SETTINGS, NEAR_M)
        (view,) = explorer.upcoming(np.array([8.0, 4.0, yaw]), costmap_of(state))
        assert np.cos(view[2] - yaw) > 0.8
