"""The least squares of a calibration: what changes no depth costs nothing, derivatives, and σ by leaving out views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.board_views import BOARD, RIGS, board_views
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3
from wheelsight_calibration.camera_model import BEFORE_KNOTS, CellTable, Model, Points, Sigmas, filled, poses_in
from wheelsight_calibration.camera_solver import Residuals, solve
from wheelsight_calibration.views import RAW_DISPARITY

CAMERA = PinholeCamera(512, 424, 365.0, 365.0, 255.5, 211.5)
KNOTS_M = np.linspace(0.5, 4.5, 17)
NO_POINTS = Points(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 2)))
NO_CELLS = CellTable(np.empty(0, np.int64), np.empty((0, 2)), np.empty(0), np.empty(0))
POSES = 3


def model_of(sensor: str) -> tuple[Model, FloatArray]:
    """Three boards' cells before a registered camera, and parameters with an error that is none of nothing."""
    rng = np.random.default_rng(4)
    count = 90
    reading = rng.uniform(400, 900, count) if sensor == RAW_DISPARITY else rng.uniform(0.7, 4.0, count)
    px = rng.uniform(20, 400, (count, 2))
    cells = CellTable(np.arange(count) % POSES, px, reading, np.full(count, 1e-3))
    model = Model(
        NO_POINTS, NO_POINTS, cells, CAMERA, CAMERA, sensor, True, 0.06, (1e-3, 1e-3),
        KNOTS_M if sensor == "tof" else np.empty(0), np.eye(4), POSES,
    )  # fmt: skip
    T = np.array([se3.exp([0, 0, z, 0.2, 0.1 * z, 0]) for z in (1.0, 2.0, 3.0)])
    x = filled(model, np.zeros(model.slices()["poses"].stop), (CAMERA, CAMERA), 0.06, T)
    error = model.slices()["error"]
    x[error] = 3e-3 * rng.standard_normal(error.stop - error.start)
    if model.has_pattern:
        x[error.start + 2] = 0.6
    return model, x


def test_a_line_moved_from_the_curve_to_scale_and_offset_costs_nothing() -> None:
    """As it changes no depth; were it to change σ, scale would go where σ is largest."""
    model, x = model_of("tof")
    residuals, error = Residuals(model, Sigmas(0.1, 0.1, 0.1)), model.slices()["error"]
    y, slope, level = x.copy(), 0.02, 0.01
    y[error.start] = np.log(np.exp(x[error.start]) + slope)
    y[error.start + 1] += level
    y[error.start + 3 : error.stop] -= slope * KNOTS_M + level
    assert np.abs(residuals.depth(x)).max() > 100
    assert residuals.depth(y) == pytest.approx(residuals.depth(x), rel=1e-9)


@pytest.mark.parametrize("sensor", ["tof", "structured-light", RAW_DISPARITY])
def test_derivatives_by_knots_are_those_of_differences(sensor: str) -> None:
    model, x = model_of(sensor)
    residuals, error = Residuals(model, Sigmas(0.1, 0.1, 0.1)), model.slices()["error"]
    step = 1e-6
    of_sum = (residuals.depth(x, more=step) - residuals.depth(x, more=-step)) / (2 * step)
    found = residuals.by_knots(x, of_sum, residuals.depth(x))
    for k in range(error.start + BEFORE_KNOTS, error.stop):
        up, down = x.copy(), x.copy()
        up[k] += step
        down[k] -= step
        by_differences = (residuals.depth(up) - residuals.depth(down)) / (2 * step)
        scale = np.abs(found).max()
        assert found[:, k - error.start - BEFORE_KNOTS] == pytest.approx(by_differences, abs=1e-5 * scale)


def test_the_written_curve_is_the_one_that_is_fitted() -> None:
    model, x = model_of("tof")
    error = model.slices()["error"]
    knots = 7e-3 * np.sin(2 * np.pi * KNOTS_M / 1.9)  # Kinect v2's swing, by Lachat et al. 2015
    x[error] = np.concatenate([[0, 0, 0], knots])
    z = np.linspace(0.8, 4.2, 200)
    written = model.error_of(x).of_readings(z, np.full((200, 2), 200.0), CAMERA) - z
    assert np.abs(written - 7e-3 * np.sin(2 * np.pi * z / 1.9)).max() < 0.2e-3
    assert len(model.error_of(x).curve_m) == 3 * 16 + 1


def corners_only(seed: int, count: int) -> tuple[Model, FloatArray]:
    rng = np.random.default_rng(seed)
    rig = RIGS["realsense"](rng)
    corners = [view.color for view in board_views(rig, rng, count).views]
    view = np.repeat(np.arange(count), BOARD.count)
    squares = np.tile(BOARD.points_m / BOARD.square_m, (count, 1))
    seen = Points(view, squares, np.concatenate([one.px for one in corners]))
    model = Model(
        seen, NO_POINTS, NO_CELLS, rig.color, rig.color, "stereo", True, BOARD.square_m, (1e-3, 0.0),
        np.empty(0), np.eye(4), count,
    )  # fmt: skip
    T = poses_in(rig.color, corners, BOARD).T_camera_board
    T[:, :3, 3] *= BOARD.square_m
    x = np.zeros(model.slices()["poses"].stop)
    return model, filled(model, x, (rig.color, rig.color), BOARD.square_m, T)


