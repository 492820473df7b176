"""Polygons on the floor: where in one of them there is most room."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial import KDTree

from wheelsight.core.geometry import BoolArray, FloatArray
from wheelsight.mapping import CellKind, OccupancyGrid, roomiest_place

CELL_M = 0.05
ORIGIN = (-1.0, -2.0)


def floor(
    width_m: float, height_m: float, *boxes: tuple[float, float, float, float], cell_m: float = CELL_M
) -> OccupancyGrid:
    """Free from (0, 0) on, but for boxes of low x and y, high x and y; unknown around that."""
    shape = round((height_m + 4) / cell_m), round((width_m + 2) / cell_m)
    kinds = np.zeros(shape, np.uint8)
    empty = OccupancyGrid.of_kinds(kinds, np.zeros(shape, bool), cell_m, ORIGIN)
    at = empty.middle_of(np.moveaxis(np.indices(shape), 0, -1))
    kinds[_within(at, (0, 0, width_m, height_m))] = CellKind.FREE
    for box in boxes:
        kinds[_within(at, box)] = CellKind.OBSTACLE
    return OccupancyGrid.of_kinds(kinds, np.zeros(shape, bool), cell_m, ORIGIN)


def _within(at: FloatArray, box: tuple[float, float, float, float]) -> BoolArray:
    return np.asarray(((at > box[:2]) & (at < box[2:])).all(axis=-1))


def rectangle(x: float, y: float, far_x: float, far_y: float) -> FloatArray:
    return np.array([[x, y], [far_x, y], [far_x, far_y], [x, far_y]])


def place_in(grid: OccupancyGrid, polygon: FloatArray) -> FloatArray:
    found = roomiest_place(grid, polygon)
    assert found is not None
    return found


def test_of_an_empty_square_it_is_the_middle() -> None:
    assert_allclose(place_in(floor(6, 6), rectangle(1, 2, 4, 5)), (2.5, 3.5), atol=CELL_M)


def test_walls_count_as_the_areas_own_edge_does() -> None:
    """The area reaches 2 m beyond the room, whose middle it is all the same."""
    assert_allclose(place_in(floor(4, 4), rectangle(-0.9, -1.9, 4.9, 5.9)), (2, 2), atol=CELL_M)


def test_a_corridor_has_it_in_its_middle_and_not_at_one_of_its_ends() -> None:
    assert_allclose(place_in(floor(10, 2), rectangle(0, 0, 10, 2)), (5, 1), atol=1.5 * CELL_M)


def test_beside_a_box_it_is_in_the_middle_of_what_is_left() -> None:
    """A box across one end of a rectangle leaves a square of 3 m."""
    assert_allclose(place_in(floor(5, 3, (0, 0, 2, 3)), rectangle(0, 0, 5, 3)), (3.5, 1.5), atol=CELL_M)


def test_a_box_in_a_corner_has_its_corner_as_far_away_as_the_walls() -> None:
    """Of a square of side a with a box of side b in its corner: r from the two other walls and from the box's corner.

    (a - r - b) √2 = r, so that r = (a - b) √2 / (1 + √2).
    """
    a, b = 4.0, 1.0
    r = (a - b) * np.sqrt(2) / (1 + np.sqrt(2))
    found = place_in(floor(a, a, (0, 0, b, b)), rectangle(0, 0, a, a))
    assert_allclose(found, (a - r, a - r), atol=1.5 * CELL_M)


def test_of_an_l_it_is_in_the_wide_leg() -> None:
    """Though the middle of its corners is in none."""
    corners = np.array([[0, 0], [6, 0], [6, 1], [2, 1], [2, 6], [0, 6.0]])
    found = place_in(floor(6, 6), corners)
    assert_allclose(found[0], 1.0, atol=0.25)
    assert 0.9 < found[1] < 5.1


@pytest.mark.parametrize("polygon", [rectangle(20, 20, 21, 21), rectangle(-0.9, 1, -0.1, 2), rectangle(2, 2, 3, 3)])
def test_without_free_floor_there_is_none(polygon: FloatArray) -> None:
    """Beyond the grid, where nothing is known, and in a box."""
    assert roomiest_place(floor(4, 4, (2, 2, 3, 3)), polygon) is None


@given(
    st.lists(st.tuples(*(st.floats(0, 5) for _ in range(2)), *(st.floats(0.2, 2) for _ in range(2))), max_size=4),
    st.lists(st.tuples(st.floats(-0.5, 5.5), st.floats(-0.5, 5.5)), min_size=3, max_size=6),
)
def test_it_is_free_and_no_other_free_place_has_more_room_by_a_cell(
    boxes: list[tuple[float, float, float, float]], corners: list[tuple[float, float]]
) -> None:
    hull = shapely.MultiPoint(corners).convex_hull
    if hull.geom_type != "Polygon" or hull.area < 0.1:
        return
    polygon = np.array(hull.exterior.coords)[:-1]
    grid = floor(5, 5, *((x, y, x + w, y + h) for x, y, w, h in boxes), cell_m=0.2)
    cells = grid.middle_of(np.argwhere(np.ones(grid.kind.shape, bool)))
    inside = shapely.contains_xy(hull, cells[:, 0], cells[:, 1]) & (grid.kind.ravel() == CellKind.FREE)
    found = roomiest_place(grid, polygon)
    if not inside.any():
        assert found is None
        return
    assert found is not None
    assert inside[np.linalg.norm(cells - found, axis=1).argmin()]
    assert np.linalg.norm(cells - found, axis=1).min() < 1e-9
    room_m = KDTree(cells[~inside]).query([found, *cells[inside]])[0]
    assert room_m[0] > room_m.max() - 0.2 - 1e-6
