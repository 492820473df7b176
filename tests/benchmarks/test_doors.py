"""Doors: their walls and widths by closed forms, the table, and a door that the chair passes."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.doors import Door, Passage, passed, sheets_of
from wheelsight.mapping import CellKind, OccupancyGrid


def test_the_walls_leave_the_door_open() -> None:
    door = Door(0.8, 0.7, (0.02, 0.03))
    for way_m, expected in ((0.0, 0.4), (0.3, 0.1), (-0.35, 0.05)):
        at = door.placed(np.array([[0.06, way_m]]))
        assert door.walls.clearance_m(at + 1e-6 * np.array([[0, 0], [1, 0], [0, 1]])) == pytest.approx(
            expected, abs=1e-4
        )


@pytest.mark.parametrize("yaw_rad", [0.0, np.pi / 2, -np.pi / 2])
def test_the_width_in_a_grid_is_that_between_squares(yaw_rad: float) -> None:
    kind = np.full((40, 40), CellKind.FREE, np.uint8)
    kind[20:22, :12] = kind[20:22, 27:] = CellKind.OBSTACLE  # 15 cells of 0.05 m
    if yaw_rad == 0:
        kind = np.ascontiguousarray(kind.T)
    grid = OccupancyGrid.of_kinds(kind, kind == CellKind.FREE, 0.05, (-1.0, -1.0))
    assert Door(0.8, yaw_rad).width_in(grid) == pytest.approx(0.75)


def test_the_table_counts_what_was_passed_in_time() -> None:
    passages = [
        Passage(9.0, 0.05, -0.01, ""),
        Passage(16.0, 0.04, -0.03, ""),
        Passage(None, 0.3, -0.2, "no way leads there"),
        Passage(None, 0.0, -0.02, "touched the wall"),
    ]
    doors, targets, missed = sheets_of({0.8: passages})
    assert doors.rows[0][:5] == ("0.80", "4", "25 %", "50 %", "1")
    assert [row[3].startswith("missed") for row in targets.rows] == [True, True]
    assert [row[0].split(": ")[1] for row in missed.rows] == [
        "passed after 16 s",
        "no way leads there",
        "touched the wall",
    ]


@pytest.mark.slow
def test_the_chair_passes_a_door_of_its_own_map() -> None:
    """It was given up: what the camera saw of the wall made the door narrower than the map's."""
    found = passed(0.8, 0)
    assert found.time_s is not None
    assert found.time_s < 30
    assert found.clearance_m > 0.01
