"""Residuals, Jacobians and sums of the kernels against numeric derivatives and plain Python."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher
from odometry.dense.scenes import Plane, bench, frame_of
from odometry.plain_kernels import plain

from wheelsight.core.geometry import PinholeCamera, se3, so3
from wheelsight.vision import image_kernels as _grid_kernels
from wheelsight.vision import image_kernels as _reference_kernels
from wheelsight.vision.dense import alignment_kernels as _shown_kernels
from wheelsight.vision.dense import alignment_kernels as kernels
from wheelsight.vision.dense import alignment_kernels as steps
from wheelsight.vision.dense import alignment_kernels as turns

TINY = PinholeCamera(24, 20, 22.0, 21.0, 11.3, 9.8)
GRID = np.array([TINY.fx, TINY.fy, TINY.cx, TINY.cy], np.float32)
NOISE = np.array([0.001, 0.0014, 0.3, 10.0], np.float32)
JUMP, ANY_BEND = np.array([0, 0.03, 0], np.float32), np.full(2, np.inf, np.float32)
NO_BOUNDARY = np.array([np.inf, 0, 0], np.float32)
UPPER = np.triu_indices(6)


@pytest.fixture
def pair(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth and grey of a frame, and a reference's pixels: one plane with a slope of grey, so that both are smooth."""
    rows, columns = np.mgrid[: TINY.height, : TINY.width]
    x, y = (columns - TINY.cx) / TINY.fx, (rows - TINY.cy) / TINY.fy
    normal, offset = np.array([0.1, -0.2, -1.0]) / np.linalg.norm([0.1, -0.2, -1.0]), -1.5
    depth_m = (offset / (normal[0] * x + normal[1] * y + normal[2])).astype(np.float32)
    there = (100 + 3.0 * columns - 2.0 * rows).astype(np.float32)
    pixels = np.empty((*depth_m.shape, _grid_kernels.CHANNELS), np.float32)
    normals = np.broadcast_to(normal, (*depth_m.shape, 3)).astype(np.float32)
    _reference_kernels.pack(depth_m, normals, there, GRID, NO_BOUNDARY, 0, TINY.height, pixels)
    here = there + rng.normal(0, 3, there.shape)
    return (depth_m + 0.01).astype(np.float32), here.astype(np.float32), pixels


def sums_of(pair: tuple, T: np.ndarray, weight: float, huber: float = 1e6, module: Any = kernels) -> np.ndarray:
    """The total of all rows."""
    depth_m, grey, pixels = pair
    T_rows = np.ascontiguousarray(np.broadcast_to(T[:3], (TINY.height, 3, 4)), np.float32)
    how = np.array([0.5, 1.0, 5.0, 1.1, 2.0, huber, weight, 0.0, 0.0, 0.5], np.float32)
    sums = np.zeros((TINY.height, kernels.SUMS))
    images = kernels.Images(depth_m, grey, pixels, GRID)
    module.accumulate(images, T_rows, NOISE, how, 1, 0, TINY.height, sums)
    return sums.sum(axis=0)


@pytest.mark.parametrize("kind", ["plane", "grey"])
@pytest.mark.parametrize("pixel", [(4, 5), (10, 12), (15, 17)])
def test_jacobian_is_the_numeric_one(pair: tuple, kind: str, pixel: tuple[int, int]) -> None:
    depth_m, grey, pixels = (a.copy() for a in pair)
    alone = np.zeros_like(depth_m)
    alone[pixel] = depth_m[pixel]
    grey[pixel] = 60.0  # darker than the reference, so that the error keeps its sign
    if kind == "grey":
        pixels[..., _grid_kernels.OFFSET] = np.nan
    weight, count = (0.0, kernels.PLANE_COUNT) if kind == "plane" else (1.0, kernels.GREY_COUNT)
    T = se3.exp([0.004, -0.003, 0.02, 0.003, -0.002, 0.004])

    def of(T: np.ndarray) -> np.ndarray:
        total = sums_of((alone, grey, pixels), T, weight)
        assert total[count] == 1
        return total

    total = of(T)
    part = total[kernels.GREY_SUMS :] if kind == "grey" else total
    sign = np.sign(pixels[10, 10, _grid_kernels.NZ] * (depth_m[pixel] + 0.02 - pixels[(*pixel, _grid_kernels.DEPTH)]))
    sign = sign if kind == "plane" else 1.0
    jacobian = sign * part[21:27] / total[count + 1]
    steps_ = 1e-3 * np.eye(6)
    numeric = [(of(se3.exp(d) @ T)[count + 1] - of(se3.exp(-d) @ T)[count + 1]) / 2e-3 * sign for d in steps_]
    np.testing.assert_allclose(jacobian, numeric, atol=0.02 * np.abs(jacobian).max())
    H = np.zeros((6, 6))
    H[UPPER] = part[:21]
    np.testing.assert_allclose(H[UPPER], np.outer(jacobian, jacobian)[UPPER], rtol=1e-3, atol=1e-3 * H.max())


