"""Graphs without some keyframes: the same motions and covariances between those that are left."""

from __future__ import annotations

import numpy as np
import pytest
from graphs import ANCHOR, LOOP_SIGMAS, drive, measured, odometry, true_loops
from numpy.testing import assert_allclose

from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.graph import Prior, RelativePose
from wheelsight.slam.maps.rebuilding import composed, inverse, without
from wheelsight.slam.solvers import OwnPoseGraph

T = drive(laps=2, side=4)
NONE = 0.0 * LOOP_SIGMAS


def edge(first: int, second: int, sigma: float = 0.01, *, is_loop: bool = False) -> RelativePose:
    T_first_second = se3.invert(T[first]) @ T[second]
    return RelativePose(KeyframeId(first), KeyframeId(second), T_first_second, sigma**2 * np.eye(6), is_loop)


def ends(edges: tuple[RelativePose, ...]) -> list[tuple[int, int]]:
    return [(one.first, one.second) for one in edges]


def marginal(edges: list[RelativePose], numbers: list[int], last: int) -> np.ndarray:
    """Of a keyframe, where the first is held."""
    graph, at = OwnPoseGraph(), {number: KeyframeId(k) for k, number in enumerate(numbers)}
    for number in numbers:
        graph.add(T[number])
    graph.add_prior(Prior(KeyframeId(0), T[numbers[0]], ANCHOR))
    moved = [RelativePose(at[e.first], at[e.second], e.T_first_second, e.covariance, e.is_loop) for e in edges]
    graph.add_edges(moved)
    graph.optimise()
    C = graph.marginal(at[KeyframeId(last)])
    assert C is not None
    return C


def test_an_edge_seen_from_the_other_end_is_the_same_when_turned_twice() -> None:
    rng = np.random.default_rng(1)
    one = measured(rng, T, 3, 9, LOOP_SIGMAS, is_loop=True)
    back = inverse(one)
    assert (back.first, back.second, back.is_loop) == (9, 3, True)
    assert_allclose(back.T_first_second @ one.T_first_second, np.eye(4), atol=1e-12)
    assert_allclose(inverse(back).covariance, one.covariance, rtol=1e-9, atol=1e-15)


def test_a_composed_edge_is_as_uncertain_as_draws_of_both_say() -> None:
    rng = np.random.default_rng(2)
    first, second = edge(0, 5, 0.02), inverse(edge(9, 5, 0.03))
    both = composed(first, second)
    draws = [
        se3.exp(rng.normal(0, 0.02, (20_000, 6))) @ first.T_first_second,
        se3.exp(rng.multivariate_normal(np.zeros(6), second.covariance, 20_000)) @ second.T_first_second,
    ]
    errors = se3.log(draws[0] @ draws[1] @ se3.invert(both.T_first_second))
    assert_allclose(both.T_first_second, se3.invert(T[0]) @ T[9], atol=1e-12)
    assert_allclose(np.cov(errors.T), both.covariance, atol=0.04 * np.abs(both.covariance).max())


def test_a_chain_without_its_middle_leaves_its_end_as_uncertain() -> None:
    chain = odometry(np.random.default_rng(3), T[:6])
    left = without(chain, [2, 3])
    assert {tuple(sorted(pair)) for pair in ends(left)} == {(0, 1), (4, 5), (1, 4)}
    numbers = [0, 1, 4, 5]
    assert_allclose(marginal(list(left), numbers, 5), marginal(chain, list(range(6)), 5), rtol=0.02, atol=1e-8)


def test_a_loop_of_one_that_is_left_out_is_carried_to_its_neighbour() -> None:
    chain = [edge(0, 1), edge(1, 2, 0.005), edge(2, 3), edge(0, 2, 0.05, is_loop=True)]
    left = without(chain, [2])
    # Over to 1, the end of its surest edge, where odometry from 0 on is surer than the loop: it goes.
    assert ends(left) == [(0, 1), (1, 3)]
    far = [*chain[:3], edge(3, 4), edge(2, 9, 0.05, is_loop=True)]
    carried = without(far, [2])
    assert ends(carried) == [(0, 1), (3, 4), (1, 3), (1, 9)]
    assert [one.is_loop for one in carried] == [False, False, False, True]
    assert_allclose(carried[-1].T_first_second, se3.invert(T[1]) @ T[9], atol=1e-12)


def test_odometry_carries_before_a_loop_that_is_surer() -> None:
    left = without([edge(0, 1, 0.02), edge(1, 2, 0.02), edge(1, 9, 0.001, is_loop=True)], [1])
    assert not left[0].is_loop
    assert {tuple(sorted(pair)) for pair in ends(left)} == {(0, 2), (0, 9)}


def test_what_is_carried_twice_to_the_same_place_counts_once() -> None:
    """Both loops lead to 9 from keyframes that are left out, and are carried to 0: the surer one stays."""
    graph = [edge(0, 1), edge(0, 2), edge(1, 9, 0.04, is_loop=True), edge(2, 9, 0.03, is_loop=True)]
    for order in ([1, 2], [2, 1]):
        (loop,) = without(graph, order)
        assert (loop.first, loop.second, loop.is_loop) == (0, 9, True)
        assert_allclose(loop.covariance, composed(graph[1], graph[3]).covariance)


@pytest.mark.parametrize("seed", range(5))
def test_what_hung_together_does_so_still_and_lies_where_it_lay(seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = [edge(k, k + 1) for k in range(len(T) - 1)]
    graph += [edge(one.first, one.second, 0.03, is_loop=True) for one in true_loops(rng, T, 6)]
    gone = rng.choice(np.arange(1, len(T)), 20, replace=False).tolist()
    left = without(graph, gone)
    reached, stays = {0}, set(range(len(T))) - set(gone)
    for _ in stays:
        reached |= {end for pair in ends(left) if reached & set(pair) for end in pair}
    assert reached == stays
    for one in left:
        assert_allclose(one.T_first_second, se3.invert(T[one.first]) @ T[one.second], atol=1e-9)


def test_a_keyframe_without_edges_leaves_nothing() -> None:
    assert without([edge(0, 1)], [5, 0, 1]) == ()
