"""Areas of a building: named polygons on the floor and the coordinates each one tells (Trinh et al., Fig. 7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import AreaError
from wheelsight.geometry import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Area:
    """A part of the floor that looks alike enough to be told from the others.

    Attributes:
        name: what labels and forests call it.
        polygon: (N, 2) corners in the world frame, metres, in either direction, not closed.
        x_m: the coordinate x of whoever is in it, or None where it does not tell: a corridor along x.
        y_m: the same for y.
    """

    name: str
    polygon: FloatArray
    x_m: float | None = None
    y_m: float | None = None


@dataclass(frozen=True, eq=False)
class AreaMap:
    """Areas that do not overlap; together they may leave floor uncovered."""

    areas: tuple[Area, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Of the areas, in their order."""
        return tuple(area.name for area in self.areas)

    def index_at(self, xy: ArrayLike) -> IntArray:
        """Which area holds each point (..., 2) in metres: its index (...), -1 where none does."""
        import shapely

        xy = np.asarray(xy, float)
        found = np.full(xy.shape[:-1], -1, np.int64)
        for index, area in enumerate(self.areas):
            found[shapely.intersects_xy(shapely.Polygon(area.polygon), xy[..., 0], xy[..., 1]) & (found < 0)] = index
        return found

    def name_at(self, x_m: float, y_m: float) -> str | None:
        """The area that holds a point, or None."""
        index = int(self.index_at(np.array([x_m, y_m])))
        return None if index < 0 else self.areas[index].name


__all__ = ["Area", "AreaError", "AreaMap"]
