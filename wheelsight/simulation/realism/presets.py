"""How hard a simulation is: nothing but the sensors' noise, or all that a robot's sensors are known to do."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Literal, get_args

import numpy as np

from wheelsight.errors import ConfigError
from wheelsight.simulation.realism.body import BodySettings
from wheelsight.simulation.realism.control import ControlSettings
from wheelsight.simulation.realism.floor import Floor, FloorSettings
from wheelsight.simulation.realism.lens import LensSettings
from wheelsight.simulation.realism.lights import LightSettings
from wheelsight.simulation.realism.mount import MountSettings
from wheelsight.simulation.realism.pixels import PixelSettings
from wheelsight.simulation.realism.registration import RegistrationSettings
from wheelsight.simulation.realism.shadows import ShadowSettings
from wheelsight.simulation.realism.stamps import StampSettings
from wheelsight.simulation.realism.sunlight import SunlightSettings
from wheelsight.simulation.realism.tyres import TyreSettings
from wheelsight.simulation.realism.wheel_sizes import WheelSizeSettings
from wheelsight.simulation.world import World

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

    def floor_of(self, world: World, seed: int) -> Floor:
        """The floor of a world."""
        return Floor(world, self.floor, stream(seed, "floor"))


def realism_names() -> tuple[str, ...]:
    """What `--realism` takes."""
    return get_args(RealismName)


def realism_of(name: str) -> Realism | None:
    """The parts of a preset; None for the ideal one, which has none. Raises ConfigError for a name that is none."""
    if name not in realism_names():
        near = get_close_matches(name, realism_names(), n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ConfigError(f"--realism is {name}", fix=f"{hint}choose from {', '.join(realism_names())}")
    return Realism() if name == "real" else None


def stream(seed: int, part: str) -> np.random.Generator:
    """Random numbers of one part of a drive: other parts, added or left out, do not change them."""
    return np.random.default_rng([seed, zlib.crc32(part.encode())])
