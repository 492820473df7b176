"""A sensor whose colour and depth cameras stand apart and differ: poses are those of the depth camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none
from odometry.views import error_of, from_start
from synthetic import render_room, wobbling_trajectory

from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation import Localizer
from wheelsight.vision.features import FeatureOdometry, FeatureSettings

COLOR = PinholeCamera(400, 300, 330.0, 331.0, 198.0, 151.0)
DEPTH = PinholeCamera(320, 240, 250.0, 249.0, 163.0, 117.0)
# Turned noticeably, so that a mix-up of the frames shows: poses of the two cameras differ by centimetres.
T_COLOR_DEPTH = se3.exp(np.array([-0.08, 0.03, 0.02, 0.05, -0.12, 0.08]))
T_BASE_CAMERA = se3.from_parts([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.3, 0.1, 0.9])
TRUTH = wobbling_trajectory(20, speed=3.0)
MODES = ["keyframes", "previous"]


@pytest.fixture(scope="module")
def frames():
    T_depth_color = se3.invert(T_COLOR_DEPTH)
    seen = []
    for stamp_s, T_map_depth in TRUTH:
        color, _ = render_room(T_map_depth @ T_depth_color, COLOR)
        seen.append(RgbdFrame(stamp_s, color, render_room(T_map_depth, DEPTH)[1]))
    return seen


def calibration(**others) -> Calibration:
    return Calibration(COLOR, DEPTH, T_COLOR_DEPTH, **others)


def test_a_distorted_depth_camera_is_refused() -> None:
    bent = replace(DEPTH, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(CalibrationError, match=r"distorted depth camera.*undistort"):
        FeatureOdometry(Calibration(COLOR, bent, T_COLOR_DEPTH))


def errors(answers, world):
    return np.array([error_of(answer, truth) for answer, truth in zip(answers, world, strict=True)])


@pytest.mark.parametrize("reference", MODES)
def test_poses_are_the_depth_camera_s(frames, reference):
    subject = FeatureOdometry(calibration(), FeatureSettings(reference=reference))
    found = errors([subject.process(frame) for frame in frames], from_start(TRUTH.T_frame_body))
    assert found[:, 0].max() < 0.02
    assert found[:, 1].max() < 0.006
    # The test can tell: the colour camera's poses lie further off than that.
    color_poses = from_start(TRUTH.T_frame_body @ se3.invert(T_COLOR_DEPTH))
    assert np.linalg.norm((color_poses - from_start(TRUTH.T_frame_body))[:, :3, 3], axis=1).max() > 0.03


def test_the_motion_is_the_depth_camera_s(frames):
    subject = FeatureOdometry(calibration(), FeatureSettings(reference="previous"))
    answer = [subject.process(frame) for frame in frames[:2]][-1]
    step = se3.invert(TRUTH.T_frame_body[0]) @ TRUTH.T_frame_body[1]
    error = se3.log(step @ se3.invert(not_none(answer.motion.T_reference_current)))
    assert np.linalg.norm(error[:3]) < 0.01
    assert error @ np.linalg.solve(not_none(answer.motion.covariance), error) < 30


def test_calling_the_sensor_registered_spoils_it(frames):
    wrong = Calibration(COLOR, DEPTH, np.eye(4))
    subject = FeatureOdometry(wrong)
    answers = [subject.process(frame) for frame in frames]
    tracked = [
        (a, T) for a, T in zip(answers, from_start(TRUTH.T_frame_body), strict=True) if a.T_odom_body is not None
    ]
    assert max(error_of(answer, truth)[0] for answer, truth in tracked) > 0.02 or len(tracked) < len(frames)


def test_a_prior_of_the_depth_camera_is_turned_into_the_colour_camera_s(frames, monkeypatch):
    monkeypatch.setattr("wheelsight.vision.features.tracking.match_all", lambda *_: pytest.fail("the prior was off"))
    monkeypatch.setattr("wheelsight.vision.features.tracking._PRIOR_RADII", 0.4)
    subject = FeatureOdometry(calibration(), FeatureSettings(reference="previous"))
    subject.process(frames[0])
    world = from_start(TRUTH.T_frame_body)
    step = se3.invert(world[0]) @ world[3]
    answer = subject.process(frames[3], step)
    assert error_of(answer, world[3])[0] < 0.02
    assert answer.matches > 100


def test_the_base_s_poses_through_the_localizer(frames):
    subject = Localizer(calibration(T_base_camera=T_BASE_CAMERA), Config())
    answers = [subject.process(frame) for frame in frames]
    T_map_base = TRUTH.T_frame_body @ se3.invert(T_BASE_CAMERA)
    found = errors(answers, from_start(T_map_base))
    assert {not_none(answer).body for answer in answers} == {"base"}
    assert found[:, 0].max() < 0.03
    assert found[:, 1].max() < 0.006
