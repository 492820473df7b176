"""A robot that drives to goals in a map of the day before, by its own localization; judged by the simulator's truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.session_starts import Building, FirstDay
from wheelsight.config import load_config
from wheelsight.errors import ConfigError
from wheelsight.geometry import FloatArray, se3
from wheelsight.geometry.se2 import wrap_angle
from wheelsight.localizer import Localizer, LocalizerInStep
from wheelsight.navigation import (
    Costmap,
    KnownFloor,
    NavigationResult,
    NavigationSettings,
    Navigator,
    Plan,
    Planner,
    planar_pose,
)
from wheelsight.pipeline.known_maps import open_known
from wheelsight.simulation import SimulationSettings
from wheelsight.simulation.simulator import Simulator
from wheelsight.slam.sessions import MapFolder, driven_way, occupancy_of

ARRIVED_M, ARRIVED_DEG = 0.15, 10.0
_LONGEST_S = 240.0
_HEADINGS = 8
_LEAST_WAY_M, _ROUND_M = 1.0, 0.05


@dataclass(frozen=True)
class Hardness:
    """What the second day has that the first had not: people, things in the way."""

    people: int = 0
    rate_hz: float = 10.0
    size: tuple[int, int] = (320, 240)


@dataclass(frozen=True, eq=False)
class Drive:
    """What became of a goal.

    Attributes:
        building: where.
        goal: (3,) in the map.
        result: as the navigator tells it; None where it took too long.
        off_m, off_deg: of the true pose from the goal, beside the map's nearest keyframe.
        shortest_m: the plan by the map alone; NaN without one.
        way_m: truly driven.
        clearance_m: least true distance from outline to things.
        contacts: what the robot touched by its own motion, in words.
        time_s: simulated.
    """

    building: str
    goal: FloatArray
    result: NavigationResult | None
    off_m: float
    off_deg: float
    shortest_m: float
    way_m: float
    clearance_m: float
    contacts: tuple[str, ...]
    time_s: float

    @property
    def has_arrived(self) -> bool:
        """Truly, and by what it says."""
        says = self.result is not None and self.result.has_arrived
        return says and self.off_m <= ARRIVED_M and self.off_deg <= ARRIVED_DEG

    @property
    def spl(self) -> float:
        """Success weighted by path length (Anderson et al. 2018)."""
        if not self.has_arrived or not self.shortest_m > 0:
            return 0.0
        return self.shortest_m / max(self.shortest_m, self.way_m)

    @property
    def sentence(self) -> str:
        """For the terminal."""
        what = "took too long" if self.result is None else (self.result.detail or "arrived")
        if self.has_arrived:
            what = "arrived"
        touched = f", touched {', '.join(self.contacts)}" if self.contacts else ""
        return (
            f"{self.building} ({self.goal[0]:.1f}, {self.goal[1]:.1f}): {what}, {self.off_m:.2f} m and"
            f" {self.off_deg:.0f}° off, {self.way_m:.1f} m for {self.shortest_m:.1f}, {self.time_s:.0f} s,"
            f" clearance {self.clearance_m:.2f} m{touched}"
        )


class KnownBuilding:
    """The map of the first day, as a navigator takes it."""

    def __init__(self, building: Building, day: FirstDay, settings: NavigationSettings) -> None:
        self.building, self.day, self.settings = building, day, settings
        with_folder = MapFolder.open(day.folder)
        self.footprint = settings.footprint.outline
        self.floor = KnownFloor(occupancy_of(with_folder), driven=driven_way(with_folder), footprint=self.footprint)
        with_folder.close()
        self.costmap = Costmap.of(self.floor.layer, self.footprint, settings.costmap)
        self._planner = Planner(self.footprint, settings.planner, settings.limits)

    def world_pose(self, pose: FloatArray) -> FloatArray:
        """(3,) where a pose of the map truly is, beside its nearest keyframe."""
        T_map = se3.from_plane(*pose)
        nearest = int(se3.view_shift_m(se3.invert(self.day.T_map_base) @ T_map).argmin())
        return planar_pose(self.day.T_world_base[nearest] @ se3.invert(self.day.T_map_base[nearest]) @ T_map)

    def map_pose(self, T_world_base: FloatArray) -> FloatArray:
        """(3,) in the map of a true pose (4, 4), beside its nearest keyframe."""
        nearest = int(se3.view_shift_m(se3.invert(self.day.T_world_base) @ T_world_base).argmin())
        return planar_pose(self.day.T_map_base[nearest] @ se3.invert(self.day.T_world_base[nearest]) @ T_world_base)

    def pose(self, rng: np.random.Generator, around_m: float = 0.0) -> FloatArray:
        """A pose at which the outline fits with the wanted margin, and with so much room about the axle."""
        least_m = max(self.footprint.inscribed_m + self.settings.planner.wanted_margin_m, around_m)
        cells = np.argwhere((self.costmap.distance_m > least_m) & ~self.costmap.is_lethal)
        while True:
            xy = self.costmap.middle_of(cells[rng.integers(len(cells))])
            yaws = rng.permutation(_HEADINGS) * 2 * np.pi / _HEADINGS - np.pi
            tries = np.column_stack([np.tile(xy, (_HEADINGS, 1)), yaws])
            free = np.flatnonzero(self._planner.has_room(self.costmap, tries))
            if len(free):
                return np.asarray(tries[free[0]])

    def goal_from(self, start: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, Plan]:
        """A goal that the map says can be reached from a pose, and the plan by the map alone."""
        while True:
            goal = self.pose(rng)
            plan = self._planner.plan(self.costmap, start, goal)
            if isinstance(plan, Plan) and not plan.goal_change and plan.length_m > _LEAST_WAY_M:
                return goal, plan


def drives_in(
    known: KnownBuilding, starts: int, goals: int, seed: int, hard: Hardness, on_drive: Callable[[Drive], None]
) -> list[Drive]:
    """So many starts, with so many goals one after another from each."""
    rng = np.random.default_rng(seed)
    done = []
    for number in range(starts):
        with _begun(known, rng, seed + number, hard) as simulator:
            config = load_config(overrides={"odometry": "wheels,dense", "known_map.path": str(known.day.folder)})
            opened = open_known(simulator.calibration, config)
            assert opened is not None
            localizer = Localizer(simulator.calibration, config, known=opened[0], waits=True)
            navigator = _navigator(simulator, localizer, known)
            for _ in range(goals):
                goal, plan = known.goal_from(known.map_pose(simulator.T_world_base), rng)
                done.append(_driven(known, simulator, navigator, goal, plan.length_m))
                on_drive(done[-1])
            localizer.close()
            opened[1].close()
    return done


def _begun(known: KnownBuilding, rng: np.random.Generator, seed: int, hard: Hardness) -> Simulator:
    """A robot somewhere on free floor, on the second day."""
    where = {"world": known.building.world} if known.building.plan is None else {"plan": known.building.plan}
    settings = SimulationSettings(
        **where, size=hard.size, rate_hz=hard.rate_hz, seed=5, day=1 + seed, realism="real", passersby=hard.people
    )
    while True:
        x, y, yaw = known.world_pose(known.pose(rng, known.footprint.circumscribed_m + _ROUND_M)).tolist()
        try:
            simulator = Simulator(settings, start=(x, y, yaw))
        except ConfigError:
            continue  # something stands there on this day
        # Whoever starts it looks round first: it may turn on the spot.
        turned = [se3.from_plane(x, y, yaw + turn) for turn in np.linspace(0, 2 * np.pi, 24, endpoint=False)]
        if min(simulator.clearance_m(T) for T in turned) > _ROUND_M:
            return simulator


def _navigator(simulator: Simulator, localizer: Localizer, known: KnownBuilding) -> Navigator:
    return Navigator(simulator, LocalizerInStep(localizer), known.floor, known.settings, trusts_floor=True)


def _driven(known: KnownBuilding, simulator: Simulator, navigator: Navigator, goal: FloatArray, plan_m: float) -> Drive:
    begin_s, way_m, clearance_m = simulator.time_s, 0.0, math.inf
    touched, last = len(simulator.contacts), simulator.T_world_base[:2, 3].copy()
    navigator.go_to_pose(goal)
    while not navigator.is_task_complete() and simulator.time_s - begin_s < _LONGEST_S:
        navigator.step()
        here = simulator.T_world_base[:2, 3].copy()
        way_m, last = way_m + float(np.hypot(*(here - last))), here
        clearance_m = min(clearance_m, simulator.clearance_m())
    result = navigator.result
    if not navigator.is_task_complete():
        navigator.cancel_task()
    for _ in range(20):
        navigator.step()
    off = known.map_pose(simulator.T_world_base) - goal
    contacts = tuple(one.name for one in simulator.contacts[touched:] if one.is_by_robot)
    return Drive(
        known.building.name,
        goal,
        result,
        float(np.hypot(*off[:2])),
        float(np.degrees(abs(wrap_angle(off[2])))),
        plan_m,
        way_m,
        clearance_m,
        contacts,
        simulator.time_s - begin_s,
    )
