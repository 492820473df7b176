"""Two beliefs as one: moments of a mixture, and what covers another belief."""

from __future__ import annotations

import numpy as np
import pytest
from fusion.error_state.test_pose_belief import SETTINGS, belief_somewhere, difference, look_at

from wheelsight.core.geometry import se3
from wheelsight.estimation.fault_detection import covering, covering_pose, mixed
from wheelsight.estimation.pose_belief import LAG


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_mixture_has_the_moments_of_both(rng, share):
    one = belief_somewhere(rng)
    other = one.retracted(rng.normal(size=len(one.covariance)) * 1e-3, 2 * one.covariance)
    found = mixed(one, other, share)
    apart = difference(other, one)
    np.testing.assert_allclose(difference(found, one), share * apart, atol=1e-5)
    expected = (1 - share) * one.covariance + share * other.covariance + share * (1 - share) * np.outer(apart, apart)
    np.testing.assert_allclose(found.covariance, expected, atol=1e-5)


def test_covering_reaches_another_belief_however_it_is_turned(rng):
    one = belief_somewhere(rng)
    far = np.zeros(len(one.covariance))
    far[:6] = [1.0, -2.0, 0.0, 0.0, 0.0, 1.5]
    other = one.retracted(far, one.covariance)
    found = covering(one, other, since_s=0.0, sigmas=2.5)
    t = one.T[0][:3, 3]
    J = np.concatenate([np.eye(3), -np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])], axis=1)
    C, off = (J @ found.covariance[:6, :6] @ J.T)[:2, :2], (other.T[0] - one.T[0])[:2, 3]
    assert np.sqrt(off @ np.linalg.solve(C, off)) < 3


def test_what_both_are_uncertain_of_counts_once(rng):
    one = belief_somewhere(rng)
    np.testing.assert_allclose(covering(one, one, since_s=0.0, sigmas=2.5).covariance, one.covariance, atol=1e-12)


def test_covering_is_as_uncertain_as_another_belief_everywhere(rng):
    """Of poses with the twist and the lag known, by which the camera has them apart."""
    one = belief_somewhere(rng)
    A = 0.1 * rng.normal(size=one.covariance.shape)
    other = one.retracted(np.zeros(len(A)), one.covariance / 2 + A @ A.T)
    found, given = covering(one, other, since_s=0.0, sigmas=2.5), one.aux_offset + np.array([0, 1, 2, LAG])

    def of_poses(P):
        return P[: one.aux_offset, : one.aux_offset] - P[: one.aux_offset, given] @ np.linalg.solve(
            P[np.ix_(given, given)], P[given, : one.aux_offset]
        )

    for belief in (one, other):
        more = of_poses(found.covariance) - of_poses(belief.covariance)
        assert np.linalg.eigvalsh(more)[0] > -1e-10


def test_what_covers_another_belief_knows_the_way_since_a_clone_as_well_as_before(rng):
    """Only a measurement at a pose from before both went apart says which of them is right."""
    one = belief_somewhere(rng, 1).cloned("late", 9.0, 4)
    far = np.zeros(len(one.covariance))
    far[[0, 1, 5]] = [0.1, -0.2, 0.3]
    far[12:18] = 0.9 * far[:6]
    found = covering(one, one.retracted(far, one.covariance), since_s=5.0, sigmas=2.5)
    for name, is_wider in (("late", False), ("clone 0", True)):
        before, after = (b.innovation(look_at(one, name, np.random.default_rng(0)), SETTINGS) for b in (one, found))
        wider = np.linalg.eigvalsh(after.covariance)[-1] / np.linalg.eigvalsh(before.covariance)[-1]
        assert (wider > 3) == is_wider


@pytest.mark.parametrize("sigmas", [1.0, 2.5])
def test_a_pose_covers_another_at_so_many_standard_deviations(sigmas: float) -> None:
    T_one, T_other = se3.exp([1.0, 2.0, 0.0, 0.0, 0.0, 0.5]), se3.exp([1.3, 1.8, 0.0, 0.0, 0.0, 0.9])
    T, C = covering_pose(T_one, np.zeros((6, 6)), T_other, np.zeros((6, 6)), sigmas)
    np.testing.assert_array_equal(T, T_one)
    moved = se3.log(T_other @ se3.invert(T_one))
    values, axes = np.linalg.eigh(C)
    assert values[:5] == pytest.approx(0.0, abs=1e-12)  # it may be elsewhere in that direction only
    apart = np.concatenate([T_other[:3, 3] - T_one[:3, 3] - np.cross(moved[3:], T_one[:3, 3]), moved[3:]])
    assert abs(axes[:, 5] @ apart) / np.sqrt(values[5]) == pytest.approx(sigmas)
