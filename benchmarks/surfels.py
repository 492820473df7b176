"""How quick the surfel map is: views predicted and frames fused, and whether a longer drive makes them slower."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass

import numpy as np

from benchmarks.machine import is_busy
from wheelsight.calibration import DepthNoise
from wheelsight.geometry import Float32Array, FloatArray, se3, so3
from wheelsight.mapping import SurfelMap, Surfels, SurfelSettings

_GRID = np.array([262.5, 262.5, 159.75, 119.75])
_SHAPE = (240, 320)
_NOISE = DepthNoise()
_HALF_WIDTH_M, _HALF_HEIGHT_M = 1.5, 1.25
_STEP_M = 0.02
_FRAME_S = 1 / 30
_REPEATS = 9
# Surfels of a whole building, out of sight.
_ELSEWHERE = 700_000
_PITCH_M = 0.0115


@dataclass(frozen=True, slots=True)
class SurfelTimes:
    """Medians and minima in milliseconds, at 320×240.

    Attributes:
        threads: that shared a frame's rows.
        in_view, surfels: of the map that was predicted from and fused into.
        predict_ms, fuse_ms: medians. predict_least_ms, fuse_least_ms: the shortest.
        predict_cpu_ms, fuse_cpu_ms: least processor time, of all threads together; other programs hardly change it.
        first_ms, last_ms: a frame, predicted and fused, in the first and the last quarter of a drive down a corridor.
        frames: of that drive. grown: surfels it left.
        was_busy: whether other programs ran: medians are then too long.
    """

    threads: int
    in_view: int
    surfels: int
    predict_ms: float
    predict_least_ms: float
    fuse_ms: float
    fuse_least_ms: float
    predict_cpu_ms: float
    fuse_cpu_ms: float
    first_ms: float
    last_ms: float
    frames: int
    grown: int
    was_busy: bool


def measure_surfels(threads: int = 2, frames: int = 400) -> SurfelTimes:
    """Time a large map and a drive down a corridor; compiled kernels are warmed first."""
    was_busy = is_busy()
    dense = _dense_map(threads)
    T, (depth_m, normal, grey) = _pose(0.0), _corridor(0.0)
    stamp_s = dense.stamp_s
    dense.predict(T, _GRID, _SHAPE)
    predicting, fusing, cpu = [], [], []
    in_view = dense.in_view(T, _GRID, _SHAPE)
    for _ in range(_REPEATS):
        stamp_s += _FRAME_S
        begin, cpu_begin = time.perf_counter(), time.process_time()
        dense.predict(T, _GRID, _SHAPE)
        between, cpu_between = time.perf_counter(), time.process_time()
        dense.fuse(depth_m, normal, grey, None, _GRID, T, stamp_s, _NOISE)
        predicting.append(1e3 * (between - begin))
        fusing.append(1e3 * (time.perf_counter() - between))
        cpu.append((1e3 * (cpu_between - cpu_begin), 1e3 * (time.process_time() - cpu_between)))
    medians = (statistics.median(predicting), min(predicting), statistics.median(fusing), min(fusing))
    predict_cpu_ms, fuse_cpu_ms = np.min(cpu, axis=0).tolist()
    first_ms, last_ms, grown = _drive(threads, frames)
    return SurfelTimes(
        threads, in_view, len(dense), *medians, predict_cpu_ms, fuse_cpu_ms, first_ms, last_ms, frames, grown, was_busy
    )


def _drive(threads: int, frames: int) -> tuple[float, float, int]:
    """Median milliseconds a frame in the first and the last quarter, and the surfels left."""
    surfel_map = SurfelMap(SurfelSettings(threads=threads))
    times_ms = []
    rng = np.random.default_rng(0)
    for k in range(frames + _REPEATS):
        x = k * _STEP_M
        T, (depth_m, normal, grey) = _pose(x), _corridor(x)
        noisy = depth_m + (_NOISE.sigma_m(depth_m.astype(float)) * rng.standard_normal(_SHAPE)).astype(np.float32)
        begin = time.perf_counter()
        surfel_map.predict(T, _GRID, _SHAPE)
        surfel_map.fuse(noisy, normal, grey, None, _GRID, T, k * _FRAME_S, _NOISE)
        times_ms.append(1e3 * (time.perf_counter() - begin))
    # The first frames find an empty map, which costs less than any other.
    settled = times_ms[_REPEATS:]
    quarter = len(settled) // 4
    return statistics.median(settled[:quarter]), statistics.median(settled[-quarter:]), len(surfel_map)


def _dense_map(threads: int) -> SurfelMap:
    """A corridor covered by surfels a centimetre apart, all of it stable and active, and more of them elsewhere."""
    surfel_map = SurfelMap(SurfelSettings(threads=threads))
    across = np.arange(-_HALF_WIDTH_M, _HALF_WIDTH_M, _PITCH_M)
    upright = np.arange(-_HALF_HEIGHT_M, _HALF_HEIGHT_M, _PITCH_M)
    along = np.arange(0.3, 5.0, _PITCH_M)
    faces = [
        (np.stack(np.meshgrid(along, upright), -1).reshape(-1, 2), 1, side * _HALF_WIDTH_M) for side in (-1, 1)
    ] + [(np.stack(np.meshgrid(along, across), -1).reshape(-1, 2), 2, side * _HALF_HEIGHT_M) for side in (-1, 1)]
    for flat, axis, offset in faces:
        position = np.insert(flat, axis, offset, axis=1)
        normal = np.zeros_like(position)
        normal[:, axis] = -np.sign(offset)
        surfel_map.add(_surfels(position, normal), 0.0)
    rng = np.random.default_rng(1)
    far = rng.uniform(-30, 30, (_ELSEWHERE, 3)) * [1, 1, 0] - [60, 0, 0]
    surfel_map.add(_surfels(far, np.tile([0.0, 0, 1], (_ELSEWHERE, 1))), 0.0)
    return surfel_map


def _surfels(position: FloatArray, normal: FloatArray) -> Surfels:
    n = len(position)
    flat = np.ones(n, np.float32)
    color = np.full((n, 3), 128, np.float32)
    stamps_s = np.zeros(n)
    shape = (position.astype(np.float32), normal.astype(np.float32), 1.4 * _PITCH_M * flat)
    return Surfels(*shape, color, 128 * flat, 20 * flat, 1e-6 * flat, stamps_s, stamps_s)


def _pose(x: float) -> FloatArray:
    """T_world_camera of a camera that looks along the corridor, world x."""
    R_world_camera = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    return se3.from_parts(so3.exp(np.array([0.0, 0.0, 0.2])) @ R_world_camera, np.array([x, 0.0, 0.0]))


def _corridor(x: float) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Depth, normals and grey of the corridor's four sides, 5 m of it in sight."""
    T = _pose(x)
    u, v = np.meshgrid(np.arange(_SHAPE[1]), np.arange(_SHAPE[0]))
    rays = np.stack([(u - _GRID[2]) / _GRID[0], (v - _GRID[3]) / _GRID[1], np.ones(_SHAPE)], axis=-1) @ T[:3, :3].T
    with np.errstate(divide="ignore"):
        to_side, to_floor = _HALF_WIDTH_M / np.abs(rays[..., 1]), _HALF_HEIGHT_M / np.abs(rays[..., 2])
    depth_m = np.minimum(to_side, to_floor)
    normal = np.zeros((*_SHAPE, 3))
    is_side = to_side < to_floor
    normal[..., 1] = np.where(is_side, -np.sign(rays[..., 1]), 0)
    normal[..., 2] = np.where(is_side, 0, -np.sign(rays[..., 2]))
    points = T[:3, 3] + rays * depth_m[..., None]
    grey = 128 + 60 * np.sin(5 * points[..., 0]) * np.cos(3 * points[..., 1] + 2 * points[..., 2])
    depth_m[depth_m > 5.0] = 0.0
    return depth_m.astype(np.float32), (normal @ T[:3, :3]).astype(np.float32), grey.astype(np.float32)
