"""Cost-to-go against csgraph's Dijkstra, closed forms and plain Python."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from odometry.plain_kernels import plain
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from wheelsight.core.errors import ArgumentError
from wheelsight.navigation import cost_to_go
from wheelsight.navigation import planner_kernels as kernels


def some_costs(seed: int, rows: int, columns: int, blocked: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    costs = (1 + rng.exponential(1.0, (rows, columns))).astype(np.float32)
    costs[rng.random(costs.shape) < 0.3] = 1.0
    costs[rng.random(costs.shape) < blocked] = np.inf
    return costs


def by_csgraph(costs: np.ndarray, size_m: float, goal: tuple[int, int]) -> np.ndarray:
    """Step by step, in plain Python."""
    rows, columns = costs.shape
    begin, end, paid = [], [], []
    for i in range(rows):
        for j in range(columns):
            for di, dj in ((0, 1), (1, 0), (1, 1), (1, -1)):
                a, b = i + di, j + dj
                if not (a < rows and 0 <= b < columns):
                    continue
                if np.isfinite([costs[i, j], costs[a, b], costs[i, b], costs[a, j]]).all():
                    begin.append(i * columns + j)
                    end.append(a * columns + b)
                    paid.append(size_m * np.hypot(di, dj) * 0.5 * (float(costs[i, j]) + float(costs[a, b])))
    graph = coo_matrix((paid, (begin, end)), shape=(rows * columns,) * 2).tocsr()
    found = dijkstra(graph, directed=False, indices=goal[0] * columns + goal[1]).reshape(rows, columns)
    return np.where(np.isfinite(costs[goal]), found, np.inf)


@given(st.integers(0, 10**6), st.integers(2, 14), st.integers(2, 14), st.sampled_from([0.0, 0.2, 0.45]))
def test_costs_are_those_of_csgraph(seed: int, rows: int, columns: int, blocked: float) -> None:
    costs = some_costs(seed, rows, columns, blocked)
    goal = (seed % rows, seed % columns)
    np.testing.assert_allclose(cost_to_go(costs, 0.05, goal), by_csgraph(costs, 0.05, goal), rtol=1e-6)


def test_on_a_free_floor_it_is_the_octile_distance() -> None:
    found = cost_to_go(np.ones((40, 70), np.float32), 0.1, (7, 50))
    rows, columns = np.abs(np.arange(40) - 7)[:, None], np.abs(np.arange(70) - 50)
    octile = np.maximum(rows, columns) + (np.sqrt(2) - 1) * np.minimum(rows, columns)
    np.testing.assert_allclose(found, 0.1 * octile, rtol=1e-6, atol=1e-12)


def test_no_way_leads_through_a_closed_wall_or_past_corners_that_touch() -> None:
    costs = np.ones((20, 20), np.float32)
    costs[10] = np.inf
    assert np.isinf(cost_to_go(costs, 1.0, (3, 3))[10:]).all()
    diagonal = np.ones((20, 20), np.float32)
    np.fill_diagonal(diagonal, np.inf)
    found = cost_to_go(diagonal, 1.0, (0, 5))
    assert np.isinf(found[np.tril_indices(20)]).all()
    assert np.isfinite(found[np.triu_indices(20, 1)]).all()


def test_compiled_and_plain_kernels_say_the_same() -> None:
    costs, goals = some_costs(4, 30, 25, 0.25), np.array([[3, 4], [20, 20]])
    costs[3, 4] = costs[20, 20] = 1
    results = []
    for module in (kernels, plain(kernels)):
        known = module.cost_to_go_kernel(costs, 0.1, goals, np.array([0.0, 0.7]))
        row, column = np.argwhere(np.isfinite(known))[-1].tolist()
        results.append((known, module.descend(known, costs, 0.1, row, column)))
    (known, way), (plain_known, plain_way) = results
    np.testing.assert_allclose(known, plain_known, rtol=1e-6)
    np.testing.assert_array_equal(way, plain_way)


@given(st.integers(0, 10**6))
def test_the_way_down_costs_what_was_said_and_goes_from_neighbour_to_neighbour(seed: int) -> None:
    costs = some_costs(seed, 15, 18, 0.2)
    costs[2, 3] = 1
    known = cost_to_go(costs, 0.1, (2, 3))
    row, column = np.argwhere(np.isfinite(known))[seed % np.count_nonzero(np.isfinite(known))].tolist()
    way = kernels.descend(known, costs, 0.1, row, column)
    assert way[0].tolist() == [row, column]
    assert way[-1].tolist() == [2, 3]
    steps = np.abs(np.diff(way, axis=0))
    assert steps.max(initial=0) <= 1
    values = costs[way[:, 0], way[:, 1]].astype(float)
    paid = float((0.1 * np.hypot(*steps.T) * 0.5 * (values[1:] + values[:-1])).sum()) if len(way) > 1 else 0.0
    assert paid == pytest.approx(known[row, column], rel=1e-6)


@pytest.mark.parametrize(
    ("costs", "goal"),
    [
        (np.ones((4, 4), np.float32), (4, 0)),
        (np.ones((4, 4), np.float32), (0, -1)),
        (np.full((4, 4), 0.5, np.float32), (0, 0)),
        (np.full((4, 4), np.nan, np.float32), (0, 0)),
    ],
)
def test_what_is_no_question_is_refused(costs: np.ndarray, goal: tuple[int, int]) -> None:
    with pytest.raises(ArgumentError):
        cost_to_go(costs, 0.1, goal)
