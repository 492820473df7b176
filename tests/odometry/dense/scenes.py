"""Scenes for dense odometry: planes ray-cast exactly, with textures given by formulas, and the room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera, se3, so3
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.dense import DenseOdometry, DenseSettings, GridFrame
from wheelsight.vision.dense.alignment import Aligner, DenseAlignment, Gridder, Reference, ReferenceMaker

SMALL = PinholeCamera(320, 240, 262.0, 260.0, 161.3, 118.4)


@dataclass(frozen=True)
class Plane:
    """All points with normal · p = distance_m, painted in waves or not at all."""

    normal: tuple[float, float, float]
    distance_m: float
    is_painted: bool = False


def render(
    planes: Sequence[Plane], T_map_camera: FloatArray, camera: PinholeCamera = SMALL
) -> tuple[np.ndarray, Float32Array]:
    """Colour (H, W, 3) uint8 and depth (H, W) of the nearest planes before a camera at (4, 4), exactly."""
    rays = camera.rays().reshape(-1, 3)
    rays_world, origin = rays @ T_map_camera[:3, :3].T, T_map_camera[:3, 3]
    z_m, grey = np.full(len(rays), np.inf), np.full(len(rays), 128.0)
    for plane in planes:
        normal = np.array(plane.normal)
        with np.errstate(divide="ignore"):
            z = (plane.distance_m - origin @ normal) / (rays_world @ normal)
        is_nearer = (z > 0.1) & (z < z_m)
        z_m = np.where(is_nearer, z, z_m)
        points = origin + rays_world * np.where(is_nearer, z, 1.0)[:, None]
        grey = np.where(is_nearer, _waves(points) if plane.is_painted else 128.0, grey)
    depth_m = np.where(z_m < 9.0, z_m, 0.0).reshape(camera.height, camera.width).astype(np.float32)
    color = np.repeat(np.rint(grey).astype(np.uint8).reshape(*depth_m.shape, 1), 3, axis=2)
    return color, depth_m


def frame_of(
    planes: Sequence[Plane], T_map_camera: FloatArray, stamp_s: float, noise_seed: int | None = None
) -> RgbdFrame:
    """A frame of planes, with a Kinect's noise in depth and 2 grey levels in colour where there is a seed for it."""
    color, depth_m = render(planes, T_map_camera)
    if noise_seed is not None:
        rng = np.random.default_rng(noise_seed)
        noise = rng.standard_normal(depth_m.shape)
        depth_m = (depth_m + 1.425e-3 * depth_m**2 * noise * (depth_m > 0)).astype(np.float32)
        color = (color + rng.normal(0, 2, depth_m.shape)[..., None]).clip(0, 255).astype(np.uint8)
    return RgbdFrame(stamp_s, color, depth_m)


@dataclass(frozen=True)
class Bench:
    """The parts of dense odometry for one camera, to be used one by one."""

    gridder: Gridder
    maker: ReferenceMaker
    aligner: Aligner

    def grid(self, frame: RgbdFrame, twist: FloatArray | None = None) -> GridFrame:
        """The frame on the ideal grid."""
        return self.gridder.on_grid(frame, np.zeros(6) if twist is None else twist)

    def reference(self, frame: RgbdFrame) -> Reference:
        """A frame as reference, at the origin."""
        return self.maker.of_frame(self.grid(frame), np.eye(4))

    def align(self, first: RgbdFrame, second: RgbdFrame, guess: FloatArray | None = None) -> DenseAlignment:
        """T_first_second."""
        return self.aligner.align(self.grid(second), self.reference(first), np.eye(4) if guess is None else guess)


# Of pixels that share no error.
EXACT = Calibration.registered_camera(SMALL, frame_sigma_m=0.0, frame_sigma_rad=0.0)


def bench(calibration: Calibration | None = None, **settings: Any) -> Bench:
    """For the small camera unless another calibration is given."""
    calibration = calibration or EXACT
    chosen = DenseSettings(**settings)
    gridder = Gridder(calibration, chosen)
    maker = ReferenceMaker(calibration.depth_noise)
    return Bench(gridder, maker, Aligner(calibration, chosen, gridder, maker))


def dense(calibration: Calibration | None = None, **settings: Any) -> DenseOdometry:
    """Dense odometry of the small camera unless another calibration is given."""
    chosen = DenseSettings(**settings)
    return DenseOdometry(calibration or EXACT, chosen)


def rolled(rows: list[RgbdFrame], stamp_s: float) -> RgbdFrame:
    """What a rolling shutter sees: row r of the frame taken at row r's time."""
    color, depth_m = rows[0].color.copy(), rows[0].depth_m.copy()
    for r, frame in enumerate(rows):
        color[r], depth_m[r] = frame.color[r], frame.depth_m[r]
    return replace(rows[0], stamp_s=stamp_s, color=color, depth_m=depth_m)


def apart(T_a: FloatArray, T_b: FloatArray) -> tuple[float, float]:
    """Metres and radians between two poses."""
    T = se3.invert(T_a) @ T_b
    return float(np.linalg.norm(T[:3, 3])), float(so3.angle(T[:3, :3]))


def _waves(p: FloatArray) -> FloatArray:
    """Grey (N,) at points (N, 3): waves of 0.2 to 0.9 m in every direction."""
    directions = np.array([[7, 2, 3], [-3, 8, 1], [1, -4, 9], [14, 11, -9], [-13, 17, 12], [25, -6, 19]], float)
    return 128 + 17 * np.sin(p @ directions.T + np.arange(6)).sum(axis=1)
