"""ATE in closed form: what alignment must forgive, and what it must not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.errors import EvaluationError
from wheelsight.core.geometry import align_points_with_scale, se3, so3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import ate


def winding_path(n: int = 60, seed: int = 0) -> Trajectory:
    rng = np.random.default_rng(seed)
    steps = se3.exp(rng.normal([0.1, 0, 0, 0, 0, 0.05], 0.05, (n, 6)))
    T = [np.eye(4)]
    for step in steps[1:]:
        T.append(T[-1] @ step)
    return Trajectory(np.arange(n) / 30.0, np.array(T))


def noisy(truth: Trajectory, sigma: float = 0.02, seed: int = 1) -> Trajectory:
    noise = se3.exp(np.random.default_rng(seed).normal(0, sigma, (len(truth), 6)))
    return Trajectory(truth.stamps_s, truth.T_frame_body @ noise)


def test_of_the_truth_itself_is_zero() -> None:
    truth = winding_path()
    error = ate(truth, truth)
    assert error.translation.max < 1e-12
    assert error.rotation.max < 1e-7
    np.testing.assert_allclose(error.T_truth_estimate, np.eye(4), atol=1e-12)
    assert (error.scale, error.translation.count) == (1.0, len(truth))


@given(xi=st.lists(st.floats(-3, 3), min_size=6, max_size=6))
def test_forgives_any_rigid_motion_of_the_estimate(xi: list[float]) -> None:
    truth = winding_path()
    estimate, T_new_frame = noisy(truth), se3.exp(np.array(xi))
    before, after = ate(estimate, truth), ate(estimate.moved(T_new_frame), truth)
    np.testing.assert_allclose(after.errors_m, before.errors_m, atol=1e-9)
    np.testing.assert_allclose(after.errors_rad, before.errors_rad, atol=1e-7)
    np.testing.assert_allclose(after.T_truth_estimate @ T_new_frame, before.T_truth_estimate, atol=1e-9)


def test_of_opposite_offsets_is_their_size() -> None:
    """A square whose corners are shifted outwards along ±z in turn: no rigid motion makes it better."""
    corners = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    shifted = corners + 0.1 * np.array([[0, 0, 1.0], [0, 0, -1], [0, 0, 1], [0, 0, -1]])
    truth = Trajectory(np.arange(4.0), se3.from_parts(np.eye(3), corners))
    error = ate(Trajectory(np.arange(4.0), se3.from_parts(np.eye(3), shifted)), truth)
    np.testing.assert_allclose(error.errors_m, 0.1)
    assert (error.translation.rmse, error.translation.std) == pytest.approx((0.1, 0.0), abs=1e-9)


def test_scale_only_on_request() -> None:
    truth = winding_path()
    T = truth.T_frame_body.copy()
    T[:, :3, 3] *= 0.5
    half = Trajectory(truth.stamps_s, T, np.tile(np.eye(6), (len(truth), 1, 1))).moved(se3.exp([1, 2, 3, 0.4, 0, 0]))
    assert ate(half, truth).translation.rmse > 0.1
    error = ate(half, truth, with_scale=True)
    assert error.scale == pytest.approx(2.0)
    np.testing.assert_allclose(error.aligned.T_frame_body, truth.T_frame_body, atol=1e-9)
    assert error.aligned.covariances is not None
    # (v, ω) of the body at the world's origin: positions doubled, angles kept.
    Ad = se3.adjoint(error.T_truth_estimate @ se3.exp([1, 2, 3, 0.4, 0, 0]))
    assert np.linalg.det(error.aligned.covariances[0]) == pytest.approx(np.linalg.det(Ad) ** 2 * 2.0**6)


def test_rotation_error_is_what_alignment_leaves() -> None:
    truth = winding_path()
    R_true_estimated = so3.exp([0.0, 0.3, 0.0])
    T = truth.T_frame_body.copy()
    T[:, :3, :3] = T[:, :3, :3] @ R_true_estimated
    error = ate(Trajectory(truth.stamps_s, T), truth)
    assert error.translation.max < 1e-12
    np.testing.assert_allclose(error.errors_rad, 0.3, atol=1e-9)


def test_on_a_straight_line_orientations_settle_the_roll() -> None:
    along = np.linspace(0, 4, 40)[:, None] * [1.0, 0, 0]
    truth = Trajectory(np.arange(40.0), se3.from_parts(so3.exp([0.2, 0.1, 0]), along))
    wavy = along + 0.01 * np.sin(np.arange(40))[:, None] * [1.0, 0, 0]
    estimate = Trajectory(truth.stamps_s, se3.from_parts(so3.exp([0.2, 0.1, 0]), wavy))
    error = ate(estimate.moved(se3.exp([3, 2, 1, 0.5, 0.6, 0.7])), truth)
    expected = wavy[:, 0] - wavy[:, 0].mean() - along[:, 0] + along[:, 0].mean()
    np.testing.assert_allclose(error.errors_m, np.abs(expected), atol=1e-7)
    assert error.rotation.max < 1e-6


def test_of_a_robot_that_stood_still() -> None:
    truth = Trajectory(np.arange(5.0), np.tile(se3.exp([1, 2, 3, 0.1, 0.2, 0.3]), (5, 1, 1)))
    error = ate(truth.moved(se3.exp([-1, 0, 2, 0.5, 0, 0])), truth)
    assert error.translation.max < 1e-9
    assert error.rotation.max < 1e-7
    with pytest.raises(EvaluationError, match="no scale can be found"):
        ate(truth, truth, with_scale=True)


def test_compares_only_poses_near_in_time() -> None:
    truth = winding_path()
    estimate = Trajectory(truth.stamps_s[::2] + 0.004, truth.T_frame_body[::2])
    assert ate(estimate, truth).translation.max < 1e-12
    error = ate(estimate, truth)
    np.testing.assert_array_equal(error.stamps_s, estimate.stamps_s)
    np.testing.assert_array_equal(error.truth.stamps_s, truth.stamps_s[::2])
    with pytest.raises(EvaluationError, match=r"^0 of the estimate's poses within 0\.003 s"):
        ate(estimate, truth, max_gap_s=0.003)


def bent_path(bend: float, n: int = 200) -> Trajectory:
    """A drive in the plane through two corners, bent by so many radians a metre more than it should be."""
    way = np.linspace(0, 20, n)
    yaw = np.cumsum(0.1 * np.sin(way / 3) * 0.1 + bend * 0.1)
    xy = np.cumsum(0.1 * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1), axis=0)
    return Trajectory(way, se3.from_plane(xy[:, 0], xy[:, 1], yaw), body="base")


@pytest.mark.parametrize("with_scale", [False, True])
@pytest.mark.parametrize("body", ["base", "camera"])
def test_a_mirrored_path_near_a_plane_is_not_laid_on_its_image(
    rng: np.random.Generator, with_scale: bool, body: str
) -> None:
    """As of mirrored images: the floor is uneven, the estimate drifts in height and tilts, its world is any."""
    mount = np.eye(4) if body == "base" else np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1], [0, 0, 0, 1]])
    truth = bent_path(0.05)
    uneven = se3.exp(rng.normal(0, 0.005, (len(truth), 6)))
    truth = Trajectory(truth.stamps_s, truth.T_frame_body @ uneven @ mount, body=body)
    T = bent_path(0.05).T_frame_body.copy()
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    T = mirror @ T @ mirror @ se3.exp(rng.normal(0, 0.005, (len(truth), 6))) @ mount
    T[:, 2, 3] += np.linspace(0, 0.1, len(T))
    estimate = Trajectory(truth.stamps_s, T, body=body).moved(se3.exp([3.0, 2, 1, 0.5, 0.6, 0.7]))
    T_turned, _ = align_points_with_scale(truth.positions_m, estimate.positions_m, with_scale=with_scale)
    turned = se3.apply(T_turned, estimate.positions_m) - truth.positions_m
    assert np.sqrt(np.mean(turned**2)) < 0.1  # in space the mirror image can be had
    error = ate(estimate, truth, with_scale=with_scale)
    assert error.translation.rmse > 0.8
    up = error.aligned.T_frame_body[:, :3, :3] @ mount[:3, :3].T
    assert (up[:, 2, 2] > 0.95).all()


def test_a_path_in_space_is_laid_as_it_fits_whatever_orientations_say() -> None:
    truth = winding_path()
    T = truth.T_frame_body @ se3.from_parts(so3.exp([np.pi, 0, 0]), np.zeros(3))  # a body named by other axes
    assert ate(Trajectory(truth.stamps_s, T), truth).translation.max < 1e-9


def test_an_estimate_of_another_size_is_said_to_be_one() -> None:
    truth = bent_path(0.05)
    stood = Trajectory(truth.stamps_s, np.tile(np.eye(4), (len(truth), 1, 1)), body="base")
    wild = truth.T_frame_body.copy()
    wild[:, :3, 3] *= 1e38
    with pytest.raises(EvaluationError, match=r"cannot be laid upon the truth: its 200 poses reach over .*e\+39 m"):
        ate(Trajectory(truth.stamps_s, wild, body="base"), stood)


@pytest.mark.parametrize("with_scale", [False, True])
def test_a_path_in_the_plane_is_never_turned_over(with_scale: bool) -> None:
    truth, estimate = bent_path(0.05), bent_path(-0.05)
    mirrored, _ = align_points_with_scale(truth.positions_m, estimate.positions_m, with_scale=with_scale)
    assert mirrored[2, 2] < 0  # the mirror image fits better, and in space it can be had
    error = ate(estimate, truth, with_scale=with_scale)
    T = error.T_truth_estimate
    np.testing.assert_allclose(T[2], [0, 0, 1, 0], atol=1e-9)
    assert error.rotation.rmse < 1.0

    def rmse_at(yaw: float) -> float:
        q = (estimate.positions_m - estimate.positions_m.mean(axis=0)) @ se3.exp([0, 0, 0, 0, 0, yaw])[:3, :3].T
        off = truth.positions_m - truth.positions_m.mean(axis=0)
        return float(np.sqrt(np.mean(np.sum((off - error.scale * q) ** 2, axis=1))))

    yaw = np.arctan2(T[1, 0], T[0, 0])
    assert error.translation.rmse == pytest.approx(rmse_at(yaw))
    assert all(rmse_at(yaw + off) > rmse_at(yaw) for off in (-0.01, 0.01))
