"""What the words of `wheelsight map zone` mean."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from wheelsight.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.geometry import FloatArray
    from wheelsight.mapping import MapEdit

_WHICH = "--keep-out, --speed M_S, --wipe or --area NAME"
_FORM = "X,Y in metres in the map, such as 2,-1 3,-1 3,0.5; two are opposite corners of a rectangle"


@dataclass(frozen=True, slots=True)
class AskedZone:
    """What was typed: one of what is there, and corners, for which it is; without any of it, a list.

    Attributes:
        corners: words, of one or more corners each.
        keep_out, speed_m_s, wipe, area: what is in them.
        areas: an areas.yaml.
        forget: number in the list, from 1 on.
    """

    corners: tuple[str, ...]
    keep_out: bool
    speed_m_s: float | None
    wipe: bool
    area: str | None
    areas: Path | None
    forget: int | None

    @property
    def told(self) -> str | None:
        """The first option that was given."""
        return next(iter(self._options()), None)

    def _options(self) -> list[str]:
        values = (self.keep_out or None, self.speed_m_s, self.wipe or None, self.area, self.areas, self.forget)
        names = ("--keep-out", "--speed", "--wipe", "--area", "--areas", "--forget")
        return [name for name, value in zip(names, values, strict=True) if value is not None]

    def check(self) -> None:
        """Raises ConfigError for what means nothing together."""
        for word in self.corners:
            if word.startswith("-") and not word[1:2].isdigit() and word[1:2] != ".":
                raise ConfigError(f"there is no option {word}", fix=f"{_WHICH}; --areas FILE or --forget NUMBER")
        options = self._options()
        if len(options) > 1:
            raise ConfigError(f"{options[0]} and {options[1]} are given at once", fix="one after another")
        if not options and self.corners:
            raise ConfigError("what is in these corners is not said", fix=_WHICH)
        if self.told in ("--areas", "--forget") and self.corners:
            raise ConfigError(f"{self.told} has no corners", fix="leave them out")
        if self.speed_m_s is not None and not 0 < self.speed_m_s < math.inf:
            raise ConfigError(
                f"--speed is {self.speed_m_s:g}", fix="metres a second, over 0, such as 0.3; or --keep-out"
            )


def drawn_by(asked: AskedZone) -> Sequence[MapEdit]:
    """What is to be drawn, hung on no keyframe. Raises ConfigError, MapError, AreaError."""
    from wheelsight.areas import load_areas
    from wheelsight.mapping import EditKind, MapEdit

    if asked.areas is not None:
        return [MapEdit(EditKind.AREA, area.polygon, name=area.name) for area in load_areas(asked.areas)]
    if asked.forget is not None:
        return []
    polygon = _polygon_of(asked.told or "", asked.corners)
    if asked.speed_m_s is not None:
        return [MapEdit(EditKind.SPEED, polygon, limit_m_s=asked.speed_m_s)]
    if asked.area is not None:
        return [MapEdit(EditKind.AREA, polygon, name=asked.area)]
    return [MapEdit(EditKind.KEEP_OUT if asked.keep_out else EditKind.WIPED, polygon)]


def _polygon_of(option: str, words: Sequence[str]) -> FloatArray:
    """(N, 2) corners of words such as "2,-1" or "2,-1 3,-1 3,0.5". Raises ConfigError."""
    import numpy as np

    corners = [_corner(text) for word in words for text in word.split()]
    if len(corners) < 2:
        raise ConfigError(f"{option} has {'one corner' if corners else 'no corners'}", fix=_FORM)
    if len(corners) == 2:
        (x, y), (far_x, far_y) = corners
        corners = [(x, y), (far_x, y), (far_x, far_y), (x, far_y)]
    return np.array(corners)


def _corner(text: str) -> tuple[float, float]:
    try:
        x_m, y_m = map(float, text.split(","))
    except ValueError:
        x_m = y_m = math.nan
    if not math.isfinite(x_m) or not math.isfinite(y_m):
        raise ConfigError(f"{text!r} is no corner", fix=_FORM)
    return x_m, y_m
