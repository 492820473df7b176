"""Where memory runs short, what is far from the camera rests on the disk, and comes back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mapping.scenes import GRID, SHAPE, Wall, fuse, pose, see
from numpy.testing import assert_allclose, assert_array_equal

from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.mapping import SurfelMap, Surfels, SurfelSettings, load_map, save_map
from wheelsight.mapping.columns import columns_of

WAY_M, EVERY_M, FAR_M = 24.0, 0.8, 2.2
FITS, BOUND = 400_000, 90_000


def settings(max_surfels: int, folder: Path | None) -> SurfelSettings:
    return SurfelSettings(
        stable_confidence=1.0,
        far_m=FAR_M,
        max_surfels=max_surfels,
        resting_folder=None if folder is None else str(folder),
    )


def along_a_wall(max_surfels: int, folder: Path | None = None) -> tuple[SurfelMap, KeyframeStore]:
    """A map of a long wall by a camera that goes along it, with a keyframe at each frame."""
    store = KeyframeStore()
    made = SurfelMap(settings(max_surfels, folder), store)
    for k, x in enumerate(np.arange(0.0, WAY_M, EVERY_M)):
        store.add(Keyframe(0.1 * k, GRID, b"", b""), pose(x))
        fuse(made, see([Wall(2.0)], pose(x)), pose(x), 0.1 * k, k)
    return made, store


def in_order(surfels: Surfels) -> Surfels:
    order = np.lexsort(surfels.position.T)
    return Surfels(*(getattr(surfels, name)[order] for name in Surfels.__slots__))


def assert_same(one: Surfels, other: Surfels) -> None:
    one, other = in_order(one), in_order(other)
    assert len(one.grey) == len(other.grey)
    for name in Surfels.__slots__:
        assert_allclose(getattr(one, name), getattr(other, name), atol=1e-5, err_msg=name)


def test_memory_is_bounded_and_nothing_is_given_up(tmp_path: Path) -> None:
    bounded, _ = along_a_wall(BOUND, tmp_path)
    whole, _ = along_a_wall(FITS)
    status = bounded.status()
    assert status.dropped == 0
    assert status.resting > BOUND / 2
    assert bounded.blocks.alive < BOUND
    assert len(bounded) == status.surfels == len(whole)
    assert (status.stable, status.active) == (whole.status().stable, whole.status().active)
    assert_same(bounded.surfels(), whole.surfels())
    assert_same(bounded.surfels("stable"), whole.surfels("stable"))


def test_what_rests_is_seen_again_when_the_camera_comes_back(tmp_path: Path) -> None:
    bounded, _ = along_a_wall(BOUND, tmp_path)
    whole, _ = along_a_wall(FITS)
    shown, expected = (one.render(pose(1.0), GRID, SHAPE) for one in (bounded, whole))
    assert np.count_nonzero(expected.depth_m) > 0.5 * expected.depth_m.size
    assert_array_equal(shown.depth_m, expected.depth_m)
    assert bounded.blocks.alive < BOUND
    assert_same(bounded.surfels(), whole.surfels())


def test_it_comes_back_moved_with_its_keyframe(tmp_path: Path) -> None:
    T_new_old = se3.exp([0.2, -0.1, 0.3, 0.01, -0.02, 0.03])
    maps = []
    for made, store in (along_a_wall(BOUND, tmp_path), along_a_wall(FITS)):
        moved = [KeyframeId(number) for number in range(6)]
        store.move(moved, T_new_old @ store.T_map_keyframe[moved])
        maps.append(made)
    assert_same(maps[0].surfels(), maps[1].surfels())
    depths = [made.render(T_new_old @ pose(1.0), GRID, SHAPE).depth_m for made in maps]
    assert_allclose(depths[0], depths[1], atol=1e-4)
    assert_same(maps[0].surfels(), maps[1].surfels())


def test_a_larger_map_than_finds_room_is_saved_and_opened(tmp_path: Path) -> None:
    bounded, _ = along_a_wall(BOUND, tmp_path)
    save_map(bounded, tmp_path / "map.surfels")
    opened = load_map(tmp_path / "map.surfels")
    assert opened.blocks.alive < BOUND < len(opened) == len(bounded)
    first, second = (columns_of(made.surfels(), made.stamp_s, 10.0) for made in (opened, bounded))
    for name, column in first.items():
        assert_array_equal(column, second[name], err_msg=name)
    shown = [made.render(pose(1.0), GRID, SHAPE).depth_m > 0 for made in (opened, bounded)]
    assert np.mean(shown[0] != shown[1]) < 0.002


def test_where_nothing_can_be_written_the_bound_is_kept_by_dropping(tmp_path: Path) -> None:
    made, _ = along_a_wall(BOUND, tmp_path / "not there")
    assert made.status().resting == 0
    assert made.dropped > 0
    assert len(made) <= BOUND


def test_what_was_deleted_meanwhile_is_counted(tmp_path: Path) -> None:
    made, _ = along_a_wall(BOUND, tmp_path)
    resting = made.status().resting
    for path in tmp_path.rglob("*.surfels"):
        path.unlink()
    made.render(pose(1.0), GRID, SHAPE)
    assert 0 < made.dropped <= resting


def test_a_small_place_that_is_too_fine_has_nothing_far_away(tmp_path: Path) -> None:
    """All is in view: it is dropped as it was before anything could rest."""
    store = KeyframeStore()
    store.add(Keyframe(0.0, GRID, b"", b""), pose())
    made = SurfelMap(settings(4096, tmp_path), store)
    for k in range(3):
        fuse(made, see([Wall(1.0 + 0.5 * k)], pose()), pose(), 0.1 * k, 0)
    assert made.status().resting == 0
    assert made.dropped > 0


def test_the_same_frames_give_the_same_map(tmp_path: Path) -> None:
    one, other = (along_a_wall(BOUND, tmp_path)[0].surfels() for _ in range(2))
    for name in Surfels.__slots__:
        assert_array_equal(getattr(one, name), getattr(other, name))


def test_temporary_files_go_with_the_map(tmp_path: Path) -> None:
    made, _ = along_a_wall(BOUND, tmp_path)
    assert list(tmp_path.iterdir())
    del made
    assert not list(tmp_path.iterdir())
