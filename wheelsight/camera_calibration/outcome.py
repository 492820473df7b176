"""A solution as a result: lenses, standard deviations by name, and residuals in pixels and metres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.camera_calibration.board import Board
from wheelsight.camera_calibration.model import Points
from wheelsight.camera_calibration.point_modes import point_modes
from wheelsight.camera_calibration.readings import grid_px, reading_m, readings_for
from wheelsight.camera_calibration.residuals import Residuals
from wheelsight.camera_calibration.result import CameraCalibration, CornerResiduals, DepthResiduals, UsedView
from wheelsight.camera_calibration.solve import Solution
from wheelsight.camera_calibration.task import Counted
from wheelsight.camera_calibration.views import RAW_DISPARITY
from wheelsight.geometry import FloatArray, se3, so3

_STEP = 1e-6
_BARE = ("fx", "fy", "cx", "cy")
_BROWN = ("k1", "k2", "p1", "p2", "k3")
_AXES = ("x", "y", "z")
_DISTANCES, _ACROSS, _DOWN = 12, 9, 7


def outcome(residuals: Residuals, solution: Solution, board: Board, counted: Counted) -> CameraCalibration:
    """What a solution of what counts says."""
    model, x = residuals.model, solution.x
    R, t = model.poses_of(x)
    T = se3.from_parts(R, t)
    at = model.slices()
    has_depth = model.is_registered or at["apart"].stop > at["apart"].start
    depth = _depth_residuals(residuals, x)
    return CameraCalibration(
        board=replace(board, square_m=model.square_of(x)),
        color=model.color_camera(x),
        depth=model.depth_camera(x) if has_depth else None,
        T_color_depth=model.T_color_depth_of(x) if has_depth and not model.is_registered else None,
        depth_error=model.error_of(x),
        sensor=model.sensor,
        sigmas=sigmas_by_name(residuals, solution),
        depth_sigma_m=_depth_sigma(residuals, solution, depth),
        point_errors=point_modes(model, solution) if has_depth and len(model.cells.px) else None,
        color_sigma_px=_pixel_sigma(residuals, solution) if has_depth else 0.0,
        noise=_pixel_noise(residuals, depth) if len(model.cells.px) else None,
        views=tuple(
            UsedView(view.name, seen, pose) for view, seen, pose in zip(counted.views, counted.color, T, strict=True)
        ),
        left_out=counted.left_out,
        color_residuals=_corner_residuals(model.color, residuals.color(x) * residuals.sigmas.color_px),
        infrared_residuals=_corner_residuals(model.infrared, residuals.infrared(x) * residuals.sigmas.infrared_px),
        depth_residuals=depth,
        dropped_corners=counted.dropped_corners,
        dropped_cells=counted.dropped_cells,
    )


def sigmas_by_name(residuals: Residuals, solution: Solution) -> dict[str, float]:
    """Standard deviations of what a user knows by name."""
    model, x, at = residuals.model, solution.x, residuals.at
    named: dict[str, float] = {}
    for name, camera, start in (
        ("color", model.color_camera(x), model.color_start),
        ("depth", model.depth_camera(x), model.depth_start),
    ):
        size = at[name].stop - at[name].start
        if not size:
            continue
        J = np.eye(size)
        J[0] *= camera.fx
        J[1, :2] = camera.fy
        J[2:4] *= start.fx
        sigmas = solution.sigmas_of(J, at[name]).tolist()
        named |= {f"{name}.{k}": s for k, s in zip((*_BARE, *_BROWN), sigmas, strict=False)}
    if at["apart"].stop > at["apart"].start:
        # A perturbation from the left moves the way by v + ω × t.
        way = np.hstack([np.eye(3), -so3.hat(model.T_color_depth_of(x)[:3, 3])])
        turn = np.degrees(np.hstack([np.zeros((3, 3)), np.eye(3)]))
        sigmas = solution.sigmas_of(np.vstack([way, turn]), at["apart"]).tolist()
        named |= dict(
            zip([*(f"T.{axis}" for axis in _AXES), *(f"T.turn_{axis}_deg" for axis in _AXES)], sigmas, strict=True)
        )
    if model.square_m is None:
        named["square"] = float(solution.sigmas_of(np.full((1, 1), model.square_of(x)), at["square"])[0])
    return named


def _corner_residuals(points: Points, off_px: FloatArray) -> CornerResiduals:
    return CornerResiduals(points.view, points.px, off_px)


def _depth_residuals(residuals: Residuals, x: FloatArray) -> DepthResiduals:
    model = residuals.model
    if not len(model.cells.px):
        return DepthResiduals(np.empty(0, np.int64), np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0))
    off_m, _ = residuals.depth_m(x)
    error, camera = model.error_of(x), model.depth_camera(x)
    corrected = error.of_readings(reading_m(error, model.cells.reading), model.cells.px, camera)
    depth_m = corrected - off_m
    raw = model.cells.reading
    if model.sensor == RAW_DISPARITY:
        raw = 1 / np.maximum(-model.nominal_step * (model.settings.model.disparity_of_infinity - raw), 1e-3)
    return DepthResiduals(model.cells.view, model.cells.px, depth_m, off_m, raw - depth_m)


def _depth_sigma(residuals: Residuals, solution: Solution, depth: DepthResiduals) -> FloatArray:
    """(K, 2) distances from the nearest cell to the farthest, or on to where σ is stated anyway, and σ there.

    σ is of corrected depth, root mean square over pixels.
    """
    model, x = residuals.model, solution.x
    at = model.slices()["error"]
    if not len(depth.depth_m) or at.stop == at.start:
        return np.empty((0, 2))
    nearest_m, farthest_m = np.percentile(depth.depth_m, (1, 99)).tolist()
    distances_m = np.linspace(nearest_m, max(farthest_m, model.settings.model.stated_to_m), _DISTANCES)
    camera, error = model.depth_camera(x), model.error_of(x)
    px = grid_px(camera, 3, 3)
    readings = readings_for(error, np.repeat(distances_m, len(px)), np.tile(px, (_DISTANCES, 1)), camera)
    J = np.empty((len(readings), at.stop - at.start))

    def true_m(y: FloatArray) -> FloatArray:
        moved = model.error_of(y)
        return moved.of_readings(reading_m(moved, readings), np.tile(px, (_DISTANCES, 1)), camera)

    here = true_m(x)
    for k in range(at.start, at.stop):
        y = x.copy()
        y[k] += _STEP
        J[:, k - at.start] = (true_m(y) - here) / _STEP
    sigmas = solution.sigmas_of(J, at).reshape(_DISTANCES, -1)
    return np.stack([distances_m, np.sqrt((sigmas**2).mean(axis=1))], axis=-1)


def _pixel_sigma(residuals: Residuals, solution: Solution) -> float:
    """Root mean square over the depth image of the σ of where colour shows a depth pixel's point, pixels."""
    model, x = residuals.model, solution.x
    at = model.slices()
    if model.is_registered:
        return 0.0
    camera = model.depth_camera(x)
    T = se3.from_parts(*model.poses_of(x))
    px = grid_px(camera, _ACROSS, _DOWN)
    middle_m = np.full(len(px), float(np.median(T[:, 2, 3])))

    def color_px(y: FloatArray) -> FloatArray:
        p = model.depth_camera(y).back_project(px, middle_m)
        p = se3.apply(model.T_color_depth_of(y), p)
        return model.color_camera(y).denormalise(p[:, :2] / p[:, 2:]).ravel()

    columns = [*range(at["color"].start, at["color"].stop), *range(at["depth"].start, at["depth"].stop)]
    columns += range(at["apart"].start, at["apart"].stop)
    here = color_px(x)
    J = np.empty((len(here), len(columns)))
    for index, k in enumerate(columns):
        y = x.copy()
        y[k] += _STEP
        J[:, index] = (color_px(y) - here) / _STEP
    return float(np.sqrt(2 * (solution.sigmas_of(J, columns) ** 2).mean()))


def _pixel_noise(residuals: Residuals, depth: DepthResiduals) -> tuple[float, float]:
    """Noise of one pixel, (constant_m, quadratic_per_m): the law that was taken, as large as pixels scatter."""
    model = residuals.model
    sigma_m = model.cells.scatter * depth.depth_m**2
    if model.sensor == RAW_DISPARITY:
        sigma_m = sigma_m * -model.nominal_step
    constant, quadratic = model.noise
    factor = float(np.median(sigma_m / (constant + quadratic * depth.depth_m**2)))
    return factor * constant, factor * quadratic
