"""Keyframes that show a place again give loops; those of just now do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from places.seen_room import EXACT, kept, ring, seen

from wheelsight.core.errors import MapError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.slam import place_recognition
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.place_recognition import PlaceWatcher

# Half round the room and the same way again, some centimetres aside; a keyframe a second.
WAY = [T for lap in (0.0, 0.06) for T in (pose @ se3.exp([lap, 0, 0, 0, 0, 0]) for pose in ring(16)[:8])]


@pytest.fixture(scope="module")
def store() -> KeyframeStore:
    """Where keyframes are said to be plays no part: all are said to be at the origin."""
    made = KeyframeStore()
    for second, T in enumerate(WAY):
        made.add(replace(kept(seen(T)), stamp_s=float(second)), np.eye(4))
    return made


@pytest.fixture(scope="module")
def watcher(store: KeyframeStore) -> PlaceWatcher:
    return PlaceWatcher(store, EXACT, 5.0)


@pytest.fixture(scope="module")
def loops(store: KeyframeStore, watcher: PlaceWatcher) -> list[RelativePose]:
    return [loop for number in store for loop in watcher.find_loops(number)]


def error(loop: RelativePose) -> FloatArray:
    """As a left perturbation."""
    truth = se3.invert(WAY[loop.first]) @ WAY[loop.second]
    return se3.log(loop.T_first_second @ se3.invert(truth))


def test_each_place_of_the_second_lap_is_found_where_it_is(loops: list[RelativePose]) -> None:
    assert {loop.second for loop in loops} >= {9, 10, 11, 12, 13, 14}
    for loop in loops:
        off = error(loop)
        assert np.linalg.norm(off[:3]) < 0.03
        assert off @ np.linalg.solve(loop.covariance, off) < 30
        assert loop.is_loop


def test_what_was_seen_just_now_is_no_loop(loops: list[RelativePose]) -> None:
    assert min(loop.second - loop.first for loop in loops) >= 5


def test_candidates_are_counted_that_were_refused(loops: list[RelativePose], watcher: PlaceWatcher) -> None:
    assert loops
    assert sum(watcher.refusals.values()) > 0


def test_who_is_passed_by_is_found_later(store: KeyframeStore) -> None:
    watcher = PlaceWatcher(store, EXACT, 5.0)
    for number in list(store)[:10]:
        watcher.add(number)
    assert any(watcher.find_loops(number) for number in list(store)[10:])


def test_a_keyframe_that_cannot_be_read_is_reported_and_passed_over(store: KeyframeStore) -> None:
    """Its disk is gone; others show the place all the same."""

    def fail() -> Keyframe:
        raise MapError("the disk is gone")

    lame = KeyframeStore()
    lame.limit_memory(5)
    watcher, loops = PlaceWatcher(lame, EXACT, 5.0), list[RelativePose]()
    for number in store:
        loops += watcher.find_loops(lame.add(store[number], np.eye(4)))
        if number == 4:
            lame.keep_on_disk(number, fail)
    assert watcher.refusals["the keyframe cannot be read"] > 0
    assert loops
    assert 4 not in {loop.first for loop in loops}


def test_a_piece_that_is_not_joined_asks_more_of_the_rest_and_then_of_itself(
    store: KeyframeStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The nearest view is unjoined, too: it must not take the place of one that shows where in the map that is."""
    for name, value in (("_CANDIDATES", 1), ("_NEAR_CANDIDATES", 0), ("_CANDIDATES_UNJOINED", 4)):
        monkeypatch.setattr(place_recognition, name, value)
    asked = {}
    for unjoined in ((), (KeyframeId(1), KeyframeId(3))):
        watcher = PlaceWatcher(store, EXACT, 0.5)
        for number in list(store)[:9]:
            watcher.add(number)
        asked[unjoined] = [loop.first for loop in watcher.find_loops(KeyframeId(9), unjoined=unjoined)]
    assert asked[()] == [1]
    *others, last = asked[KeyframeId(1), KeyframeId(3)]
    assert last == 1
    assert others
    assert not {1, 3} & set(others)
