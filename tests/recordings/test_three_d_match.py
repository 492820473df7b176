from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none
from other_formats import make_three_d_match, rendered
from synthetic import CAMERA

from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import open_recording


def test_reads_what_was_rendered(tmp_path: Path) -> None:
    truth = make_three_d_match(tmp_path / "sun3d" / "seq-01")
    recording = open_recording(tmp_path / "sun3d" / "seq-01")
    assert (recording.format, recording.frame_count) == ("three_d_match", 2)
    assert recording.calibration.color == recording.calibration.depth == CAMERA
    assert recording.calibration.source == "camera-intrinsics.txt of sun3d"
    found = not_none(recording.ground_truth)
    np.testing.assert_allclose(found.T_frame_body, truth.T_frame_body, atol=1e-8)
    for event, (color, depth_m) in zip(recording.events(), rendered(truth, CAMERA), strict=True):
        assert isinstance(event, RgbdFrame)
        np.testing.assert_array_equal(event.color, color)
        np.testing.assert_allclose(event.depth_m, depth_m, atol=0.51e-3)
    reported = " ".join(recording.warnings)
    assert "30 frames a second are assumed" in reported
    assert "took over, not motion capture" in reported
    assert "not registered" not in reported


def test_frames_of_7_scenes_are_left_to_its_reader(tmp_path: Path) -> None:
    make_three_d_match(tmp_path / "7-scenes-redkitchen" / "seq-01")
    with pytest.raises(RecordingError, match="colour image is 320×240, the calibration's 640×480"):
        open_recording(tmp_path / "7-scenes-redkitchen" / "seq-01")


@pytest.mark.parametrize(
    "text", ["1 2 3\n", "262 1 161\n0 260 118\n0 0 1\n", "a b c\n1 2 3\n4 5 6\n", "-5 0 3\n0 5 3\n0 0 1\n"]
)
def test_intrinsics_that_are_none_are_named(tmp_path: Path, text: str) -> None:
    make_three_d_match(tmp_path / "seq-01")
    (tmp_path / "camera-intrinsics.txt").write_text(text)
    with pytest.raises(CalibrationError, match=r"camera-intrinsics.txt: .*\(correct it, or give --camera\)"):
        open_recording(tmp_path / "seq-01")
