"""Exploration: goals from which a robot sees floor that nobody has seen, until none is left that it can reach.

Borders between free and unknown floor are looked at one after another (Yamauchi 1997), the nearest and widest first.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from wheelsight.geometry import BoolArray, FloatArray, IntArray
from wheelsight.geometry.se2 import wrap_angle
from wheelsight.navigation.costmap import CellState, Costmap, StaticLayer
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.grid_search import cost_to_go
from wheelsight.navigation.navigator_settings import NavigationSettings

# As many places, the cheapest to reach, are asked whether they see a border.
_MOST_PLACES = 80


@dataclass(frozen=True, slots=True, eq=False)
class Frontier:
    """A border between free and unknown floor.

    Attributes:
        middle: (2,) the cell of it next to its middle, metres in the map.
        size_m: its width.
    """

    middle: FloatArray
    size_m: float


class Exploration:
    """The `Goals` of a robot that explores.

    Args:
        footprint, settings: of the robot.
        near_m: from the axle, the nearest floor that its camera sees.
    """

    def __init__(self, footprint: Footprint, settings: NavigationSettings, near_m: float) -> None:
        self._footprint, self._settings, self._near_m = footprint, settings, near_m
        self._looked: list[FloatArray] = []
        self._views: list[FloatArray] = []  # (3,) from where it looked; a yaw of NaN is all around
        # Middle of a border, and from where it is looked at: of the plan that is driven, and of the one to come.
        self._aim: tuple[FloatArray, FloatArray] | None = None
        self._next: tuple[FloatArray, FloatArray] | None = None
        self._turns = settings.exploration.turns
        self.left = 1
        self.name = "explore"

    def upcoming(self, pose: FloatArray, costmap: Costmap) -> tuple[FloatArray, ...]:
        """See `Goals`: first once around, then the border that is worth most."""
        if self._turns > 0:
            step = 2 * np.pi / self._settings.exploration.turns
            self._next = pose[:2], np.array([pose[0], pose[1], np.nan])
            return (np.array([pose[0], pose[1], wrap_angle(pose[2] + step)]),)
        free_m = self._ways_m(pose, costmap)
        found = [one for one in frontiers(costmap, self._settings.exploration.least_m) if not self._is_done(one)]
        views = [(one, self._view(one, free_m, costmap)) for one in found]
        worth = [(self._cost(one, view, free_m, costmap, pose), one, view) for one, view in views if view is not None]
        self.left = len(worth)
        if not worth:
            return ()
        _, best, view = min(worth, key=lambda item: item[0])
        assert view is not None
        self._next = best.middle, view
        return (view,)

    def is_met(self, pose: FloatArray, layer: StaticLayer) -> bool:
        """See `Goals`: a border was looked at from near enough, or is none any more."""
        if self._turns > 0 or self._aim is None:
            return False
        border, view = self._aim
        s = self._settings.exploration
        is_near = np.hypot(*(view[:2] - pose[:2])) <= s.there_m and np.cos(view[2] - pose[2]) >= np.cos(s.there_rad)
        return bool(is_near or not _is_border(layer, border, s.least_m / 2))

    def taken(self) -> None:
        """See `Goals`."""
        self._aim = self._next

    def reached(self) -> None:
        """See `Goals`."""
        if self._aim is not None:
            self._views.append(self._aim[1])
        if self._turns > 0:
            self._turns -= 1
        elif self._aim is not None:
            self._looked.append(self._aim[0])

    def missed(self) -> bool:
        """See `Goals`: there are others, and another view of the same."""
        if self._turns > 0:
            self._turns = 0
        elif self._aim is not None:
            self._looked.append(self._aim[0])
            self._views.append(self._aim[1])
        return True

    def _is_done(self, frontier: Frontier) -> bool:
        s = self._settings.exploration
        near = [looked for looked in self._looked if np.hypot(*(looked - frontier.middle)) < s.same_m]
        return len(near) >= s.tries

    def _ways_m(self, pose: FloatArray, costmap: Costmap) -> FloatArray:
        """(H, W) what ways to each cell cost, of the circle within the outline; infinite where none leads."""
        least_m = self._footprint.inscribed_m + self._settings.planner.margin_m
        metre = np.where(costmap.distance_m >= least_m, 1 + costmap.cost, np.inf).astype(np.float32)
        row, column = costmap.cells_at(pose[:2]).tolist()
        metre[row, column] = 1.0
        return cost_to_go(metre, costmap.resolution_m, (row, column))

    def _view(self, frontier: Frontier, ways_m: FloatArray, costmap: Costmap) -> FloatArray | None:
        """(3,) the cheapest place from which the camera sees a border, or else next to it; None: none is reached."""
        cells = np.argwhere(np.isfinite(ways_m))
        apart_m = np.hypot(*(costmap.middle_of(cells) - frontier.middle).T)
        in_sight = (apart_m >= self._near_m) & (apart_m <= self._settings.exploration.far_m)
        for group in (cells[in_sight], cells[apart_m < self._near_m]):
            order = np.argsort(ways_m[group[:, 0], group[:, 1]])[:_MOST_PLACES]
            for cell in group[order]:
                xy = costmap.middle_of(cell)
                away = frontier.middle - xy
                view = np.array([*xy, np.arctan2(away[1], away[0])])
                if not self._is_old(view) and _sees(costmap, xy, frontier.middle):
                    return view
        return None

    def _is_old(self, view: FloatArray) -> bool:
        """Whether it looked from there before, in that direction."""
        s = self._settings.exploration
        near = [old for old in self._views if np.hypot(*(old[:2] - view[:2])) < s.same_m]
        return any(np.isnan(old[2]) or np.cos(old[2] - view[2]) > np.cos(s.same_rad) for old in near)

    def _cost(
        self, frontier: Frontier, view: FloatArray, ways_m: FloatArray, costmap: Costmap, pose: FloatArray
    ) -> float:
        s = self._settings.exploration
        row, column = costmap.cells_at(view[:2]).tolist()
        turn_rad = abs(float(wrap_angle(view[2] - pose[2])))
        return float(ways_m[row, column]) + s.turn_m * turn_rad - s.gain * frontier.size_m


def frontiers(costmap: Costmap, least_m: float) -> list[Frontier]:
    """Borders between free and unknown floor, of at least so many metres."""
    is_free, is_unknown = costmap.state == CellState.FREE, costmap.state == CellState.UNKNOWN
    beside = cv2.dilate(is_unknown.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    is_border = is_free & beside
    count, labels = cv2.connectedComponents(is_border.astype(np.uint8), connectivity=8)
    return [one for label in range(1, count) if (one := _frontier(labels == label, costmap)).size_m >= least_m]


def _frontier(is_part: BoolArray, costmap: Costmap) -> Frontier:
    cells: IntArray = np.argwhere(is_part)
    places = costmap.middle_of(cells)
    middle = places[np.hypot(*(places - places.mean(axis=0)).T).argmin()]
    extent = places.max(axis=0) - places.min(axis=0) + costmap.resolution_m
    return Frontier(middle, float(np.hypot(*extent)))


def _is_border(layer: StaticLayer, xy: FloatArray, reach_m: float) -> bool:
    """Whether there is floor so near to a place that nobody has seen; beyond a map's edges nobody has."""
    reach = int(np.ceil(reach_m / layer.resolution_m))
    column, row = np.floor((xy - layer.origin) / layer.resolution_m).astype(int).tolist()
    about = layer.state[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
    return bool(about.size < (2 * reach + 1) ** 2 or (about == CellState.UNKNOWN).any())


def _sees(costmap: Costmap, xy: FloatArray, to: FloatArray) -> bool:
    """Whether nothing that is known stands between."""
    steps = int(np.ceil(2 * np.hypot(*(to - xy)) / costmap.resolution_m)) + 1
    cells = costmap.cells_at(xy + np.linspace(0, 1, steps)[:, None] * (to - xy))
    return not bool((costmap.state[cells[:, 0], cells[:, 1]] == CellState.OCCUPIED).any())