def test_compiled_is_plain_python(pair: tuple) -> None:
    T = se3.exp([0.01, -0.02, 0.02, 0.01, -0.02, 0.01])
    compiled = sums_of(pair, T, 0.5, huber=1.5)
    assert compiled[kernels.PLANE_COUNT] > 300
    assert compiled[kernels.GREY_COUNT] > 300
    np.testing.assert_allclose(compiled, sums_of(pair, T, 0.5, huber=1.5, module=plain(kernels)), rtol=1e-4, atol=1e-2)


def test_stretches_of_a_row_add_up(pair: tuple, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = sums_of(pair, np.eye(4), 0.5, huber=1.5)
    monkeypatch.setattr(kernels, "_STRETCH", 10)  # of 24 pixels
    np.testing.assert_allclose(sums_of(pair, np.eye(4), 0.5, 1.5, plain(kernels)), whole, rtol=1e-4, atol=1e-2)


def test_huber_takes_weight_from_large_errors_only(pair: tuple) -> None:
    gentle, strict = (sums_of(pair, np.eye(4), 1.0, huber=limit) for limit in (1e6, 0.5))
    assert strict[kernels.GREY_COUNT] == gentle[kernels.GREY_COUNT]
    assert strict[kernels.GREY_COUNT + 2] < gentle[kernels.GREY_COUNT + 2]


def test_unknown_pixels_take_no_part(pair: tuple) -> None:
    depth_m, grey, pixels = (a.copy() for a in pair)
    depth_m[:, :12], grey[10:] = 0.0, -1.0
    pixels[:5] = np.nan
    total = sums_of((depth_m, grey, pixels), np.eye(4), 1.0)
    assert np.isfinite(total).all()
    assert 0 < total[kernels.GREY_COUNT] < total[kernels.PLANE_COUNT] < total[kernels.PAIRS]


@pytest.mark.parametrize("depth_m", [0.0, 2.0])
@pytest.mark.parametrize("pixel", [(4, 5), (10, 12), (15, 17)])
def test_jacobian_of_a_turn_is_the_numeric_one(pair: tuple, pixel: tuple[int, int], depth_m: float) -> None:
    T, sums = se3.from_parts(so3.exp([0.004, -0.003, 0.002]), [0.03, -0.02, 0.04]), np.empty(16)
    grey, depth = np.full((TINY.height, TINY.width), -1.0, np.float32), np.full(pair[0].shape, depth_m, np.float32)
    grey[pixel] = 60.0
    gain, offset = 1.2, 5.0
    images = kernels.Images(depth, grey, pair[2], GRID.astype(float))
    turns.accumulate_turn(images, T, np.array([gain, offset]), 1e9, sums)
    assert sums[9] == 1

    def seen(R: np.ndarray) -> float:
        """The reference's grey, whose slopes are 3 and -2 a pixel, where the pixel's point falls, as exposed here."""
        ray = R @ [(pixel[1] - TINY.cx) / TINY.fx, (pixel[0] - TINY.cy) / TINY.fy, 1.0]
        point = ray + (T[:3, 3] / depth_m if depth_m else 0.0)
        return gain * (3 * TINY.fx * point[0] / point[2] - 2 * TINY.fy * point[1] / point[2])

    R = T[:3, :3]
    numeric = [(seen(so3.exp(d) @ R) - seen(so3.exp(-d) @ R)) / 2e-5 for d in 1e-5 * np.eye(3)]
    np.testing.assert_allclose(sums[6:9] / sums[10], numeric, rtol=1e-4, atol=1e-2)
    np.testing.assert_allclose(sums[:6], np.outer(numeric, numeric)[np.triu_indices(3)], rtol=1e-3, atol=0.1)


@pytest.mark.parametrize("shift_px", [0, 1, 4])
def test_exposure_is_found_in_images_that_do_not_lie_on_each_other(rng: np.random.Generator, shift_px: int) -> None:
    there = cv2.GaussianBlur(rng.normal(100, 80, (200, 300)), (0, 0), 2.0)
    here = 0.7 * np.roll(there, shift_px, axis=1) + 20
    moments = there.size, there.sum(), here.sum(), (there**2).sum(), (here**2).sum()
    gain, offset = steps.fit_exposure(moments, 1.0)
    assert gain == pytest.approx(0.7, abs=0.01)
    assert gain * there.mean() + offset == pytest.approx(here.mean())
    assert steps.fit_exposure((9.0, 900.0, 450.0, 9e4, 2.25e4), 1.3) == pytest.approx((1.3, -80.0))


def test_solve_is_numpys(rng: np.random.Generator) -> None:
    J, total = rng.standard_normal((40, 6)), np.zeros(kernels.SUMS)
    H, b = J.T @ J, rng.standard_normal(6)
    total[:21], total[21:27] = H[UPPER], b
    free, held = np.zeros((6, 6)), rng.standard_normal(6)
    np.testing.assert_allclose(steps.solve(total, free, held), -np.linalg.solve(H, b), rtol=1e-6)
    A = rng.standard_normal((6, 6))
    np.testing.assert_allclose(
        steps.solve(total, A.T @ A, held), -np.linalg.solve(H + A.T @ A, b + A.T @ A @ held), rtol=1e-6
    )


def test_offset_is_the_tangent_to_first_order(rng: np.random.Generator) -> None:
    T_held, xi = se3.exp(rng.standard_normal(6)), 1e-3 * rng.standard_normal(6)
    np.testing.assert_allclose(steps.offset(se3.exp(xi) @ T_held, T_held), xi, atol=1e-5)


def test_solve_stays_finite_where_nothing_is_seen() -> None:
    total = np.zeros(kernels.SUMS)
    assert not steps.solve(total, np.zeros((6, 6)), np.zeros(6)).any()
    total[0] = 4.0
    total[21] = 2.0
    np.testing.assert_allclose(steps.solve(total, np.zeros((6, 6)), np.zeros(6)), [-0.5, 0, 0, 0, 0, 0], atol=1e-6)


@pytest.mark.parametrize("size", [1e-7, 1e-3, 0.8])
def test_move_is_the_exponential(rng: np.random.Generator, size: float) -> None:
    change, T = size * rng.standard_normal(6), se3.exp(rng.standard_normal(6))
    moved = T.copy()
    steps.move(change, moved)
    np.testing.assert_allclose(moved, se3.exp(change) @ T, atol=1e-12)


def test_rows_are_placed_by_what_the_straightening_twist_missed(rng: np.random.Generator) -> None:
    T_reference_previous, T = se3.exp(0.1 * rng.standard_normal(6)), se3.exp(0.1 * rng.standard_normal(6))
    twist, late_s, seconds = rng.standard_normal(6), np.linspace(-0.01, 0.01, 5), 0.05
    T_rows = np.empty((5, 3, 4), np.float32)
    steps.place_rows(T, se3.invert(T_reference_previous), seconds, twist, late_s, T_rows)
    step = se3.invert(T_reference_previous) @ T
    wrong = np.concatenate([step[:3, 3], so3.log(step[:3, :3])]) / seconds - twist
    for late, T_row in zip(late_s, T_rows, strict=True):
        np.testing.assert_allclose(T_row, (T @ se3.exp(late * wrong))[:3], atol=2e-3)


def test_normals_of_a_plane_are_its_own() -> None:
    normal = np.array([0.3, -0.2, -0.93]) / np.linalg.norm([0.3, -0.2, -0.93])
    parts = bench()
    grid = parts.grid(frame_of([Plane(tuple(normal), -2.0)], np.eye(4), 0.0))
    found = parts.maker.normals(grid.levels[0])
    known = found[..., 2] != 0
    assert known[5:-5, 5:-5].all()
    np.testing.assert_allclose(found[known], np.broadcast_to(normal, found.shape)[known], atol=2e-3)


def test_normals_have_the_slopes_that_least_squares_finds(rng: np.random.Generator) -> None:
    shape, jump = (10, 150), JUMP[1]  # wider than what is fitted at once
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    depth_m = 1.2 + 0.002 * columns - 0.004 * rows + 0.3 * (columns > 60) + rng.normal(0, 0.004, shape)
    depth_m = np.where(rng.random(shape) < 0.3, 0, depth_m).astype(np.float32)
    grid, out = np.array([90.0, 91.0, 74.0, 5.0], np.float32), np.full((*shape, 3), np.nan, np.float32)
    for begin, end in ((0, 4), (4, 10)):
        _reference_kernels.normals(depth_m, grid, 2, JUMP, ANY_BEND, begin, end, out)
    assert not out[:2].any()
    assert not out[:, :2].any()
    expected = np.zeros((*shape, 3))
    for r, c in np.argwhere(depth_m[2:-2, 2:-2] > 0) + 2:
        window = slice(r - 2, r + 3), slice(c - 2, c + 3)
        known = (depth_m[window] > 0) & (np.abs(depth_m[window] - depth_m[r, c]) < jump * depth_m[r, c])
        known[1:4, 1:4] = False
        if known.sum() >= 6:
            places = np.stack([columns[window][known] - c, rows[window][known] - r, np.ones(known.sum())], axis=1)
            fit = np.linalg.lstsq(places, 1 / depth_m[window][known].astype(float), rcond=None)[0]
            slopes, ray = fit[:2] * grid[:2], (np.array([c, r]) - grid[2:]) / grid[:2]
            normal = -np.array([*slopes, fit[2] - slopes @ ray])
            cosine = fit[2] / np.linalg.norm(normal) / np.hypot(1, np.linalg.norm(ray))
            expected[r, c] = normal / np.linalg.norm(normal) if cosine > 0.1 else 0
    assert np.count_nonzero(expected[..., 2]) > 600
    np.testing.assert_allclose(out, expected, atol=2e-5)


def test_normals_do_not_reach_over_an_edge() -> None:
    depth_m = np.full((20, 20), 1.0, np.float32)
    depth_m[:, 10:] = 2.0
    out = np.empty((20, 20, 3), np.float32)
    _reference_kernels.normals(depth_m, GRID, 2, JUMP, 2 * NOISE[:2], 0, 20, out)
    np.testing.assert_allclose(out[5, 9], [0, 0, -1], atol=1e-6)
    np.testing.assert_allclose(out[5, 10], [0, 0, -1], atol=1e-6)


@pytest.mark.parametrize("turned", [False, True])
def test_grey_has_no_gradient_beside_what_stands_out_before_it(turned: bool) -> None:
    """There the rim of what is nearer is spread over it, and moves as that does; on that itself it is as it seems."""
    rows, columns = np.mgrid[: TINY.height, : TINY.width]
    slope = 1 / (0.5 + 0.01 * rows + 0.004 * columns)  # a slanted surface: inverse depth is linear
    depth_m = np.where(columns < 10, 0.9 * slope, slope).astype(np.float32)
    grey, normal = (100 + 3.0 * columns + 2.0 * rows).astype(np.float32), np.zeros((*depth_m.shape, 3), np.float32)
    expected = (columns >= 10) & (columns < 12) & (rows >= 2) & (rows < TINY.height - 2)
    if turned:
        depth_m, grey, expected = (np.ascontiguousarray(a.T) for a in (depth_m, grey, expected))
        normal = np.ascontiguousarray(normal.transpose(1, 0, 2))
    boundary, out = (
        np.array([0.0, 0.02, 0.0], np.float32),
        np.empty((*depth_m.shape, _grid_kernels.CHANNELS), np.float32),
    )
    _reference_kernels.pack(depth_m, normal, grey, GRID, boundary, 0, len(depth_m), out)
    inner = slice(1, -1), slice(1, -1)
    np.testing.assert_array_equal(np.isnan(out[..., _grid_kernels.ALONG_U])[inner], expected[inner])
    np.testing.assert_array_equal(np.isnan(out[..., _grid_kernels.ALONG_V])[inner], expected[inner])
    assert np.isfinite(out[..., _grid_kernels.GREY]).all()


def test_noise_tilts_no_normals_of_a_wall_that_is_passed(rng: np.random.Generator) -> None:
    """Of neighbours within 3 % of a depth alone, those would be picked that err alike."""
    wall, parts, tilts_deg = [Plane((1, 0, 0), 1.0)], bench(), []
    for _ in range(4):
        level = parts.grid(frame_of(wall, np.eye(4), 0.0, noise_seed=int(rng.integers(1000)))).levels[0]
        normal = parts.maker.normals(level)
        is_far = (level.depth_m > 3.0) & (level.depth_m < 5.0) & (normal[..., 0] != 0)
        tilts_deg.append(np.degrees(np.arcsin(normal[is_far, 2])).mean())
    assert abs(np.mean(tilts_deg)) < 0.3  # 1.5, towards the camera, of those


def test_of_a_grazed_floor_no_readings_are_picked_that_err_upwards(rng: np.random.Generator) -> None:
    """Seen at 80°, its normals scatter about any limit set there, with the noise of the depths they come from."""
    grid, shape, height_m = np.array([293.0, 293.0, 159.5, 100.0], np.float32), (90, 320), 0.9
    below = (np.arange(shape[0])[:, None] + 40 + np.zeros(shape)) / grid[1]
    true_m, grid[3] = height_m / below, -40
    ray = np.stack([(np.arange(shape[1]) - grid[2]) / grid[0] + 0 * below, below, np.ones(shape)], axis=-1)
    least, shares, raised_m = np.cos(np.radians(84.5)), [], []
    for _ in range(10):
        depth_m = (true_m + (1e-3 + 1.425e-3 * true_m**2) * rng.standard_normal(shape)).astype(np.float32)
        out = np.empty((*shape, 3), np.float32)
        _reference_kernels.normals(depth_m, grid, 2, JUMP, ANY_BEND, 0, shape[0], out)
        is_used = -(out * ray).sum(axis=-1) / np.linalg.norm(ray, axis=-1) >= least
        is_far = (true_m > 4.0) & (true_m < 5.5)
        shares.append(is_used[is_far].mean())
        raised_m.append(((true_m - depth_m) * below)[is_far & is_used].mean())
    assert np.mean(shares) > 0.94
    assert abs(np.mean(raised_m)) < 8e-5


def test_halving_keeps_the_nearer_surface_and_leaves_out_holes() -> None:
    depth_m = np.array([[1.0, 1.02, 0, 0], [3.0, 0, 0, 2.0]], np.float32)
    half = np.empty((1, 2), np.float32)
    _grid_kernels.halve_depth(depth_m, 0.03, 0, 1, half)
    np.testing.assert_allclose(half, [[1.01, 2.0]], rtol=1e-6)


def test_halving_nothing_gives_nothing() -> None:
    half = np.empty((2, 2), np.float32)
    _grid_kernels.halve_depth(np.zeros((4, 4), np.float32), 0.03, 0, 2, half)
    assert not half.any()
    _grid_kernels.halve_grey(np.array([[1, 2, 3, 4], [3, 4, 5, -1]], np.float32), 0, 1, half)
    np.testing.assert_allclose(half[0], [2.5, -1])


@pytest.mark.parametrize("name", ["halve_depth", "straighten"])
def test_grid_kernels_are_plain_python(rng: np.random.Generator, name: str) -> None:
    depth_m = rng.uniform(0.9, 1.1, (20, 24)).astype(np.float32)
    depth_m[rng.random((20, 24)) < 0.2] = 0
    outs = []
    for module in (_grid_kernels, plain(_grid_kernels)):
        if name == "halve_depth":
            out = np.zeros((10, 12), np.float32)
            module.halve_depth(depth_m, 0.03, 0, 10, out)
        else:
            out = np.zeros((2, 20, 24), np.float32)
            v, u = np.mgrid[:20, :24].astype(np.float32)
            source_px = np.stack([u + 0.3, v - 0.2], axis=-1)
            twist = np.array([0.2, -0.1, 0.3, 0.5, -1.0, 0.4], np.float32)
            exposure = _grid_kernels.Exposure(tuple(GRID), tuple(twist), np.float32(0.03))
            module.straighten(depth_m, 100 * depth_m, source_px, exposure, np.float32(0.1), (0, 20), out)
        outs.append(out)
    np.testing.assert_allclose(outs[0], outs[1], rtol=1e-4)


def test_a_crease_has_no_normal() -> None:
    planes = [Plane((1.0, 0.0, -1.0), -2.0), Plane((-1.0, 0.0, -1.0), -2.0)]  # meet at x = 0, 2 m away
    parts = bench()
    frame = frame_of(planes, np.eye(4), 0.0)
    found, middle = parts.reference(frame).scales.steep.normal[30], round(parts.grid(frame).levels[2].intrinsics[2])
    assert not found[middle].any()
    assert found[middle - 8, 2] != 0
    assert found[middle + 8, 2] != 0


@pytest.mark.parametrize("module", [kernels, _grid_kernels, _reference_kernels, _shown_kernels, steps, turns])
def test_no_kernel_takes_more_than_eight_arguments(module: ModuleType) -> None:
    """What belongs together comes as a NamedTuple, whose fields mypy knows."""
    counts = {name: k.py_func.__code__.co_argcount for name, k in vars(module).items() if isinstance(k, Dispatcher)}
    assert counts
    assert {name for name, count in counts.items() if count > 8} == set()
