"""KeyframeStore: one table of poses, which all that hangs on keyframes follows."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from threading import Event, current_thread

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore

INTRINSICS = np.array([10.0, 10.0, 3.5, 2.5])


def keyframe(stamp_s: float = 0.0) -> Keyframe:
    return Keyframe.of_images(stamp_s, INTRINSICS, np.ones((6, 8), np.float32), np.full((6, 8), 7, np.float32))


def poses(count: int, seed: int) -> np.ndarray:
    return se3.exp(np.random.default_rng(seed).normal(size=(count, 6)))


def test_images_are_kept_to_a_fraction_of_a_millimetre() -> None:
    rng = np.random.default_rng(1)
    depth_m, grey = rng.uniform(0.3, 10, (48, 64)).astype(np.float32), rng.uniform(0, 255, (48, 64)).astype(np.float32)
    depth_m[3, 4], grey[5, 6] = 0, -1
    kept = Keyframe.of_images(1.5, INTRINSICS, depth_m, grey)
    assert np.abs(kept.depth_m - depth_m).max() < 1.01e-4
    assert np.abs(kept.grey - np.maximum(grey, 0)).max() <= 0.501
    assert (kept.depth_m[3, 4], kept.grey[5, 6]) == (0, 0)
    assert len(kept.depth_png) + len(kept.grey_png) < depth_m.nbytes + grey.nbytes


def test_a_keyframe_is_known_by_its_number_and_where_it_is_by_the_store() -> None:
    store, T = KeyframeStore(), poses(40, 2)
    numbers = [store.add(keyframe(k), T[k]) for k in range(40)]
    assert numbers == list(store) == list(range(40))
    assert [store[number].stamp_s for number in numbers] == list(range(40))
    np.testing.assert_array_equal(store.T_map_keyframe, T)
    assert store.revision == 0
    with pytest.raises(ValueError, match="read-only"):
        store.T_map_keyframe[0] = np.eye(4)


def test_a_keyframe_is_made_in_a_thread_while_the_store_goes_on() -> None:
    store, may_go_on, threads = KeyframeStore(), Event(), []

    def made() -> Keyframe:
        threads.append(current_thread())
        assert may_go_on.wait(30)
        return keyframe(7)

    number = store.add(made, np.eye(4))
    store.move([number], poses(1, 2))
    may_go_on.set()
    assert store[number].stamp_s == 7
    assert store[number] is store[number]
    assert threads[0] is not current_thread()
    store.close()
    assert not threads[0].is_alive()


def test_keyframes_that_threads_made_are_those_that_were_handed_in() -> None:
    here, meanwhile = KeyframeStore(), KeyframeStore()
    rng = np.random.default_rng(3)
    for k in range(20):
        images = rng.uniform(0.3, 10, (48, 64)).astype(np.float32), rng.uniform(0, 255, (48, 64)).astype(np.float32)
        make = partial(Keyframe.of_images, float(k), INTRINSICS, *images)
        here.add(make(), np.eye(4))
        meanwhile.add(make, np.eye(4))
    meanwhile.replace(KeyframeId(3), partial(keyframe, 3.5))
    here.replace(KeyframeId(3), keyframe(3.5))
    meanwhile.close()
    for number in here:
        one, other = here[number], meanwhile[number]
        assert (one.stamp_s, one.depth_png, one.grey_png) == (other.stamp_s, other.depth_png, other.grey_png)


def test_a_closed_store_is_read_and_takes_more() -> None:
    store = KeyframeStore()
    store.close()
    first = store.add(partial(keyframe, 1.0), np.eye(4))
    store.close()
    second = store.add(partial(keyframe, 2.0), np.eye(4))
    store.close()
    assert [store[number].stamp_s for number in (first, second)] == [1.0, 2.0]


def failing() -> Keyframe:
    raise MemoryError("no room for a keyframe")


@pytest.mark.parametrize(
    "then",
    [
        lambda store: store.add(keyframe, np.eye(4)),
        lambda store: store.replace(KeyframeId(0), keyframe),
        lambda store: store.close(),
        lambda store: store[KeyframeId(1)],
    ],
    ids=["add", "replace", "close", "get"],
)
def test_an_error_in_making_one_is_raised_where_the_store_is_used_next(then: Callable[[KeyframeStore], object]) -> None:
    store = KeyframeStore()
    store.add(keyframe, np.eye(4))
    store.add(failing, np.eye(4))
    with pytest.raises(MemoryError, match="no room for a keyframe"):
        then(store)
    assert len(store) == 2
    with suppress(MemoryError):
        store.close()


def test_an_error_that_was_raised_once_does_not_stop_what_comes_later() -> None:
    store = KeyframeStore()
    store.add(failing, np.eye(4))
    with pytest.raises(MemoryError):
        store.close()
    number = store.add(keyframe, np.eye(4))
    store.close()
    assert store[number].stamp_s == 0.0


def test_what_follows_is_reported_how_keyframes_moved_since_it_asked() -> None:
    store = KeyframeStore()
    follower = store.follow()
    T, after, last = poses(3, 3), poses(3, 4), poses(1, 5)
    a, b = store.add(keyframe(), T[0]), store.add(keyframe(), T[1])
    assert follower.moves() is None
    store.move([b], after[1:2])
    c = store.add(keyframe(), T[2])
    store.move([c, b], np.stack([after[2], last[0]]))
    moves = follower.moves()
    assert moves is not None
    assert store.revision == 2
    np.testing.assert_array_equal(moves[a], np.eye(4))
    np.testing.assert_allclose(moves[b] @ T[1], last[0], atol=1e-12)
    np.testing.assert_allclose(moves[c] @ T[2], after[2], atol=1e-12)
    assert follower.moves() is None


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 20), st.integers(0, 10_000))
def test_a_point_that_follows_stays_where_it_is_relative_to_its_keyframe(count: int, seed: int) -> None:
    rng, store = np.random.default_rng(seed), KeyframeStore()
    T = poses(count, seed)
    for pose in T:
        store.add(keyframe(), pose)
    of, points = rng.integers(0, count, 50), rng.normal(size=(50, 3))
    follower = store.follow()
    p_map = se3.apply(store.T_map_keyframe[of], points[:, None])[:, 0]
    for step in range(3):
        moved = rng.permutation(count)[: 1 + count // 2]
        store.move([KeyframeId(int(k)) for k in moved], poses(len(moved), seed + step + 1))
    moves = follower.moves()
    assert moves is not None
    p_map = se3.apply(moves[of], p_map[:, None])[:, 0]
    np.testing.assert_allclose(p_map, se3.apply(store.T_map_keyframe[of], points[:, None])[:, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("numbers", "T", "says"),
    [
        ([5], np.eye(4)[None], "there is no keyframe 5"),
        ([-1], np.eye(4)[None], "there is no keyframe -1"),
        ([0, 0], np.tile(np.eye(4), (2, 1, 1)), "each keyframe once"),
        ([0], np.tile(np.eye(4), (2, 1, 1)), "1 keyframes and 2 poses"),
        ([0], np.full((1, 4, 4), np.nan), "not finite"),
    ],
)
def test_moves_that_are_none_are_refused(numbers: list[KeyframeId], T: np.ndarray, says: str) -> None:
    store = KeyframeStore()
    store.add(keyframe(), np.eye(4))
    with pytest.raises(ArgumentError, match=says):
        store.move(numbers, T)
    assert store.revision == 0


def test_better_images_take_a_keyframe_s_place_and_move_nothing() -> None:
    store, better = KeyframeStore(), keyframe()
    numbers = [store.add(keyframe(), pose) for pose in poses(2, 3)]
    before, follower = store.T_map_keyframe.copy(), store.follow()
    store.replace(numbers[1], better)
    assert store[numbers[1]] is better
    assert store[numbers[0]] is not better
    np.testing.assert_array_equal(store.T_map_keyframe, before)
    assert (store.revision, follower.moves()) == (0, None)
    with pytest.raises(ArgumentError, match="there is no keyframe 2"):
        store.replace(KeyframeId(2), better)


def test_a_keyframe_that_rests_is_read_again_and_those_asked_for_last_are_held() -> None:
    store, reads = KeyframeStore(), list[int]()

    def reader(number: int):
        def read() -> Keyframe:
            reads.append(number)
            return keyframe(100.0 + number)

        return read

    store.limit_memory(2)
    for number in range(7):
        store.add(keyframe(float(number)), np.eye(4))
        store.keep_on_disk(KeyframeId(number), reader(number))
    # Given up once twice as many newer ones follow.
    assert [store[number].stamp_s for number in store] == [100.0, 101.0, 102.0, 3.0, 4.0, 5.0, 6.0]
    assert reads == [0, 1, 2]
    assert store[KeyframeId(1)].stamp_s == 101.0  # still at hand
    assert store[KeyframeId(0)].stamp_s == 100.0
    assert reads == [0, 1, 2, 0]


def test_what_is_recalled_goes_by_numbers_alone() -> None:
    """However far on another thread has driven by then."""
    store = KeyframeStore()
    store.limit_memory(3)
    recalled: list[list[float]] = []
    for newest in range(8):
        store.add(keyframe(float(newest)), np.eye(4))
        store.keep_on_disk(KeyframeId(newest), lambda: keyframe(-1.0))
        for asked in range(max(0, newest - 2), newest + 1):  # a thread that lags, or does not
            reported = [store.as_of(KeyframeId(k), KeyframeId(asked)).stamp_s for k in range(asked + 1)]
            assert reported == [-1.0] * max(asked - 2, 0) + list(map(float, range(max(asked - 2, 0), asked + 1)))
            recalled.append(reported)
    assert recalled


def test_nothing_rests_unless_somebody_says() -> None:
    store, kept = KeyframeStore(), keyframe()
    for _ in range(5):
        store.add(kept, np.eye(4))
    assert store.as_of(KeyframeId(0), KeyframeId(4)) is kept
    store.limit_memory(1)
    assert store.as_of(KeyframeId(0), KeyframeId(4)) is kept  # no one has written it
    with pytest.raises(ArgumentError):
        store.as_of(KeyframeId(5), KeyframeId(6))
