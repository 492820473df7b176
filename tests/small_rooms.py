"""Worlds of a few geoms, and poses to look at them from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.core.areas import AreaMap
from wheelsight.core.geometry import FloatArray
from wheelsight_sim.world import Surface, World

WHITE = Surface("plain", (0.8, 0.8, 0.8), infrared=0.6)


def room(geoms: str, surfaces: dict[str, Surface] | None = None) -> World:
    """A world of MJCF geoms, which are `white` unless they say another of the materials."""
    surfaces = surfaces or {"white": WHITE}
    materials = "".join(f'<material name="{name}" rgba="0.5 0.5 0.5 1"/>' for name in surfaces)
    mjcf = (
        f'<mujoco><asset>{materials}</asset><default><geom material="{next(iter(surfaces))}"/></default>'
        f"<worldbody>{geoms}</worldbody></mujoco>"
    )
    route = np.array([[0.0, 0.0], [8.0, 0.0]])
    return World("room", "a few geoms", mjcf, surfaces, AreaMap(), route, False, (-20.0, -20.0, 20.0, 20.0))


def corridor(
    half_width_m: float = 1.4,
    route: tuple[tuple[float, float], ...] = ((1.0, 0.0), (23.0, 0.0)),
    ends_m: tuple[float, ...] = (),
) -> World:
    """Along x, with walls across it at `ends_m`, a bin on its left, and in its middle a poster to walk through."""
    h = half_width_m + 0.1
    walls = "".join(f'<geom name="end{x}" type="box" pos="{x} 0 1.4" size="0.1 3 1.4"/>' for x in ends_m)
    walls += (
        f'<geom name="left" type="box" pos="12 {h} 1.4" size="13 0.1 1.4"/>'
        f'<geom name="right" type="box" pos="12 {-h} 1.4" size="13 0.1 1.4"/>'
        '<geom name="floor" type="plane" size="40 40 1"/>'
        f'<geom name="bin" type="cylinder" pos="9 {half_width_m - 0.2} 0.4" size="0.2 0.4"/>'
        f'<geom name="poster" type="box" pos="12 0 1.4" size="0.5 0.5 0.5" contype="0"/>'
    )
    return replace(room(walls), route=np.array(route))


def looking(x: float = 0.0, y: float = 0.0, z: float = 1.0, yaw: float = 0.0, pitch: float = 0.0) -> FloatArray:
    """T_odom_camera of a camera that looks along the world's x, turned to the left by yaw and down by pitch."""
    c, s = np.cos(pitch), np.sin(pitch)
    tilt = np.array([[0, -s, c], [-1, 0, 0], [0, -c, -s]])
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.eye(4)
    T[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ tilt
    T[:3, 3] = x, y, z
    return T


def wall(distance_m: float, tilt_rad: float = 0.0, material: str = "white") -> str:
    """A wall across the view of `looking()`, its middle so far ahead, turned by `tilt_rad` round the vertical."""
    c, s = np.cos(tilt_rad), np.sin(tilt_rad)
    # A box's front face, 1 m before its middle, passes through the point ahead.
    return (
        f'<geom name="wall" type="box" size="1 30 30" material="{material}" '
        f'pos="{distance_m + c:.9f} {s:.9f} 1" euler="0 0 {np.degrees(tilt_rad):.9f}"/>'
    )
