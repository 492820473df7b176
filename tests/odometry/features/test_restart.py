"""A start at a pose that others tell, where the camera sees nothing known."""

from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none
from odometry.views import FRAME_S, covered_frame, error_of, from_start, odometry, room_frame, room_frames, run
from synthetic import wobbling_trajectory

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.core.messages import RgbdFrame

TRUTH = wobbling_trajectory(16)
WORLD = from_start(TRUTH.T_frame_body)
T_TOLD = se3.exp([0.5, -0.3, 0.2, 0.1, 0.4, 0.0])
COVARIANCE = np.diag([1e-4] * 3 + [1e-5] * 3)


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    return room_frames(TRUTH)


@pytest.mark.parametrize("reference", ["keyframes", "previous"])
def test_it_goes_on_where_others_tell_it_to(frames: list[RgbdFrame], reference: str) -> None:
    subject = odometry(reference=reference)
    run(subject, [*frames[:3], *(covered_frame(f.stamp_s) for f in frames[3:6])])
    again = subject.restart(frames[6], T_TOLD, COVARIANCE)
    assert again.status is Status.TRACKING
    np.testing.assert_allclose(not_none(again.T_odom_body), T_TOLD, atol=1e-12)
    np.testing.assert_array_equal(again.covariance, COVARIANCE)
    np.testing.assert_array_equal(again.motion.T_reference_current, np.eye(4))
    assert again.matched is None
    for k in range(7, 12):
        answer = subject.process(frames[k])
        assert answer.status is Status.TRACKING
        assert error_of(answer, T_TOLD @ se3.invert(WORLD[6]) @ WORLD[k])[0] < 0.02
        assert (
            np.linalg.eigvalsh(not_none(answer.covariance) - 0.99 * COVARIANCE)[0] > 0
        )  # what was reported stays uncertain


def test_what_was_known_is_given_up(frames: list[RgbdFrame]) -> None:
    """Nothing shows where the old map lies in what others tell, so that it is not met again at its old pose."""
    subject = odometry(lost_after=2)
    run(subject, frames[:3])
    subject.restart(frames[6], T_TOLD, COVARIANCE)
    run(subject, [covered_frame(frames[6].stamp_s + k * FRAME_S) for k in range(1, 4)])
    back = subject.process(room_frame(TRUTH.T_frame_body[0], frames[6].stamp_s + 1.0))
    if back.T_odom_body is not None:
        assert error_of(back, T_TOLD @ se3.invert(WORLD[6]) @ WORLD[0])[0] < 0.03


def test_without_keypoints_there_is_no_restart(frames: list[RgbdFrame]) -> None:
    subject = odometry()
    run(subject, frames[:3])
    none = subject.restart(covered_frame(frames[3].stamp_s), T_TOLD, COVARIANCE)
    assert (none.T_odom_body, none.status, none.reason) == (None, Status.FAILING, Reason.TOO_FEW_KEYPOINTS)
    assert error_of(subject.process(frames[4]), WORLD[4])[0] < 0.02


def test_the_pose_that_is_reported_is_the_cameras_not_the_colour_cameras(frames: list[RgbdFrame]) -> None:
    camera = PinholeCamera(320, 240, 262.0, 260.0, 161.3, 118.4)
    T_color_depth = se3.from_parts(np.eye(3), [0.03, 0.0, 0.0])
    subject = odometry(Calibration(color=camera, depth=camera, T_color_depth=T_color_depth))
    again = subject.restart(frames[6], T_TOLD, COVARIANCE)
    np.testing.assert_allclose(not_none(again.T_odom_body), T_TOLD, atol=1e-12)
