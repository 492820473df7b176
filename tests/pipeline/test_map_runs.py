"""Runs that build a map: what they leave, and what they never leave."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from pipeline.made import FILES, metrics_in, names_in
from room_drive import make_room_drive
from stand_ins import MemoryRecording
from synthetic import make_tum_recording

from wheelsight.app.run import MAP_FILE
from wheelsight.app.runs import run, run_each
from wheelsight.config import Config, load_config
from wheelsight.core.errors import RecordingError
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.mapping import SurfelMap, load_map
from wheelsight.slam.maps import MapFolder

pytestmark = pytest.mark.usefixtures("real_odometry")


def mapped(**overrides: object) -> Config:
    small = {"surfels.stable_confidence": 3.0, "surfels.fused_way_m": 0.0, "report.pictures": 2}
    return load_config(overrides={"odometry": "dense", "map": "surfels", **small, **overrides})


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings") / "room"
    make_tum_recording(folder, frames=8, covered=[4])
    return folder


def in_memory(room: Path, stop: BaseException, after: int) -> Recording:
    """The same events, and then something that ends them early."""
    source = open_recording(room)
    events: list[Event | BaseException] = list(source.events())
    return MemoryRecording([*events[:after], stop, *events[after:]], source.ground_truth, source.calibration)


def test_a_run_leaves_its_map_and_a_frame_that_failed_is_not_in_it(room: Path, tmp_path: Path) -> None:
    record = run(open_recording(room), mapped(), tmp_path)
    assert names_in(tmp_path) == FILES | {"map"}
    assert len(record.estimate) == 7
    found = metrics_in(tmp_path)["map"]
    assert found["file"] == f"map/{MAP_FILE}"
    kept = load_map(tmp_path / found["file"])
    assert found["frames_fused"] == 7
    assert found["surfels"] == len(kept) == record.frames[-1].surfels
    assert found["stable"] == kept.status().stable > 1000
    assert found["active"] == found["surfels"]
    assert found["dropped"] == 0
    assert found["memory_bytes"] > 70 * found["surfels"]
    assert [frame.surfels for frame in record.frames][4] == record.frames[3].surfels
    of_camera = ["extract", "recognise", "prepare", "predict", "align", "verify", "keyframe", "track"]
    assert list(record.stage_seconds) == ["check", *of_camera, "fuse", "decide"]


def test_the_record_shows_the_map_from_above_and_along_the_way(room: Path, tmp_path: Path) -> None:
    record = run(open_recording(room), mapped(), tmp_path)
    assert record.map is not None
    assert record.map.plan is not None
    assert not record.map.is_levelled
    # The room's z axis points up, and the camera, which is tilted, is the map's world.
    truth = open_recording(room).ground_truth
    assert truth is not None
    R_room_odom = truth.T_frame_body[0, :3, :3]
    np.testing.assert_allclose(R_room_odom @ record.map.plan.R_plan_map[2], [0, 0, 1], atol=0.03)
    assert len(record.map.pictures) == 2
    for picture in record.map.pictures:
        assert picture.rendered.shape == (480, 640, 3)
        shown = picture.rendered[::2, ::2].astype(float).mean(axis=2)
        known = (picture.rendered[::2, ::2] < 255).any(axis=2)
        assert known.mean() > 0.9
        grey = picture.color @ [0.299, 0.587, 0.114]
        assert np.corrcoef(shown[known], grey[known])[0, 1] > 0.7


@pytest.mark.usefixtures("drawn_pages")
@pytest.mark.slow
def test_of_several_odometries_the_map_is_in_the_folder_of_its_own(tmp_path: Path) -> None:
    make_room_drive(tmp_path / "drive", frames=4)
    out = tmp_path / "out"
    records = run_each(open_recording(tmp_path / "drive"), mapped(odometry="wheels,dense", fusion="none"), out)
    assert (out / "dense" / "map" / MAP_FILE).is_file()
    assert not (out / MAP_FILE).exists()
    assert not (out / "wheels" / MAP_FILE).exists()
    of_each = metrics_in(out)["odometry"]
    assert "map" not in of_each["wheels"]
    assert of_each["dense"]["map"]["surfels"] > 1000
    assert metrics_in(out / "dense")["map"] == of_each["dense"]["map"]
    by_name = {record.odometry: record for record in records}
    assert by_name["wheels"].map is None
    assert by_name["dense"].map is not None
    assert by_name["dense"].map.is_levelled
    plan = by_name["dense"].map.plan
    assert plan is not None
    np.testing.assert_array_equal(plan.R_plan_map, np.eye(3))
    assert 'id="dense-map"' in (out / "report.html").read_text()


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), RecordingError("the disk went away", path="depth")])
def test_what_breaks_a_run_off_leaves_the_map_until_then(room: Path, tmp_path: Path, stop: BaseException) -> None:
    with pytest.raises(type(stop)):
        run(in_memory(room, stop, after=3), mapped(), tmp_path)
    metrics = metrics_in(tmp_path)
    assert metrics["interrupted"]
    assert metrics["map"]["frames_fused"] == 3
    assert len(load_map(tmp_path / metrics["map"]["file"])) == metrics["map"]["surfels"]


def press_ctrl_c(monkeypatch: pytest.MonkeyPatch, times: int, at: int = 3) -> None:
    """While the map averages that frame, it is pressed so many times."""
    fuse, calls = SurfelMap.fuse, []

    def pressed(self: SurfelMap, *arguments: object) -> object:
        calls.append(arguments)
        for _ in range(times if len(calls) == at else 0):
            os.kill(os.getpid(), signal.SIGINT)
        return fuse(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(SurfelMap, "fuse", pressed)


@pytest.fixture
def ctrl_c_raises() -> object:
    """As in a terminal, wherever tests run."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c_raises")
