"""A Gaussian's parts in areas, reweighted, against random points; kernels against plain Python."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fusion.areas.loops import loop
from odometry.plain_kernels import plain
from scipy.stats import norm

from wheelsight.estimation import area_kernels as kernels
from wheelsight.estimation.area_rectifier import FloorShares, PlaneBelief, pose_of, reweighted

BELIEFS = {
    "within one area": ((7.0, 1.0), np.diag([0.04, 0.01])),
    "over a border": ((11.8, 1.2), np.array([[0.5, 0.1], [0.1, 0.2]])),
    "over the whole floor": ((6.0, 4.0), np.array([[16.0, 4.0], [4.0, 9.0]])),
    "outside": ((30.0, 40.0), np.diag([1.0, 1.0])),
}


@pytest.mark.parametrize("name", BELIEFS)
def test_masses_and_moments_are_those_of_random_points(rng, name):
    mean, covariance = np.array(BELIEFS[name][0]), BELIEFS[name][1]
    border_m = 0.2
    parts, axes = FloorShares(loop(), border_m).parts_of(mean, covariance)
    np.testing.assert_allclose(axes @ axes.T, covariance, atol=1e-12)
    points = rng.multivariate_normal(mean, covariance, 100_000)
    # A border blurred by a Gaussian is a sharp border seen from a place that is off by one.
    index = loop().index_at(points + rng.normal(0, border_m, points.shape))
    masses = np.bincount(np.where(index < 0, 8, index), minlength=9) / len(points)
    np.testing.assert_allclose(parts[:, 0], masses, atol=0.006)
    likelihoods = rng.uniform(0.05, 1, 9)
    new_mean, new_covariance = reweighted(parts, likelihoods)
    weights = likelihoods[index]  # -1 is the last, outside
    wanted = np.average(points, axis=0, weights=weights)
    np.testing.assert_allclose(mean + axes @ new_mean, wanted, atol=0.02 * np.sqrt(np.trace(covariance)))
    wanted_covariance = np.cov(points.T, aweights=weights)
    np.testing.assert_allclose(axes @ new_covariance @ axes.T, wanted_covariance, atol=0.03 * np.trace(covariance))


def test_a_half_plane_is_the_truncated_gaussian_of_the_books():
    mean, sigma = np.array([2.5, 5.0]), 0.4  # beside the west corridor's border at 2, far from its ends
    floor = FloorShares(loop(), 0.02, cell_m=0.01)
    parts, axes = floor.parts_of(mean, np.diag([sigma**2, 0.01]))
    likelihoods = np.zeros(9)
    likelihoods[6] = 1.0
    new_mean, new_covariance = reweighted(parts, likelihoods)
    cut = (2.0 - mean[0]) / sigma
    hazard = norm.pdf(cut) / norm.cdf(cut)
    assert (mean + axes @ new_mean)[0] == pytest.approx(mean[0] - sigma * hazard, abs=0.01)
    found = (axes @ new_covariance @ axes.T)[0, 0]
    assert found == pytest.approx(sigma**2 * (1 - cut * hazard - hazard**2), rel=0.05)


def test_likelihoods_that_are_alike_change_nothing():
    for mean, covariance in BELIEFS.values():
        parts, _ = FloorShares(loop()).parts_of(np.array(mean), covariance)
        new_mean, new_covariance = reweighted(parts, np.full(9, 0.3))
        np.testing.assert_allclose(new_mean, 0, atol=1e-12)
        np.testing.assert_allclose(np.diag(new_covariance), 1, atol=1e-12)


def test_a_correction_is_the_kalman_filters(rng):
    root = rng.normal(size=(6, 6))
    belief = PlaneBelief(1.0, 2.0, 0.3, np.ones(6), np.zeros(3))
    belief.covariance = root @ root.T
    P, mean = belief.covariance.copy(), belief.mean.copy()
    seen, noise = np.array([1.4, 1.7]), np.array([[0.5, 0.1], [0.1, 0.3]])
    H = np.eye(2, 6)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise)
    axes = np.linalg.cholesky(P[:2, :2])
    shifted, shrunk = K[:2] @ (seen - mean[:2]), -K[:2] @ P[:2, :2]
    along = np.linalg.inv(axes)
    belief.correct(along @ shifted, np.eye(2) + along @ shrunk @ along.T, axes)
    np.testing.assert_allclose(belief.mean, mean + K @ (seen - mean[:2]))
    np.testing.assert_allclose(belief.covariance, (np.eye(6) - K @ H) @ P, atol=1e-9)


def test_two_beliefs_together_have_the_moments_of_their_mixture(rng):
    one, other = (PlaneBelief(x, 1.0, yaw, np.full(6, s), np.zeros(3)) for x, yaw, s in ((0, 3.0, 0.1), (2, -3.0, 0.2)))
    pose, covariance = pose_of(one, other, 0.25)
    first = rng.random(100_000) < 0.25
    yaw = np.where(first, 3.0, 2 * np.pi - 3.0)
    points = np.stack([np.where(first, 0.0, 2.0), np.full(len(first), 1.0), yaw], axis=1)
    points += rng.normal(size=points.shape) * np.where(first, 0.1, 0.2)[:, None]
    np.testing.assert_allclose(pose, points.mean(axis=0) - (0, 0, 2 * np.pi), atol=0.01)
    np.testing.assert_allclose(covariance, np.cov(points.T), atol=0.01)


def test_the_jacobian_of_a_step_is_the_numeric_one():
    start = np.array([1.0, 2.0, 0.4, 0.01, 0.02, -0.03])
    step = np.array([0.5, 0.02, 0.3])

    def moved(state):
        mean = state.copy()
        kernels.step(mean, np.zeros((6, 6)), step, np.zeros((3, 3)), np.zeros(3))
        return mean

    d = 1e-6
    numeric = np.stack([(moved(start + d * e) - moved(start - d * e)) / (2 * d) for e in np.eye(6)], axis=1)
    root = np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])
    covariance = root @ root.T
    kernels.step(start.copy(), covariance, step, np.zeros((3, 3)), np.zeros(3))
    np.testing.assert_allclose(covariance, numeric @ root @ root.T @ numeric.T, atol=1e-9)


def test_kernels_are_their_plain_python(rng):
    slow = plain(kernels)
    mean, axes = np.array([3.0, 1.0]), np.array([[0.8, 0.1], [0.0, 0.4]])
    shares = rng.dirichlet(np.ones(3), (30, 40))
    compiled, plainly = (k.parts_in_areas(mean, axes, 15, 17, shares, np.zeros(2), 0.1) for k in (kernels, slow))
    np.testing.assert_allclose(compiled, plainly, atol=1e-12)
    states = [(np.arange(6) / 10, np.eye(6)) for _ in range(2)]
    ways: tuple[Any, Any] = (kernels, slow)
    for k, state in zip(ways, states, strict=True):
        k.step(*state, np.array([0.3, 0.01, 0.1]), np.eye(3) / 100, np.full(3, 1e-4))
    for one, other in zip(*states, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
    odometry, reported = rng.normal(size=50), np.where(rng.random(50) < 0.5, rng.normal(size=50), np.nan)
    for is_increment in (True, False):
        rest = odometry, reported, np.array([0.3, 0.5, 0.2]), np.array([0.4, 0.6, 0.0]), is_increment
        np.testing.assert_allclose(kernels.rectify(*rest), slow.rectify(*rest), atol=1e-12)
