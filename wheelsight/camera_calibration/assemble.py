"""A model of what counts: corners and cells of all views in arrays, and the parameters to begin with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wheelsight.camera_calibration.depth_cells import board_cells
from wheelsight.camera_calibration.model import Cells, Model, Points, lens_parameters
from wheelsight.camera_calibration.task import Counted, Task
from wheelsight.camera_calibration.views import RAW_DISPARITY, Corners, DepthCells
from wheelsight.depth_error import LARGEST_GRID
from wheelsight.geometry import FloatArray, PinholeCamera, se3, so3

# Noise of one pixel by how depth is measured: Khoshelham & Elberink 2012, Fankhauser et al. 2015, and of stereo 0.1 px
# of disparity with 50 mm between lenses of 640 px (Intel's tuning guide for D400 cameras).
_NOISE = {
    "structured-light": (0.001, 1.425e-3),
    "tof": (0.0015, 0.2e-3),
    "stereo": (0.001, 3.1e-3),
}
_LEAST_NOISE_M = 1e-4


def model_of(
    task: Task, counted: Counted, lenses: tuple[PinholeCamera, PinholeCamera], T_color_depth: FloatArray
) -> Model:
    """The model of what counts, about lenses of colour and depth and T_color_depth."""
    sensor = RAW_DISPARITY if task.seen.is_disparity else task.setup.sensor
    cells = _joined_cells(counted.cells)
    return Model(
        color=_joined(counted.color, task.squares),
        infrared=_joined(counted.infrared, task.squares),
        cells=cells,
        color_start=lenses[0],
        depth_start=lenses[1],
        sensor=sensor,
        is_registered=task.setup.is_registered,
        square_m=task.board.square_m if task.board.is_size_known else None,
        noise=_noise(task, sensor),
        knots_m=_knots(task, sensor, cells),
        T_color_depth=T_color_depth,
        count=len(counted.views),
        settings=task.settings,
        keeps_color=task.setup.keeps_color,
    )


def filled(
    model: Model, x: FloatArray, lenses: tuple[PinholeCamera, PinholeCamera], square_m: float, T: FloatArray
) -> FloatArray:
    """Parameters with these lenses, square and poses (V, 4, 4), metres; the rest is that of x."""
    at, y = model.slices(), x.copy()
    y[at["color"]] = lens_parameters(lenses[0], model.color_start)
    size = at["depth"].stop - at["depth"].start
    if size:
        y[at["depth"]] = lens_parameters(lenses[1], model.depth_start)[:size]
    if model.square_m is None:
        y[at["square"]] = np.log(square_m)
    y[at["poses"]] = np.concatenate([T[:, :3, 3] / square_m, so3.log(T[:, :3, :3])], axis=1).ravel()
    return y


def with_cells(
    task: Task,
    counted: Counted,
    T_depth_board: FloatArray,
    depth: PinholeCamera,
    square_m: float,
    share: float,
) -> Counted:
    """The same with depth cells of each view, within `share` of the board's outline as it is believed to lie.

    Args:
        task: how cells are chosen.
        counted: the views.
        T_depth_board: (V, 4, 4), metres.
        depth: the depth lens.
        square_m: side of a square.
        share: of the outline, about its middle; where the board is on a plate, of what its plane is learned from.
    """
    columns, rows = task.board.columns, task.board.rows
    corners = np.array([[-1, -1, 0], [columns, -1, 0], [columns, rows, 0], [-1, rows, 0]], float)
    middle = corners.mean(axis=0)
    outline_m = square_m * (middle + share * (corners - middle))
    cells = []
    for view, T in zip(counted.views, T_depth_board, strict=True):
        p = se3.apply(T, outline_m)
        if view.reading is None or (p[:, 2] <= 0).any():
            cells.append(DepthCells.none())
            continue
        outline_px = depth.denormalise(p[:, :2] / p[:, 2:])
        how = {"is_disparity": task.seen.is_disparity, "on_plate": task.setup.on_plate}
        cells.append(board_cells(view.reading, outline_px, task.settings.depth, **how))
    return replace(counted, cells=tuple(cells), dropped_cells=0)


def _noise(task: Task, sensor: str) -> tuple[float, float]:
    """(constant_m, quadratic_per_m) of one pixel."""
    settings, nominal = task.settings, task.setup.known_cameras
    if sensor == RAW_DISPARITY:
        return _LEAST_NOISE_M, settings.depth.sigma_disparity / settings.depth.sigma_share * -task.nominal_step
    if nominal is not None:
        return nominal.depth_noise.constant_m, nominal.depth_noise.quadratic_per_m
    return _NOISE[sensor]


def _knots(task: Task, sensor: str, cells: Cells) -> FloatArray:
    """Distances (K,) of the curve's knots, from the sensor's nearest to its farthest or as far as boards were."""
    if sensor != "tof" or not len(cells.reading):
        return np.empty(0)
    settings = task.settings.model
    low = min(settings.curve_from_m, float(np.percentile(cells.reading, 1)))
    high = max(settings.curve_to_m, float(np.percentile(cells.reading, 99)))
    count = int((high - low) / settings.curve_step_m) + 1
    return np.linspace(low, high, min(max(count, 2), LARGEST_GRID))


def _joined(corners: Sequence[Corners | None], squares: FloatArray) -> Points:
    seen = [(k, c) for k, c in enumerate(corners) if c is not None]
    if not seen:
        return Points(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 2)))
    view = np.concatenate([np.full(len(c.ids), k) for k, c in seen])
    return Points(view, np.concatenate([squares[c.ids] for _, c in seen]), np.concatenate([c.px for _, c in seen]))


def _joined_cells(cells: Sequence[DepthCells]) -> Cells:
    view = np.concatenate([np.full(len(c.reading), k) for k, c in enumerate(cells)]).astype(np.int64)
    px, reading, scatter = (np.concatenate([getattr(c, name) for c in cells]) for name in ("px", "reading", "scatter"))
    return Cells(view, px, reading, scatter)
