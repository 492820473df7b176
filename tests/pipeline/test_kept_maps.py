"""What a run leaves for the next drive."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from full_disk import FullDisk
from numpy.testing import assert_allclose
from pipeline.made import FILES, metrics_in, names_in
from pipeline.two_days import CALIBRATION, FIRST_DAY, at, covered, frames_of
from room_drive import make_room_drive
from stand_ins import MemoryRecording
from synthetic import make_tum_recording

from wheelsight.app.run import MAP_FILE, run_each
from wheelsight.app.runs import run
from wheelsight.config import Config, load_config
from wheelsight.core.errors import OutputError
from wheelsight.core.geometry import se3
from wheelsight.io.recordings import open_recording
from wheelsight.io.ros_map import FREE, UNKNOWN, read_ros_map
from wheelsight.slam import GtsamPoseGraph, OwnPoseGraph
from wheelsight.slam.graph import Prior
from wheelsight.slam.maps import MapFolder, find_map

pytestmark = pytest.mark.usefixtures("real_odometry")
KEPT = {"odometry": "dense", "sessions.keep_map": True, "dense.keyframe_way_m": 0.01, "dense.keyframe_overlap": 0.97}


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings") / "room"
    make_tum_recording(folder, frames=8)
    return folder


def kept(**overrides: object) -> Config:
    return load_config(overrides={**KEPT, **overrides})


def test_a_run_keeps_its_keyframes_where_they_are_and_how_they_hang_together(room: Path, tmp_path: Path) -> None:
    record = run(open_recording(room), kept(), tmp_path)
    assert names_in(tmp_path) == FILES | {"map"}
    found = MapFolder.open(find_map(tmp_path))
    stamps_s = [found.store[number].stamp_s for number in found.store]
    assert len(stamps_s) >= 2
    at = np.searchsorted(record.estimate.stamps_s, stamps_s)
    assert_allclose(record.estimate.stamps_s[at], stamps_s)
    assert_allclose(found.store.T_map_keyframe, record.estimate.T_frame_body[at], atol=1e-9)
    assert [(edge.first, edge.second) for edge in found.edges] == [(k, k + 1) for k in range(len(stamps_s) - 1)]
    reported = metrics_in(tmp_path)["kept_map"]
    assert reported == {"file": "map", "keyframes": len(stamps_s), "bytes": reported["bytes"]}
    assert reported["bytes"] == sum(file.stat().st_size for file in (tmp_path / "map").iterdir())
    assert (record.kept_map is not None, found.surfels()) == (True, None)


def test_a_pose_graph_of_a_kept_map_has_its_optimum_where_it_was_kept(room: Path, tmp_path: Path) -> None:
    run(open_recording(room), kept(), tmp_path)
    found = MapFolder.open(find_map(tmp_path))
    graph: GtsamPoseGraph | OwnPoseGraph = OwnPoseGraph()
    for T in found.store.T_map_keyframe:
        graph.add(T)
    graph.add_prior(Prior(next(iter(found.store)), found.store.T_map_keyframe[0], 1e-8 * np.eye(6)))
    graph.add_edges(found.edges)
    assert graph.optimise() == pytest.approx(0, abs=1e-9)


def test_with_a_surfel_map_it_is_kept_unless_one_says_otherwise(room: Path, tmp_path: Path) -> None:
    mapped = {"odometry": "dense", "map": "surfels"}
    run(open_recording(room), load_config(overrides=mapped), tmp_path)
    found = MapFolder.open(find_map(tmp_path)).surfels()
    assert found is not None
    assert names_in(tmp_path) == FILES | {"map"}  # and no second copy of the surfels
    run(open_recording(room), load_config(overrides={**mapped, "sessions.keep_map": False}), tmp_path, force=True)
    assert names_in(tmp_path) == FILES | {MAP_FILE}
    run(open_recording(room), load_config(overrides={"odometry": "features"}), tmp_path / "other")
    assert names_in(tmp_path / "other") == FILES


def test_a_folder_that_holds_something_else_is_left_alone(room: Path, tmp_path: Path) -> None:
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="map: is not empty"):
        run(open_recording(room), kept(), tmp_path, force=True)
    assert [path.name for path in (tmp_path / "map").iterdir()] == ["mine.txt"]


def test_where_the_disk_is_full_the_run_ends_well_and_says_so(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    FullDisk("keyframes-00000.journal", 1000).take_over(monkeypatch)
    record = run(open_recording(room), kept(), tmp_path)
    assert len(record.estimate) == 8
    (warning,) = [warning for warning in record.warnings if "not written any further" in warning]
    assert "no space left on the disk (free some space" in warning
    assert warning in metrics_in(tmp_path)["warnings"]
    assert len(MapFolder.open(find_map(tmp_path)).store) == 0


def test_a_run_of_which_nothing_came_leaves_no_map(room: Path, tmp_path: Path) -> None:
    source = open_recording(room)
    with pytest.raises(KeyboardInterrupt):
        run(MemoryRecording([KeyboardInterrupt()], None, source.calibration), kept(), tmp_path)
    assert names_in(tmp_path) == set()


@pytest.mark.slow
def test_of_joined_sensors_one_map_is_kept_and_it_lies_where_the_way_has_it(tmp_path: Path) -> None:
    make_room_drive(tmp_path / "drive", frames=20)
    source = open_recording(tmp_path / "drive")
    joined = {"odometry": "wheels,dense", "map": "surfels", "dense.keyframe_way_m": 0.05}
    *_, record = run_each(source, load_config(overrides=joined), tmp_path / "out")
    assert sorted(path.parent.name for path in (tmp_path / "out").rglob("map.json")) == ["map"]
    found = MapFolder.open(find_map(tmp_path / "out"))
    assert found.path == tmp_path / "out" / "joined" / "map"
    # A joined robot knows where its camera sits: what of the floor is free is reported at once.
    plan = read_ros_map(found.path / "occupancy.yaml")
    assert {FREE, UNKNOWN} < set(np.unique(plan.occupancy).tolist())
    T_base_camera = source.calibration.T_base_camera
    assert T_base_camera is not None
    for number in found.store:
        near = int(np.argmin(np.abs(record.estimate.stamps_s - found.store[number].stamp_s)))
        T_map_camera = record.estimate.T_frame_body[near] @ T_base_camera
        assert se3.view_shift_m(se3.invert(T_map_camera) @ found.store.pose(number)) < 0.03
    assert len(found.edges) == len(found.store) - 1


def test_a_map_with_loops_has_the_edges_by_which_its_graph_hangs_together(tmp_path: Path) -> None:
    """Estimates that joined sensors answer at a keyframe's own frame do not always tell of it; the graph does."""
    make_room_drive(tmp_path / "room", frames=16)
    joined = {"odometry": "wheels,dense", "sessions.keep_map": True, "loops.source": "keyframes"}
    config = load_config(overrides={**joined, "dense.keyframe_way_m": 0.01, "dense.keyframe_overlap": 0.97})
    run_each(open_recording(tmp_path / "room"), config, tmp_path / "out")
    found = MapFolder.open(find_map(tmp_path / "out"))
    steps = [(edge.first, edge.second) for edge in found.edges if not edge.is_loop]
    assert sorted(steps) == [(k, k + 1) for k in range(len(found.store) - 1)]
    assert len(found.store) >= 3


