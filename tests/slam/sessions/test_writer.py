from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from full_disk import FullDisk
from numpy.testing import assert_allclose, assert_array_equal
from sessions.kept_views import CALIBRATION, SETTINGS, edge, keyframe, pose
from sessions.killed_drive import KEYFRAMES_A_SECOND

from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.core.settings import RecognitionSettings
from wheelsight.mapping import SurfelMap
from wheelsight.slam.maps import MapFolder, MapWriter
from wheelsight.slam.maps.journal import RecordKind, read_journal, unpack_poses
from wheelsight.slam.maps.writer import THREAD

RECOGNITION = RecognitionSettings()
PROJECT = Path(__file__).resolve().parents[3]


def answer(number: int) -> Estimate:
    C = 1e-4 * (number + 1) * np.eye(6)
    held = KeyframeId(number)
    return Estimate(float(number), Status.TRACKING, pose(number), C, keyframe=held, T_keyframe_body=np.eye(4))


def drive(writer: MapWriter, store: KeyframeStore, count: int) -> None:
    for number in range(count):
        store.add(partial(keyframe, number), pose(number))
        for _ in range(3):
            writer.update(answer(number))


def test_a_drive_leaves_its_map(tmp_path: Path) -> None:
    store = KeyframeStore()
    writer = MapWriter(MapFolder.create(tmp_path / "map", CALIBRATION, SETTINGS), store, RECOGNITION)
    drive(writer, store, 7)
    store.move([KeyframeId(2)], pose(12)[None])
    surfel_map = SurfelMap(store=store)
    writer.close(surfel_map)
    assert (writer.keyframes, writer.warnings) == (7, ())
    assert not any(thread.name == THREAD for thread in threading.enumerate())
    found = MapFolder.open(tmp_path / "map")
    assert_array_equal(found.store.T_map_keyframe, store.T_map_keyframe)
    assert all(found.store[number].stamp_s == number for number in found.store)
    assert [(one.first, one.second) for one in found.edges] == [(k, k + 1) for k in range(6)]
    T_odom_keyframe = found.contents.places[4].T_odom_keyframe
    assert T_odom_keyframe is not None
    assert_allclose(T_odom_keyframe, pose(4), atol=1e-12)
    asked: list[int] = []
    assert len(found.recognizer(RECOGNITION, lambda done, total: asked.append(done))) == 7
    assert asked == []
    surfels = found.surfels()
    assert surfels is not None
    assert len(surfels) == 0
    MapFolder.open(tmp_path / "map", read_only=False).close()  # no one holds it


def test_a_keyframe_is_written_once_it_is_settled(tmp_path: Path) -> None:
    """The first is made again at the second frame."""
    store = KeyframeStore()
    folder = MapFolder.create(tmp_path / "map", CALIBRATION, SETTINGS)
    writer = MapWriter(folder, store)
    number = store.add(keyframe(0), pose(0))
    writer.update(answer(0))
    store.replace(number, keyframe(77))
    writer.update(answer(0))
    writer.update(answer(0))
    writer.close()
    found = MapFolder.open(tmp_path / "map")
    assert found.store[KeyframeId(0)].stamp_s == 77


def test_moved_keyframes_are_written_while_driving(tmp_path: Path) -> None:
    store, path = KeyframeStore(), tmp_path / "map"
    clock = iter(range(1_000_000))
    writer = MapWriter(MapFolder.create(path, CALIBRATION, SETTINGS), store, now_s=lambda: float(next(clock)))
    drive(writer, store, 3)
    store.move([KeyframeId(1)], pose(21)[None])
    waiting = threading.Event()
    for _ in range(100_000):
        writer.update(answer(2))
        found = MapFolder.open(path).store.T_map_keyframe
        if len(found) == 3 and np.allclose(found[1], pose(21), rtol=0, atol=1e-12):
            break
        waiting.wait(0.01)
    else:
        pytest.fail("the moved pose was never written")
    writer.close()


