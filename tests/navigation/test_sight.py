"""Sight: what a view shows, by closed form on an open plane, and behind a wall."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.navigation.costmap import CellState
from wheelsight.navigation.exploration import ViewSector, marks

CELL_M = 0.05
SIGHT = ViewSector(1.0, 3.0, 0.5)
PLANE = np.full((160, 160), CellState.UNKNOWN, np.uint8)
MIDDLE = np.array([80.0, 80.0])


def gains_of(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    marked = marks(state != CellState.OCCUPIED, state == CellState.UNKNOWN)
    gains, headings = SIGHT.gains_m2(marked, CELL_M, MIDDLE[None])
    return gains[0], headings


@pytest.mark.parametrize("half_rad", [0.1, 0.5, 0.52, 1.0])
def test_on_an_open_plane_a_view_shows_a_ring_s_part(half_rad: float) -> None:
    sight = ViewSector(1.0, 3.0, half_rad)
    gains, _ = sight.gains_m2(marks(PLANE != CellState.OCCUPIED, PLANE == CellState.UNKNOWN), CELL_M, MIDDLE[None])
    np.testing.assert_allclose(gains, half_rad * (3.0**2 - 1.0**2), rtol=0.03)


def test_the_cells_of_a_view_cover_what_it_gains() -> None:
    cells = SIGHT.seen(marks(PLANE != CellState.OCCUPIED, PLANE == CellState.UNKNOWN), CELL_M, MIDDLE, 0.7)
    assert len(cells) * CELL_M**2 == pytest.approx(SIGHT.half_rad * (3.0**2 - 1.0**2), rel=0.05)
    away = (cells + 0.5 - MIDDLE) * CELL_M
    far_m, bearing = np.hypot(*away.T), np.arctan2(away[:, 0], away[:, 1])
    assert far_m.min() > SIGHT.near_m - CELL_M
    assert far_m.max() < SIGHT.far_m + CELL_M
    assert np.abs(bearing - 0.7).max() < SIGHT.half_rad + CELL_M / SIGHT.near_m


def test_nothing_is_seen_past_a_wall() -> None:
    state = PLANE.copy()
    state[:, 110] = CellState.OCCUPIED  # 1.5 m to the east of the middle
    gains, headings = gains_of(state)
    ahead, behind = (gains[np.abs(np.cos(headings - to) - 1).argmin()] for to in (0.0, np.pi))
    # Of the sector what lies before the wall: at each bearing up to 1.5 m / cos.
    assert ahead == pytest.approx(1.5**2 * np.tan(0.5) - 0.5 * 1.0**2, rel=0.06)
    assert behind == pytest.approx(0.5 * (3.0**2 - 1.0**2), rel=0.03)
    cells = SIGHT.seen(marks(state != CellState.OCCUPIED, state == CellState.UNKNOWN), CELL_M, MIDDLE, 0.0)
    assert cells[:, 1].max() < 110


def test_what_is_not_wanted_hides_nothing_and_counts_for_nothing() -> None:
    state = PLANE.copy()
    state[:, :120] = CellState.FREE
    gains, headings = gains_of(state)
    assert gains[np.abs(np.cos(headings) + 1).argmin()] == 0.0
    ahead = gains[np.abs(np.cos(headings) - 1).argmin()]
    assert ahead == pytest.approx(0.5 * 3.0**2 - 2.0**2 * np.tan(0.5), rel=0.06)


def test_beyond_the_edge_there_is_nothing_to_see() -> None:
    marked = marks(PLANE != CellState.OCCUPIED, PLANE == CellState.UNKNOWN)
    gains, headings = SIGHT.gains_m2(marked, CELL_M, np.array([[80.0, 159.5]]))
    assert gains[0, np.abs(np.cos(headings) - 1).argmin()] == 0.0
