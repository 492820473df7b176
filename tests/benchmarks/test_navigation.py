"""Goals by the truth, and things on the way to them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks import navigation
from benchmarks.box_worlds import Box
from benchmarks.navigation_courses import grid_with, thing_on
from benchmarks.navigation_drives import Drive, Hardness
from wheelsight.mapping import CellKind, OccupancyGrid

ARRIVED = Drive("flat", (1.0, 2.0, 0.0), True, "to the kitchen", 2, 0.05, 3.0, 6.0, 8.0, 0.2, (), 20.0)
LOST = replace(ARRIVED, says_arrived=False, detail="it does not know where it is", off_m=2.0)


@pytest.mark.parametrize(
    ("changed", "has_arrived"),
    [
        ({}, True),
        ({"says_arrived": None}, False),
        ({"off_m": 0.16}, False),
        ({"off_deg": 10.5}, False),
    ],
)
def test_it_has_arrived_by_the_truth_and_by_what_it_says(changed: dict[str, Any], has_arrived: bool) -> None:
    assert replace(ARRIVED, **changed).has_arrived is has_arrived


def test_spl_is_the_share_of_the_way_and_nothing_without_success() -> None:
    assert ARRIVED.spl == pytest.approx(0.75)
    assert replace(ARRIVED, way_m=5.0).spl == 1.0
    assert LOST.spl == 0.0


def test_targets_are_others_among_people_and_things() -> None:
    alone = navigation.targets_of([ARRIVED, LOST], Hardness())
    assert [target.measured for target in alone] == pytest.approx([50.0, 0, 0.375, 0.2])
    among = navigation.targets_of([ARRIVED, replace(ARRIVED, contacts=("box1",))], Hardness(people=4, things=5))
    assert [(target.limit, target.measured) for target in among] == [(95.0, 100.0), (0, 1)]
    assert navigation.title_of(Hardness(people=4, things=5)) == "Goals in a known map, among 4 people and 5 things"
    assert navigation.title_of(Hardness()) == "Goals in a known map"


def test_what_went_wrong_is_reported() -> None:
    *_, wrong = navigation.sheets_of([ARRIVED, LOST], Hardness())
    assert len(wrong.rows) == 1
    assert "does not know where" in wrong.rows[0][0]


def test_a_thing_is_marked_where_it_stands() -> None:
    free = np.full((40, 60), CellKind.FREE, np.uint8)
    grid = OccupancyGrid.of_kinds(free, np.zeros(free.shape, bool), 0.1, (-1.0, -2.0))
    turned = Box(2.0, 0.0, 0.8, 0.4, 1.0, yaw_rad=np.pi / 2)
    marked = grid_with(grid, [turned]).kind == CellKind.OBSTACLE
    x, y = grid.middle_of(np.argwhere(marked)).T
    assert (x.min(), x.max()) == pytest.approx((1.8, 2.2), abs=0.11)
    assert (y.min(), y.max()) == pytest.approx((-0.4, 0.4), abs=0.11)
    assert 0.4 * 0.8 <= marked.sum() * 0.1**2 <= 0.6 * 1.0
    assert not (grid.kind == CellKind.OBSTACLE).any()


def test_things_lie_on_the_way_and_off_the_stops() -> None:
    rng = np.random.default_rng(3)
    way = np.column_stack([np.linspace(0, 10, 101), np.zeros(101), np.zeros(101)])
    found = [thing_on([way], [way[0], way[-1]], rng) for _ in range(200)]
    things = [thing for thing in found if thing is not None]
    assert 100 < len(things) < 200
    assert max(abs(thing.y_m) for thing in things) <= 0.4
    assert min(thing.x_m for thing in things) > 1.2
    assert max(thing.x_m for thing in things) < 8.8
