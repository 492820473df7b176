"""Kernels of one motion against those of batches, numeric derivatives, and identities."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.geometry import se3

tangents = st.lists(st.floats(-1.7, 1.7), min_size=6, max_size=6).map(np.array)


@given(tangents)
def test_one_motion_is_treated_as_each_of_a_batch(xi):
    T = motions.exp(xi)
    np.testing.assert_allclose(T, se3.exp(xi), atol=1e-12)
    np.testing.assert_allclose(motions.log(T), se3.log(T), atol=1e-9)
    np.testing.assert_allclose(motions.adjoint(T), se3.adjoint(T), atol=1e-12)
    np.testing.assert_allclose(motions.inverse(T), se3.invert(T), atol=1e-12)
    np.testing.assert_allclose(motions.inverse_adjoint(T), se3.adjoint(se3.invert(T)), atol=1e-12)
    assert motions.view_shift_m(T) == pytest.approx(float(se3.view_shift_m(T)), abs=1e-9)


@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e-4, 1e-3, 1e-2, 0.3, 1.0])
def test_left_jacobian_against_a_numeric_one(rng, scale):
    xi, h = rng.normal(size=6) * scale, 1e-6
    back = se3.invert(se3.exp(xi))
    columns = [(se3.log(se3.exp(xi + d) @ back) - se3.log(se3.exp(xi - d) @ back)) / (2 * h) for d in h * np.eye(6)]
    np.testing.assert_allclose(motions.left_jacobian(xi), np.transpose(columns), atol=1e-8)


@pytest.mark.parametrize("angle", [np.pi - 1e-7, np.pi])
def test_log_of_half_a_turn(angle):
    for axis in np.eye(3):
        T = se3.exp(np.r_[0.3, -0.2, 0.1, angle * axis])
        np.testing.assert_allclose(se3.exp(motions.log(T)), T, atol=1e-6)


@given(tangents, st.integers(0, 2**32 - 1))
def test_what_rounding_made_no_rotation_is_mended_to_the_nearest(xi, seed):
    rough = se3.exp(xi)
    rough[:3, :3] += 1e-5 * np.random.default_rng(seed).normal(size=(3, 3))
    assert not se3.is_valid(rough, tolerance=1e-9)
    np.testing.assert_allclose(motions.renormalized(rough), se3.nearest(rough), atol=1e-13)


@given(tangents, st.integers(0, 2**32 - 1))
def test_a_covariance_is_carried_with_its_perturbation(xi, seed):
    """Of many small δ, T exp(δ) T⁻¹ is spread as `carried` says."""
    T, A = se3.exp(xi), 1e-5 * np.random.default_rng(seed).normal(size=(6, 6))
    there = np.transpose([se3.log(T @ se3.exp(column) @ se3.invert(T)) for column in A.T])
    np.testing.assert_allclose(motions.carried(T, A @ A.T), there @ there.T, rtol=1e-3, atol=1e-14)
