"""Exploration: selects viewpoints that show unseen floor.

`ViewSector` computes the floor that a depth camera sees from a viewpoint.
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
from wheelsight.navigation.planner import cost_to_go
from wheelsight.navigation.settings import Footprint
from wheelsight.navigation.view_tour import best_order, covering_views

# Spacing of the places that are candidates.
_APART_M = 0.25
# Least width of unseen floor that is worth a look: a robot needs as much. Least unseen floor of a viewpoint, a third of
# a wheelchair's area (found on the simulator alone: docs/decisions/planner).
_LEAST_M, _LEAST_M2 = 0.6, 0.2
# Largest distance at which floor counts as visible: a Kinect's floor is rough beyond.
FAR_M = 3.5
# Time to a viewpoint, as a way at 0.3 m/s: a radian of turn takes 2 s, over floor that was not seen lately,
# and a stop with a choice 3 s.
_STOP_M, _TURN_M = 1.0, 0.6
# Cost of a way between two viewpoints that the circle cannot go, which is none of a tour.
_NO_WAY_M = 1e3
# Largest ratio of the cost of the best tour that begins with the present viewpoint to that of the best one.
_STAYS = 1.15
# Exploration ends when all views together show less than this share of free floor, and none shows as many m².
_LEFT, _LEFT_M2 = 0.015, 0.6
# Share of a viewpoint's floor that makes it unnecessary once it was seen from elsewhere: the next one shows the rest.
_SHOWN = 0.9
# Looks at floor that stays unseen before it is given up, and looks in a whole turn in place at the start.
_TRIES, TURNS = 2, 3
# Distance and angle below which viewpoints count as one; and from a viewpoint that are near enough. A Kinect sees 1
# rad.
_SAME_M, _SAME_RAD, _THERE_M, _THERE_RAD = 0.7, 0.5, 0.15, 0.15


@dataclass(frozen=True, slots=True, eq=False)
class _Viewpoint:
    """A viewpoint to drive to.

    Attributes:
        gain: number of unseen cells that it showed when it was chosen.
    """

    view: FloatArray
    gain: int


class Exploration:
    """Goals of a robot that explores, until it has seen all reachable floor.

    Views are chosen that show unseen floor together, each by what it adds for its time (cf. González-Baños and Latombe
    2002), and ordered to a tour (`view_tour`), whose first view is the goal. The robot stays with it until another tour
    is clearly better, and drives on once it has seen its floor.
    Frontiers (Yamauchi 1997) are not enough for a camera that sees no floor before 2 m: they do not say from where it
    sees what is behind them.

    Args:
        near_m: distance from the axle to the nearest floor that its camera sees.
    """

    is_asked_for = False  # a place beside a viewpoint shows as much
    name = "explore"

    def __init__(self, footprint: Footprint, margin_m: float, near_m: float, half_view_rad: float) -> None:
        self._footprint = footprint
        # Least distance of the footprint's centre line to obstacles.
        self._least_m = footprint.inscribed_m + margin_m
        self._sight = ViewSector(near_m, max(FAR_M, near_m), half_view_rad)
        self._looked: list[FloatArray] = []  # (3,) visited views
        self._missed: list[FloatArray] = []  # (3,) views that no way leads to, in any direction
        self._at: FloatArray | None = None  # (3,) last pose
        # Viewpoints of the current plan, and of the one that is computed.
        self._aim: _Viewpoint | None = None
        self._next: _Viewpoint | None = None
        self._turns = TURNS
        self.left = 1

    def upcoming(self, pose: FloatArray, costmap: Costmap) -> tuple[FloatArray, ...]:
        """Return the next poses of a full turn at first, then the best viewpoint; see `Goals`."""
        if self._turns > 0:
            step = 2 * np.pi / TURNS
            self._next = None
            return (np.array([pose[0], pose[1], wrap_angle(pose[2] + step)]),)
        # Unseen floor (H, W) that is wide enough for a robot, connected to it, and not given up.
        size_m = costmap.resolution_m
        is_wide = self._is_wide(costmap.state, size_m)
        row, column = costmap.cells_at(pose[:2]).tolist()
        is_wide[row, column] = True
        _, labels = cv2.connectedComponents(is_wide.astype(np.uint8), connectivity=4)
        is_wanted = costmap.is_unseen & self._is_about(labels == labels[row, column], size_m)
        looks = np.zeros(is_wanted.shape, np.int64)
        for view in self._looked:
            cells = self._seen_from(view, costmap, is_wanted)
            looks[cells[:, 0], cells[:, 1]] += 1
        is_wanted = np.asarray(is_wanted & (looks < _TRIES))
        self._next = self.best_viewpoint(pose, costmap, is_wanted)
        if self._next is None:
            self.left = 0
            return ()
        # The number of areas that are large enough for a look, but at least the next one.
        _, _, areas, _ = cv2.connectedComponentsWithStats(is_wanted.astype(np.uint8), connectivity=8)
        areas_m2 = np.asarray(areas)[1:, cv2.CC_STAT_AREA] * costmap.resolution_m**2
        self.left = max(1, int(np.count_nonzero(areas_m2 >= _LEAST_M2)))
        return (self._next.view,)

    def is_met(self, pose: FloatArray, layer: StaticLayer) -> bool:
        """Return whether the robot is near enough to the viewpoint, or has seen its floor on the way; see `Goals`."""
        self._at = pose
        if self._turns > 0 or self._aim is None:
            return False
        view = self._aim.view
        if _apart_m(view, pose) <= _THERE_M and _turn_rad(view, pose) <= _THERE_RAD:
            return True
        left = len(self._seen_from(view, layer, layer.is_unseen))
        return left <= (1 - _SHOWN) * self._aim.gain

    def taken(self) -> None:
        """Start to drive to the next viewpoint; see `Goals`."""
        self._aim = self._next

    def reached(self) -> None:
        """Record the view; see `Goals`."""
        if self._turns > 0:
            self._turns -= 1
        elif self._aim is not None:
            # A view from elsewhere does not rule out another look from the viewpoint.
            at, view = self._at, self._aim.view
            is_there = at is not None and _apart_m(at, view) < _SAME_M and _turn_rad(at, view) < _SAME_RAD
            self._looked.append(at if at is not None and is_there else view)
            self._aim = None

    def missed(self) -> bool:
        """Skip the viewpoint and return True, as others may show the same floor; see `Goals`."""
        if self._turns > 0:
            self._turns = 0
        elif self._aim is not None:
            self._looked.append(self._aim.view)
            self._missed.append(self._aim.view)
            self._aim = None
        return True

    def best_viewpoint(self, pose: FloatArray, costmap: Costmap, is_wanted: BoolArray) -> _Viewpoint | None:
        """Return the first view of the best tour of views that show wanted floor; None if too little is left.

        A tour takes a corner along that is on its way, where the view with the most floor for its time leaves it, and
        comes back for it later (cf. Cao et al. 2021, TARE).
        """
        size_m = costmap.resolution_m
        # Path costs (H, W) of the inscribed circle from the robot.
        row, column = costmap.cells_at(pose[:2]).tolist()
        metre = np.where(costmap.distance_m >= self._least_m, 1 + costmap.cost, np.inf).astype(np.float32)
        metre[row, column] = 1.0
        ways_m = cost_to_go(metre, size_m, (row, column))
        is_clear = self._is_about(self._is_wide(costmap.state, size_m), size_m)
        poses, gains_m2 = self._candidates(costmap, is_wanted, is_clear, ways_m, (row, column))

        def seen_by(view: FloatArray, is_left: BoolArray) -> IntArray:
            cell = (view[1::-1] - costmap.origin[::-1]) / size_m
            return self._sight.seen(marks(is_clear, is_left), size_m, cell, float(view[2]))

        aim, least = self._aim, _LEAST_M2 / size_m**2
        if aim is not None:
            at = costmap.cells_at(aim.view[:2])
            is_way = ((at >= 0) & (at < ways_m.shape)).all() and np.isfinite(ways_m[at[0], at[1]])
            aim = aim if is_way and len(seen_by(aim.view, is_wanted)) >= least else None
        cells = costmap.cells_at(poses[:, :2])
        cost_m = _STOP_M + ways_m[cells[:, 0], cells[:, 1]] + _TURN_M * _turns_rad(pose, poses)
        first = None if aim is None else aim.view
        views, added = covering_views(seen_by, is_wanted, poses, gains_m2 / size_m**2, cost_m, least, first)
        is_little = added.sum() < _LEFT * np.count_nonzero(costmap.state == CellState.FREE)
        if len(views) == 0 or (is_little and added.max() * size_m**2 < _LEFT_M2):
            return None
        places = costmap.cells_at(np.vstack([pose[:2], views[:, :2]]))
        costs_m = np.zeros((len(places), len(places)))
        for k, (row, column) in enumerate(places[1:].tolist(), 1):
            costs_m[:, k] = cost_to_go(metre, size_m, (row, column))[places[:, 0], places[:, 1]]
        for k, start in enumerate([pose, *views]):
            costs_m[k, 1:] += _STOP_M + _TURN_M * _turns_rad(start, views)
        costs_m[~np.isfinite(costs_m)] = _NO_WAY_M
        order, tour_m = best_order(costs_m, added)
        # The robot stays with its view until another tour is clearly better: two doors alike let it go to and fro.
        if aim is not None and (order[0] == 0 or best_order(costs_m, added, first=0)[1] <= _STAYS * tour_m):
            return aim
        view = views[order[0]]
        return _Viewpoint(view, len(self._seen_from(view, costmap, costmap.is_unseen)))

    def _candidates(
        self,
        costmap: Costmap,
        is_wanted: BoolArray,
        is_clear: BoolArray,
        ways_m: FloatArray,
        begin: tuple[int, int],
    ) -> tuple[FloatArray, FloatArray]:
        """Return (V, 3) views that are not ruled out, and (V,) areas of wanted floor that they show.

        They stand on a grid through the robot's cell `begin`, in the headings that show more than the others about them
        that are not ruled out.
        """
        size_m = costmap.resolution_m
        is_close = distances_m(is_wanted, size_m) <= self._sight.far_m
        step = max(1, round(_APART_M / size_m))
        is_asked = np.zeros(is_wanted.shape, bool)
        is_asked[begin[0] % step :: step, begin[1] % step :: step] = True
        cells = np.argwhere(np.isfinite(ways_m) & is_close & is_asked)
        gains, headings = self._sight.gains_m2(marks(is_clear, is_wanted), size_m, np.asarray(cells + 0.5, float))
        place, heading = np.nonzero(gains >= _LEAST_M2)
        poses = np.column_stack([costmap.middle_of(cells[place]), headings[heading]])
        is_good = np.ones(len(poses), bool)
        for looked in self._looked:
            is_near = np.hypot(*(poses[:, :2] - looked[:2]).T) < _SAME_M
            is_good &= ~(is_near & (np.cos(poses[:, 2] - looked[2]) > np.cos(_SAME_RAD)))
        for missed in self._missed:
            is_good &= np.hypot(*(poses[:, :2] - missed[:2]).T) >= _SAME_M
        # Circles along the outline's centre line fit: a fast test for walls.
        radius_m, along_x = self._footprint.inscribed_m, self._footprint.corners[:, 0]
        low, high = along_x.min() + radius_m, along_x.max() - radius_m
        for along_m in np.linspace(low, max(low, high), 1 + math.ceil(max(high - low, 0.0) / radius_m)):
            middles = poses[:, :2] + along_m * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
            at = np.clip(costmap.cells_at(middles), 0, np.array(costmap.state.shape) - 1)
            is_good &= costmap.distance_m[at[:, 0], at[:, 1]] >= self._least_m
        gains[place[~is_good], heading[~is_good]] = 0.0
        within = max(1, int(self._sight.half_rad / (headings[1] - headings[0])))
        around = np.max([np.roll(gains, k, axis=1) for k in range(-within, within + 1)], axis=0)
        is_best = gains[place, heading] == around[place, heading]
        return poses[is_good & is_best], gains[place, heading][is_good & is_best]

    def _seen_from(self, view: FloatArray, of: Costmap | StaticLayer, is_wanted: BoolArray) -> IntArray:
        """Return wanted cells (N, 2) that a view shows."""
        cell, size_m = (view[1::-1] - of.origin[::-1]) / of.resolution_m, of.resolution_m
        # Cut to what is in reach, as this is called often.
        reach = math.ceil((self._sight.far_m + _LEAST_M) / size_m)
        low = np.clip(cell.astype(int) - reach, 0, of.state.shape)
        high = np.clip(cell.astype(int) + reach + 1, 0, of.state.shape)
        cut = slice(low[0], high[0]), slice(low[1], high[1])
        if (low >= high).any():
            return np.zeros((0, 2), np.int64)
        is_clear = self._is_about(self._is_wide(of.state[cut], size_m), size_m)
        return np.asarray(low + self._sight.seen(marks(is_clear, is_wanted[cut]), size_m, cell - low, float(view[2])))

    def _is_wide(self, state: ByteArray, resolution_m: float) -> BoolArray:
        """Return (H, W) places where a robot might be: far enough from occupied cells, even if unknown."""
        least_m = _LEAST_M / 2
        return np.asarray(distances_m(state == CellState.OCCUPIED, resolution_m) >= least_m)

    def _is_about(self, is_wide: BoolArray, resolution_m: float) -> BoolArray:
        """Return (H, W) floor around such places, less a cell, so that holes in walls show nothing behind them."""
        reach_m = _LEAST_M / 2 - resolution_m
        return np.asarray(distances_m(is_wide, resolution_m) <= max(reach_m, 0.0))


def _apart_m(pose: FloatArray, other: FloatArray) -> float:
    """Return the distance between two poses."""
    return float(np.hypot(*(pose[:2] - other[:2])))


def _turns_rad(pose: FloatArray, poses: FloatArray) -> FloatArray:
    """Return (N,) angles that a robot turns on straight ways from a pose (3,) to others (N, 3)."""
    ways = poses[:, :2] - pose[:2]
    along = np.arctan2(ways[:, 1], ways[:, 0])
    on_way = np.abs(wrap_angle(along - pose[2])) + np.abs(wrap_angle(poses[:, 2] - along))
    at_once = np.abs(wrap_angle(poses[:, 2] - pose[2]))
    return np.asarray(np.where(np.hypot(*ways.T) < _THERE_M, at_once, on_way))


def _turn_rad(pose: FloatArray, other: FloatArray) -> float:
    """Return the angle between two headings."""
    return abs(float(wrap_angle(pose[2] - other[2])))


# Rays in all directions from a place: at 3.5 m they are 0.3 m apart.
_RAYS = 72
# Places at a time, which limits memory to some tens of megabytes.
_AT_ONCE = 256
# Values of marked cells: wanted, and opaque.
_WANTED, _OPAQUE = 1, 2


@dataclass(frozen=True, slots=True)
class ViewSector:
    """View of a camera that looks ahead.

    Attributes:
        near_m, far_m: distances from the axle of the nearest floor that it sees, and of the farthest that counts.
        half_rad: half of its field of view.
    """

    near_m: float
    far_m: float
    half_rad: float

    def gains_m2(self, marked: ByteArray, resolution_m: float, cells: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the area of wanted floor that is visible from places, in all directions.

        Args:
            marked: (H, W) of `marks`.
            cells: (P, 2) row and column; .5 is the centre of a cell.

        Returns:
            Gains (P, R) in m², and their headings (R,).
        """
        turn = 2 * np.pi / _RAYS
        headings: FloatArray = np.linspace(-np.pi, np.pi, _RAYS, endpoint=False)
        along_m = self._along_m(resolution_m)
        area = np.where(along_m >= self.near_m, along_m * resolution_m * turn, 0.0)
        places = np.asarray(cells, float)
        chunks = (places[k : k + _AT_ONCE] for k in range(0, len(places), _AT_ONCE))
        by_ray = [_is_seen(marked, resolution_m, some, headings, along_m) @ area for some in chunks]
        gain = np.concatenate([np.zeros((0, _RAYS)), *by_ray])
        # Each ray stands for a sector around it, so the outermost ones count in part.
        whole = int(self.half_rad / turn - 0.5)
        rest = min(self.half_rad / turn - 0.5 - whole, 1.0)
        shares = dict.fromkeys(range(-whole, whole + 1), 1.0) | {whole + 1: rest, -whole - 1: rest}
        return np.sum([share * np.roll(gain, k, axis=1) for k, share in shares.items()], axis=0), headings

    def seen(self, marked: ByteArray, resolution_m: float, cell: FloatArray, heading_rad: float) -> IntArray:
        """Return (N, 2) row and column of the wanted cells that are visible from a place (2,) in one direction."""
        count = 2 + int(2 * self.half_rad * self.far_m / resolution_m)
        headings = heading_rad + np.linspace(-self.half_rad, self.half_rad, count)
        along_m = self._along_m(resolution_m)
        is_seen = _is_seen(marked, resolution_m, np.asarray(cell, float)[None], headings, along_m)[0]
        ray, step = np.nonzero(is_seen & (along_m >= self.near_m))
        cells = _cells_along(cell, headings[ray], along_m[step] / resolution_m)
        flat = np.unique(cells @ (marked.shape[1], 1))  # rows of two sort ten times as slowly
        return np.stack(np.divmod(flat, marked.shape[1]), axis=-1)

    def _along_m(self, resolution_m: float) -> FloatArray:
        """Return (S,) distances of the samples along a ray."""
        return np.arange(0.5 * resolution_m, self.far_m, resolution_m)


