"""Two drives through one room, each in a frame of its own, become one map."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from places.seen_room import EXACT, kept, seen
from sessions.seen_maps import RING, SIGMAS, aside, step, write_seen

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import MapError, OutputError
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.maps import MapFolder, MergedMap, in_largest_piece, info_of, merge
from wheelsight.slam.maps.journal import read_journal

MONDAY = RING[:6]
TUESDAY = [aside(T, 0.06) for T in RING[2:9]]
OFF = se3.exp([3.0, -1.0, 0.2, 0.1, 0.0, 2.0])


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("maps")
    write_seen(folder / "monday", MONDAY)
    write_seen(folder / "tuesday", TUESDAY, OFF, begin_s=1000.0)
    write_seen(folder / "elsewhere", TUESDAY, room=7)
    return folder


@pytest.fixture(scope="module")
def doings() -> list[str]:
    return []


@pytest.fixture(scope="module")
def merged(maps: Path, doings: list[str]) -> MergedMap:
    both = MapFolder.open(maps / "monday"), MapFolder.open(maps / "tuesday")
    return merge(*both, maps / "both", on_keyframe=lambda doing, *_: doings.append(doing))


def test_both_lie_where_they_are_in_the_first_ones_frame(merged: MergedMap) -> None:
    assert (merged.keyframes, merged.left_out) == ((6, 7), 0)
    T = merged.folder.store.T_map_keyframe
    off = se3.invert(np.array([*MONDAY, *TUESDAY])) @ T
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.03
    assert_allclose(T[0], MONDAY[0], atol=1e-6)


def test_edges_of_both_and_loops_between_them_are_kept(merged: MergedMap) -> None:
    edges = merged.folder.edges
    steps = {(e.first, e.second) for e in edges if not e.is_loop}
    assert steps == {(k, k + 1) for k in range(12) if k != 5}
    loops = [e for e in edges if e.is_loop]
    assert len(loops) == merged.loops[0] >= 2
    assert all(e.first < 6 <= e.second for e in loops)
    assert info_of(merged.folder).parts == 1


def test_the_new_map_has_all_that_a_map_has(merged: MergedMap, maps: Path, doings: list[str]) -> None:
    folder = merged.folder
    assert folder.header.source == "monday and tuesday"
    # What recognises Monday first, Tuesday's at the end.
    assert list(dict.fromkeys(doings)) == ["recognition", "recognising", "fusing", "writing"]
    made: list[int] = []
    assert len(folder.recognizer(on_keyframe=lambda done, total: made.append(done))) == 13
    assert made == []
    surfels = folder.surfels()
    assert surfels is not None
    assert {0, 12} <= set(surfels.surfels().keyframe.tolist())
    tuesday = MapFolder.open(maps / "tuesday")
    assert_array_equal(folder.store[KeyframeId(8)].depth_m, tuesday.store[KeyframeId(2)].depth_m)
    place = folder.contents.places[8]
    assert place.stamp_s == 1002.0
    assert place.T_odom_keyframe is not None
    assert_allclose(place.T_odom_keyframe, OFF @ TUESDAY[2], atol=1e-9)


def test_where_nothing_is_recognised_nothing_is_written(maps: Path, tmp_path: Path) -> None:
    monday, other = MapFolder.open(maps / "monday"), MapFolder.open(maps / "elsewhere")
    with pytest.raises(MapError, match=r"nothing of .*elsewhere is recognised in it|no two agree"):
        merge(monday, other, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_one_keyframe_alone_joins_nothing(maps: Path, tmp_path: Path) -> None:
    write_seen(tmp_path / "glance", TUESDAY[:1], OFF)
    with pytest.raises(MapError, match=r"1 of 1 keyframes of .*glance are recognised in it, and no two agree"):
        merge(MapFolder.open(maps / "monday"), MapFolder.open(tmp_path / "glance"), tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_another_camera_is_refused(maps: Path, tmp_path: Path) -> None:
    camera = EXACT.cameras[1]
    other = Calibration.registered_camera(replace(camera, fx=1.2 * camera.fx))
    MapFolder.create(tmp_path / "other", other).close()
    with pytest.raises(MapError, match=r"of another camera than .*other: its fx is"):
        merge(MapFolder.open(maps / "monday"), MapFolder.open(tmp_path / "other"), tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_map_without_keyframes_is_refused(maps: Path, tmp_path: Path) -> None:
    MapFolder.create(tmp_path / "empty", EXACT).close()
    monday, empty = MapFolder.open(maps / "monday"), MapFolder.open(tmp_path / "empty")
    assert not in_largest_piece(empty).any()
    for both in ((monday, empty), (empty, monday)):
        with pytest.raises(MapError, match="empty: has no keyframes"):
            merge(*both, tmp_path / "new")


def test_a_folder_that_holds_something_is_refused_before_the_work(maps: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    asked: list[str] = []
    both = MapFolder.open(maps / "monday"), MapFolder.open(maps / "tuesday")
    with pytest.raises(OutputError, match="is not empty"):
        merge(*both, tmp_path, on_keyframe=lambda doing, *_: asked.append(doing))
    assert asked == []


def test_what_damage_took_and_what_lies_nowhere_is_left_out(maps: Path, tmp_path: Path) -> None:
    """One keyframe of Monday is lost; a second piece of Tuesday hangs by an edge that shows nothing."""
    monday = Path(shutil.copytree(maps / "monday", tmp_path / "monday"))
    journal = monday / "keyframes-00000.journal"
    data = bytearray(journal.read_bytes())
    data[read_journal(journal).records[0][0].offset + 100] ^= 1
    journal.write_bytes(data)
    tuesday = Path(shutil.copytree(maps / "tuesday", tmp_path / "tuesday"))
    folder = MapFolder.open(tuesday, read_only=False)
    T = [*folder.store.T_map_keyframe, np.eye(4)]
    folder.append_keyframe(7, replace(kept(seen(TUESDAY[0], seed=3)), stamp_s=1100.0), T[7])
    folder.append_edges([step(T, 6, 100 * SIGMAS)])
    folder.close()
    found = merge(MapFolder.open(monday), MapFolder.open(tuesday), tmp_path / "new")
    assert (found.keyframes, found.left_out) == ((5, 7), 1)
    off = se3.invert(np.array([*MONDAY[1:], *TUESDAY])) @ found.folder.store.T_map_keyframe
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.03
    assert len(found.folder.recognizer()) == 12
