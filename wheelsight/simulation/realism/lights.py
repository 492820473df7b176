"""Lamps that go on and off while the robot drives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wheelsight.simulation.lighting import Lighting


@dataclass(frozen=True, slots=True)
class LightSettings:
    """How often light changes.

    Attributes:
        every_s: mean time between two switches. Chosen: motion detectors in corridors wait minutes, people switch
            lamps when they come and go.
        dimmed: (least, most) share of the lamps' light that is left while some of them are off. Chosen.
    """

    every_s: float = 40.0
    dimmed: tuple[float, float] = (0.35, 0.8)


class Lights:
    """The switches of one drive. All lamps are dimmed alike, those seen directly too."""

    def __init__(self, settings: LightSettings, duration_s: float, rng: np.random.Generator) -> None:
        count = int(rng.poisson(duration_s / settings.every_s))
        self._switches_s = np.sort(rng.uniform(0, duration_s, count))
        self._levels = np.concatenate([[1.0], rng.uniform(*settings.dimmed, count)])
        self._levels[2::2] = 1.0

    def level_at(self, stamp_s: float) -> float:
        """Share of the lamps' light at a time."""
        return float(self._levels[np.searchsorted(self._switches_s, stamp_s, side="right")])

    def lit(self, lighting: Lighting, stamp_s: float) -> Lighting:
        """A building's lighting as it is at a time."""
        tints = lighting.tints.copy()
        level = self.level_at(stamp_s)
        tints[1] *= level
        tints[0] *= 0.5 * (1 + level)  # half of the light from all round is that of lamps
        return replace(lighting, tints=tints)
