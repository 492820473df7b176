"""Doors in maps by rays, of several widths and approaches, and where a kernel moves the ends of rays."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.doors import Door, any_door
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.mapping import occupancy_kernels as kernels

BANDS = kernels.Bands(0.05, 0.05, 0.1, 0.015, 0.1, 1.05, 2.0, 5.0, 0.15, 0.5)
SPACING = 0.4


def into(ends: np.ndarray, u: int) -> np.ndarray:
    """Where the hit of a ray from (0, 0) moves, in cells."""
    found = np.zeros(2)
    kernels._find_into(np.ones(len(ends)), ends, u, SPACING, np.zeros(3), BANDS, found)  # noqa: SLF001
    return found


def wall(y: np.ndarray, slope: float = 0.0) -> np.ndarray:
    """(N, 3) ends on a wall before the camera, level, across its view, or turned about the middle."""
    return np.column_stack([20.0 + slope * y, y, np.full(len(y), 0.5)])


def test_a_hit_within_a_wall_moves_half_a_cell_along_the_normal() -> None:
    y = SPACING * np.arange(-10, 11)
    np.testing.assert_allclose(into(wall(y), 10), [0.5, 0.0], atol=1e-9)
    # Obliquely a cell reaches farther along the normal.
    normal = np.array([1.0, -0.5]) / np.hypot(1, 0.5)
    np.testing.assert_allclose(into(wall(y, 0.5), 10), 0.5 * np.abs(normal).sum() * normal, atol=1e-9)


def test_a_hit_at_an_edge_moves_until_it_is_half_a_cell_from_the_edge() -> None:
    """The edge is half-way to the next ray, which passes."""
    y = SPACING * np.arange(0, 11)
    np.testing.assert_allclose(into(wall(np.append(y[::-1] * -1, 30.0)), 10), [0.5, -0.5 + SPACING / 2], atol=1e-9)


def test_a_thing_narrower_than_a_cell_is_marked_in_its_middle() -> None:
    ends = wall(np.array([-30.0, 0.0, SPACING, 30.0]))
    np.testing.assert_allclose([into(ends, k)[1] + ends[k, 1] for k in (1, 2)], SPACING / 2, atol=1e-9)
    assert 0 < into(ends, 1)[0] <= 0.5


def test_a_lone_ray_stays() -> None:
    np.testing.assert_array_equal(into(wall(np.array([-30.0, 0.0, 30.0])), 1), [0.0, 0.0])


def true_grid(door: Door) -> OccupancyGrid:
    """Cells whose middles lie in the wall."""
    side = 240
    middles = (np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1) + 0.5) * 0.05 - 6.0 - door.place_m
    c, s = np.cos(door.yaw_rad), np.sin(door.yaw_rad)
    x, y = np.moveaxis(middles @ np.array([[c, -s], [s, c]]), -1, 0)
    is_wall = (x > 0) & (x < 0.12) & (np.abs(y) > door.width_m / 2)
    kind = np.where(is_wall, CellKind.OBSTACLE, CellKind.FREE).astype(np.uint8)
    return OccupancyGrid.of_kinds(kind, ~is_wall, 0.05, (-6.0, -6.0))


@pytest.mark.slow
def test_a_door_in_a_map_is_as_wide_as_cells_can_have_it() -> None:
    """In the mean to 0.03 m along the cells, and obliquely to what cells of the true wall leave; 0.1 m off before."""
    off_m, oblique_m = [], []
    for width_m in (0.75, 0.8, 0.9):
        rng = np.random.default_rng(round(1000 * width_m))
        for aside_rad in (-0.6, 0.0, 0.6):
            x, y = rng.uniform(0, 0.05, 2).tolist()
            along = Door(width_m, 0.0, (x, y))
            off_m.append(along.width_in(along.mapped(aside_rad, rng)[0]) - width_m)
            door = any_door(width_m, rng)
            oblique_m.append(door.width_in(door.mapped(aside_rad, rng)[0]) - door.width_in(true_grid(door)))
    assert abs(np.mean(off_m)) < 0.03
    assert abs(np.mean(oblique_m)) < 0.03
