from __future__ import annotations

import numpy as np

from wheelsight_sim import RobotModel


def test_a_camera_that_leans_right_looks_left_and_down() -> None:
    """Each angle alone, by where the camera's axes then point in the base frame."""
    plain = RobotModel(camera_pitch_rad=0.0).T_base_camera
    np.testing.assert_allclose(plain[:3, :3], [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)
    right, _, ahead = RobotModel(camera_pitch_rad=0.2, camera_yaw_rad=0.3).T_base_camera[:3, :3].T
    np.testing.assert_allclose(ahead, [np.cos(0.2) * np.cos(0.3), np.cos(0.2) * np.sin(0.3), -np.sin(0.2)], atol=1e-12)
    np.testing.assert_allclose(right, [np.sin(0.3), -np.cos(0.3), 0], atol=1e-12)
    leaning = RobotModel(camera_pitch_rad=0.0, camera_roll_rad=0.1).T_base_camera[:3, :3]
    np.testing.assert_allclose(leaning[:, 2], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(leaning[:, 0], [0, -np.cos(0.1), -np.sin(0.1)], atol=1e-12)


def test_a_camera_sits_where_it_is_put() -> None:
    robot = RobotModel(camera_forward_m=0.4, camera_left_m=0.1, camera_height_m=0.8)
    np.testing.assert_array_equal(robot.T_base_camera[:3, 3], [0.4, 0.1, 0.8])
