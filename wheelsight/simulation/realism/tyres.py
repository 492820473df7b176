"""Tyres that are pressed in by the load they carry."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import FloatArray


@dataclass(frozen=True, slots=True)
class TyreSettings:
    """How soft tyres are.

    Attributes:
        stiffness_n_m: load that presses a tyre in by a metre: 80 kN/m, as in `BodySettings`.
        rolling_share: how much of that the rolling radius loses; tyres with a stiff tread roll by a radius that lies
            between the free and the loaded one, nearer to the free one (Pacejka, Tire and Vehicle Dynamics, ch. 1).
        settling_s: over which time loads are averaged: contacts of MuJoCo's stiff floor ring, tyres do not. Chosen.
    """

    stiffness_n_m: float = 80_000.0
    rolling_share: float = 0.4
    settling_s: float = 0.1


class LoadedRadii:
    """Rolling radii of wheels, from their loads.

    Args:
        radii_m: (W,) at the loads at rest.
        loads_n: (W,) these.
        settings: how soft the tyres are.
    """

    def __init__(self, radii_m: FloatArray, loads_n: FloatArray, settings: TyreSettings) -> None:
        self._radii_m, self._rest_n = np.array(radii_m, float), np.array(loads_n, float)
        self._loads_n = self._rest_n.copy()
        self._settings = settings

    def after(self, loads_n: FloatArray, seconds: float) -> FloatArray:
        """(W,) the radii after so long under loads (W,) in newton."""
        keep = math.exp(-seconds / self._settings.settling_s)
        self._loads_n = keep * self._loads_n + (1 - keep) * np.asarray(loads_n, float)
        pressed_m = self._settings.rolling_share * (self._loads_n - self._rest_n) / self._settings.stiffness_n_m
        return np.asarray(self._radii_m - pressed_m)
