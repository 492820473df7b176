"""The paper's wheelchair as MJCF, and its way through MuJoCo's time: motors in, pose and wheel angles out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight_sim.body_motion import CASTOR_X_M, CASTOR_Y_M, FloorSurface, LoadedRadii, TyreSettings
from wheelsight_sim.doors import Leaves
from wheelsight_sim.drivers import COMMAND_PERIOD_S
from wheelsight_sim.readings import is_during
from wheelsight_sim.robot import Patch, RobotModel, WheelFaults
from wheelsight_sim.world import World

if TYPE_CHECKING:
    import mujoco

# Dimensions are those of Trinh et al., section II. The body's frame is the base itself: both driven wheels touch the
# ground at (0, ±track / 2, 0), whatever their radii. Every wheel meets the floor with a sphere, which has one point
# of contact, straight below its centre; so radius and track width mean the same to physics as to odometry. The
# cylinders are only to be seen.

PREFIX = "wheelchair/"
ROLLING = ("left_wheel", "right_wheel", "left_castor", "right_castor")
TIMESTEP_S = 0.0025
FLOOR_FRICTION = 0.7
LIFT_M = 0.01
CASTOR_RADIUS_M = 0.08

_CASTOR_TRAIL_M = 0.05
_CLEARANCE_M = 0.05
_NO_SLIP_FRICTION = 3.0
# Soft enough for creep to be set at any speed, see `Tyres`; and hard, for wheels that must not slip.
_FRICTION_TO_NORMAL_IMPEDANCE = {True: 0.05, False: 10.0}
_STIFF = (2 * TIMESTEP_S, 1.0)
_IMPEDANCE = (0.99, 0.99, 0.001, 0.5, 2.0)
_WEIGHT_KG = 130.0
_WHEELS_KG = 2 * (4 + 0.5 + 0.8)


def wheelchair_mjcf(robot: RobotModel) -> str:
    """The wheelchair alone; its body `base` is free and starts with the base frame in the world's origin."""
    half_height, half_y = (robot.height_m - _CLEARANCE_M) / 2, robot.track_width_m / 2
    return (
        Path(__file__)
        .with_name("wheelchair.xml")
        .read_text(encoding="utf-8")
        .format(
            chassis_kg=_WEIGHT_KG - _WHEELS_KG,
            middle=robot.length_m / 2 - robot.tail_m,
            half_length=robot.length_m / 2,
            half_width=robot.width_m / 2,
            hull_z=_CLEARANCE_M + half_height,
            hull_half_z=half_height,
            jack_z=0.02 - LIFT_M,
            back_z=(0.5 + robot.height_m) / 2,
            back_half_z=(robot.height_m - 0.5) / 2,
            foot_x=robot.length_m - robot.tail_m - 0.12,
            left_y=half_y,
            left_radius=robot.left_radius_m,
            left_spoke=0.9 * robot.left_radius_m,
            right_y=-half_y,
            right_radius=robot.right_radius_m,
            right_spoke=0.9 * robot.right_radius_m,
            castor_x=CASTOR_X_M,
            castor_y=CASTOR_Y_M,
            castor_radius=CASTOR_RADIUS_M,
            castor_trail=-_CASTOR_TRAIL_M,
        )
    )


