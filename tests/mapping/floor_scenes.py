"""Rooms of boxes, seen by a robot's camera by closed form, and keyframes made of that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, PinholeCamera, se3, so3
from wheelsight.core.keyframes import Keyframe, KeyframeId
from wheelsight.mapping import OccupancyMapper, OccupancySettings

CAMERA = PinholeCamera(160, 120, 131.0, 131.0, 79.5, 59.5)
INTRINSICS = np.array([131.0, 131.0, 79.5, 59.5])
EXACT = DepthNoise(constant_m=0.001, quadratic_per_m=0.0, near_m=0.2, far_m=12.0)
_FORWARDS = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
_PX = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
_RAYS = np.stack([(_PX[0] - CAMERA.cx) / CAMERA.fx, (_PX[1] - CAMERA.cy) / CAMERA.fy, np.ones(_PX[0].shape)], axis=-1)


@dataclass(frozen=True)
class Box:
    """What fills a part of space, or, of a `hole`, leaves out a part of the floor."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


ROOM = Box((-3.0, -2.0, 0.0), (3.0, 2.0, 2.5))


def mount(height_m: float = 1.1, down_deg: float = 20.0) -> FloatArray:
    """T_base_camera."""
    return se3.from_parts(so3.exp([0.0, np.radians(down_deg), 0.0]) @ _FORWARDS, [0.2, 0.0, height_m])


def robot(T_base_camera: FloatArray | None = None, noise: DepthNoise = EXACT) -> Calibration:
    T = mount() if T_base_camera is None else T_base_camera
    return Calibration.registered_camera(CAMERA, T_base_camera=T, depth_noise=noise)


ROBOT = robot()


def at(x: float, y: float, yaw_deg: float, T_base_camera: FloatArray | None = None) -> FloatArray:
    """T_map_camera where the base is there."""
    T = mount() if T_base_camera is None else T_base_camera
    return np.asarray(se3.from_plane(x, y, np.radians(yaw_deg)) @ T)


def depth_of(T_map_camera: FloatArray, *things: Box, room: Box = ROOM, hole: Box | None = None) -> Float32Array:
    """(h, w) what is seen in a room of some things from there; below a hole is a floor of its own."""
    o, d = T_map_camera[:3, 3], _RAYS @ T_map_camera[:3, :3].T
    z = _out_of(o, d, room)
    if hole is not None:
        ground = o + d * z[..., None]
        z = np.where(_over(ground, hole) & (ground[..., 2] < 1e-6), _out_of(o, d, hole), z)
    for thing in things:
        z = np.minimum(z, _into(o, d, thing))
    return z.astype(np.float32)


def _crossings(o: FloatArray, d: FloatArray, box: Box) -> tuple[FloatArray, FloatArray]:
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (np.array(box.low) - o) / d, (np.array(box.high) - o) / d
    return np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)


def _into(o: FloatArray, d: FloatArray, box: Box) -> FloatArray:
    first, last = _crossings(o, d, box)
    return np.where((first < last) & (first > 0), first, np.inf)


def _out_of(o: FloatArray, d: FloatArray, box: Box) -> FloatArray:
    return _crossings(o, d, box)[1]


def _over(points: FloatArray, box: Box) -> BoolArray:
    inside = (points[..., :2] > box.low[:2]) & (points[..., :2] < box.high[:2])
    return np.asarray(inside.all(axis=-1))


def keyframe(depth_m: Float32Array) -> Keyframe:
    return Keyframe.of_images(0.0, INTRINSICS, depth_m, np.full(depth_m.shape, 100, np.float32))


def turning(count: int = 16) -> list[FloatArray]:
    """Poses all round the middle of the room that look outwards, and as many that look over it to the other side."""
    turns = 360 * np.arange(count) / count
    ways = [(radius_m, turn) for radius_m in (0.3, -0.9) for turn in turns]
    return [at(r * np.cos(np.radians(turn)), r * np.sin(np.radians(turn)), turn) for r, turn in ways]


def mapped(
    poses: list[FloatArray],
    *things: Box,
    settings: OccupancySettings | None = None,
    hole: Box | None = None,
    room: Box = ROOM,
) -> OccupancyMapper:
    """What these poses show of a room."""
    made = OccupancyMapper(ROBOT, settings)
    for number, T in enumerate(poses):
        made.add(KeyframeId(number), keyframe(depth_of(T, *things, room=room, hole=hole)), T)
    return made
