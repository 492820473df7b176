"""Where a wheelchair can drive on a floor, and the shortest ways there that keep away from walls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from wheelsight.geometry import ByteArray, Float32Array, FloatArray, IntArray
from wheelsight.simulation.worlds.floor_plan._doorways import Doorway
from wheelsight.simulation.worlds.floor_plan._free_space import FreeSpace, drawn

# A metre beside a wall costs as much as five in the open: drivers keep to the middle of corridors.
_WALL_COST, _COMFORTABLE_M = 4.0, 0.9
# A wheelchair's footplates are 0.8 m ahead of its axle, and in the doorway before that has turned. It turns before,
# and has as much again to come straight.
_LANE_M = 1.6
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))


@dataclass(frozen=True, eq=False)
class Ground:
    """Cells on which the middle of a robot's axle can be.

    Attributes:
        space: the floor.
        is_open: (R, C) uint8, 1 for such cells; all can be reached from each other.
        away_m: (R, C) metres to the nearest wall.
        cost: (R, C) of a metre there, at least 1.
    """

    space: FreeSpace
    is_open: ByteArray
    away_m: Float32Array
    cost: Float32Array

    @classmethod
    def of(cls, space: FreeSpace, half_width_m: float, start: tuple[float, float] | None = None) -> Ground:
        """The part that is `half_width_m` from every wall and joined to a place, else the largest; may be empty."""
        is_open = drawn(space.shape.buffer(-half_width_m), space.plan, space.grid.shape, is_generous=True)
        away_m = space.distance_m()
        cost = 1 + _WALL_COST * np.maximum(1 - away_m / _COMFORTABLE_M, 0)
        _, labels, facts, _ = cv2.connectedComponentsWithStats(is_open, connectivity=8)
        part = 1 + int(np.argmax(facts[1:, cv2.CC_STAT_AREA])) if len(facts) > 1 else -1
        if start is not None:
            row, column = space.cells_at(np.array(start)).tolist()
            part = int(labels[row, column]) or -1
        return cls(space, (labels == part).astype(np.uint8), away_m, cost.astype(np.float32))

    def lane_m(self, doorway: Doorway, side: int) -> float:
        """How far straight out of a doorway, on its left (1) or right (-1), one can drive, up to _LANE_M."""
        steps_m = np.arange(0.0, _LANE_M + 1e-9, self.space.cell_m / 2)
        cells = self.space.cells_at(doorway.middle + side * steps_m[:, None] * doorway.onward)
        closed = np.flatnonzero(self.is_open[cells[:, 0], cells[:, 1]] == 0)
        return float(steps_m[max(closed[0] - 1, 0)]) if len(closed) else _LANE_M

    def price(self, waypoints: FloatArray) -> float:
        """What a way through waypoints (N, 2) costs; infinite where it leaves open ground."""
        line = shapely.segmentize(shapely.LineString(waypoints), self.space.cell_m / 2)
        points = shapely.get_coordinates(line)
        cells = self.space.cells_at((points[1:] + points[:-1]) / 2)
        if not self.is_open[cells[:, 0], cells[:, 1]].all():
            return np.inf
        return float(self.cost[cells[:, 0], cells[:, 1]] @ np.hypot(*np.diff(points, axis=0).T))

    def ways(self, limit: float) -> Ways:
        """What finds shortest ways of up to that cost."""
        rows, columns = np.nonzero(self.is_open)
        height, width = self.is_open.shape
        index = np.full(self.is_open.shape, -1, np.int64)
        index[rows, columns] = np.arange(len(rows))
        ends, weights = [], []
        for down, right in _STEPS:
            r, c = rows + down, columns + right
            fits = (r < height) & (c >= 0) & (c < width)
            a, r, c = np.flatnonzero(fits), r[fits], c[fits]
            b = index[r, c]
            a, b = a[b >= 0], b[b >= 0]
            length_m = self.space.cell_m * np.hypot(down, right)
            ends.append(np.stack([a, b]))
            price = self.cost[rows, columns]
            weights.append(length_m * (price[a] + price[b]) / 2)
        a, b = np.concatenate(ends, axis=1)
        graph = coo_array((np.concatenate(weights), (a, b)), shape=(len(rows), len(rows))).tocsr()
        return Ways(self, index, np.stack([rows, columns], axis=-1), graph, limit)


@dataclass(frozen=True, eq=False)
class Ways:
    """The graph of open cells.

    Attributes:
        ground: whose cells.
        index: (R, C) number of each open cell, -1 for others.
        cells: (N, 2) row and column of each number.
        graph: what a step between two costs.
        limit: no way costs more.
    """

    ground: Ground
    index: IntArray
    cells: IntArray
    graph: Any
    limit: float

    def from_cell(self, cell: tuple[int, int]) -> tuple[FloatArray, IntArray]:
        """Costs (N,) of the ways from a cell to all others, infinite beyond the limit, and the cells before (N,)."""
        number = int(self.index[cell])
        costs, before = dijkstra(self.graph, False, number, return_predecessors=True, limit=self.limit)
        return np.asarray(costs), np.asarray(before)

    def way(self, before: IntArray, end: tuple[int, int]) -> IntArray:
        """Cells (M, 2) from where `before` began to `end`."""
        numbers = [int(self.index[end])]
        while before[numbers[-1]] >= 0:
            numbers.append(int(before[numbers[-1]]))
        return np.asarray(self.cells[numbers[::-1]])

    def farthest(self, costs: FloatArray) -> tuple[int, int]:
        """The cell of which costs (N,) are greatest, but finite."""
        row, column = self.cells[int(np.argmax(np.where(np.isfinite(costs), costs, -1)))].tolist()
        return row, column
