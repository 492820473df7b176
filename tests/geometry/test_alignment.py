"""Closed-form alignment: known motions, scipy, OpenCV, evo, and a brute-force search; what must be refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from evo.core.geometry import umeyama_alignment
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from wheelsight.core.errors import DegenerateGeometryError
from wheelsight.core.geometry import align_points, align_points_with_scale, se3, so3

seeds = st.integers(0, 2**32 - 1)
MIRROR = np.diag([1.0, 1.0, -1.0])


def random_motion(rng: np.random.Generator) -> np.ndarray:
    return se3.from_parts(Rotation.random(rng=rng).as_matrix(), rng.normal(scale=3.0, size=3))


def noisy_pair(rng: np.random.Generator, n: int = 30, noise_m: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    p_b = rng.normal(scale=[2.0, 1.0, 0.5], size=(n, 3))
    return se3.apply(random_motion(rng), p_b) + rng.normal(scale=noise_m, size=(n, 3)), p_b


def squared_error(T_a_b: np.ndarray, p_a: np.ndarray, p_b: np.ndarray, weights: np.ndarray) -> float:
    return float(weights @ ((p_a - se3.apply(T_a_b, p_b)) ** 2).sum(axis=1))


@given(seeds, st.integers(3, 40))
def test_a_known_motion_is_found(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    T_a_b, p_b = random_motion(rng), rng.normal(size=(n, 3))
    np.testing.assert_allclose(align_points(se3.apply(T_a_b, p_b), p_b), T_a_b, atol=1e-6 if n == 3 else 1e-9)


@given(seeds, st.floats(0.01, 100))
def test_a_known_scale_is_found(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    T_a_b, p_b = random_motion(rng), rng.normal(size=(20, 3))
    T, found = align_points_with_scale(se3.apply(T_a_b, scale * p_b), p_b)
    assert found == pytest.approx(scale, rel=1e-12)
    np.testing.assert_allclose(T, T_a_b, atol=1e-9)


@given(seeds)
def test_a_plane_determines_the_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_a_b, p_b = random_motion(rng), rng.normal(size=(12, 3)) * [1, 1, 0]
    np.testing.assert_allclose(align_points(se3.apply(T_a_b, p_b), p_b), T_a_b, atol=1e-9)


@given(seeds)
def test_the_rotation_is_scipys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p_a, p_b = noisy_pair(rng)
    weights = rng.uniform(0.1, 5.0, len(p_a))
    mean_a, mean_b = np.average(p_a, axis=0, weights=weights), np.average(p_b, axis=0, weights=weights)
    rotation, _ = Rotation.align_vectors(p_a - mean_a, p_b - mean_b, weights=weights)
    T_a_b = align_points(p_a, p_b, weights)
    np.testing.assert_allclose(T_a_b[:3, :3], rotation.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(T_a_b[:3, 3], mean_a - rotation.apply(mean_b), atol=1e-9)


@pytest.mark.parametrize("with_scale", [False, True])
def test_motion_and_scale_are_evos(rng: np.random.Generator, with_scale: bool) -> None:
    for mirror in (np.eye(3), MIRROR):
        p_a, p_b = noisy_pair(rng)
        p_b = p_b @ mirror
        R, t, scale = umeyama_alignment(p_b.T, p_a.T, with_scale)
        T_a_b, found_scale = align_points_with_scale(p_a, p_b, with_scale=with_scale)
        np.testing.assert_allclose(T_a_b, se3.from_parts(R, t), atol=1e-12)
        assert found_scale == pytest.approx(scale, rel=1e-12)


def test_motion_and_scale_are_opencvs(rng: np.random.Generator) -> None:
    p_a, p_b = noisy_pair(rng)
    expected, expected_scale = cv2.estimateAffine3D(p_b, p_a, force_rotation=True)
    T_a_b, scale = align_points_with_scale(p_a, p_b)
    np.testing.assert_allclose(T_a_b[:3], expected, atol=1e-9)
    assert scale == pytest.approx(expected_scale, rel=1e-9)


@given(seeds)
def test_mirrored_points_get_the_best_proper_rotation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p_a, p_b = noisy_pair(rng, noise_m=0.02)
    p_a = p_a @ MIRROR
    T_a_b, weights = align_points(p_a, p_b), np.ones(len(p_a))
    assert se3.is_valid(T_a_b, tolerance=1e-12)
    expected, _ = Rotation.align_vectors(p_a - p_a.mean(axis=0), p_b - p_b.mean(axis=0))
    error = squared_error(T_a_b, p_a, p_b, weights)
    T_expected = se3.from_parts(expected.as_matrix(), p_a.mean(axis=0) - expected.apply(p_b.mean(axis=0)))
    assert error <= squared_error(T_expected, p_a, p_b, weights) * (1 + 1e-12)


@pytest.mark.parametrize("mirror", [np.eye(3), MIRROR], ids=["proper", "mirrored"])
def test_a_brute_force_search_finds_nothing_better(rng: np.random.Generator, mirror: np.ndarray) -> None:
    p_a, p_b = noisy_pair(rng, noise_m=0.2)
    p_a, weights = p_a @ mirror, rng.uniform(0.0, 2.0, len(p_a))
    best = squared_error(align_points(p_a, p_b, weights), p_a, p_b, weights)

    def cost(xi: np.ndarray) -> float:
        return squared_error(se3.exp(xi), p_a, p_b, weights)

    starts = [np.concatenate([p_a.mean(axis=0), omega]) for omega in Rotation.random(12, rng=rng).as_rotvec()]
    found = min(minimize(cost, start, method="BFGS").fun for start in starts)
    assert best <= found * (1 + 1e-9)
    assert found == pytest.approx(best, rel=1e-4)


@given(seeds)
def test_moving_either_set_moves_the_answer(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p_a, p_b = noisy_pair(rng)
    T_a_b, T_c_a, T_d_b = align_points(p_a, p_b), random_motion(rng), random_motion(rng)
    moved = align_points(se3.apply(T_c_a, p_a), se3.apply(T_d_b, p_b))
    np.testing.assert_allclose(moved, T_c_a @ T_a_b @ se3.invert(T_d_b), atol=1e-9)


def test_exchanging_the_sets_inverts_the_answer(rng: np.random.Generator) -> None:
    p_a, p_b = noisy_pair(rng)
    np.testing.assert_allclose(align_points(p_b, p_a), se3.invert(align_points(p_a, p_b)), atol=1e-12)


def test_a_whole_weight_is_a_repeated_pair(rng: np.random.Generator) -> None:
    p_a, p_b = noisy_pair(rng)
    counts = rng.integers(0, 4, len(p_a))
    repeated = align_points(np.repeat(p_a, counts, axis=0), np.repeat(p_b, counts, axis=0))
    np.testing.assert_allclose(align_points(p_a, p_b, counts), repeated, atol=1e-12)


def test_a_pair_without_weight_does_not_count(rng: np.random.Generator) -> None:
    p_a, p_b = noisy_pair(rng)
    outliers = p_a.copy()
    outliers[:5] += 1000.0
    weights = np.repeat([0.0, 1.0], [5, len(p_a) - 5])
    np.testing.assert_allclose(align_points(outliers, p_b, weights), align_points(p_a[5:], p_b[5:]), atol=1e-9)


def test_noise_averages_out(rng: np.random.Generator) -> None:
    T_a_b, p_b = random_motion(rng), rng.normal(size=(20_000, 3))
    p_a = se3.apply(T_a_b, p_b) + rng.normal(scale=0.05, size=p_b.shape)
    error = se3.log(align_points(p_a, p_b) @ se3.invert(T_a_b))
    assert np.linalg.norm(error[3:]) < 5 * 0.05 / np.sqrt(len(p_b))


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("offset_m", [0.0, 1.0, 1e3])
def test_the_answer_does_not_hang_on_size_or_place(rng: np.random.Generator, scale: float, offset_m: float) -> None:
    p_b = scale * (rng.normal(size=(20, 3)) + offset_m)
    T_a_b = se3.from_parts(Rotation.random(rng=rng).as_matrix(), scale * rng.normal(size=3))
    found = align_points(se3.apply(T_a_b, p_b), p_b)
    np.testing.assert_allclose(found[:3, :3], T_a_b[:3, :3], atol=1e-9)


LINE = np.linspace(0, 1, 10)[:, None] * [1.0, 2.0, -1.0]
CUBE = np.array(np.meshgrid([-1.0, 1], [-1.0, 1], [-1.0, 1])).reshape(3, -1).T
TURN = so3.exp([0.3, -0.5, 0.7])


@pytest.mark.parametrize(
    ("p_a", "p_b", "message"),
    [
        (CUBE[:2], CUBE[:2], "three are needed"),
        (np.zeros((0, 3)), np.zeros((0, 3)), "three are needed"),
        (LINE @ TURN.T, LINE, "one line"),
        (LINE @ TURN.T + 1e3, LINE - 1e3, "one line"),
        (CUBE @ TURN.T, np.outer(CUBE[:, 0], [1.0, 1.0, 1.0]), "one line"),
        (np.zeros((5, 3)), np.zeros((5, 3)), "one place"),
        (np.full((5, 3), 7.0) @ TURN.T, np.full((5, 3), 7.0), "one place"),
        (np.full((8, 3), 1e6) @ TURN.T + 1e-10 * CUBE, np.full((8, 3), 1e6) - 1e-10 * CUBE, "one place"),
        (CUBE, np.full((8, 3), 3.0), "one place"),
        (-CUBE, CUBE, "mirrored"),
        (np.where(CUBE[0] == CUBE, np.nan, CUBE), CUBE, "not finite"),
        (CUBE, np.where(CUBE[0] == CUBE, np.inf, CUBE), "not finite"),
    ],
)
@pytest.mark.parametrize("with_scale", [False, True])
def test_points_that_leave_the_motion_free_are_refused(
    p_a: np.ndarray, p_b: np.ndarray, message: str, with_scale: bool
) -> None:
    with pytest.raises(DegenerateGeometryError, match=message):
        align_points_with_scale(p_a, p_b, with_scale=with_scale)


def test_weights_may_make_points_degenerate(rng: np.random.Generator) -> None:
    p_a, p_b = noisy_pair(rng, n=5)
    with pytest.raises(DegenerateGeometryError, match="three are needed"):
        align_points(p_a, p_b, [1, 1, 0, 0, 0])


@pytest.mark.parametrize("weights", [[1, 1], [1, 1, -1, 1, 1]])
def test_wrong_weights_are_a_programming_error(rng: np.random.Generator, weights: list[int]) -> None:
    p_a, p_b = noisy_pair(rng, n=5)
    with pytest.raises(ValueError, match="non-negative"):
        align_points(p_a, p_b, weights)


@pytest.mark.parametrize(("p_a", "p_b"), [(CUBE, CUBE[:5]), (CUBE[:, :2], CUBE[:, :2]), (CUBE[None], CUBE[None])])
def test_wrong_shapes_are_a_programming_error(p_a: np.ndarray, p_b: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"\(N, 3\)"):
        align_points(p_a, p_b)
