"""OccupancyGrid: what is free, what is occupied, and where the floor is missing; as a value."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wheelsight.geometry import BoolArray, ByteArray, FloatArray, IntArray
from wheelsight.ros_map import FREE, OCCUPIED, UNKNOWN, RosMap


class CellKind(IntEnum):
    """What a cell of the floor is."""

    UNKNOWN = 0
    FREE = 1
    OVERHANG = 2
    """Something hangs above the robot; what is below it, `OccupancyGrid.occupancy` says."""
    OBSTACLE = 3
    DROP_OFF = 4
    KEEP_OUT = 5
    """Somebody said so; see `MapEdits`."""


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid:
    """The floor in square cells, along the axes of the frame `map`.

    Attributes:
        kind: (H, W) uint8 of `CellKind`; row 0 is the least y.
        occupancy: (H, W) int8 as nav_msgs/OccupancyGrid has it: 0 free, 100 occupied, -1 unknown.
        resolution_m: side of a cell.
        origin: x and y in metres of the corner of cell (0, 0).
    """

    kind: ByteArray
    occupancy: NDArray[np.int8]
    resolution_m: float
    origin: tuple[float, float]

    @classmethod
    def of_kinds(
        cls, kind: ByteArray, is_free: BoolArray, resolution_m: float, origin: tuple[float, float]
    ) -> OccupancyGrid:
        """Of kinds (H, W), and where an overhang leaves the floor below it free (H, W)."""
        return cls(kind, _occupancy(kind, is_free), resolution_m, origin)

    def to_ros(self) -> RosMap:
        """The same for `write_ros_map`, which tells free, occupied and unknown apart and no more."""
        return RosMap(self.occupancy, self.resolution_m, (*self.origin, 0.0))

    def cells_at(self, xy_map: ArrayLike) -> IntArray:
        """(..., 2) row and column of points (..., 2) in `map`; they may lie outside."""
        cells = (np.asarray(xy_map, float) - self.origin) / self.resolution_m
        return np.floor(cells[..., ::-1]).astype(np.int64)

    def middle_of(self, cells: ArrayLike) -> FloatArray:
        """(..., 2) in `map` of the middles of cells (..., 2) of row and column."""
        return np.asarray((np.asarray(cells, float)[..., ::-1] + 0.5) * self.resolution_m + self.origin)

    def kind_at(self, xy_map: ArrayLike) -> ByteArray:
        """(...) of `CellKind` at points (..., 2) in `map`; unknown outside."""
        cells = self.cells_at(xy_map)
        inside = np.asarray(((cells >= 0) & (cells < self.kind.shape)).all(axis=-1))
        row, column = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
        return np.asarray(np.where(inside, self.kind[row, column], CellKind.UNKNOWN), np.uint8)

    def changed(self, where: BoolArray, kind: CellKind) -> OccupancyGrid:
        """The same with other kinds of some cells (H, W)."""
        kinds = np.where(where, np.uint8(kind), self.kind).astype(np.uint8)
        told = _occupancy(kinds, np.zeros_like(where))
        return replace(self, kind=kinds, occupancy=np.where(where, told, self.occupancy).astype(np.int8))

    def free_m2(self) -> float:
        """How much floor is free."""
        return float(np.count_nonzero(self.occupancy == FREE) * self.resolution_m**2)


def _occupancy(kind: ByteArray, is_free: BoolArray) -> NDArray[np.int8]:
    told = np.where(kind >= CellKind.OBSTACLE, OCCUPIED, np.where(kind == CellKind.FREE, FREE, UNKNOWN))
    return np.where((kind == CellKind.OVERHANG) & is_free, FREE, told).astype(np.int8)
