from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none
from scipy import stats

from wheelsight.core.errors import EvaluationError
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import THREE_SIGMA_RADIUS, consistency, position_covariances_m2

T_TRUTH_START = se3.exp([3.0, -2.0, 0.0, 0.0, 0.0, 1.9])


def driving(n: int = 400, covariances: np.ndarray | None = None) -> Trajectory:
    """A base on a bend, from the origin of its own world."""
    s = np.arange(n) / 20
    pose = se3.exp(np.stack([0.5 * s, 0 * s, 0 * s, 0 * s, 0 * s, 0.1 * s], axis=-1))
    return Trajectory(100.0 + s, pose, covariances, body="base")


def growing(n: int = 400, seed: int = 0) -> tuple[Trajectory, Trajectory]:
    """An estimate whose errors are a random walk of the left perturbation, and that says so; and its truth."""
    rng = np.random.default_rng(seed)
    sigmas = np.array([0.002, 0.001, 0, 0, 0, 0.0005])
    true, errors = driving(n), np.cumsum(sigmas * rng.standard_normal((n, 6)), axis=0)
    errors -= errors[0]
    covariances = np.arange(float(n))[:, None, None] * np.diag(sigmas**2)
    T = se3.invert(se3.exp(errors)) @ true.T_frame_body
    return Trajectory(true.stamps_s, T, covariances, body="base"), true.moved(T_TRUTH_START)


def test_positions_scatter_as_their_covariances_say(rng: np.random.Generator) -> None:
    A = 0.01 * rng.standard_normal((6, 6))
    T = se3.exp([4.0, 1.0, 0.3, 0.1, -0.2, 0.8])
    errors = rng.standard_normal((40_000, 6)) @ A.T
    scattered = (se3.exp(errors) @ T)[:, :3, 3]
    (found,) = position_covariances_m2(Trajectory(np.zeros(1), T[None], (A @ A.T)[None]))
    np.testing.assert_allclose(found, np.cov(scattered.T), atol=0.03 * np.abs(found).max())


def test_covariances_turn_with_their_world() -> None:
    estimate, _ = growing()
    R = T_TRUTH_START[:3, :3]
    turned = position_covariances_m2(estimate.moved(T_TRUTH_START))
    np.testing.assert_allclose(turned, R @ position_covariances_m2(estimate) @ R.T, atol=1e-12)


def test_an_error_of_known_size_is_reported_along_the_way_and_aside() -> None:
    true = driving(covariances=np.tile(1e-4 * np.eye(6), (400, 1, 1)))
    ahead = np.zeros((400, 6))
    ahead[:, 0], ahead[:, 1] = np.linspace(0, 0.3, 400), np.linspace(0, -0.1, 400)
    T = true.T_frame_body.copy()
    T[:, :3, 3] += np.einsum("nij,nj->ni", T[:, :3, :3], ahead[:, :3])
    found = consistency(Trajectory(true.stamps_s, T, true.covariances, body="base"), driving().moved(T_TRUTH_START))
    np.testing.assert_allclose(found.errors_m, ahead[:, :2], atol=1e-9)
    np.testing.assert_allclose(found.T_truth_estimate, T_TRUTH_START, atol=1e-12)
    assert found.drift_m == pytest.approx(np.hypot(0.3, 0.1))
    assert found.way_m == pytest.approx(driving().length_m)
    assert found.drift_share == pytest.approx(found.drift_m / found.way_m)


def test_the_share_of_time_is_that_of_chi_squared() -> None:
    shares = [consistency(*growing(seed=seed), truth_sigma_m=1e-6).share for seed in range(200)]
    assert np.mean(shares) == pytest.approx(0.9973, abs=0.002)


def test_one_that_states_too_little_is_found_out() -> None:
    estimate, truth = growing()
    boasting = Trajectory(estimate.stamps_s, estimate.T_frame_body, not_none(estimate.covariances) / 1e4, body="base")
    assert consistency(boasting, truth, truth_sigma_m=1e-6).share < 0.5


def test_a_pose_speaks_until_the_next_one_but_not_across_a_gap() -> None:
    estimate, truth = growing(60)
    kept = np.r_[0:20, 50:60]
    np.testing.assert_allclose(
        consistency(estimate.select(kept), truth).weights_s, [*[0.05] * 19, 0.5, *[0.05] * 9, 0], atol=1e-9
    )


def test_the_radius_is_that_of_two_dimensions() -> None:
    assert stats.chi2.cdf(THREE_SIGMA_RADIUS**2, 2) == pytest.approx(stats.chi2.cdf(9, 1), abs=1e-5)


def test_what_cannot_be_compared_is_refused() -> None:
    estimate, truth = growing()
    with pytest.raises(EvaluationError, match="no covariances"):
        consistency(driving(), truth)
    with pytest.raises(EvaluationError, match="of the base, the ground truth of the camera"):
        consistency(estimate, Trajectory(truth.stamps_s, truth.T_frame_body, body="camera"))
    with pytest.raises(EvaluationError, match="0 of the estimate's poses have a truth"):
        consistency(estimate, Trajectory(truth.stamps_s + 1e4, truth.T_frame_body, body="base"))
