"""A room with boxes, seen through Kinect v1's noise from true poses: the model against the surfaces themselves."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
from scipy.spatial import KDTree

from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.geometry import FloatArray
from wheelsight.core.keyframes import FrameSurface
from wheelsight.mapping import SurfelMap

CAMERA = synthetic.CAMERA
GRID = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])


def distance_to_box(points: FloatArray, low: tuple[float, ...], high: tuple[float, ...]) -> FloatArray:
    """(n,) to the surface of an upright box, from inside and outside."""
    middle, half = np.add(low, high) / 2, np.subtract(high, low) / 2
    beyond = np.abs(points - middle) - half
    return np.abs(np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0))


def normals_of(depth_m: np.ndarray) -> np.ndarray:
    """(h, w, 3) by differences of points, towards the camera."""
    points = CAMERA.rays() * depth_m[..., None]
    normal = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    normal *= -np.sign((normal * points).sum(axis=-1, keepdims=True))
    return normal.astype(np.float32)


@pytest.mark.slow
def test_the_model_of_a_room_is_where_its_surfaces_are():
    surfel_map, seen = SurfelMap(), []
    trajectory = synthetic.wobbling_trajectory(60)
    for stamp_s, T in zip(trajectory.stamps_s, trajectory.T_frame_body, strict=True):
        exact_m = synthetic.render_room(T)[1]
        color, depth_m = synthetic.render_room(T, depth_noise=True)
        grey = (color @ [0.299, 0.587, 0.114]).astype(np.float32)
        image = FrameSurface(depth_m, normals_of(exact_m), grey, color.astype(np.float32))
        surfel_map.fuse(image, GRID, T, stamp_s, DepthNoise())
        points = (CAMERA.rays() * exact_m[..., None]).reshape(-1, 3)[::97]
        seen.append(points @ T[:3, :3].T + T[:3, 3])
    surfels = surfel_map.surfels("stable")
    boxes = [synthetic.ROOM, *synthetic.BOXES]
    error_m = np.min([distance_to_box(surfels.position.astype(float), *box) for box in boxes], axis=0)
    assert error_m.mean() < 0.004
    assert np.percentile(error_m, 95) < 0.012
    to_surfel_m, _ = KDTree(surfels.position).query(np.concatenate(seen))
    assert np.mean(to_surfel_m < 0.02) > 0.93
    view = surfel_map.predict(T, GRID, exact_m.shape)
    there = view.depth_m > 0
    assert there.mean() > 0.98
    assert np.median(np.abs(view.depth_m - exact_m)[there]) < 0.004
    assert np.median(np.abs(view.grey - grey)[there]) < 6
