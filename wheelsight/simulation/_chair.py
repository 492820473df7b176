"""The wheelchair on its way through MuJoCo's time: motors in, pose and wheel angles out, faults as they come."""

from __future__ import annotations

import math

import numpy as np

from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.simulation.encoders import is_during
from wheelsight.simulation.robot import Robot, WheelFaults
from wheelsight.simulation.wheelchair import LIFT_M, PREFIX, ROLLING, TIMESTEP_S, scene
from wheelsight.simulation.world import World

_GRAVITY_M_S2 = 9.81
_FLOOR_SLOPE, _FLOOR_WAVES, _FLOOR_WAVE_M = 0.002, 12, (0.5, 4.0)
_SWAY_N, _SWAY_S = 6.0, 1.0
_LIFT_M_S = 0.02


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
    ) -> None:
        import mujoco

        self._mujoco, self._robot, self._faults, self._slip, self._rng = mujoco, robot, faults, slip, rng
        self._model = scene(world, robot, slip=slip)
        self._data = mujoco.MjData(self._model)
        self._base = self._model.body(PREFIX + "base").id
        self._jack = self._model.geom(PREFIX + "jack").id
        self._jack_down_m = float(self._model.geom_pos[self._jack, 2])
        self._jack_m = self._jack_up_m = self._jack_down_m + 2 * LIFT_M
        self._wheel_bodies = [self._model.geom(PREFIX + name).id for name in ROLLING]
        self._pairs = [self._model.pair(name).id for name in ROLLING]
        self._friction = self._model.pair_friction[self._pairs].copy()
        self._angles = [int(self._model.joint(PREFIX + name).qposadr[0]) for name in ROLLING[:2]]
        self._floor = _Floor(rng)
        self._sway = np.zeros(2)
        self._place(T_world_base)

    def _place(self, T_world_base: FloatArray) -> None:
        adr = int(self._model.joint(PREFIX + "base").qposadr[0])
        self._data.qpos[adr : adr + 3] = T_world_base[:3, 3]
        self._data.qpos[adr + 3 : adr + 7] = np.roll(so3.to_quaternion(T_world_base[:3, :3]), 1)
        for side in ("left", "right"):
            swivel = int(self._model.joint(f"{PREFIX}{side}_swivel").qposadr[0])
            self._data.qpos[swivel] = self._rng.uniform(-0.5, 0.5)
        self._pose = self._data.qpos[adr : adr + 7]
        dof = int(self._model.joint(PREFIX + "base").dofadr[0])
        self._velocity = self._data.qvel[dof : dof + 6]
        self._model.geom_pos[self._jack, 2] = self._jack_m
        self._mujoco.mj_forward(self._model, self._data)
        self._zero_rad = self._data.qpos[self._angles].copy()

    def settle(self, seconds: float) -> None:
        """Lets the wheelchair come to rest on its wheels, motors braked."""
        self.step(-math.inf, round(seconds / TIMESTEP_S))
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
    def yaw_rate_rad_s(self) -> float:
        """About the base's z axis, as a gyroscope on it feels it."""
        return float(self._velocity[5])

    @property
    def is_broken(self) -> bool:
        """Whether the physics has run away."""
        return bool(self._data.warning.number.any())

    def obey(self, v_m_s: float, yaw_rate_rad_s: float) -> None:
        """Sets the motors' speeds, by the nominal wheels as the owner entered them."""
        nominal = Robot()
        across = yaw_rate_rad_s * nominal.track_width_m / 2
        self._data.ctrl[:] = (v_m_s - across) / nominal.left_radius_m, (v_m_s + across) / nominal.right_radius_m

    def step(self, stamp_s: float, steps: int) -> None:
        """Goes on by so many time steps with the floor, the rider and the faults of `stamp_s`."""
        self._lift(is_during(stamp_s, self._faults.lifted_s), steps * TIMESTEP_S)
        if self._faults.patches:
            self._grip()
        if self._slip:
            self._disturb(steps * TIMESTEP_S)
        self._mujoco.mj_step(self._model, self._data, steps)

    def _grip(self) -> None:
        """Each wheel's friction by the patch it stands on."""
        for pair, geom, usual in zip(self._pairs, self._wheel_bodies, self._friction, strict=True):
            x, y = self._data.geom_xpos[geom, :2]
            self._model.pair_friction[pair] = usual
            for patch in self._faults.patches:
                if math.hypot(x - patch.x_m, y - patch.y_m) < patch.radius_m:
                    self._model.pair_friction[pair, :2] = patch.friction

    def _lift(self, is_lifted: bool, seconds: float) -> None:
        """Moves the jack under the left end of the axle towards the ground, or back up."""
        goal = self._jack_down_m if is_lifted else self._jack_up_m
        step = _LIFT_M_S * seconds
        self._jack_m += min(max(goal - self._jack_m, -step), step)
        self._model.geom_pos[self._jack, 2] = self._jack_m

    def _disturb(self, seconds: float) -> None:
        """A floor that is not quite level where the wheelchair stands, and a rider who shifts about."""
        slope = self._floor.slope(self._pose[0], self._pose[1])
        self._model.opt.gravity[:2] = -_GRAVITY_M_S2 * slope
        keep = math.exp(-seconds / _SWAY_S)
        self._sway = keep * self._sway + _SWAY_N * math.sqrt(1 - keep**2) * self._rng.standard_normal(2)
        self._data.xfrc_applied[self._base, :2] = self._sway


class _Floor:
    """The slope of a floor with waves of a few decimetres to metres, of one root mean square in x and in y."""

    def __init__(self, rng: np.random.Generator) -> None:
        directions = rng.uniform(0, 2 * math.pi, _FLOOR_WAVES)
        lengths_m = rng.uniform(*_FLOOR_WAVE_M, _FLOOR_WAVES)
        self._waves = 2 * math.pi / lengths_m[:, None] * np.stack([np.cos(directions), np.sin(directions)], axis=-1)
        self._phases = rng.uniform(0, 2 * math.pi, _FLOOR_WAVES)
        self._units = np.stack([np.cos(directions), np.sin(directions)], axis=-1)
        self._slope = _FLOOR_SLOPE * 2 / math.sqrt(_FLOOR_WAVES)

    def slope(self, x_m: float, y_m: float) -> FloatArray:
        """(2,) rise a metre along x and y."""
        heights = np.sin(self._waves @ (x_m, y_m) + self._phases)
        return np.asarray(self._slope * heights @ self._units)
