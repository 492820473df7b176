"""Exploration: it looks from where most unseen floor shows for its way, until no view is left that shows any."""

from __future__ import annotations

import numpy as np
import pytest
from patched import patched

from wheelsight.navigation import Costmap, Exploration, Footprint, StaticLayer
from wheelsight.navigation.costmap import CellState
from wheelsight.navigation.exploration import FAR_M

constants = patched({"exploration.TURNS": 0})
CELL_M, NEAR_M, HALF_RAD = 0.1, 1.0, 0.5
CHAIR = Footprint.rectangle(0.8, 0.3, 0.6)
MARGIN_M = 0.025
MIDDLE = np.array([4.0, 4.0, 0.0])


def explorer_of() -> Exploration:
    return Exploration(CHAIR, MARGIN_M, NEAR_M, HALF_RAD)


def layer_of(state: np.ndarray, is_assumed: np.ndarray | None = None) -> StaticLayer:
    return StaticLayer(state, np.full(state.shape, np.inf, np.float32), CELL_M, (0.0, 0.0), is_assumed)


def costmap_of(state: np.ndarray, is_assumed: np.ndarray | None = None) -> Costmap:
    return Costmap.of(layer_of(state, is_assumed), CHAIR)


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
    explorer = explorer_of()
    assert explorer.upcoming(MIDDLE, costmap_of(room())) == ()
    assert explorer.left == 0


def test_it_looks_through_a_door_from_where_its_camera_sees_what_is_behind() -> None:
    (view,) = explorer_of().upcoming(MIDDLE, costmap_of(open_to(room(), 3.0, 4.5)))
    # Along its axis it leaves through the opening, and sees unknown floor within its reach.
    y_m = view[1] + np.tan(view[2]) * (8.0 - view[0])
    assert 3.0 < y_m < 4.5
    assert abs(view[2]) < 1.0
    assert 8.0 - view[0] < FAR_M


def test_a_slit_is_not_worth_a_look() -> None:
    assert explorer_of().upcoming(MIDDLE, costmap_of(open_to(room(), 1.0, 1.3))) == ()


def test_the_wide_one_first() -> None:
    (view,) = explorer_of().upcoming(MIDDLE, costmap_of(open_to(open_to(room(), 1.0, 1.8), 4.8, 7.3)))
    assert 4.8 < view[1] + np.tan(view[2]) * (8.0 - view[0]) < 7.3


def test_what_cannot_be_reached_is_not_looked_at() -> None:
    state = room()
    state[:81, 60] = CellState.OCCUPIED
    assert explorer_of().upcoming(MIDDLE, costmap_of(open_to(state, 3.0, 4.5))) == ()


def test_floor_behind_a_wall_is_none_that_a_view_shows() -> None:
    """Beyond a shut room all is unknown; a pocket within it is what is looked at."""
    state = room()
    state[60:75, 10:25] = CellState.UNKNOWN
    (view,) = explorer_of().upcoming(MIDDLE, costmap_of(state))
    away = np.array([1.75, 6.75]) - view[:2]
    assert NEAR_M < np.hypot(*away) < FAR_M
    assert np.cos(np.arctan2(away[1], away[0]) - view[2]) > np.cos(HALF_RAD)


def test_floor_that_somebody_said_is_free_is_looked_at_all_the_same() -> None:
    """The robot begins in the middle of floor that it does not see, and steps aside to look at it."""
    rows, columns = np.indices((120, 120))
    is_assumed = np.hypot((rows + 0.5) * CELL_M - 4.0, (columns + 0.5) * CELL_M - 4.0) < 0.9
    assert explorer_of().upcoming(MIDDLE, costmap_of(room())) == ()
    (view,) = explorer_of().upcoming(MIDDLE, costmap_of(room(), is_assumed))
    away = MIDDLE[:2] - view[:2]
    assert np.hypot(*away) > NEAR_M
    assert np.cos(np.arctan2(away[1], away[0]) - view[2]) > np.cos(HALF_RAD)


def test_little_floor_of_much_is_left() -> None:
    state = room()
    state[38:43, 70:75] = CellState.UNKNOWN
    assert explorer_of().upcoming(MIDDLE, costmap_of(state)) == ()
    free = state.copy()
    free[:, :28] = free[:, 80:] = free[:26] = free[54:] = CellState.OCCUPIED  # the same floor is more of a small room
    assert explorer_of().upcoming(MIDDLE, costmap_of(free)) != ()


