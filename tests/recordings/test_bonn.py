from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none
from other_formats import BONN_CAMERA, make_bonn

from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory, write_tum
from wheelsight.io.recordings import open_recording

T_ROS = np.array([[-1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
T_M = [[1.0157, 0.1828, -0.2389], [0.0009, -0.8431, -0.6413], [-0.3009, 0.6147, -0.8085]]


def test_reads_camera_and_images(tmp_path: Path) -> None:
    make_bonn(tmp_path / "rgbd_bonn_balloon")
    recording = open_recording(tmp_path / "rgbd_bonn_balloon")
    assert (recording.format, recording.frame_count) == ("bonn", 2)
    assert recording.calibration.color == recording.calibration.depth == BONN_CAMERA
    assert all(isinstance(event, RgbdFrame) for event in recording.events())
    assert any("True poses are of markers" in warning for warning in recording.warnings)


def test_poses_of_markers_become_the_cameras(tmp_path: Path) -> None:
    """Markers written where they are by a camera's known poses give these back."""
    truth = make_bonn(tmp_path / "rgbd_bonn_balloon")
    T_markers_camera = np.eye(4)
    T_markers_camera[:3, :3] = np.array(T_M) / np.cbrt(np.linalg.det(T_M))
    T_markers_camera[:3, 3] = 0.0113, -0.0098, 0.0111
    written = T_ROS @ truth.T_frame_body @ np.linalg.inv(se3.nearest(T_markers_camera)) @ T_ROS
    write_tum(Trajectory(truth.stamps_s, written), tmp_path / "rgbd_bonn_balloon" / "groundtruth.txt")
    found = not_none(open_recording(tmp_path / "rgbd_bonn_balloon").ground_truth)
    np.testing.assert_allclose(found.T_frame_body, truth.T_frame_body, atol=1e-5)


def test_a_folder_of_another_name_is_not_taken_for_it(tmp_path: Path) -> None:
    make_bonn(tmp_path / "balloon")
    with pytest.raises(CalibrationError, match="its camera is unknown"):
        open_recording(tmp_path / "balloon")
