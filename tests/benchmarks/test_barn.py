"""The automaton by its rule, worlds that can be crossed, and the challenge's score."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely

from benchmarks import barn
from benchmarks.barn_worlds import CELL_M, SIDE_CELLS, WAY_CELLS, WAY_M, automaton, field_of, grid_of, opened, smoothed
from wheelsight.mapping import CellKind
from wheelsight.navigation import CostmapSettings, NavigationSettings
from wheelsight_sim.clearance import obstacles

COSTLY = NavigationSettings(costmap=CostmapSettings(unknown="costly"))
CROSSED = barn.Crossing(0, 0.2, 3, 1, 20.0, 30.0, 21.0, 0.9, (), 0.1, "at the goal")


def plainly_smoothed(filled: np.ndarray) -> np.ndarray:
    rows, columns = filled.shape
    after = filled.copy()
    for r in range(rows):
        for c in range(columns):
            count = 0
            for i in range(r - 1, r + 2):
                for j in range(c - 1, c + 2):
                    if not 0 <= i < rows:
                        count += 1
                    elif 0 <= j < columns and (i, j) != (r, c):
                        count += bool(filled[i, j])
            after[r, c] = count > 4 or (filled[r, c] and count >= 2)
    return after


def test_smoothing_is_the_rule_cell_by_cell() -> None:
    filled = np.random.default_rng(4).random((12, 9)) < 0.4
    assert (smoothed(filled) == plainly_smoothed(filled)).all()


def test_a_lone_cell_goes_and_a_hole_in_a_block_is_filled() -> None:
    lone = np.zeros((9, 9), bool)
    lone[4, 4] = True
    assert not smoothed(lone)[3:6, 3:6].any()
    block = np.zeros((9, 9), bool)
    block[3:6, 3:6] = True
    block[4, 4] = False
    assert smoothed(block)[4, 4]


def test_sides_are_closed_and_more_fill_leaves_more() -> None:
    shares = [np.mean([automaton(np.random.default_rng(s), fill, 3).mean() for s in range(20)]) for fill in (0.15, 0.3)]
    assert shares[0] < shares[1]
    assert automaton(np.random.default_rng(1), 0.2, 4)[[0, -1]].all()


def comes_through(filled: np.ndarray) -> bool:
    """A flood of whole squares, cell by cell, from the first column to the last; beyond both all is open."""
    reach, (rows, columns) = WAY_CELLS // 2, filled.shape

    def fits(r: int, c: int) -> bool:
        block = filled[r - reach : r + reach + 1, max(c - reach, 0) : c + reach + 1]
        return reach <= r < rows - reach and not block.any()

    seen = {(r, 0) for r in range(rows) if fits(r, 0)}
    left = list(seen)
    while left:
        r, c = left.pop()
        for at in ((r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)):
            if 0 <= at[1] < columns and at not in seen and fits(*at):
                seen.add(at)
                left.append(at)
    return any(c == columns - 1 for _, c in seen)


def test_a_way_for_the_challenges_square_is_there_or_is_cleared() -> None:
    cleared = 0
    for seed in range(30):
        filled = automaton(np.random.default_rng(seed), 0.3, 2)
        way = opened(filled)
        if way is None:
            assert not comes_through(filled)
            continue
        assert comes_through(way)
        assert not (way & ~filled).any()
        if comes_through(filled):
            assert (way == filled).all()
        else:
            cleared += 1
            assert (way != filled).any()
    assert 5 < cleared < 30


def test_the_grid_is_the_world() -> None:
    field = field_of(1, 1, COSTLY)
    grid, solid = grid_of(field.filled), obstacles(field.world)
    assert solid.intersection(shapely.box(0, -4, WAY_M, 4)).area == pytest.approx(
        field.filled[1:-1].sum() * CELL_M**2, rel=0.1
    )
    rng = np.random.default_rng(2)
    for x, y in rng.uniform((-1.5, -4), (WAY_M + 2, 4), (200, 2)):
        point = shapely.Point(x, y)
        if point.distance(solid.boundary) > 0.03:
            is_obstacle = grid.kind_at([x, y]) == CellKind.OBSTACLE
            assert is_obstacle == solid.contains(point)
    assert field.filled.shape == (SIDE_CELLS, SIDE_CELLS)
    assert field.plan.length_m >= WAY_M


def test_the_same_number_is_the_same_world_and_another_seed_another() -> None:
    one, same, other = (field_of(1, seed, COSTLY) for seed in (1, 1, 2))
    assert (one.filled == same.filled).all()
    assert (one.filled != other.filled).any()
    assert (one.fill, one.rounds) == (0.20, 2)


@pytest.mark.parametrize(
    ("time_s", "score", "old"), [(20.0, 0.5, 0.25), (40.0, 0.5, 0.25), (60.0, 1 / 3, 0.25), (200.0, 0.125, 0.125)]
)
def test_the_score_is_the_challenges(time_s: float, score: float, old: float) -> None:
    one = replace(CROSSED, time_s=time_s)
    assert one.score(1.0) == pytest.approx(score)
    assert one.score(1.0, barn.OLDER) == pytest.approx(old)
    assert one.score(2.0) == pytest.approx(min(max(10 / time_s, 1 / 8), 0.5))


@pytest.mark.parametrize("changed", [{"contacts": ("box7",)}, {"off_m": 1.01}, {"time_s": barn.LONGEST_S + 1}])
def test_who_touches_or_does_not_come_there_in_time_has_no_score(changed: dict[str, Any]) -> None:
    assert replace(CROSSED, **changed).score(1.0) == 0.0


def test_the_table_tells_shares_and_means() -> None:
    touched = replace(CROSSED, number=1, fill=0.3, contacts=("box7",))
    sheet, targets, missed = barn.sheets_of([CROSSED, touched], 1.0)
    assert [row[1] for row in sheet.rows[:3]] == ["1", "1", "2"]
    assert sheet.rows[2][2:5] == ("50.0 %", "50.0 %", "0.250")
    assert [row[3].startswith("missed") for row in targets.rows] == [True, True, True]
    assert "box7" in missed.rows[0][0]
