"""Planes seen by a small camera, exactly or with a depth sensor's noise, and maps made of them."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.geometry import Float32Array, FloatArray, se3, so3
from wheelsight.core.keyframes import FrameSurface, Keyframe, KeyframeId, KeyframeStore
from wheelsight.mapping import FusedFrame, SurfelMap, Surfels, SurfelSettings

GRID = np.array([131.0, 131.0, 80.2, 59.4])
SHAPE = (120, 160)
NOISE = DepthNoise(constant_m=0.001, quadratic_per_m=1.425e-3, near_m=0.2, far_m=8.0)
FRAME_S = 1 / 30


@dataclass(frozen=True)
class Wall:
    """The plane z = `depth_m + slope · x` of the world, within `low` to `high` of x."""

    depth_m: float = 2.0
    slope: float = 0.0
    low: float = -np.inf
    high: float = np.inf

    @property
    def normal(self) -> FloatArray:
        return np.array([self.slope, 0.0, -1.0]) / np.hypot(self.slope, 1.0)

    def distance(self, points: FloatArray | Float32Array) -> FloatArray:
        """Signed distances (...) of points (..., 3)."""
        return np.asarray((points - [0.0, 0.0, self.depth_m]) @ self.normal)


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> FloatArray:
    """T_map_camera of a camera that looks along z, turned about y."""
    return se3.from_parts(so3.exp(np.array([0.0, yaw, 0.0])), np.array([x, y, z]))


def rays(grid: FloatArray = GRID, shape: tuple[int, int] = SHAPE) -> FloatArray:
    u, v = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    return np.stack([(u - grid[2]) / grid[0], (v - grid[3]) / grid[1], np.ones(shape)], axis=-1)


def see(
    walls: list[Wall],
    T_map_camera: FloatArray,
    rng: np.random.Generator | None = None,
    grid: FloatArray = GRID,
    shape: tuple[int, int] = SHAPE,
) -> FrameSurface:
    """The nearest of the walls at each pixel; with the noise of NOISE where `rng` is given."""
    directions = rays(grid, shape) @ T_map_camera[:3, :3].T
    depth_m, normal = np.full(shape, np.inf), np.zeros((*shape, 3))
    for wall in walls:
        z = -wall.distance(T_map_camera[:3, 3]) / (directions @ wall.normal)
        x = T_map_camera[0, 3] + z * directions[..., 0]
        nearer = (z > 0) & (z < depth_m) & (wall.low <= x) & (x <= wall.high)
        depth_m[nearer], normal[nearer] = z[nearer], wall.normal @ T_map_camera[:3, :3]
    depth_m[np.isinf(depth_m)] = 0.0
    points = T_map_camera[:3, 3] + directions * depth_m[..., None]
    grey = 128 + 60 * np.sin(4 * points[..., 0]) * np.cos(3 * points[..., 1])
    color = np.stack([grey, 0.5 * grey, 255 - grey], axis=-1)
    if rng is not None:
        depth_m = np.where(depth_m > 0, depth_m + NOISE.sigma_m(depth_m) * rng.standard_normal(shape), 0.0)
    return FrameSurface(*(image.astype(np.float32) for image in (depth_m, normal, grey, color)))


def kept_keyframes(count: int) -> KeyframeStore:
    """So many at poses 0.3 m apart, of which nothing is seen."""
    store = KeyframeStore()
    for k in range(count):
        store.add(Keyframe(0.1 * k, GRID, b"", b""), pose(0.3 * k, yaw=0.1 * k))
    return store


def fuse(
    surfel_map: SurfelMap, view: FrameSurface, T_map_camera: FloatArray, stamp_s: float, keyframe: int | None = None
) -> FusedFrame:
    number = None if keyframe is None else KeyframeId(keyframe)
    return surfel_map.fuse(view, GRID, T_map_camera, stamp_s, NOISE, keyframe=number)


def look_at(
    surfel_map: SurfelMap,
    walls: list[Wall],
    poses: list[FloatArray],
    rng: np.random.Generator | None = None,
    start_s: float = 0.0,
) -> list[FusedFrame]:
    """Fuse what is seen from poses, 30 a second."""
    return [fuse(surfel_map, see(walls, T, rng), T, start_s + k * FRAME_S) for k, T in enumerate(poses)]


def made_map(**settings: Any) -> SurfelMap:
    return SurfelMap(SurfelSettings(**settings))


def crowd(count: int, keyframes: int = 1) -> SurfelMap:
    """A map of stable surfels anywhere in a room, on keyframes at the origin; in no order."""
    rng, made = np.random.default_rng(3), SurfelMap(SurfelSettings(max_surfels=2 * count))
    made.restore(0, np.tile(np.eye(4), (keyframes, 1, 1)))
    position = rng.uniform((0, 0, 0), (6, 5, 2.5), (count, 3)).astype(np.float32)
    normal = np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    flat, seen_s = np.ones(count, np.float32), np.zeros(count)
    color = rng.integers(0, 256, (count, 3)).astype(np.float32)
    numbers = rng.integers(0, keyframes, count).astype(np.int32)
    made.add(Surfels(position, normal, 0.01 * flat, color, flat, 50 * flat, 1e-5 * flat, seen_s, seen_s, numbers), 0.0)
    return made


def peak_bytes(do: Callable[[], object]) -> int:
    """What it takes at most above what is held before, as Python and NumPy ask for it."""
    tracemalloc.start()
    try:
        do()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
