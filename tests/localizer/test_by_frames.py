"""What frames alone come to: the base's pose, as it hangs on the camera's keyframes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from narrowing import not_none
from room_drive import T_BASE_CAMERA, make_room_drive

from wheelsight.config import load_config
from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import open_recording
from wheelsight.vision.dense import DenseEstimate


def test_the_base_hangs_on_the_camera_s_keyframe_and_no_answer_holds_its_frame(tmp_path: Path) -> None:
    make_room_drive(tmp_path / "drive", frames=4)
    recording = open_recording(tmp_path / "drive")
    localizer = Localizer(recording.calibration, load_config(overrides={"odometry": "dense"}))
    answers = [localizer.process(event) for event in recording.events() if isinstance(event, RgbdFrame)]
    first = answers[0]
    assert first is not None
    for answer in answers:
        assert isinstance(answer, DenseEstimate)
        assert (answer.body, answer.keyframe, answer.frame) == ("base", 0, None)
        T_map_keyframe = not_none(answer.T_odom_body) @ se3.invert(not_none(answer.T_keyframe_body))
        np.testing.assert_allclose(T_map_keyframe, first.T_odom_body @ T_BASE_CAMERA, atol=1e-9)
