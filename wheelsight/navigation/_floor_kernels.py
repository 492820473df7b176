"""Compiled: which unknown cells of a grid lie in sight of a place."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel


@kernel
def mark_in_sight(state: Any, place: Any, reach: float, states: Any, found: Any) -> None:
    """Mark unknown cells whose middle is within reach of a place with nothing occupied on the line between them.

    Args:
        state: (H, W) of cells.
        place: (2,) column and row, in cells from the grid's corner.
        reach: in cells.
        states: which value is unknown, and which occupied.
        found: (H, W) bool, marked.
    """
    unknown, occupied = states
    height, width = state.shape
    for row in range(max(int(place[1] - reach), 0), min(int(place[1] + reach) + 2, height)):
        for column in range(max(int(place[0] - reach), 0), min(int(place[0] + reach) + 2, width)):
            x, y = column + 0.5 - place[0], row + 0.5 - place[1]
            if state[row, column] == unknown and np.sqrt(x * x + y * y) <= reach:
                found[row, column] = _is_open(state, place, (x, y), reach, occupied)


@kernel
def _is_open(state: Any, place: Any, way: Any, reach: float, occupied: int) -> bool:
    """Whether a way (x, y) in cells from a place meets nothing occupied."""
    steps = 1 + int(2 * reach)
    for k in range(steps + 1):
        share = k / steps
        row, column = int(np.floor(place[1] + share * way[1])), int(np.floor(place[0] + share * way[0]))
        if 0 <= row < state.shape[0] and 0 <= column < state.shape[1] and state[row, column] == occupied:
            return False
    return True
