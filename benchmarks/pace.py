"""`python -m benchmarks.pace`: where the time of a drive goes, in floor plans of real buildings.

A wheelchair's base (lag, limits of acceleration) drives in a plan with the navigator of `wheelsight drive`: planner,
MPPI, collision monitor, costmap of a small depth camera (64×48, 63° × 50°, 10 images a second) that sees the floor from
2.3 m on, as a level Kinect on a chair does. Its localization is true and nothing is rendered but walls, so a minute
takes seconds; `benchmarks.navigation` and `benchmarks.exploration` have real sensors and our own localization.

Goals are random poses in the known plan, one drive each from the last one. "Times" is the time over that of the first
plan's length at 0.7 m/s. With `--explore` the robot begins without a map. "Seen" is the share of reachable floor (as in
`benchmarks.exploration`) that it calls free at the end, "tours" its way over that of a short tour which knows the plan.
Each control period has one cause (`time_cause`), the first that applies.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.exploration_ideal import CAMERA_M, SIGHT
from benchmarks.exploration_truth import CELL_M, TruePlan, tour_m
from benchmarks.navigation_page import write_section
from benchmarks.plain_rooms import CAMERA, EYE, DepthEye, RoomRobot
from benchmarks.sequences import default_data_folder
from benchmarks.sessions import buildings_of
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target
from wheelsight.app.run.drive_record import time_cause
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import Event
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import (
    Costmap,
    Footprint,
    KnownFloor,
    NavigationSettings,
    Navigator,
    Plan,
    Planner,
    PlannerSettings,
    StaticLayer,
    planar_pose,
)
from wheelsight.navigation.costmap import CellState
from wheelsight.navigation.path_smoothing import Drivable
from wheelsight_sim import SimulationSettings
from wheelsight_sim.physics import start_of
from wheelsight_sim.robot import RobotModel
from wheelsight_sim.simulate import world_of

PACE_M_S, TIMES, MEAN_M_S, TOURS, SHARE_PERCENT = 0.7, 1.6, 0.25, 1.8, 97.0
FLATS = ("studio", "flat", "map_real.yaml", "indoor.yaml")
_MOUNT = RobotModel(camera_height_m=CAMERA_M, camera_forward_m=0.35, camera_pitch_rad=0.0).T_base_camera
_LONGEST_S, _STEP_M, _SPARE_M = 900.0, 0.02, 0.15
_TITLE = "A walking pace"


class PlanWalls:
    """Walls from floor to ceiling in the cells of a true plan, as `plain_rooms.RoomRobot` needs them."""

    def __init__(self, plan: TruePlan) -> None:
        self._plan = plan
        free = (~plan.is_taken).astype(np.uint8)
        self._distance_m = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * CELL_M

    def depth_m(self, T_map_camera: FloatArray, eye: DepthEye = EYE) -> FloatArray:
        """(h, w) of walls and floor, 0 beyond what the camera senses."""
        rays = eye.camera.rays()
        across = rays[rays.shape[0] // 2, :, 0]
        bearings = np.arctan2(T_map_camera[1, 2], T_map_camera[0, 2]) - np.arctan(across)
        along_m = np.arange(_STEP_M, eye.senses_m[1] * 1.3, _STEP_M)
        ways = np.stack([np.cos(bearings)[:, None] * along_m, np.sin(bearings)[:, None] * along_m], axis=-1)
        at = np.clip(self._plan.cells_at(T_map_camera[:2, 3] + ways), 0, np.array(self._plan.is_taken.shape) - 1)
        is_hit = self._plan.is_taken[at[..., 0], at[..., 1]]
        wall_m = np.where(is_hit.any(axis=1), along_m[is_hit.argmax(axis=1)], np.inf) * np.cos(np.arctan(across))
        with np.errstate(divide="ignore"):
            floor_m = np.where(rays[..., 1] > 0, T_map_camera[2, 3] / rays[..., 1], np.inf)
        depth = np.minimum(floor_m, wall_m[None])
        return np.where((depth >= eye.senses_m[0]) & (depth <= eye.senses_m[1]), depth, 0.0)

    def clearance_m(self, corners: FloatArray) -> float:
        """From an outline's sides to the nearest taken cell, to within a cell."""
        sides = [
            a + np.linspace(0, 1, 30)[:, None] * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)
        ]
        at = np.clip(self._plan.cells_at(np.concatenate(sides)), 0, np.array(self._distance_m.shape) - 1)
        return max(float(self._distance_m[at[:, 0], at[:, 1]].min()) - CELL_M / 2, 0.0)


