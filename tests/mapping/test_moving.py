"""Surfels move with the keyframes that they hang on, and with the whole map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mapping.scenes import FRAME_S, GRID, SHAPE, Wall, fuse, kept_keyframes, pose, see
from numpy.testing import assert_allclose, assert_array_equal

from wheelsight.core.errors import MapError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.mapping import SurfelMap, Surfels, SurfelSettings, load_map, save_map

FIRST, SECOND = KeyframeId(0), KeyframeId(1)
APART_M = 8.0


@pytest.fixture
def store() -> KeyframeStore:
    return kept_keyframes(2)


@pytest.fixture
def surfel_map(store: KeyframeStore, rng: np.random.Generator) -> SurfelMap:
    """Two walls, out of sight of each other: one hangs on the first keyframe, the other on the second."""
    made = SurfelMap(SurfelSettings(stable_confidence=3.0), store)
    for k in range(8):
        near, far = pose(0.01 * k), pose(APART_M + 0.01 * k)
        fuse(made, see([Wall(2.0, slope=0.2)], near, rng), near, 2 * k * FRAME_S, 0)
        fuse(made, see([Wall(2.5)], far, rng), far, (2 * k + 1) * FRAME_S, 1)
    assert set(made.surfels().keyframe) == {0, 1}
    return made


def of_keyframe(surfels: Surfels, keyframe: int) -> Surfels:
    """In an order that motions keep: by what they look like."""
    chosen = np.flatnonzero(surfels.keyframe == keyframe)
    order = chosen[np.lexsort([surfels.radius_m[chosen], surfels.grey[chosen], *surfels.color[chosen].T])]
    return Surfels(*(getattr(surfels, name)[order] for name in Surfels.__slots__))


def move(store: KeyframeStore, T_new_old: FloatArray, *keyframes: KeyframeId) -> None:
    store.move(keyframes, T_new_old @ store.T_map_keyframe[list(keyframes)])


MOTIONS = [
    pytest.param(se3.exp([0.003, -0.002, 0.001, 0.001, -0.002, 0.003]), id="by millimetres"),
    pytest.param(se3.exp([3.0, -2.0, 1.0, 0.3, -0.2, 0.5]), id="by metres"),
]


@pytest.mark.parametrize("T_new_old", MOTIONS)
def test_surfels_move_with_their_keyframe_and_no_others(
    surfel_map: SurfelMap, store: KeyframeStore, T_new_old: FloatArray
) -> None:
    before = surfel_map.surfels()
    move(store, T_new_old, SECOND)
    after = surfel_map.surfels()
    assert len(surfel_map) == len(after.grey) == len(before.grey)
    for name in Surfels.__slots__:
        assert_array_equal(getattr(of_keyframe(after, 0), name), getattr(of_keyframe(before, 0), name))
    moved, old = of_keyframe(after, 1), of_keyframe(before, 1)
    assert_allclose(moved.position, se3.apply(T_new_old, old.position), atol=2e-6)
    assert_allclose(moved.normal, old.normal @ T_new_old[:3, :3].T, atol=1e-6)
    for name in set(Surfels.__slots__) - {"position", "normal"}:
        assert_array_equal(getattr(moved, name), getattr(old, name))


@pytest.mark.parametrize("T_new_old", MOTIONS)
def test_from_the_moved_pose_the_same_is_seen(
    surfel_map: SurfelMap, store: KeyframeStore, T_new_old: FloatArray
) -> None:
    """So moved surfels are found where they are now: in other blocks of space."""
    T_map_camera, others = pose(APART_M), surfel_map.predict(pose(), GRID, SHAPE)
    before = surfel_map.predict(T_map_camera, GRID, SHAPE)
    move(store, T_new_old, SECOND)
    after = surfel_map.predict(T_new_old @ T_map_camera, GRID, SHAPE)
    assert (before.depth_m > 0).mean() > 0.95
    assert_allclose(after.depth_m, before.depth_m, atol=1e-3)
    assert np.abs(after.depth_m - before.depth_m).mean() < 1e-5
    assert np.abs(after.normal - before.normal).mean() < 1e-5
    assert np.abs(after.grey - before.grey).mean() < 1e-2
    assert_array_equal(surfel_map.predict(pose(), GRID, SHAPE).depth_m, others.depth_m)


def test_where_all_moves_rigidly_the_map_is_the_same_from_a_moved_pose(
    surfel_map: SurfelMap, store: KeyframeStore
) -> None:
    T_new_old = se3.exp([-4.0, 7.0, 0.5, 1.0, 0.5, -2.0])
    before = [surfel_map.render(T, GRID, SHAPE) for T in (pose(), pose(APART_M))]
    move(store, T_new_old, FIRST, SECOND)
    for T, expected in zip((pose(), pose(APART_M)), before, strict=True):
        view = surfel_map.render(T_new_old @ T, GRID, SHAPE)
        assert np.abs(view.depth_m - expected.depth_m).mean() < 1e-5
        assert np.abs(view.color - expected.color).mean() < 1e-2


def test_moved_surfels_are_averaged_with_what_is_seen_of_them(
    surfel_map: SurfelMap, store: KeyframeStore, rng: np.random.Generator
) -> None:
    T_new_old = se3.exp([3.0, -2.0, 1.0, 0.3, -0.2, 0.5])
    move(store, T_new_old, SECOND)
    view, size = see([Wall(2.5)], pose(APART_M), rng), len(surfel_map)
    fused = fuse(surfel_map, view, T_new_old @ pose(APART_M), 1.0, 1)
    assert fused.matched > 0.9 * view.depth_m.size
    assert fused.added < 0.02 * size


def test_where_room_runs_short_moves_take_that_of_what_has_left(rng: np.random.Generator) -> None:
    store, size = kept_keyframes(1), 2 * SHAPE[0] * SHAPE[1]
    one = SurfelMap(SurfelSettings(max_surfels=size), store)
    fuse(one, see([Wall(2.0)], pose(), rng), pose(), 0.0, 0)
    count = len(one)
    for _ in range(10):
        move(store, se3.exp([0.0, 0.0, 0.6, 0, 0, 0]), FIRST)
        assert len(one.surfels().grey) == count
    assert one.dropped == 0


def test_motions_add_up_until_the_map_is_asked_for(surfel_map: SurfelMap, store: KeyframeStore) -> None:
    before, T = of_keyframe(surfel_map.surfels(), 1), se3.exp([0.1, 0.2, -0.1, 0.1, 0.0, 0.2])
    for _ in range(3):
        move(store, T, SECOND)
    after = of_keyframe(surfel_map.surfels(), 1)
    assert_allclose(after.position, se3.apply(T @ T @ T, before.position), atol=2e-6)


def test_keyframes_added_after_a_move_have_not_moved(
    surfel_map: SurfelMap, store: KeyframeStore, rng: np.random.Generator
) -> None:
    move(store, se3.exp([0.0, 3.0, 0, 0, 0, 0]), SECOND)
    third = store.add(store[SECOND], pose(-APART_M))
    fuse(surfel_map, see([Wall(2.0)], pose(-APART_M), rng), pose(-APART_M), 1.0, third)
    surfels = of_keyframe(surfel_map.surfels(), third)
    assert len(surfels.grey) > 0.9 * SHAPE[0] * SHAPE[1]
    assert abs(np.median(surfels.position[:, 2]) - 2.0) < 5e-3
    assert np.abs(surfels.position[:, 1]).max() < 1.5


def test_a_whole_map_moves_with_its_keyframes_and_with_what_hangs_on_none(
    surfel_map: SurfelMap, store: KeyframeStore, rng: np.random.Generator
) -> None:
    fuse(surfel_map, see([Wall(2.0)], pose(-APART_M), rng), pose(-APART_M), 1.0)
    before, poses, reported = surfel_map.surfels(), store.T_map_keyframe.copy(), store.follow()
    T_new_old = se3.exp([0.3, -0.2, 0.1, 0.1, 0.2, -0.3])
    surfel_map.move(T_new_old)
    after = surfel_map.surfels()
    for keyframe in (-1, 0, 1):
        old, new = of_keyframe(before, keyframe), of_keyframe(after, keyframe)
        assert len(old.grey) > 1000
        assert_allclose(new.position, se3.apply(T_new_old, old.position), atol=3e-6)
    assert_allclose(store.T_map_keyframe, T_new_old @ poses, atol=1e-12)
    moves = reported.moves()
    assert moves is not None
    assert_allclose(moves, np.tile(T_new_old, (2, 1, 1)), atol=1e-12)


def test_a_map_from_a_file_follows_a_store_from_where_its_keyframes_were(
    surfel_map: SurfelMap, store: KeyframeStore, tmp_path: Path
) -> None:
    save_map(surfel_map, tmp_path / "a.surfels")
    surfel_map = load_map(tmp_path / "a.surfels")
    surfel_map.attach_to(store)
    T_new_old = se3.exp([3.0, -2.0, 1.0, 0.3, -0.2, 0.5])
    later = kept_keyframes(3)
    later.move([FIRST, SECOND], store.T_map_keyframe)
    move(later, T_new_old, SECOND)
    back = load_map(tmp_path / "a.surfels")
    back.attach_to(later)
    move(store, T_new_old, SECOND)
    for keyframe in (0, 1):
        expected = of_keyframe(surfel_map.surfels(), keyframe).position
        assert_allclose(of_keyframe(back.surfels(), keyframe).position, expected, atol=2e-6)
    move(later, T_new_old, FIRST)
    move(store, T_new_old, FIRST)
    assert_allclose(of_keyframe(back.surfels(), 0).position, of_keyframe(surfel_map.surfels(), 0).position, atol=2e-6)
    with pytest.raises(MapError, match="has 3 keyframes, the store 1"):
        back.attach_to(kept_keyframes(1))


def test_a_map_that_is_not_moved_is_the_same_to_the_last_bit(rng: np.random.Generator) -> None:
    made = []
    for store in (None, kept_keyframes(2)):
        surfel_map, views = SurfelMap(store=store), np.random.default_rng(3)
        for k in range(4):
            T = pose(0.02 * k)
            keyframe = None if store is None else k // 2
            fuse(surfel_map, see([Wall(2.0, slope=0.3)], T, views), T, k * FRAME_S, keyframe)
        made.append(surfel_map.surfels())
    for name in set(Surfels.__slots__) - {"keyframe"}:
        assert_array_equal(getattr(made[0], name), getattr(made[1], name))


def test_a_keyframe_that_is_not_there_is_refused(store: KeyframeStore) -> None:
    view = see([Wall(2.0)], pose())
    for surfel_map, keyframe in ((SurfelMap(store=store), 2), (SurfelMap(store=store), -1), (SurfelMap(), 0)):
        with pytest.raises(MapError, match=f"no keyframe {keyframe}"):
            fuse(surfel_map, view, pose(), 0.0, keyframe)
        assert len(surfel_map) == 0


def test_a_map_is_moved_by_rigid_motions_only(surfel_map: SurfelMap) -> None:
    with pytest.raises(MapError, match="T_new_old"):
        surfel_map.move(2 * np.eye(4))