def scene(world: World, robot: RobotModel, *, slip: bool = True, doors: Leaves | None = None) -> mujoco.MjModel:
    """The world's walls and furniture, a floor, and the wheelchair on it, ready to be stepped.

    Only the wheels and the floor touch (each as a pair with its own friction), and the wheelchair's hull and what
    stands in the world; what is only to be seen is left out. `doors` swing, and are as solid as walls.

    Raises:
        ConfigError: MJCF that MuJoCo does not take.
    """
    import mujoco

    try:
        spec = mujoco.MjSpec.from_string(world.mjcf)
        if doors is not None:
            doors.add_to(spec, is_solid=True)
        for geom in list(spec.geoms):
            if geom.type == mujoco.mjtGeom.mjGEOM_PLANE or not geom.contype:
                spec.delete(geom)
        spec.worldbody.add_geom(
            name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1), contype=0, conaffinity=0
        )
        spec.attach(mujoco.MjSpec.from_string(wheelchair_mjcf(robot)), prefix=PREFIX, frame=spec.worldbody.add_frame())
        option = spec.option
        option.timestep = TIMESTEP_S
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        # Implicit damping would change the wheels' acceleration after the contacts are solved, and make them slip.
        option.integrator = mujoco.mjtIntegrator.mjINT_EULER
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
        option.impratio = _FRICTION_TO_NORMAL_IMPEDANCE[slip]
        option.noslip_iterations = 0 if slip else 20
        friction = FLOOR_FRICTION if slip else _NO_SLIP_FRICTION
        for name in (*ROLLING, "jack"):
            spec.add_pair(
                name=name,
                geomname1="ground",
                geomname2=PREFIX + name,
                condim=3,
                friction=(friction, friction, 0.005, 0.0001, 0.0001),
                solref=_STIFF,
                solimp=_IMPEDANCE,
            )
        model: mujoco.MjModel = spec.compile()
    except ValueError as error:
        raise ConfigError(f"world {world.name!r} with its robot is no MJCF that MuJoCo takes: {error}") from error
    return model


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
        robot: RobotModel,
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
        """Whether the physics diverges, checked before MuJoCo, which would reset and write a log file."""
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
        """Advance by some time steps with the floor, the rider and the faults at `stamp_s`."""
        if self._faults.lifted_s:
            self._lift(is_during(stamp_s, self._faults.lifted_s), steps * TIMESTEP_S)
        self._tyres.grip(self._data)
        if self._slip:
            # The floor's slope, and a rider who shifts about and pushes the wheelchair a little.
            seconds = steps * TIMESTEP_S
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


_CREEP_STIFFNESS = 10.0
_SLOWEST_M_S = 0.02
_STIFFEST_PER_S = 1 / TIMESTEP_S
_SLOPE_STEP_M = 0.005
_SLOPE, _WAVES, _WAVE_LENGTH_M = 0.002, 12, (0.5, 4.0)


@dataclass(frozen=True, slots=True, eq=False)
class Underfoot:
    """A floor with thresholds and carpets, and tyres that give way."""

    floor: FloorSurface
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
            rates = self._rates
            if self._underfoot is not None:
                floor = self._underfoot.floor
                softer = np.where(floor.is_carpet(self.places(data)), floor.settings.carpet_creep, 1.0)
                rates = [rate * share for rate, share in zip(rates, softer.tolist(), strict=True)]
            for pair, dof, rate, radius_m in zip(self._pairs, self._speeds, rates, self._radii_m, strict=True):
                speed_m_s = max(abs(float(data.qvel[dof])) * radius_m, _SLOWEST_M_S)
                self._model.pair_solreffriction[pair] = 0.0, -min(rate / speed_m_s, _STIFFEST_PER_S)
        if self._patches:
            for pair, geom in zip(self._pairs, self._geoms, strict=True):
                x, y = data.geom_xpos[geom, :2].tolist()
                under = (p.friction for p in self._patches if math.hypot(x - p.x_m, y - p.y_m) < p.radius_m)
                self._model.pair_friction[pair, :2] = next(under, self._friction)


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


def drag_n(floor: FloorSurface, places: FloatArray, loads_n: FloatArray, ahead: FloatArray, speed_m_s: float) -> float:
    """Force in newton along `ahead` (2,) on wheels at places (W, 2) that climb thresholds or roll on carpet.

    A wheel that carries a load up a slope is pushed back by the load's share along it.
    """
    step = ahead * _SLOPE_STEP_M
    rise = (floor.height_m(places + step) - floor.height_m(places - step)) / (2 * _SLOPE_STEP_M)
    carpet = floor.is_carpet(places) * floor.settings.carpet_drag * math.tanh(speed_m_s / _SLOWEST_M_S)
    return -float(loads_n @ (rise + carpet))