def test_poses_that_move_all_the_time_do_not_fill_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that moved most are written while driving, and all at the end."""
    monkeypatch.setattr("wheelsight.slam.maps.writer._MOVED_POSES", 2)
    settings = SETTINGS.model_copy(update={"flush_s": 1e-6})
    store = KeyframeStore()
    writer = MapWriter(MapFolder.create(tmp_path / "map", CALIBRATION, settings), store)
    drive(writer, store, 20)
    others = [KeyframeId(number) for number in range(20) if number != 7]
    for k in range(1, 30):
        slightly = se3.exp([1e-4 * k, 0, 0, 0, 0, 0])
        store.move(others, slightly @ store.T_map_keyframe[others])
        store.move([KeyframeId(7)], pose(100 + k)[None])
        writer.update(answer(19))
    writer.close()
    (graph,) = (tmp_path / "map").glob("graph-*")
    reported = [
        unpack_poses(bytes(held)) for record, held in read_journal(graph).records if record.kind == RecordKind.POSES
    ]
    while_driving, (last, _) = reported[:-1], reported[-1]
    assert 0 < sum(len(numbers) for numbers, _ in while_driving) <= 2 * 20
    assert all(7 in numbers for numbers, _ in while_driving)
    assert len(last) <= 20
    assert_array_equal(MapFolder.open(tmp_path / "map").store.T_map_keyframe, store.T_map_keyframe)


def test_what_is_written_rests_on_disk_and_is_read_again(tmp_path: Path) -> None:
    store = KeyframeStore()
    settings = SETTINGS.model_copy(update={"memory_keyframes": 2, "flush_s": 0.01})
    writer = MapWriter(MapFolder.create(tmp_path / "map", CALIBRATION, settings), store)
    drive(writer, store, 8)
    first, made = KeyframeId(0), keyframe(0)
    waiting = threading.Event()
    for _ in range(1000):
        if store[first].depth_png != made.depth_png:
            break
        waiting.wait(0.01)
    found = store[first]
    assert store.as_of(first, KeyframeId(1)).stamp_s == store.as_of(first, KeyframeId(2)).stamp_s == 0
    assert store[KeyframeId(7)].depth_png == keyframe(7).depth_png  # as odometry made it
    writer.close()
    kept = MapFolder.open(tmp_path / "map").store[first]
    assert found.depth_png == kept.depth_png != made.depth_png
    assert found.features is not None
    assert kept.features is not None
    assert_array_equal(found.features.descriptors, kept.features.descriptors)


def test_without_a_disk_keyframes_stay_in_memory(tmp_path: Path) -> None:
    store = KeyframeStore()
    settings = SETTINGS.model_copy(update={"memory_keyframes": 1, "flush_s": 0.01})
    folder = MapFolder.create(tmp_path / "map", CALIBRATION, settings)
    writer = MapWriter(folder, store)
    folder.close()  # it cannot be written from now on
    drive(writer, store, 6)
    writer.close()
    assert writer.warnings
    assert [store[number].depth_png for number in store] == [keyframe(k).depth_png for k in range(6)]


def test_loops_are_kept_and_those_that_were_false_are_not(tmp_path: Path) -> None:
    store = KeyframeStore()
    writer = MapWriter(MapFolder.create(tmp_path / "map", CALIBRATION, SETTINGS), store)
    drive(writer, store, 5)
    loops = [edge(4, 0, is_loop=True), edge(3, 0, is_loop=True), edge(3, 0, is_loop=True)]
    writer.add_edges(loops[:2])
    writer.add_edges(loops[2:])
    writer.withdraw_edges([loops[1], edge(4, 0, is_loop=True)])  # the last one was never added
    drive_more = store.add(keyframe(5), pose(5))
    writer.update(answer(drive_more))
    writer.close()
    found = MapFolder.open(tmp_path / "map")
    assert [(one.first, one.second) for one in found.edges if one.is_loop] == [(4, 0), (3, 0)]
    assert [(one.first, one.second) for one in found.edges if not one.is_loop] == [(k, k + 1) for k in range(5)]


def test_a_keyframe_that_could_not_be_made_is_reported(tmp_path: Path) -> None:
    def fail():
        raise ValueError("no image")

    store = KeyframeStore()
    writer = MapWriter(MapFolder.create(tmp_path / "map", CALIBRATION, SETTINGS), store)
    store.add(keyframe(0), pose(0))
    store.add(fail, pose(1))
    for _ in range(3):
        writer.update(None)
    writer.close()
    assert writer.warnings == ("Keyframe 1 is not in the map: no image.",)
    assert len(MapFolder.open(tmp_path / "map").store) == 1


def test_on_a_full_disk_the_drive_goes_on_and_it_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    FullDisk("keyframes-00001.journal", 2000).take_over(monkeypatch)
    store = KeyframeStore()
    writer = MapWriter(MapFolder.create(tmp_path / "map", CALIBRATION, SETTINGS), store, RECOGNITION)
    drive(writer, store, 7)
    writer.close(SurfelMap(store=store))
    (warning,) = writer.warnings
    where = tmp_path / "map" / "keyframes-00001.journal"
    fix = "free some space, or choose another folder"
    assert warning == f"The map is not written any further: {where}: no space left on the disk ({fix})."
    assert writer.keyframes == 3
    found = MapFolder.open(tmp_path / "map")
    assert len(found.store) == 3
    assert len(found.recognizer(RECOGNITION)) == 3


def test_whatever_goes_wrong_the_drive_goes_on_and_it_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("no one thought of this")

    monkeypatch.setattr("wheelsight.slam.maps.folder.pack_place", fail)
    store = KeyframeStore()
    writer = MapWriter(MapFolder.create(tmp_path / "map", CALIBRATION, SETTINGS), store)
    drive(writer, store, 3)
    writer.close()
    writer.close()
    assert writer.warnings == ("The map is not written any further: ZeroDivisionError: no one thought of this.",)
    MapFolder.open(tmp_path / "map", read_only=False).close()


def test_extending_a_map_goes_on_with_its_numbers(tmp_path: Path) -> None:
    store = KeyframeStore()
    writer = MapWriter(MapFolder.create(tmp_path / "map", CALIBRATION, SETTINGS), store)
    drive(writer, store, 4)
    writer.close()
    folder = MapFolder.open(tmp_path / "map", read_only=False)
    writer = MapWriter(folder, folder.store)
    assert folder.store.add(keyframe(40), pose(40)) == 4
    for _ in range(3):
        writer.update(None)
    folder.store.move([KeyframeId(0), KeyframeId(4)], np.array([pose(50), pose(54)]))
    writer.close()
    found = MapFolder.open(tmp_path / "map").store
    assert [found[number].stamp_s for number in found] == [0, 1, 2, 3, 40]
    assert_allclose(found.T_map_keyframe, [pose(k) for k in (50, 1, 2, 3, 54)], rtol=0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_kill_at_any_moment_costs_the_last_seconds_alone(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "map"
    program = Path(__file__).with_name("killed_drive.py")
    folders = (PROJECT, PROJECT / "tests" / "slam")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders))}
    child = subprocess.Popen([sys.executable, str(program), str(path)], env=environment, stdout=subprocess.PIPE)
    assert child.stdout is not None
    chosen = random.Random(seed)
    last = chosen.randrange(1, 40)
    reported = -1
    for line in child.stdout:
        reported = int(line)
        if reported >= last:
            break
    threading.Event().wait(chosen.uniform(0, 0.06))
    child.send_signal(signal.SIGKILL)
    reported = max([reported, *(int(line) for line in child.stdout if line.endswith(b"\n"))])
    child.wait()
    child.stdout.close()
    found = MapFolder.open(path, read_only=False)  # what the dead process held is free
    assert reported + 1 - len(found.store) <= 5 * KEYFRAMES_A_SECOND
    assert found.contents.health.is_whole
    assert all(found.store[number].stamp_s == number % 8 for number in found.store)
    ends = [(one.first, one.second) for one in found.edges]
    assert ends == [(k, k + 1) for k in range(len(ends))]
    assert len(ends) >= len(found.store) - 2
    found.close()