def test_sigmas_by_views_are_those_of_fits_without_each_view() -> None:
    """By its closed form, a step each; here by fits to their end, without one view after the other."""
    count = 9
    model, start = corners_only(3, count)
    sigmas, lens = Sigmas(0.1, 0.1, 1.0), model.slices()["color"]
    residuals = Residuals(model, sigmas)
    all_of = solve(residuals, start, 1e-9)
    moved = []
    for k in range(count):
        kept = model.color.view != k
        view = model.color.view[kept]
        fewer = Points(view - (view > k), model.color.square[kept], model.color.px[kept])
        poses = start[lens.stop :].reshape(count, 6)
        one_less = replace(model, color=fewer, count=count - 1)
        begin = np.concatenate([start[lens], np.delete(poses, k, axis=0).ravel()])
        moved.append(solve(Residuals(one_less, sigmas), begin, 1e-9).x[lens] - all_of.x[lens])
    of_priors = residuals.prior_rows[:, lens]
    C = all_of.covariance
    expected = np.transpose(moved) @ np.array(moved) * (count - 1) / count + C @ (of_priors.T @ of_priors) @ C
    found = np.sqrt(np.diag(all_of.by_views))
    assert found[:4] == pytest.approx(np.sqrt(np.diag(expected))[:4], rel=0.1)


def test_the_larger_of_both_sigmas_counts() -> None:
    model, start = corners_only(3, 9)
    solution = solve(Residuals(model, Sigmas(0.1, 0.1, 1.0)), start)
    both = np.sqrt([np.diag(solution.covariance), np.diag(solution.by_views)]).max(axis=0)
    assert solution.sigmas_of(np.eye(len(both)), slice(None)) == pytest.approx(both)


BENT = (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)  # freiburg1's colour lens, as a driver registers depth to it


def tilted_boards(sensor: str) -> tuple[Model, FloatArray]:
    """Depth without noise of boards that fill the image, tilted each way, and where they are."""
    rng = np.random.default_rng(2)
    straight = PinholeCamera(320, 240, 292.0, 292.0, 159.5, 119.5)
    bent = replace(straight, distortion=BENT)
    count, each = 12, 60
    turns = [se3.exp([0, 0, 0, 0.6 * np.cos(a), 0.6 * np.sin(a), 0]) for a in 2.4 * np.arange(count)]
    T = np.array([se3.exp([0, 0, 1 + 0.15 * k, 0, 0, 0]) @ turn for k, turn in enumerate(turns)])
    view = np.repeat(np.arange(count), each)
    px = rng.uniform((8, 8), (312, 232), (len(view), 2))
    rays = np.concatenate([bent.normalise(px), np.ones((len(px), 1))], axis=1)
    n = T[view, :3, 2]
    z = (n * T[view, :3, 3]).sum(axis=1) / (n * rays).sum(axis=1)
    cells = CellTable(view, px, z, np.full(len(view), 1e-3))
    corners = np.tile(BOARD.points_m / BOARD.square_m, (count, 1)) - BOARD.points_m.mean(axis=0) / BOARD.square_m
    of_board = np.repeat(np.arange(count), BOARD.count)
    p = se3.apply(T[of_board], BOARD.square_m * corners[:, None])[:, 0]
    seen = Points(of_board, corners, straight.denormalise(p[:, :2] / p[:, 2:]))
    model = Model(
        seen, NO_POINTS, cells, straight, straight, sensor, False, BOARD.square_m, (1e-3, 1e-3),
        np.empty(0), np.eye(4), count, keeps_color=True,
    )  # fmt: skip
    return model, filled(model, np.zeros(model.slices()["poses"].stop), (straight, straight), BOARD.square_m, T)


def test_tilted_planes_tell_how_a_depth_lens_bends() -> None:
    """Nothing else does, where no infrared image shows a corner."""
    model, start = tilted_boards("structured-light")
    found = model.depth_camera(solve(Residuals(model, Sigmas(0.1, 0.1, 0.1)), start).x)
    u, v = np.meshgrid(np.linspace(20, 300, 8), np.linspace(20, 220, 6))
    px = np.stack([u.ravel(), v.ravel()], axis=-1)
    off = found.normalise(px) - replace(model.depth_start, distortion=BENT).normalise(px)
    assert np.abs(off).max() < 2e-4  # of 14e-3 by a straight lens
    assert found.fx == pytest.approx(model.depth_start.fx, rel=1e-3)


def test_stereo_answers_images_that_the_camera_has_straightened() -> None:
    model, x = tilted_boards("stereo")
    assert not model.depth_camera(x).has_distortion
    assert model.slices()["depth"].stop - model.slices()["depth"].start == 4
