"""Worlds as the BARN challenge has them, of our own generator: obstacles by a cellular automaton, and a way through.

By the published description (Perille et al. 2020: "Benchmarking Metric Ground Navigation"): cells are filled at random,
15 to 30 % of them, and smoothed 2 to 4 times: more than 4 of 8 neighbours fill a cell, less than 2 empty it. The field
is closed at its sides and open at its ends. There is a way through for a square of 5 cells: the challenge's generator
gives the Jackal two cells to each side of its own. Where there is none, a strip of that width is cleared from the
largest region that is open at the begin to that at the end.

A Jackal (0.51 × 0.43 m) crosses 5 × 5 m of cells of 0.15 m, to a goal 10 m on. The simulated wheelchair (1.10 × 0.60 m)
has 3 times the Jackal's area: all lengths are 1.75 times as long, which is the root of that.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from benchmarks.box_worlds import Box, hall
from wheelsight.core.geometry import BoolArray, IntArray
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import Costmap, NavigationSettings, Plan, Planner, StaticLayer
from wheelsight_sim import World

SCALE = 1.75
CELL_M, SIDE_CELLS, WAY_M = 0.15 * SCALE, 33, 10.0 * SCALE
FILLS, ROUNDS = (0.15, 0.20, 0.25, 0.30), (2, 3, 4)
WAY_CELLS = 5
_FIELD_M = SIDE_CELLS * CELL_M
_BEGIN_M = (WAY_M - _FIELD_M) / 2
_BEHIND_M, _BEYOND_M = 2.0, 2.5
# Of a truth that a planner is given: five to a cell of the automaton.
_FINE = 5
_HEIGHTS_M = (1.0, 1.5)


def automaton(rng: np.random.Generator, fill: float, rounds: int, side: int = SIDE_CELLS) -> BoolArray:
    """(side, side) filled cells; first and last row are walls."""
    filled = rng.random((side, side)) < fill
    filled[[0, -1]] = True
    for _ in range(rounds):
        filled = smoothed(filled)
    return filled


def smoothed(filled: BoolArray) -> BoolArray:
    """Once: of 8 neighbours more than 4 fill a cell, less than 2 empty it; beyond first and last row all is filled."""
    padded = np.pad(np.pad(filled.astype(int), ((0, 0), (1, 1))), ((1, 1), (0, 0)), constant_values=1)
    rows, columns = filled.shape
    shifts = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    neighbours = np.sum([padded[i : i + rows, j : j + columns] for i, j in shifts], axis=0)
    return np.asarray((neighbours > 4) | (filled & (neighbours >= 2)))


def opened(filled: BoolArray) -> BoolArray | None:
    """The same with a way from the first column to the last for a square of `WAY_CELLS`; None where an end is shut."""
    reach = WAY_CELLS // 2
    closed = np.pad(np.pad(filled, ((reach, reach), (0, 0)), constant_values=True), ((0, 0), (reach, reach)))
    square = np.ones((WAY_CELLS, WAY_CELLS), np.uint8)
    is_open = cv2.erode((~closed).astype(np.uint8), square)[reach:-reach, reach:-reach]
    _, labels, about, _ = cv2.connectedComponentsWithStats(is_open, connectivity=4)
    ends = [np.unique(column[column > 0]) for column in (labels[:, 0], labels[:, -1])]
    if not all(map(len, ends)):
        return None
    first, last = (there[about[there, cv2.CC_STAT_AREA].argmax()] for there in ends)
    cleared = filled.copy()
    return cleared if first == last else _cleared(cleared, np.argwhere(labels == first), np.argwhere(labels == last))


def _cleared(cleared: BoolArray, begins: IntArray, ends: IntArray) -> BoolArray:
    """With a strip from the last of some cells (N, 2) to the first of others, along the row and then the column."""
    reach = WAY_CELLS // 2
    (row, column), (row_to, column_to) = begins[begins[:, 1].argmax()], ends[ends[:, 1].argmin()]
    for rows, columns in (((row, row), (column, column_to)), ((row, row_to), (column_to, column_to))):
        (top, bottom), (left, right) = sorted(rows), sorted(columns)
        cleared[top - reach : bottom + reach + 1, max(left - reach, 0) : right + reach + 1] = False
    return cleared


@dataclass(frozen=True, eq=False)
class Field:
    """One world. The robot begins at the origin and heads along x, and its goal is `WAY_M` on.

    Attributes:
        number: of it.
        fill, rounds: of the automaton.
        tries: how many were drawn until one could be crossed.
        filled: (33, 33) cells; rows are along y.
        plan: the best way through it, of one who knows it all.
    """

    number: int
    fill: float
    rounds: int
    tries: int
    filled: BoolArray
    plan: Plan

    @cached_property
    def world(self) -> World:
        """With walls round it."""
        heights = np.random.default_rng([self.number, 1])
        boxes = [
            Box(x, y, long_m, CELL_M, float(heights.uniform(*_HEIGHTS_M))) for x, y, long_m in _stretches(self.filled)
        ]
        side_m = _FIELD_M / 2
        return hall(f"field {self.number}", (-_BEHIND_M, -side_m, WAY_M + _BEYOND_M, side_m), boxes, self.number)


def field_of(number: int, seed: int, settings: NavigationSettings) -> Field:
    """The worlds take turns in fill and rounds; those in which the robot finds no way are drawn again."""
    fill, rounds = FILLS[number % len(FILLS)], ROUNDS[number // len(FILLS) % len(ROUNDS)]
    rng, tries = np.random.default_rng([seed, number]), 0
    footprint = settings.footprint.outline
    planner = Planner(footprint, settings.drivable, settings.limits)
    while True:
        filled, tries = opened(automaton(rng, fill, rounds)), tries + 1
        if filled is None:
            continue
        costmap = Costmap.of(StaticLayer.of(grid_of(filled)), footprint, settings.costmap)
        plan = planner.plan(costmap, (0.0, 0.0, 0.0), (WAY_M, 0.0))
        if isinstance(plan, Plan) and not plan.goal_change:
            return Field(number, fill, rounds, tries, filled, plan)


def grid_of(filled: BoolArray) -> OccupancyGrid:
    """The whole hall, as it truly is."""
    cell_m, free = CELL_M / _FINE, np.uint8(CellKind.FREE)
    before, after = (np.full((SIDE_CELLS * _FINE, round(m / cell_m)), free) for m in _ends_m())
    field = np.where(filled.repeat(_FINE, axis=0).repeat(_FINE, axis=1), np.uint8(CellKind.OBSTACLE), free)
    kind = np.pad(np.hstack([before, field, after]), 1, constant_values=int(CellKind.OBSTACLE)).astype(np.uint8)
    origin = (_BEGIN_M - before.shape[1] * cell_m - cell_m, -_FIELD_M / 2 - cell_m)
    return OccupancyGrid.of_kinds(kind, np.zeros(kind.shape, bool), cell_m, origin)


def _ends_m() -> tuple[float, float]:
    """Of floor before the field and after it."""
    return _BEGIN_M + _BEHIND_M, _BEGIN_M + _BEYOND_M


def _stretches(filled: BoolArray) -> list[tuple[float, float, float]]:
    """Filled cells that follow each other along x: middle x, y, and length, metres."""
    steps = np.diff(np.pad(filled, ((0, 0), (1, 1))).astype(int), axis=1)
    (rows, begins), (_, ends) = np.nonzero(steps == 1), np.nonzero(steps == -1)
    y = (rows + 0.5) * CELL_M - _FIELD_M / 2
    x = _BEGIN_M + (begins + ends) / 2 * CELL_M
    return list(zip(x.tolist(), y.tolist(), ((ends - begins) * CELL_M).tolist(), strict=True))
