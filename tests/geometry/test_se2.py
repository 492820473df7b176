"""SE(2) against scipy's matrix exponential, the embedding in SE(3), and identities."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, logm

from wheelsight.core.geometry import se2, se3

NEAR_ZERO = [0.0, 1e-300, -1e-12, 1e-8, 9.9e-5, -1.01e-4, 1e-3]

coordinate = st.floats(-10, 10, allow_subnormal=False)
angles = st.floats(-np.pi + 1e-3, np.pi - 1e-3) | st.sampled_from(NEAR_ZERO)
tangents = st.tuples(coordinate, coordinate, angles).map(np.array)
motions = tangents.map(se2.exp)


def hat(xi: np.ndarray) -> np.ndarray:
    vx, vy, omega = xi
    return np.array([[0, -omega, vx], [omega, 0, vy], [0, 0, 0]])


@given(tangents)
def test_exp_is_the_matrix_exponential(xi: np.ndarray) -> None:
    np.testing.assert_allclose(se2.exp(xi), expm(hat(xi)), atol=1e-12)


@settings(max_examples=30)  # logm is slow
@given(tangents)
def test_log_is_the_matrix_logarithm(xi: np.ndarray) -> None:
    np.testing.assert_allclose(hat(se2.log(expm(hat(xi)))), np.real(logm(expm(hat(xi)))), atol=1e-9)


@given(tangents)
def test_log_undoes_exp(xi: np.ndarray) -> None:
    np.testing.assert_allclose(se2.log(se2.exp(xi)), xi, atol=1e-11)


@pytest.mark.parametrize("angle", [np.pi, -np.pi, np.pi - 1e-9, -np.pi + 1e-9])
def test_exp_undoes_log_at_half_a_turn(angle: float) -> None:
    T = se2.from_parts(1.0, -2.0, angle)
    np.testing.assert_allclose(se2.exp(se2.log(T)), T, atol=1e-12)


@given(tangents)
def test_it_is_se3_in_the_plane(xi: np.ndarray) -> None:
    vx, vy, omega = xi
    in_space = se3.exp([vx, vy, 0, 0, 0, omega])
    np.testing.assert_allclose(se2.exp(xi), in_space[np.ix_([0, 1, 3], [0, 1, 3])], atol=1e-12)


@given(motions, motions)
def test_invert_and_compose_are_matrix_algebra(T_a_b: np.ndarray, T_b_c: np.ndarray) -> None:
    np.testing.assert_allclose(se2.invert(T_a_b), np.linalg.inv(T_a_b), atol=1e-11)
    np.testing.assert_allclose(se2.compose(T_a_b, T_b_c, T_a_b), T_a_b @ T_b_c @ T_a_b, atol=1e-12)


@given(coordinate, coordinate, angles)
def test_parts_come_back(x: float, y: float, yaw_rad: float) -> None:
    np.testing.assert_allclose(se2.to_parts(se2.from_parts(x, y, yaw_rad)), (x, y, yaw_rad), atol=1e-14)


@given(motions, st.lists(st.tuples(coordinate, coordinate), max_size=3))
def test_apply_is_the_homogeneous_product(T: np.ndarray, points: list[tuple[float, float]]) -> None:
    p = np.array(points).reshape(-1, 2)
    homogeneous = np.column_stack([p, np.ones(len(p))])
    np.testing.assert_allclose(se2.apply(T, p), (homogeneous @ T.T)[:, :2], atol=1e-11)


@given(st.floats(-100, 100))
def test_a_wrapped_angle_is_the_same_direction_within_half_a_turn(angle_rad: float) -> None:
    wrapped = se2.wrap_angle(angle_rad)
    assert abs(wrapped) <= np.pi
    turns = (angle_rad - wrapped) / (2 * np.pi)
    assert turns == pytest.approx(np.round(turns), abs=1e-12)


@pytest.mark.parametrize("shape", [(0,), (5,), (2, 3)])
def test_batches_are_loops(rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    xi = rng.normal(size=(*shape, 3))
    T = se2.exp(xi)
    assert T.shape == (*shape, 3, 3)
    assert se2.log(T).shape == xi.shape
    for index in np.ndindex(*shape):
        np.testing.assert_allclose(T[index], se2.exp(xi[index]), atol=1e-15)
        np.testing.assert_allclose(se2.log(T)[index], se2.log(T[index]), atol=1e-15)
        np.testing.assert_allclose(se2.invert(T)[index], se2.invert(T[index]), atol=1e-15)


def test_a_quarter_turn_is_a_quarter_circle() -> None:
    radius_m = 2.0
    T = se2.exp([radius_m * np.pi / 2, 0, np.pi / 2])
    np.testing.assert_allclose(T, se2.from_parts(radius_m, radius_m, np.pi / 2), atol=1e-15)
