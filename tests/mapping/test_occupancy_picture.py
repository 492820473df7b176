from __future__ import annotations

import numpy as np
import pytest

from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.mapping.occupancy import PlanLine, picture_of


def test_the_picture_has_the_colours_of_its_kinds_and_y_up() -> None:
    kinds = np.full((40, 60), CellKind.FREE, np.uint8)
    kinds[:10, :10], kinds[-10:, -10:] = CellKind.OBSTACLE, CellKind.DROP_OFF
    grid = OccupancyGrid.of_kinds(kinds, np.ones(kinds.shape, bool), 0.05, (1.0, 2.0))
    bare, image = picture_of(grid), picture_of(grid, [[[1.2, 3.0], [3.8, 3.0]]])
    assert bare.shape == image.shape
    scale = bare.shape[1] // 60
    assert tuple(bare[40 * scale - 2, 1]) == (40, 40, 40)
    assert tuple(bare[1, 60 * scale - 2]) == (213, 94, 0)
    assert tuple(bare[1, 1]) == (255, 255, 255)
    rows = np.flatnonzero((bare != image).any(axis=(1, 2)))
    assert rows.mean() == pytest.approx((40 - 20) * scale, abs=scale)
    one = OccupancyGrid.of_kinds(np.zeros((1, 1), np.uint8), np.zeros((1, 1), bool), 0.05, (0.0, 0.0))
    assert picture_of(one).shape[1] == 640


def test_nothing_is_drawn_between_two_stretches_of_the_way() -> None:
    kinds = np.full((40, 60), CellKind.FREE, np.uint8)
    grid = OccupancyGrid.of_kinds(kinds, np.ones(kinds.shape, bool), 0.05, (0.0, 0.0))
    first, second = [[0.5, 1.0], [1.0, 1.0]], [[2.0, 1.0], [2.5, 1.0]]
    image = picture_of(grid, [first, [], second, [[1.5, 1.5]]])
    px = picture_of(grid).shape[1] // 60
    row = (image[20 * px] != 255).any(axis=-1)
    assert row[int(0.5 / 0.05) * px : int(1.0 / 0.05) * px].all()
    assert not row[int(1.2 / 0.05) * px : int(1.8 / 0.05) * px].any()
    assert row[int(2.0 / 0.05) * px : int(2.5 / 0.05) * px].all()
    assert (image[10 * px, 30 * px] != 255).any()  # a keyframe alone is a dot


def test_axes_are_at_whole_metres_and_lines_have_their_words() -> None:
    kinds = np.full((40, 60), CellKind.FREE, np.uint8)
    grid = OccupancyGrid.of_kinds(kinds, np.ones(kinds.shape, bool), 0.05, (-1.0, -0.5))
    bare, image = picture_of(grid), picture_of(grid, has_axes=True)
    a_metre = 20 * (bare.shape[1] // 60)
    height = 2 * a_metre
    assert bare.shape == image.shape
    assert image[height - 3, a_metre, 0] < 60  # the stroke of x = 0 at the lower edge
    assert image[height - a_metre // 2, 3, 0] < 60  # that of y = 0 at the left one
    assert image[height - a_metre // 2 - a_metre, 2 * a_metre, 0] < 255  # the cross at (1, 1)
    assert (image[height - 3 * a_metre // 4, 5 * a_metre // 4] == 255).all()  # between them is nothing
    square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)]
    words, none = (picture_of(grid, lines=[PlanLine(square, (0, 0, 0), text=text)]) for text in ("a room", ""))
    changed = np.argwhere((words != none).any(axis=-1)).mean(axis=0)
    np.testing.assert_allclose(changed, [height - a_metre, 1.5 * a_metre], atol=0.1 * a_metre)
