"""A drive that was laid into a known map by false loops is laid again once more of the map says so, and not before."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.drive_graph import SubmapGraph
from wheelsight.slam.graph import RelativePose, anchor

COUNT, STEP_M = 30, 0.4
C = 1e-4 * np.eye(6)
# Loops that agree with each other and are wrong: half a metre aside, and turned, as of a table that was moved.
MOVED = se3.exp([0.1, 0.5, 0.0, 0.0, 0.0, 0.1])


def at(number: int) -> FloatArray:
    """Where a keyframe truly is: the drive follows the way of the map, a little aside."""
    along, is_second = number % COUNT, number >= COUNT
    return se3.exp([STEP_M * along, 0.1 * is_second, 0.0, 0.0, 0.0, 0.02 * along])


def known_map() -> SubmapGraph:
    """Keyframes of yesterday, each held, and those of a drive that no one has laid into them yet."""
    made = SubmapGraph()
    for number in range(2 * COUNT):
        is_new = number >= COUNT
        T = se3.exp([0.0, 9.0, 0.0, 0.0, 0.0, 1.0]) @ at(number) if is_new else at(number)
        made.add_pose(T, COUNT if is_new else 0)
        if number <= COUNT:
            made.add_prior(anchor(KeyframeId(number), T), until_joined=is_new)
        else:
            step = se3.invert(at(number - 1)) @ at(number)
            made.add_edges([RelativePose(KeyframeId(number - 1), KeyframeId(number), step, C)])
    return made


def loop(along: int, off: FloatArray | None = None) -> RelativePose:
    """The drive's keyframe, seen from that of the map beside it."""
    T = se3.invert(at(along)) @ (np.eye(4) if off is None else off) @ at(COUNT + along)
    return RelativePose(KeyframeId(along), KeyframeId(COUNT + along), T, C, is_loop=True)


def seen(made: SubmapGraph, along: range, off: FloatArray | None = None) -> None:
    for number in along:
        made.offer([loop(number, off)])


def off_m(made: SubmapGraph) -> float:
    true = np.array([at(COUNT + number) for number in range(COUNT)])
    return float(np.linalg.norm(made.poses[COUNT:, :3, 3] - true[:, :3, 3], axis=-1).max())


def test_a_false_start_is_given_up_for_what_more_of_the_map_says() -> None:
    made = known_map()
    seen(made, range(2, 6), MOVED)
    assert set(made.submaps.tolist()) == {0}
    assert off_m(made) > 0.4
    seen(made, range(8, 28))
    assert made.report().overturned == 1
    assert off_m(made) < 0.02
    assert sum(not one.is_kept for one in made.report().decisions) == 4


@pytest.mark.parametrize("count", [3, 10])
def test_a_right_start_is_kept_against_one_thing_that_was_moved(count: int) -> None:
    made = known_map()
    seen(made, range(2, 20))
    false = [loop(20 + number % 4, MOVED) for number in range(count)]
    made.offer(false)
    made.review()
    assert made.report().overturned == 0
    assert off_m(made) < 0.02
    assert sum(not one.is_kept for one in made.report().decisions) == count


def test_equal_voices_change_nothing() -> None:
    made = known_map()
    seen(made, range(2, 10))
    seen(made, range(12, 20), MOVED)
    made.review()
    assert made.report().overturned == 0
    assert off_m(made) < 0.02
