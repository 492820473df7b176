from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none
from other_formats import make_eth3d, rendered
from synthetic import CAMERA

from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import OpenOptions, open_recording


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_eth3d(tmp_path / "plant_1")
    return tmp_path / "plant_1"


def test_reads_what_was_rendered(tmp_path: Path) -> None:
    truth = make_eth3d(tmp_path / "plant_1")
    recording = open_recording(tmp_path / "plant_1")
    assert (recording.format, recording.body, recording.frame_count) == ("eth3d", "camera", 3)
    assert recording.calibration.color == recording.calibration.depth == CAMERA
    assert recording.calibration.source == "calibration.txt of plant_1"
    assert recording.calibration.rolling_shutter_s == 0
    found = not_none(recording.ground_truth)
    np.testing.assert_allclose(found.T_frame_body, truth.T_frame_body, atol=1e-6)
    for event, (color, depth_m) in zip(recording.events(), rendered(truth, CAMERA), strict=True):
        assert isinstance(event, RgbdFrame)
        np.testing.assert_array_equal(event.color, color)
        np.testing.assert_allclose(event.depth_m, depth_m, atol=1.01e-4)


def test_a_calibration_given_stands_in_place_of_the_file(folder: Path, tmp_path: Path) -> None:
    (folder / "calibration.txt").write_text("nothing of use\n")
    given = replace(CAMERA, fx=300.0)
    save_calibration(Calibration.registered_camera(given), tmp_path / "mine.yaml")
    assert open_recording(folder, OpenOptions(camera=tmp_path / "mine.yaml")).calibration.color == given


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("262 260 161\n", "holds 3 numbers where the four fx fy cx cy are expected"),
        ("262 260 161 x\n", "holds an invalid number: .*'x'"),
        ("262 260 161 nan\n", "where the four fx fy cx cy are expected"),
        ("262 -260 161 118\n", "focal lengths must be positive"),
        ("", "holds 0 numbers"),
    ],
)
def test_intrinsics_that_are_none_are_named(folder: Path, text: str, problem: str) -> None:
    (folder / "calibration.txt").write_text(text)
    with pytest.raises(
        CalibrationError, match=rf"calibration.txt: .*{problem}.*\(write fx fy cx cy in pixels"
    ) as caught:
        open_recording(folder)
    assert "\n" not in str(caught.value)


def test_the_size_is_that_of_the_first_image_that_can_be_read(folder: Path) -> None:
    first = min((folder / "rgb").iterdir())
    first.write_bytes(first.read_bytes()[:8])
    recording = open_recording(folder)
    assert not_none(recording.calibration.color).width == CAMERA.width
    assert [type(event).__name__ for event in recording.events()] == ["SkippedFrame", "RgbdFrame", "RgbdFrame"]


def test_a_folder_without_depth_names_what_is_missing(folder: Path) -> None:
    (folder / "depth.txt").unlink()
    with pytest.raises(RecordingError, match=r"depth.txt: is missing"):
        open_recording(folder)