def test_ctrl_c_waits_for_the_frame_that_is_being_fused(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    press_ctrl_c(monkeypatch, times=1)
    with pytest.raises(KeyboardInterrupt):
        run(open_recording(room), mapped(), tmp_path)
    metrics = metrics_in(tmp_path)
    assert metrics["interrupted"]
    assert metrics["frames"]["with_pose"] == metrics["map"]["frames_fused"] == 3
    assert len(load_map(tmp_path / metrics["map"]["file"])) == metrics["map"]["surfels"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("ctrl_c_raises")
def test_a_map_that_was_broken_off_in_the_middle_of_a_frame_is_not_kept(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    press_ctrl_c(monkeypatch, times=2)
    with pytest.raises(KeyboardInterrupt):
        run(open_recording(room), mapped(), tmp_path)
    assert names_in(tmp_path) == FILES | {"map"}
    assert MapFolder.open(tmp_path / "map").surfels() is None  # keyframes are whole all the same
    metrics = metrics_in(tmp_path)
    assert "map" not in metrics
    assert "The map was not kept: it was broken off in the middle of a frame." in metrics["warnings"]
    assert metrics["frames"]["with_pose"] == 2


def test_a_run_killed_while_it_writes_leaves_no_half_written_map(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(descriptor: int) -> None:
        raise SystemExit

    monkeypatch.setattr(os, "fsync", killed)
    with pytest.raises(SystemExit):
        run(open_recording(room), mapped(), tmp_path)
    assert not list(tmp_path.rglob(MAP_FILE))


def test_a_map_without_room_says_so(room: Path, tmp_path: Path) -> None:
    record = run(open_recording(room), mapped(**{"surfels.max_surfels": 20_000}), tmp_path)
    metrics = metrics_in(tmp_path)
    assert metrics["map"]["dropped"] == record.frames[-1].surfels_dropped > 0
    (said,) = (warning for warning in metrics["warnings"] if "no room" in warning)
    assert f"{metrics['map']['dropped']:,} surfels" in said
    assert "20,000" in said


def test_a_map_of_an_earlier_run_goes(room: Path, tmp_path: Path) -> None:
    run(open_recording(room), mapped(), tmp_path)
    run(open_recording(room), load_config(overrides={"odometry": "dense"}), tmp_path, force=True)
    assert names_in(tmp_path) == FILES


@pytest.mark.usefixtures("drawn_pages")
def test_where_nothing_could_be_followed_the_map_is_empty_and_said_so(tmp_path: Path) -> None:
    covered = [RgbdFrame(0.1 * k, np.zeros((24, 32, 3), np.uint8), np.zeros((24, 32), np.float32), k) for k in range(3)]
    record = run(MemoryRecording(covered), mapped(), tmp_path / "out")
    assert record.map is not None
    assert record.map.plan is None
    assert metrics_in(tmp_path / "out")["map"]["surfels"] == 0
    assert len(load_map(tmp_path / "out" / MAP_FILE)) == 0
    assert "It is empty: no frame had a pose." in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.slow
def test_two_runs_leave_the_same_map_to_the_byte(room: Path, tmp_path: Path) -> None:
    for name in ("first", "second"):
        run(open_recording(room), mapped(), tmp_path / name)
    first, second = ((tmp_path / name / "map" / MAP_FILE).read_bytes() for name in ("first", "second"))
    assert first == second
