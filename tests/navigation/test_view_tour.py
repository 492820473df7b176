"""Tours of views, held against all orders and against exhaustive choices."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.geometry import BoolArray, FloatArray, IntArray
from wheelsight.navigation.view_tour import VIEWS, best_order, covering_views


def cost_of(order: tuple[int, ...], costs: np.ndarray, gains: np.ndarray) -> float:
    """The last time, and the mean one by gains."""
    steps = [costs[before + 1, after + 1] for before, after in zip((-1, *order), order, strict=False)]
    times = np.cumsum(steps)
    return float(times[-1] + times @ gains[list(order)] / gains.sum())


@pytest.mark.parametrize("count", [1, 3, 5, 7])
@given(seed=st.integers(0, 10**6))
def test_an_order_is_nearly_the_best_of_all(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    at = rng.uniform(0, 10, (count + 1, 2))
    costs = np.hypot(*(at[:, None] - at).transpose(2, 0, 1)) + rng.uniform(0, 1, (count + 1, count + 1))
    gains = rng.uniform(0.1, 5.0, count)
    order, cost = best_order(costs, gains)
    assert sorted(order) == list(range(count))
    assert cost == pytest.approx(cost_of(tuple(order), costs, gains))
    least = min(cost_of(one, costs, gains) for one in permutations(range(count)))
    assert cost <= (1 + 1e-9 if count <= 5 else 1.15) * least
    begun, cost = best_order(costs, gains, first=count - 1)
    assert begun[0] == count - 1
    assert cost >= least - 1e-9


def test_a_corner_on_the_way_is_taken_along_and_a_hall_comes_before_a_far_corner() -> None:
    def along(*x: float) -> FloatArray:
        return np.abs(np.subtract.outer((0.0, *x), (0.0, *x)))

    assert best_order(along(1.0, 5.0), np.array([1.0, 20.0]))[0] == [0, 1]
    assert best_order(along(-2.0, 3.0), np.array([1.0, 20.0]))[0] == [1, 0]
    assert best_order(along(-2.0, 3.0), np.array([1.0, 1.0]))[0] == [0, 1]


def shown(view: FloatArray, is_wanted: BoolArray) -> IntArray:
    """Cells about a place, within a view's third number."""
    cells = np.argwhere(is_wanted)
    return cells[np.hypot(*(cells - view[:2]).T) <= view[2]]


@given(seed=st.integers(0, 10**6))
def test_views_are_those_of_a_plain_greedy_choice(seed: int) -> None:
    rng = np.random.default_rng(seed)
    is_wanted = rng.random((20, 20)) < 0.6
    views = np.column_stack([rng.uniform(0, 20, (30, 2)), rng.uniform(1, 5, 30)])
    most = np.array([len(shown(view, is_wanted)) for view in views], float)
    cost, least = rng.uniform(1, 3, 30), 4.0
    chosen, added = covering_views(shown, is_wanted, views, most + rng.uniform(0, 3, 30), cost, least)
    left = is_wanted.copy()
    for view, gain in zip(chosen, added, strict=True):
        counts = np.array([len(shown(one, left)) for one in views])
        value = np.where(counts >= least, counts / cost, 0.0)
        assert gain == len(shown(view, left))
        assert gain / cost[np.argmin(np.abs(views - view).sum(axis=1))] == pytest.approx(value.max())
        cells = shown(view, left)
        left[cells[:, 0], cells[:, 1]] = False
    assert len(chosen) == VIEWS or max(len(shown(one, left)) for one in views) < least


def test_a_given_view_comes_first_and_no_view_is_none() -> None:
    is_wanted = np.ones((10, 10), bool)
    first = np.array([2.0, 2.0, 1.0])
    views = np.array([[7.0, 7.0, 3.0]])
    chosen, added = covering_views(shown, is_wanted, views, np.array([40.0]), np.ones(1), 1.0, first)
    np.testing.assert_array_equal(chosen[0], first)
    assert added[0] == 5
    assert len(chosen) == 2
    chosen, added = covering_views(shown, is_wanted, np.zeros((0, 3)), np.zeros(0), np.zeros(0), 1.0)
    assert chosen.shape == (0, 3)
    assert added.shape == (0,)
