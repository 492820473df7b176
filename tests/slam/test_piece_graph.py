"""Two pieces of a map are joined where loops seen from apart agree, and not by few against others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.drive_graph import SubmapGraph
from wheelsight.slam.graph import RelativePose, anchor

COUNT, STEP_M = 5, 0.4
C = 1e-4 * np.eye(6)
# Where the second piece truly lies, and where it is thought to be.
APART = se3.exp([3.0, -1.0, 0.2, 0.0, 0.1, 0.7])


def at(number: int) -> FloatArray:
    """Where a keyframe truly is; both pieces go along x, side by side."""
    return se3.exp([STEP_M * (number % COUNT), 0.5 * (number // COUNT), 0.0, 0.0, 0.0, 0.05 * number])


def graph() -> SubmapGraph:
    made = SubmapGraph()
    for number in range(2 * COUNT):
        piece = COUNT * (number // COUNT)
        T = at(number) if not piece else APART @ at(number)
        made.add_pose(T, piece)
        if number % COUNT == 0:
            made.add_prior(anchor(KeyframeId(number), T), until_joined=bool(piece))
        else:
            before = KeyframeId(number - 1)
            step = se3.invert(at(number - 1)) @ at(number)
            made.add_edges([RelativePose(before, KeyframeId(number), step, C)])
    return made


def loop(first: int, second: int, off: FloatArray | None = None) -> RelativePose:
    T = se3.invert(at(first)) @ at(second) @ (np.eye(4) if off is None else off)
    return RelativePose(KeyframeId(first), KeyframeId(second), T, C, is_loop=True)


def wrong(seed: int) -> FloatArray:
    return se3.exp(np.random.default_rng(seed).uniform(1.0, 3.0, 6))


def test_two_loops_seen_from_apart_join() -> None:
    made = graph()
    assert not made.offer([loop(0, 5)])
    assert made.offer([loop(2, 7)])
    assert set(made.submaps.tolist()) == {0}
    np.testing.assert_allclose(made.poses, [at(number) for number in range(2 * COUNT)], atol=1e-5)


def test_one_view_does_not_bear_out_the_next_beside_it() -> None:
    made = graph()
    assert not made.offer([loop(0, 5), loop(1, 5), loop(1, 6)])  # 0.4 m apart
    assert made.offer([loop(2, 8)])


def test_loops_that_guess_along_a_corridor_bear_nothing_out() -> None:
    """Both take one stretch for the next, two metres on, and each says that it does not know."""
    made = graph()
    on = se3.exp([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    unsure = np.diag([100.0, *np.diag(C)[1:]])
    guesses = [replace(loop(*ends, on), covariance=unsure) for ends in ((0, 5), (2, 7), (4, 9))]
    assert not made.offer(guesses)
    assert made.offer([loop(0, 5), loop(2, 7)])
    np.testing.assert_allclose(made.poses, [at(number) for number in range(2 * COUNT)], atol=1e-5)


@pytest.mark.parametrize("against", [1, 2])
def test_few_do_not_join_against_others(against: int) -> None:
    made = graph()
    false = [loop(number, 9, wrong(number)) for number in range(against)]
    assert made.offer([*false, loop(0, 5), loop(2, 7)]) == (against == 1)
    if against > 1:
        assert made.offer([loop(1, 6), loop(3, 8)])
    np.testing.assert_allclose(made.poses, [at(number) for number in range(2 * COUNT)], atol=1e-5)
