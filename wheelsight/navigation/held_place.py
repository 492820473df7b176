"""HeldPlace: a place in the map that the wheels carry on for a moment, while the localization is less sure than it was.

Somebody who walks past close to the camera contradicts the wheels for a second; until it is settled who was right, the
localization states tens of centimetres, and its place leaps by as much. Wheels are off by millimetres in that time,
unless it is they that slip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import FloatArray, se2
from wheelsight.navigation.navigator_settings import HoldSettings


@dataclass(frozen=True, slots=True, eq=False)
class HeldPlace:
    """As the localization had it.

    Attributes:
        T_map_base: (3, 3) where the base was.
        T_wheels: (3, 3) where the wheels alone had it then, in a frame of their own.
        sigma_m: standard deviation along the worse axis, as the localization stated.
        stamp_s: when.
    """

    T_map_base: FloatArray
    T_wheels: FloatArray
    sigma_m: float
    stamp_s: float

    def carried(self, T_wheels: FloatArray) -> FloatArray:
        """(3, 3) where the base is once the wheels have it at (3, 3)."""
        return np.asarray(self.T_map_base @ se2.invert(self.T_wheels) @ T_wheels)

    def sigma_at(self, T_wheels: FloatArray, settings: HoldSettings) -> float:
        """Metres: as sure as wheels leave it, once they have the base at (3, 3)."""
        return float(np.hypot(self.sigma_m, settings.wheels_share * self._way_m(T_wheels)))

    def holds(self, sigma_m: float, T_wheels: FloatArray, stamp_s: float, settings: HoldSettings) -> bool:
        """Whether it is better still than what the localization states to be known to `sigma_m` now."""
        s = settings
        is_late = stamp_s - self.stamp_s > s.seconds or self._way_m(T_wheels) > s.way_m
        is_sure = sigma_m <= max(self.sigma_at(T_wheels, s), s.sure_m)
        return not is_late and not is_sure and np.isfinite(sigma_m)

    def _way_m(self, T_wheels: FloatArray) -> float:
        """As the crow flies, since."""
        x, y, _ = se2.to_parts(se2.invert(self.T_wheels) @ T_wheels)
        return float(np.hypot(x, y))
