"""Our poses, covariances and twists in ROS's conventions, by known transforms."""

from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none
from numpy.testing import assert_allclose

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.core.trajectory import Trajectory
from wheelsight_export.bag_writing import mounts_of
from wheelsight_export.sources import in_odom, map_to_odom, pose_covariances, twists, upright, upright_points
from wheelsight_export.topics import COLOR_FRAME, DEPTH_FRAME, LINK

CAMERA = PinholeCamera(64, 48, 52.0, 52.0, 31.5, 23.5)


def test_a_pose_covariance_is_of_the_position_and_of_turns_about_the_parents_axes(rng: np.random.Generator) -> None:
    T = se3.exp(rng.normal(0, 1, 6))
    root = rng.normal(0, 1e-4, (6, 6))
    found = pose_covariances(Trajectory(np.zeros(1), T[None], (root @ root.T)[None]))
    assert found is not None
    # What ROS means, by its comment: errors of x, y, z, and turns about fixed axes that are applied from the left.
    drawn = rng.normal(0, 1, (20_000, 6)) @ root.T
    disturbed = se3.exp(drawn) @ T
    of_position = disturbed[:, :3, 3] - T[:3, 3]
    of_turn = so3.log(disturbed[:, :3, :3] @ T[:3, :3].T)
    sampled = np.cov(np.concatenate([of_position, of_turn], axis=1).T)
    assert_allclose(found[0], sampled, atol=0.05 * np.abs(sampled).max())


def test_a_turn_about_the_origin_moves_what_is_far_from_it() -> None:
    T = se3.from_plane(3.0, 0.0, 0.0)
    C = np.zeros((6, 6))
    C[5, 5] = 0.01**2
    found = pose_covariances(Trajectory(np.zeros(1), T[None], C[None]))
    assert found is not None
    assert found[0][1, 1] == pytest.approx(0.03**2)  # 3 m ahead, 0.01 rad is 0.03 m across
    assert found[0][5, 5] == pytest.approx(0.01**2)
    assert found[0][1, 5] == pytest.approx(0.03 * 0.01)
    assert found[0][0, 0] == 0


def test_twists_of_an_even_motion_are_that_motion_in_the_bodys_axes(rng: np.random.Generator) -> None:
    xi, T_odom_start = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.3]), se3.exp(rng.normal(0, 1, 6))
    stamps_s = np.array([0.0, 0.1, 0.15, 0.3])
    T = T_odom_start @ se3.exp(stamps_s[:, None] * xi)
    assert_allclose(twists(Trajectory(stamps_s, T, body="base")), np.tile(xi, (4, 1)), atol=1e-12)


def test_a_single_pose_does_not_move() -> None:
    assert_allclose(twists(Trajectory(np.zeros(1), np.eye(4)[None])), np.zeros((1, 6)))


def test_a_camera_that_goes_along_its_optical_axis_goes_along_x() -> None:
    T = np.tile(np.eye(4), (2, 1, 1))
    T[1, :3, 3] = (0.0, 0.0, 2.0)  # z is forward
    C = np.tile(np.diag([1.0, 2, 3, 4, 5, 6]), (2, 1, 1))
    found = upright(Trajectory(np.array([0.0, 1.0]), T, C, body="camera"))
    assert_allclose(found.T_frame_body[0], np.eye(4), atol=1e-15)
    assert_allclose(found.positions_m[1], (2, 0, 0), atol=1e-15)
    assert found.covariances is not None
    assert_allclose(found.covariances[0].diagonal(), (3, 1, 2, 6, 4, 5), atol=1e-12)
    assert_allclose(upright_points(np.array([[0.0, -1.0, 0.0]]), "camera"), [[0, 0, 1]], atol=1e-15)  # -y is up


def test_a_base_stays_as_it_is() -> None:
    way = Trajectory(np.zeros(1), se3.from_plane(1.0, 2.0, 0.3)[None], body="base")
    assert upright(way) is way


def test_odom_lies_in_the_map_where_the_correction_says() -> None:
    lived = Trajectory(np.arange(3.0), se3.from_plane([0, 1, 2], 0, 0), body="base", frame="odom")
    moved = se3.exp([0.1, -0.2, 0, 0, 0, 0.3])
    corrected = lived.moved(moved).select([0, 2])
    stamps_s, T = map_to_odom(lived, corrected)
    assert_allclose(stamps_s, (0, 2))
    assert_allclose(T, np.tile(moved, (2, 1, 1)), atol=1e-12)
    assert_allclose(map_to_odom(lived, None)[1], np.tile(np.eye(4), (3, 1, 1)))


def test_optical_frames_look_along_z_with_x_right_and_y_down() -> None:
    T_base_camera = se3.from_parts([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], (0.2, 0.0, 1.1))
    T_color_depth = se3.from_parts(np.eye(3), (-0.025, 0.0, 0.0))
    calibration = Calibration(CAMERA, CAMERA, T_color_depth, T_base_camera=T_base_camera)
    joined = {(parent, child): T for parent, child, T in mounts_of(calibration)}
    assert_allclose(joined["base_link", LINK], se3.from_parts(np.eye(3), (0.2, 0, 1.1)), atol=1e-15)
    depth, color = joined[LINK, DEPTH_FRAME], joined[LINK, COLOR_FRAME]
    ahead, right = se3.apply(depth, np.eye(3)[[2, 0]])
    assert_allclose(ahead, (1, 0, 0), atol=1e-15)
    assert_allclose(right, (0, -1, 0), atol=1e-15)
    assert_allclose(se3.compose(se3.invert(color), depth), T_color_depth, atol=1e-15)


def test_without_a_mount_the_camera_hangs_on_nothing() -> None:
    frames: list[tuple[str, str, FloatArray]] = mounts_of(Calibration.registered_camera(CAMERA))
    assert {parent for parent, _, _ in frames} == {LINK}
    assert mounts_of(Calibration()) == []


def test_a_way_in_odom_is_as_certain_as_the_trajectory_and_lies_in_the_map_where_that_does() -> None:
    rng = np.random.default_rng(3)
    A = rng.normal(size=(3, 6, 6))
    C = A @ np.swapaxes(A, 1, 2)
    lived = Trajectory(np.arange(3.0), se3.exp(rng.normal(size=(3, 6))), C, body="base")
    leapt = se3.from_plane(*rng.normal(size=(3, 3)).T)
    odom = Trajectory(np.arange(3.0), leapt @ lived.T_frame_body, body="base", frame="odom")
    found = in_odom(lived, odom)
    assert found.frame == "odom"
    assert in_odom(lived, None) is lived
    assert_allclose(map_to_odom(found, lived)[1], se3.invert(leapt), atol=1e-12)
    P, P_odom = (se3.position_covariance(way.T_frame_body, not_none(way.covariances)) for way in (lived, found))
    R = leapt[:, :3, :3]
    assert_allclose(P_odom, R @ P @ np.swapaxes(R, 1, 2), atol=1e-9)
