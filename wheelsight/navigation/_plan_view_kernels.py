"""Compiled: what a camera looks at along a plan, and what the robot goes over."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import BoolArray, FloatArray, IntArray
from wheelsight.navigation._sweep_kernels import outside_m


class Eye(NamedTuple):
    """A camera that looks ahead.

    Attributes:
        x, y: where it sits in the base.
        half_rad: to either side, how far it sees.
        near_m, far_m: from it, the nearest floor that it looks over, and the farthest that counts.
    """

    x: float
    y: float
    half_rad: float
    near_m: float
    far_m: float


class Walls(NamedTuple):
    """What cannot be seen through.

    Attributes:
        is_there: (H, W) row 0 is the least y.
        resolution: metres a cell.
        origin: x and y of the corner of cell (0, 0).
    """

    is_there: BoolArray
    resolution: float
    origin: tuple[float, float]


@kernel
def first_over(poses: FloatArray, points: FloatArray, sides: FloatArray, out: IntArray) -> None:
    """Number of the first of poses (N, 3) at which an outline holds each point (M, 2), or N, into (M,)."""
    reach2 = (sides[:, 0] ** 2 + sides[:, 1] ** 2).max()
    out[:] = len(poses)
    for n in range(len(poses)):
        c, s = np.cos(poses[n, 2]), np.sin(poses[n, 2])
        for m in range(len(points)):
            if out[m] < n:
                continue
            dx, dy = points[m, 0] - poses[n, 0], points[m, 1] - poses[n, 1]
            if dx * dx + dy * dy > reach2:
                continue
            if outside_m(sides, c * dx + s * dy, -s * dx + c * dy) <= 0.0:
                out[m] = n


@kernel
def first_blind(
    poses: FloatArray, points: FloatArray, slack_m: FloatArray, over: IntArray, eye: Eye, walls: Walls, lag: int
) -> Any:
    """Number of the first pose that goes over a point which no pose, so many before it and more, looks at; or N.

    A point counts as looked at where something so near to it is. `over` is by `first_over`.
    """
    first = len(poses)
    for m in range(len(points)):
        if over[m] >= first:
            continue
        is_seen = False
        for n in range(over[m] - lag, -1, -1):
            if _looks_at(poses[n], points[m], slack_m[m], eye, walls):
                is_seen = True
                break
        if not is_seen:
            first = over[m]
    return first


@kernel
def _looks_at(pose: FloatArray, point: FloatArray, slack_m: float, eye: Eye, walls: Walls) -> Any:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = pose[0] + c * eye.x - s * eye.y, pose[1] + s * eye.x + c * eye.y
    dx, dy = point[0] - x, point[1] - y
    away = np.sqrt(dx * dx + dy * dy)
    if away < eye.near_m - slack_m or away > eye.far_m:
        return False
    beyond = abs(np.arctan2(-s * dx + c * dy, c * dx + s * dy)) - eye.half_rad
    if beyond > 0.0 and (beyond > np.pi / 2 or away * np.sin(beyond) > slack_m):
        return False
    steps = int(away / walls.resolution)
    for k in range(1, steps):
        column = int(np.floor((x + dx * k / steps - walls.origin[0]) / walls.resolution))
        row = int(np.floor((y + dy * k / steps - walls.origin[1]) / walls.resolution))
        if 0 <= row < len(walls.is_there) and 0 <= column < walls.is_there.shape[1] and walls.is_there[row, column]:
            return False
    return True
