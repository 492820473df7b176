"""Exploration: selects viewpoints that show unknown floor. Sight: computes the unknown floor that a depth camera
sees from a viewpoint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.geometry import BoolArray, ByteArray, FloatArray, IntArray
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.navigation.costmap import CellState, Costmap, StaticLayer, distances_m
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.planner import cost_to_go
from wheelsight.navigation.settings import NavigationSettings

# Exploration: goals from which a robot sees floor that nobody has seen, until none is left that it can reach.
#
# Views are valued as in González-Baños and Latombe 2002: what they show of unseen floor, less with each metre of way.
# Frontiers alone (Yamauchi 1997) do not tell from where a camera sees what is behind them that sees no floor before 2
# m.


# Places whose views are asked for lie about so far apart.
_APART_M = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class _Aim:
    """What is driven to.

    Attributes:
        view: (3,) x, y, yaw.
        gain: in cells that were not seen when it was chosen.
    """

    view: FloatArray
    gain: int


class Exploration:
    """The `Goals` of a robot that explores.

    Args:
        footprint, settings: of the robot.
        near_m: from the axle, the nearest floor that its camera sees.
        half_view_rad: to either side, how far it sees.
    """

    def __init__(self, footprint: Footprint, settings: NavigationSettings, near_m: float, half_view_rad: float) -> None:
        self._footprint, self._settings = footprint, settings
        self._sight = Sight(near_m, max(settings.exploration.far_m, near_m), half_view_rad)
        self._looked: list[FloatArray] = []  # (3,) from where
        self._at: FloatArray | None = None  # (3,) where it was when it was asked last
        # Of the plan that is driven, and of the one to come.
        self._aim: _Aim | None = None
        self._next: _Aim | None = None
        self._turns = settings.exploration.turns
        self.left = 1
        self.name = "explore"

    @property
    def is_asked_for(self) -> bool:
        """See `Goals`: from beside a view shows as much."""
        return False

    def upcoming(self, pose: FloatArray, costmap: Costmap) -> tuple[FloatArray, ...]:
        """See `Goals`: first once around, then the view that is worth most."""
        if self._turns > 0:
            step = 2 * np.pi / self._settings.exploration.turns
            self._next = None
            return (np.array([pose[0], pose[1], wrap_angle(pose[2] + step)]),)
        is_wanted = self._wanted(costmap, pose)
        self._next = self._best(pose, costmap, is_wanted)
        self.left = 0 if self._next is None else self._pieces(is_wanted, costmap.resolution_m)
        return () if self._next is None else (self._next.view,)

    def is_met(self, pose: FloatArray, layer: StaticLayer) -> bool:
        """See `Goals`: it looked from near enough, or what was to be seen was seen on the way."""
        self._at = pose
        if self._turns > 0 or self._aim is None:
            return False
        s, view = self._settings.exploration, self._aim.view
        if _apart_m(view, pose) <= s.there_m and _turn_rad(view, pose) <= s.there_rad:
            return True
        left = len(self._seen_from(view, layer, layer.is_unseen))
        return left <= (1 - s.shown) * self._aim.gain

    def taken(self) -> None:
        """See `Goals`."""
        self._aim = self._next

    def reached(self) -> None:
        """See `Goals`."""
        if self._turns > 0:
            self._turns -= 1
        elif self._aim is not None:
            # What was seen from elsewhere may still be looked at from there.
            s, at, view = self._settings.exploration, self._at, self._aim.view
            is_there = at is not None and _apart_m(at, view) < s.same_m and _turn_rad(at, view) < s.same_rad
            self._looked.append(at if at is not None and is_there else view)

    def missed(self) -> bool:
        """See `Goals`: there are other views, also of the same floor."""
        if self._turns > 0:
            self._turns = 0
        elif self._aim is not None:
            self._looked.append(self._aim.view)
        return True

    def _wanted(self, costmap: Costmap, pose: FloatArray) -> BoolArray:
        """(H, W) floor that nobody has seen, wide enough for a robot, joined to where it is, and not given up."""
        s, size_m = self._settings.exploration, costmap.resolution_m
        is_wide = self._is_wide(costmap.state, size_m)
        row, column = costmap.cells_at(pose[:2]).tolist()
        is_wide[row, column] = True
        _, labels = cv2.connectedComponents(is_wide.astype(np.uint8), connectivity=4)
        is_wanted = costmap.is_unseen & self._is_about(labels == labels[row, column], size_m)
        looks = np.zeros(is_wanted.shape, np.int64)
        for view in self._looked:
            cells = self._seen_from(view, costmap, is_wanted)
            looks[cells[:, 0], cells[:, 1]] += 1
        return np.asarray(is_wanted & (looks < s.tries))

    def _best(self, pose: FloatArray, costmap: Costmap, is_wanted: BoolArray) -> _Aim | None:
        """The view that is worth most; None where none shows enough."""
        s = self._settings.exploration
        cells, ways_m = self._places(pose, costmap, is_wanted)
        is_clear = self._is_about(self._is_wide(costmap.state, costmap.resolution_m), costmap.resolution_m)
        marked = marks(is_clear, is_wanted)
        gains, headings = self._sight.gains_m2(marked, costmap.resolution_m, np.asarray(cells + 0.5, float))
        worth = np.zeros_like(gains)
        shows = gains >= s.least_m2
        place, heading = np.nonzero(shows)
        poses = np.column_stack([costmap.middle_of(cells[place]), headings[heading]])
        turn_rad = np.abs(wrap_angle(headings[heading] - pose[2]))
        value = gains[shows] * np.exp(-s.way_per_m * (ways_m[place] + s.turn_m * turn_rad))
        worth[shows] = np.where(self._fits(costmap, poses) & ~self._is_old(poses), value, 0.0)
        if not worth.any():
            return None
        best, heading_of = np.unravel_index(int(worth.argmax()), worth.shape)
        view = np.array([*costmap.middle_of(cells[best]), headings[heading_of]])
        return _Aim(view, len(self._seen_from(view, costmap, costmap.is_unseen)))

    def _places(self, pose: FloatArray, costmap: Costmap, is_wanted: BoolArray) -> tuple[IntArray, FloatArray]:
        """(P, 2) cells that can be reached and lie near to what is wanted, and what ways there cost, (P,)."""
        ways_m = self._ways_m(pose, costmap)
        is_near = distances_m(is_wanted, costmap.resolution_m) <= self._sight.far_m
        step = max(1, round(_APART_M / costmap.resolution_m))
        is_asked = np.zeros(is_wanted.shape, bool)
        row, column = costmap.cells_at(pose[:2]).tolist()
        is_asked[row % step :: step, column % step :: step] = True
        cells = np.argwhere(np.isfinite(ways_m) & is_near & is_asked)
        return cells, ways_m[cells[:, 0], cells[:, 1]]

    def _ways_m(self, pose: FloatArray, costmap: Costmap) -> FloatArray:
        """(H, W) what ways to each cell cost, of the circle within the outline; infinite where none leads."""
        metre = np.where(costmap.distance_m >= self._least_m, 1 + costmap.cost, np.inf).astype(np.float32)
        row, column = costmap.cells_at(pose[:2]).tolist()
        metre[row, column] = 1.0
        return cost_to_go(metre, costmap.resolution_m, (row, column))

    @property
    def _least_m(self) -> float:
        return self._footprint.inscribed_m + self._settings.planner.margin_m

    def _fits(self, costmap: Costmap, poses: FloatArray) -> BoolArray:
        """(N,) whether circles along the outline's middle fit at poses (N, 3), which most poses in walls fail."""
        radius_m = self._footprint.inscribed_m
        low, high = self._footprint.corners[:, 0].min() + radius_m, self._footprint.corners[:, 0].max() - radius_m
        fits = np.ones(len(poses), bool)
        for along_m in np.linspace(low, max(low, high), 1 + math.ceil(max(high - low, 0.0) / radius_m)):
            middles = poses[:, :2] + along_m * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
            at = np.clip(costmap.cells_at(middles), 0, np.array(costmap.state.shape) - 1)
            fits &= costmap.distance_m[at[:, 0], at[:, 1]] >= self._least_m
        return fits

    def _is_old(self, poses: FloatArray) -> BoolArray:
        """(N,) whether it looked from there before, in that direction."""
        s, is_old = self._settings.exploration, np.zeros(len(poses), bool)
        for looked in self._looked:
            is_near = np.hypot(*(poses[:, :2] - looked[:2]).T) < s.same_m
            is_old |= is_near & (np.cos(poses[:, 2] - looked[2]) > np.cos(s.same_rad))
        return is_old

    def _seen_from(self, view: FloatArray, of: Costmap | StaticLayer, is_wanted: BoolArray) -> IntArray:
        """(N, 2) cells of those wanted that a view shows."""
        cell, size_m = (view[1::-1] - of.origin[::-1]) / of.resolution_m, of.resolution_m
        # Nothing farther matters, and it is asked often.
        reach = math.ceil((self._sight.far_m + self._settings.exploration.least_m) / size_m)
        low = np.clip(cell.astype(int) - reach, 0, of.state.shape)
        high = np.clip(cell.astype(int) + reach + 1, 0, of.state.shape)
        cut = slice(low[0], high[0]), slice(low[1], high[1])
        if (low >= high).any():
            return np.zeros((0, 2), np.int64)
        is_clear = self._is_about(self._is_wide(of.state[cut], size_m), size_m)
        return np.asarray(low + self._sight.seen(marks(is_clear, is_wanted[cut]), size_m, cell - low, float(view[2])))

    def _is_wide(self, state: ByteArray, resolution_m: float) -> BoolArray:
        """(H, W) places so far from all that is occupied that a robot might be there; what is not known may be free."""
        least_m = self._settings.exploration.least_m / 2
        return np.asarray(distances_m(state == CellState.OCCUPIED, resolution_m) >= least_m)

    def _is_about(self, is_wide: BoolArray, resolution_m: float) -> BoolArray:
        """(H, W) floor about such places; a cell less, lest a hole in a wall show what is behind it."""
        reach_m = self._settings.exploration.least_m / 2 - resolution_m
        return np.asarray(distances_m(is_wide, resolution_m) <= max(reach_m, 0.0))

    def _pieces(self, is_wanted: BoolArray, resolution_m: float) -> int:
        """How many pieces of floor that is wanted are large enough for a look; at least the one that is next."""
        _, _, about, _ = cv2.connectedComponentsWithStats(is_wanted.astype(np.uint8), connectivity=8)
        areas_m2 = np.asarray(about)[1:, cv2.CC_STAT_AREA] * resolution_m**2
        return max(1, int(np.count_nonzero(areas_m2 >= self._settings.exploration.least_m2)))


