"""What a robot could explore by a plan, in rooms whose answer is known; and what the page says of what it did."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from navigation.true_plans import START, plan_of

from benchmarks import exploration
from benchmarks.exploration_drives import Explored
from benchmarks.exploration_ideal import SIGHT as CHAIRS
from benchmarks.exploration_ideal import explored
from benchmarks.exploration_truth import CELL_M, TruePlan, tour_m
from wheelsight.navigation import NavigationSettings
from wheelsight.navigation.exploration import ViewSector

SIGHT = ViewSector(1.0, 5.0, 0.5)
DONE = Explored("flat", 1, "", 50.0, 49.0, 0.1, 0.02, 0.03, 30.0, 20.0, (), 0.15, 400.0, 300, 200)


def covered_m2(plan: TruePlan) -> float:
    return float(plan.covered(plan.reached(START)).sum() * CELL_M**2)


def test_all_of_an_empty_room_is_covered_but_corners_that_no_outline_fills() -> None:
    found = covered_m2(plan_of(4.0, 4.0))
    assert 16.0 - 4 * 0.05 < found <= 16.0


@pytest.mark.parametrize(("gap_m", "is_passed"), [(0.5, False), (0.8, True)])
def test_it_comes_through_what_it_fits_through(gap_m: float, is_passed: bool) -> None:
    plan = plan_of(8.0, 4.0, (4.0, 0.0, 4.1, 2.0 - gap_m / 2), (4.0, 2.0 + gap_m / 2, 4.1, 4.0))
    reached = np.asarray(plan.reached(START).any(axis=0))
    row, column = plan.cells_at(np.array([6.0, 2.0])).tolist()
    assert bool(reached[row, column]) is is_passed
    assert (covered_m2(plan) > 30.0) is is_passed
    # For any robot but a wheelchair all of it is open floor.
    assert plan.open_floor(START)[row, column]


def test_it_does_not_drive_sideways() -> None:
    """A bay beside a corridor, both wide enough for the chair, and too narrow to turn from one into the other."""
    plan = plan_of(5.0, 4.0, (0.0, 0.0, 5.0, 1.65), (0.0, 2.35, 1.85, 4.0), (2.55, 2.35, 5.0, 4.0))
    reached = plan.reached(START)
    row, column = plan.cells_at(np.array([2.2, 3.5])).tolist()
    assert not reached[:, row, column].any()
    wide = plan_of(5.0, 4.0, (0.0, 0.0, 5.0, 1.3), (0.0, 2.7, 1.2, 4.0), (3.8, 2.7, 5.0, 4.0))
    assert wide.reached(START)[:, row, column].any()


def test_with_a_margin_it_comes_less_far() -> None:
    plan = plan_of(4.0, 4.0)
    assert covered_m2(replace(plan, margin_m=0.2)) < 3.8**2 < covered_m2(plan)


def test_who_sees_all_from_the_start_has_no_tour() -> None:
    plan = plan_of(4.0, 4.0)
    reached = plan.reached(START)
    assert tour_m(plan, reached, START, ViewSector(0.0, 5.0, 0.5), 0.97) == 0.0
    # And who does not see the floor before him steps aside, by less than twice of what he does not see.
    assert 0.3 < tour_m(plan, reached, START, SIGHT, 0.97) < 2.5


def test_a_tour_leads_into_each_room_and_not_back() -> None:
    door = 1.2
    plan = plan_of(12.0, 4.0, (4.0, 0.0, 4.1, 2.0 - door / 2), (4.0, 2.0 + door / 2, 4.1, 4.0))
    plan = replace(plan, is_taken=plan.is_taken | plan_of(12.0, 4.0, (8.0, 0.0, 8.1, 2.6)).is_taken)
    plan = replace(plan, is_tall=plan.is_taken)
    found = tour_m(plan, plan.reached(START), START, SIGHT, 0.97)
    assert 4.0 < found < 12.0


@pytest.mark.parametrize(
    ("changed", "is_good"),
    [
        ({}, True),
        ({"free_m2": 48.0}, False),
        ({"way_m": 41.0}, False),
        ({"contacts": ("sofa",)}, False),
        ({"ended": "took too long"}, False),
    ],
)
def test_what_was_to_be_reached(changed: dict[str, Any], is_good: bool) -> None:
    one = replace(DONE, **changed)
    assert exploration.is_good(one) is is_good
    sheets = exploration.sheets_of([DONE, one])
    assert len(sheets) == (2 if is_good else 3)


def test_targets_are_by_the_worst() -> None:
    worst = replace(DONE, free_m2=40.0, way_m=50.0, contacts=("sofa",))
    reported = exploration.targets_of([DONE, worst])
    assert [target.measured for target in reported] == pytest.approx([80.0, 2.5, 1])
    assert not any(target.is_met for target in reported)
    assert all(target.is_met for target in exploration.targets_of([DONE]))
    assert "80.0 % of 50.0 m²" in worst.sentence
    assert "touched sofa" in worst.sentence


@pytest.mark.slow
def test_without_errors_two_rooms_are_seen_on_a_way_of_few_tours() -> None:
    """By far more than is to be seen, hence of more than the two tours that are to be reached."""
    plan = plan_of(10.0, 5.0, (5.0, 0.0, 5.1, 1.9), (5.0, 3.1, 5.1, 5.0), (1.0, 4.2, 3.0, 5.0))
    found = explored(plan, START, NavigationSettings())
    assert found.share_percent >= 97.0
    assert found.way_m <= 2.5 * tour_m(plan, plan.reached(START), START, CHAIRS, 0.97)


def test_a_room_from_which_no_way_leads_is_not_looked_for() -> None:
    shut = plan_of(10.0, 5.0, (5.0, 0.0, 5.1, 5.0))
    found = explored(shut, START, NavigationSettings())
    assert found.share_percent >= 97.0
    assert found.views < 15
