"""Compiled parts of people's walking: where a robot leaves room, and the best of the steps that stay safe."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import FloatArray


class RouteGrid(NamedTuple):
    """How far along a route each cell lies (R, C), and how far left of it (R, C); along starts again after a lap."""

    along_m: FloatArray
    left_m: FloatArray
    lap_m: float


class Wish(NamedTuple):
    """How far somebody wants to step along the route, negative for back, and how far left of it to be, metres."""

    stride_m: float
    favourite_m: float


@kernel
def keep_clear(
    clear: Any, cell_m: float, corner_m: Any, xy_robot_m: Any, R_world_robot: Any, outline_m: Any, distance_m: float
) -> None:
    """Set cells of `clear` (R, C) to 0 whose centres are nearer than `distance_m` to the robot's outline.

    Cell (row, column) is centred `cell_m` · (column, row) from `corner_m` (2,). `outline_m` (x_back, x_front, y_half)
    is a rectangle in the robot's frame, which stands at `xy_robot_m` (2,), turned by R (2, 2).
    """
    reach_m = max(abs(outline_m[0]), abs(outline_m[1])) + outline_m[2] + distance_m
    middle = (xy_robot_m - corner_m) / cell_m
    reach = reach_m / cell_m + 1
    for row in range(max(int(middle[1] - reach), 0), min(int(middle[1] + reach) + 2, clear.shape[0])):
        for column in range(max(int(middle[0] - reach), 0), min(int(middle[0] + reach) + 2, clear.shape[1])):
            dx = corner_m[0] + cell_m * column - xy_robot_m[0]
            dy = corner_m[1] + cell_m * row - xy_robot_m[1]
            x = R_world_robot[0, 0] * dx + R_world_robot[1, 0] * dy
            y = abs(R_world_robot[0, 1] * dx + R_world_robot[1, 1] * dy)
            past_x = max(outline_m[0] - x, x - outline_m[1], 0.0)
            past_y = max(y - outline_m[2], 0.0)
            if past_x * past_x + past_y * past_y < distance_m * distance_m:
                clear[row, column] = 0


@kernel
def best_step(
    safe: Any, route: RouteGrid, steps: Any, row: int, column: int, wish: Wish, taken: Any, apart: float
) -> tuple[int, int]:
    """The cell (row, column) to step to, of those that are `safe` (R, C) and one of `steps` (K, 2) away.

    Wanted is the stride of `wish`, then to be where it says beside the route, and `apart` cells from others' cells
    `taken` (N, 2). (-1, -1) where no step is safe.
    """
    along_m, left_m, lap_m = route
    stride_m, favourite_m = wish
    best, found = np.inf, (-1, -1)
    for k in range(len(steps)):
        r, c = row + steps[k, 0], column + steps[k, 1]
        if not (0 <= r < safe.shape[0] and 0 <= c < safe.shape[1]) or not safe[r, c]:
            continue
        way_m = along_m[r, c] - along_m[row, column]
        way_m -= lap_m * np.round(way_m / lap_m)
        cost = abs(stride_m - way_m) / abs(stride_m) + 0.3 * abs(left_m[r, c] - favourite_m)
        for n in range(len(taken)):
            gap = np.sqrt((r - taken[n, 0]) ** 2 + (c - taken[n, 1]) ** 2)
            cost += 3 * max(apart - gap, 0.0) / apart
        if cost < best:
            best, found = cost, (r, c)
    return found
