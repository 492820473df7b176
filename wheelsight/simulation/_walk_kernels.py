"""Compiled parts of people's walking: where a robot leaves room, and the best of the steps that stay safe."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def keeps_clear(xy_m: Any, is_free: Any, xy_robot_m: Any, R_world_robot: Any, outline_m: Any, distance_m: float) -> Any:
    """(S, L) uint8: 1 for free places at least `distance_m` from the robot's outline, else 0.

    `xy_m` (S, L, 2) are the places, `outline_m` (x_back, x_front, y_half) is a rectangle in the robot's frame, which
    stands at `xy_robot_m` (2,), turned by R (2, 2).
    """
    clear = np.zeros(is_free.shape, np.uint8)
    for s in range(is_free.shape[0]):
        for side in range(is_free.shape[1]):
            if not is_free[s, side]:
                continue
            dx, dy = xy_m[s, side, 0] - xy_robot_m[0], xy_m[s, side, 1] - xy_robot_m[1]
            x = R_world_robot[0, 0] * dx + R_world_robot[1, 0] * dy
            y = abs(R_world_robot[0, 1] * dx + R_world_robot[1, 1] * dy)
            past_x = max(outline_m[0] - x, x - outline_m[1], 0.0)
            past_y = max(y - outline_m[2], 0.0)
            clear[s, side] = past_x * past_x + past_y * past_y >= distance_m * distance_m
    return clear


@njit(cache=True, nogil=True)
def best_step(
    safe: Any,
    xy_m: Any,
    is_loop: bool,
    s: int,
    side: int,
    reach_s: int,
    reach_side: int,
    heading: int,
    stride_m: float,
    favourite: int,
    taken_m: Any,
    apart_m: float,
) -> tuple[int, int]:
    """The place (s, side) to step to, of those in reach that are `safe` (S, L).

    Wanted is a step of `stride_m` metres in the direction `heading` along the route, towards the `favourite` side and
    `apart_m` away from the places `taken_m` (K, 2) of others. (-1, -1) where no step is safe.
    """
    best, found = np.inf, (-1, -1)
    for ds in range(-reach_s, reach_s + 1):
        to_s = s + ds
        if is_loop:
            to_s %= safe.shape[0]
        if to_s < 0 or to_s >= safe.shape[0]:
            continue
        for to_side in range(max(side - reach_side, 0), min(side + reach_side, safe.shape[1] - 1) + 1):
            if not safe[to_s, to_side]:
                continue
            x, y = xy_m[to_s, to_side]
            way = np.sqrt((x - xy_m[s, side, 0]) ** 2 + (y - xy_m[s, side, 1]) ** 2)
            ahead = way if ds * heading > 0 else -way if ds * heading < 0 else 0.0
            cost = abs(stride_m - ahead) / stride_m + 0.02 * abs(to_side - favourite) + 0.05 * abs(to_side - side)
            for k in range(len(taken_m)):
                gap = np.sqrt((x - taken_m[k, 0]) ** 2 + (y - taken_m[k, 1]) ** 2)
                cost += 3 * max(apart_m - gap, 0.0) / apart_m
            if cost < best:
                best, found = cost, (to_s, to_side)
    return found
