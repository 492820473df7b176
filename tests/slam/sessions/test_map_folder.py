from __future__ import annotations

import math
import shutil
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from full_disk import FullDisk
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from sessions.kept_views import CALIBRATION, COUNT, SETTINGS, edge, keyframe, pose
from sessions.old_keyframes import write_old

from wheelsight.core.errors import ArgumentError, MapError, OutputError
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.settings import RecognitionSettings
from wheelsight.mapping import SurfelMap, Surfels
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.maps import MapFolder, discard_map
from wheelsight.slam.maps import journal as records
from wheelsight.slam.maps.journal import FIRST_RECORD, HEAD_BYTES, JournalWriter, Place, RecordKind, read_journal


def test_a_map_comes_back(written: Path) -> None:
    assert sorted(path.name for path in written.iterdir()) == [
        "calibration.yaml",
        "graph-00000.journal",
        *(f"keyframes-0000{piece}.journal" for piece in range(3)),
        "lock",
        "map.json",
    ]
    found = MapFolder.open(written)
    assert len(found.store) == COUNT
    assert list(found.store) == list(range(COUNT))
    assert_array_equal(found.store.T_map_keyframe, [pose(number) for number in range(COUNT)])
    for number in found.store:
        back = found.store[number]
        assert back.stamp_s == number
        assert np.corrcoef(back.grey.ravel(), keyframe(number).grey.ravel())[0, 1] > 0.999
    assert [(one.first, one.second) for one in found.edges] == [(k, k + 1) for k in range(COUNT - 1)]
    assert found.contents.health.notes == ()
    assert found.header.source == "made up"
    assert found.calibration.cameras == CALIBRATION.cameras
    assert_array_equal(found.contents.places[3].T_odom_keyframe, pose(3))


def test_the_newest_poses_and_the_edges_that_hold_are_reported(copied: Path) -> None:
    folder = MapFolder.open(copied, read_only=False)
    loops = folder.append_edges([edge(6, 0, is_loop=True), edge(5, 1, is_loop=True)])
    assert loops == (COUNT - 1, COUNT)
    folder.append_poses([2, 4], np.array([pose(12), pose(14)]))
    folder.append_poses([4], np.array([pose(24)]))
    folder.withdraw_edges([loops[0]])
    folder.append_keyframe(COUNT, keyframe(COUNT), pose(COUNT))
    folder.close()
    found = MapFolder.open(copied)
    expected = [pose({2: 12, 4: 24}.get(number, number)) for number in range(COUNT + 1)]
    assert_array_equal(found.store.T_map_keyframe, expected)
    assert [(one.first, one.second) for one in found.edges if one.is_loop] == [(5, 1)]
    assert len(found.edges) == COUNT
    assert found.contents.places[COUNT].T_odom_keyframe is None
    # Each writer begins journals of its own.
    assert len(list(copied.glob("graph-*"))) == 2


@given(share=st.floats(0, 1, exclude_max=True), kind=st.sampled_from(["graph", "keyframes"]))
def test_a_map_that_was_cut_off_anywhere_opens(written: Path, share: float, kind: str) -> None:
    path = written.with_name("cut")
    shutil.rmtree(path, ignore_errors=True)
    shutil.copytree(written, path)
    last = sorted(path.glob(f"{kind}-*"))[-1]
    whole = last.read_bytes()
    cut = int(share * len(whole))
    last.write_bytes(whole[:cut])
    found = MapFolder.open(path)
    records = read_journal(written / last.name).records
    left = [record for record, content in records if record.offset + HEAD_BYTES + len(content) <= cut]
    if kind == "graph":
        places = [record.key for record in left if record.kind == 2]
        assert len(found.store) == len(places)
    else:
        assert len(found.store) == 6 + len(left)
    assert all(found.store[number].stamp_s == number for number in found.store)
    assert all(max(one.first, one.second) < len(found.store) for one in found.edges)
    assert found.contents.health.missing == ()
    at_border = cut in {0, FIRST_RECORD, *(r.offset + HEAD_BYTES + r.length for r in left)}
    assert (found.contents.health.torn_bytes == 0) == (at_border or cut == 0)


