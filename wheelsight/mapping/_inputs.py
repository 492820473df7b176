"""Frames and poses as they come to a surfel map: refused where they are none, else ready for its kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry import Float32Array, FloatArray, se3
from wheelsight.views import Surface

_NONE_LARGER_PX = 4096


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Depth (h, w), normals (h, w, 3), colour (h, w, 3) and grey (h, w) of a frame, as `SurfelMap.fuse` takes them.

    Without colour, `color` is (0, 0, 3).
    """

    depth_m: Float32Array
    normal: Float32Array
    color: Float32Array
    grey: Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """T_map_camera (4, 4) and fx, fy, cx, cy (4,)."""

    T: FloatArray
    grid: FloatArray

    @property
    def T32(self) -> Float32Array:
        return self.T.astype(np.float32)

    @property
    def grid32(self) -> Float32Array:
        return self.grid.astype(np.float32)

    @property
    def pitch(self) -> np.float32:
        """Size of a pixel at one metre."""
        return np.float32(1 / min(self.grid[:2]))


def rays_of(grid: FloatArray, shape: tuple[int, ...]) -> tuple[Float32Array, Float32Array]:
    """Slopes of the columns (w,) and rows (h,) of a camera fx, fy, cx, cy."""
    fx, fy, cx, cy = grid
    x, y = (np.arange(shape[1]) - cx) / fx, (np.arange(shape[0]) - cy) / fy
    return x.astype(np.float32), y.astype(np.float32)


def checked_frame(surface: Surface) -> Frame:
    """The frame, if its images are of one shape; else MapError."""
    depth_m, color = surface.depth_m, surface.color
    if depth_m.ndim != 2 or not 0 < max(depth_m.shape) <= _NONE_LARGER_PX:
        raise MapError(f"depth_m is of shape {depth_m.shape}, not (h, w)")
    images = {"normal": surface.normal, "grey": surface.grey} | ({} if color is None else {"color": color})
    for name, image in images.items():
        expected = depth_m.shape if name == "grey" else (*depth_m.shape, 3)
        if image.shape != expected:
            raise MapError(f"{name} is of shape {image.shape}, not {expected} as depth_m asks")
    color = np.empty((0, 0, 3), np.float32) if color is None else color
    given = (depth_m, surface.normal, color, surface.grey)
    return Frame(*(np.ascontiguousarray(image, np.float32) for image in given))


def checked_pose(T_map_camera: FloatArray, intrinsics: FloatArray) -> Pose:
    """The pose, if it is one; else MapError."""
    T, grid = checked_motion(T_map_camera, "T_map_camera"), np.ascontiguousarray(intrinsics, float)
    if grid.shape != (4,) or not np.isfinite(grid).all() or min(grid[:2]) <= 0:
        raise MapError("intrinsics are not fx, fy, cx, cy with positive focal lengths")
    return Pose(T, grid)


def checked_motion(T: FloatArray, name: str) -> FloatArray:
    """The rigid motion (4, 4), if it is one; else MapError."""
    T = np.ascontiguousarray(T, float)
    if T.shape != (4, 4) or not np.isfinite(T).all() or not se3.is_valid(T, tolerance=1e-4):
        raise MapError(f"{name} is not a rigid motion", fix="fuse, predict and move only where the pose is known")
    return T
