"""How far the map of a simulated drive is from the surfaces that its camera looked at."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from benchmarks.flat import SEEN_M
from benchmarks.true_surface import SurfaceBuilder, TrueSurface
from wheelsight.core.geometry import FloatArray, se3
from wheelsight_sim import SimulatedRecording
from wheelsight_sim.scene import Scene

WITHIN_M = 0.02
_A_SECOND = 3.0
_FITTED, _ROUNDS, _FAR_M = 50_000, 12, 0.08


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
    """The share of points (n, 3) of a map that lie within 2 cm of the true surface, as they fit best; NaN of none.

    Where the trajectory has the map, an error of the camera's mount shifts all of it.
    """
    if not len(points):
        return float("nan")
    T_fitted = fitted(points, T_world_map, surface)
    return float(np.mean(surface.distances_m(se3.apply(T_fitted, points)) <= WITHIN_M))


def fitted(points: FloatArray, T_world_map: FloatArray, surface: TrueSurface) -> FloatArray:
    """T_world_map (4, 4) by which points (n, 3) lie nearest to the planes of the surface, from a first guess on."""
    some, tree, T = points[:: max(1, len(points) // _FITTED)], KDTree(surface.points), T_world_map
    for _ in range(_ROUNDS):
        here = se3.apply(T, some)
        near = tree.query(here)[1]
        n = surface.normals[near]
        off_m = ((here - surface.points[near]) * n).sum(axis=1)
        weight = np.where(np.abs(off_m) < _FAR_M, 1 / (1 + (off_m / WITHIN_M) ** 2), 0.0)
        J = np.concatenate([n, np.cross(here, n)], axis=1)
        H = (J * weight[:, None]).T @ J + 1e-9 * len(J) * np.eye(6)
        T = se3.exp(-np.linalg.solve(H, J.T @ (weight * off_m))) @ T
    return np.asarray(se3.nearest(T))