def test_what_is_open_to_read_takes_nothing(written: Path) -> None:
    folder = MapFolder.open(written)
    for work in (
        lambda: folder.append_keyframe(9, keyframe(9), pose(9)),
        lambda: folder.append_edges([edge(0, 1)]),
        lambda: folder.append_poses([0], pose(0)[None]),
        lambda: folder.withdraw_edges([0]),
    ):
        with pytest.raises(OutputError, match="read-only"):
            work()
    assert len(list(written.glob("graph-*"))) == 1


def test_a_folder_in_use_and_one_that_cannot_be_written_are_refused(written: Path, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="is not empty"):
        MapFolder.create(written, CALIBRATION)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is a file, not a folder"):
        MapFolder.create(tmp_path / "file", CALIBRATION)


def test_a_full_disk_costs_what_comes_after(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    FullDisk("keyframes-00001.journal", 3000).take_over(monkeypatch)
    folder = MapFolder.create(tmp_path / "map", CALIBRATION, SETTINGS)
    for number in range(3):
        folder.append_keyframe(number, keyframe(number), pose(number))
    with pytest.raises(OutputError, match="no space left on the disk"):
        folder.append_keyframe(3, keyframe(3), pose(3))
    folder.close()
    found = MapFolder.open(tmp_path / "map")
    assert len(found.store) == 3
    assert found.contents.health.torn_bytes == 3000 - FIRST_RECORD


def test_what_recognises_is_kept_completed_or_made_again(copied: Path) -> None:
    settings = RecognitionSettings()
    made: list[tuple[int, int]] = []
    folder = MapFolder.open(copied, read_only=False)
    again = folder.recognizer(settings, lambda done, total: made.append((done, total)))
    assert made == [(k + 1, COUNT) for k in range(COUNT)]
    assert again.keyframes == tuple(range(COUNT))
    part = Recognizer(settings)
    for number in range(4):
        part.add(KeyframeId(number), folder.store[KeyframeId(number)])
    folder.save_recognition(part)
    made.clear()
    completed = folder.recognizer(settings, lambda done, total: made.append((done, total)))
    assert made == [(1, 3), (2, 3), (3, 3)]
    for found in (again, completed):
        view = folder.store[KeyframeId(5)]
        assert found.candidates(view, 1)[0].keyframe == 5
    assert again.candidates(keyframe(2)) == completed.candidates(keyframe(2))
    folder.save_recognition(completed)
    made.clear()
    assert len(folder.recognizer(settings, lambda done, total: made.append((done, total)))) == COUNT
    assert made == []
    assert len(folder.recognizer(RecognitionSettings(seed=3))) == COUNT
    (copied / "recognition.npz").write_bytes(b"damaged")
    assert len(folder.recognizer(settings)) == COUNT
    folder.close()


def test_a_map_of_before_is_read_recognised_and_extended(copied: Path) -> None:
    before = MapFolder.open(copied)
    write_old(copied, before)
    folder = MapFolder.open(copied, read_only=False)
    assert not folder.contents.health.notes
    for number in folder.store:
        then, now = before.store[number], folder.store[number]
        assert_array_equal(now.depth_m, then.depth_m)
        assert_array_equal(now.grey, then.grey)
        assert then.features is not None
        assert now.features is not None
        assert_allclose(now.features.points, then.features.points, rtol=0, atol=1e-6)
        assert_array_equal(now.features.descriptors, then.features.descriptors)
    known = folder.recognizer()
    folder.save_recognition(known)
    made: list[int] = []
    again = folder.recognizer(on_keyframe=lambda done, _: made.append(done))
    assert made == []
    assert again.candidates(keyframe(3)) == known.candidates(keyframe(3))
    folder.append_keyframe(COUNT, keyframe(COUNT), pose(COUNT))
    folder.close()
    assert len(MapFolder.open(copied).store) == COUNT + 1


def test_recognition_leaves_descriptors_to_the_keyframes(copied: Path) -> None:
    """And is made again where a keyframe is another by now."""
    folder = MapFolder.open(copied, read_only=False)
    known = folder.recognizer()
    folder.save_recognition(known)
    with np.load(copied / "recognition.npz") as file:
        assert file["words_own"].shape == (0, 4)
        assert len(file["words_place"]) > COUNT
    folder.append_keyframe(3, keyframe(50), pose(3))
    folder.close()
    made: list[int] = []
    MapFolder.open(copied).recognizer(on_keyframe=lambda done, _: made.append(done))
    assert len(made) == COUNT


def surfels(keyframes: np.ndarray) -> Surfels:
    n = len(keyframes)
    position = np.stack([np.arange(n), np.zeros(n), np.full(n, 2.0)], axis=-1).astype(np.float32)
    normal = np.tile(np.array([0, 0, -1], np.float32), (n, 1))
    ones = np.ones(n, np.float32)
    color, seen_s = np.full((n, 3), 100, np.float32), np.ones(n)
    return Surfels(position, normal, 0.01 * ones, color, 100 * ones, 20 * ones, 1e-4 * ones, seen_s, seen_s, keyframes)


def test_surfels_come_back_where_their_keyframes_are_by_now(copied: Path) -> None:
    assert MapFolder.open(copied).surfels() is None
    folder = MapFolder.open(copied, read_only=False)
    surfel_map = SurfelMap(store=folder.store)
    surfel_map.add(surfels(np.array([0, 2, 2, -1], np.int32)), 1.0)
    folder.save_surfels(surfel_map)
    T = np.eye(4)
    T[:3, 3] = (0.0, 5.0, 0.0)
    folder.append_poses([2], (T @ pose(2))[None])
    folder.close()
    found = MapFolder.open(copied)
    back = found.surfels()
    assert back is not None
    at = back.surfels().position
    assert_allclose(at[np.argsort(at[:, 0])][:, 1], [0, 5, 5, 0], atol=1e-5)
    found.store.move([KeyframeId(0)], (T @ pose(0))[None])
    at = back.surfels().position
    assert_allclose(at[np.argsort(at[:, 0])][:, 1], [5, 5, 5, 0], atol=1e-5)


def test_an_earlier_map_goes_and_other_files_stay(copied: Path) -> None:
    (copied / "notes.txt").write_text("mine")
    discard_map(copied)
    assert [path.name for path in copied.iterdir()] == ["notes.txt"]
    discard_map(copied)
    discard_map(copied / "nowhere")


def test_a_pose_that_is_none_is_refused_before_anything_is_written(copied: Path) -> None:
    folder = MapFolder.open(copied, read_only=False)
    with pytest.raises(ArgumentError, match="no rigid motion"):
        folder.append_keyframe(COUNT, keyframe(COUNT), np.full((4, 4), np.nan))
    folder.close()
    assert len(list(copied.glob("keyframes-*"))) == 3


def test_numbers_beyond_reason_ask_for_no_memory(copied: Path) -> None:
    """Of a keyframe that is whole, of a place alone, of images alone, and of edges."""
    number = 4_999_999
    graph, keyframes = JournalWriter(copied / "graph-00001.journal"), JournalWriter(copied / "keyframes-00009.journal")
    _, old = read_journal(copied / "keyframes-00000.journal").records[0]
    keyframes.append(RecordKind.KEYFRAME, number, bytes(old))
    keyframes.append(RecordKind.KEYFRAME, 1 << 60, b"")
    for key in (number, 1 << 61):
        graph.append(RecordKind.PLACE, key, records.pack_place(Place(1.0, pose(0))))
    graph.append(RecordKind.POSES, 0, records.pack_poses([number], pose(0)[None]))
    graph.close()
    keyframes.close()
    found = MapFolder.open(copied)
    health = found.contents.health
    assert (len(found.store), found.contents.T_map_keyframe.shape) == (COUNT, (COUNT, 4, 4))
    assert (health.dropped, health.missing, health.beyond, health.is_whole) == (2, (), (number,), False)
    assert health.notes[-1] == f"Keyframes of impossible numbers are left out: {number}."
    graph = JournalWriter(copied / "graph-00002.journal")
    graph.append(RecordKind.EDGES, 1 << 40, records.pack_edges([edge(0, 1)]))
    graph.close()
    with pytest.raises(MapError, match=r"graph-00002\.journal: its record at byte 16 holds edge 1099511627776"):
        MapFolder.open(copied)


def test_edges_of_high_numbers_take_the_room_of_few(copied: Path) -> None:
    """A table as long as the highest number, made again for each record, would take an hour."""
    graph = JournalWriter(copied / "graph-00001.journal")
    for _ in range(100):
        for first in (4_000_000, 0):
            graph.append(RecordKind.EDGES, first, records.pack_edges([edge(0, 1)]))
    graph.append(RecordKind.WITHDRAWN, 0, records.pack_numbers([4_000_000, -1]))
    graph.close()
    found = MapFolder.open(copied).contents
    assert (len(found.edges), found.edge_count) == (COUNT - 1, 4_000_001)


def test_keyframes_that_damage_took_leave_gaps(tmp_path: Path) -> None:
    """Of a drive of an hour, of which the first part is left and the last."""
    folder = MapFolder.create(tmp_path / "map", CALIBRATION)
    for number in (0, 1, 5000):
        folder.append_keyframe(number, keyframe(number), pose(number))
    folder.close()
    found = MapFolder.open(tmp_path / "map")
    assert list(found.store) == [0, 1, 5000]
    assert len(found.contents.health.missing) == 4998


@pytest.mark.parametrize("digits", ["²", "٣", "1" * 12, "-1", "x", ""])
def test_other_files_with_names_like_a_journal_are_none(copied: Path, digits: str) -> None:
    shutil.copy(copied / "graph-00000.journal", copied / f"graph-{digits}.journal")
    folder = MapFolder.open(copied, read_only=False)
    folder.append_edges([edge(0, 2)])
    folder.close()
    assert (copied / "graph-00001.journal").exists()
    assert len(MapFolder.open(copied).edges) == COUNT


def test_a_long_graph_goes_into_several_journals(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.slam.maps.folder._GRAPH_RECORDS", 2)
    folder = MapFolder.open(copied, read_only=False)
    for number in range(5):
        folder.append_edges([edge(number, number + 2)])
    folder.close()
    assert len(list(copied.glob("graph-*.journal"))) == 1 + 3
    assert len(MapFolder.open(copied).edges) == COUNT - 1 + 5


def test_a_recognition_that_unpacks_to_more_than_its_map_needs_is_made_again(copied: Path) -> None:
    """Each of its arrays in turn as zeros, which packed take a thousandth."""
    path, settings = copied / "recognition.npz", RecognitionSettings()
    folder = MapFolder.open(copied, read_only=False)
    folder.save_recognition(folder.recognizer(settings))
    folder.close()
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    for name, array in arrays.items():
        shape = (4_000_000 // array.dtype.itemsize // max(math.prod(array.shape[1:]), 1), *array.shape[1:])
        np.savez_compressed(path, **(arrays | {name: np.zeros(shape, array.dtype)}))
        tracemalloc.start()
        with pytest.raises(MapError, match=r"(is damaged: it states|knows) [0-9,]+ (bytes of|keyframes)"):
            Recognizer.load(path, settings=settings, most_keyframes=COUNT)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
        tracemalloc.stop()
    assert len(MapFolder.open(copied).recognizer(settings)) == COUNT
