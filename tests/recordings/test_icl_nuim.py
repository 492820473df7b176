from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none
from other_formats import ICL_CAMERA, make_icl_nuim, rendered

from wheelsight.core.errors import RecordingError
from wheelsight.core.messages import RgbdFrame, SkippedFrame
from wheelsight.core.trajectory import read_tum
from wheelsight.io.recordings import OpenOptions, open_recording


@pytest.mark.parametrize("as_rendered", [False, True])
def test_reads_what_was_rendered(tmp_path: Path, as_rendered: bool) -> None:
    truth = make_icl_nuim(tmp_path, as_rendered=as_rendered)
    recording = open_recording(tmp_path)
    assert (recording.format, recording.frame_count) == ("icl_nuim", 2)
    assert recording.calibration.color == recording.calibration.depth == ICL_CAMERA
    assert any("30 frames a second are assumed" in warning for warning in recording.warnings)
    found = not_none(recording.ground_truth)
    np.testing.assert_allclose(found.stamps_s, [1 / 30, 2 / 30])
    np.testing.assert_allclose(found.T_frame_body, truth.T_frame_body, atol=1e-6)
    for number, (event, (color, depth_m)) in enumerate(
        zip(recording.events(), rendered(truth, ICL_CAMERA), strict=True), start=1
    ):
        assert isinstance(event, RgbdFrame)
        assert event.stamp_s == number / 30
        np.testing.assert_array_equal(event.color, color)
        np.testing.assert_allclose(event.depth_m, depth_m, atol=1.01e-4)


def test_points_are_those_of_the_published_convention(tmp_path: Path) -> None:
    """K with fy = -480 and the pose as it is written put a pixel's point where ours does, the room's y turned over."""
    make_icl_nuim(tmp_path)
    written = read_tum(tmp_path / "livingRoom2.gt.freiburg").T_frame_body[1]
    ours = not_none(open_recording(tmp_path).ground_truth).T_frame_body[1]
    u, v, z = 100.0, 50.0, 2.0
    published = written @ [(u - 319.5) / 481.2 * z, (v - 239.5) / -480.0 * z, z, 1]
    point = ours @ [(u - 319.5) / 481.2 * z, (v - 239.5) / 480.0 * z, z, 1]
    np.testing.assert_allclose(point, published * [1, -1, 1, 1], atol=1e-9)


def test_another_rate_counts_for_images_and_truth(tmp_path: Path) -> None:
    make_icl_nuim(tmp_path)
    recording = open_recording(tmp_path, OpenOptions(rate_hz=10.0))
    assert [event.stamp_s for event in recording.events()] == [0.1, 0.2]
    np.testing.assert_allclose(not_none(recording.ground_truth).stamps_s, [0.1, 0.2])


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda data: data[: len(data) // 2], "distances where 640×480 pixels need one each"),
        (lambda data: data.replace(b" ", b" x", 1), "holds an invalid number"),
        (lambda data: b"9" * 50 + data[data.index(b" ") :], "holds an invalid number"),
    ],
)
def test_damaged_distances_spoil_one_frame(tmp_path: Path, change: object, problem: str) -> None:
    make_icl_nuim(tmp_path, as_rendered=True)
    path = tmp_path / "scene_00_0001.depth"
    assert callable(change)
    path.write_bytes(change(path.read_bytes()))
    first, second = open_recording(tmp_path).events()
    assert isinstance(first, SkippedFrame)
    assert problem in first.reason
    assert isinstance(second, RgbdFrame)


@pytest.mark.parametrize("word", [b"1e300", b"9e38", b"-1", b"nan", b"inf"])
def test_a_distance_of_no_camera_was_not_measured(tmp_path: Path, word: bytes) -> None:
    make_icl_nuim(tmp_path, as_rendered=True)
    path = tmp_path / "scene_00_0001.depth"
    path.write_bytes(word + path.read_bytes()[path.read_bytes().index(b" ") :])
    first, second = open_recording(tmp_path).events()
    assert isinstance(first, RgbdFrame)
    assert isinstance(second, RgbdFrame)
    assert first.depth_m[0, 0] == 0
    assert (first.depth_m.ravel()[1:] > 0).all()


def test_truth_of_two_rooms_is_refused_and_none_is_said(tmp_path: Path) -> None:
    make_icl_nuim(tmp_path, as_rendered=True)
    path = tmp_path / "livingRoom2.gt.freiburg"
    (tmp_path / "traj0.gt.freiburg").write_bytes(path.read_bytes())
    with pytest.raises(RecordingError, match=r"holds 2 files of true poses: livingRoom2.gt.freiburg, traj0"):
        open_recording(tmp_path)
    for each in tmp_path.glob("*.gt.freiburg"):
        each.unlink()
    recording = open_recording(tmp_path)
    assert recording.ground_truth is None
    assert any("nothing can be evaluated" in warning for warning in recording.warnings)


def test_a_folder_without_images_names_what_it_needs(tmp_path: Path) -> None:
    (tmp_path / "traj0.gt.freiburg").write_text("1 0 0 0 0 0 0 1\n")
    with pytest.raises(RecordingError, match=r"holds no colour image \(it needs \*.gt.freiburg"):
        open_recording(tmp_path)
