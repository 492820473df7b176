"""A run that finds itself in the map of an earlier one, or extends that."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from grids import mostly_slow
from narrowing import not_none
from pipeline.made import FILES, metrics_in, names_in, status_in
from pipeline.two_days import CALIBRATION, FIRST_DAY, OTHER_ROOM, SECOND_DAY, covered, frames_of, recorded
from stand_ins import MemoryRecording
from synthetic import CAMERA

from wheelsight.app.run import RunRecord, Tone, verdict_of
from wheelsight.app.runs import run
from wheelsight.config import Config, load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import MapError
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.core.trajectory import read_tum
from wheelsight.slam.maps import MapFolder, in_largest_piece

pytestmark = pytest.mark.usefixtures("real_odometry")
SETTINGS = {"odometry": "dense", "loops.source": "keyframes", "loops.latency_s": 0.3, "loops.apart_s": 2.5}
UNKNOWN = "The place was not recognised in the map"


def settings(**more: object) -> Config:
    return load_config(overrides={**SETTINGS, **{name.replace("__", "."): value for name, value in more.items()}})


@pytest.fixture(scope="module")
def first_day(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that has left a map."""
    out = tmp_path_factory.mktemp("first_day") / "monday"
    run(recorded(FIRST_DAY, 100.0), settings(sessions__keep_map=True), out)
    return out


@pytest.fixture
def monday(first_day: Path, tmp_path: Path) -> Path:
    """A copy, which may be extended."""
    return Path(shutil.copytree(first_day, tmp_path / "monday"))


def bytes_in(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "map").iterdir()}


def find(monday: Path, out: Path, source: MemoryRecording, **more: object) -> RunRecord:
    return run(source, settings(known_map__path=str(monday), **more), out)


def off(T_map_camera: FloatArray, T_room_camera: FloatArray) -> tuple[float, float]:
    """Metres and degrees, where the map begins where the first day did."""
    D = se3.invert(se3.invert(FIRST_DAY[0]) @ T_room_camera) @ T_map_camera
    return float(np.linalg.norm(D[:3, 3])), float(np.degrees(so3.angle(D[:3, :3])))


def statuses_in(out: Path) -> list[str]:
    return [row["status"] for row in status_in(out)]


def check_near(out: Path, way: Sequence[FloatArray]) -> None:
    corrected = read_tum(out / "trajectory_corrected.txt")
    assert (corrected.frame, len(corrected)) == ("map", len(way))
    for T_map_camera, T_room_camera in zip(corrected.T_frame_body, way, strict=True):
        way_m, turn_deg = off(T_map_camera, T_room_camera)
        assert way_m < 0.05
        assert turn_deg < 1.5


def test_the_second_day_is_found_and_the_map_stays_as_it_is(first_day: Path, tmp_path: Path) -> None:
    before = bytes_in(first_day)
    record = find(first_day, tmp_path / "found", recorded(SECOND_DAY))
    assert bytes_in(first_day) == before
    assert names_in(tmp_path / "found") == FILES | {"trajectory_corrected.txt", "loops_judged.csv"}
    statuses = statuses_in(tmp_path / "found")
    joined = statuses.index("tracking")
    assert set(statuses[:joined]) == {"initializing"}
    assert set(statuses[joined:]) == {"tracking"}
    check_near(tmp_path / "found", SECOND_DAY)
    assert read_tum(tmp_path / "found" / "trajectory.txt").frame == "odom"
    assert metrics_in(tmp_path / "found")["loops"]["kept"] >= 2
    known = not_none(record.known_map)
    assert known.is_recognised
    assert known.after_s == pytest.approx(not_none(record.frames[joined].posed_s) - record.frames[0].stamp_s)
    T_map_camera = np.eye(4)
    T_map_camera[:3, 3] = known.x_m, known.y_m, known.z_m
    T_map_room = se3.invert(FIRST_DAY[0])
    assert np.linalg.norm(T_map_camera[:3, 3] - (T_map_room @ SECOND_DAY[joined])[:3, 3]) < 0.05
    assert 0 < not_none(known.sigma_m) < 0.2
    assert known.views >= 2
    assert known.keyframes_placed == known.keyframes
    assert metrics_in(tmp_path / "found")["known_map"] == known.to_dict()
    assert verdict_of(record).findings[-1].tone is Tone.GREEN
    assert record.correction is not None
    assert metrics_in(tmp_path / "found")["loops"]["evaluation"]["ate_m"]["rmse"] < 0.03


