"""The motors of a simulated wheelchair: a duty becomes a speed of the wheel's rim, late."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.wheel_control import Duties


@dataclass(frozen=True, slots=True)
class MotorSettings:
    """How motors answer.

    Attributes:
        full_speed_m_s: of a rim at a duty of 1: 157 pulses of 0.33 mm in 20 ms (Trinh et al., II.C).
        spread: deviation of that from motor to motor, as a share. Chosen.
        lag_s: time constant. Chosen: the joystick's filter of docs/firmware.md has 0.01 s, the chair's own controller
            and the motors the rest.
    """

    full_speed_m_s: float = 2.6
    spread: float = 0.03
    lag_s: float = 0.1


class Motors:
    """Of both driven wheels; how strong each is comes by chance, or not where `rng` is None."""

    def __init__(self, settings: MotorSettings | None = None, rng: np.random.Generator | None = None) -> None:
        self._settings = settings or MotorSettings()
        shares = np.ones(2) if rng is None else 1 + self._settings.spread * rng.standard_normal(2)
        self._full_m_s = self._settings.full_speed_m_s * shares
        self._rims_m_s: FloatArray = np.zeros(2)

    def after(self, duties: Duties, seconds: float) -> tuple[float, float]:
        """Speeds that the rims of the left and right wheel would have, were there nothing in their way."""
        share = 1 - math.exp(-seconds / self._settings.lag_s)
        wanted = self._full_m_s * (duties.left, duties.right)
        self._rims_m_s = self._rims_m_s + share * (wanted - self._rims_m_s)
        return float(self._rims_m_s[0]), float(self._rims_m_s[1])
