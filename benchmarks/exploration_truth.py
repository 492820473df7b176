"""What a robot could explore of a world, by its true plan: the floor it can reach, and a tour that sees all of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import shapely

from wheelsight.core.geometry import BoolArray, ByteArray, FloatArray, IntArray
from wheelsight.navigation import Footprint
from wheelsight.navigation.exploration import ViewSector, marks
from wheelsight.navigation.planner import cost_to_go
from wheelsight_sim.clearance import footprints, obstacles
from wheelsight_sim.world import World

CELL_M = 0.05
_AROUND_M = 1.0
_HEADINGS, _STEP_CELLS = 48, 3
_VIEWS_APART_CELLS = 6


@dataclass(frozen=True, eq=False)
class TruePlan:
    """The floor of a world in cells of 0.05 m, and where a robot with an outline can be on it.

    Attributes:
        is_taken: (H, W) something that a wheelchair runs into is within half a cell of the cell's middle.
        is_tall: (H, W) likewise, something as high as the camera, which hides what is behind it.
        origin: x and y in the world of the corner of cell (0, 0).
        footprint: of the robot.
        margin_m: that its planner keeps at least.
    """

    is_taken: BoolArray
    is_tall: BoolArray
    origin: tuple[float, float]
    footprint: Footprint
    margin_m: float

    @classmethod
    def of(cls, world: World, footprint: Footprint, margin_m: float, camera_m: float) -> TruePlan:
        """Of a world; the camera is so high over the floor."""
        x_min, y_min, x_max, y_max = world.size_m
        origin = x_min - _AROUND_M, y_min - _AROUND_M
        columns, rows = (int((side + 2 * _AROUND_M) / CELL_M) for side in (x_max - x_min, y_max - y_min))
        x, y = ((np.arange(count) + 0.5) * CELL_M + low for count, low in ((columns, origin[0]), (rows, origin[1])))
        tall = [one.polygon for one in footprints(world) if one.is_solid and one.bottom_m < camera_m < one.top_m]
        # Walls of floor plans are thinner than a cell.
        grown = [shapely.buffer(of, CELL_M / 2) for of in (obstacles(world), shapely.union_all(tall))]
        taken, is_tall = (np.asarray(shapely.contains_xy(of, *np.meshgrid(x, y))) for of in grown)
        return cls(taken, is_tall, origin, footprint, margin_m)

    def cells_at(self, xy: FloatArray) -> IntArray:
        """(..., 2) row and column of places (..., 2); they may lie outside."""
        return np.asarray(np.floor((np.asarray(xy, float)[..., ::-1] - self.origin[::-1]) / CELL_M), np.int64)

    def middle_of(self, cells: IntArray) -> FloatArray:
        """(..., 2) places of the middles of cells (..., 2)."""
        return np.asarray((np.asarray(cells, float)[..., ::-1] + 0.5) * CELL_M + self.origin)

    @cached_property
    def free_poses(self) -> BoolArray:
        """(headings, H, W) where the outline fits with the margin, its axle's middle at the cell's."""
        grown = self.footprint.padded(self.margin_m)
        taken = self.is_taken.astype(np.uint8)
        return np.stack([cv2.dilate(taken, _print(grown, yaw)) == 0 for yaw in _yaws()])

    def reached(self, start: FloatArray) -> BoolArray:
        """(headings, H, W) poses that it comes to from a pose (3,), turning on the spot and driving along its heading.

        It goes from heading to heading of 48, and in steps of three cells, of which each must be free.
        """
        free = np.pad(self.free_poses, ((0, 0), (_STEP_CELLS,) * 2, (_STEP_CELLS,) * 2))
        count, height, width = free.shape
        row, column = (self.cells_at(start[:2]) + _STEP_CELLS).tolist()
        heading = round(float(start[2]) / (2 * np.pi / count)) % count
        flat, is_reached = free.ravel(), np.zeros(free.size, bool)
        front = np.array([(heading * height + row) * width + column])
        steps = [[k * c for k in range(1, _STEP_CELLS + 1)] for c in (1, -1)]
        ways = np.array([[_offsets(yaw, some, width) for some in steps] for yaw in _yaws()])
        # Where it truly stands it may be nearer to something than its planner would go.
        is_reached[front] = True
        while len(front):
            heading_of, place = np.divmod(front, height * width)
            turned = [((heading_of + turn) % count) * height * width + place for turn in (1, -1)]
            passed = front[:, None, None] + ways[heading_of]
            driven = passed[..., -1][flat[passed].all(axis=-1)]
            found = np.concatenate([*turned, driven])
            front = np.unique(found[flat[found] & ~is_reached[found]])
            is_reached[front] = True
        cut = slice(_STEP_CELLS, -_STEP_CELLS)
        return np.asarray(is_reached.reshape(free.shape)[:, cut, cut])

    def covered(self, reached: BoolArray) -> BoolArray:
        """(H, W) cells that the outline covers at any of the poses."""
        found = np.zeros(self.is_taken.shape, bool)
        for poses, yaw in zip(reached, _yaws(), strict=True):
            found |= np.asarray(cv2.dilate(poses.astype(np.uint8), np.flip(_print(self.footprint, yaw)))) > 0
        return np.asarray(found & ~self.is_taken)

    def open_floor(self, start: FloatArray) -> BoolArray:
        """(H, W) cells where nothing stands, joined to the one where it begins: narrow ones and corners, too."""
        _, labels = cv2.connectedComponents((~self.is_taken).astype(np.uint8), connectivity=4)
        row, column = self.cells_at(start[:2]).tolist()
        return np.asarray((labels == labels[row, column]) & ~self.is_taken)


def tour_m(plan: TruePlan, reached: BoolArray, start: FloatArray, sight: ViewSector, share: float) -> float:
    """How far somebody drives who knows the plan, and looks all around at some places, until he has seen the floor.

    Places are chosen greedily, by how much more each shows, until a share of what can be seen of the floor is; those
    that prove needless are left out. They are visited in an order that the nearest next one and 2-opt find, from the
    start, and not back. No one has proved that it is the shortest; things below the camera hide nothing from it, and
    turns cost nothing.
    """
    shown = _shown(plan, reached, start, sight)
    chosen = _cover(shown.is_shown, share)
    return _shortest_m(_ways_m(plan, reached, shown.cells[chosen]))


@dataclass(frozen=True, eq=False)
class _Shown:
    """(P, 2) places at which the robot can turn round, the start first; and (P, N) which floor each shows."""

    cells: IntArray
    is_shown: BoolArray


def _shown(plan: TruePlan, reached: BoolArray, start: FloatArray, sight: ViewSector) -> _Shown:
    is_asked = np.zeros(plan.is_taken.shape, bool)
    is_asked[::_VIEWS_APART_CELLS, ::_VIEWS_APART_CELLS] = True
    cells = np.vstack([plan.cells_at(start[:2]), np.argwhere(reached.all(axis=0) & is_asked)])
    covered = plan.covered(reached)
    marked: ByteArray = marks(~plan.is_tall, covered)
    around = ViewSector(sight.near_m, sight.far_m, np.pi)
    number = np.full(covered.shape, -1)
    number[covered] = np.arange(np.count_nonzero(covered))
    is_shown = np.zeros((len(cells), np.count_nonzero(covered)), bool)
    for one, cell in zip(is_shown, cells, strict=True):
        seen = around.seen(marked, CELL_M, cell + 0.5, 0.0)
        one[number[seen[:, 0], seen[:, 1]]] = True
    return _Shown(cells, is_shown)


def _cover(is_shown: BoolArray, share: float) -> list[int]:
    """Places, the first always, that together show a share of what all show."""
    enough = share * np.count_nonzero(is_shown.any(axis=0))
    chosen, is_seen = [0], is_shown[0].copy()
    while np.count_nonzero(is_seen) < enough:
        best = int((is_shown & ~is_seen).sum(axis=1).argmax())
        chosen.append(best)
        is_seen |= is_shown[best]
    for one in chosen[1:]:
        others = [other for other in chosen if other != one]
        if np.count_nonzero(is_shown[others].any(axis=0)) >= enough:
            chosen = others
    return chosen


def _ways_m(plan: TruePlan, reached: BoolArray, cells: IntArray) -> FloatArray:
    """(P, P) metres from place to place, over cells at which the robot can be in some heading."""
    metre = np.where(reached.any(axis=0), 1.0, np.inf).astype(np.float32)
    metre[tuple(cells[0])] = 1.0
    rows = [cost_to_go(metre, CELL_M, (int(row), int(column)))[tuple(cells.T)] for row, column in cells]
    return np.array(rows)


def _shortest_m(ways_m: FloatArray) -> float:
    """Of an open way from the first through all others."""
    order = [0]
    while len(order) < len(ways_m):
        left = [k for k in range(len(ways_m)) if k not in order]
        order.append(min(left, key=lambda k: ways_m[order[-1], k]))
    best = _length_m(ways_m, order)
    is_better = True
    while is_better:
        is_better = False
        for i in range(1, len(order) - 1):
            for j in range(i + 1, len(order)):
                turned = [*order[:i], *order[i : j + 1][::-1], *order[j + 1 :]]
                if (length := _length_m(ways_m, turned)) < best - 1e-9:
                    order, best, is_better = turned, length, True
    return best


def _length_m(ways_m: FloatArray, order: Sequence[int]) -> float:
    return float(ways_m[order[:-1], order[1:]].sum())


def _yaws() -> FloatArray:
    return np.arange(_HEADINGS) * 2 * np.pi / _HEADINGS


def _offsets(yaw: float, steps: Sequence[int], width: int) -> list[int]:
    """By how much a cell's number grows with each of some steps along a heading."""
    return [round(step * float(np.sin(yaw))) * width + round(step * float(np.cos(yaw))) for step in steps]


def _print(footprint: Footprint, yaw: float) -> ByteArray:
    """(k, k) cells under an outline whose axle's middle is in the middle one."""
    reach = int(np.ceil(footprint.circumscribed_m / CELL_M)) + 1
    away = CELL_M * np.stack(np.meshgrid(*2 * [np.arange(-reach, reach + 1)]), axis=-1)
    c, s = np.cos(yaw), np.sin(yaw)
    return np.asarray(footprint.contains(away @ np.array([[c, -s], [s, c]])), np.uint8)