def test_floor_that_stays_unseen_is_left_in_the_end() -> None:
    explorer = explorer_of()
    state = room()
    state[36:45, 70:79] = CellState.UNKNOWN
    views: list[np.ndarray] = []
    while ahead := explorer.upcoming(MIDDLE, costmap_of(state)):
        views += ahead
        explorer.taken()
        explorer.reached()
        assert len(views) < 10
    assert len(views) == 2
    # The second look is another: from there the first saw no more.
    off = views[1] - views[0]
    assert np.hypot(*off[:2]) >= 0.7 or abs(off[2]) > 0.5


def test_a_view_that_no_way_leads_to_is_left_for_another() -> None:
    explorer = explorer_of()
    state = room()
    state[36:45, 70:79] = CellState.UNKNOWN
    views: list[np.ndarray] = []
    while ahead := explorer.upcoming(MIDDLE, costmap_of(state)):
        views += ahead
        explorer.taken()
        assert explorer.missed()
        assert len(views) < 10
    assert len(views) == 2
    assert np.hypot(*(views[0] - views[1])[:2]) > 0.1


def test_first_it_turns_once_around(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.navigation.exploration.TURNS", 3)
    explorer = explorer_of()
    costmap, yaws = costmap_of(room()), [0.0]
    for _ in range(3):
        (goal,) = explorer.upcoming(np.array([4.0, 4.0, yaws[-1]]), costmap)
        assert goal[:2] == pytest.approx((4.0, 4.0))
        yaws.append(float(goal[2]))
        explorer.taken()
        assert not explorer.is_met(goal, layer_of(room()))
        explorer.reached()
    steps = np.angle(np.exp(1j * np.diff(yaws)))
    assert steps.sum() == pytest.approx(2 * np.pi)
    assert explorer.upcoming(MIDDLE, costmap) == ()


def test_it_has_looked_from_near_its_view_and_no_nearer() -> None:
    explorer = explorer_of()
    state = open_to(room(), 3.0, 4.5)
    (view,) = explorer.upcoming(MIDDLE, costmap_of(state))
    explorer.taken()
    assert explorer.is_met(view + [0.1, 0.0, 0.1], layer_of(state))
    assert not explorer.is_met(view + [0.5, 0.0, 0.0], layer_of(state))
    assert not explorer.is_met(view + [0.0, 0.0, 0.5], layer_of(state))


def test_what_was_seen_on_the_way_needs_no_look() -> None:
    explorer = explorer_of()
    before = open_to(room(), 3.0, 4.5)
    (view,) = explorer.upcoming(MIDDLE, costmap_of(before))
    explorer.taken()
    after = before.copy()
    after[:, 81:] = CellState.FREE
    far = view - [3.0, 0.0, 0.0]
    assert not explorer.is_met(far, layer_of(before))
    assert explorer.is_met(far, layer_of(after))
    # A wall behind the door is seen, and hides the rest.
    wall = before.copy()
    wall[:, 82] = CellState.OCCUPIED
    assert explorer.is_met(far, layer_of(wall))


def test_of_two_alike_it_looks_at_the_one_before_it_first() -> None:
    state = np.pad(open_to(room(), 3.2, 4.8), ((0, 0), (40, 0)), constant_values=CellState.UNKNOWN)
    state[32:48, 40:42] = CellState.FREE  # another opening, in the wall at x = 4 m
    for yaw in (0.0, np.pi):
        (view,) = explorer_of().upcoming(np.array([8.0, 4.0, yaw]), costmap_of(state))
        assert np.cos(view[2] - yaw) > 0.8


def test_floor_that_is_worth_less_than_a_look_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.navigation.exploration._LEAST_M2", 50.0)
    assert explorer_of().upcoming(MIDDLE, costmap_of(open_to(room(), 3.0, 4.5))) == ()


def test_it_stays_with_its_view_until_another_is_clearly_better() -> None:
    """Of two doors alike: a little nearer to the other one it goes on to the first."""
    state = np.pad(open_to(room(), 3.2, 4.8), ((0, 0), (40, 0)), constant_values=CellState.UNKNOWN)
    state[32:48, 40:42] = CellState.FREE
    costmap, explorer = costmap_of(state), explorer_of()
    (first,) = explorer.upcoming(np.array([8.0, 4.0, 0.0]), costmap)
    explorer.taken()
    assert first[0] > 8.0
    turned = np.array([7.9, 4.0, 0.55 * np.pi])
    (fresh,) = explorer_of().upcoming(turned, costmap)
    assert fresh[0] < 8.0
    (kept,) = explorer.upcoming(turned, costmap)
    np.testing.assert_allclose(kept, first)
    explorer.reached()
    (other,) = explorer.upcoming(turned, costmap)
    assert other[0] < 8.0
