"""Compiled: how far an outline goes along an arc before it meets things, or floor that was not seen."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import ByteArray, Float32Array, FloatArray
from wheelsight.navigation._field_kernels import moved


class Ground(NamedTuple):
    """What is known of the floor about a robot.

    Attributes:
        deep_m: (m, m) metres into floor that was never seen; rows along x, columns along y.
        is_old: (m, m) 1 where it was not seen lately.
        first: i and j of the first cell in the plane.
        cell_m: side of a cell.
        pose: of the robot in the plane: x, y, cosine, sine.
    """

    deep_m: Float32Array
    is_old: ByteArray
    first: tuple[int, int]
    cell_m: float
    pose: tuple[float, float, float, float]


@kernel
def outside_m(sides: FloatArray, x: float, y: float) -> Any:
    """Metres from an outline (sides as `Outline` has them) to a point in its frame; beside a corner it may be less."""
    most = -np.inf
    for k in range(len(sides)):
        most = max(most, sides[k, 3] * (x - sides[k, 0]) - sides[k, 2] * (y - sides[k, 1]))
    return most


@kernel
def all_outside_m(sides: FloatArray, points: FloatArray) -> Any:
    """The same of points (N, 2)."""
    away = np.empty(len(points))
    for k in range(len(points)):
        away[k] = outside_m(sides, points[k, 0], points[k, 1])
    return away


@kernel
def _steps_free(away_m: float, margin_m: float, stride_m: float) -> Any:
    """For how many steps a thing stays beyond a margin, for in each it comes nearer by a stride at most."""
    return 1 + int((away_m - margin_m) / stride_m) if away_m > margin_m and stride_m > 0 else 1


@kernel
def _strides_m(points: FloatArray, arc: Any, steps: int) -> Any:
    """(N,) how far things move against the robot in a step of an arc, at most."""
    strides = np.empty(len(points))
    for k in range(len(points)):
        lever = np.hypot(points[k, 0], points[k, 1]) + abs(arc[0])
        strides[k] = (abs(arc[0]) + lever * abs(arc[1])) / steps
    return strides


@kernel
def clear_share(sides: FloatArray, points: FloatArray, arc: Any, steps: int, margin_m: float) -> Any:
    """The share of an arc (way, turn) that an outline goes before a thing (N, 2) is nearer than a margin.

    Things that are nearer already count where they come nearer still.
    """
    before = all_outside_m(sides, points)
    strides = _strides_m(points, arc, steps)
    due = np.empty(len(points), np.int64)
    for k in range(len(points)):
        due[k] = _steps_free(before[k], margin_m, strides[k])
    for n in range(1, steps + 1):
        x, y, c, s = moved((0.0, 0.0, 1.0, 0.0), arc[0] * n / steps, arc[1] * n / steps)
        for k in range(len(points)):
            if due[k] > n:
                continue
            dx, dy = points[k, 0] - x, points[k, 1] - y
            away = outside_m(sides, c * dx + s * dy, -s * dx + c * dy)
            if away < margin_m and away < before[k] - 1e-6:
                return (n - 1) / steps
            due[k] = n + _steps_free(away, margin_m, strides[k])
    return 1.0


@kernel
def zone_share(sides: FloatArray, points: FloatArray, arc: Any, steps: int, zone_m: float) -> Any:
    """The share of an arc (way, turn) that an outline goes before a thing (N, 2) is within a zone."""
    strides = _strides_m(points, arc, steps)
    due = np.zeros(len(points), np.int64)
    for n in range(steps + 1):
        x, y, c, s = moved((0.0, 0.0, 1.0, 0.0), arc[0] * n / steps, arc[1] * n / steps)
        for k in range(len(points)):
            if due[k] > n:
                continue
            dx, dy = points[k, 0] - x, points[k, 1] - y
            away = outside_m(sides, c * dx + s * dy, -s * dx + c * dy)
            if away < zone_m:
                return max(n - 1, 0) / steps
            due[k] = n + _steps_free(away, zone_m, strides[k])
    return 1.0


@kernel
def seen_shares(outline: FloatArray, sides: FloatArray, ground: Ground, arc: Any, steps: int, deep_m: float) -> Any:
    """The shares of an arc that points (K, 2) of an outline go before one is too deep in floor never seen, and before
    one is over floor that was not seen lately. What the robot covers now is none of it.
    """
    old = 1.0
    px, py, pc, ps = ground.pose
    rows, columns = ground.deep_m.shape
    for n in range(1, steps + 1):
        x, y, c, s = moved((0.0, 0.0, 1.0, 0.0), arc[0] * n / steps, arc[1] * n / steps)
        for k in range(len(outline)):
            bx, by = x + c * outline[k, 0] - s * outline[k, 1], y + s * outline[k, 0] + c * outline[k, 1]
            beside_m = outside_m(sides, bx, by)
            if beside_m <= 0.0:
                continue
            i = int(np.floor((px + pc * bx - ps * by) / ground.cell_m)) - ground.first[0]
            j = int(np.floor((py + ps * bx + pc * by) / ground.cell_m)) - ground.first[1]
            outside = i < 0 or j < 0 or i >= rows or j >= columns
            # A cell that the robot covers in part is not seen, and no news.
            if old == 1.0 and beside_m > 1.5 * ground.cell_m and (outside or ground.is_old[i, j] == 1):
                old = (n - 1) / steps
            if outside or ground.deep_m[i, j] > deep_m:
                return (n - 1) / steps, old
    return 1.0, old


@kernel
def deepest_m(points: FloatArray, ground: Ground) -> Any:
    """How deep in floor never seen the deepest of points (N, 2) of a robot is; infinite beyond what is known."""
    px, py, pc, ps = ground.pose
    rows, columns = ground.deep_m.shape
    most = 0.0
    for k in range(len(points)):
        i = int(np.floor((px + pc * points[k, 0] - ps * points[k, 1]) / ground.cell_m)) - ground.first[0]
        j = int(np.floor((py + ps * points[k, 0] + pc * points[k, 1]) / ground.cell_m)) - ground.first[1]
        if i < 0 or j < 0 or i >= rows or j >= columns:
            return np.inf
        most = max(most, ground.deep_m[i, j])
    return most
