"""Drives with a fault: who leads the robot, what became of it, and what is counted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import shapely

from benchmarks.fault_robot import STRAIGHT_ON_FROM_S, Fault, FaultKind, FaultyRobot, Leader
from wheelsight.config import load_config
from wheelsight.core.errors import WheelsightError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import STOP
from wheelsight.core.robots import CONTROL_PERIOD_S, RobotLimits
from wheelsight.estimation import Localizer, LocalizerInStep
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import (
    CollisionMonitor,
    Footprint,
    KnownFloor,
    MonitorState,
    NavigationSettings,
    Navigator,
    planar_pose,
)
from wheelsight.navigation.collision_monitor import VelocityRamp
from wheelsight.navigation.senses import Senses
from wheelsight_sim.simulator import PERIOD_S

CELL_M = 0.05
# After the fault; with a wrong map until the task is over, or so long.
_WATCHED_S, _WATCHED_MAP_S = 6.0, 40.0


@dataclass(frozen=True)
class FaultDrive:
    """What became of one.

    Attributes:
        number, kind, leader: of the fault.
        forward_m_s: true speed as it began.
        away_m: from the robot's outline to the thing then.
        could_stop: whether the way that the limits' braking takes was free then.
        contacts: what the robot drove into.
        contact_m_s: how fast, at most.
        blind_m: way from the fault until braking begins.
        stopped_m: way until it stood.
        reason: why it stood at last, in words.
    """

    number: int
    kind: str
    leader: str
    forward_m_s: float
    away_m: float
    could_stop: bool
    contacts: tuple[str, ...]
    contact_m_s: float
    blind_m: float
    stopped_m: float
    reason: str

    @property
    def sentence(self) -> str:
        """For the terminal."""
        touched = f", touched {', '.join(self.contacts)} at {self.contact_m_s:.2f} m/s" if self.contacts else ""
        return (
            f"{self.number} {self.kind}, {self.leader}: {self.forward_m_s:.2f} m/s, {self.away_m:.2f} m before it;"
            f" blind {self.blind_m:.2f} m, stood after {self.stopped_m:.2f} m ({self.reason}){touched}"
        )


class _Led(Protocol):
    """Anyone who leads a robot, period by period."""

    @property
    def reason(self) -> str:
        """Why it is slower than asked, or over; in words."""

    @property
    def is_over(self) -> bool:
        """Whether it will ask for nothing more."""

    def step(self) -> None:
        """One period."""


class StraightOn:
    """Asks for full speed ahead whatever happens, through ramp and collision monitor: the worst of controllers."""

    is_over = False

    def __init__(
        self, robot: FaultyRobot, localization: LocalizerInStep, floor: KnownFloor, settings: NavigationSettings
    ) -> None:
        footprint = settings.footprint.outline
        self._robot, self._settings = robot, settings
        self._monitor = CollisionMonitor(footprint, settings.limits, settings.monitor)
        self._senses = Senses(robot.calibration, localization, floor, self._monitor, footprint, settings)
        self._monitor.trust_floor(self._senses.near_m)
        self._ramp, self._command, self.reason = VelocityRamp(settings.limits), STOP, ""

    def step(self) -> None:
        """See `_Led`."""
        events, is_sound = self._robot.step(self._command), True
        try:
            self._senses.update(events, self._robot.now_s)
        except WheelsightError as error:
            self.reason, is_sound = str(error), False
        goes = is_sound and self._robot.now_s > STRAIGHT_ON_FROM_S and not self._robot.stop_reason
        asked_m_s = self._settings.limits.forward_m_s if goes else 0.0
        if self._robot.stop_reason:
            self._ramp.follow(STOP)  # as the navigator does
        ramped = self._ramp.step(asked_m_s, 0.0, CONTROL_PERIOD_S)
        checked = self._monitor.check(ramped, self._robot.now_s, self._senses.where.status)
        if checked.state is not MonitorState.FREE:
            self._ramp.follow(checked.command)
            self.reason = str(checked.reason)
        self._command = checked.command


class Led:
    """A navigator on its way to a goal behind the thing, by a map that does not know it."""

    def __init__(
        self, robot: FaultyRobot, localization: LocalizerInStep, floor: KnownFloor, settings: NavigationSettings
    ) -> None:
        self._navigator = Navigator(robot, localization, floor, settings, trusts_floor=True)
        self._navigator.go_to_pose(robot.fault.goal)
        self.reason = ""

    @property
    def is_over(self) -> bool:
        """See `_Led`."""
        return self._navigator.is_task_complete()

    def step(self) -> None:
        """See `_Led`."""
        monitor = self._navigator.step().monitor
        if monitor is not None and monitor.state is not MonitorState.FREE:
            self.reason = str(monitor.reason)
        if self._navigator.result is not None:
            self.reason = self._navigator.result.detail


_LEADERS: dict[Leader, type[StraightOn | Led]] = {Leader.STRAIGHT_ON: StraightOn, Leader.NAVIGATOR: Led}


def driven(fault: Fault, seed: int) -> FaultDrive:
    """Drive it, by the localization that `wheelsight drive` has."""
    settings = NavigationSettings()
    config = load_config(overrides={"odometry": "wheels,dense", "loops.source": "keyframes"})
    with FaultyRobot.of(fault, seed, settings.limits) as robot:
        localization = LocalizerInStep(Localizer(robot.calibration, config, waits=True))
        try:
            led = _LEADERS[fault.leader](robot, localization, KnownFloor(map_of(fault)), settings)
            return _watched(robot, led, settings)
        finally:
            localization.close()


def _watched(robot: FaultyRobot, led: _Led, settings: NavigationSettings) -> FaultDrive:
    fault, simulator = robot.fault, robot.simulator
    before, forward_m_s = simulator.T_world_base[:2, 3].copy(), 0.0
    while robot.now_s < fault.at_s:
        led.step()
        here = simulator.T_world_base[:2, 3].copy()
        before, forward_m_s = here, float(np.hypot(*(here - before))) / PERIOD_S
    pose = planar_pose(simulator.T_world_base)
    footprint, thing = settings.footprint.outline, fault.in_the_way.corners_m
    began_m = _distance_m(footprint.at(pose), thing)
    could_stop = is_free_to_stop(footprint, pose, forward_m_s, settings, thing)
    is_map = fault.kind is FaultKind.MAP
    until_s = fault.at_s + (_WATCHED_MAP_S if is_map else _WATCHED_S)
    while robot.now_s < until_s and not (is_map and led.is_over):
        led.step()
    touched = [one for one in simulator.contacts if one.is_by_robot]
    return FaultDrive(
        fault.number,
        str(fault.kind),
        str(fault.leader),
        forward_m_s,
        began_m,
        could_stop,
        tuple(one.name for one in touched),
        max((one.robot_m_s for one in touched), default=0.0),
        robot.blind_m,
        robot.stopped_m,
        led.reason or robot.stop_reason,
    )


def braking_way_m(forward_m_s: float, reaction_s: float, limits: RobotLimits, share: float) -> float:
    """From a speed to a stand: so long as before, then with a share of the limits' braking."""
    return forward_m_s * reaction_s + forward_m_s**2 / (2 * share * limits.braking_m_s2)


