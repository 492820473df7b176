"""A robot that is off in a known map is laid on what stands there; what the map does not show is left alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from wheelsight.geometry import FloatArray, se2
from wheelsight.navigation import LiveObstacles, StaticLayer
from wheelsight.navigation.costmap import CellState
from wheelsight.navigation.map_match import MapMatch

CELL_M = 0.05
ROOM = np.array([(0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (0.0, 4.0)])


def along(corners: FloatArray, is_closed: bool = True) -> FloatArray:
    """(N, 2) points of walls, densely."""
    ends = np.roll(corners, -1, axis=0) if is_closed else corners[1:]
    begins = corners if is_closed else corners[:-1]
    return np.concatenate([np.linspace(a, b, 400) for a, b in zip(begins, ends, strict=True)])


def static_of(points: FloatArray) -> StaticLayer:
    state = np.full((200, 240), CellState.FREE, np.uint8)
    cells = np.floor((points + 2.0) / CELL_M).astype(int)
    state[cells[:, 1], cells[:, 0]] = CellState.OCCUPIED
    return StaticLayer(state, np.full(state.shape, np.inf, np.float32), CELL_M, (-2.0, -2.0))


def live_of(points: FloatArray) -> LiveObstacles:
    is_occupied = np.zeros((280, 280), bool)
    cells = np.floor((points[np.abs(points).max(axis=1) < 6.9] + 7.0) / CELL_M).astype(int)
    is_occupied[cells[:, 1], cells[:, 0]] = True
    return LiveObstacles(is_occupied, CELL_M, (-7.0, -7.0), "odom", 1.0, is_occupied)


def seen_from(points: FloatArray, T_map_odom: FloatArray) -> FloatArray:
    """Points (N, 2) of the map in odom."""
    T = se2.invert(T_map_odom)
    return np.asarray(points @ T[:2, :2].T + T[:2, 2])


@pytest.mark.parametrize("off", [(0.12, -0.1, 0.0), (0.05, 0.05, 0.09), (-0.1, 0.08, -0.1)])
def test_a_room_tells_where_the_robot_is(off: tuple[float, float, float]) -> None:
    walls = along(ROOM)
    match = MapMatch(static_of(walls))
    T_map_odom = se2.from_parts(2.0, 1.0, 0.3)
    told = se2.to_parts(se2.from_parts(*off) @ T_map_odom)
    for _ in range(6):
        match.update(live_of(seen_from(walls, T_map_odom)), np.array(told), np.array([0.5, 0.5]))
    found = se2.to_parts(match.T_map_told @ se2.from_parts(*told))
    assert_allclose(found, se2.to_parts(T_map_odom), atol=0.03)  # half a cell, and what is rounded


def test_a_corridor_tells_nothing_of_the_way_along() -> None:
    walls = np.concatenate([along(np.array([(-2.0, y), (9.5, y)]), is_closed=False) for y in (0.0, 1.5)])
    match = MapMatch(static_of(walls))
    told = np.array([2.3, 0.6, 0.0])
    for _ in range(6):
        match.update(live_of(seen_from(walls, se2.from_parts(2.0, 0.7, 0.0))), told, np.zeros(2))
    x, y, _ = se2.to_parts(match.T_map_told @ se2.from_parts(*told))
    assert y == pytest.approx(0.7, abs=0.03)
    assert x == pytest.approx(2.3, abs=0.01)


def test_things_that_the_map_does_not_have_pull_nothing() -> None:
    walls = along(ROOM)
    people = np.concatenate(
        [along(np.array([(1.0, 1.0), (1.4, 1.2)]), False), along(np.array([(3.0, 2.0), (3.2, 2.4)]), False)]
    )
    match = MapMatch(static_of(walls))
    T_map_odom = se2.from_parts(2.0, 1.0, 0.0)
    seen = seen_from(np.concatenate([walls, people]), T_map_odom)
    match.update(live_of(seen), np.array(se2.to_parts(T_map_odom)), np.zeros(2))
    assert_allclose(match.T_map_told, np.eye(3), atol=0.01)


def test_another_building_is_no_match() -> None:
    rng = np.random.default_rng(0)
    match = MapMatch(static_of(along(ROOM)))
    elsewhere = rng.uniform(0.8, 3.2, (400, 2)) + (1.0, 0.0)
    match.update(live_of(elsewhere), np.zeros(3), np.array([2.0, 2.0]))
    assert match.share is None
    assert_allclose(match.T_map_told, np.eye(3))


def test_too_little_is_no_match() -> None:
    match = MapMatch(static_of(along(ROOM)))
    match.update(live_of(np.array([(1.0, 1.0), (1.1, 1.0)])), np.zeros(3), np.zeros(2))
    assert match.share is None


def test_what_stands_elsewhere_pulls_no_farther_than_the_localization_may_be_off() -> None:
    """Two walls of four, moved by 0.3 m since: as far as the likelihood goes, it is the robot that has."""
    walls = along(ROOM)
    T_map_odom = se2.from_parts(2.0, 1.0, 0.0)
    seen = seen_from(walls[:800] + (0.3, 0.0), T_map_odom)
    off_m = []
    for sigmas in ((np.inf, np.inf), (0.02, 0.01)):
        match = MapMatch(static_of(walls))
        for _ in range(8):
            match.update(live_of(seen), np.array(se2.to_parts(T_map_odom)), np.zeros(2), sigmas)
        off_m.append(float(np.hypot(*match.T_map_told[:2, 2])))
    assert off_m[0] > 0.2
    assert off_m[1] < 0.6 * off_m[0]
    assert off_m[1] < 0.15


def test_a_correction_is_given_up_once_the_localization_knows_better() -> None:
    walls = along(ROOM)
    match = MapMatch(static_of(walls))
    T_map_odom = se2.from_parts(2.0, 1.0, 0.0)
    told = np.array(se2.to_parts(se2.from_parts(0.3, -0.2, 0.0) @ T_map_odom))
    for _ in range(8):
        match.update(live_of(seen_from(walls, T_map_odom)), told, np.zeros(2), (0.5, 0.1))
    assert np.hypot(*match.T_map_told[:2, 2]) == pytest.approx(np.hypot(0.3, 0.2), abs=0.05)
    nothing = live_of(np.zeros((0, 2)))
    match.update(nothing, np.array(se2.to_parts(T_map_odom)), np.zeros(2), (0.5, 0.1))
    assert np.hypot(*match.T_map_told[:2, 2]) > 0.3
    match.update(nothing, np.array(se2.to_parts(T_map_odom)), np.zeros(2), (0.03, 0.01))
    assert_allclose(match.T_map_told, np.eye(3))
