"""A drive, stepped by MuJoCo, and the drive of a holonomic base; the way that the robot is to go."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.core.calibration_parts import Gyro, HolonomicWheels
from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray, se2, se3
from wheelsight.core.messages import HolonomicReading, OdometryReading, WheelCounts, WheelTicks, YawRate
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import drivers
from wheelsight_sim.doors import Leaves
from wheelsight_sim.drivers import COMMAND_PERIOD_S, Command, Driver, Path2d
from wheelsight_sim.readings import GYRO_PERIOD_S, DeadReckoning, Encoders, Gyroscope, is_during
from wheelsight_sim.robot import TICK_PERIOD_S, Drive, RobotModel, WheelFaults, WheelSizeSettings
from wheelsight_sim.settings import Realism, SimulationSettings, realism_of, stream
from wheelsight_sim.wheelchair import TIMESTEP_S, Chair, Underfoot
from wheelsight_sim.world import World

TRUTH_PERIOD_S = 0.005
NO_FAULTS = WheelFaults()

_SETTLING_S = 0.5
_STEPS = round(TRUTH_PERIOD_S / TIMESTEP_S)


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """What there is to know of one moment.

    Attributes:
        stamp_s: seconds since the start.
        position_m: (3,) of T_world_base.
        quaternion_wxyz: (4,) of T_world_base.
        ticks: of the wheels, where it was their turn and they did not drop out.
        yaw_rate: of the gyroscope, where there is one and it was its turn.
    """

    stamp_s: float
    position_m: FloatArray
    quaternion_wxyz: FloatArray
    ticks: WheelTicks | None
    yaw_rate: YawRate | None


class SteppedRobot:
    """A chair with its encoders and gyroscope: `read` once and `advance` once every `TRUTH_PERIOD_S`.

    The chair is let settle at `T_world_start`. `seed` is of the rider, castors, encoders' phases and gyroscope.

    Attributes:
        chair: what physics moves.
        tick: how often it was advanced.

    Raises:
        ConfigError: a world that MuJoCo does not take.
    """

    def __init__(
        self,
        world: World,
        robot: RobotModel,
        T_world_start: FloatArray,
        *,
        faults: WheelFaults = NO_FAULTS,
        slip: bool = True,
        seed: int = 0,
        floor: Underfoot | None = None,
        doors: Leaves | None = None,
    ) -> None:
        chair_rng, encoder_rng, gyro_rng = (np.random.default_rng([seed, part]) for part in range(3))
        self.chair = Chair(world, robot, faults, T_world_start, slip=slip, rng=chair_rng, underfoot=floor, doors=doors)
        if doors is not None:
            self.chair.swing(*doors.poses_at(0.0))
        self.chair.settle(_SETTLING_S)
        self._encoders = Encoders(robot, faults, encoder_rng)
        self._gyroscope = Gyroscope(Gyro(), gyro_rng) if robot.has_gyro else None
        self.tick = 0

    @property
    def time_s(self) -> float:
        """Seconds since the start."""
        return self.tick * TRUTH_PERIOD_S

    @property
    def counts(self) -> tuple[int, int]:
        """Counts of the left and right encoder in the wheel controller, even if no reading arrives."""
        return self._encoders.counts

    def read(self) -> Reading:
        """The pose, and each sensor whose turn it is."""
        position, quaternion_wxyz = self.chair.pose
        self._encoders.turn(self.time_s, self.chair.wheels_rad)
        ticks = yaw_rate = None
        if self.tick % ticks_of(TICK_PERIOD_S) == 0:
            ticks = self._encoders.read(self.time_s)
        if self._gyroscope is not None and self.tick % ticks_of(GYRO_PERIOD_S) == 0:
            yaw_rate = self._gyroscope.read(self.time_s, self.chair.yaw_rate_rad_s)
        return Reading(self.time_s, position, quaternion_wxyz, ticks, yaw_rate)

    def advance(self) -> None:
        """Go on by `TRUTH_PERIOD_S`."""
        self.chair.step(self.time_s, _STEPS)
        self.tick += 1


def poses_of(readings: Sequence[Reading]) -> FloatArray:
    """T_world_base (N, 4, 4) of readings."""
    quaternions_xyzw = np.roll(np.array([reading.quaternion_wxyz for reading in readings]), -1, axis=1)
    return se3.from_quaternion(np.array([reading.position_m for reading in readings]), quaternions_xyzw)


def floor_of(world: World, realism: Realism | None, seed: int) -> Underfoot | None:
    """What a world's floor and tyres do to wheels, or None where nothing."""
    return None if realism is None else Underfoot(realism.floor_of(world, seed), realism.tyres)


