"""Floors to plan on, and the wheelchair."""

from __future__ import annotations

import numpy as np

from wheelsight.navigation import CellState, Costmap, CostmapSettings, Footprint, StaticLayer

CHAIR = Footprint.rectangle(front_m=0.8, back_m=0.3, width_m=0.6)


def static_of(
    is_occupied: np.ndarray, resolution_m: float = 0.05, origin: tuple[float, float] = (0.0, 0.0)
) -> StaticLayer:
    state = np.where(is_occupied, CellState.OCCUPIED, CellState.FREE).astype(np.uint8)
    return StaticLayer(state, np.full(state.shape, np.inf, np.float32), resolution_m, origin)


def costmap_of(is_occupied: np.ndarray, resolution_m: float = 0.05, settings: CostmapSettings | None = None) -> Costmap:
    return Costmap.of(static_of(is_occupied, resolution_m), CHAIR, settings)


def room(height_m: float, width_m: float, resolution_m: float = 0.05) -> np.ndarray:
    """Walls one cell thick all round."""
    cells = np.zeros((round(height_m / resolution_m), round(width_m / resolution_m)), bool)
    cells[[0, -1]] = cells[:, [0, -1]] = True
    return cells


def room_with_door(door_m: float, resolution_m: float = 0.02, wall_m: float = 0.1) -> np.ndarray:
    """6 × 6 m, with a wall across the middle and a door in it whose middle is at x = 3 m."""
    cells = room(6.0, 6.0, resolution_m)
    rows = slice(round(3.0 / resolution_m), round((3.0 + wall_m) / resolution_m))
    count = round(door_m / resolution_m)
    first = round(3.0 / resolution_m) - count // 2
    cells[rows] = True
    cells[rows, first : first + count] = False
    return cells
