from __future__ import annotations

import numpy as np
import pytest

from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.mapping.occupancy_picture import picture_of


def test_the_picture_has_the_colours_of_its_kinds_and_y_up() -> None:
    kinds = np.full((40, 60), CellKind.FREE, np.uint8)
    kinds[:10, :10], kinds[-10:, -10:] = CellKind.OBSTACLE, CellKind.DROP_OFF
    grid = OccupancyGrid.of_kinds(kinds, np.ones(kinds.shape, bool), 0.05, (1.0, 2.0))
    bare, image = picture_of(grid), picture_of(grid, [[1.2, 3.0], [3.8, 3.0]])
    assert bare.shape == image.shape
    scale = bare.shape[1] // 60
    assert tuple(bare[40 * scale - 2, 1]) == (40, 40, 40)
    assert tuple(bare[1, 60 * scale - 2]) == (213, 94, 0)
    assert tuple(bare[1, 1]) == (255, 255, 255)
    rows = np.flatnonzero((bare != image).any(axis=(1, 2)))
    assert rows.mean() == pytest.approx((40 - 20) * scale, abs=scale)
    one = OccupancyGrid.of_kinds(np.zeros((1, 1), np.uint8), np.zeros((1, 1), bool), 0.05, (0.0, 0.0))
    assert picture_of(one).shape[1] == 640
