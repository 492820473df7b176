"""A robot in a rectangular room, seen by a depth camera whose errors are known: closed forms for self-calibration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wheelsight.core.calibration import Calibration, DepthNoise, Wheels
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId
from wheelsight.slam.graph import RelativePose
from wheelsight_calibration.self_model import RobotModel
from wheelsight_calibration.self_solver import MapData
from wheelsight_calibration.self_views import on_floor, overlapping, patches_of
from wheelsight_calibration.wheel_drive import WheelDrive

SIZE_M = np.array([6.0, 5.0, 2.5])
LENS = PinholeCamera(80, 60, 73.25, 73.25, 39.5, 29.5)
_STEP_S = 0.02
_NOISES = {"structured-light": DepthNoise(0.001, 1.425e-3, 0.45, 10.0), "tof": DepthNoise(0.0015, 0.2e-3, 0.5, 8.0)}


class Room(NamedTuple):
    """Data of a drive, the model with its nominal calibration, true values (P,) and true poses (N, 4, 4)."""

    data: MapData
    model: RobotModel
    truth: FloatArray
    T_map_camera: FloatArray


def nominal(sensor: str) -> Calibration:
    """A camera 0.9 m high that looks 0.2 rad down, on wheels of which nothing is stated."""
    c, s = np.cos(0.2), np.sin(0.2)
    T = np.eye(4)
    T[:3, :3] = [[0, -s, c], [-1, 0, 0], [0, -c, -s]]
    T[:3, 3] = 0.2, 0.0, 0.9
    wheels = Wheels(0.17, 0.17, 0.52, 3200, scale_sigma=0.005, drift_sigma_rad_per_m=0.005, turn_sigma=0.01)
    return Calibration.registered_camera(LENS, depth_noise=_NOISES[sensor], T_base_camera=T, wheels=wheels)


def depth_m(T_map_camera: FloatArray, rays: FloatArray) -> FloatArray:
    """(H, W) true depth of the room along rays (H, W, 3) with z = 1."""
    turned, at = rays @ T_map_camera[:3, :3].T, T_map_camera[:3, 3]
    with np.errstate(divide="ignore"):
        ways = np.where(turned > 0, (SIZE_M - at) / turned, np.where(turned < 0, -at / turned, np.inf))
    return np.asarray(ways.min(axis=-1))


def readings_m(model: RobotModel, truth: FloatArray, T_map_camera: FloatArray) -> FloatArray:
    """(H, W) what a camera of these true values reads without noise: corrected, it is the true depth."""
    nominal_rays = LENS.rays()
    rays = nominal_rays.copy()
    rays[..., :2] = rays[..., :2] * (1 + truth[0]) + truth[1:3]
    true_m = depth_m(T_map_camera, rays).ravel()
    flat, reading = nominal_rays.reshape(-1, 3), true_m.copy()
    for _ in range(4):
        reading = true_m - model.depth_changes(flat, reading) @ truth[: model.camera_count]
    return reading.reshape(rays.shape[:2])


def _way(slide_s: float, turns_only: bool) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Stamps (N,) and x, y, yaw of the base, its speeds ahead and of turning; straight, then on the spot."""
    ahead, turn = list[float](), list[float]()
    for k in range(10):
        ahead += [0.0 if turns_only else 0.4] * 100 + [0.0] * 75
        turn += [0.15 * (-1) ** k] * 100 + [0.8 if k % 4 < 3 else -0.8] * 75
    v, w = np.array(ahead), np.array(turn)
    yaw = np.concatenate([[0.0], np.cumsum(w * _STEP_S)])
    middle = yaw[:-1] + w * _STEP_S / 2
    steps = (v - 1j * slide_s * v * w) * np.exp(1j * middle) * _STEP_S
    place = 3.0 + 2.5j + np.concatenate([[0.0], np.cumsum(steps)])
    return (
        _STEP_S * np.arange(len(yaw), dtype=float),
        np.asarray(np.column_stack([place.real, place.imag, yaw]), float),
        v,
        w,
    )


def drawn_room(
    sensor: str,
    seed: int,
    *,
    views: int = 40,
    share: float = 0.5,
    truth: FloatArray | None = None,
    turns_only: bool = False,
) -> Room:
    """A drive of a unit whose values are drawn from the prior, at `share` of its σ, unless `truth` gives them."""
    rng = np.random.default_rng(seed)
    calibration = nominal(sensor)
    model = RobotModel.of(calibration, has_wheels=True, has_gyro=False)
    if truth is None:
        root = np.linalg.cholesky(model.prior + 1e-18 * np.eye(len(model)))
        truth = share * root @ rng.standard_normal(len(model))
    wheels, mount = model.wheels(truth), model.mount(truth)
    stamps_s, poses, v, w = _way(float(truth[model.index("slide_s")]), turns_only)
    rims_m = np.stack([v - w * wheels.track_width_m / 2, v + w * wheels.track_width_m / 2]) * _STEP_S
    rims_m += 0.003 * np.sqrt(np.abs(rims_m)) * rng.standard_normal(rims_m.shape)
    radii_m = np.array([[wheels.left_radius_m], [wheels.right_radius_m]])
    angles = np.concatenate([np.zeros((2, 1)), np.cumsum(rims_m, axis=1)], axis=1) / radii_m
    drive = WheelDrive(stamps_s + wheels.delay_s, *angles)
    at = np.linspace(20, len(stamps_s) - 20, views).astype(int)
    jolts = se3.exp(rng.standard_normal((views, 6)) * (0, 0, 0.002, 0.002, 0.002, 0))
    T = se3.from_plane(*poses[at].T) @ jolts @ mount
    noise, seen = calibration.depth_noise, []
    intrinsics = np.array([LENS.fx, LENS.fy, LENS.cx, LENS.cy])
    for k, T_map_camera in zip(at.tolist(), T, strict=True):
        reading = readings_m(model, truth, T_map_camera)
        noisy = (reading + noise.sigma_m(reading) * rng.standard_normal(reading.shape)).astype(np.float32)
        grey = np.zeros(reading.shape, np.float32)
        seen.append(patches_of(Keyframe.of_images(float(stamps_s[k]), intrinsics, noisy, grey), calibration))
    start = T @ se3.exp(0.005 * rng.standard_normal((views, 6)))
    covariance = np.diag(np.full(6, 0.01**2))
    edges = tuple(
        RelativePose(KeyframeId(i), KeyframeId(i + 1), se3.invert(start[i]) @ start[i + 1], covariance)
        for i in range(views - 1)
    )
    assert calibration.T_base_camera is not None
    floors = tuple(np.flatnonzero(on_floor(view, calibration.T_base_camera, 6.0, 0.1)) for view in seen)
    steps = np.stack([np.arange(views - 1), np.arange(1, views)], axis=1)
    data = MapData(tuple(seen), start, tuple(overlapping(seen, start, 6)), floors, edges, steps, drive)
    return Room(data, model, truth, T)
