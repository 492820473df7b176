"""What a simulation is made of: all that must be known to make the same recording again."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from wheelsight.errors import ConfigError
from wheelsight.files import StrPath
from wheelsight.simulation.drivers import MAX_SPEED_M_S
from wheelsight.simulation.realism import RealismName, realism_of
from wheelsight.simulation.robot import Robot, WheelFaults
from wheelsight.simulation.worlds.floor_plan.settings import FloorPlan

BaseName = Literal["differential", "mecanum", "omni-3", "omni-4", "increments"]

_LARGEST_PX = 4096
_SMALLEST_PX = 16


@dataclass(frozen=True)
class SimulationSettings:
    """A world, a robot, a way through the world, and a camera; equal settings make equal recordings, byte for byte.

    Attributes:
        base: "differential": a wheelchair, moved by physics; "mecanum", "omni-3", "omni-4": a holonomic base that
            looks elsewhere than where it goes; "increments": one whose own odometry is read.
        world: one of `world_names()`; not looked at where there is a plan.
        camera: one of `camera_names()`.
        size: (width, height) of the images in pixels, or None for the camera's own.
        rate_hz: images a second, or None for the camera's own.
        laps: how often the world's route is driven.
        seed: of everything random: textures, lighting, noise, passers-by, slip.
        day: another one has other light, people, noise and slip, and chairs and bins stand elsewhere; building, robot
            and camera stay those of the seed.
        speed_m_s: of the robot on straights, up to 1.2.
        duration_s: ends the drive after so long, or None for the whole route.
        is_reverse: drives the route from its end to its start.
        velocities: CSV of velocities to be driven in place of the route, `stamp_s,v_m_s,yaw_rate_rad_s`, or None.
        stops_to_turn: whether the robot stops at each waypoint and turns on the spot, rather than round the corner.
        passersby: how many people walk about.
        doors: how many doors open and shut while the robot drives; which and when is another on each day.
        has_motion_blur: whether colour images are smeared by the camera's motion during exposure.
        realism: one of `realism_names()`: "ideal" has nothing but the sensors' noise, "real" all that real sensors
            and robots do beside it, motion blur included.
        has_slip: whether wheels slip on the floor.
        robot: as it truly is; its owner believes in `Robot()`.
        faults: of the wheels.
        covered_s: (from, to) times in which something lies on the camera.
        plan: a floor plan that a world is made of, in place of a built-in one.

    Raises:
        ConfigError: a value out of its range; names the option of `wheelsight simulate` that sets it.
    """

    world: str = "floor4"
    camera: str = "kinect-v1"
    size: tuple[int, int] | None = (320, 240)
    rate_hz: float | None = None
    laps: int = 1
    seed: int = 0
    day: int = 0
    speed_m_s: float = 0.8
    duration_s: float | None = None
    is_reverse: bool = False
    velocities: StrPath | None = None
    stops_to_turn: bool = False
    passersby: int = 0
    doors: int = 0
    has_motion_blur: bool = False
    has_slip: bool = True
    robot: Robot = field(default_factory=Robot)
    faults: WheelFaults = field(default_factory=WheelFaults)
    covered_s: tuple[tuple[float, float], ...] = ()
    realism: RealismName = "ideal"
    plan: FloorPlan | None = None
    base: BaseName = "differential"

    def __post_init__(self) -> None:
        if self.base not in get_args(BaseName):
            raise ConfigError(f"--base is {self.base!r}", fix=f"one of {', '.join(get_args(BaseName))}")
        realism_of(self.realism)
        _check_whole("--laps", self.laps, 1, 1000)
        _check_whole("--seed", self.seed, 0, 2**32 - 1)
        _check_whole("--day", self.day, 0, 100_000)
        _check_whole("--passers-by", self.passersby, 0, 100)
        _check_whole("--doors", self.doors, 0, 1000)
        _check_range("--speed", self.speed_m_s, MAX_SPEED_M_S, "m/s")
        if self.rate_hz is not None:
            _check_range("--rate", self.rate_hz, 120, "Hz")
        if self.duration_s is not None:
            _check_range("--duration", self.duration_s, 24 * 3600, "s")
        if self.size is not None and not all(_SMALLEST_PX <= side <= _LARGEST_PX for side in self.size):
            raise ConfigError(f"--size is {self.size[0]}x{self.size[1]}", fix=f"{_SMALLEST_PX} to {_LARGEST_PX} pixels")
        if self.velocities is not None and (self.is_reverse or self.stops_to_turn or self.laps != 1):
            raise ConfigError("--drive has no route, so --laps, --reverse and --stop-and-turn mean nothing with it")

    @property
    def day_seed(self) -> int:
        """Of what is another on each day; on day 0 the seed itself."""
        return zlib.crc32(f"{self.seed}, day {self.day}".encode()) if self.day else self.seed

    def to_dict(self) -> dict[str, Any]:
        """Plain nested values under the same names, in lists and numbers that YAML keeps exactly."""
        plain = _plain(asdict(self) | ({} if self.plan is None else {"world": self.plan.name}))
        assert isinstance(plain, dict)
        return plain


def _check_whole(option: str, value: int, least: int, most: int) -> None:
    if not least <= value <= most:
        raise ConfigError(f"{option} is {value}", fix=f"{least} to {most}")


def _check_range(option: str, value: float, most: float, unit: str) -> None:
    if not (math.isfinite(value) and 0 < value <= most):
        raise ConfigError(f"{option} is {value:g} {unit}", fix=f"over 0, up to {most:g} {unit}")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(inner) for inner in value]
    return value.name if isinstance(value, Path) else value
