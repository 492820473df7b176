from __future__ import annotations

import pytest
from odometry.views import FRAME_S, odometry, room_frames, run
from pydantic import ValidationError
from synthetic import CAMERA, wobbling_trajectory

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import se3
from wheelsight.vision.features import FeatureEstimate, FeatureSettings


@pytest.mark.parametrize(
    "wrong",
    [{"reference": "map"}, {"seed": -1}, {"seed": 2**32}, {"keypoints": 10}, {"min_inliers": 3}, {"max_speed_m_s": 0}]
    + [{"pyramid_scale": 1.0}, {"sigma_growth": 0.9}, {"prior_share": 1.1}, {"inlier_chi2": 0}, {"distinct_share": 0}]
    + [{"keyframe_share": 1.5}, {"lost_after": 0}, {"max_sigma_m": float("inf")}, {"unknown": 1}],
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ValidationError):
        FeatureSettings(**wrong)


def test_the_largest_seed_works():
    frames = room_frames(wobbling_trajectory(3))
    assert frames[1].stamp_s - frames[0].stamp_s == pytest.approx(FRAME_S)
    assert run(odometry(seed=2**32 - 1), frames)[-1].T_odom_body is not None


CHANGED = {
    "pyramid_scale": 1.4,
    "sigma_px": 3.0,
    "sigma_growth": 1.5,
    "depth_jump_focal_px": 2e3,
    "distinct_share": 0.5,
    "prior_radii": 0.1,
    "prior_share": 1.0,
    "ransac_chi2": 1.0,
    "triangle_m": 2.5,
    "triangle_change_m": 0.2,
    "triangle_change_share": 0.1,
    "inlier_chi2": 2.0,
    "refinement_steps": 1,
    "longest_step_s": 0.01,
    "view_distance_m": 100.0,
}


@pytest.fixture(scope="module")
def noisy_frames():
    return room_frames(wobbling_trajectory(24, speed=3.0).select(slice(0, 24, 3)), depth_noise=True)


def told_by(answer: FeatureEstimate) -> tuple[object, ...]:
    """All of an answer that is compared; its pose may be none."""
    T = answer.T_odom_body
    return answer.matches, answer.inliers, None if T is None else T.tolist()


def answers_of(frames, **changed):
    """With few hypotheses, near landmarks and a rolling shutter, so that every setting has something to decide."""
    base = {"refinement_steps": 2, "local_keyframes": 1, "keyframe_share": 0.95}
    base |= {"ransac_iterations": 40, "triangle_change_m": 0.01, "triangle_change_share": 0.0}
    calibration = Calibration.registered_camera(CAMERA, rolling_shutter_s=0.02)
    step = se3.exp([0.0, 0.0, 0.01, 0.0, 0.0, 0.0])
    subject = odometry(calibration, **(base | changed))
    return [told_by(subject.process(frame, step)) for frame in frames]


@pytest.fixture(scope="module")
def usual_answers(noisy_frames):
    return answers_of(noisy_frames)


def test_the_same_settings_show_the_same_poses(noisy_frames, usual_answers):
    assert answers_of(noisy_frames) == usual_answers


@pytest.mark.parametrize("name", CHANGED)
def test_each_setting_of_tracking_shows_in_the_poses(noisy_frames, usual_answers, name):
    assert answers_of(noisy_frames, **{name: CHANGED[name]}) != usual_answers
