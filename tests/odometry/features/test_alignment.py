from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from wheelsight.core.estimates import Reason
from wheelsight.core.geometry import se3
from wheelsight.vision.features.tracking import PointPairs, find_motion, refine_motion

SIGMA_XY, TRIALS = 0.002, 300


def depth_sigma(depth_m: np.ndarray) -> np.ndarray:
    return 0.001 + 1.425e-3 * depth_m**2


def pairs_of(rng, T, n: int = 150, noise: float = 1.0, outliers: float = 0.0, without_depth: float = 0.0, view=None):
    """Pairs of n points before the camera, seen with the noise that they state, or with `noise` times that."""
    xy, z = (rng.uniform(-0.5, 0.5, (n, 2)), rng.uniform(1, 4, n)) if view is None else view
    p_reference = se3.apply(se3.invert(T), np.column_stack([xy * z[:, None], z]))
    sigma_xy, sigma_m = np.full(n, SIGMA_XY), depth_sigma(z)
    xy = xy + noise * sigma_xy[:, None] * rng.standard_normal((n, 2))
    z = z + noise * sigma_m * rng.standard_normal(n)
    wrong = rng.permutation(n)[: round(outliers * n)]
    xy[wrong], z[wrong] = rng.uniform(-0.5, 0.5, (len(wrong), 2)), rng.uniform(1, 4, len(wrong))
    z[rng.permutation(n)[: round(without_depth * n)]] = 0
    return PointPairs(p_reference, xy, z, sigma_xy, sigma_m)


def motion(rng) -> np.ndarray:
    return se3.exp(rng.uniform(-0.1, 0.1, 6))


def errors_and_covariances(rng, **how):
    """Errors (TRIALS, 6) as left perturbations, and the covariances (TRIALS, 6, 6) stated with them."""
    T = motion(rng)
    view = rng.uniform(-0.5, 0.5, (150, 2)), rng.uniform(1, 4, 150)
    found = [refine_motion(pairs_of(rng, T, view=view, **how), T) for _ in range(TRIALS)]
    errors = np.array([se3.log(one.T_current_reference @ se3.invert(T)) for one in found])
    return errors, np.array([one.covariance for one in found])


def mean_nees(errors, covariances) -> float:
    return float(np.mean([e @ np.linalg.solve(C, e) for e, C in zip(errors, covariances, strict=True)])) / 6


@pytest.mark.parametrize("how", [{}, {"outliers": 0.3}, {"without_depth": 0.5}])
def test_the_covariance_is_honest_on_the_safe_side(rng, how):
    """Robust weights count each pair for less than it is worth, so the stated covariance is somewhat too large.

    For Gaussian residuals of three components and Geman and McClure's weights at c = 16.3/2, H is about 0.59 of the
    full information while the estimate loses a little: NEES/6 is about 0.75 (0.71 to 0.78 measured).
    """
    errors, covariances = errors_and_covariances(rng, **how)
    low, high = chi2.ppf([0.005, 0.995], 6 * TRIALS) / (6 * TRIALS)
    nees = mean_nees(errors, covariances)
    assert 0.5 < nees < high
    assert nees < low  # not merely consistent: on the safe side, beyond chance
    empirical = errors.T @ errors / TRIALS
    ratio = np.linalg.eigvals(np.linalg.solve(covariances.mean(axis=0), empirical)).real
    assert ratio.min() > 0.3
    assert ratio.max() < 1.1


def test_the_error_has_no_bias(rng):
    errors, _ = errors_and_covariances(rng)
    spread = np.linalg.inv(np.cov(errors.T) / TRIALS)
    assert errors.mean(axis=0) @ spread @ errors.mean(axis=0) < chi2.ppf(0.999, 6)


def test_noise_twice_as_large_as_stated_shows(rng):
    assert mean_nees(*errors_and_covariances(rng, noise=2.0)) > 1.5


@pytest.mark.parametrize("outliers", [0.0, 0.3, 0.6])
def test_the_motion_is_found_and_the_right_pairs_distinguished(rng, outliers):
    for seed in range(5):
        T = motion(rng)
        pairs = pairs_of(rng, T, 200, noise=0.0, outliers=outliers)
        rough = find_motion(pairs, seed)
        assert not isinstance(rough, Reason)
        found = refine_motion(pairs, rough)
        np.testing.assert_allclose(found.T_current_reference, T, atol=1e-6 if outliers == 0 else 2e-3)
        right = round((1 - outliers) * 200)
        assert right <= found.inliers <= right + 5
        assert found.inliers == found.is_inlier.sum()


def test_one_seed_gives_one_motion(rng):
    pairs = pairs_of(rng, motion(rng), outliers=0.4)
    np.testing.assert_array_equal(
        find_motion(pairs, 11, iterations=50),
        find_motion(pairs, 11, iterations=50),
    )


def test_too_few_pairs_with_depth_are_too_few_matches(rng):
    pairs = pairs_of(rng, motion(rng), 100, without_depth=0.9)
    assert find_motion(pairs, 0) is Reason.TOO_FEW_MATCHES
    assert not isinstance(find_motion(pairs, 0, min_inliers=10), Reason)


def test_pairs_that_do_not_belong_together_are_too_few_inliers(rng):
    assert find_motion(pairs_of(rng, motion(rng), 100, outliers=1.0), 0) is Reason.TOO_FEW_INLIERS


def test_what_pairs_say_nothing_about_is_very_uncertain_never_infinite(rng):
    none = pairs_of(rng, motion(rng), 0)
    found = refine_motion(none, np.eye(4))
    np.testing.assert_array_equal(found.T_current_reference, np.eye(4))
    np.testing.assert_allclose(found.covariance, 1e6 * np.eye(6))
    assert found.inliers == 0


def test_points_in_one_small_patch_leave_the_motion_uncertain(rng):
    T = motion(rng)
    spread, patch = ((rng.uniform(-r, r, (100, 2)), rng.uniform(2 - r, 2 + r, 100)) for r in (0.5, 0.01))
    wide, narrow = (refine_motion(pairs_of(rng, T, 100, view=view), T).covariance for view in (spread, patch))
    assert np.linalg.eigvalsh(narrow)[-1] > 100 * np.linalg.eigvalsh(wide)[-1]
