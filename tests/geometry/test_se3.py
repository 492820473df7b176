"""SE(3) and SO(3) against scipy's matrix exponential and rotations, numeric derivatives, and identities."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from wheelsight.core.geometry import se2, se3, so3

NEAR_ZERO = [0.0, 1e-300, 1e-12, 1e-8, 9.9e-5, 1.01e-4, 1e-3]
NEAR_PI = [np.pi - 1e-3, np.pi - 1e-6, np.pi - 1e-9, np.pi]

coordinate = st.floats(-10, 10, allow_subnormal=False)
vectors = st.tuples(coordinate, coordinate, coordinate).map(np.array)
angles = st.floats(0, np.pi - 1e-3) | st.sampled_from(NEAR_ZERO)
unit_vectors = vectors.filter(lambda v: np.linalg.norm(v) > 0.1).map(lambda v: v / np.linalg.norm(v))
rotation_vectors = st.tuples(angles, unit_vectors).map(lambda pair: pair[0] * pair[1])
tangents = st.tuples(vectors, rotation_vectors).map(np.concatenate)
motions = tangents.map(se3.exp)


def hat(xi: np.ndarray) -> np.ndarray:
    """The 4×4 matrix of a tangent, written out by hand."""
    vx, vy, vz, x, y, z = xi
    return np.array([[0, -z, y, vx], [z, 0, -x, vy], [-y, x, 0, vz], [0, 0, 0, 0]])


@given(tangents)
def test_exp_is_the_matrix_exponential(xi: np.ndarray) -> None:
    np.testing.assert_allclose(se3.exp(xi), expm(hat(xi)), atol=1e-11)


@settings(max_examples=30)  # logm is slow
@given(tangents)
def test_log_is_the_matrix_logarithm(xi: np.ndarray) -> None:
    np.testing.assert_allclose(hat(se3.log(expm(hat(xi)))), np.real(logm(expm(hat(xi)))), atol=1e-9)


@given(tangents)
def test_log_undoes_exp(xi: np.ndarray) -> None:
    np.testing.assert_allclose(se3.log(se3.exp(xi)), xi, atol=1e-11)


@pytest.mark.parametrize("angle", NEAR_ZERO + NEAR_PI)
@pytest.mark.parametrize("axis", [[1.0, 0, 0], [0, -1, 0], [0.6, 0, 0.8], [-0.36, 0.48, 0.8]])
def test_exp_undoes_log_near_zero_and_up_to_half_a_turn(angle: float, axis: list[float]) -> None:
    T = expm(hat(np.array([1, -2, 3, *(angle * np.array(axis))])))
    assert np.linalg.norm(se3.log(T)[3:]) == pytest.approx(angle, abs=1e-9)
    np.testing.assert_allclose(se3.exp(se3.log(T)), T, atol=1e-9)


@given(motions, tangents)
def test_adjoint_carries_a_tangent_to_the_other_side(T: np.ndarray, xi: np.ndarray) -> None:
    np.testing.assert_allclose(T @ se3.exp(xi) @ se3.invert(T), se3.exp(se3.adjoint(T) @ xi), atol=1e-9)


def test_a_positions_covariance_is_that_of_a_pose_perturbed_from_the_left(rng: np.random.Generator) -> None:
    T, roots = se3.exp(rng.normal(size=(4, 6))), rng.normal(size=(4, 6, 6))
    C, step = roots @ np.swapaxes(roots, 1, 2), 1e-6
    moved = [(se3.exp(step * unit) @ T)[:, :3, 3] - (se3.exp(-step * unit) @ T)[:, :3, 3] for unit in np.eye(6)]
    J = np.stack(moved, axis=-1) / (2 * step)
    found = se3.position_covariance(T, C)
    np.testing.assert_allclose(found, J @ C @ np.swapaxes(J, 1, 2), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(se3.position_covariance(T[1], C[1]), found[1], atol=1e-12)


@given(motions, motions)
def test_adjoint_of_a_product_is_the_product_of_adjoints(T_a_b: np.ndarray, T_b_c: np.ndarray) -> None:
    np.testing.assert_allclose(se3.adjoint(T_a_b @ T_b_c), se3.adjoint(T_a_b) @ se3.adjoint(T_b_c), atol=1e-9)


@given(motions)
def test_invert_is_the_matrix_inverse(T: np.ndarray) -> None:
    np.testing.assert_allclose(se3.invert(T), np.linalg.inv(T), atol=1e-10)


@given(motions, motions, motions)
def test_compose_multiplies_from_left_to_right(T_a_b: np.ndarray, T_b_c: np.ndarray, T_c_d: np.ndarray) -> None:
    np.testing.assert_allclose(se3.compose(T_a_b, T_b_c, T_c_d), T_a_b @ T_b_c @ T_c_d, atol=1e-12)


@given(motions, st.lists(vectors, min_size=1, max_size=5).map(np.array))
def test_apply_is_the_homogeneous_product(T: np.ndarray, p: np.ndarray) -> None:
    homogeneous = np.column_stack([p, np.ones(len(p))])
    np.testing.assert_allclose(se3.apply(T, p), (homogeneous @ T.T)[:, :3], atol=1e-11)


@given(motions, tangents, st.floats(0, 1))
def test_interpolation_follows_the_screw(T_start: np.ndarray, xi: np.ndarray, share: float) -> None:
    T_end = se3.exp(xi) @ T_start
    np.testing.assert_allclose(se3.interpolate(T_start, T_end, 0.0), T_start, atol=1e-10)
    np.testing.assert_allclose(se3.interpolate(T_start, T_end, 1.0), T_end, atol=1e-9)
    np.testing.assert_allclose(se3.interpolate(T_start, T_end, share), expm(share * hat(xi)) @ T_start, atol=1e-9)


@given(motions, tangents)
def test_the_midpoint_is_as_far_from_both_ends(T_start: np.ndarray, xi: np.ndarray) -> None:
    T_end = se3.exp(xi) @ T_start
    T_middle = se3.interpolate(T_start, T_end, 0.5)
    np.testing.assert_allclose(T_middle @ se3.invert(T_start), T_end @ se3.invert(T_middle), atol=1e-9)


def test_interpolation_takes_one_pair_and_many_shares(rng: np.random.Generator) -> None:
    T_start, T_end = se3.exp(rng.normal(size=(2, 6)))
    shares = np.linspace(0, 1, 5)
    expected = [se3.interpolate(T_start, T_end, share) for share in shares]
    np.testing.assert_allclose(se3.interpolate(T_start, T_end, shares), expected, atol=1e-14)


@pytest.mark.parametrize("shape", [(0,), (5,), (2, 3)])
def test_batches_are_loops(rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    xi = rng.normal(size=(*shape, 6))
    T = se3.exp(xi)
    q = so3.to_quaternion(T[..., :3, :3])
    assert T.shape == (*shape, 4, 4)
    for index in np.ndindex(*shape):
        np.testing.assert_allclose(T[index], se3.exp(xi[index]), atol=1e-15)
        np.testing.assert_allclose(se3.log(T)[index], se3.log(T[index]), atol=1e-14)
        np.testing.assert_allclose(se3.adjoint(T)[index], se3.adjoint(T[index]), atol=0)
        np.testing.assert_allclose(se3.invert(T)[index], se3.invert(T[index]), atol=1e-15)
        np.testing.assert_allclose(so3.angle(T[..., :3, :3])[index], so3.angle(T[index][:3, :3]), atol=1e-15)
        np.testing.assert_allclose(so3.from_quaternion(q)[index], T[index][:3, :3], atol=1e-14)
    assert se3.log(T).shape == (*shape, 6)
    assert se3.adjoint(T).shape == (*shape, 6, 6)


@given(rotation_vectors)
def test_left_jacobian_is_the_numeric_derivative(omega: np.ndarray) -> None:
    h = 1e-6
    steps = h * np.eye(3)
    forward = so3.log(so3.exp(omega + steps) @ so3.exp(omega).T)
    backward = so3.log(so3.exp(omega - steps) @ so3.exp(omega).T)
    np.testing.assert_allclose(so3.left_jacobian(omega), ((forward - backward) / (2 * h)).T, atol=1e-8)


@pytest.mark.parametrize("angle", NEAR_ZERO + NEAR_PI + [1.0, 2.0])
def test_left_jacobian_is_the_sum_of_its_series(angle: float) -> None:
    W = so3.hat(angle * np.array([2, -1, 2]) / 3)
    term, total = np.eye(3), np.eye(3)
    for n in range(1, 40):
        term = term @ W / (n + 1)
        total = total + term
    np.testing.assert_allclose(so3.left_jacobian(angle * np.array([2, -1, 2]) / 3), total, atol=1e-14)


@given(vectors, vectors)
def test_hat_is_the_cross_product(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(so3.hat(a) @ b, np.cross(a, b), atol=1e-12)


@given(rotation_vectors, st.floats(0.1, 10))
def test_quaternions_agree_with_scipy(omega: np.ndarray, norm: float) -> None:
    rotation = Rotation.from_rotvec(omega)
    q = so3.to_quaternion(rotation.as_matrix())
    np.testing.assert_allclose(q * np.sign(q @ rotation.as_quat()), rotation.as_quat(), atol=1e-12)
    assert q[3] >= 0
    np.testing.assert_allclose(so3.from_quaternion(norm * q), rotation.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(so3.from_quaternion(-q), rotation.as_matrix(), atol=1e-12)
    assert so3.angle(rotation.as_matrix()) == pytest.approx(np.linalg.norm(omega), abs=1e-9)


def test_quaternions_are_written_x_y_z_w() -> None:
    quarter_turn_about_z = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]
    T = se3.from_quaternion([1, 2, 3], quarter_turn_about_z)
    np.testing.assert_allclose(T, [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-15)


def test_the_nearest_rotation_beats_all_others(rng: np.random.Generator) -> None:
    M = so3.exp(rng.normal(size=(20, 3))) + 0.3 * rng.normal(size=(20, 3, 3))
    M[0] = np.diag([1.0, 1.0, -1.0]) + 0.01 * rng.normal(size=(3, 3))
    R = so3.nearest(M)
    assert se3.is_valid(se3.from_parts(R, np.zeros((20, 3))), tolerance=1e-12)
    for near_rotation in so3.exp(rng.normal(scale=0.05, size=(50, 3))):
        others = np.linalg.norm(near_rotation @ R - M, axis=(1, 2))
        assert (np.linalg.norm(R - M, axis=(1, 2)) <= others).all()


def test_a_rotation_is_its_own_nearest(rng: np.random.Generator) -> None:
    R = so3.exp(rng.normal(size=(4, 5, 3)))
    np.testing.assert_allclose(so3.nearest(R), R, atol=1e-14)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda T: T[:3],
        lambda T: T * np.diag([1, 1, -1, 1]),
        lambda T: T + 1e-3 * np.eye(4),
        lambda T: T + np.array([[0] * 4] * 3 + [[0, 0, 1e-3, 0]]),
        lambda T: np.where(np.eye(4, dtype=bool), np.nan, T),
        lambda T: np.stack([T, 2 * T]),
    ],
    ids=["shape", "reflection", "stretched", "last row", "NaN", "second of a batch"],
)
def test_what_is_no_rigid_motion_is_not_valid(spoil) -> None:
    T = se3.exp([1, 2, 3, 0.1, 0.2, 0.3])
    assert se3.is_valid(T, tolerance=1e-6)
    assert not se3.is_valid(spoil(T), tolerance=1e-6)


def test_a_motion_in_the_plane_is_that_of_se2_in_space(rng: np.random.Generator) -> None:
    x, y, yaw = rng.uniform(-3, 3, (3, 5))
    T = se3.from_plane(x, y, yaw)
    np.testing.assert_allclose(T[:, [0, 1, 3]][:, :, [0, 1, 3]], se2.from_parts(x, y, yaw), atol=1e-15)
    np.testing.assert_array_equal(T[:, 2], np.tile([0.0, 0.0, 1.0, 0.0], (5, 1)))
    assert se3.is_valid(T)
    assert se3.from_plane(1.0, 2.0, 0.3).shape == (4, 4)


@given(motions, st.integers(0, 2**32 - 1))
def test_nearest_takes_rounding_out_and_leaves_motions_alone(T: np.ndarray, seed: int) -> None:
    np.testing.assert_allclose(se3.nearest(T), T, atol=1e-14)
    rough = T.copy()
    rough[:3, :3] += 1e-4 * np.random.default_rng(seed).uniform(-1, 1, (3, 3))
    mended = se3.nearest(rough)
    assert se3.is_valid(mended, tolerance=1e-12)
    np.testing.assert_array_equal(mended[:3, 3], T[:3, 3])
    off = np.linalg.norm(mended - rough)
    # No rotation lies nearer: not the true one, nor any beside the one found.
    assert off <= np.linalg.norm(T - rough) + 1e-15
    for turn in 1e-4 * np.concatenate([np.eye(3), -np.eye(3)]):
        beside = se3.from_parts(so3.exp(turn) @ mended[:3, :3], T[:3, 3])
        assert np.linalg.norm(beside - rough) > off


def test_nearest_ends_what_inverses_double() -> None:
    """Transposing takes a rotation that is none for its inverse, and squares how wrong it is, again and again."""
    T = se3.exp([0.3, -0.2, 0.1, 0.5, -0.4, 0.9])
    T[:3, :3] *= 1 + 1e-9
    rough, kept = T, se3.nearest(T)
    for _ in range(20):
        rough = rough @ se3.invert(rough) @ rough
        kept = se3.nearest(kept @ se3.invert(kept) @ kept)
    assert not se3.is_valid(rough, tolerance=1e-3)
    np.testing.assert_allclose(kept, se3.nearest(T), atol=1e-12)


@given(motions, motions)
def test_view_shift_is_the_way_and_the_turn(T_a: np.ndarray, T_b: np.ndarray) -> None:
    T = np.array([T_a, T_b])
    turned = [Rotation.from_matrix(R).magnitude() for R in T[:, :3, :3]]
    np.testing.assert_allclose(se3.view_shift_m(T), np.sqrt((T[:, :3, 3] ** 2).sum(axis=1)) + 1.5 * np.array(turned))


@pytest.mark.parametrize("angle", NEAR_ZERO + [1.0, 2.0] + NEAR_PI)
@given(axis=unit_vectors)
def test_one_rotation_is_as_the_same_in_a_batch(axis: np.ndarray, angle: float) -> None:
    """Single ones take a way of their own: the batch goes through scipy."""
    omega = angle * axis
    R = Rotation.from_rotvec(omega).as_matrix()
    one, batch = so3.log(R), so3.log(R[None])[0]
    # Half a turn has two names.
    assert min(np.abs(one - batch).max(), np.abs(one + batch).max() if angle > 3.14 else np.inf) < 1e-8
    np.testing.assert_allclose(so3.angle(R), so3.angle(R[None])[0], atol=1e-12)
    np.testing.assert_allclose(so3.hat(omega), so3.hat(omega[None])[0])
    np.testing.assert_allclose(so3.left_jacobian(omega), so3.left_jacobian(omega[None])[0], atol=1e-12)


def test_a_mirrored_matrix_is_no_rotation() -> None:
    for R in (np.diag([1.0, 1.0, -1.0]), np.zeros((3, 3))):
        for given_ in (R, R[None]):
            with pytest.raises(ValueError, match=r"determinant|mirrored"):
                so3.log(given_)


def test_what_is_rigid_is_left_to_the_bit_and_the_rest_is_mended() -> None:
    T = se3.exp(np.random.default_rng(3).standard_normal((3, 6)))
    bent = T.copy()
    bent[1, :3, :3] *= 1 + 1e-6
    found = se3.renormalized(bent)
    np.testing.assert_array_equal(found[[0, 2]], T[[0, 2]])
    np.testing.assert_allclose(found[1], T[1], atol=1e-12)
    np.testing.assert_array_equal(se3.renormalized(T[0]), T[0])


@given(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6), st.integers(0, 15), st.floats(-3e-6, 3e-6))
def test_validity_is_that_of_allclose(xi: list[float], place: int, off: float) -> None:
    T = se3.exp(np.array(xi))
    T.ravel()[place] += off
    R = T[:3, :3]
    close = np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.allclose(T[3], (0, 0, 0, 1), atol=1e-6)
    assert se3.is_valid(T) == close
