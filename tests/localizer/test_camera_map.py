"""Anchor: motions and covariances under known transforms, against numbers found by perturbing poses."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from narrowing import not_none

from wheelsight.core.estimates import MotionEstimate, Reason, with_view_noise
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.estimation.fusion_localizer import Anchor

_SCALE = np.array([1.0, 1, 1, 2, 2, 2])  # of degenerate directions (v, ω · 2 m)
tangents = st.lists(st.floats(-1.2, 1.2), min_size=6, max_size=6).map(np.array)
seeds = st.integers(0, 2**32 - 1)


def some_covariance(rng: np.random.Generator) -> FloatArray:
    A = 1e-2 * rng.standard_normal((6, 6))
    return np.asarray(A @ A.T)


def motion(T: FloatArray, covariance: FloatArray, hidden: FloatArray | None = None) -> MotionEstimate:
    return MotionEstimate(T, covariance, None, 90, 70, hidden)


def numeric(moved: object, about: FloatArray) -> FloatArray:
    """Jacobian (6, 6) of the left perturbation of `moved(ξ)`, which is `about` at 0, by ξ."""
    h = 1e-6
    columns = [(se3.log(moved(d) @ se3.invert(about)) - se3.log(moved(-d) @ se3.invert(about))) for d in h * np.eye(6)]  # type: ignore[operator]
    return np.transpose(columns) / (2 * h)


@settings(max_examples=30)
@given(tangents, tangents, tangents, seeds)
def test_a_motion_is_reported_from_the_anchor_with_what_its_alignment_left_uncertain(
    anchor: FloatArray, reference: FloatArray, by: FloatArray, seed: int
) -> None:
    T_odom_anchor, T_map_reference, T_reference_now = se3.exp(anchor), se3.exp(reference), se3.exp(by)
    covariance = some_covariance(np.random.default_rng(seed))
    reported = Anchor(T_odom_anchor, np.zeros((6, 6))).motion_to(
        T_map_reference @ T_reference_now, motion(T_reference_now, covariance)
    )

    def moved(xi: FloatArray) -> FloatArray:
        return np.asarray(se3.invert(T_odom_anchor) @ T_map_reference @ se3.exp(xi) @ T_reference_now)

    np.testing.assert_allclose(not_none(reported.T_reference_current), moved(np.zeros(6)), atol=1e-12)
    J = numeric(moved, moved(np.zeros(6)))
    np.testing.assert_allclose(not_none(reported.covariance), J @ covariance @ J.T, atol=1e-8)
    assert (reported.reason, reported.matches, reported.inliers, reported.degenerate) == (None, 90, 70, None)


@settings(max_examples=30)
@given(tangents, tangents, seeds)
def test_an_anchors_own_uncertainty_is_that_of_its_frame(reference: FloatArray, by: FloatArray, seed: int) -> None:
    """As a left perturbation in the frame itself: T_map_camera exp(ξ)."""
    T_map_reference, T_reference_now = se3.exp(reference), se3.exp(by)
    covariance = some_covariance(np.random.default_rng(seed))
    T_map_camera = T_map_reference @ T_reference_now
    anchor = Anchor.at(T_map_camera, motion(T_reference_now, covariance))

    def seen_from_it(xi: FloatArray) -> FloatArray:
        return np.asarray(se3.invert(T_map_camera) @ T_map_reference @ se3.exp(xi) @ T_reference_now)

    J = numeric(seen_from_it, np.eye(4))
    np.testing.assert_allclose(anchor.covariance, J @ covariance @ J.T, atol=1e-8)


@settings(max_examples=30)
@given(tangents, tangents, tangents, st.integers(1, 5), seeds)
def test_hidden_directions_span_the_same_motions_from_the_anchor(
    anchor: FloatArray, reference: FloatArray, by: FloatArray, count: int, seed: int
) -> None:
    hidden = np.linalg.qr(np.random.default_rng(seed).standard_normal((6, count)))[0].T
    T_odom_anchor, T_map_reference, T_reference_now = se3.exp(anchor), se3.exp(reference), se3.exp(by)
    T_odom_now = T_map_reference @ T_reference_now
    at = Anchor(T_odom_anchor, np.zeros((6, 6)))
    reported = at.motion_to(T_odom_now, motion(T_reference_now, 1e-6 * np.eye(6), hidden))
    assert reported.degenerate is not None
    np.testing.assert_allclose(reported.degenerate @ reported.degenerate.T, np.eye(count), atol=1e-9)
    # The camera moved a little along each hidden direction of its reference, as the anchor sees it.
    for direction in hidden:
        moved = T_map_reference @ se3.exp(1e-6 * direction / _SCALE) @ T_reference_now
        xi = se3.log(se3.invert(T_odom_anchor) @ moved @ se3.invert(se3.invert(T_odom_anchor) @ T_odom_now))
        xi = _SCALE * xi / 1e-6
        outside = xi - reported.degenerate.T @ (reported.degenerate @ xi)
        assert np.linalg.norm(outside) < 1e-4 * np.linalg.norm(xi)


def test_a_view_that_hides_nothing_hides_nothing_from_the_anchor() -> None:
    nothing = motion(np.eye(4), 1e-6 * np.eye(6), np.zeros((0, 6)))
    assert Anchor(np.eye(4), np.zeros((6, 6))).motion_to(se3.exp(0.1 * np.ones(6)), nothing).degenerate is None


def test_a_pose_that_rounding_made_no_motion_becomes_one(rng: np.random.Generator) -> None:
    T = se3.exp(rng.standard_normal(6))
    rough = T.copy()
    rough[:3, :3] *= 1 + 1e-5
    reported = Anchor(np.eye(4), np.zeros((6, 6))).motion_to(rough, motion(np.eye(4), np.eye(6)))
    assert reported.T_reference_current is not None
    assert not se3.is_valid(rough)
    assert se3.is_valid(reported.T_reference_current, tolerance=1e-12)
    np.testing.assert_allclose(reported.T_reference_current, T, atol=1e-12)


def test_errors_of_views_add_up_along_the_way_in_the_frames_own_axes() -> None:
    """Half a metre ahead and half a radian: by the closed form 0.5 m + 0.75 m of way."""
    of_frame = np.diag(np.square([3e-3, 2e-3, 1e-3, 4e-3, 5e-3, 6e-3]))
    T, before = se3.from_parts(np.eye(3), [0.0, 0.0, 0.5]), np.diag([1e-6] * 6)
    T[:3, :3] = se3.exp(np.array([0, 0, 0, 0, 0.5, 0]))[:3, :3]
    widened = with_view_noise(motion(T, before), of_frame, 25.0).covariance
    Ad_back = np.linalg.inv(se3.adjoint(T))
    walked = Ad_back @ (not_none(widened) - before) @ Ad_back.T
    np.testing.assert_allclose(walked, 25.0 * motions.view_shift_m(T) * of_frame, atol=1e-12)
    np.testing.assert_allclose(motions.view_shift_m(T), 1.25, atol=1e-9)


def test_a_camera_that_stands_or_saw_nothing_strays_nowhere() -> None:
    of_frame, here = np.diag([1e-6] * 6), motion(np.eye(4), np.diag([1e-6] * 6))
    np.testing.assert_array_equal(not_none(with_view_noise(here, of_frame, 25.0).covariance), np.diag([1e-6] * 6))
    nothing = MotionEstimate.failed(Reason.DEGENERATE)
    assert with_view_noise(nothing, of_frame, 25.0) is nothing
