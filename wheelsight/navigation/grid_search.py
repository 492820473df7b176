"""Cost-to-go: what the cheapest way from each cell to a goal costs."""

from __future__ import annotations

import numpy as np

from wheelsight.errors import ArgumentError
from wheelsight.geometry import Float32Array, FloatArray
from wheelsight.navigation import _cost_to_go_kernels as kernels


def cost_to_go(metre_cost: Float32Array, resolution_m: float, goal: tuple[int, int]) -> FloatArray:
    """(H, W) of the cheapest ways along 8 neighbours to a cell; infinite where none leads there.

    A step costs its length times the mean of what a metre costs in both cells; none cuts the corner of a blocked cell.

    Args:
        metre_cost: (H, W) at least 1; infinite where blocked.
        resolution_m: side of a cell.
        goal: row and column.

    Raises:
        ArgumentError: a goal outside, or costs below 1 or NaN.
    """
    if metre_cost.ndim != 2 or not all(0 <= at < size for at, size in zip(goal, metre_cost.shape, strict=True)):
        raise ArgumentError(f"cell {goal} of {metre_cost.shape}", fix="give row and column of a cell")
    # Below 1 cells would be settled too early.
    if not (metre_cost >= 1).all() or not 0 < resolution_m < np.inf:
        raise ArgumentError("a metre that costs less than 1, or nothing that is a number", fix="infinite where blocked")
    costs = np.ascontiguousarray(metre_cost, np.float32)
    return np.asarray(kernels.cost_to_go(costs, float(resolution_m), np.array([goal]), np.zeros(1)))
