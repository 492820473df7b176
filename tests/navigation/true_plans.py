"""True plans of rooms that a benchmark explores."""

from __future__ import annotations

import numpy as np

from benchmarks.exploration_truth import CELL_M, TruePlan
from wheelsight.navigation import Footprint

CHAIR = Footprint.rectangle(0.8, 0.3, 0.6)
START = np.array([2.0, 2.0, 0.0])


def plan_of(width_m: float, height_m: float, *walls: tuple[float, float, float, float]) -> TruePlan:
    """A room with its corner at (0, 0), and things in it: x and y from, x and y to."""
    around = round(1.0 / CELL_M)
    rows, columns = round(height_m / CELL_M) + 2 * around, round(width_m / CELL_M) + 2 * around
    is_taken = np.ones((rows, columns), bool)
    is_taken[around:-around, around:-around] = False
    for west, south, east, north in walls:
        left, bottom, right, top = (around + round(at / CELL_M) for at in (west, south, east, north))
        is_taken[bottom:top, left:right] = True
    return TruePlan(is_taken, is_taken, (-1.0, -1.0), CHAIR, 0.0)
