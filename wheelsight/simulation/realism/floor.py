"""What a floor has that wheels feel: thresholds between areas, and the edges and the pile of carpets."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wheelsight.geometry import BoolArray, ByteArray, Float32Array, FloatArray
from wheelsight.simulation.world import World

_BOX = 6
_THICKEST_CARPET_M = 0.02
_CELL_M, _MOST_CELLS, _MARGIN_M = 0.02, 4e6, 1.0


@dataclass(frozen=True, slots=True)
class FloorSettings:
    """How high things lie on the floor.

    Attributes:
        threshold_m: (least, most) height of what lies where two areas meet, one for a world; DIN 18040 allows
            wheelchairs 20 mm at most, and asks for none.
        threshold_width_m: half its width.
        carpet_m: height of a carpet. Chosen.
        carpet_edge_m: over which it rises.
        carpet_creep: share of a hard floor's stiffness against creep that tyres have on carpet. Chosen.
        carpet_drag: more rolling resistance there, as a share of the load; carpets double a wheelchair's resistance of
            about 0.015 (van der Woude et al., "Rolling resistance of wheelchairs", 2003).
    """

    threshold_m: tuple[float, float] = (0.002, 0.010)
    threshold_width_m: float = 0.03
    carpet_m: float = 0.006
    carpet_edge_m: float = 0.01
    carpet_creep: float = 0.5
    carpet_drag: float = 0.015


class Floor:
    """Of one world, as a grid of heights.

    Args:
        world: whose areas' borders have thresholds, and on whose floor carpets lie.
        settings: how high these are.
        rng: of the world.
    """

    def __init__(self, world: World, settings: FloorSettings, rng: np.random.Generator) -> None:
        low, high = np.array(world.size_m[:2], float) - _MARGIN_M, np.array(world.size_m[2:], float) + _MARGIN_M
        self.settings = settings
        self.cell_m = max(_CELL_M, float(np.sqrt(np.prod(high - low) / _MOST_CELLS)))
        self._low = low
        columns, rows = (np.ceil((high - low) / self.cell_m).astype(int) + 1).tolist()
        lines = [self._cells(area.polygon) for area in world.areas.areas]
        borders, carpets = np.zeros((2, rows, columns), np.uint8)
        cv2.polylines(borders, lines, True, 1)
        for outline in _carpets(world):
            cv2.fillPoly(carpets, [self._cells(outline)], 1)
        self._is_carpet = carpets.astype(bool)
        self.height = _ridge(borders, settings.threshold_width_m, self.cell_m) * np.float32(
            rng.uniform(*settings.threshold_m)
        ) + _ridge(carpets, settings.carpet_edge_m, self.cell_m) * np.float32(settings.carpet_m)

    def height_m(self, xy_m: ArrayLike) -> FloatArray:
        """(...) how high the floor is at places (..., 2)."""
        at = (np.asarray(xy_m, float) - self._low) / self.cell_m
        at = at.clip(0, np.array(self.height.shape[::-1]) - 1.001)
        first = at.astype(np.int64)
        across, along = np.moveaxis(at - first, -1, 0)
        column, row = np.moveaxis(first, -1, 0)
        h = self.height
        near = (1 - across) * h[row, column] + across * h[row, column + 1]
        far = (1 - across) * h[row + 1, column] + across * h[row + 1, column + 1]
        return np.asarray((1 - along) * near + along * far)

    def is_carpet(self, xy_m: ArrayLike) -> BoolArray:
        """(...) whether carpet lies at places (..., 2)."""
        at = np.rint((np.asarray(xy_m, float) - self._low) / self.cell_m).astype(np.int64)
        column, row = np.moveaxis(at.clip(0, np.array(self._is_carpet.shape[::-1]) - 1), -1, 0)
        return np.asarray(self._is_carpet[row, column])

    def _cells(self, outline: FloatArray) -> NDArray[np.int32]:
        return np.rint((np.asarray(outline, float) - self._low) / self.cell_m).astype(np.int32)


def _ridge(marked: ByteArray, width_m: float, cell_m: float) -> Float32Array:
    """(R, C) one at what is marked, and falling beside it by a Gaussian of that half width; no steeper than cells."""
    if not marked.any():
        return np.zeros(marked.shape, np.float32)
    away_m = cv2.distanceTransform(1 - marked, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * np.float32(cell_m)
    return np.asarray(np.exp(-0.5 * (away_m / max(width_m, cell_m)) ** 2), np.float32)


def _carpets(world: World) -> list[FloatArray]:
    """Outlines (4, 2) of the thin boxes on the floor that look like carpet."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(world.mjcf)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found = []
    for g in range(model.ngeom):
        surface = world.surfaces.get(model.mat(model.geom_matid[g]).name) if model.geom_matid[g] >= 0 else None
        top_m = data.geom_xpos[g, 2] + model.geom_size[g, 2]
        is_flat = model.geom_type[g] == _BOX and 0 < top_m < _THICKEST_CARPET_M
        if surface is None or surface.kind != "carpet" or not is_flat:
            continue
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * model.geom_size[g, :2]
        R = data.geom_xmat[g].reshape(3, 3)[:2, :2]
        found.append(np.asarray(data.geom_xpos[g, :2] + corners @ R.T))
    return found
