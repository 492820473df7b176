from __future__ import annotations

import numpy as np
import pytest
from odometry.plain_kernels import plain

from wheelsight.core.geometry import PinholeCamera, align_points, se3, so3
from wheelsight.vision import image_kernels as compiled

GATE = 16.3
SIGMA_XY, SIGMA_M = 0.002, 0.01
in_python = plain(compiled)


def scene(rng: np.random.Generator, n: int = 60, noise: float = 0.0, outliers: float = 0.0):
    """T_current_reference and what kernels take of n points: p_reference, xy, depth_m, scale_xy, scale_m."""
    T = se3.exp(np.concatenate([rng.uniform(-0.2, 0.2, 3), rng.uniform(-0.2, 0.2, 3)]))
    xy, depth_m = rng.uniform(-0.5, 0.5, (n, 2)), rng.uniform(1, 4, n)
    p_reference = se3.apply(se3.invert(T), np.column_stack([xy * depth_m[:, None], depth_m]))
    xy = xy + noise * SIGMA_XY * rng.standard_normal((n, 2))
    depth_m = depth_m + noise * SIGMA_M * rng.standard_normal(n)
    wrong = rng.permutation(n)[: round(outliers * n)]
    xy[wrong], depth_m[wrong] = rng.uniform(-0.5, 0.5, (len(wrong), 2)), rng.uniform(1, 4, len(wrong))
    return T, compiled.Pairs(p_reference, xy, depth_m, np.full(n, 1 / SIGMA_XY), np.full(n, 1 / SIGMA_M))


def parts(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.ascontiguousarray(T[:3, :3]), T[:3, 3].copy()


def residuals(T, p_reference, xy, depth_m, scale_xy, scale_m):
    """(N, 3), normalised, written again from the definition."""
    p = se3.apply(T, p_reference)
    off_xy = (p[:, :2] / p[:, 2:] - xy) * scale_xy[:, None]
    return np.column_stack([off_xy, (p[:, 2] - depth_m) * scale_m])


def robust_cost(T, *observed):
    """Geman and McClure's: Σ s / (1 + s / c) with c = gate/2, of squares s of points in front of the camera."""
    squares = (residuals(T, *observed) ** 2).sum(axis=1)
    return float((squares / (1 + squares / (GATE / 2))).sum())


def derivative(function, at: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Of a function of a motion by its left perturbation, by central differences; the perturbation's axis last."""
    steps = step * np.eye(6)
    return np.stack([(function(se3.exp(d) @ at) - function(se3.exp(-d) @ at)) / (2 * step) for d in steps], axis=-1)


def assert_same(got, expected, rtol: float = 1e-9, atol: float = 1e-9) -> None:
    for one, other in zip(got, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=rtol, atol=atol)


def test_project_agrees_with_the_camera(rng):
    camera = PinholeCamera(320, 240, 262.0, 260.0, 161.3, 118.4)
    points = rng.uniform((-3, -3, -1), (3, 3, 3), (500, 3))
    points = points[np.abs(points[:, 2]) > 0.1]
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
    got = compiled.project(points, *numbers)
    expected, _ = camera.project(points)
    inside = np.all((expected > 0) & (expected < (320, 240)), axis=1)
    assert 20 < inside.sum() < 400
    np.testing.assert_allclose(got, np.where(inside[:, None], expected, np.nan))
    np.testing.assert_array_equal(in_python.project(points, *numbers), got)


@pytest.mark.parametrize("mirrored", [False, True])
def test_align_three_agrees_with_the_library(rng, mirrored):
    for _ in range(20):
        T_a_b = se3.exp(rng.standard_normal(6))
        p_b = rng.uniform(-1, 1, (3, 3))
        p_a = se3.apply(T_a_b, p_b) + 0.02 * rng.standard_normal((3, 3))
        if mirrored:
            p_a = p_a * (1, 1, -1)
        R, t = compiled.align_three(p_a, p_b)
        np.testing.assert_allclose(se3.from_parts(R, t), align_points(p_a, p_b), atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1)
        assert_same(in_python.align_three(p_a, p_b), (R, t))


def test_residuals_are_normalised_distances(rng):
    T, observed = scene(rng, noise=1.0, outliers=0.2)
    R, t = parts(T)
    n = len(observed[0])
    got = compiled.residuals_of(R, t, observed, np.empty(n))
    np.testing.assert_allclose(got, (residuals(T, *observed) ** 2).sum(axis=1), rtol=1e-9)
    np.testing.assert_allclose(in_python.residuals_of(R, t, observed, np.empty(n)), got, rtol=1e-12)


def test_a_point_behind_the_camera_agrees_with_nothing(rng):
    T, observed = scene(rng)
    R, t = parts(T)
    p_reference = observed.p_reference
    p_reference[4] = se3.apply(se3.invert(T), np.array([[0.1, 0.1, -1.0]]))
    squares = compiled.residuals_of(R, t, observed, np.empty(len(p_reference)))
    assert np.flatnonzero(np.isinf(squares)).tolist() == [4]
    H, g, cost = compiled.normal_equations(R, t, observed, GATE)
    others = np.arange(len(p_reference)) != 4
    without = compiled.normal_equations(R, t, compiled.Pairs(*(x[others] for x in observed)), GATE)
    assert_same((H, g, cost), without, atol=1e-6)


def test_pairs_without_depth_count_by_their_pixels_alone(rng):
    T, observed = scene(rng, noise=1.0)
    R, t = parts(T)
    observed.scale_m[::2] = 0
    first = compiled.normal_equations(R, t, observed, GATE)
    observed.depth_m[::2] = 0
    assert_same(compiled.normal_equations(R, t, observed, GATE), first)


def test_normal_equations_hold_the_derivatives_of_the_robust_cost(rng):
    T, observed = scene(rng, noise=2.0, outliers=0.3)
    T = se3.exp(0.002 * rng.standard_normal(6)) @ T
    H, g, cost = compiled.normal_equations(*parts(T), observed, GATE)
    assert cost == pytest.approx(robust_cost(T, *observed))
    half_gradient = 0.5 * derivative(lambda T: np.array(robust_cost(T, *observed)), T)
    np.testing.assert_allclose(g, half_gradient, rtol=1e-5, atol=1e-4 * np.abs(g).max())
    J = derivative(lambda T: residuals(T, *observed), T)
    squares = (residuals(T, *observed) ** 2).sum(axis=1)
    weight = (1 + squares / (GATE / 2)) ** -2
    np.testing.assert_allclose(H, np.einsum("n,nra,nrb->ab", weight, J, J), rtol=1e-5, atol=1e-6 * np.abs(H).max())


def test_normal_equations_in_plain_python(rng):
    T, observed = scene(rng, noise=2.0, outliers=0.3)
    got = compiled.normal_equations(*parts(T), observed, GATE)
    assert_same(in_python.normal_equations(*parts(T), observed, GATE), got, rtol=1e-10)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.1])
