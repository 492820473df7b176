"""Stamps of readings that are told while a robot drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.simulation.realism.stamps import SHORTEST_S, STAMP_DECIMALS, Reading, StampSettings


class Delays:
    """Stamps readings one by one as `realism.stamps.as_stamped` does those of a whole drive; None leaves them exact."""

    def __init__(self, settings: StampSettings | None, rng: np.random.Generator) -> None:
        self._settings, self._rng = settings, rng
        self._last_s = -np.inf

    def stamped(self, reading: Reading) -> Reading:
        """The reading with the stamp of the host; stamps grow."""
        settings = self._settings
        if settings is None:
            return reading
        late_s = abs(settings.wheel_jitter_s * self._rng.standard_normal())
        if self._rng.random() < settings.burst_share:
            late_s += self._rng.uniform(0, settings.burst_s)
        self._last_s = max(reading.stamp_s + late_s, self._last_s + SHORTEST_S)
        return replace(reading, stamp_s=round(float(self._last_s), STAMP_DECIMALS))