@pytest.mark.parametrize(
    ("setting", "is_second"), [("dense__finest_width_px", True), ("localizer__most_width_px", False)]
)
def test_days_by_images_of_two_sizes_find_each_other(
    first_day: Path, tmp_path: Path, setting: str, is_second: bool
) -> None:
    small: dict[str, object] = {setting: 200}
    if not is_second:
        run(recorded(FIRST_DAY, 100.0), settings(sessions__keep_map=True, **small), tmp_path / "monday")
    monday = first_day if is_second else tmp_path / "monday"
    find(monday, tmp_path / "found", recorded(SECOND_DAY), **(small if is_second else {}))
    statuses = statuses_in(tmp_path / "found")
    assert set(statuses[statuses.index("tracking") :]) == {"tracking"}
    check_near(tmp_path / "found", SECOND_DAY)


def test_an_extended_map_has_new_keyframes_that_hang_on_the_old_ones(monday: Path, tmp_path: Path) -> None:
    before, was = bytes_in(monday), MapFolder.open(monday / "map")
    record = find(monday, tmp_path / "found", recorded(SECOND_DAY), known_map__extend=True)
    assert names_in(tmp_path / "found") == FILES | {"trajectory_corrected.txt", "loops_judged.csv"}
    after = bytes_in(monday)
    assert all(after[name].startswith(before[name]) for name in before if name.endswith(".journal"))
    now = MapFolder.open(monday / "map")
    old, new = len(was.store), len(now.store) - len(was.store)
    assert new >= 2
    assert record.kept_map is not None
    assert record.kept_map.keyframes == new
    across = [edge for edge in now.edges if edge.first < old <= edge.second]
    assert across
    assert all(edge.is_loop for edge in across)
    assert in_largest_piece(now).all()
    moved_m = np.linalg.norm(now.store.T_map_keyframe[:old, :3, 3] - was.store.T_map_keyframe[:, :3, 3], axis=1)
    assert moved_m.max() < 0.05
    check_near(tmp_path / "found", SECOND_DAY)
    find(monday, tmp_path / "again", recorded(SECOND_DAY[::-1], 500.0))
    check_near(tmp_path / "again", SECOND_DAY[::-1])


@pytest.mark.parametrize("extends", mostly_slow([False, True], quick=[True]))
def test_another_room_is_not_recognised_and_reported(monday: Path, tmp_path: Path, extends: bool) -> None:
    count, recognition = len(MapFolder.open(monday / "map").store), bytes_in(monday)["recognition.npz"]
    before = bytes_in(monday)
    source = recorded(SECOND_DAY, seed=OTHER_ROOM)
    record = find(monday, tmp_path / "found", source, known_map__extend=extends)
    assert set(statuses_in(tmp_path / "found")) == {"initializing"}
    assert names_in(tmp_path / "found") == FILES
    known = not_none(record.known_map)
    assert (known.is_recognised, known.after_s, known.keyframes_placed) == (False, None, 0)
    assert known.sentence == f"{UNKNOWN} {monday}: there are no poses in it"
    assert metrics_in(tmp_path / "found")["known_map"] == known.to_dict()
    assert verdict_of(record).tone is Tone.RED
    assert "the place was not recognised" in verdict_of(record).phrase
    found = MapFolder.open(monday / "map")
    assert len(found.store) == count
    assert max(edge.second for edge in found.edges) < count
    assert bytes_in(monday)["recognition.npz"] == recognition
    assert extends or bytes_in(monday) == before


def test_a_place_recognised_when_the_drive_is_over_is_added_with_its_keyframes(monday: Path, tmp_path: Path) -> None:
    """Answers come later than the recording is long: no frame was answered in the map."""
    count = len(MapFolder.open(monday / "map").store)
    more = {"known_map__extend": True, "loops__latency_s": 30.0}
    find(monday, tmp_path / "found", recorded(SECOND_DAY), **more)
    assert set(statuses_in(tmp_path / "found")) == {"initializing"}
    check_near(tmp_path / "found", SECOND_DAY)
    found = MapFolder.open(monday / "map")
    assert len(found.store) > count
    assert max(edge.second for edge in found.edges) == len(found.store) - 1
    assert in_largest_piece(found).all()


