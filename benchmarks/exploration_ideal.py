"""`python -m benchmarks.exploration_ideal`: the same flats by a robot that senses and drives without error.

It has the views that `navigation.Exploration` chooses, and nothing else of the navigator: it goes there by the cheapest
way for the circle within its outline, heading along it, sees floor and walls exactly, and stands wherever it wants to.
Hence seconds in place of a quarter of an hour, for comparing how views are chosen; what comes of them,
`benchmarks.exploration` shows. Things hide what is behind them, however low they are.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.exploration import FOUR_FLATS
from benchmarks.exploration_truth import CELL_M, TruePlan, tour_m
from benchmarks.sequences import default_data_folder
from benchmarks.sessions import buildings_of
from benchmarks.table import Sheet
from wheelsight.config import load_config
from wheelsight.core.geometry import FloatArray, IntArray
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.navigation import Costmap, Exploration, NavigationSettings, StaticLayer, planar_pose
from wheelsight.navigation.costmap import CellState
from wheelsight.navigation.exploration import TURNS, ViewSector
from wheelsight.navigation.planner import cost_to_go
from wheelsight_sim import SimulationSettings
from wheelsight_sim.physics import start_of
from wheelsight_sim.simulate import world_of

CAMERA_M, WALLS_FROM_M, HALF_RAD = 0.9, 0.3, 0.5
# A Kinect on the chair sees floor from here on, and the map takes depth up to there.
SIGHT = ViewSector(2.3, 5.0, HALF_RAD)
_RAYS, _ALONG_M, _STEP_CELLS, _TURN_RAD = 160, 0.025, 4, 0.15
_NEIGHBOURS = np.array([(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if r or c])
_MOST_VIEWS = 200


@dataclass(frozen=True)
class Found:
    """Share of reachable floor in percent, metres driven, radians turned, and how many views it took."""

    share_percent: float
    way_m: float
    turn_rad: float
    views: int


class IdealRobot:
    """What it has seen, (H, W) of `CellState` in the cells of a true plan, and where it is."""

    def __init__(self, plan: TruePlan, start: FloatArray, settings: NavigationSettings) -> None:
        self._plan, self._settings, self.pose = plan, settings, start.astype(float)
        self.state = np.full(plan.is_taken.shape, CellState.UNKNOWN, np.uint8)
        cells = np.moveaxis(np.indices(self.state.shape), 0, -1)
        self._middles = plan.middle_of(cells)
        self._is_reported = np.hypot(*np.moveaxis(self._middles - start[:2], -1, 0)) < SIGHT.near_m
        self.way_m = self.turn_rad = 0.0
        self._look()

    @property
    def layer(self) -> StaticLayer:
        """As a floor that grows: what it saw and stood on, and what somebody said of the floor about its start."""
        speed = np.full(self.state.shape, np.inf, np.float32)
        layer = StaticLayer(self.state.copy(), speed, CELL_M, self._plan.origin)
        return layer.with_floor(self._is_reported & ~self._plan.is_taken, is_assumed=True)

    @property
    def costmap(self) -> Costmap:
        """Of it."""
        return Costmap.of(self.layer, self._plan.footprint, self._settings.costmap)

    def turn_to(self, yaw: float) -> None:
        """On the spot, looking on the way."""
        turn = float(wrap_angle(yaw - self.pose[2]))
        steps = max(1, int(abs(turn) / _TURN_RAD))
        for _ in range(steps):
            self.pose[2] += turn / steps
            self._look()
        self.turn_rad += abs(turn)

    def go(self, view: FloatArray, exploration: Exploration) -> bool:
        """To a view, or until it is needless; whether a way leads there."""
        cells = self._cells_to(view)
        if cells is None:
            return False
        for cell in [*cells[_STEP_CELLS::_STEP_CELLS], cells[-1]]:
            away = self._plan.middle_of(cell) - self.pose[:2]
            if np.hypot(*away) > CELL_M:
                self.turn_to(float(np.arctan2(away[1], away[0])))
            self.pose[:2] += away
            self.way_m += float(np.hypot(*away))
            self._look()
            if exploration.is_met(self.pose.copy(), self.layer):
                return True
        self.turn_to(float(view[2]))
        exploration.is_met(self.pose.copy(), self.layer)
        return True

    def _cells_to(self, view: FloatArray) -> IntArray | None:
        costmap = self.costmap
        least_m = self._plan.footprint.inscribed_m + self._plan.margin_m
        metre = np.where(costmap.distance_m >= least_m, 1 + costmap.cost, np.inf).astype(np.float32)
        here, there = (costmap.cells_at(at[:2]) for at in (self.pose, view))
        metre[tuple(here)] = metre[tuple(there)] = 1.0
        to_go = cost_to_go(metre, CELL_M, (int(there[0]), int(there[1])))
        if not np.isfinite(to_go[tuple(here)]):
            return None
        cells = [here]
        while (cells[-1] != there).any():
            beside = cells[-1] + _NEIGHBOURS
            cells.append(beside[to_go[beside[:, 0], beside[:, 1]].argmin()])
        return np.array(cells)

    def _look(self) -> None:
        """See along all rays, and stand on what is below."""
        bearings = self.pose[2] + np.linspace(-SIGHT.half_rad, SIGHT.half_rad, _RAYS)
        along_m = np.arange(WALLS_FROM_M, SIGHT.far_m, _ALONG_M)
        ways = np.stack([np.cos(bearings)[:, None] * along_m, np.sin(bearings)[:, None] * along_m], axis=-1)
        at = np.clip(self._plan.cells_at(self.pose[:2] + ways), 0, np.array(self.state.shape) - 1)
        is_taken = self._plan.is_taken[at[..., 0], at[..., 1]]
        is_past = np.maximum.accumulate(is_taken, axis=1)
        is_first = is_taken & ~np.pad(is_past[:, :-1], ((0, 0), (1, 0)))
        for is_so, kind in ((~is_past & (along_m >= SIGHT.near_m), CellState.FREE), (is_first, CellState.OCCUPIED)):
            self.state[at[is_so][:, 0], at[is_so][:, 1]] = kind
        row, column = self._plan.cells_at(self.pose[:2]).tolist()
        reach = round(1.0 / CELL_M)
        cut = slice(max(row - reach, 0), row + reach), slice(max(column - reach, 0), column + reach)
        c, s = np.cos(self.pose[2]), np.sin(self.pose[2])
        away = (self._middles[cut] - self.pose[:2]) @ np.array([[c, -s], [s, c]])
        stood = self._plan.footprint.contains(away) & (self.state[cut] == CellState.UNKNOWN)
        self.state[cut][stood] = CellState.FREE


def explored(plan: TruePlan, start: FloatArray, settings: NavigationSettings) -> Found:
    """Until no view is left that is worth its way."""
    robot, exploration = (
        IdealRobot(plan, start, settings),
        Exploration(plan.footprint, settings.planner.margin_m, SIGHT.near_m, HALF_RAD),
    )
    views, turns = 0, TURNS
    while views < _MOST_VIEWS and (ahead := exploration.upcoming(robot.pose.copy(), robot.costmap)):
        exploration.taken()
        views += 1
        if views <= turns:
            robot.turn_to(float(ahead[0][2]))
            exploration.is_met(robot.pose.copy(), robot.layer)
            exploration.reached()
        elif robot.go(ahead[0], exploration):
            exploration.reached()
        else:
            exploration.missed()
    is_reachable = plan.covered(plan.reached(start))
    share = np.count_nonzero(is_reachable & (robot.state == CellState.FREE)) / np.count_nonzero(is_reachable)
    return Found(100 * share, robot.way_m, robot.turn_rad, views)


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.exploration_ideal", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with maps/PLAN in it")
    parser.add_argument("--flats", nargs="+", default=list(FOUR_FLATS), help="plans, or worlds: studio, flat")
    parser.add_argument("--seed", type=int, default=1, help="of worlds")
    asked = parser.parse_args()
    navigation = load_config().navigation
    margin_m = max(navigation.planner.margin_m, navigation.follow.margin_m)
    rows = []
    for building in buildings_of(asked.flats, asked.data, 40.0):
        world = world_of(SimulationSettings(seed=asked.seed, **building.where))
        start = planar_pose(start_of(world))
        plan = TruePlan.of(world, navigation.footprint.outline, margin_m, CAMERA_M)
        found, way_m = explored(plan, start, navigation), tour_m(plan, plan.reached(start), start, SIGHT, 0.97)
        figures = f"{found.share_percent:.1f} %", f"{found.way_m:.1f}", f"{way_m:.1f}", f"{found.way_m / way_m:.2f}"
        rows.append((building.name, *figures, f"{found.turn_rad:.0f}", str(found.views)))
    header = ("flat", "seen", "way m", "tour m", "tours", "turned rad", "views")
    Console(width=120).print(Sheet("Explored without error", header, tuple(rows)).to_rich())


if __name__ == "__main__":
    main()
