"""Costmap and floor kernels against the plain numpy that says the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from odometry.plain_kernels import plain

from wheelsight.core.geometry import BoolArray, FloatArray
from wheelsight.navigation import costmap_kernels
from wheelsight.navigation import costmap_kernels as floor_kernels
from wheelsight.navigation import costmap_kernels as live_kernels

FREE, UNKNOWN, OCCUPIED = 0, 1, 2
turns = st.floats(-4.0, 4.0)


def marked_plainly(is_occupied: BoolArray, low: FloatArray, T: FloatArray, to_low: FloatArray, shape: tuple[int, int]):
    """Sixteen points a cell, each turned and shifted."""
    found = np.zeros(shape, bool)
    x, y, yaw = T
    R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    for row, column in np.argwhere(is_occupied):
        for k in range(16):
            point = low + 0.05 * np.array([column + (k % 4 + 0.5) / 4, row + (k // 4 + 0.5) / 4])
            at = np.floor((R @ point + (x, y) - to_low) / 0.1).astype(int)[::-1]
            if (at >= 0).all() and (at < shape).all():
                found[tuple(at)] = True
    return found


@given(seed=st.integers(0, 2**32 - 1), turn=turns)
def test_obstacles_are_marked_where_any_sixteenth_of_their_cells_lies(seed: int, turn: float) -> None:
    rng = np.random.default_rng(seed)
    is_occupied, low, to_low = rng.random((9, 12)) < 0.2, rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2)
    T, state = np.array([*rng.uniform(-0.3, 0.3, 2), turn]), np.zeros((14, 17), np.uint8)
    of, to = costmap_kernels.CellFrame(0.05, *low.tolist()), costmap_kernels.CellFrame(0.1, *to_low.tolist())
    place = (float(T[0]), float(T[1]), float(np.cos(turn)), float(np.sin(turn)))
    costmap_kernels.mark_occupied(is_occupied, of, place, to, OCCUPIED, state)
    # A point on the edge of a cell may fall to either side of it.
    assert np.count_nonzero((state == OCCUPIED) != marked_plainly(is_occupied, low, T, to_low, state.shape)) <= 1


@pytest.mark.parametrize("is_plain", [False, True])
def test_costs_fall_from_obstacles_and_are_no_less_where_no_one_looked(is_plain: bool) -> None:
    kernels = plain(costmap_kernels) if is_plain else costmap_kernels
    distance_m = np.linspace(0, 1.5, 30, dtype=np.float32).reshape(5, 6)
    state = np.full((5, 6), FREE, np.uint8)
    state[:, 3] = UNKNOWN
    is_lethal = distance_m == 0
    found = kernels.costs(state, is_lethal, distance_m, costmap_kernels.Falls(0.3, 0.6, 5.0, 0.5), UNKNOWN)
    beyond = np.maximum(distance_m - 0.3, 0)
    expected = np.where(beyond <= 0.6, np.exp(-5 * beyond), 0)
    expected = np.where(state == UNKNOWN, np.maximum(expected, 0.5), expected)
    expected[is_lethal] = 1
    assert found.dtype == np.float32
    assert found == pytest.approx(expected, abs=1e-6)


@given(seed=st.integers(0, 2**32 - 1))
def test_cells_in_sight_have_nothing_between(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = rng.choice([FREE, UNKNOWN, OCCUPIED], size=(24, 30), p=[0.3, 0.65, 0.05]).astype(np.uint8)
    place, reach, found = rng.uniform(8, 16, 2), 7.0, np.zeros((24, 30), bool)
    floor_kernels.mark_in_sight(state, place, reach, (UNKNOWN, OCCUPIED), found)
    shares = np.linspace(0, 1, 2 + int(2 * reach))
    for row, column in np.ndindex(state.shape):
        way = np.array([column, row]) + 0.5 - place
        passed = np.floor(place + shares[:, None] * way).astype(int)
        # Beyond the reach it is not asked what lies there.
        is_near = state[row, column] == UNKNOWN and np.hypot(*way) <= reach
        assert found[row, column] == (is_near and not (state[passed[:, 1], passed[:, 0]] == OCCUPIED).any())


def test_a_cell_is_left_where_any_of_its_layers_is(rng: np.random.Generator) -> None:
    left = rng.choice([0, 0, 0, 2], size=(20, 30, 4)).astype(np.uint8)
    assert (live_kernels.any_left(left) == left.any(axis=2)).all()
