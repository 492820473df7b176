"""What a simulation is made of: all that must be known to make the same recording again."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from wheelsight.core.errors import ConfigError
from wheelsight.core.files import StrPath
from wheelsight_sim.appearance import LightSettings, ShadowSettings, SunlightSettings
from wheelsight_sim.body_motion import BodySettings, FloorSettings, FloorSurface, MountSettings, TyreSettings
from wheelsight_sim.color_sensor import ControlSettings, LensSettings, PixelSettings
from wheelsight_sim.depth_sensor import RegistrationSettings
from wheelsight_sim.drivers import MAX_SPEED_M_S
from wheelsight_sim.readings import StampSettings
from wheelsight_sim.robot import RobotModel, WheelFaults, WheelSizeSettings
from wheelsight_sim.world import World

_LONGEST_WAY_M = 20_000.0


@dataclass(frozen=True, slots=True)
class FloorPlan:
    """A plan that a world is to be made of.

    Attributes:
        path: of a map in ROS map_server's format (its YAML file), or of a bare image.
        resolution_m: side of a pixel of a bare image; None for a YAML file.
        areas: image of the same size that shows the rooms, one colour each or parted by lines; None for no areas.
        start: x, y in metres and yaw in radians in the frame `map` where the base begins; None for a roomy place.
        way_m: how far the route leads at least, where the building has a tour; None for one lap of up to 100 m.

    Raises:
        ConfigError: a start that is not finite, or a way of no length.
    """

    path: StrPath
    resolution_m: float | None = None
    areas: StrPath | None = None
    start: tuple[float, float, float] | None = None
    way_m: float | None = None

    def __post_init__(self) -> None:
        if self.start is not None and not all(map(math.isfinite, self.start)):
            raise ConfigError(f"--start is {self.start}", fix="x and y in metres and yaw in radians")
        if self.way_m is not None and not 0 < self.way_m <= _LONGEST_WAY_M:
            raise ConfigError(f"--way is {self.way_m:g} m", fix=f"over 0, up to {_LONGEST_WAY_M:g} m")

    @property
    def name(self) -> str:
        """What the world is called: the file's name without its ending."""
        return Path(self.path).stem


RealismName = Literal["ideal", "real"]


@dataclass(frozen=True, slots=True)
class Realism:
    """All that a real robot's sensors do beside their noise, one part each; what is random comes from the drive's seed.

    Attributes:
        lens, registration, control, pixels: of the camera; one without error of its own has none of them.
        mount, wheel_sizes, body, floor, tyres: of the robot and the floor under it.
        stamps: of what the sensors say.
        sunlight, lights, shadows: of the building.
    """

    lens: LensSettings = field(default_factory=LensSettings)
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    control: ControlSettings = field(default_factory=ControlSettings)
    pixels: PixelSettings = field(default_factory=PixelSettings)
    mount: MountSettings = field(default_factory=MountSettings)
    wheel_sizes: WheelSizeSettings = field(default_factory=WheelSizeSettings)
    body: BodySettings = field(default_factory=BodySettings)
    floor: FloorSettings = field(default_factory=FloorSettings)
    tyres: TyreSettings = field(default_factory=TyreSettings)
    stamps: StampSettings = field(default_factory=StampSettings)
    sunlight: SunlightSettings = field(default_factory=SunlightSettings)
    lights: LightSettings = field(default_factory=LightSettings)
    shadows: ShadowSettings = field(default_factory=ShadowSettings)

    def floor_of(self, world: World, seed: int) -> FloorSurface:
        """The floor of a world."""
        return FloorSurface(world, self.floor, stream(seed, "floor"))


def realism_names() -> tuple[str, ...]:
    """What `--realism` takes."""
    return get_args(RealismName)


def realism_of(name: str) -> Realism | None:
    """The parts of a preset; None for the ideal one, which has none. Raises ConfigError for a name that is none."""
    refuse_unknown(name, realism_names(), f"--realism is {name}")
    return Realism() if name == "real" else None


def refuse_unknown(name: str, known: tuple[str, ...], problem: str) -> None:
    """Raise ConfigError for a name that is not known, with the nearest that is."""
    if name not in known:
        near = get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ConfigError(problem, fix=f"{hint}choose from {', '.join(known)}")


def stream(seed: int, part: str) -> np.random.Generator:
    """Random numbers of one part of a drive: other parts, added or left out, do not change them."""
    return np.random.default_rng([seed, zlib.crc32(part.encode())])


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
        robot: as it truly is; its owner believes in `RobotModel()`.
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
    robot: RobotModel = field(default_factory=RobotModel)
    faults: WheelFaults = field(default_factory=WheelFaults)
    covered_s: tuple[tuple[float, float], ...] = ()
    realism: RealismName = "ideal"
    plan: FloorPlan | None = None
    base: BaseName = "differential"

    def __post_init__(self) -> None:
        if self.base not in get_args(BaseName):
            raise ConfigError(f"--base is {self.base!r}", fix=f"one of {', '.join(get_args(BaseName))}")
        realism_of(self.realism)
        counts = {"--laps": (self.laps, 1, 1000), "--seed": (self.seed, 0, 2**32 - 1), "--day": (self.day, 0, 100_000)}
        counts |= {"--passers-by": (self.passersby, 0, 100), "--doors": (self.doors, 0, 1000)}
        for option, (count, least, most) in counts.items():
            if not least <= count <= most:
                raise ConfigError(f"{option} is {count}", fix=f"{least} to {most}")
        ranges: dict[str, tuple[float | None, float, str]]
        ranges = {"--speed": (self.speed_m_s, MAX_SPEED_M_S, "m/s"), "--rate": (self.rate_hz, 120, "Hz")}
        ranges |= {"--duration": (self.duration_s, 24 * 3600, "s")}
        for option, (value, limit, unit) in ranges.items():
            if value is not None and not (math.isfinite(value) and 0 < value <= limit):
                raise ConfigError(f"{option} is {value:g} {unit}", fix=f"over 0, up to {limit:g} {unit}")
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


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(inner) for inner in value]
    return value.name if isinstance(value, Path) else value