def _apart_m(pose: FloatArray, other: FloatArray) -> float:
    return float(np.hypot(*(pose[:2] - other[:2])))


def _turn_rad(pose: FloatArray, other: FloatArray) -> float:
    return abs(float(wrap_angle(pose[2] - other[2])))


# Sight: how much floor that nobody has seen a depth camera would see from places of a map.


# Rays all around, from a place of which the gain is asked: at 3.5 m they are 0.3 m apart.
_RAYS = 72
# Places at a time, which bounds memory to some tens of megabytes.
_AT_ONCE = 256
_WANTED, _OPAQUE = 1, 2


@dataclass(frozen=True, slots=True)
class Sight:
    """Of a camera that looks ahead.

    Attributes:
        near_m, far_m: from the axle, the nearest floor that it sees, and the farthest that counts.
        half_rad: to either side of straight ahead.
    """

    near_m: float
    far_m: float
    half_rad: float

    def gains_m2(self, marked: ByteArray, resolution_m: float, cells: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What it would see of what is wanted, looking each way from some places.

        Args:
            marked: (H, W) of `marks`.
            resolution_m: side of a cell.
            cells: (P, 2) row and column, of which .5 is a cell's middle.

        Returns:
            gains (P, R) in m², and the headings (R,) to which they belong.
        """
        turn = 2 * np.pi / _RAYS
        headings: FloatArray = np.linspace(-np.pi, np.pi, _RAYS, endpoint=False)
        along_m = self._along_m(resolution_m)
        area = np.where(along_m >= self.near_m, along_m * resolution_m * turn, 0.0)
        by_ray = [
            _is_seen(marked, resolution_m, some, headings, along_m) @ area for some in _chunks(np.asarray(cells, float))
        ]
        gain = np.concatenate([np.zeros((0, _RAYS)), *by_ray])
        # A ray stands for half a turn to either side of it, hence the outermost count by a part.
        whole = int(self.half_rad / turn - 0.5)
        rest = min(self.half_rad / turn - 0.5 - whole, 1.0)
        shares = dict.fromkeys(range(-whole, whole + 1), 1.0) | {whole + 1: rest, -whole - 1: rest}
        return np.sum([share * np.roll(gain, k, axis=1) for k, share in shares.items()], axis=0), headings

    def seen(self, marked: ByteArray, resolution_m: float, cell: FloatArray, heading_rad: float) -> IntArray:
        """(N, 2) row and column of the cells that are wanted and would be seen from a place (2,), looking one way."""
        count = 2 + int(2 * self.half_rad * self.far_m / resolution_m)
        headings = heading_rad + np.linspace(-self.half_rad, self.half_rad, count)
        along_m = self._along_m(resolution_m)
        is_seen = _is_seen(marked, resolution_m, np.asarray(cell, float)[None], headings, along_m)[0]
        ray, step = np.nonzero(is_seen & (along_m >= self.near_m))
        return np.unique(_cells_along(cell, headings[ray], along_m[step] / resolution_m), axis=0)

    def _along_m(self, resolution_m: float) -> FloatArray:
        return np.arange(0.5 * resolution_m, self.far_m, resolution_m)


def marks(is_clear: BoolArray, is_wanted: BoolArray) -> ByteArray:
    """(H, W) what `Sight` goes by: which cells are wanted, and which can be seen past; others hide what is behind."""
    return np.where(is_clear, np.where(is_wanted, _WANTED, 0), _OPAQUE).astype(np.uint8)


def _is_seen(
    marked: ByteArray, resolution_m: float, cells: FloatArray, headings: FloatArray, along_m: FloatArray
) -> BoolArray:
    """(P, R, S) whether what is wanted lies there, and nothing before it; beyond the edges there is neither."""
    at = _cells_along(cells[:, None, None], headings[:, None], along_m / resolution_m)
    inside = ((at >= 0) & (at < marked.shape)).all(axis=-1)
    at[~inside] = 0
    met = np.where(inside, marked[at[..., 0], at[..., 1]], 0)
    is_hidden = np.maximum.accumulate(met == _OPAQUE, axis=-1)
    return np.asarray((met == _WANTED) & ~is_hidden)


def _cells_along(cells: ArrayLike, headings: FloatArray, steps: FloatArray) -> IntArray:
    """(..., 2) row and column so many cells from places, in directions."""
    ways = np.stack(np.broadcast_arrays(steps * np.sin(headings), steps * np.cos(headings)), axis=-1)
    return np.asarray(np.floor(np.asarray(cells, float) + ways), np.int64)


def _chunks(cells: FloatArray) -> list[FloatArray]:
    return [cells[k : k + _AT_ONCE] for k in range(0, len(cells), _AT_ONCE)]
