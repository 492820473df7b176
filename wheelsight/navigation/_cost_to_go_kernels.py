"""Compiled: what it costs to get from each cell to the goal, and the way down.

Cells wait in buckets that are no wider than the cheapest step, so that whatever is in the lowest bucket is final
(Denardo & Fox 1979): Dijkstra's answer without a heap.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel

_DIAGONAL = np.sqrt(2.0)
# Of the cheapest step; rounding must not put a cell into the bucket that it was reached from.
_WIDTH = 0.999


@kernel(error_model="numpy")
def cost_to_go(metre_cost: Any, resolution_m: float, goals: Any, goal_costs: Any) -> Any:
    """(H, W) float64 of the cheapest ways along 8 neighbours to any of goals (N, 2) of row and column; infinite: none.

    A step costs its length times the mean of what a metre costs in both cells. No way cuts the corner of a blocked
    cell.

    Args:
        metre_cost: (H, W) float32, at least 1; infinite where blocked.
        resolution_m: side of a cell.
        goals: (N, 2).
        goal_costs: (N,) what is left to pay there.
    """
    rows, columns = metre_cost.shape
    wide = columns + 2
    costs = np.full((rows + 2) * wide, np.inf, np.float32)
    highest = np.float32(1.0)
    for i in range(rows):
        for j in range(columns):
            costs[(i + 1) * wide + j + 1] = metre_cost[i, j]
            if metre_cost[i, j] < np.inf:
                highest = max(highest, metre_cost[i, j])
    known = np.full(len(costs), np.inf)
    width = _WIDTH * resolution_m
    last = 0.0
    for k in range(len(goals)):
        last = max(last, goal_costs[k])
    buckets = int(max(_DIAGONAL * highest * resolution_m, last) / width) + 3
    heads = np.full(buckets, -1, np.int32)
    links = np.full((len(costs), 2), -1, np.int32)
    waiting = 0
    for k in range(len(goals)):
        cell = (goals[k, 0] + 1) * wide + goals[k, 1] + 1
        if costs[cell] < np.inf and goal_costs[k] < known[cell]:
            waiting += _put(cell, goal_costs[k], known, heads, links, width)
    _spread(costs, known, heads, links, wide, resolution_m, waiting)
    return known.reshape(rows + 2, wide)[1:-1, 1:-1].copy()


@kernel(error_model="numpy")
def _put(cell: int, cost: float, known: Any, heads: Any, links: Any, width: float) -> Any:
    """Move a cell to the bucket of its new cost, which is lower; 1 where it was in none, else 0."""
    is_new = 1
    if known[cell] < np.inf:
        is_new = 0
        _take(cell, int(known[cell] / width) % len(heads), heads, links)
    known[cell] = cost
    bucket = int(cost / width) % len(heads)
    links[cell, 0], links[cell, 1] = -1, heads[bucket]
    if heads[bucket] >= 0:
        links[heads[bucket], 0] = cell
    heads[bucket] = cell
    return is_new


@kernel(error_model="numpy")
def _take(cell: int, bucket: int, heads: Any, links: Any) -> None:
    before, after = links[cell, 0], links[cell, 1]
    if before >= 0:
        links[before, 1] = after
    else:
        heads[bucket] = after
    if after >= 0:
        links[after, 0] = before


@kernel(error_model="numpy")
def _spread(costs: Any, known: Any, heads: Any, links: Any, wide: int, resolution_m: float, waiting: int) -> None:
    """Settle all cells that wait, and those reached from them."""
    width = _WIDTH * resolution_m
    straight = np.array([1, -1, wide, -wide])
    sides = np.array([[1, wide], [1, -wide], [-1, wide], [-1, -wide]])
    half, diagonal = 0.5 * resolution_m, 0.5 * _DIAGONAL * resolution_m
    bucket = 0
    while waiting > 0:
        cell = heads[bucket]
        if cell < 0:
            bucket = (bucket + 1) % len(heads)
            continue
        _take(cell, bucket, heads, links)
        waiting -= 1
        here, paid = costs[cell], known[cell]
        for k in range(4):
            other = cell + straight[k]
            cost = paid + half * (here + costs[other])
            if cost < known[other]:
                waiting += _put(other, cost, known, heads, links, width)
            if costs[cell + sides[k, 0]] == np.inf or costs[cell + sides[k, 1]] == np.inf:
                continue
            other = cell + sides[k, 0] + sides[k, 1]
            cost = paid + diagonal * (here + costs[other])
            if cost < known[other]:
                waiting += _put(other, cost, known, heads, links, width)


@kernel(error_model="numpy")
def descend(known: Any, metre_cost: Any, resolution_m: float, row: int, column: int) -> Any:
    """(N, 2) rows and columns of the cheapest way from a cell to the goal, each a neighbour of the last."""
    rows, columns = known.shape
    way = np.empty((rows * columns, 2), np.int64)
    count = 0
    while True:
        way[count, 0], way[count, 1] = row, column
        count += 1
        best, next_row, next_column = np.inf, -1, -1
        for i in range(max(row - 1, 0), min(row + 2, rows)):
            for j in range(max(column - 1, 0), min(column + 2, columns)):
                if (
                    metre_cost[i, column] == np.inf
                    or metre_cost[row, j] == np.inf
                    or not known[i, j] < known[row, column]
                ):
                    continue
                step = _DIAGONAL if i != row and j != column else 1.0
                cost = known[i, j] + 0.5 * step * resolution_m * (metre_cost[i, j] + metre_cost[row, column])
                if cost < best:
                    best, next_row, next_column = cost, i, j
        if next_row < 0:
            return way[:count].copy()
        row, column = next_row, next_column