def marks(is_clear: BoolArray, is_wanted: BoolArray) -> ByteArray:
    """Return (H, W) marked cells for `ViewSector`: wanted ones, and opaque ones, which hide what is behind them."""
    return np.where(is_clear, np.where(is_wanted, _WANTED, 0), _OPAQUE).astype(np.uint8)


def _is_seen(
    marked: ByteArray, resolution_m: float, cells: FloatArray, headings: FloatArray, along_m: FloatArray
) -> BoolArray:
    """Return (P, R, S) whether a sample is wanted and visible; beyond the edges it is neither wanted nor opaque."""
    at = _cells_along(cells[:, None, None], headings[:, None], along_m / resolution_m)
    inside = ((at >= 0) & (at < marked.shape)).all(axis=-1)
    at[~inside] = 0
    met = np.where(inside, marked[at[..., 0], at[..., 1]], 0)
    is_hidden = np.maximum.accumulate(met == _OPAQUE, axis=-1)
    return np.asarray((met == _WANTED) & ~is_hidden)


def _cells_along(cells: ArrayLike, headings: FloatArray, steps: FloatArray) -> IntArray:
    """Return (..., 2) row and column at distances in cells from places, in directions."""
    ways = np.stack(np.broadcast_arrays(steps * np.sin(headings), steps * np.cos(headings)), axis=-1)
    return np.asarray(np.floor(np.asarray(cells, float) + ways), np.int64)