def start_of(world: World) -> FloatArray:
    """T_world_base (4, 4) at the route's first waypoint, heading for the second."""
    (x, y), towards = world.route[0], world.route[1] - world.route[0]
    return se3.from_plane(x, y, np.arctan2(towards[1], towards[0]))


def ticks_of(period_s: float) -> int:
    """How many times `TRUTH_PERIOD_S` a period lasts."""
    return round(period_s / TRUTH_PERIOD_S)


STUCK_AFTER_S = 10.0

_STUCK_M, _STUCK_RAD = 0.05, 0.05


def simulate_drive(
    world: World,
    robot: RobotModel,
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

    The drive starts where the driver says, or at the world's start, and ends after `time_limit_s` at the latest.
    `seed` is of the rider, castors, encoders' phases and gyroscope, `floor_seed` of the floor (None: `seed`). `realism`
    adds errors of tyres and floor. `on_progress` is called with each simulated second.

    Raises ConfigError for a time limit that is none, or a world that MuJoCo does not take.
    """
    if not (math.isfinite(time_limit_s) and time_limit_s > 0):
        raise ConfigError(f"time_limit_s is {time_limit_s}", fix="give seconds above 0")
    start = driver.T_world_start if driver.T_world_start is not None else start_of(world)
    floor = floor_of(world, realism, seed if floor_seed is None else floor_seed)
    moving = SteppedRobot(world, robot, start, faults=faults, slip=slip, seed=seed, floor=floor)
    readings: list[Reading] = []
    reason = _drive(moving, DeadReckoning(robot.nominal, start), driver, readings, time_limit_s, on_progress)
    stamps_s = np.array([reading.stamp_s for reading in readings])
    ticks = tuple(reading.ticks for reading in readings if reading.ticks is not None)
    yaw_rates = tuple(reading.yaw_rate for reading in readings if reading.yaw_rate is not None)
    return Drive(Trajectory(stamps_s, poses_of(readings), body="base"), ticks, yaw_rates, not reason, reason)


def _drive(
    robot: SteppedRobot,
    odometry: DeadReckoning,
    driver: Driver,
    readings: list[Reading],
    time_limit_s: float,
    on_progress: Callable[[float], None] | None,
) -> str:
    """Steps to the end and keeps the readings; returns why it ended before the driver had arrived, or nothing."""
    watch, chair = _Watch(), robot.chair
    for tick in range(math.ceil(time_limit_s / TRUTH_PERIOD_S) + 1):
        stamp_s = robot.time_s
        if chair.is_broken:
            return f"the physics became unstable at {stamp_s:.1f} s"
        readings.append(robot.read())
        if tick % ticks_of(COMMAND_PERIOD_S) == 0:
            T_odometry = odometry.update(*robot.counts)
            command = driver.command(stamp_s, T_odometry if driver.is_blind else chair.T_world_base)
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


@dataclass(slots=True)
class _Watch:
    """Detects a robot that no longer follows commands to move."""

    since_s: float | None = None
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0

    def trouble(self, stamp_s: float, chair: Chair, command: Command) -> str:
        """The problem, or an empty string."""
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


# A driver strays by this distance from the legs, and a robot sweeps more than its width when it turns.
_MARGIN_M = 0.1
_UMBMARK_WORLD = "square"


def route_of(settings: SimulationSettings, world: World) -> FloatArray:
    """The world's waypoints (N, 2) in the order in which the settings want them driven; a loop keeps its first."""
    if not settings.is_reverse:
        return world.route
    return np.concatenate([world.route[:1], world.route[:0:-1]]) if world.is_loop else world.route[::-1].copy()


def driver_of(settings: SimulationSettings, world: World) -> Driver:
    """The driver by the settings. Raises InputError for an invalid file of velocities."""
    if settings.velocities is not None:
        return drivers.read_manual_velocities(settings.velocities)
    route = route_of(settings, world)
    if settings.stops_to_turn:
        laps = np.concatenate([np.tile(route, (settings.laps, 1)), route[: int(world.is_loop)]])
        is_umbmark = settings.plan is None and world.name == _UMBMARK_WORLD
        # UMBmark is driven by the wheels alone: steering by sight would hide their errors. Elsewhere walls are near.
        return drivers.StopAndTurn(laps, settings.speed_m_s, is_blind=is_umbmark)
    return drivers.follow_route(route, is_loop=world.is_loop, laps=settings.laps, speed_m_s=settings.speed_m_s)


def refuse_walls(settings: SimulationSettings, world: World, driver: Driver, picture: Path | None) -> None:
    """Raise ConfigError if the path hits an obstacle, and draw it if `picture` is given."""
    from wheelsight_sim.clearance import draw_plan, find_collision

    way = route_of(settings, world)
    if settings.velocities is not None:
        # The path of the given velocities without lag, in steps of 5 cm or more.
        (x, y), towards = world.route[0], world.route[1] - world.route[0]
        T = se2.from_parts(x, y, np.arctan2(towards[1], towards[0]))
        places, stamp_s = [world.route[0]], 0.0
        while (command := driver.command(stamp_s, np.eye(4))) is not None:
            T = T @ se2.exp(COMMAND_PERIOD_S * np.array([command.v_m_s, 0.0, command.yaw_rate_rad_s]))
            stamp_s += COMMAND_PERIOD_S
            if np.hypot(*(T[:2, 2] - places[-1])) >= 0.05:
                places.append(T[:2, 2].copy())
        way = np.array([*places, T[:2, 2] + 1e-6])
    is_loop = world.is_loop and settings.velocities is None
    collision = find_collision(world, way, settings.robot.width_m / 2 + _MARGIN_M, is_loop=is_loop)
    if collision is None:
        return
    what = "leaves the floor" if collision.geom is None else f"runs into {collision.geom}"
    problem = f"the way {what} at x = {collision.place[0]:.2f}, y = {collision.place[1]:.2f} m"
    if picture is not None:
        draw_plan(world, picture, route=way, mark=collision.place, is_loop=is_loop)
    raise ConfigError(problem, path=settings.velocities, fix=None if picture is None else f"see {picture}")


def expected_s(settings: SimulationSettings, world: World) -> float | None:
    """The expected duration of the drive, or None if unknown."""
    if settings.velocities is not None:
        return settings.duration_s
    route = route_of(settings, world)
    lap = np.concatenate([route, route[: int(world.is_loop)]])
    corners_s = len(lap) * (4.0 if settings.stops_to_turn else 1.0)
    way_s = np.hypot(*np.diff(lap, axis=0).T).sum() / settings.speed_m_s
    return min(settings.laps * float(way_s + corners_s), settings.duration_s or np.inf)


# A holonomic base follows its path exactly, because physics does not simulate rollers. Inverse kinematics gives the
# rotation of its wheels. Their slip is random, by distance, and on a patch of ice a wheel spins.


# Data sheets of small research bases (four mecanum wheels of 10 cm; three omni wheels of 10 cm).
_ALIKE: dict[str, Any] = {"radius_m": 0.05, "ticks_per_turn": 4096.0}
_OF_THREE = math.pi / 3, math.pi, 5 * math.pi / 3
_OF_FOUR = math.pi / 4, 3 * math.pi / 4, 5 * math.pi / 4, 7 * math.pi / 4
_WHEELS = {
    "mecanum": HolonomicWheels("mecanum", half_length_m=0.20, half_width_m=0.18, **_ALIKE),
    "omni-3": HolonomicWheels("omni", distance_m=0.20, angles_rad=_OF_THREE, **_ALIKE),
    "omni-4": HolonomicWheels("omni", distance_m=0.22, angles_rad=_OF_FOUR, **_ALIKE),
}
_INCREMENTS = HolonomicWheels("increments", distance_m=0.27)
# Largest yaw of the base to each side of its path, and the period: at 0.8 m/s it turns by 0.5 rad/s.
_LOOKING_ASIDE_RAD, _LOOKING_EVERY_M = 0.8, 8.0
# 1/s: how fast the base turns to where it is to look, within the yaw rate and its change of the other drivers.
_TURNING_PER_S, _FASTEST_RAD_S, _FASTEST_RAD_S2 = 2.0, 0.8, 1.5
# On ice a wheel spins on by this share of its way.
_SPINNING = 0.5


def nominal_wheels(settings: SimulationSettings) -> HolonomicWheels:
    """The wheels of a holonomic base as its data sheet has them."""
    return _INCREMENTS if settings.base == "increments" else _WHEELS[settings.base]


def owned_wheels(settings: SimulationSettings, sizes: WheelSizeSettings, rng: np.random.Generator) -> HolonomicWheels:
    """The wheels by a calibration, with its errors and standard deviations."""
    wheels, (scale, turn) = nominal_wheels(settings), rng.standard_normal(2) * (sizes.scale_sigma, sizes.turn_sigma)
    known: dict[str, Any] = {
        "scale_sigma": sizes.scale_sigma,
        "drift_sigma_rad_per_m": sizes.drift_sigma_rad_per_m,
        "turn_sigma": math.hypot(sizes.scale_sigma, sizes.turn_sigma),
    }
    if wheels.layout == "increments":
        return replace(wheels, **known)
    levers = {name: getattr(wheels, name) for name in ("half_length_m", "half_width_m", "distance_m")}
    off: dict[str, Any] = {name: (1 + turn) * size_m for name, size_m in levers.items() if size_m is not None}
    assert wheels.radius_m is not None
    return replace(wheels, radius_m=(1 + scale) * wheels.radius_m, **off, **known)


def simulate_holonomic_drive(
    settings: SimulationSettings, world: World, on_progress: Callable[[float], None] | None = None
) -> Drive:
    """The drive along the world's route that the settings ask for. Raises ConfigError for what such a base has not."""
    faults = settings.faults
    has_not = {"--lift": faults.lifted_s, "--drive": settings.velocities, "--stop-and-turn": settings.stops_to_turn}
    for option, value in has_not.items():
        if value:
            raise ConfigError(f"{option} means nothing with --base {settings.base}", fix="leave one of them out")
    route = drivers.laps_of(route_of(settings, world), world.is_loop, settings.laps)
    poses, is_complete = _poses(drivers.smooth_path(route), settings)
    rng = np.random.default_rng([settings.day_seed, 7])
    stamps_s = TRUTH_PERIOD_S * np.arange(len(poses), dtype=float)
    T = se2.from_parts(*poses.T)
    steps = se2.log(se2.compose(se2.invert(T[:-1]), T[1:]))
    counts = _counts(settings, steps, poses, rng)
    readings = tuple(_readings(settings, stamps_s, counts))
    if on_progress is not None:
        for second in range(math.floor(stamps_s[-1]) + 1):
            on_progress(float(second))
    truth = Trajectory(stamps_s, se3.from_plane(*poses.T), body="base")
    reason = "" if is_complete else f"the time limit of {settings.duration_s:g} s came before the end of the route"
    yaw_rates: tuple[YawRate, ...] = ()
    if settings.robot.has_gyro:
        gyroscope, every = Gyroscope(Gyro(), np.random.default_rng([settings.day_seed, 2])), ticks_of(GYRO_PERIOD_S)
        rates = np.append(steps[:, 2], steps[-1, 2])[::every] / TRUTH_PERIOD_S
        taken = zip(stamps_s[::every].tolist(), rates.tolist(), strict=True)
        yaw_rates = tuple(gyroscope.read(stamp_s, rate) for stamp_s, rate in taken)
    return Drive(truth, (), yaw_rates, is_complete, reason, readings)


def _poses(paths: list[Path2d], settings: SimulationSettings) -> tuple[FloatArray, bool]:
    """x, y and yaw (N, 3) of the base every `TRUTH_PERIOD_S`, and whether that is all of the way."""
    most = math.inf if settings.duration_s is None else round(settings.duration_s / TRUTH_PERIOD_S) + 1
    found: list[tuple[float, float, float]] = []
    yaw, rate, driven_m, target = paths[0].at(0.0)[2], 0.0, 0.0, paths[0].at(0.0)[2]
    for path in paths:
        speeds, along_m = drivers.speed_profile(path, settings.speed_m_s), 0.0
        turned = round((target - path.at(0.0)[2]) / (2 * math.pi)) * 2 * math.pi
        v_m_s = 0.0
        while along_m < path.length_m - 1e-3:
            if len(found) >= most:
                return np.array(found), False
            x, y, ahead = path.at(along_m)
            found.append((x, y, yaw))
            wanted = float(np.interp(along_m, path.along_m, speeds))
            v_m_s = min(max(wanted, 0.01), v_m_s + 0.5 * TRUTH_PERIOD_S)  # m/s², as a rider bears
            along_m += v_m_s * TRUTH_PERIOD_S
            driven_m += v_m_s * TRUTH_PERIOD_S
            target = ahead + turned
            aside = _LOOKING_ASIDE_RAD * math.sin(2 * math.pi * driven_m / _LOOKING_EVERY_M)
            asked = min(max(_TURNING_PER_S * (target + aside - yaw), -_FASTEST_RAD_S), _FASTEST_RAD_S)
            change = _FASTEST_RAD_S2 * TRUTH_PERIOD_S
            rate += min(max(asked - rate, -change), change)
            yaw += rate * TRUTH_PERIOD_S
    return np.array(found), True


def _counts(settings: SimulationSettings, steps: FloatArray, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(N, wheels) whole counts, of wheels that slip where they may."""
    wheels, faults = _true_wheels(settings), settings.faults
    ways_m = steps @ wheels.jacobian.T
    realism = realism_of(settings.realism)
    if realism is not None:
        # A calibration has one radius for all wheels, so the wheels differ: driving ahead turns the base.
        turn_by_each = np.linalg.norm(wheels.to_base[2] * wheels.jacobian[:, 0])
        unequal = stream(settings.seed, "unequal wheels").standard_normal(len(wheels.jacobian))
        ways_m *= 1 + realism.wheel_sizes.drift_sigma_rad_per_m / turn_by_each * unequal
    if settings.has_slip:
        ways_m += wheels.slip_m_per_sqrt_m * np.sqrt(np.abs(ways_m)) * rng.standard_normal(ways_m.shape)
    is_on_ice = np.zeros(len(poses) - 1, bool)
    for patch in faults.patches:
        is_on_ice |= np.hypot(poses[:-1, 0] - patch.x_m, poses[:-1, 1] - patch.y_m) < patch.radius_m
    ways_m[is_on_ice, 0] *= 1 + _SPINNING
    unplugged = [is_during(TRUTH_PERIOD_S * i, faults.unplugged_s) for i in range(len(ways_m))]
    rolled = np.vstack([np.zeros(ways_m.shape[1]), np.cumsum(ways_m, axis=0)]) / wheels.m_per_tick
    counts = np.floor(rolled + rng.random(ways_m.shape[1]))
    lost = np.cumsum(np.diff(counts, axis=0) * np.array(unplugged)[:, None], axis=0)
    return np.asarray(counts - np.vstack([np.zeros(ways_m.shape[1]), lost]))


def _true_wheels(settings: SimulationSettings) -> HolonomicWheels:
    """Those that count; of a base that has increments ready, four mecanum wheels."""
    return _WHEELS["mecanum" if settings.base == "increments" else settings.base]


def _readings(settings: SimulationSettings, stamps_s: FloatArray, counts: FloatArray) -> list[HolonomicReading]:
    """Every 20 ms, but where they drop out."""
    wheels, every = _true_wheels(settings), ticks_of(TICK_PERIOD_S)
    T, last, found = np.eye(3), counts[0], list[HolonomicReading]()
    for stamp_s, row in zip(stamps_s[::every].tolist(), counts[::every], strict=True):
        T, last = T @ se2.exp(wheels.to_base @ (wheels.m_per_tick * (row - last))), row
        if is_during(stamp_s, settings.faults.dropouts_s):
            continue
        if settings.base == "increments":
            x_m, y_m, yaw_rad = (float(part) for part in se2.to_parts(T))
            found.append(OdometryReading(stamp_s, x_m, y_m, yaw_rad))
        else:
            found.append(WheelCounts(stamp_s, tuple(int(count) for count in row)))
    return found
