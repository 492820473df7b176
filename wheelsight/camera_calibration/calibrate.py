"""Calibrating an RGB-D camera by views of a board: fit, leave out what disagrees, and refuse what is not sure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from wheelsight.camera_calibration.agreement import agreeing, sigmas_of
from wheelsight.camera_calibration.assemble import filled, model_of, with_cells
from wheelsight.camera_calibration.board import Board
from wheelsight.camera_calibration.checks import check_lens_views, doubts_beyond, refuse_unsure
from wheelsight.camera_calibration.model import Model, Sigmas
from wheelsight.camera_calibration.outcome import outcome
from wheelsight.camera_calibration.residuals import Residuals
from wheelsight.camera_calibration.result import CameraCalibration
from wheelsight.camera_calibration.settings import CameraCalibrationSettings
from wheelsight.camera_calibration.solve import Solution, solve
from wheelsight.camera_calibration.start import (
    LensStart,
    apart_by_planes,
    apart_by_poses,
    lens_from_corners,
    plane_of,
    poses_in,
    usual_lens,
)
from wheelsight.camera_calibration.task import CameraSetup, Counted, Task
from wheelsight.camera_calibration.views import ViewSet
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray, PinholeCamera, se3, so3

# Of the board's outline: what surely is board before the cameras' places are known, and after.
_SEED_SHARE, _BOARD_SHARE = 0.55, 0.95
_ROUGHLY = 1e-3  # of the cost: fits between which something is left out need no more
_AROUND_PX = 8


def calibrate_camera(
    seen: ViewSet,
    board: Board,
    setup: CameraSetup | None = None,
    settings: CameraCalibrationSettings | None = None,
    on_step: Callable[[str], None] = lambda _: None,
) -> CameraCalibration:
    """Lenses, where the cameras are to each other, and what depth is off by, from views of one board.

    Raises:
        CalibrationError: the views do not determine it; says what is missing.
        ConfigError: a setup that fits no images.
    """
    task = Task(seen, board, setup or CameraSetup(), settings or CameraCalibrationSettings())
    task.check()
    on_step("finding the lenses")
    counted, model, x = _begin(task, Counted.of(seen))
    keeps, refusal = task.setup.keeps_color, task.settings.refusal
    check_lens_views(model, x, counted.color, keeps, refusal)
    first = task.settings.detection.sigma_px
    sigmas = Sigmas(first, first, task.settings.depth.sigma_share)
    for turn in range(task.settings.robust.rounds):
        on_step(f"fitting, round {turn + 1} of {task.settings.robust.rounds + 1}")
        residuals = Residuals(model, sigmas)
        solution = solve(residuals, x, _ROUGHLY)
        sigmas = sigmas_of(residuals, solution.x)
        before, counted = counted, agreeing(counted, Residuals(model, sigmas), solution.x)
        counted, model, x = _again(task, before, counted, model, solution, is_first=turn == 0)
    on_step("fitting what is left")
    residuals = Residuals(model, sigmas)
    x = solve(residuals, x, _ROUGHLY).x
    residuals = Residuals(model, sigmas_of(residuals, x))
    solution = solve(residuals, x)
    result = outcome(residuals, solution, board, counted)
    refuse_unsure(result, model, keeps, refusal)
    return replace(result, warnings=(*result.warnings, *doubts_beyond(result, refusal)))


def _begin(task: Task, counted: Counted) -> tuple[Counted, Model, FloatArray]:
    seen, nominal, fewest = task.seen, task.setup.known_cameras, task.settings.refusal.fewest_views
    if len(counted.views) < fewest:
        problem = f"{len(counted.views)} views show the board, fewer than {fewest}"
        raise CalibrationError(problem, fix="take more: near and far, tilted each way, all over the image")
    if task.setup.keeps_color and nominal is not None:
        color = poses_in(nominal.cameras[0], counted.color, task.board)
    else:
        color = lens_from_corners(counted.color, task.board, seen.color_size)
    counted, depth, T_color_depth = _depth_start(task, counted, color)
    square_m = task.first_square_m
    if seen.has_depth and not task.board.is_size_known:
        square_m = _square_by_depth(task, counted, depth, color.T_camera_board)
    T = _scaled(color.T_camera_board, square_m)
    if seen.has_depth:
        counted = with_cells(task, counted, se3.invert(T_color_depth) @ T, depth, square_m, _SEED_SHARE)
        if not seen.has_infrared and not task.setup.is_registered:
            planes = np.array([plane_of(c, task.nominal_m(c.reading), depth) for c in counted.cells])
            T_color_depth = apart_by_planes(T, planes, task.settings.prior.apart_m, T_color_depth)
    model = model_of(task, counted, (color.camera, depth), T_color_depth)
    x = np.zeros(model.slices()["poses"].stop)
    return counted, model, filled(model, x, (color.camera, depth), square_m, T)


def _depth_start(task: Task, counted: Counted, color: LensStart) -> tuple[Counted, PinholeCamera, FloatArray]:
    """A depth lens and T_color_depth to begin with, and infrared corners numbered as colour's are."""
    seen, nominal = task.seen, task.setup.known_cameras
    if seen.depth_size is None or task.setup.is_registered:
        return counted, color.camera, np.eye(4)
    both = [k for k, corners in enumerate(counted.infrared) if corners is not None]
    if not both:
        if nominal is not None:
            return counted, nominal.cameras[1], nominal.T_color_camera
        return counted, usual_lens(seen.depth_size), np.eye(4)
    corners = [seen_corners for seen_corners in counted.infrared if seen_corners is not None]
    lens = lens_from_corners(corners, task.board, seen.depth_size)
    T_color, T_depth, infrared = color.T_camera_board[both], lens.T_camera_board.copy(), list(counted.infrared)
    for index, k in enumerate(both):
        # A board that looks the same upside down may be numbered from its other end in the other image.
        if so3.angle(T_color[index, :3, :3] @ T_depth[index, :3, :3].T) > np.pi / 2:
            turned = corners[index].turned(task.board.count)
            infrared[k] = turned
            T_depth[index] = poses_in(lens.camera, [turned], task.board).T_camera_board[0]
    square_m = task.first_square_m
    apart = apart_by_poses(_scaled(T_color, square_m), _scaled(T_depth, square_m))
    return replace(counted, infrared=tuple(infrared)), lens.camera, apart


