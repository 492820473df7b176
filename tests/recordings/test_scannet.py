from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none
from other_formats import SENS_COLOR, SENS_DEPTH, make_scannet
from synthetic import render_room

from wheelsight.core.errors import InputError, RecordingError
from wheelsight.core.messages import RgbdFrame, SkippedFrame
from wheelsight.io.recordings import OpenOptions, open_recording

HEAD = 4 + 8 + 9  # before the matrices
SIZES = HEAD + 4 * 64
FRAMES = SIZES + 36


def test_reads_what_was_rendered(tmp_path: Path) -> None:
    truth = make_scannet(tmp_path / "scene0000_00.sens")
    recording = open_recording(tmp_path / "scene0000_00.sens")
    assert (recording.format, recording.name, recording.frame_count) == ("scannet", "scene0000_00", 2)
    assert recording.calibration.color == SENS_COLOR
    assert recording.calibration.depth == SENS_DEPTH
    np.testing.assert_array_equal(not_none(recording.calibration.T_color_depth), np.eye(4))
    found = not_none(recording.ground_truth)
    np.testing.assert_allclose(found.T_frame_body, truth.T_frame_body, atol=1e-6)
    np.testing.assert_allclose(found.stamps_s, [1, 1.033333])
    for event, T in zip(recording.events(), truth.T_frame_body, strict=True):
        assert isinstance(event, RgbdFrame)
        np.testing.assert_allclose(event.depth_m, render_room(T, SENS_DEPTH)[1], atol=0.51e-3)
        assert np.abs(event.color.astype(int) - render_room(T, SENS_COLOR)[0]).mean() < 6
    assert not any("assumed" in warning for warning in recording.warnings)


def test_a_file_without_stamps_gets_them_from_a_rate(tmp_path: Path) -> None:
    make_scannet(tmp_path / "a.sens", microseconds=0)
    recording = open_recording(tmp_path / "a.sens")
    assert [event.stamp_s for event in recording.events()] == [0, 1 / 30]
    assert any("30 frames a second are assumed" in warning for warning in recording.warnings)
    slower = open_recording(tmp_path / "a.sens", OpenOptions(rate_hz=10))
    assert [event.stamp_s for event in slower.events()] == [0, 0.1]


def test_the_extrinsic_of_depth_leads_to_colour(tmp_path: Path) -> None:
    path = tmp_path / "a.sens"
    make_scannet(path)
    T = np.eye(4)
    T[:3, 3] = 0.02, -0.01, 0.003
    data = path.read_bytes()
    path.write_bytes(data[: HEAD + 192] + struct.pack("<16f", *T.ravel()) + data[SIZES:])
    np.testing.assert_allclose(not_none(open_recording(path).calibration.T_color_depth), T, atol=1e-8)


def test_poses_where_tracking_was_lost_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "a.sens"
    make_scannet(path)
    data = path.read_bytes()
    path.write_bytes(data[:FRAMES] + struct.pack("<16f", *[-np.inf] * 16) + data[FRAMES + 64 :])
    recording = open_recording(path)
    assert len(not_none(recording.ground_truth)) == 1
    assert "1 of 2 true poses are not finite and were left out." in recording.warnings


def test_a_file_that_is_cut_off_keeps_its_whole_frames(tmp_path: Path) -> None:
    path = tmp_path / "a.sens"
    make_scannet(path, 3)
    path.write_bytes(path.read_bytes()[:-10])
    recording = open_recording(path)
    assert recording.frame_count == 2
    assert "The file is cut off: 1 of 3 frames are missing." in recording.warnings


def test_a_damaged_image_spoils_one_frame(tmp_path: Path) -> None:
    path = tmp_path / "a.sens"
    make_scannet(path)
    data = bytearray(path.read_bytes())
    data[-60:] = bytes(60)
    path.write_bytes(data)
    assert open_recording(path).frame_count == 2
    first, second = open_recording(path).events()
    assert isinstance(first, RgbdFrame)
    assert isinstance(second, SkippedFrame)
    assert "depth image" in second.reason


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda data: b"", "is cut off within its header"),
        (lambda data: data[:100], "is cut off within its header"),
        (lambda data: data[: FRAMES + 50], "cut off before the end of its first frame"),
        (lambda data: b"\3" + data[1:], "its version field is 3"),
        (lambda data: data[:4] + b"\xff" * 8 + data[12:], "its sensor name would have"),
        (lambda data: data[:SIZES] + struct.pack("<i", 0) + data[SIZES + 4 :], "colour compression field is 0"),
        (lambda data: data[: SIZES + 4] + struct.pack("<i", 2) + data[SIZES + 8 :], "depth compression field is 2"),
        (lambda data: data[: SIZES + 24] + struct.pack("<f", 0) + data[SIZES + 28 :], "0 units a metre"),
        (lambda data: data[: FRAMES + 80] + b"\xff" * 8 + data[FRAMES + 88 :], "frame 0 says its images have"),
        (lambda data: data[:HEAD] + struct.pack("<f", -1) + data[HEAD + 4 :], "its header: .*focal lengths"),
        (lambda data: data[: HEAD + 64] + bytes(64) + data[HEAD + 128 :], "an extrinsic matrix is no rigid motion"),
    ],
)
def test_what_is_no_such_file_is_one_line(tmp_path: Path, change: Callable[[bytes], bytes], problem: str) -> None:
    path = tmp_path / "a.sens"
    make_scannet(path)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(InputError, match=rf"a.sens: .*{problem}.*\(.+\)") as caught:
        open_recording(path)
    assert "\n" not in str(caught.value)


def test_a_calibration_of_another_size_is_refused(tmp_path: Path) -> None:
    make_scannet(tmp_path / "a.sens")
    with pytest.raises(RecordingError, match=r"colour image is 324×242, the calibration's 640×480 \(choose another"):
        open_recording(tmp_path / "a.sens", OpenOptions(camera="freiburg1"))
