from __future__ import annotations

import cv2
import numpy as np
import pytest
from narrowing import not_none
from synthetic import render_room, wobbling_trajectory

from wheelsight.core.errors import CalibrationError, RecordingError, TrajectoryError
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import open_recording

CAMERA = PinholeCamera(640, 480, 585.0, 585.0, 320.0, 240.0)
TRUTH = wobbling_trajectory(3)


@pytest.fixture(scope="module")
def rendered():
    return [render_room(T_frame_camera, CAMERA) for T_frame_camera in TRUTH.T_frame_body]


@pytest.fixture
def folder(tmp_path, rendered):
    """Frames 0, 1 and 4, millimetres, a corner of each depth image not measured."""
    for number, (color, depth_m), T in zip((0, 1, 4), rendered, TRUTH.T_frame_body, strict=True):
        units = np.rint(depth_m * 1000).astype(np.uint16)
        units[:10, :10], units[:10, 10:20] = 65535, 0
        cv2.imwrite(str(tmp_path / f"frame-{number:06}.color.png"), color[..., ::-1])
        cv2.imwrite(str(tmp_path / f"frame-{number:06}.depth.png"), units)
        np.savetxt(tmp_path / f"frame-{number:06}.pose.txt", T * (1 + 2e-4 * (np.indices((4, 4)).sum(0) < 3)))
    return tmp_path


def test_reads_what_was_rendered(folder, rendered):
    recording = open_recording(folder)
    assert (recording.format, recording.body, recording.frame_count) == ("seven_scenes", "camera", 3)
    events = list(recording.events())
    np.testing.assert_allclose([event.stamp_s for event in events], [0, 1 / 30, 4 / 30])
    for event, (color, depth_m) in zip(events, rendered, strict=True):
        assert isinstance(event, RgbdFrame)
        np.testing.assert_array_equal(event.color, color)
        assert (event.depth_m[:10, :20] == 0).all()
        np.testing.assert_allclose(event.depth_m[10:], depth_m[10:], atol=0.6e-3)


def test_rotations_are_made_orthonormal(folder):
    truth = not_none(open_recording(folder).ground_truth)
    assert truth.body == "camera"
    np.testing.assert_allclose(truth.T_frame_body, TRUTH.T_frame_body, atol=1e-3)


def test_says_what_a_user_must_know(folder):
    recording = open_recording(folder)
    assert not recording.calibration.is_registered
    text = " ".join(recording.warnings)
    for words in ("30 frames a second are assumed", "not registered", "T_color_depth", "2 cm"):
        assert words in text


def test_intrinsics_beside_the_frames_replace_those_of_depth(folder):
    (folder / "camera-intrinsics.txt").write_text("570.0 0 319.0\n0 571.0 239.0\n0 0 1\n")
    calibration = open_recording(folder).calibration
    depth = not_none(calibration.depth)
    assert (depth.fx, depth.fy, depth.cx, depth.cy) == (
        570,
        571,
        319,
        239,
    )
    assert not_none(calibration.color).fx == 525


@pytest.mark.parametrize(
    "text", ["1 2 3\n", "585 1 320\n0 585 240\n0 0 1\n", "a b c\n1 2 3\n4 5 6\n", "-5 0 3\n0 5 3\n0 0 1\n"]
)
def test_intrinsics_that_are_none_are_named(folder, text):
    (folder / "camera-intrinsics.txt").write_text(text)
    with pytest.raises(CalibrationError, match=r"camera-intrinsics.txt: .*\(correct or remove the file\)"):
        open_recording(folder)


def test_frames_without_a_partner_are_counted(folder):
    (folder / "frame-000001.depth.png").unlink()
    recording = open_recording(folder)
    assert (recording.frame_count, recording.association.dropped_color) == (2, 1)


def test_a_folder_without_depth_says_so(folder):
    for path in folder.glob("*.depth.png"):
        path.unlink()
    with pytest.raises(RecordingError, match=r"holds no frame-NNNNNN\.depth image"):
        open_recording(folder)


def test_poses_where_tracking_was_lost_are_left_out(folder):
    (folder / "frame-000001.pose.txt").write_text("nan nan nan nan\n" * 4)
    recording = open_recording(folder)
    assert len(not_none(recording.ground_truth)) == 2
    assert "1 of 3 true poses are not finite and were left out." in recording.warnings


def test_a_pose_that_is_no_rotation_is_named(folder):
    np.savetxt(folder / "frame-000004.pose.txt", np.diag([1.2, 1, 1, 1]))
    with pytest.raises(TrajectoryError, match=r"frame-000004.pose.txt: the first 3×3 numbers are no rotation"):
        open_recording(folder)


def test_a_pose_of_another_shape_is_named(folder):
    (folder / "frame-000004.pose.txt").write_text("1 2 3\n")
    with pytest.raises(RecordingError, match=r"frame-000004.pose.txt: holds 3 numbers, not a 4×4 matrix"):
        open_recording(folder)
