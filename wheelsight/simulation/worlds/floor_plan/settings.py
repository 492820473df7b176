"""Which floor plan a world is made of, and how far the robot is to drive in it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from wheelsight.errors import ConfigError
from wheelsight.files import StrPath

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
