"""A way that was driven again is no longer than before; what it shows is there, and hangs together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from places.seen_room import EXACT, kept, seen
from sessions.kept_views import write_map
from sessions.seen_maps import RING, SIGMAS, aside, step

from wheelsight.core.errors import MapError, OutputError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam import RelativePose
from wheelsight.slam.maps import MapFolder, fuse_keyframes, info_of, prune

# The second time it goes on where the first one ends.
WAY = [*RING[:5], *(aside(T, 0.03) for T in RING[:7])]


def loop(first: int, second: int, T: list[FloatArray]) -> RelativePose:
    ends = KeyframeId(first), KeyframeId(second)
    return RelativePose(*ends, se3.invert(T[first]) @ T[second], np.diag((3 * SIGMAS) ** 2), is_loop=True)


def write(path: Path, *, rooms: list[int] | None = None, joined: bool = True) -> Path:
    folder = MapFolder.create(path, EXACT, source="twice")
    for number, T in enumerate(WAY):
        view = kept(seen(T, seed=0 if rooms is None else rooms[number]))
        folder.append_keyframe(number, replace(view, stamp_s=float(number)), T, T)
    folder.append_edges([step(WAY, number) for number in range(len(WAY) - 1) if number != 4])
    if joined:
        folder.append_edges([loop(k, k + 5, WAY) for k in range(5)])
    folder.close()
    return path


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("maps") / "twice")


def test_what_is_seen_again_is_left_out_and_what_is_new_stays(twice: Path, tmp_path: Path) -> None:
    doings: list[str] = []
    old = MapFolder.open(twice)
    found = prune(old, tmp_path / "new", on_keyframe=lambda doing, *_: doings.append(doing))
    assert list(dict.fromkeys(doings)) == ["comparing", "recognition", "writing"]
    assert found.left_out == 5
    store = found.folder.store
    assert [store[number].stamp_s for number in store] == [0, 1, 2, 3, 4, 10, 11]
    assert_array_equal(store.T_map_keyframe, [*WAY[:5], *WAY[10:]])
    assert info_of(found.folder).parts == 1
    for edge in found.folder.edges:
        truth = se3.invert(store.pose(edge.first)) @ store.pose(edge.second)
        assert_allclose(edge.T_first_second, truth, atol=1e-9)
    assert sorted(found.folder.recognizer().keyframes) == list(range(7))
    assert len(MapFolder.open(twice).store) == len(WAY)  # which stays as it is
    assert found.folder.surfels() is None


def test_a_pruned_map_is_not_pruned_any_further(twice: Path, tmp_path: Path) -> None:
    once = prune(MapFolder.open(twice), tmp_path / "once").folder
    assert prune(once, tmp_path / "again").left_out == 0


def test_surfels_stay_and_hang_on_who_shows_them(twice: Path, tmp_path: Path) -> None:
    folder = MapFolder.open(twice, read_only=False)
    before = fuse_keyframes(folder)
    folder.save_surfels(before)
    folder.close()
    kept = MapFolder.open(twice).surfels()
    assert kept is not None
    after = prune(MapFolder.open(twice), tmp_path / "new").folder.surfels()
    (twice / "map.surfels").unlink()
    assert after is not None
    one, other = kept.surfels(), after.surfels()
    assert len(other.grey) == len(one.grey)
    here, there = (np.lexsort(of.position.T) for of in (one, other))
    assert_allclose(other.position[there], one.position[here], atol=1e-6)
    assert_allclose(other.color[there], one.color[here], atol=1e-5)
    stood = {0: 0, 3: 3, 5: 0, 8: 3, 10: 5, 11: 6}
    was, now = one.keyframe[here], other.keyframe[there]
    for number, new in stood.items():
        assert set(now[was == number].tolist()) <= {new}
    assert {0, 5} <= set(now.tolist())


def test_pieces_do_not_prune_each_other(tmp_path: Path) -> None:
    """Nobody knows how they lie, though their poses say the same place."""
    path = write(tmp_path / "apart", joined=False)
    assert prune(MapFolder.open(path), tmp_path / "new").left_out == 0


def test_a_place_that_looks_otherwise_by_now_stays(tmp_path: Path) -> None:
    """A cupboard stands before the wall that the first keyframe saw."""
    path = tmp_path / "map"
    folder = MapFolder.create(path, EXACT)
    view = kept(seen(WAY[0]))
    depth_m = view.depth_m
    depth_m[:, : depth_m.shape[1] // 2] *= 0.5
    changed = replace(view, depth_png=type(view).of_images(1.0, view.intrinsics, depth_m, view.grey).depth_png)
    for number, one in enumerate((view, changed, view)):
        folder.append_keyframe(number, replace(one, stamp_s=float(number)), WAY[0])
    folder.append_edges([step([WAY[0]] * 3, 0), step([WAY[0]] * 3, 1)])
    folder.close()
    found = prune(MapFolder.open(path), tmp_path / "new")
    assert [found.folder.contents.places[k].stamp_s for k in (0, 1)] == [0.0, 1.0]
    assert found.left_out == 1


def test_no_keyframes_and_a_full_folder_are_refused(twice: Path, tmp_path: Path) -> None:
    write_map(tmp_path / "empty", 0)
    with pytest.raises(MapError, match="has no keyframes"):
        prune(MapFolder.open(tmp_path / "empty"), tmp_path / "new")
    assert not (tmp_path / "new").exists()
    with pytest.raises(OutputError, match="is not empty"):
        prune(MapFolder.open(twice), tmp_path)
