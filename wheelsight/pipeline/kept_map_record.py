"""KeptMapRecord and KnownMapRecord: the map folder that a run leaves, and the one in which it found itself."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from wheelsight.pipeline import words


@dataclass(frozen=True, slots=True)
class KeptMapRecord:
    """The map folder of one track.

    Attributes:
        file: its name in the track's folder.
        keyframes: how many it holds.
        bytes: of all its files.
        warnings: what could not be written, and why.
    """

    file: str
    keyframes: int
    bytes: int
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """For metrics.json."""
        return {name: value for name, value in asdict(self).items() if name != "warnings"}

    @property
    def sentence(self) -> str:
        """How large it is."""
        return f"{self.keyframes:,} keyframes, {self.bytes / 1e6:.1f} MB"


@dataclass(frozen=True, slots=True)
class KnownMapRecord:
    """Whether a drive found itself in the map of an earlier one.

    Attributes:
        path: of the map's folder.
        after_s: seconds from the first frame to the first pose in the map; None where there was none on the way.
        x_m, y_m, z_m, yaw_rad: where in the map that pose was; the heading is None of a camera alone.
        sigma_m, sigma_rad: how surely, one standard deviation along the worst direction, and of the turn about the
            worst axis; None where that is not known.
        views: how often the drive saw something of the map, up to its end.
        keyframes, keyframes_placed: of this drive, and of how many it is known where in the map they lie.
        has_start: whether the user said where it begins.
    """

    path: str
    after_s: float | None = None
    x_m: float | None = None
    y_m: float | None = None
    z_m: float | None = None
    yaw_rad: float | None = None
    sigma_m: float | None = None
    sigma_rad: float | None = None
    views: int = 0
    keyframes: int = 0
    keyframes_placed: int = 0
    has_start: bool = False

    @property
    def is_recognised(self) -> bool:
        """Whether something of the map was seen, so that it is known where in it the drive lies."""
        return self.views > 0 and self.keyframes_placed > 0

    def to_dict(self) -> dict[str, Any]:
        """For metrics.json."""
        return {**asdict(self), "is_recognised": self.is_recognised}

    @property
    def sentence(self) -> str:
        """Whether, after how long, where, and how surely it was recognised."""
        if not self.is_recognised:
            if self.has_start:
                return f"The place was not recognised in the map {self.path}: poses rest on --start alone"
            return f"The place was not recognised in the map {self.path}: there are no poses in it"
        seen = f"{words.count(self.views, 'view')} of the map seen again"
        if self.after_s is None:
            return f"Recognised in the map {self.path} only after the drive: no pose on the way is in it; {seen}"
        where = f"x {self.x_m:.2f} m, y {self.y_m:.2f} m, "
        where += f"z {self.z_m:.2f} m" if self.yaw_rad is None else f"heading {math.degrees(self.yaw_rad):.0f}°"
        sure = "how surely is not known"
        if self.sigma_m is not None and self.sigma_rad is not None:
            sure = f"1σ {words.length(self.sigma_m)} and {words.angle(math.degrees(self.sigma_rad))}"
        after = words.duration(self.after_s)
        return f"Recognised in the map {self.path} after {after}, at {where} ({sure}); {seen}"
