"""Compiled: marks obstacles in a grid from cells of another one, and says what driving over each cell costs."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel

_PARTS = 4


class Cells(NamedTuple):
    """A grid's cells: side in metres, and x and y of the corner of cell (0, 0)."""

    resolution_m: float
    x: float
    y: float


class Falls(NamedTuple):
    """How cost falls away from obstacles; see `CostmapSettings`.

    Attributes:
        near_m: from the middle of an obstacle's cell to where it begins to fall.
        inflation_m, decay_per_m, unknown_cost: of the settings.
    """

    near_m: float
    inflation_m: float
    decay_per_m: float
    unknown_cost: float


@kernel
def mark_occupied(is_occupied: Any, of: Cells, T: Any, to: Cells, occupied: int, state: Any) -> None:
    """Mark all cells of a grid in which any sixteenth of another grid's occupied cell has its middle.

    Args:
        is_occupied: (h, w) of the other grid, whose cells are `of`.
        T: x, y, cosine and sine of where that lies in this one's frame.
        to, state: (H, W) this grid.
        occupied: value that marks.
    """
    x, y, c, s = T
    for i in range(is_occupied.shape[0]):
        for j in range(is_occupied.shape[1]):
            if not is_occupied[i, j]:
                continue
            for k in range(_PARTS * _PARTS):
                a = of.x + of.resolution_m * (j + (k % _PARTS + 0.5) / _PARTS)
                b = of.y + of.resolution_m * (i + (k // _PARTS + 0.5) / _PARTS)
                column = int(np.floor((x + c * a - s * b - to.x) / to.resolution_m))
                row = int(np.floor((y + s * a + c * b - to.y) / to.resolution_m))
                if 0 <= row < state.shape[0] and 0 <= column < state.shape[1]:
                    state[row, column] = occupied


@kernel
def costs(state: Any, is_lethal: Any, distance_m: Any, falls: Falls, unknown: int) -> Any:
    """(H, W) float32 from 0 to 1, 1 on obstacles: exp(-decay · distance) about them, and no less where unknown."""
    rows, columns = state.shape
    found = np.zeros((rows, columns), np.float32)
    for i in range(rows):
        for j in range(columns):
            cost = 0.0
            beyond_m = max(distance_m[i, j] - falls.near_m, 0.0)
            if is_lethal[i, j]:
                cost = 1.0
            elif beyond_m <= falls.inflation_m:
                cost = np.exp(-falls.decay_per_m * beyond_m)
            if state[i, j] == unknown:
                cost = max(cost, falls.unknown_cost)
            found[i, j] = cost
    return found
