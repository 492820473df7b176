from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none
from other_formats import REDWOOD_CAMERA, make_redwood, rendered

from wheelsight.core.errors import InputError, RecordingError
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import open_recording

LOG = "livingroom1-traj.log"


def test_reads_what_was_rendered(tmp_path: Path) -> None:
    truth = make_redwood(tmp_path)
    recording = open_recording(tmp_path)
    assert (recording.format, recording.frame_count) == ("redwood", 2)
    assert recording.calibration.color == recording.calibration.depth == REDWOOD_CAMERA
    found = not_none(recording.ground_truth)
    np.testing.assert_allclose(found.T_frame_body, truth.T_frame_body, atol=1e-8)
    np.testing.assert_allclose(found.stamps_s, [0, 1 / 30])
    for event, (color, depth_m) in zip(recording.events(), rendered(truth, REDWOOD_CAMERA), strict=True):
        assert isinstance(event, RgbdFrame)
        np.testing.assert_allclose(event.depth_m, depth_m, atol=0.51e-3)
        assert np.abs(event.color.astype(int) - color).mean() < 6
    assert any("30 frames a second are assumed" in warning for warning in recording.warnings)


def test_a_pose_goes_to_the_image_that_its_third_number_counts(tmp_path: Path) -> None:
    truth = make_redwood(tmp_path)
    lines = (tmp_path / LOG).read_text().splitlines(keepends=True)
    (tmp_path / LOG).write_text("".join(lines[5:]) + "7 7 8\n" + "".join(lines[1:5]))
    recording = open_recording(tmp_path)
    found = not_none(recording.ground_truth)
    np.testing.assert_allclose(found.stamps_s, [1 / 30])
    np.testing.assert_allclose(found.T_frame_body[0], truth.T_frame_body[1], atol=1e-8)
    assert f"1 of 2 poses of {LOG} are of no depth image here." in recording.warnings


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda lines: lines[:-1], r":9: holds 9 lines, not five a pose"),
        (lambda lines: [], r": holds 0 lines"),
        (lambda lines: ["0 0\n", *lines[1:]], r":1: three whole numbers"),
        (lambda lines: [*lines[:2], "1 2 x 4\n", *lines[3:]], r":3: four numbers"),
        (lambda lines: [lines[0], "2 0 0 0\n", *lines[2:]], r":1: the first 3×3 numbers are no rotation"),
        (lambda lines: lines[5:] + lines[:5], r": its third numbers do not grow"),
    ],
)
def test_a_log_that_is_none_is_named(tmp_path: Path, change: Callable[[list[str]], list[str]], problem: str) -> None:
    make_redwood(tmp_path)
    (tmp_path / LOG).write_text("".join(change((tmp_path / LOG).read_text().splitlines(keepends=True))))
    with pytest.raises(InputError, match=rf"{LOG}{problem}.*\(.+\)"):
        open_recording(tmp_path)


def test_two_logs_and_no_images_are_reported(tmp_path: Path) -> None:
    make_redwood(tmp_path)
    (tmp_path / "b.log").write_bytes((tmp_path / LOG).read_bytes())
    with pytest.raises(RecordingError, match=r"holds 2 logs: b.log, livingroom1"):
        open_recording(tmp_path)
    for path in (tmp_path / "depth").iterdir():
        path.unlink()
    with pytest.raises(RecordingError, match=r"depth: holds no depth image called by its number \(it needs rgb/"):
        open_recording(tmp_path)
