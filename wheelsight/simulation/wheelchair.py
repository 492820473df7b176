"""The paper's wheelchair as MJCF, set on a world's floor: what MuJoCo steps through time.

Dimensions are those of Trinh et al., section II. The body's frame is the base itself: both driven wheels touch the
ground at (0, ±track / 2, 0), whatever their radii. Every wheel meets the floor with a sphere, which has one point of
contact, straight below its centre; so radius and track width mean the same to physics as to odometry. The cylinders
are only to be seen.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from wheelsight.errors import ConfigError
from wheelsight.simulation.doors import Leaves
from wheelsight.simulation.robot import Robot
from wheelsight.simulation.world import World

if TYPE_CHECKING:
    import mujoco

PREFIX = "wheelchair/"
ROLLING = ("left_wheel", "right_wheel", "left_castor", "right_castor")
TIMESTEP_S = 0.0025
FLOOR_FRICTION = 0.7
LIFT_M = 0.01
CASTOR_RADIUS_M = 0.08

_CASTOR_TRAIL_M = 0.05
_CASTOR_X_M, _CASTOR_Y_M = 0.45, 0.17
_TAIL_M = 0.30
_CLEARANCE_M = 0.05
_NO_SLIP_FRICTION = 3.0
# Soft enough for creep to be set at any speed, see `_ground.Tyres`; and hard, for wheels that must not slip.
_FRICTION_TO_NORMAL_IMPEDANCE = {True: 0.05, False: 10.0}
_STIFF = (2 * TIMESTEP_S, 1.0)
_IMPEDANCE = (0.99, 0.99, 0.001, 0.5, 2.0)

_MJCF = """
<mujoco model="wheelchair">
  <compiler angle="radian" autolimits="true"/>
  <default>
    <geom contype="0" conaffinity="0" mass="0" group="1"/>
    <default class="touch"><geom group="3" rgba="0.4 0.4 0.9 0.3"/></default>
    <default class="tyre"><geom type="cylinder" euler="1.5707963 0 0" rgba="0.1 0.1 0.1 1"/></default>
    <default class="motor"><joint axis="0 1 0" armature="0.3" damping="0.05" frictionloss="0.7"/></default>
    <default class="swivel"><joint axis="0 0 1" damping="0.02" frictionloss="0.05"/></default>
    <default class="castor"><joint axis="0 1 0" damping="0.002" frictionloss="0.2"/></default>
  </default>
  <worldbody>
    <body name="base">
      <freejoint name="base"/>
      <inertial pos="0.14 0 0.42" mass="{chassis_kg}" diaginertia="12 14 9"/>
      <geom name="hull" type="box" conaffinity="3" class="touch" friction="0.3"
            pos="{middle} 0 {hull_z}" size="{half_length} {half_width} {hull_half_z}"/>
      <geom name="jack" type="sphere" class="touch" size="0.02" pos="0 {left_y} {jack_z}"/>
      <geom name="frame" type="box" pos="0.2 0 0.28" size="0.32 0.2 0.06" rgba="0.2 0.2 0.25 1"/>
      <geom name="seat" type="box" pos="0.12 0 0.48" size="0.24 0.22 0.04" rgba="0.15 0.15 0.4 1"/>
      <geom name="back" type="box" pos="-0.12 0 {back_z}" size="0.03 0.22 {back_half_z}" rgba="0.15 0.15 0.4 1"/>
      <geom name="footrest" type="box" pos="{foot_x} 0 0.12" size="0.12 0.16 0.015" rgba="0.3 0.3 0.3 1"/>
      {driven}
      {castors}
    </body>
  </worldbody>
  <actuator>
    <velocity name="left_motor" joint="left_wheel" kv="100" forcerange="-45 45"/>
    <velocity name="right_motor" joint="right_wheel" kv="100" forcerange="-45 45"/>
  </actuator>
</mujoco>
"""
_DRIVEN = """
      <body name="{side}_wheel" pos="0 {y} {radius}">
        <inertial pos="0 0 0" mass="4" diaginertia="0.04 0.06 0.04"/>
        <joint name="{side}_wheel" class="motor"/>
        <geom name="{side}_wheel" type="sphere" class="touch" size="{radius}"/>
        <geom name="{side}_tyre" class="tyre" size="{radius} 0.04"/>
        <geom name="{side}_spoke" type="box" size="{spoke} 0.041 0.01" rgba="0.7 0.7 0.7 1"/>
      </body>"""
_CASTOR = """
      <body name="{side}_fork" pos="{x} {y} {radius}">
        <inertial pos="0 0 0.05" mass="0.5" diaginertia="0.001 0.001 0.001"/>
        <joint name="{side}_swivel" class="swivel"/>
        <geom name="{side}_fork" type="box" pos="-0.025 0 0.09" size="0.03 0.03 0.01" rgba="0.7 0.7 0.7 1"/>
        <body name="{side}_castor" pos="{trail} 0 0">
          <inertial pos="0 0 0" mass="0.8" diaginertia="0.0015 0.0025 0.0015"/>
          <joint name="{side}_castor" class="castor"/>
          <geom name="{side}_castor" type="sphere" class="touch" size="{radius}"/>
          <geom name="{side}_castor_tyre" class="tyre" size="{radius} 0.02"/>
        </body>
      </body>"""
_WEIGHT_KG = 130.0
_WHEELS_KG = 2 * (4 + 0.5 + 0.8)


def wheelchair_mjcf(robot: Robot) -> str:
    """The wheelchair alone; its body `base` is free and starts with the base frame in the world's origin."""
    half_height = (robot.height_m - _CLEARANCE_M) / 2
    half_y = robot.track_width_m / 2
    driven = [
        _DRIVEN.format(side=side, y=y, radius=radius, spoke=0.9 * radius)
        for side, y, radius in (("left", half_y, robot.left_radius_m), ("right", -half_y, robot.right_radius_m))
    ]
    castors = [
        _CASTOR.format(side=side, x=_CASTOR_X_M, y=y, radius=CASTOR_RADIUS_M, trail=-_CASTOR_TRAIL_M)
        for side, y in (("left", _CASTOR_Y_M), ("right", -_CASTOR_Y_M))
    ]
    return _MJCF.format(
        chassis_kg=_WEIGHT_KG - _WHEELS_KG,
        middle=robot.length_m / 2 - _TAIL_M,
        half_length=robot.length_m / 2,
        half_width=robot.width_m / 2,
        hull_z=_CLEARANCE_M + half_height,
        hull_half_z=half_height,
        left_y=half_y,
        jack_z=0.02 - LIFT_M,
        back_z=(0.5 + robot.height_m) / 2,
        back_half_z=(robot.height_m - 0.5) / 2,
        foot_x=robot.length_m - _TAIL_M - 0.12,
        driven="".join(driven),
        castors="".join(castors),
    )


def scene(world: World, robot: Robot, *, slip: bool = True, doors: Leaves | None = None) -> mujoco.MjModel:
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
        _add_contacts(spec, slip=slip)
        model: mujoco.MjModel = spec.compile()
    except ValueError as error:
        raise ConfigError(f"world {world.name!r} with its robot is no MJCF that MuJoCo takes: {error}") from error
    return model


def _add_contacts(spec: mujoco.MjSpec, *, slip: bool) -> None:
    import mujoco

    option = spec.option
    option.timestep = TIMESTEP_S
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # Implicit damping would change the wheels' acceleration after the contacts were solved for it, and make them slip.
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
