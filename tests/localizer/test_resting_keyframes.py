"""Keyframes of a drive that writes no map rest in a temporary file, and come back as they were."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

from wheelsight.core.errors import MapError
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures, KeyframeId, KeyframeStore
from wheelsight.estimation.localizer import RestingKeyframes

MOST, COUNT = 4, 20


def keyframe(number: int) -> Keyframe:
    rng = np.random.default_rng(number)
    depth_m, grey = (rng.uniform(0, most, (24, 32)).astype(np.float32) for most in (5, 255))
    if number % 3 == 0:
        return Keyframe.of_images(0.1 * number, np.array([30.0, 30.0, 16.0, 12.0]), depth_m, grey)
    keypoints = rng.normal(size=(number, 2)), rng.normal(size=(number, 3))
    features = KeyframeFeatures(*keypoints, rng.integers(0, 2**63, (number, 4)).astype(np.uint64))
    return Keyframe.of_images(0.1 * number, np.array([30.0, 30.0, 16.0, 12.0]), depth_m, grey, features)


def driven(store: KeyframeStore, resting: RestingKeyframes, begin: int = 0) -> list[Keyframe]:
    made = [keyframe(number) for number in range(begin, begin + COUNT)]
    for one in made:
        store.add(one, np.eye(4))
        resting.look()
    return made


def assert_same(found: Keyframe, made: Keyframe) -> None:
    assert (found.stamp_s, found.depth_png, found.grey_png) == (made.stamp_s, made.depth_png, made.grey_png)
    np.testing.assert_array_equal(found.intrinsics, made.intrinsics)
    assert found.code is None
    assert (found.features is None) == (made.features is None)
    if found.features is not None and made.features is not None:
        for name in ("px", "points", "descriptors"):
            np.testing.assert_array_equal(getattr(found.features, name), getattr(made.features, name))


def in_memory(store: KeyframeStore, made: list[Keyframe]) -> list[int]:
    """Numbers of those that are still the ones that were added."""
    return [number for number in store if store[number] is made[number]]


def test_old_keyframes_leave_memory_and_come_back_to_the_last_bit(tmp_path: Path) -> None:
    store = KeyframeStore()
    made = driven(store, RestingKeyframes(store, MOST, tmp_path))
    # Given up once twice as many newer ones follow.
    assert in_memory(store, made) == list(range(COUNT - 2 * MOST, COUNT))
    for number in range(COUNT):
        assert_same(store[KeyframeId(number)], keyframe(number))
        assert_same(store.as_of(KeyframeId(number), KeyframeId(COUNT - 1)), keyframe(number))
    assert not list(tmp_path.iterdir())


def test_a_drive_that_writes_a_map_leaves_it_to_the_writer(tmp_path: Path) -> None:
    store = KeyframeStore()
    store.is_written = True
    made = driven(store, RestingKeyframes(store, MOST, tmp_path))
    assert in_memory(store, made) == list(range(COUNT))


def test_keyframes_that_were_there_before_are_left_where_they_are(tmp_path: Path) -> None:
    store = KeyframeStore()
    before = [keyframe(number) for number in range(COUNT)]
    for one in before:
        store.add(one, np.eye(4))
    made = driven(store, RestingKeyframes(store, MOST, tmp_path), COUNT)
    assert in_memory(store, before + made) == [*range(COUNT), *range(2 * COUNT - 2 * MOST, 2 * COUNT)]


def test_without_a_disk_all_stay(tmp_path: Path) -> None:
    store = KeyframeStore()
    made = driven(store, RestingKeyframes(store, MOST, tmp_path / "missing"))
    assert in_memory(store, made) == list(range(COUNT))
    assert_same(store[KeyframeId(0)], keyframe(0))


def test_a_file_that_was_cut_off_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tempfile.TemporaryFile(dir=tmp_path)  # noqa: SIM115 - who rests in it closes it
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: file)
    store = KeyframeStore()
    driven(store, RestingKeyframes(store, MOST, tmp_path))
    file.truncate(10)
    with pytest.raises(MapError, match="cut off"):
        store[KeyframeId(0)]
