"""What wheels meet: tyres that creep under load, patches of low friction, a floor that is not quite level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.simulation.robot import Patch
from wheelsight.simulation.wheelchair import CASTOR_RADIUS_M, PREFIX, ROLLING, TIMESTEP_S

if TYPE_CHECKING:
    import mujoco

_CREEP_STIFFNESS = 10.0
_SLOWEST_M_S = 0.02
_STIFFEST_PER_S = 1 / TIMESTEP_S
_SLOPE, _WAVES, _WAVE_LENGTH_M = 0.002, 12, (0.5, 4.0)


class Tyres:
    """How each rolling wheel grips.

    Rubber under a tangential force rolls a little less than its turns say: the slip over the wheel's speed is the force
    over a stiffness that grows with the load. Ten times the load a unit of slip is at the soft end of what tyres have
    (Pacejka, Tire and Vehicle Dynamics, ch. 1: the slopes of the curves of force against slip). MuJoCo's friction
    creeps too, by (R / b) · force with the regularisation R of the contact and the rate b at which it takes slip back;
    b is set to the wheel's speed, so that creep is in proportion to it and nothing creeps at rest.
    """

    def __init__(
        self, model: mujoco.MjModel, radii_m: Sequence[float], patches: Sequence[Patch], *, creep: bool
    ) -> None:
        self._model, self._patches, self._creeps = model, patches, creep
        self._pairs = [model.pair(name).id for name in ROLLING]
        self._geoms = [model.geom(PREFIX + name).id for name in ROLLING]
        self._speeds = [int(model.joint(PREFIX + name).dofadr[0]) for name in ROLLING]
        self._radii_m = (*radii_m, CASTOR_RADIUS_M, CASTOR_RADIUS_M)
        self._friction = float(model.pair_friction[self._pairs[0], 0])
        self._rates = [_STIFFEST_PER_S * _SLOWEST_M_S] * len(ROLLING)

    def weigh(self, data: mujoco.MjData) -> None:
        """Takes each wheel's load from a wheelchair that stands still."""
        of_geom = {int(contact.geom[1]): int(contact.efc_address) for contact in data.contact}
        for i, geom in enumerate(self._geoms):
            row = of_geom.get(geom, -1)
            if row >= 0:
                self._rates[i] = float(data.efc_R[row + 1] * data.efc_force[row]) * _CREEP_STIFFNESS

    def grip(self, data: mujoco.MjData) -> None:
        """Sets friction and creep for where the wheels stand and how fast they turn."""
        if self._creeps:
            for pair, dof, rate, radius_m in zip(self._pairs, self._speeds, self._rates, self._radii_m, strict=True):
                speed_m_s = max(abs(float(data.qvel[dof])) * radius_m, _SLOWEST_M_S)
                self._model.pair_solreffriction[pair] = 0.0, -min(rate / speed_m_s, _STIFFEST_PER_S)
        if self._patches:
            for pair, geom in zip(self._pairs, self._geoms, strict=True):
                x, y = data.geom_xpos[geom, :2].tolist()
                self._model.pair_friction[pair, :2] = self._friction_at(x, y)

    def _friction_at(self, x_m: float, y_m: float) -> float:
        for patch in self._patches:
            if math.hypot(x_m - patch.x_m, y_m - patch.y_m) < patch.radius_m:
                return patch.friction
        return self._friction


class UnevenFloor:
    """The slope of a floor with waves of decimetres to metres: 2 mm a metre, root mean square, along x and along y.

    The floor stays the plane z = 0 to wheels and camera; only the pull of gravity along it is the slope's.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        directions_rad = rng.uniform(0, 2 * math.pi, _WAVES)
        self._units = np.stack([np.cos(directions_rad), np.sin(directions_rad)], axis=-1)
        self._waves_per_m = 2 * math.pi / rng.uniform(*_WAVE_LENGTH_M, _WAVES)[:, None] * self._units
        self._phases_rad = rng.uniform(0, 2 * math.pi, _WAVES)

    def slope(self, x_m: float, y_m: float) -> FloatArray:
        """(2,) rise a metre along x and y."""
        heights = np.sin(self._waves_per_m @ (x_m, y_m) + self._phases_rad)
        return np.asarray(_SLOPE * 2 / math.sqrt(_WAVES) * (heights @ self._units))
