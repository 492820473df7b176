"""Frames and poses as they come to a surfel map: refused where they are none, else ready for its kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from wheelsight.checks import why_not_metres
from wheelsight.errors import MapError
from wheelsight.geometry import Float32Array, FloatArray, se3
from wheelsight.views import Surface

_NONE_LARGER_PX = 4096
_KNOWN_POSES = "fuse, predict and move only where the pose is known"
_UNITS = {
    "depth_m": "divide raw depth by its units a metre: of millimetres, (depth / 1000).astype(np.float32)",
    "normal": "unit vectors in the camera frame",
    "grey": "0 to 255, -1 where unknown",
    "color": "0 to 255, -1 where unknown",
}


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


def checked_frame(surface: Surface, far_m: float) -> Frame:
    """The frame, if its images are of one shape and its depth in metres; else MapError.

    Pixels whose depth is no number add nothing.

    Args:
        far_m: as far as the camera is trusted.
    """
    given = {name: _array(name, getattr(surface, name)) for name in ("depth_m", "normal", "grey")}
    depth_m = given["depth_m"]
    if depth_m.ndim != 2 or not 0 < max(depth_m.shape) <= _NONE_LARGER_PX:
        raise MapError(f"depth_m is of shape {depth_m.shape}, not (h, w)")
    color = np.empty((0, 0, 3), np.float32) if surface.color is None else _array("color", surface.color)
    for name, image in (given if surface.color is None else given | {"color": color}).items():
        expected = (*depth_m.shape, 3) if name in ("normal", "color") else depth_m.shape
        if image.shape != expected:
            raise MapError(f"{name} is of shape {image.shape}, not {expected} as depth_m asks")
    if wrong := why_not_metres(depth_m, far_m):
        raise MapError(f"depth_m {wrong[0]}", fix=wrong[1])
    return Frame(depth_m, given["normal"], color, given["grey"])


def _array(name: str, image: Any) -> Float32Array:
    if not isinstance(image, np.ndarray):
        raise MapError(f"{name} is a {type(image).__name__}, not an array", fix="np.asarray(image, np.float32)")
    is_bytes = name == "color" and image.dtype == np.uint8
    if image.dtype.kind != "f" and not is_bytes:
        raise MapError(f"{name} is of {image.dtype}, not float32", fix=_UNITS[name])
    return np.ascontiguousarray(image, np.float32)


def checked_pose(T_map_camera: FloatArray, intrinsics: FloatArray) -> Pose:
    """The pose, if it is one; else MapError."""
    T = checked_motion(T_map_camera, "T_map_camera")
    try:
        grid = np.ascontiguousarray(intrinsics, float)
    except (TypeError, ValueError) as error:
        raise MapError("intrinsics are not fx, fy, cx, cy") from error
    if grid.shape != (4,) or not np.isfinite(grid).all() or min(grid[:2]) <= 0:
        raise MapError("intrinsics are not fx, fy, cx, cy with positive focal lengths")
    return Pose(T, grid)


def checked_motion(T: FloatArray, name: str) -> FloatArray:
    """The rigid motion (4, 4), if it is one; else MapError."""
    try:
        T = np.ascontiguousarray(T, float)
    except (TypeError, ValueError) as error:
        raise MapError(f"{name} is a {type(T).__name__}, not (4, 4) of numbers", fix=_KNOWN_POSES) from error
    if wrong := se3.why_invalid(T, tolerance=1e-4):
        raise MapError(f"{name} is not a rigid motion: {wrong[0]}", fix=f"{wrong[1]}; {_KNOWN_POSES}")
    return T
