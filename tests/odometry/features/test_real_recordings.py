from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from wheelsight.core.estimates import Status
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import ate
from wheelsight.io.recordings import open_recording
from wheelsight.vision.features import FeatureOdometry

pytestmark = pytest.mark.data


@pytest.mark.parametrize("name", ["freiburg1_rpy_part", "red_kitchen"])
def test_a_second_of_a_real_recording_is_followed(data_folder, name):
    recording = open_recording(data_folder / "rgbd" / name)
    subject = FeatureOdometry(recording.calibration)
    frames = (event for event in recording.events() if isinstance(event, RgbdFrame))
    answers = [subject.process(frame) for frame in islice(frames, 30)]
    assert [answer.status for answer in answers] == [Status.TRACKING] * 30
    found = Trajectory(
        np.array([answer.stamp_s for answer in answers]), np.array([answer.T_odom_body for answer in answers])
    )
    assert recording.ground_truth is not None
    assert ate(found, recording.ground_truth).translation.rmse < 0.03