class TrueLocalization:
    """A localization that knows the true pose."""

    keyframes, recognised, warnings = None, None, ()

    def __init__(self, robot: RoomRobot) -> None:
        self._robot = robot

    def process(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        """See `Localization`."""
        C, T = 1e-6 * np.eye(6), self._robot.T_map_base
        return [(event, Estimate(event.stamp_s, Status.TRACKING, T, C, body="base")) for event in events]

    def close(self) -> None:
        """See `Localization`."""


class SeenSoFar:
    """A floor that grows by what an ideal camera sees and by what the robot stands on."""

    is_fixed = has_keep_out = False
    driven: FloatArray = np.empty((0, 2))

    def __init__(self, plan: TruePlan, footprint: Footprint, start: FloatArray) -> None:
        self._plan, self._footprint, self.revision = plan, footprint, 0
        self._pose: FloatArray | None = None
        self._state = np.full(plan.is_taken.shape, CellState.UNKNOWN, np.uint8)
        cells = np.moveaxis(np.indices(self._state.shape), 0, -1)
        near = np.hypot(*np.moveaxis(plan.middle_of(cells) - start[:2], -1, 0)) < SIGHT.near_m
        self._is_reported = near & ~plan.is_taken
        self._stood = np.zeros(self._state.shape, bool)
        self.layer = self._layer()

    def update(self, pose: FloatArray | None, now_s: float) -> None:
        """See `KnownFloor`."""
        if pose is None or (self._pose is not None and np.abs(pose - self._pose).max() < 0.04):
            return
        self._pose, self.revision = pose.copy(), self.revision + 1
        along_m = np.arange(0.3, SIGHT.far_m, CELL_M / 2)
        bearings = pose[2] + np.linspace(-SIGHT.half_rad, SIGHT.half_rad, 200)
        ways = np.stack([np.cos(bearings)[:, None] * along_m, np.sin(bearings)[:, None] * along_m], axis=-1)
        at = np.clip(self._plan.cells_at(pose[:2] + ways), 0, np.array(self._state.shape) - 1)
        is_taken = self._plan.is_taken[at[..., 0], at[..., 1]]
        is_past = np.maximum.accumulate(is_taken, axis=1)
        first = is_taken & ~np.pad(is_past[:, :-1], ((0, 0), (1, 0)))
        for is_so, kind in ((~is_past & (along_m >= SIGHT.near_m), CellState.FREE), (first, CellState.OCCUPIED)):
            self._state[at[is_so][:, 0], at[is_so][:, 1]] = kind
        corners = (self._footprint.padded(0.05).at(pose) - self._plan.origin) / CELL_M
        stood = np.zeros(self._state.shape, np.uint8)
        cv2.fillConvexPoly(stood, np.rint(corners - 0.5).astype(np.int32), 1)
        self._stood |= (stood > 0) & ~self._plan.is_taken
        self.layer = self._layer()

    def is_silent(self, now_s: float) -> bool:
        """See `KnownFloor`."""
        return False

    def _layer(self) -> StaticLayer:
        state = np.where(self._stood & (self._state == CellState.UNKNOWN), CellState.FREE, self._state).astype(np.uint8)
        layer = StaticLayer(state, np.full(state.shape, np.inf, np.float32), CELL_M, self._plan.origin)
        return layer.with_floor(self._is_reported, is_assumed=True)


@dataclass
class Pace:
    """What a drive took."""

    name: str
    time_s: float = 0.0
    way_m: float = 0.0
    planned_m: float = 0.0
    clearance_m: float = np.inf
    ended: str = ""
    spent_s: dict[str, float] = field(default_factory=dict)
    seen_percent: float = np.nan
    tour_m: float = np.nan

    def row(self) -> tuple[str, ...]:
        """As `_HEADER` has it."""
        causes = sorted(self.spent_s.items(), key=lambda one: -one[1])
        shares = ", ".join(f"{100 * s / self.time_s:.0f} % {cause}" for cause, s in causes if s > 0.02 * self.time_s)
        times = self.time_s / (self.planned_m / PACE_M_S) if self.planned_m else np.nan
        return (
            self.name,
            f"{self.time_s:.0f}",
            f"{self.way_m:.1f}",
            f"{self.way_m / max(self.time_s, 1e-9):.2f}",
            f"{times:.2f}" if np.isfinite(times) else "—",
            f"{self.seen_percent:.1f}" if np.isfinite(self.seen_percent) else "—",
            f"{self.way_m / self.tour_m:.2f}" if np.isfinite(self.tour_m) else "—",
            f"{self.clearance_m:.2f}",
            self.ended or "arrived",
            shares,
        )


_HEADER = ("drive", "s", "way m", "m/s", "times", "seen %", "tours", "clearance m", "ended", "time")


def _driven(navigator: Navigator, robot: RoomRobot, name: str) -> Pace:
    """Step until the task is complete."""
    pace, begin_s, footprint = Pace(name), robot.now_s, navigator.footprint
    before = robot.base.pose[:2].copy()
    while not navigator.is_task_complete() and robot.now_s - begin_s < _LONGEST_S:
        feedback = navigator.step()
        cause = str(time_cause(feedback, navigator.settings.limits))
        pace.spent_s[cause] = pace.spent_s.get(cause, 0.0) + 0.05
        pace.way_m += float(np.hypot(*(robot.base.pose[:2] - before)))
        before = robot.base.pose[:2].copy()
        pace.clearance_m = min(pace.clearance_m, robot.walls.clearance_m(footprint.at(robot.base.pose)))
    pace.time_s, result = robot.now_s - begin_s, navigator.result
    pace.planned_m = 0.0 if result is None else result.planned_m
    pace.ended = "took too long" if result is None else "" if result else f"{result.reason}: {result.detail}"
    return pace


def paces_in(plan: TruePlan, name: str, start: FloatArray, goals: int, seed: int, explores: bool) -> list[Pace]:
    """Drives in a plan: to goals one after another, or an exploration."""
    settings = NavigationSettings()
    robot = RoomRobot(PlanWalls(plan), tuple(start.tolist()), DepthEye(CAMERA, _MOUNT))
    kind = np.where(plan.is_taken, CellKind.OBSTACLE, CellKind.FREE).astype(np.uint8)
    grid = OccupancyGrid.of_kinds(kind, kind == CellKind.FREE, CELL_M, plan.origin)
    outline = settings.footprint.outline
    floor = SeenSoFar(plan, outline, start) if explores else KnownFloor(grid, footprint=outline)
    navigator = Navigator(robot, TrueLocalization(robot), floor, settings, trusts_floor=True)  # type: ignore[arg-type]
    if explores:
        navigator.explore()
        pace = _driven(navigator, robot, f"{name}, explored")
        is_reachable = plan.covered(plan.reached(start))
        is_free = is_reachable & (floor.layer.state == CellState.FREE)
        pace.seen_percent = 100 * np.count_nonzero(is_free) / np.count_nonzero(is_reachable)
        pace.tour_m = tour_m(plan, plan.reached(start), start, SIGHT, SHARE_PERCENT / 100)
        pace.planned_m = 0.0
        return [pace]
    rng, costmap = np.random.default_rng(seed), Costmap.of(StaticLayer.of(grid), outline)
    planner, done, here = Planner(outline, settings.drivable, settings.limits), list[Pace](), start
    # Floor that is joined with the start, and goals at which the outline has room to spare.
    is_room = (costmap.distance_m > outline.inscribed_m + settings.drivable.margin_m).astype(np.uint8)
    labels = cv2.connectedComponents(is_room, connectivity=4)[1]
    cells = np.argwhere(labels == labels[tuple(costmap.cells_at(start[:2]))])
    roomy = Drivable.of(costmap, outline, PlannerSettings(margin_m=_SPARE_M, wanted_margin_m=_SPARE_M))
    while len(done) < goals:
        goal = np.array([*costmap.middle_of(cells[rng.integers(len(cells))]), rng.uniform(-np.pi, np.pi)])
        if not roomy.is_free(goal[None])[0]:
            continue
        if not isinstance(found := planner.plan(costmap, here, goal), Plan) or found.goal_change or found.length_m < 2:
            continue
        navigator.go_to_pose(goal)
        done.append(_driven(navigator, robot, f"{name}, goal {len(done) + 1}"))
        here = robot.base.pose.copy()
        print(done[-1].row(), flush=True)
    return done


def sheets_of(paces: Sequence[Pace], explores: bool) -> list[Sheet]:
    """All drives, where their time went together, and what must be reached."""
    together = Pace("all", sum(p.time_s for p in paces), sum(p.way_m for p in paces), sum(p.planned_m for p in paces))
    together.clearance_m = min(p.clearance_m for p in paces)
    for cause, seconds in ((cause, seconds) for pace in paces for cause, seconds in pace.spent_s.items()):
        together.spent_s[cause] = together.spent_s.get(cause, 0.0) + seconds
    ended = sum(not p.ended for p in paces)
    together.ended = f"{ended} of {len(paces)} arrived"
    mean_m_s, targets = together.way_m / together.time_s, []
    if explores:
        targets.append(Target("mean speed", MEAN_M_S, mean_m_s, "m/s", 2, is_least=True))
        targets.append(
            Target(
                "reachable floor seen, least", SHARE_PERCENT, min(p.seen_percent for p in paces), "%", 1, is_least=True
            )
        )
        targets.append(Target("way in tours, most", TOURS, max(p.way_m / p.tour_m for p in paces), "", 2))
    else:
        targets.append(Target("time over way / 0.7 m/s", TIMES, PACE_M_S * together.time_s / together.planned_m, "", 2))
    rows = (*(pace.row() for pace in paces), together.row())
    return [Sheet("Drives and where their time went", _HEADER, rows), targets_sheet(targets)]


def main(words: Sequence[str] | None = None) -> int:
    """Print all figures, and write them where asked to."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.pace", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with maps/PLAN in it")
    parser.add_argument("--flats", nargs="+", default=list(FLATS), help="plans, or worlds: studio, flat")
    parser.add_argument("--goals", type=int, default=5, help="a flat")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--explore", action="store_true", help="explore the flats instead")
    parser.add_argument("--out", type=Path, help="page whose section is written, docs/benchmarks/navigation.md")
    asked = parser.parse_args(words)
    settings, paces = NavigationSettings(), list[Pace]()
    margin_m = max(settings.planner.margin_m, settings.follow.margin_m)
    for building in buildings_of(asked.flats, asked.data, 40.0):
        world = world_of(SimulationSettings(seed=asked.seed, **building.where))
        plan = TruePlan.of(world, settings.footprint.outline, margin_m, CAMERA_M)
        paces += paces_in(plan, building.name, planar_pose(start_of(world)), asked.goals, asked.seed, asked.explore)
        print(paces[-1].row(), flush=True)
    sheets = sheets_of(paces, asked.explore)
    for sheet in sheets:
        Console(width=170).print(sheet.to_rich())
    if asked.out is not None:
        how = " --explore" if asked.explore else f" --goals {asked.goals}"
        command = f"`python -m benchmarks.pace --flats {' '.join(asked.flats)}{how} --seed {asked.seed}`"
        title = f"{_TITLE}: {'flats explored' if asked.explore else 'goals in empty buildings'}"
        write_section(asked.out, title, __doc__ or "", machine.description() | {"Command": command}, sheets)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
