from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none

from wheelsight.core.calibration import load_calibration
from wheelsight.core.errors import CalibrationError, ConfigError, RecordingError
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import (
    OpenOptions,
    camera_names,
    express_for,
    find_recordings,
    load_camera,
    open_recording,
    reader_names,
    registry,
)


def test_names_are_sorted():
    assert reader_names() == [
        "azure_kinect",
        "bonn",
        "eth3d",
        "icl_nuim",
        "measurement_lines",
        "openloris",
        "redwood",
        "replica",
        "rosbag",
        "scannet",
        "seven_scenes",
        "skid_steer",
        "three_d_match",
        "tum",
        "velocities",
        "wheelsight",
    ]
    assert camera_names() == ["bonn", "freiburg1", "freiburg2", "freiburg3", "icl_nuim", "redwood", "seven_scenes"]


@pytest.mark.parametrize("name", camera_names())
def test_each_shipped_camera_is_a_calibration_that_says_its_source(name):
    calibration = load_camera(name)
    assert (not_none(calibration.color).width, not_none(calibration.color).height) == (640, 480)
    assert calibration.source != "unknown"
    assert calibration.is_registered == (name != "seven_scenes")


def test_freiburg1_is_what_the_benchmark_publishes():
    camera = not_none(load_camera("freiburg1").color)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (517.3, 516.5, 318.6, 255.3)
    assert camera.distortion == (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)


def test_a_missing_folder_a_file_and_an_unknown_folder(tmp_path, tum_folder):
    with pytest.raises(RecordingError, match="there is no such folder"):
        open_recording(tmp_path / "nowhere")
    with pytest.raises(RecordingError, match="is a file, but no recording in one"):
        open_recording(tum_folder / "rgb.txt")
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError) as caught:
        open_recording(tmp_path / "empty")
    for name in reader_names():
        assert re.search(rf"[:,] {name}\b", str(caught.value))
    assert "docs/recordings.md" in not_none(caught.value.fix)
    assert len(caught.value.problem) < 400  # half of what an error shows, so that more formats have room


@pytest.mark.parametrize(
    ("there", "reported"),
    [
        ("imu.csv", "skid_steer needs encoders.csv and imu.csv"),
        ("sensors.yaml", "openloris needs color.txt, aligned_depth.txt and sensors.yaml"),
        ("cam_params.json", "replica needs results/frameN.jpg and depthN.png, and cam_params.json"),
    ],
)
def test_an_unknown_folder_is_reported_what_is_missing(tmp_path, there, reported):
    (tmp_path / there).write_text("")
    with pytest.raises(RecordingError) as caught:
        open_recording(tmp_path)
    assert reported in not_none(caught.value.fix)


def test_a_folder_of_recordings_points_to_one(tmp_path, tum_folder):
    with pytest.raises(RecordingError, match=f"did you mean {tum_folder}"):
        open_recording(tmp_path)


def test_finds_recordings_below_but_not_inside_recordings(tmp_path, tum_folder):
    deep = tmp_path / "a" / "b" / "freiburg1_x"
    deep.parent.mkdir(parents=True)
    shutil.copytree(tum_folder, deep)
    shutil.copytree(tum_folder, tum_folder / "inner")
    shutil.copytree(tum_folder, tmp_path / ".hidden")
    assert find_recordings(tmp_path) == [deep, tum_folder]
    assert find_recordings(tmp_path / "nowhere") == []


def test_opens_paths_given_as_text(tum_folder):
    assert open_recording(str(tum_folder)).path == tum_folder


def test_express_for_goes_there_and_back(tum_folder):
    calibration = load_calibration(tum_folder / "calibration.yaml")
    T_base_camera = se3.exp([0.2, 0.1, 1.0, 0.3, -1.2, 0.9])
    robot = type(calibration)(calibration.color, calibration.depth, T_base_camera=T_base_camera)
    rng = np.random.default_rng(1)
    T = se3.exp(rng.normal(size=(4, 6)))
    camera = Trajectory(np.arange(4.0), T, np.tile(np.eye(6), (4, 1, 1)))
    base = express_for("base", camera, robot)
    assert (base.body, base.frame) == ("base", "map")
    np.testing.assert_allclose(base.T_frame_body @ T_base_camera, T, atol=1e-12)
    np.testing.assert_allclose(express_for("camera", base, robot).T_frame_body, T, atol=1e-12)
    np.testing.assert_array_equal(base.covariances, camera.covariances)
    with pytest.raises(CalibrationError):
        express_for("base", camera, calibration)
    with pytest.raises(CalibrationError):
        express_for("laser", camera, robot)


def test_of_very_many_folders_only_some_are_searched(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "_MOST_SEARCHED", 20)
    for number in range(30):
        (tmp_path / f"{number}" / "below").mkdir(parents=True)
    looked_at: list[Path] = []
    monkeypatch.setattr(registry, "_reader_of", looked_at.append)
    assert find_recordings(tmp_path) == []
    assert len(looked_at) == 20


@pytest.mark.parametrize("name", ["a" * 300, "a\0b"])
def test_names_that_no_folder_can_have(name):
    with pytest.raises(RecordingError, match=r"\(check the path\)$"):
        open_recording(name)


def test_a_link_that_leads_to_itself_is_no_recording(tmp_path):
    (tmp_path / "bag.db3").symlink_to("bag.db3")
    assert find_recordings(tmp_path) == []
    with pytest.raises(RecordingError, match="no reader recognises this folder"):
        open_recording(tmp_path)


def test_topics_mean_nothing_where_there_is_no_bag(tum_folder):
    with pytest.raises(ConfigError, match=r"--topic truth=/mocap is of a bag, which .* is not"):
        open_recording(tum_folder, OpenOptions(topics=("truth=/mocap",)))
