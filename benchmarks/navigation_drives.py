"""A robot that drives to goals in a map of the day before, by its own localization; judged by the simulator's truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.box_worlds import with_boxes
from benchmarks.calibrated_sources import CalibratedRobot
from benchmarks.calibrated_unit import calibration_for
from benchmarks.navigation_courses import ROUND_M, Course, KnownBuilding
from wheelsight.app.run.maps import open_known
from wheelsight.config import load_config
from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.core.robots import Robot
from wheelsight.estimation import Localizer, LocalizerInStep
from wheelsight.navigation import Navigator
from wheelsight_sim import SimulationSettings
from wheelsight_sim.simulate import world_of
from wheelsight_sim.simulator import Simulator

ARRIVED_M, ARRIVED_DEG = 0.15, 10.0
_LONGEST_S = 240.0
_MOST_COURSES = 50


@dataclass(frozen=True)
class Hardness:
    """What the second day has that the first had not: people, things in the way.

    Attributes:
        people, things: how many.
        rate_hz, size: of the images.
        units: a folder of calibrations, for a robot that was calibrated; None for one that is as the data sheet says.
    """

    people: int = 0
    things: int = 0
    rate_hz: float = 10.0
    size: tuple[int, int] = (320, 240)
    units: Path | None = None


@dataclass(frozen=True)
class Drive:
    """What became of a goal.

    Attributes:
        building: where.
        goal: x, y, yaw in the map.
        says_arrived: as the navigator shows it; None where it took too long.
        detail: in its words.
        plans: how many it made; None where it took too long.
        off_m, off_deg: of the true pose from the goal, beside the map's nearest keyframe.
        shortest_m: the plan of one who knows map and things.
        way_m: truly driven.
        clearance_m: least true distance from outline to things.
        contacts: what the robot touched by its own motion, in words.
        time_s: simulated.
    """

    building: str
    goal: tuple[float, float, float]
    says_arrived: bool | None
    detail: str
    plans: int | None
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
        return bool(self.says_arrived) and self.off_m <= ARRIVED_M and self.off_deg <= ARRIVED_DEG

    @property
    def spl(self) -> float:
        """Success weighted by path length (Anderson et al. 2018)."""
        if not self.has_arrived or not self.shortest_m > 0:
            return 0.0
        return self.shortest_m / max(self.shortest_m, self.way_m)

    @property
    def sentence(self) -> str:
        """For the terminal."""
        what = "took too long" if self.says_arrived is None else (self.detail or "arrived")
        if self.has_arrived:
            what = "arrived"
        touched = f", touched {', '.join(self.contacts)}" if self.contacts else ""
        return (
            f"{self.building} ({self.goal[0]:.1f}, {self.goal[1]:.1f}): {what}, {self.off_m:.2f} m and"
            f" {self.off_deg:.0f}° off, {self.way_m:.1f} m for {self.shortest_m:.1f}, {self.time_s:.0f} s,"
            f" clearance {self.clearance_m:.2f} m{touched}"
        )


def drives_from(
    known: KnownBuilding, number: int, goals: int, seed: int, hard: Hardness, on_drive: Callable[[Drive], None]
) -> list[Drive]:
    """From a start by its number, goals one after another."""
    rng = np.random.default_rng([seed, number])
    simulator, course = _begun(known, rng, goals, seed + number, hard)
    config = load_config(overrides={"odometry": "wheels,dense", "known_map.path": str(known.day.folder)})
    done = []
    robot = _owned(simulator, hard.units)
    with simulator:
        opened = open_known(robot.calibration, config)
        assert opened is not None
        localization = LocalizerInStep(Localizer(robot.calibration, config, known=opened[0], waits=True))
        navigator = Navigator(robot, localization, known.floor, known.settings, trusts_floor=True)
        costmap = known.costmap_with(course.things)
        for goal, way_m in zip(course.goals, course.ways_m, strict=True):
            plan = known.way(costmap, known.map_pose(simulator.T_world_base), goal)
            done.append(_driven(known, simulator, navigator, goal, way_m if plan is None else plan.length_m))
            on_drive(done[-1])
        localization.close()
        opened[1].close()
    return done


def _owned(simulator: Simulator, units: Path | None) -> Robot:
    if units is None:
        return simulator
    return CalibratedRobot(simulator, calibration_for(simulator.settings, units))


def _begun(
    known: KnownBuilding, rng: np.random.Generator, goals: int, seed: int, hard: Hardness
) -> tuple[Simulator, Course]:
    """A robot somewhere on free floor, on the second day, and its course."""
    where, people = known.building.where, hard.people
    settings = SimulationSettings(
        **where, size=hard.size, rate_hz=hard.rate_hz, seed=5, day=1 + seed, realism="real", passersby=people
    )
    world = world_of(settings)
    for _ in range(_MOST_COURSES):
        course = known.course(rng, goals, hard.things)
        x, y, yaw = known.world_pose(course.start).tolist()
        things = [known.world_box(thing) for thing in course.things]
        try:
            simulator = Simulator(settings, world=with_boxes(world, things, seed), start=(x, y, yaw))
        except ConfigError:
            continue  # something stands there on this day
        # Anyone who starts it looks round first: it may turn on the spot.
        turned = [se3.from_plane(x, y, yaw + turn) for turn in np.linspace(0, 2 * np.pi, 24, endpoint=False)]
        if len(things) == hard.things and min(simulator.clearance_m(T) for T in turned) > ROUND_M:
            return simulator, course
    raise ConfigError(f"{known.building.name} has no room for a course with {hard.things} things", fix="--things 0")


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
    x, y, yaw = goal.tolist()
    return Drive(
        known.building.name,
        (x, y, yaw),
        None if result is None else result.has_arrived,
        "" if result is None else result.detail,
        None if result is None else result.plans,
        float(np.hypot(*off[:2])),
        float(np.degrees(abs(wrap_angle(off[2])))),
        plan_m,
        way_m,
        clearance_m,
        tuple(one.name for one in simulator.contacts[touched:] if one.is_by_robot),
        simulator.time_s - begin_s,
    )