@pytest.mark.slow
def test_a_map_lies_where_the_corrected_way_has_it_even_after_a_piece_that_no_one_could_place(tmp_path: Path) -> None:
    """Behind a cover the camera is turned back; what it sees then is kept far off until it is recognised."""
    back = [at(step, 0.15) for step in range(75, 5, -1)]
    before, after = frames_of(FIRST_DAY, 10.0), frames_of(back, 20.0)
    beyond = [replace(frame, index=200 + frame.index) for frame in after]
    with_loops = {"odometry": "dense", "map": "surfels", "loops.source": "keyframes"}
    source = MemoryRecording([*before, *covered(before, 14.0), *beyond], None, CALIBRATION)
    record = run(source, load_config(overrides=with_loops), tmp_path)
    assert record.correction is not None
    corrected, found = record.correction.found.corrected, MapFolder.open(find_map(tmp_path))
    stamps_s = np.array([found.store[number].stamp_s for number in found.store])
    assert (stamps_s > 20.0).any()
    rows = np.searchsorted(corrected.stamps_s, stamps_s)
    off = se3.invert(corrected.T_frame_body[rows]) @ found.store.T_map_keyframe
    assert se3.view_shift_m(off).max() < 1e-6
    assert record.map is not None
    assert all(np.mean(picture.rendered > 0) > 0.5 for picture in record.map.pictures)
