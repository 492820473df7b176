"""What wheels meet: tyres that creep under load, patches of low friction, a floor that is not quite level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.simulation.realism.floor import Floor
from wheelsight.simulation.realism.tyres import LoadedRadii, TyreSettings
from wheelsight.simulation.robot import Patch
from wheelsight.simulation.wheelchair import CASTOR_RADIUS_M, PREFIX, ROLLING, TIMESTEP_S

if TYPE_CHECKING:
    import mujoco

_CREEP_STIFFNESS = 10.0
_SLOWEST_M_S = 0.02
_STIFFEST_PER_S = 1 / TIMESTEP_S
_SLOPE_STEP_M = 0.005
_SLOPE, _WAVES, _WAVE_LENGTH_M = 0.002, 12, (0.5, 4.0)


@dataclass(frozen=True, slots=True, eq=False)
class Underfoot:
    """A floor with thresholds and carpets, and tyres that give way."""

    floor: Floor
    tyres: TyreSettings


class Tyres:
    """How each rolling wheel grips.

    Rubber under a tangential force rolls a little less than its turns say: the slip over the wheel's speed is the force
    over a stiffness that grows with the load. Ten times the load a unit of slip is at the soft end of what tyres have
    (Pacejka, Tire and Vehicle Dynamics, ch. 1: the slopes of the curves of force against slip). MuJoCo's friction
    creeps too, by (R / b) · force with the regularisation R of the contact and the rate b at which it takes slip back;
    b is set to the wheel's speed, so that creep is in proportion to it and nothing creeps at rest.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        radii_m: Sequence[float],
        patches: Sequence[Patch],
        *,
        creep: bool,
        underfoot: Underfoot | None = None,
    ) -> None:
        self._model, self._patches, self._creeps, self._underfoot = model, patches, creep, underfoot
        self._loaded: LoadedRadii | None = None
        self._pairs = [model.pair(name).id for name in ROLLING]
        self._geoms = [model.geom(PREFIX + name).id for name in ROLLING]
        self._speeds = [int(model.joint(PREFIX + name).dofadr[0]) for name in ROLLING]
        self._radii_m = (*radii_m, CASTOR_RADIUS_M, CASTOR_RADIUS_M)
        self._friction = float(model.pair_friction[self._pairs[0], 0])
        self._rates = [_STIFFEST_PER_S * _SLOWEST_M_S] * len(ROLLING)

    def weigh(self, data: mujoco.MjData) -> None:
        """Takes each wheel's load from a wheelchair that stands still."""
        for i, row in enumerate(self._rows(data)):
            if row >= 0:
                self._rates[i] = float(data.efc_R[row + 1] * data.efc_force[row]) * _CREEP_STIFFNESS
        if self._underfoot is not None:
            self._loaded = LoadedRadii(np.array(self._radii_m), self.loads_n(data), self._underfoot.tyres)

    def loads_n(self, data: mujoco.MjData) -> FloatArray:
        """(4,) load of each wheel in newton; 0 for one in the air."""
        return np.array([float(data.efc_force[row]) if row >= 0 else 0.0 for row in self._rows(data)])

    def _rows(self, data: mujoco.MjData) -> list[int]:
        """Where MuJoCo has the contact of each wheel among its constraints; -1 for one in the air."""
        contacts = data.contact
        of_geom = dict(zip(contacts.geom[:, 1].tolist(), contacts.efc_address.tolist(), strict=True))
        return [of_geom.get(geom, -1) for geom in self._geoms]

    def places(self, data: mujoco.MjData) -> FloatArray:
        """(4, 2) where the wheels stand."""
        return np.asarray(data.geom_xpos[self._geoms, :2])

    def rolled(self, data: mujoco.MjData, seconds: float) -> FloatArray:
        """(4,) how far each wheel turns a turn of a wheel under its load at rest; 1 where tyres do not give way."""
        if self._loaded is None:
            return np.ones(len(ROLLING))
        return np.array(self._radii_m) / self._loaded.after(self.loads_n(data), seconds)

    def grip(self, data: mujoco.MjData) -> None:
        """Sets friction and creep for where the wheels stand and how fast they turn."""
        if self._creeps:
            rates = self._rates if self._underfoot is None else self._rates_on(self._underfoot.floor, data)
            for pair, dof, rate, radius_m in zip(self._pairs, self._speeds, rates, self._radii_m, strict=True):
                speed_m_s = max(abs(float(data.qvel[dof])) * radius_m, _SLOWEST_M_S)
                self._model.pair_solreffriction[pair] = 0.0, -min(rate / speed_m_s, _STIFFEST_PER_S)
        if self._patches:
            for pair, geom in zip(self._pairs, self._geoms, strict=True):
                x, y = data.geom_xpos[geom, :2].tolist()
                self._model.pair_friction[pair, :2] = self._friction_at(x, y)

    def _rates_on(self, floor: Floor, data: mujoco.MjData) -> list[float]:
        """Of creep, by what each wheel stands on."""
        softer = np.where(floor.is_carpet(self.places(data)), floor.settings.carpet_creep, 1.0)
        return [rate * share for rate, share in zip(self._rates, softer.tolist(), strict=True)]

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


def drag_n(floor: Floor, places: FloatArray, loads_n: FloatArray, ahead: FloatArray, speed_m_s: float) -> float:
    """Force in newton along `ahead` (2,) on wheels at places (W, 2) that climb thresholds or roll on carpet.

    A wheel that carries a load up a slope is pushed back by the load's share along it.
    """
    step = ahead * _SLOPE_STEP_M
    rise = (floor.height_m(places + step) - floor.height_m(places - step)) / (2 * _SLOPE_STEP_M)
    carpet = floor.is_carpet(places) * floor.settings.carpet_drag * math.tanh(speed_m_s / _SLOWEST_M_S)
    return -float(loads_n @ (rise + carpet))
