"""How far the map of a simulated drive is from the surfaces that its camera looked at."""

from __future__ import annotations

import numpy as np

from benchmarks.flat import SEEN_M
from benchmarks.true_surface import SurfaceBuilder, TrueSurface
from wheelsight.geometry import FloatArray, se3
from wheelsight.simulation import SimulatedRecording
from wheelsight.simulation.scene import Scene

WITHIN_M = 0.02
_A_SECOND = 3.0


def surface_of(source: SimulatedRecording) -> TrueSurface:
    """What the camera saw in a world where nothing moves, in the world frame, three times a second."""
    scene, camera = Scene(source.world), source.renderer.unit.lens.true
    builder, step = SurfaceBuilder(camera), max(1, round(source.renderer.rate_hz / _A_SECOND))
    for index in range(0, source.frame_count, step):
        T_world_camera = source.renderer.carriage.T_world_camera(np.array([source.renderer.taken_s(index)]))[0]
        depth_m = scene.cast(camera, T_world_camera).depth_m
        builder.add(depth_m, T_world_camera, (depth_m > 0) & (depth_m < SEEN_M))
    return builder.surface()


def share_within(points: FloatArray, T_world_map: FloatArray, surface: TrueSurface) -> float:
    """The share of points (n, 3) of a map that lie within 2 cm of the true surface; NaN of none."""
    if not len(points):
        return float("nan")
    return float(np.mean(surface.distances_m(se3.apply(T_world_map, points)) <= WITHIN_M))
