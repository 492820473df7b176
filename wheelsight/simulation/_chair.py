"""The wheelchair on its way through MuJoCo's time: motors in, pose and wheel angles out, faults as they come."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.simulation._ground import Tyres, Underfoot, UnevenFloor, drag_n
from wheelsight.simulation.doors import Leaves
from wheelsight.simulation.drivers import COMMAND_PERIOD_S
from wheelsight.simulation.encoders import is_during
from wheelsight.simulation.robot import Robot, WheelFaults
from wheelsight.simulation.wheelchair import LIFT_M, PREFIX, ROLLING, TIMESTEP_S, scene
from wheelsight.simulation.world import World

_GRAVITY_M_S2 = 9.81
_SWAY_N, _SWAY_S = 6.0, 1.0
_LIFT_M_S = 0.02
_RAMP_M_S2 = 1.5
_LARGEST_SWIVEL_RAD = 0.5
_FASTEST = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """The hull touches a geom `name` at `place_m` (2,); `towards` (2,) is the direction from the hull to it."""

    name: str
    place_m: FloatArray
    towards: FloatArray


class Chair:
    """One wheelchair in one world; each step reads the patches and lifts of its moment."""

    def __init__(
        self,
        world: World,
        robot: Robot,
        faults: WheelFaults,
        T_world_base: FloatArray,
        *,
        slip: bool,
        rng: np.random.Generator,
        underfoot: Underfoot | None = None,
        doors: Leaves | None = None,
    ) -> None:
        import mujoco

        self._mujoco, self._faults, self._slip, self._rng = mujoco, faults, slip, rng
        self._nominal = robot.nominal
        self._model = scene(world, robot, slip=slip, doors=doors)
        self._data = mujoco.MjData(self._model)
        radii_m = robot.left_radius_m, robot.right_radius_m
        self._tyres = Tyres(self._model, radii_m, faults.patches, creep=slip, underfoot=underfoot)
        self._underfoot = underfoot
        self._floor, self._sway_n = UnevenFloor(rng), np.zeros(2)
        base = self._model.joint(PREFIX + "base")
        self._body = int(base.bodyid[0])
        self._pose = self._data.qpos[int(base.qposadr[0]) :][:7]
        self._velocity = self._data.qvel[int(base.dofadr[0]) :][:6]
        self._angles = [int(self._model.joint(PREFIX + name).qposadr[0]) for name in ROLLING[:2]]
        self._hull = self._model.geom(PREFIX + "hull").id
        self._jack = self._model.geom(PREFIX + "jack").id
        self._lowest_m = float(self._model.geom_pos[self._jack, 2])
        self._jack_m = self._lowest_m + 2 * LIFT_M
        self._place(T_world_base)

    def _place(self, T_world_base: FloatArray) -> None:
        self._pose[:3] = T_world_base[:3, 3]
        self._pose[3:] = np.roll(so3.to_quaternion(T_world_base[:3, :3]), 1)
        for side in ("left", "right"):
            swivel = int(self._model.joint(f"{PREFIX}{side}_swivel").qposadr[0])
            self._data.qpos[swivel] = self._rng.uniform(-_LARGEST_SWIVEL_RAD, _LARGEST_SWIVEL_RAD)
        self._zero_rad = self._data.qpos[self._angles].copy()

    def settle(self, seconds: float) -> None:
        """Lets the wheelchair come to rest on its wheels, motors braked."""
        self._lift(False, 0.0)
        self._mujoco.mj_step(self._model, self._data, round(seconds / TIMESTEP_S))
        self._tyres.weigh(self._data)
        self._zero_rad = self._data.qpos[self._angles].copy()

    @property
    def pose(self) -> tuple[FloatArray, FloatArray]:
        """Position (3,) in metres and quaternion wxyz (4,) of T_world_base, as copies."""
        return self._pose[:3].copy(), self._pose[3:].copy()

    @property
    def T_world_base(self) -> FloatArray:
        """(4, 4), of now."""
        return se3.from_quaternion(self._pose[:3], np.roll(self._pose[3:], -1))

    @property
    def wheels_rad(self) -> FloatArray:
        """(2,) how far the left and right wheel have turned forward against the frame, since they settled."""
        return np.asarray(self._data.qpos[self._angles] - self._zero_rad)

    @property
    def swivels_rad(self) -> FloatArray:
        """(2,) directions of the left and right castor's fork against the frame; 0 for one that trails behind."""
        joints = [self._model.joint(f"{PREFIX}{side}_swivel") for side in ("left", "right")]
        return np.array([float(self._data.qpos[int(joint.qposadr[0])]) for joint in joints])

    @property
    def yaw_rate_rad_s(self) -> float:
        """About the base's z axis, as a gyroscope on it feels it."""
        return float(self._velocity[5])

    @property
    def velocity_m_s(self) -> FloatArray:
        """(2,) of the base over the floor, in the world."""
        return np.array(self._velocity[:2])

    @property
    def touches(self) -> list[Touch]:
        """What stands in the world and the hull touches."""
        contacts, found = self._data.contact, []
        for i in np.flatnonzero((contacts.geom == self._hull).any(axis=1)):
            one, other = contacts.geom[i]
            thing, sign = (other, 1.0) if one == self._hull else (one, -1.0)
            name = self._model.geom(thing).name
            found.append(Touch(name, contacts.pos[i, :2].copy(), sign * contacts.frame[i, :2]))
        return found

    def swing(self, middles_m: FloatArray, yaws_rad: FloatArray) -> None:
        """Put the leaves of doors where they are: middles (N, 3) and yaws (N,)."""
        self._data.mocap_pos[:] = middles_m
        self._data.mocap_quat[:, 0] = np.cos(yaws_rad / 2)
        self._data.mocap_quat[:, 3] = np.sin(yaws_rad / 2)

    @property
    def is_broken(self) -> bool:
        """Whether numbers run away; seen before MuJoCo itself does, which then starts anew and writes a log file."""
        return bool(self._data.warning.number.any() or not np.abs(self._data.qvel).max() < _FASTEST)

    def obey(self, v_m_s: float, yaw_rate_rad_s: float) -> None:
        """Sets the motors' speeds, by the wheels as the owner believes them to be; called every `COMMAND_PERIOD_S`.

        The motors' controller ramps what would throw the rider out of the seat.
        """
        across_m_s = yaw_rate_rad_s * self._nominal.track_width_m / 2
        self.turn_wheels((v_m_s - across_m_s, v_m_s + across_m_s))

    def turn_wheels(self, rims_m_s: tuple[float, float]) -> None:
        """The same by the speeds of the left and right wheel's rim."""
        step_rad_s = _RAMP_M_S2 * COMMAND_PERIOD_S / self._nominal.left_radius_m
        for i, rim_m_s in enumerate(rims_m_s):
            change = rim_m_s / self._nominal.left_radius_m - self._data.ctrl[i]
            self._data.ctrl[i] += min(max(change, -step_rad_s), step_rad_s)

    def step(self, stamp_s: float, steps: int) -> None:
        """Goes on by so many time steps with the floor, the rider and the faults of `stamp_s`."""
        if self._faults.lifted_s:
            self._lift(is_during(stamp_s, self._faults.lifted_s), steps * TIMESTEP_S)
        self._tyres.grip(self._data)
        if self._slip:
            self._disturb(steps * TIMESTEP_S)
        before_rad = self._data.qpos[self._angles].copy()
        self._mujoco.mj_step(self._model, self._data, steps)
        if self._underfoot is not None:
            # In place of smaller wheels, which ring on MuJoCo's stiff floor: the same way takes more of a turn.
            more = self._tyres.rolled(self._data, steps * TIMESTEP_S)[:2] - 1
            self._zero_rad -= more * (self._data.qpos[self._angles] - before_rad)

    def _lift(self, is_lifted: bool, seconds: float) -> None:
        """Moves the jack under the left end of the axle down against the ground, or back up."""
        goal_m = self._lowest_m if is_lifted else self._lowest_m + 2 * LIFT_M
        step_m = _LIFT_M_S * seconds
        self._jack_m += min(max(goal_m - self._jack_m, -step_m), step_m)
        self._model.geom_pos[self._jack, 2] = self._jack_m

    def _disturb(self, seconds: float) -> None:
        """The floor's slope, and a rider who shifts about and pushes the wheelchair a little."""
        slope = self._floor.slope(float(self._pose[0]), float(self._pose[1]))
        self._model.opt.gravity[:2] = -_GRAVITY_M_S2 * slope
        keep = math.exp(-seconds / _SWAY_S)
        self._sway_n = keep * self._sway_n + _SWAY_N * math.sqrt(1 - keep**2) * self._rng.standard_normal(2)
        self._data.xfrc_applied[self._body, :2] = self._sway_n
        if self._underfoot is not None:
            ahead = self.T_world_base[:2, 0]
            places, loads_n = self._tyres.places(self._data), self._tyres.loads_n(self._data)
            speed_m_s = float(ahead @ self._velocity[:2])
            self._data.xfrc_applied[self._body, :2] += ahead * drag_n(
                self._underfoot.floor, places, loads_n, ahead, speed_m_s
            )