def is_free_to_stop(
    footprint: Footprint, pose: FloatArray, forward_m_s: float, settings: NavigationSettings, thing: FloatArray
) -> bool:
    """Whether the outline does not meet a thing (4, 2) while it brakes straight on, as the monitor reckons it."""
    monitor = settings.monitor
    way_m = braking_way_m(forward_m_s, monitor.reaction_s, settings.limits, monitor.braking_share)
    ahead = np.array([np.cos(pose[2]), np.sin(pose[2])])
    corners = footprint.at(pose)
    swept = shapely.MultiPoint(np.concatenate([corners, corners + way_m * ahead])).convex_hull
    return not bool(swept.intersects(shapely.Polygon(thing)))


def _distance_m(corners: FloatArray, thing: FloatArray) -> float:
    return float(shapely.Polygon(corners).distance(shapely.Polygon(thing)))


def map_of(fault: Fault) -> OccupancyGrid:
    """The hall without thing or end, as a map of the day before; a wrong one lies elsewhere."""
    x_min, y_min, x_max, y_max = fault.mapped_m
    x_off, y_off, turn = fault.map_off
    reach_m = float(np.hypot(x_max - x_min, y_max - y_min))
    low, count = np.array([x_min - 2.0, -reach_m / 2]), (int(reach_m / CELL_M), int((reach_m + 4.0) / CELL_M))
    rows, columns = np.mgrid[: count[0], : count[1]]
    x, y = (low[0] + (columns + 0.5) * CELL_M - x_off, low[1] + (rows + 0.5) * CELL_M - y_off)
    c, s = np.cos(turn), np.sin(turn)
    x, y = c * x + s * y, c * y - s * x
    outside_m = np.maximum.reduce([x_min - x, x - x_max, y_min - y, y - y_max])
    kind = np.full(count, CellKind.UNKNOWN, np.uint8)
    kind[outside_m <= 0.1] = CellKind.OBSTACLE
    kind[outside_m <= 0.0] = CellKind.FREE
    return OccupancyGrid.of_kinds(kind, np.zeros(count, bool), CELL_M, (float(low[0]), float(low[1])))
