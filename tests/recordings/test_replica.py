from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from narrowing import not_none
from other_formats import make_replica, rendered
from synthetic import CAMERA

from wheelsight.core.errors import CalibrationError, InputError, RecordingError, TrajectoryError
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import OpenOptions, open_recording


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_replica(tmp_path / "room0")
    return tmp_path / "room0"


def test_reads_what_was_rendered(tmp_path: Path) -> None:
    truth = make_replica(tmp_path / "room0")
    recording = open_recording(tmp_path / "room0")
    assert (recording.format, recording.frame_count) == ("replica", 2)
    assert recording.calibration.color == recording.calibration.depth == CAMERA
    assert any("30 frames a second are assumed" in warning for warning in recording.warnings)
    found = not_none(recording.ground_truth)
    np.testing.assert_allclose(found.T_frame_body, truth.T_frame_body, atol=1e-9)
    np.testing.assert_allclose(found.stamps_s, [0, 1 / 30])
    for event, (color, depth_m) in zip(recording.events(), rendered(truth, CAMERA), strict=True):
        assert isinstance(event, RgbdFrame)
        np.testing.assert_allclose(event.depth_m, depth_m, atol=0.8e-4)
        assert np.abs(event.color.astype(int) - color).mean() < 6


def test_another_scale_in_the_file_or_by_option_is_taken(folder: Path) -> None:
    path = folder.parent / "cam_params.json"
    written = json.loads(path.read_text())
    at_first = not_none(next(iter(open_recording(folder).events())))
    assert isinstance(at_first, RgbdFrame)
    written["camera"]["scale"] = 13107.0
    path.write_text(json.dumps(written))
    for options, share in ((OpenOptions(), 0.5), (OpenOptions(depth_factor=3276.75), 2.0)):
        event = next(iter(open_recording(folder, options).events()))
        assert isinstance(event, RgbdFrame)
        np.testing.assert_allclose(event.depth_m, share * at_first.depth_m, rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("{", "describes no camera"),
        ("[]", "describes no camera"),
        ('{"camera": 3}', "describes no camera"),
        ('{"camera": {"w": 320}}', "camera has no 'h'"),
        ('{"camera": {"w": 320, "h": 240, "fx": -1, "fy": 2, "cx": 3, "cy": 4}}', "focal lengths must be positive"),
        ('{"camera": {"w": 320, "h": 240, "fx": "a", "fy": 2, "cx": 3, "cy": 4}}', "fx of a camera is a str"),
        ('{"camera": {"w": 320, "h": 240, "fx": 262, "fy": 260, "cx": 161, "cy": 118, "scale": 0}}', "scale is 0"),
    ],
)
def test_a_camera_that_is_none_is_named(folder: Path, text: str, problem: str) -> None:
    (folder.parent / "cam_params.json").write_text(text)
    with pytest.raises(CalibrationError, match=rf"cam_params.json: .*{problem}") as caught:
        open_recording(folder)
    assert "\n" not in str(caught.value)


def test_without_the_camera_file_it_says_where_one_is_looked_for(folder: Path) -> None:
    (folder.parent / "cam_params.json").unlink()
    with pytest.raises(CalibrationError, match=r"no cam_params.json, here or in the folder above \(copy"):
        open_recording(folder)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("1 2 3\n", r"traj.txt:1: holds 3 numbers where the sixteen"),
        ("x " * 16, r"traj.txt:1: holds an invalid number"),
        (" ".join(map(str, np.diag([2.0, 2, 2, 1]).ravel())), r"traj.txt:1: the first 3×3 numbers are no rotation"),
        ("", "holds no poses"),
    ],
)
def test_poses_that_are_none_are_named(folder: Path, text: str, problem: str) -> None:
    (folder / "traj.txt").write_text(text)
    with pytest.raises((TrajectoryError, RecordingError), match=problem):
        open_recording(folder)


def test_frames_without_a_partner_and_of_another_size_are_reported(folder: Path) -> None:
    cv2.imwrite(str(folder / "results" / "frame000001.jpg"), np.zeros((9, 9, 3), np.uint8))
    (folder / "results" / "depth000000.png").rename(folder / "results" / "depth000005.png")
    with pytest.raises(InputError, match=r"depth image is 320×240, its colour image 9×9"):
        open_recording(folder)
