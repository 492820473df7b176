"""What a camera on a simulated robot sees, without rendering: its poses, with noise, and depth of floor and walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from drives import MIXED, Leg, simulate

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise, Wheels
from wheelsight.core.depth_errors import PointErrors
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3
from wheelsight.core.trajectory import Trajectory
from wheelsight_calibration.base import Sightings
from wheelsight_calibration.mount import FloorDepths
from wheelsight_calibration.wheel_drive import drive_from_ticks
from wheelsight_sim import RobotModel

CAMERA = PinholeCamera(320, 240, 262.5, 262.5, 159.5, 119.5)
NOISE = DepthNoise()
NOMINAL = Wheels(0.17, 0.17, 0.58, 3200)
MOUNT = RobotModel(
    camera_forward_m=0.28,
    camera_left_m=0.08,
    camera_height_m=0.8,
    camera_pitch_rad=0.25,
    camera_yaw_rad=0.15,
    camera_roll_rad=-0.05,
).T_base_camera
_FRAMES_HZ, _VIEWS_S = 15, 0.5
_STEP_PX = 8
_AIR_M = 1.5


@dataclass(frozen=True)
class Blur:
    """Standard deviations of the camera's poses: of each by itself, and of each step, which add up."""

    pose_m: float = 0.0
    pose_rad: float = 0.0
    step_m: float = 0.0
    step_rad: float = 0.0


CLEAR = Blur()
USUAL = Blur(pose_m=0.001, pose_rad=0.0005, step_m=0.0005, step_rad=0.0002)


def nominal(T_base_camera: FloatArray | None = None) -> Calibration:
    """A robot whose camera is known exactly."""
    known = {"wheels": NOMINAL, "T_base_camera": T_base_camera, "point_errors": PointErrors()}
    return Calibration.registered_camera(CAMERA, source="data sheet", **known)


def sighted(
    wheels: Wheels = NOMINAL,
    T_base_camera: FloatArray = MOUNT,
    legs: Sequence[Leg] = MIXED,
    *,
    rng: np.random.Generator | None = None,
    slips: int = 0,
    blur: Blur = CLEAR,
    camera_late_s: float = 0.0,
    slide_s: float = 0.0,
) -> Sightings:
    """A drive in a room whose walls keep a metre and a half off the way, wheels and camera truly so.

    In bends the robot slides outwards by `slide_s` times its acceleration inwards.
    """
    made = simulate(wheels, legs, rng=rng, slips=slips)
    truth = _slid(made.truth, slide_s) if slide_s else made.truth
    drive = drive_from_ticks(NOMINAL, made.stamps_s, made.left, made.right)
    start_s, end_s = truth.stamps_s[[0, -1]]
    stamps_s = np.arange(start_s, end_s, 1 / _FRAMES_HZ)
    T_odom_camera = truth.at(stamps_s) @ T_base_camera
    noise = np.random.default_rng(5) if rng is None else rng
    camera = Trajectory(stamps_s + camera_late_s, _blurred(T_odom_camera, blur, noise))
    kept = slice(None, None, round(_VIEWS_S * _FRAMES_HZ))
    views = room_views(stamps_s[kept] + camera_late_s, T_odom_camera[kept], noise if blur != CLEAR else None)
    return Sightings(drive, camera, len(stamps_s), (camera.stamps_s[0], camera.stamps_s[-1]), views)


def room_views(stamps_s: FloatArray, T_odom_camera: FloatArray, rng: np.random.Generator | None) -> FloorDepths:
    """Depth of the floor z = 0 and of four walls around the way, noisy with `rng`."""
    rays = CAMERA.rays()[_STEP_PX // 2 :: _STEP_PX, _STEP_PX // 2 :: _STEP_PX].reshape(-1, 3)
    low, high = (edge(T_odom_camera[:, :2, 3], axis=0) for edge in (np.min, np.max))
    walls = [(axis, low[axis] - _AIR_M) for axis in (0, 1)] + [(axis, high[axis] + _AIR_M) for axis in (0, 1)]
    directions = rays @ np.swapaxes(T_odom_camera[:, :3, :3], 1, 2)
    depth_m = np.full(directions.shape[:2], np.inf)
    for axis, place in [(2, 0.0), *walls]:
        with np.errstate(divide="ignore"):
            reach = (place - T_odom_camera[:, axis, 3])[:, None] / directions[..., axis]
        depth_m = np.minimum(depth_m, np.where(reach > 0, reach, np.inf))
    if rng is not None:
        depth_m = depth_m + NOISE.sigma_m(depth_m) * rng.standard_normal(depth_m.shape)
    return FloorDepths(stamps_s, rays, depth_m)


def with_late_camera(sightings: Sightings, late_s: float) -> Sightings:
    """The same drive, its frames stamped so much later."""
    camera, views = sightings.camera, sightings.views
    return replace(
        sightings,
        camera=Trajectory(camera.stamps_s + late_s, camera.T_frame_body),
        span_s=(sightings.span_s[0] + late_s, sightings.span_s[1] + late_s),
        views=replace(views, stamps_s=views.stamps_s + late_s),
    )


def _slid(truth: Trajectory, slide_s: float) -> Trajectory:
    steps = se3.invert(truth.T_frame_body[:-1]) @ truth.T_frame_body[1:]
    turned = np.arctan2(steps[:, 1, 0], steps[:, 0, 0])
    steps[:, 1, 3] -= slide_s * steps[:, 0, 3] * turned / np.diff(truth.stamps_s)
    poses = [truth.T_frame_body[0]]
    for step in steps:
        poses.append(poses[-1] @ step)
    return Trajectory(truth.stamps_s, np.array(poses), body="base")


def _blurred(T_odom_camera: FloatArray, blur: Blur, rng: np.random.Generator) -> FloatArray:
    count = len(T_odom_camera)

    def draws(m: float, rad: float) -> FloatArray:
        return rng.standard_normal((count, 6)) * np.repeat([m, rad], 3)

    steps = se3.invert(T_odom_camera[:-1]) @ T_odom_camera[1:] @ se3.exp(draws(blur.step_m, blur.step_rad)[1:])
    poses = [T_odom_camera[0]]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.asarray(np.array(poses) @ se3.exp(draws(blur.pose_m, blur.pose_rad)))
