"""What all pixels of a frame share is in the covariance of its motion, and the same by both odometries."""

from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none
from odometry.views import room_frames
from scipy.spatial.transform import Rotation
from synthetic import CAMERA, wobbling_trajectory

from wheelsight.core.calibration import Calibration
from wheelsight.core.camera_errors import frame_covariance
from wheelsight.core.errors import CalibrationError
from wheelsight.core.estimates import with_frame_error
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.vision.dense import DenseOdometry
from wheelsight.vision.features import FeatureOdometry


def calibration(sigma_m: float, sigma_rad: float) -> Calibration:
    return Calibration.registered_camera(CAMERA, frame_sigma_m=sigma_m, frame_sigma_rad=sigma_rad)


def test_a_far_frames_turn_moves_the_origin_of_a_left_perturbation() -> None:
    T = se3.from_parts(Rotation.from_euler("xyz", [0.3, -0.2, 1.0]).as_matrix(), np.array([0.5, -2.0, 1.0]))
    of_frame = frame_covariance(calibration(0.003, 0.01))
    rng = np.random.default_rng(7)
    drawn = rng.multivariate_normal(np.zeros(6), of_frame, 20_000)
    lefts = np.array([se3.log(T @ se3.exp(right) @ se3.invert(T)) for right in drawn])
    assert with_frame_error(np.zeros((6, 6)), T, of_frame) == pytest.approx(np.cov(lefts.T), abs=2e-5)


@pytest.mark.parametrize("odometry", [DenseOdometry, FeatureOdometry])
def test_both_odometries_add_it(odometry: type[DenseOdometry] | type[FeatureOdometry]) -> None:
    def covariance(sigma_m: float, sigma_rad: float) -> FloatArray:
        subject = odometry(calibration(sigma_m, sigma_rad))
        answers = [subject.process(frame) for frame in room_frames(wobbling_trajectory(3))]
        return not_none(answers[-1].motion.covariance)

    more = covariance(0.02, 0.01) - covariance(0.0, 0.0)
    assert np.diag(more) == pytest.approx([0.02**2] * 3 + [0.01**2] * 3, rel=0.1)


def test_a_negative_one_is_refused() -> None:
    with pytest.raises(CalibrationError, match=r"frame_sigma_m is -0\.1"):
        calibration(-0.1, 0.0)
