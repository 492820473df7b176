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

# Spacing of the places that are candidates.
_APART_M = 0.25
# Least width of unseen floor that is worth a look: a robot needs as much. Least unseen floor of a viewpoint, a third of
# a wheelchair's area (found on the simulator alone: docs/decisions/planner).
_LEAST_M, _LEAST_M2 = 0.6, 0.2
# Largest distance at which floor counts as visible: a Kinect's floor is rough beyond.
FAR_M = 3.5
# A viewpoint's value is the floor that it shows over its time, as a way at 0.3 m/s: a radian of turn takes 2 s, over
# floor that was not seen lately, and a stop with a choice 3 s. On ideal robots the flat takes 425 s with it, and 586 s
# with a discount by distance (docs/decisions/planner).
_STOP_M, _TURN_M = 1.0, 0.6
# Least value of another viewpoint, as a factor of that of the present one, for which the robot turns to it.
_STAYS = 1.5
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

    The value of a view is the unseen floor that it shows for each second that it takes (cf. González-Baños and Latombe
    2002). The robot stays with a view until another one is clearly better, and drives on once it has seen its floor.
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
        """Return the viewpoint with the highest value; None if none shows enough."""
        # Reachable cells (P, 2) near wanted floor, and path costs (P,) of the inscribed circle to them.
        row, column = costmap.cells_at(pose[:2]).tolist()
        metre = np.where(costmap.distance_m >= self._least_m, 1 + costmap.cost, np.inf).astype(np.float32)
        metre[row, column] = 1.0
        all_ways_m = cost_to_go(metre, costmap.resolution_m, (row, column))
        is_close = distances_m(is_wanted, costmap.resolution_m) <= self._sight.far_m
        step = max(1, round(_APART_M / costmap.resolution_m))
        is_asked = np.zeros(is_wanted.shape, bool)
        is_asked[row % step :: step, column % step :: step] = True
        cells = np.argwhere(np.isfinite(all_ways_m) & is_close & is_asked)
        ways_m = all_ways_m[cells[:, 0], cells[:, 1]]
        is_clear = self._is_about(self._is_wide(costmap.state, costmap.resolution_m), costmap.resolution_m)
        marked = marks(is_clear, is_wanted)
        gains, headings = self._sight.gains_m2(marked, costmap.resolution_m, np.asarray(cells + 0.5, float))
        worth = np.zeros_like(gains)
        shows = gains >= _LEAST_M2
        place, heading = np.nonzero(shows)
        poses = np.column_stack([costmap.middle_of(cells[place]), headings[heading]])
        value = gains[shows] / (_STOP_M + ways_m[place] + _TURN_M * _turns_rad(pose, poses))
        is_visited = np.zeros(len(poses), bool)
        for looked in self._looked:
            is_near = np.hypot(*(poses[:, :2] - looked[:2]).T) < _SAME_M
            is_visited |= is_near & (np.cos(poses[:, 2] - looked[2]) > np.cos(_SAME_RAD))
        for missed in self._missed:
            is_visited |= np.hypot(*(poses[:, :2] - missed[:2]).T) < _SAME_M
        # Whether circles along the outline's centre line fit: a fast test for walls.
        radius_m, along_x = self._footprint.inscribed_m, self._footprint.corners[:, 0]
        low, high = along_x.min() + radius_m, along_x.max() - radius_m
        fits = np.ones(len(poses), bool)
        for along_m in np.linspace(low, max(low, high), 1 + math.ceil(max(high - low, 0.0) / radius_m)):
            middles = poses[:, :2] + along_m * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
            at = np.clip(costmap.cells_at(middles), 0, np.array(costmap.state.shape) - 1)
            fits &= costmap.distance_m[at[:, 0], at[:, 1]] >= self._least_m
        worth[shows] = np.where(fits & ~is_visited, value, 0.0)
        if not worth.any():
            return None
        # The robot stays with its viewpoint until another one is clearly better: two doors alike let it go to and fro.
        aim = self._aim
        if aim is not None:
            (row, column), left = costmap.cells_at(aim.view[:2]), self._seen_from(aim.view, costmap, is_wanted)
            inside = 0 <= row < all_ways_m.shape[0] and 0 <= column < all_ways_m.shape[1]
            way_m = float(all_ways_m[row, column]) if inside else np.inf
            gain = len(left) * costmap.resolution_m**2
            kept = gain / (_STOP_M + way_m + _TURN_M * _turns_rad(pose, aim.view[None])[0])
            if gain >= _LEAST_M2 and _STAYS * kept >= worth.max():
                return aim
        best, heading_of = np.unravel_index(int(worth.argmax()), worth.shape)
        view = np.array([*costmap.middle_of(cells[best]), headings[heading_of]])
        return _Viewpoint(view, len(self._seen_from(view, costmap, costmap.is_unseen)))

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
        return np.unique(_cells_along(cell, headings[ray], along_m[step] / resolution_m), axis=0)

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
