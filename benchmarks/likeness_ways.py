"""Where a real camera's way is laid into a simulated room, so that it sees things as far away as it truly did."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.core.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import World
from wheelsight_sim.scene import Scene

QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)
_CAMERA = PinholeCamera(32, 24, 29.3, 29.3, 15.5, 11.5)  # Kinect v1's field of view
_POSES = 6
_YAWS = 8
_REACH_M, _STEP_M = 0.6, 0.3
_NEAREST_M = 0.35


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """A way in a world, and how unlike the depths there are: the mean ratio of their quantiles, as a logarithm."""

    way: Trajectory
    unlike: float


def upright(way: Trajectory, up: FloatArray, height_m: float) -> Trajectory:
    """A way whose z axis is `up` (3,) of the way's own frame, and whose mean height is `height_m`."""
    axis = np.cross(up, (0.0, 0.0, 1.0))
    sine, cosine = float(np.linalg.norm(axis)), float(np.dot(up, (0.0, 0.0, 1.0)))
    turn = np.zeros(3) if sine < 1e-9 else axis / sine * np.arctan2(sine, cosine)
    T = np.eye(4)
    T[:3, :3] = so3.exp(turn)
    moved = way.moved(T)
    T = np.eye(4)
    T[2, 3] = height_m - moved.positions_m[:, 2].mean()
    return moved.moved(T)


def placed(way: Trajectory, world: World, quantiles_m: FloatArray) -> Placed:
    """The way, turned about the vertical and moved over the floor to where its depths are likest.

    Args:
        way: upright, at its height.
        world: in whose middle things stand; what the camera looks at, on average, is laid near it.
        quantiles_m: (5,) of the real depths, `QUANTILES` of them.
    """
    scene = Scene(world, threads=1)
    poses = way.T_frame_body[np.linspace(0, len(way) - 1, _POSES).astype(int)]
    looked_at = poses[:, :3, 3] + quantiles_m[len(quantiles_m) // 2] * poses[:, :3, 2]
    middle = np.array([*looked_at[:, :2].mean(axis=0), 0.0])
    best = Placed(way, np.inf)
    for x in np.arange(-_REACH_M, _REACH_M + 0.01, _STEP_M):
        for y in np.arange(-_REACH_M, _REACH_M + 0.01, _STEP_M):
            for yaw_rad in np.arange(_YAWS) * 2 * np.pi / _YAWS:
                T = se3.compose(se3.from_plane(x, y, yaw_rad), se3.from_parts(np.eye(3), -middle))
                unlike = _unlike(scene, se3.compose(T, poses), quantiles_m)
                if unlike < best.unlike:
                    best = Placed(way.moved(T), unlike)
    return best


def _unlike(scene: Scene, poses: FloatArray, quantiles_m: FloatArray) -> float:
    seen = []
    for T_world_camera in poses:
        depth_m = scene.cast(_CAMERA, T_world_camera).depth_m
        if depth_m.min() < _NEAREST_M:
            return np.inf
        seen.append(np.quantile(depth_m, QUANTILES))
    return float(np.abs(np.log(np.mean(seen, axis=0) / quantiles_m)).mean())