def test_rotation_is_the_exponential(rng, angle):
    axis = rng.standard_normal(3)
    omega = angle * axis / np.linalg.norm(axis)
    np.testing.assert_allclose(compiled.rotation(omega), so3.exp(omega), atol=1e-12)
    np.testing.assert_allclose(in_python.rotation(omega), so3.exp(omega), atol=1e-12)


@pytest.mark.parametrize("outliers", [0.0, 0.3, 0.6])
def test_refine_finds_the_motion_exactly_where_there_is_no_noise(rng, outliers):
    for _ in range(5):
        T, observed = scene(rng, n=120, outliers=outliers)
        near = se3.exp(0.01 * rng.standard_normal(6)) @ T
        R, t, _, squares = compiled.refine(*parts(near), observed, GATE, 30)
        # Wrong pairs far beyond the gate still pull a little, as Geman and McClure's weight never is quite zero.
        np.testing.assert_allclose(se3.from_parts(R, t), T, atol=1e-9 if outliers == 0 else 2e-4)
        assert np.count_nonzero(squares < 0.1) >= (1 - outliers) * 120


def test_refine_in_plain_python(rng):
    T, observed = scene(rng, noise=1.0, outliers=0.3)
    near = se3.exp(0.01 * rng.standard_normal(6)) @ T
    got = compiled.refine(*parts(near), observed, GATE, 8)
    assert_same(in_python.refine(*parts(near), observed, GATE, 8), got, rtol=1e-7, atol=1e-9)


def rough(observed, seed: int, iterations: int = 2000, kernels=compiled):
    return kernels.ransac(observed, compiled.Triangles(0.05, 0.05, 0.03), 36.0, iterations, seed)


@pytest.mark.parametrize("n", [15, 200])
def test_ransac_finds_the_motion_among_seventy_per_cent_of_outliers(rng, n):
    for seed in range(10):
        T, observed = scene(rng, n=n, outliers=0.7)
        R, t, agreeing = rough(observed, seed)
        apart = se3.invert(T) @ se3.from_parts(R, t)
        assert np.linalg.norm(apart[:3, 3]) < 1e-6
        assert so3.angle(apart[:3, :3]) < 1e-6
        assert agreeing >= round(0.3 * n) - 1


def test_ransac_in_plain_python_finds_the_same_motion(rng):
    T, observed = scene(rng, noise=0.5, outliers=0.5)
    ours, again = rough(observed, 3, 200), rough(observed, 3, 200, in_python)
    assert ours[2] >= 28
    assert again[2] >= 28
    for R, t, _ in (ours, again):
        np.testing.assert_allclose(se3.from_parts(R, t), T, atol=0.05)


def test_ransac_answers_alike_for_one_seed_and_looks_elsewhere_for_another(rng):
    _, observed = scene(rng, noise=1.0, outliers=0.5)
    first, second = rough(observed, 7, 20), rough(observed, 7, 20)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)
    others = [rough(observed, seed, 20)[1] for seed in range(8, 12)]
    assert any(not np.array_equal(first[1], t) for t in others)


def test_ransac_does_not_disturb_the_caller_s_random_numbers(rng):
    _, observed = scene(rng)
    np.random.seed(1)
    before = np.random.random()
    np.random.seed(1)
    rough(observed, 9)
    assert np.random.random() == before


def test_ransac_finds_nothing_in_points_that_do_not_belong_together(rng):
    _, observed = scene(rng, n=100, outliers=1.0)
    assert rough(observed, 1)[2] < 15


def test_ransac_tries_no_triangle_too_small_to_tell_a_rotation(rng):
    _, (_, xy, depth_m, *scales) = scene(rng, n=40)
    xy, depth_m = 0.001 * xy, 2 + 0 * depth_m
    p = np.column_stack([xy * depth_m[:, None], depth_m])
    assert rough(compiled.Pairs(p, xy, depth_m, *scales), 1)[2] == 0