def test_who_leaves_the_map_has_no_poses_in_it_from_there(monday: Path, tmp_path: Path) -> None:
    """Carried into another room, behind a cover: what is seen there is no part of the map, and not added to it."""
    here, there = frames_of(SECOND_DAY, 10.0), frames_of(SECOND_DAY, 15.0, OTHER_ROOM)
    beyond = [replace(frame, index=200 + frame.index) for frame in there]
    source = MemoryRecording([*here, *covered(here, 12.0), *beyond], None, CALIBRATION)
    record = find(monday, tmp_path / "found", source, known_map__extend=True)
    statuses = statuses_in(tmp_path / "found")
    assert statuses[len(here) - 1] == "tracking"
    assert statuses[-1] == "coasting"
    known, verdict = not_none(record.known_map), verdict_of(record)
    assert known.is_recognised
    assert 0 < known.keyframes_placed < known.keyframes
    (found,) = (found for found in verdict.concerns if found.about == "map")
    assert f"where {known.keyframes - known.keyframes_placed} of {known.keyframes} keyframes lie" in found.sentence
    corrected = read_tum(tmp_path / "found" / "trajectory_corrected.txt")
    assert len(read_tum(tmp_path / "found" / "trajectory.txt")) > len(corrected) >= len(here)
    assert corrected.stamps_s[-1] < 15.0
    for T_map_camera, T_room_camera in zip(corrected.T_frame_body, SECOND_DAY, strict=False):
        assert off(T_map_camera, T_room_camera)[0] < 0.05
    now = MapFolder.open(monday / "map")
    assert max(edge.second for edge in now.edges) < len(now.store)
    assert not any(15.0 <= now.store[number].stamp_s < 100.0 for number in now.store)


def mounted(calibration: Calibration) -> Calibration:
    return replace(calibration, T_base_camera=FIRST_DAY[0])


@pytest.mark.slow
def test_a_start_is_believed_but_reported_where_nothing_bears_it_out(tmp_path: Path) -> None:
    """The map of a robot begins where its base did; the second day begins a turn of 45° further."""
    found, elsewhere = tmp_path / "found", tmp_path / "elsewhere"
    calibration = mounted(CALIBRATION)
    day_one = recorded(FIRST_DAY, 100.0, calibration=calibration)
    run(day_one, settings(sessions__keep_map=True), tmp_path / "monday")
    start = f"{SECOND_DAY[0][0, 3] - FIRST_DAY[0][0, 3]:.2f},0.1,165"
    second = recorded(SECOND_DAY, calibration=calibration)
    record = find(tmp_path / "monday", found, second, known_map__start=start)
    assert set(statuses_in(found)) == {"unconfirmed", "tracking"}
    known = not_none(record.known_map)
    assert (known.is_recognised, known.has_start) == (True, True)
    last = read_tum(found / "trajectory_corrected.txt").T_frame_body[-1] @ FIRST_DAY[0]
    assert np.linalg.norm((last @ se3.invert(SECOND_DAY[-1]))[:2, 3]) < 0.6
    other = recorded(SECOND_DAY, seed=OTHER_ROOM, calibration=calibration)
    record = find(tmp_path / "monday", elsewhere, other, known_map__start=start)
    assert "tracking" not in statuses_in(elsewhere)
    assert not_none(record.known_map).sentence.endswith("poses rest on --start alone")
    assert "the place was not recognised" in verdict_of(record).phrase


def test_a_map_of_another_camera_is_refused_before_anything_is_written(first_day: Path, tmp_path: Path) -> None:
    camera = PinholeCamera(CAMERA.width, CAMERA.height, 300.0, 300.0, CAMERA.cx, CAMERA.cy)
    source = recorded(SECOND_DAY[:2], calibration=Calibration.registered_camera(camera))
    with pytest.raises(MapError, match="is of another camera: "):
        find(first_day, tmp_path / "found", source)
    assert not (tmp_path / "found").exists()


def test_a_map_that_is_not_there_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("nowhere", "empty"):
        with pytest.raises(MapError, match=name):
            find(tmp_path / name, tmp_path / "found", recorded(SECOND_DAY[:2]))
    assert not (tmp_path / "found").exists()


def test_a_map_that_another_run_writes_is_not_extended_but_may_be_read(monday: Path, tmp_path: Path) -> None:
    other = MapFolder.open(monday / "map", read_only=False)
    with pytest.raises(MapError, match="writ"):
        find(monday, tmp_path / "found", recorded(SECOND_DAY[:2]), known_map__extend=True)
    assert not (tmp_path / "found").exists()
    find(monday, tmp_path / "found", recorded(SECOND_DAY[:2]))
    other.close()