def _scaled(T: FloatArray, square_m: float) -> FloatArray:
    return se3.from_parts(T[..., :3, :3], T[..., :3, 3] * square_m)


def _square_by_depth(task: Task, counted: Counted, depth: PinholeCamera, T_color_board: FloatArray) -> float:
    """Side of a square as depth in the middle of the boards tells it, the median over views."""
    found = []
    for view, T in zip(counted.views, T_color_board, strict=True):
        if view.reading is None:
            continue
        middle = se3.apply(T, task.squares).mean(axis=0)
        u, v = np.round(depth.denormalise(middle[:2] / middle[2])).astype(int).tolist()
        rows, columns = (slice(max(at - _AROUND_PX, 0), max(at + _AROUND_PX + 1, 0)) for at in (v, u))
        around = view.reading[rows, columns]
        around = around[np.isfinite(around) & (around > 0)]
        if len(around):
            found.append(float(task.nominal_m(np.array([np.median(around)]))[0]) / middle[2])
    if not found:
        raise CalibrationError("no depth is seen where the boards are", fix="give the depth camera by --calibration")
    return float(np.median(found))


def _again(
    task: Task, before: Counted, counted: Counted, model: Model, solution: Solution, *, is_first: bool
) -> tuple[Counted, Model, FloatArray]:
    """The model of what is left, and the parameters as they were found; depth cells anew after the first round."""
    x, fewest = solution.x, task.settings.refusal.fewest_views
    if len(counted.views) < fewest:
        names = ", ".join(f"{name}: {reason}" for name, reason in counted.left_out[-2:])
        problem = f"only {len(counted.views)} views agree with each other; left out {names}"
        raise CalibrationError(problem, fix="hold board and camera still, and take more views")
    kept = [before.views.index(view) for view in counted.views]
    T = se3.from_parts(*model.poses_of(x))[kept]
    lenses, square_m = (model.color_camera(x), model.depth_camera(x)), model.square_of(x)
    if is_first and task.seen.has_depth:
        T_depth_board = se3.invert(model.T_color_depth_of(x)) @ T
        counted = with_cells(task, counted, T_depth_board, lenses[1], square_m, _BOARD_SHARE)
    new = model_of(task, counted, (model.color_start, model.depth_start), model.T_color_depth)
    if not is_first:
        new = replace(new, knots_m=model.knots_m)
    y = np.zeros(new.slices()["poses"].stop)
    for name in ("apart", "error"):
        old, place = x[model.slices()[name]], new.slices()[name]
        if len(old) == place.stop - place.start:
            y[place] = old
    return counted, new, filled(new, y, lenses, square_m, T)
