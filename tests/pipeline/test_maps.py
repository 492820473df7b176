"""What is made of a run's map: it is laid where the written trajectory has it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from mapping.scenes import FRAME_S, GRID, SHAPE, Wall, crowd, fuse, made_map, peak_bytes, pose, see
from numpy.testing import assert_allclose, assert_array_equal
from room_drive import make_room_drive
from stand_ins import frame

from wheelsight.app.run import MAP_FILE, run_each
from wheelsight.app.run.maps import Stops, map_record_of
from wheelsight.app.run.run_source import spread
from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import read_tum
from wheelsight.io.recordings import open_recording
from wheelsight.io.recordings.image_recording import ImageRecording
from wheelsight.mapping import SurfelMap, load_map, surfels


def seen_along(T_odom_map: list[FloatArray]) -> tuple[Stops, SurfelMap]:
    """A wall that is mapped from poses 2 cm apart, while the map lies at some motions (4, 4)."""
    stops, surfel_map = Stops(spread(2, len(T_odom_map))), made_map()
    for k, T in enumerate(T_odom_map):
        T_map_camera = pose(0.02 * k)
        fuse(surfel_map, see([Wall(2.0)], T_map_camera), T_map_camera, k * FRAME_S)
        estimate = Estimate(k * FRAME_S, Status.TRACKING, T @ T_map_camera)
        stops.look(frame(k, k * FRAME_S), estimate, T, None)
    return stops, surfel_map


def test_a_map_that_lay_elsewhere_all_the_time_is_moved_there() -> None:
    T_odom_map = se3.exp([1.5, -3.0, 0.02, 0.01, -0.02, 0.8])
    stops, surfel_map = seen_along([T_odom_map] * 6)
    before = surfel_map.surfels()
    stops.lay(surfel_map)
    shown = surfel_map.render(T_odom_map @ pose(0.05), GRID, SHAPE)
    assert (shown.depth_m > 0).mean() > 0.9
    assert_allclose(shown.depth_m[shown.depth_m > 0], 2.0, atol=1e-4)
    assert_allclose(stops.T_map_body, [T_odom_map @ pose(0.02 * k) for k in range(6)], atol=1e-9)
    assert [stop.stamp_s for stop in stops.found] == [FRAME_S, 4 * FRAME_S]
    assert_allclose(stops.found[1].T_map_camera, T_odom_map @ pose(0.08), atol=1e-9)
    once = surfel_map.surfels()
    assert len(once.grey) == len(before.grey)
    stops.lay(surfel_map)
    assert_array_equal(surfel_map.surfels().position, once.position)


def test_a_map_of_one_odometry_stays_as_it_is() -> None:
    stops, surfel_map = seen_along([np.eye(4)] * 3)
    before, poses = surfel_map.surfels(), np.array(stops.T_map_body)
    stops.lay(surfel_map)
    assert_array_equal(surfel_map.surfels().position, before.position)
    assert_array_equal(stops.T_map_body, poses)


def test_a_map_that_drifted_from_the_trajectory_is_laid_to_its_middle() -> None:
    drifted = [se3.exp([0.0, 0.0, 0.004 * k, 0.0, 0.0, 0.0]) for k in range(6)]
    stops, surfel_map = seen_along(drifted)
    stops.lay(surfel_map)
    shown = surfel_map.render(pose(0.05), GRID, SHAPE).depth_m
    assert np.median(shown[shown > 0]) == pytest.approx(2.0 + 0.010, abs=1e-4)


def test_without_a_frame_that_has_a_pose_nothing_moves() -> None:
    surfel_map = made_map()
    Stops([]).lay(surfel_map)
    assert len(surfel_map) == 0


@pytest.mark.slow
@pytest.mark.usefixtures("real_odometry")
@pytest.mark.parametrize("fusion", ["default", "ligocki"])
def test_a_joined_map_shows_from_the_written_trajectory_what_frames_showed(tmp_path: Path, fusion: str) -> None:
    """Wheels that are 3 % too large take Ligocki's pose along, while the camera's own map knows nothing of them."""
    make_room_drive(tmp_path / "room", frames=8)
    recording = open_recording(tmp_path / "room")
    assert isinstance(recording, ImageRecording)
    assert recording.calibration.wheels is not None
    T_base_camera = recording.calibration.T_base_camera
    assert T_base_camera is not None
    wheels = recording.calibration.wheels
    wide = replace(wheels, left_radius_m=1.03 * wheels.left_radius_m, right_radius_m=1.03 * wheels.right_radius_m)
    recording = replace(recording, calibration=replace(recording.calibration, wheels=wide))
    settings = {"odometry": "wheels,dense", "fusion": fusion, "map": "surfels", "surfels.fused_way_m": 0.0}
    run_each(recording, load_config(overrides=settings), tmp_path / "out")
    joined = tmp_path / "out" / "joined"
    surfel_map, way = load_map(joined / "map" / MAP_FILE), read_tum(joined / "trajectory.txt")
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    camera, off_m = recording.calibration.cameras[1], []
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    for event in frames:
        shown = surfel_map.render(way.at(event.stamp_s)[0] @ T_base_camera, intrinsics, event.depth_m.shape).depth_m
        both = (shown > 0) & (event.depth_m > 0)
        assert both.mean() > 0.5
        off_m.append(np.median(np.abs(shown - event.depth_m)[both]))
    assert max(off_m) < 3.5e-3


def test_a_plan_and_a_cloud_take_a_part_of_what_the_map_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    """In memory: 72 bytes a surfel are copies of them all. What does not grow with the map is taken off."""
    monkeypatch.setattr(surfels, "_COPIED_AT_ONCE", 1000)
    calibration = Calibration(T_base_camera=np.eye(4))
    peaks = {}
    for count in (2000, 30_000):
        surfel_map = crowd(count)
        peaks[count] = peak_bytes(partial(map_record_of, surfel_map, [], np.eye(4)[None], calibration, 500))
    assert peaks[30_000] - peaks[2000] < 0.4 * 72 * 28_000
