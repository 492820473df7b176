"""What a solution leaves open of where points are seen, as modes of one standard deviation each."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wheelsight.camera_calibration.model import Model
from wheelsight.camera_calibration.readings import grid_px, reading_m, readings_for
from wheelsight.camera_calibration.solve import Solution
from wheelsight.geometry import FloatArray, se3
from wheelsight.point_errors import TERMS, PointErrors, mode_of

_STEP = 1e-6
_ACROSS, _DOWN, _DISTANCES = 9, 7, 6
_NEAREST_M = 0.6  # where depth cameras of all kinds see
_KEPT = 0.999  # of the variance of points, over their distance
_TINY = 1e-9  # of the variance, so that no direction is without any


def point_modes(model: Model, solution: Solution) -> PointErrors:
    """How far off points are in the colour camera's frame, as far as depth is told: of all that is sought but poses.

    A point is what lens, depth's error and the place of the cameras make of a reading. What the colour lens leaves open
    is in it: boards are seen by that lens, and what it has wrong, depth that lies on boards has wrong likewise.
    """
    x, at = solution.x, model.slices()
    blocks = ("color", "error") if model.is_registered else ("depth", "apart", "error")
    columns = [k for name in blocks for k in range(at[name].start, at[name].stop)]
    points_of = _points_of(model, x, model.settings.model.stated_to_m)
    here = points_of(x)
    moved = np.stack([(points_of(_moved(x, k)) - here) / _STEP for k in columns])
    modes = mode_of(here, moved)
    # Points over their distance, by coefficients: an orthogonal basis of them makes variances comparable.
    unit = PointErrors(tuple(map(tuple, np.eye(TERMS).tolist()))).moved_m(here)
    _, R = np.linalg.qr((unit / here[None, :, 2:]).reshape(len(unit), -1).T)
    some = [R @ modes.T @ C[np.ix_(columns, columns)] @ modes @ R.T for C in (solution.covariance, solution.by_views)]
    variances, directions = np.linalg.eigh(_larger(*some))
    order = np.argsort(variances)[::-1]
    enough = int(np.searchsorted(np.cumsum(variances[order]) / variances.sum(), _KEPT)) + 1
    kept = order[:enough]
    found = np.linalg.solve(R, directions[:, kept] * np.sqrt(variances[kept])).T
    return PointErrors(tuple(map(tuple, found.tolist())))


def _moved(x: FloatArray, k: int) -> FloatArray:
    y = x.copy()
    y[k] += _STEP
    return y


def _points_of(model: Model, x: FloatArray, farthest_m: float) -> Callable[[FloatArray], FloatArray]:
    """What parameters make of the readings that `x` makes points all over image and distances of: (N, 3)."""
    camera = model.depth_camera(x)
    distances_m = np.geomspace(_NEAREST_M, farthest_m, _DISTANCES)
    px = np.tile(grid_px(camera, _ACROSS, _DOWN), (_DISTANCES, 1))
    depth_m = np.repeat(distances_m, _ACROSS * _DOWN)
    readings = readings_for(model.error_of(x), depth_m, px, camera)

    def points(y: FloatArray) -> FloatArray:
        error, lens = model.error_of(y), model.depth_camera(y)
        seen_m = error.of_readings(reading_m(error, readings), px, lens)
        return np.asarray(se3.apply(model.T_color_depth_of(y), lens.back_project(px, seen_m)))

    return points


def _larger(a: FloatArray, b: FloatArray) -> FloatArray:
    """The covariance that is in no direction smaller than either of two."""
    L = np.linalg.cholesky(b + _TINY * np.trace(b) * np.eye(len(b)))
    inverse = np.linalg.inv(L)
    values, directions = np.linalg.eigh(inverse @ a @ inverse.T)
    across = L @ directions
    return np.asarray((across * np.maximum(values, 1.0)) @ across.T)
