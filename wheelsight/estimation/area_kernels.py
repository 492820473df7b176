"""Compiled inner loops of fusion: a Gaussian's parts in areas, a step of the wheels, eq. 5 along a drive."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from wheelsight.core.compiled import kernel

REACH = 4.5


@kernel
def parts_in_areas(mean: Any, axes: Any, steps_0: int, steps_1: int, shares: Any, corner: Any, cell_m: float) -> Any:
    """Mass, first and second moments (A + 1, 6) of a Gaussian's parts in each area and, last, outside them.

    The Gaussian is `mean + axes @ u`, u standard normal in the plane, summed over a grid of `steps_0` by `steps_1`
    points within ±4.5. The columns are 1, u0, u1, u0², u0 u1, u1². `shares` (rows y, columns x, A) says which share
    of each point of the floor belongs to each area; cell (0, 0) has its centre at `corner`.
    """
    rows, columns, areas = shares.shape
    parts = np.zeros((areas + 1, 6))
    for i in range(steps_0):
        u0 = REACH * (2 * i + 1 - steps_0) / steps_0
        weight_0 = math.exp(-u0 * u0 / 2)
        for j in range(steps_1):
            u1 = REACH * (2 * j + 1 - steps_1) / steps_1
            weight = weight_0 * math.exp(-u1 * u1 / 2)
            column = (mean[0] + axes[0, 0] * u0 + axes[0, 1] * u1 - corner[0]) / cell_m
            row = (mean[1] + axes[1, 0] * u0 + axes[1, 1] * u1 - corner[1]) / cell_m
            left = weight
            if 0 <= column < columns - 1 and 0 <= row < rows - 1:
                c, r = int(column), int(row)
                right, up = column - c, row - r
                for a in range(areas):
                    low = (1 - right) * shares[r, c, a] + right * shares[r, c + 1, a]
                    high = (1 - right) * shares[r + 1, c, a] + right * shares[r + 1, c + 1, a]
                    share = weight * ((1 - up) * low + up * high)
                    if share > 0:
                        left -= share
                        _add(parts, a, share, u0, u1)
            _add(parts, areas, left, u0, u1)
    return parts / parts[:, 0].sum()


@kernel
def _add(parts: Any, area: int, weight: float, u0: float, u1: float) -> None:
    parts[area, 0] += weight
    parts[area, 1] += weight * u0
    parts[area, 2] += weight * u1
    parts[area, 3] += weight * u0 * u0
    parts[area, 4] += weight * u0 * u1
    parts[area, 5] += weight * u1 * u1


@kernel
def step(state: Any, covariance: Any, step_mean: Any, step_covariance: Any, walk: Any) -> None:
    """Move `state` (6,), x, y, yaw, scale, drift, turn, and its covariance (6, 6) by a step of the wheels, in place.

    `step_mean` (3,) is forward, left, yaw as the wheels tell it in the frame before it, `step_covariance` (3, 3) of
    these; `walk` (3,) how far the variances of scale, drift and turn grow in one metre.
    """
    forward, left, yaw = step_mean
    extra = state[4] * forward + state[5] * yaw
    halfway = state[2] + extra / 2
    c, s = math.cos(halfway), math.sin(halfway)
    east, north = c * forward - s * left, s * forward + c * left
    scale = 1 + state[3]
    state[0] += scale * east
    state[1] += scale * north
    state[2] += yaw + extra
    turned, pushed = np.eye(6), np.zeros((6, 3))
    turned[0, 2], turned[1, 2] = -scale * north, scale * east
    turned[0, 3], turned[1, 3] = east, north
    for column, by in ((4, forward), (5, yaw)):
        turned[2, column] = by
        turned[0, column], turned[1, column] = -scale * north * by / 2, scale * east * by / 2
    pushed[0, 0], pushed[0, 1], pushed[1, 0], pushed[1, 1], pushed[2, 2] = c, -s, s, c, 1.0
    grown = turned @ covariance @ turned.T + pushed @ step_covariance @ pushed.T
    way = math.hypot(forward, left)
    for i in range(6):
        for j in range(6):
            covariance[i, j] = (grown[i, j] + grown[j, i]) / 2
    for i in range(3):
        covariance[3 + i, 3 + i] += walk[i] * way


@kernel
def rectify(odometry: Any, reported: Any, reported_weights: Any, unreported_weights: Any, is_increment: bool) -> Any:
    """Eq. 5 along a drive for one axis: coordinates (N,) from those of odometry (N,) and of the areas (N,), NaN none.

    Weights are (alpha, beta, gamma). The first coordinate is odometry's.
    """
    found = odometry.copy()
    for t in range(1, len(odometry)):
        term = found[t - 1] + odometry[t] - odometry[t - 1] if is_increment else odometry[t]
        if math.isnan(reported[t]):
            found[t] = unreported_weights[0] * found[t - 1] + unreported_weights[1] * term
        else:
            found[t] = (
                reported_weights[0] * found[t - 1] + reported_weights[1] * term + reported_weights[2] * reported[t]
            )
    return found
