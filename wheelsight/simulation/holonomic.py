"""A drive of a holonomic base: along the route, looking elsewhere than where it goes.

The base keeps its path exactly: rollers are not simulated by physics. What its wheels roll follows by inverse
kinematics, and their slip is drawn: by each wheel's way, and a wheel that spins on a patch of ice.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from wheelsight.calibration import Gyro, HolonomicWheels
from wheelsight.errors import ConfigError
from wheelsight.events import HolonomicReading, OdometryReading, WheelCounts, YawRate
from wheelsight.geometry import FloatArray, se2, se3
from wheelsight.simulation._paths import Path2d, laps_of, smooth_path
from wheelsight.simulation._way import route_of
from wheelsight.simulation.drive import Drive
from wheelsight.simulation.drivers import _speed_profile
from wheelsight.simulation.encoders import GYRO_PERIOD_S, Gyroscope, is_during
from wheelsight.simulation.realism.wheel_sizes import WheelSizeSettings
from wheelsight.simulation.robot import TICK_PERIOD_S, WheelFaults
from wheelsight.simulation.settings import SimulationSettings
from wheelsight.simulation.stepping import TRUTH_PERIOD_S, ticks_of
from wheelsight.simulation.world import World
from wheelsight.trajectory import Trajectory

# Data sheets of small research bases (four mecanum wheels of 10 cm; three omni wheels of 10 cm).
_COUNTS_A_TURN = 4096.0
_WHEELS = {
    "mecanum": HolonomicWheels(
        "mecanum", radius_m=0.05, half_length_m=0.20, half_width_m=0.18, ticks_per_turn=_COUNTS_A_TURN
    ),
    "omni-3": HolonomicWheels(
        "omni",
        radius_m=0.05,
        distance_m=0.20,
        angles_rad=(math.pi / 3, math.pi, 5 * math.pi / 3),
        ticks_per_turn=_COUNTS_A_TURN,
    ),
    "omni-4": HolonomicWheels(
        "omni",
        radius_m=0.05,
        distance_m=0.22,
        angles_rad=(math.pi / 4, 3 * math.pi / 4, 5 * math.pi / 4, 7 * math.pi / 4),
        ticks_per_turn=_COUNTS_A_TURN,
    ),
}
_INCREMENTS = HolonomicWheels("increments", distance_m=0.27)
# The base looks to both sides of its way by so much, once in so many metres: at 0.8 m/s that turns it by 0.5 rad/s.
_LOOKING_ASIDE_RAD, _LOOKING_EVERY_M = 0.8, 8.0
# 1/s: how fast the base turns to where it is to look, within the yaw rate and its change of the other drivers.
_TURNING_PER_S, _FASTEST_RAD_S, _FASTEST_RAD_S2 = 2.0, 0.8, 1.5
# On ice a wheel spins on by this share of its way.
_SPINNING = 0.5


def nominal_wheels(settings: SimulationSettings) -> HolonomicWheels:
    """The wheels of a holonomic base as its data sheet has them."""
    return _INCREMENTS if settings.base == "increments" else _WHEELS[settings.base]


def owned_wheels(settings: SimulationSettings, sizes: WheelSizeSettings, rng: np.random.Generator) -> HolonomicWheels:
    """The wheels as a calibration has left them: not quite what they are, and it says so."""
    wheels, (scale, turn) = nominal_wheels(settings), rng.standard_normal(2) * (sizes.scale_sigma, sizes.turn_sigma)
    known: dict[str, Any] = {
        "scale_sigma": sizes.scale_sigma,
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
    route = laps_of(route_of(settings, world), world.is_loop, settings.laps, None)
    poses, is_complete = _poses(smooth_path(route), settings)
    rng = np.random.default_rng([settings.day_seed, 7])
    stamps_s = TRUTH_PERIOD_S * np.arange(len(poses), dtype=float)
    steps = _steps(poses)
    counts = _counts(settings, steps, poses, rng)
    readings = tuple(_readings(settings, stamps_s, counts))
    if on_progress is not None:
        for second in range(math.floor(stamps_s[-1]) + 1):
            on_progress(float(second))
    truth = Trajectory(stamps_s, se3.from_plane(*poses.T), body="base")
    reason = "" if is_complete else f"the time limit of {settings.duration_s:g} s came before the end of the route"
    yaw_rates = _yaw_rates(settings, stamps_s, steps) if settings.robot.has_gyro else ()
    return Drive(truth, (), yaw_rates, is_complete, reason, readings)


def _poses(paths: list[Path2d], settings: SimulationSettings) -> tuple[FloatArray, bool]:
    """x, y and yaw (N, 3) of the base every `TRUTH_PERIOD_S`, and whether that is all of the way."""
    most = math.inf if settings.duration_s is None else round(settings.duration_s / TRUTH_PERIOD_S) + 1
    found: list[tuple[float, float, float]] = []
    yaw, rate, driven_m, target = paths[0].at(0.0)[2], 0.0, 0.0, paths[0].at(0.0)[2]
    for path in paths:
        speeds, along_m = _speed_profile(path, settings.speed_m_s), 0.0
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


def _steps(poses: FloatArray) -> FloatArray:
    """(N - 1, 3) tangents of the steps between poses, in the base's frame."""
    T = se2.from_parts(*poses.T)
    return se2.log(se2.compose(se2.invert(T[:-1]), T[1:]))


def _counts(settings: SimulationSettings, steps: FloatArray, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(N, wheels) whole counts, of wheels that slip where they may."""
    wheels, faults = _true_wheels(settings), settings.faults
    ways_m = steps @ wheels.jacobian.T
    if settings.has_slip:
        ways_m += wheels.slip_m_per_sqrt_m * np.sqrt(np.abs(ways_m)) * rng.standard_normal(ways_m.shape)
    ways_m[_on_ice(poses[:-1], faults), 0] *= 1 + _SPINNING
    unplugged = [is_during(TRUTH_PERIOD_S * i, faults.unplugged_s) for i in range(len(ways_m))]
    rolled = np.vstack([np.zeros(ways_m.shape[1]), np.cumsum(ways_m, axis=0)]) / wheels.m_per_tick
    counts = np.floor(rolled + rng.random(ways_m.shape[1]))
    lost = np.cumsum(np.diff(counts, axis=0) * np.array(unplugged)[:, None], axis=0)
    return np.asarray(counts - np.vstack([np.zeros(ways_m.shape[1]), lost]))


def _true_wheels(settings: SimulationSettings) -> HolonomicWheels:
    """Those that count; of a base that has increments ready, four mecanum wheels."""
    return _WHEELS["mecanum" if settings.base == "increments" else settings.base]


def _on_ice(poses: FloatArray, faults: WheelFaults) -> FloatArray:
    """(N,) whether the base is on a patch."""
    found = np.zeros(len(poses), bool)
    for patch in faults.patches:
        found |= np.hypot(poses[:, 0] - patch.x_m, poses[:, 1] - patch.y_m) < patch.radius_m
    return found


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


def _yaw_rates(settings: SimulationSettings, stamps_s: FloatArray, steps: FloatArray) -> tuple[YawRate, ...]:
    gyroscope = Gyroscope(Gyro(), np.random.default_rng([settings.day_seed, 2]))
    every = ticks_of(GYRO_PERIOD_S)
    rates = np.append(steps[:, 2], steps[-1, 2])[::every] / TRUTH_PERIOD_S
    return tuple(gyroscope.read(s, rate) for s, rate in zip(stamps_s[::every].tolist(), rates.tolist(), strict=True))
