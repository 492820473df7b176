"""A drive, stepped by MuJoCo: the driver's commands turn motors, motors turn wheels, wheels grip or slip."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wheelsight.errors import ConfigError
from wheelsight.geometry import FloatArray
from wheelsight.simulation._chair import Chair
from wheelsight.simulation.drive import Drive
from wheelsight.simulation.drivers import COMMAND_PERIOD_S, Command, Driver
from wheelsight.simulation.encoders import Reckoning
from wheelsight.simulation.realism import Realism
from wheelsight.simulation.robot import Robot, WheelFaults
from wheelsight.simulation.stepping import (
    NO_FAULTS,
    TRUTH_PERIOD_S,
    Reading,
    SteppedRobot,
    floor_of,
    poses_of,
    start_of,
    ticks_of,
)
from wheelsight.simulation.world import World
from wheelsight.trajectory import Trajectory

STUCK_AFTER_S = 10.0

_STUCK_M, _STUCK_RAD = 0.05, 0.05


def simulate_drive(
    world: World,
    robot: Robot,
    driver: Driver,
    *,
    faults: WheelFaults = NO_FAULTS,
    slip: bool = True,
    seed: int = 0,
    floor_seed: int | None = None,
    realism: Realism | None = None,
    time_limit_s: float = 3600.0,
    on_progress: Callable[[float], None] | None = None,
) -> Drive:
    """Drive until the driver has arrived, the robot is stuck or has fallen over, or the time is up.

    The base is the middle between the driven wheels, on the ground. Wheels slip as friction, an uneven floor and a
    fidgeting rider make them; with `slip` False they roll as odometry takes them to. Equal arguments, equal drives.

    Args:
        world: what there is to bump into, and where the drive starts unless the driver says so.
        robot, driver: the robot as it truly is, and who gives it commands.
        faults: what goes wrong with the wheels, and when.
        slip: whether the wheels may slip.
        seed, floor_seed: of the rider, castors, encoders' phases and gyroscope; of the floor, or else by `seed`.
        realism: what tyres and floor do beside slipping, or None for nothing.
        time_limit_s: when a drive ends that has not arrived.
        on_progress: told the simulated seconds, once for each.

    Raises:
        ConfigError: a time limit that is none, or a world MuJoCo does not take.
    """
    _check_limit(time_limit_s)
    start = driver.T_world_start if driver.T_world_start is not None else start_of(world)
    floor = floor_of(world, realism, seed if floor_seed is None else floor_seed)
    moving = SteppedRobot(world, robot, start, faults=faults, slip=slip, seed=seed, floor=floor)
    log = _Log(moving, Reckoning(robot.nominal, start))
    return log.drive(_drive(log, driver, time_limit_s, on_progress))


def _check_limit(time_limit_s: float) -> None:
    if not (math.isfinite(time_limit_s) and time_limit_s > 0):
        raise ConfigError(f"time_limit_s is {time_limit_s}", fix="give seconds above 0")


def _drive(log: _Log, driver: Driver, time_limit_s: float, on_progress: Callable[[float], None] | None) -> str:
    """Steps to the end; why it ended before the driver had arrived, or nothing."""
    watch, robot = _Watch(), log.robot
    chair = robot.chair
    for tick in range(math.ceil(time_limit_s / TRUTH_PERIOD_S) + 1):
        stamp_s = robot.time_s
        if chair.is_broken:
            return f"the physics became unstable at {stamp_s:.1f} s"
        log.add(robot.read())
        if tick % ticks_of(COMMAND_PERIOD_S) == 0:
            believed = log.T_world_believed()
            command = driver.command(stamp_s, believed if driver.is_blind else chair.T_world_base)
            if command is None:
                return ""
            reason = watch.trouble(stamp_s, chair, command)
            if reason:
                return reason
            chair.obey(command.v_m_s, command.yaw_rate_rad_s)
        if on_progress is not None and tick % ticks_of(1.0) == 0:
            on_progress(stamp_s)
        robot.advance()
    return f"the time limit of {time_limit_s:g} s came before the end of the route"


class _Log:
    """What is kept of a drive while it goes on."""

    def __init__(self, robot: SteppedRobot, reckoning: Reckoning) -> None:
        self.robot, self._reckoning = robot, reckoning
        self._readings: list[Reading] = []

    def add(self, reading: Reading) -> None:
        """Keep it."""
        self._readings.append(reading)

    def T_world_believed(self) -> FloatArray:
        """(4, 4) by the wheels alone."""
        return self._reckoning.update(*self.robot.counts)

    def drive(self, reason: str) -> Drive:
        """All of it."""
        stamps_s = np.array([reading.stamp_s for reading in self._readings])
        T_world_base = poses_of(self._readings)
        ticks = tuple(reading.ticks for reading in self._readings if reading.ticks is not None)
        yaw_rates = tuple(reading.yaw_rate for reading in self._readings if reading.yaw_rate is not None)
        return Drive(Trajectory(stamps_s, T_world_base, body="base"), ticks, yaw_rates, not reason, reason)


@dataclass(slots=True)
class _Watch:
    """Sees when a robot that is told to move no longer does."""

    since_s: float | None = None
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0

    def trouble(self, stamp_s: float, chair: Chair, command: Command) -> str:
        """What the matter is, or nothing."""
        T = chair.T_world_base
        if T[2, 2] < 0.7:
            return f"the wheelchair fell over at {stamp_s:.1f} s"
        x_m, y_m, yaw_rad = float(T[0, 3]), float(T[1, 3]), math.atan2(T[1, 0], T[0, 0])
        rests = abs(command.v_m_s) < 0.005 and abs(command.yaw_rate_rad_s) < 0.005
        moved_m = math.hypot(x_m - self.x_m, y_m - self.y_m)
        turned_rad = abs(math.remainder(yaw_rad - self.yaw_rad, 2 * math.pi))
        if self.since_s is None or rests or moved_m > _STUCK_M or turned_rad > _STUCK_RAD:
            self.since_s, self.x_m, self.y_m, self.yaw_rad = stamp_s, x_m, y_m, yaw_rad
        if stamp_s - self.since_s >= STUCK_AFTER_S:
            return f"stuck at x = {x_m:.2f}, y = {y_m:.2f} m since {self.since_s:.1f} s"
        return ""
