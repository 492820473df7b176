"""Errors of motions by a camera whose calibration has errors: of a body on a floor, by each of its point errors."""

from __future__ import annotations

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.camera_errors import best_twists, moved_in_camera_m
from wheelsight.core.geometry import FloatArray, se2, se3

_STEP = 1e-4
_PLANAR = (0, 1, 5)  # of (v, ω): along x, along y, about z
# Assumed points without an image: all over the image, one to four metres away.
_ACROSS, _DOWN, _DISTANCES_M = 9, 7, (1.0, 1.5, 2.0, 3.0, 4.0)


def motion_errors(calibration: Calibration, T_body_camera: FloatArray, points_m: FloatArray) -> FloatArray:
    """(K, 3, 3) matrices that map a small motion (x, y, yaw) of a body on a floor to its error, for each point error.

    A camera moves by the twist (v, ω), and points p of a static world by -(v + ω × p). The camera observes p + δ(p),
    and the estimated motion is the rigid one that fits best. To first order its error is the least-squares solution for
    D(v + ω × p) - ω × δ, with D the derivatives of δ. A δ proportional to p is a scale; a shift or rotation of all
    points is another mount. Points have the weight 1/z, between that of pixels (1/z²) and a uniform one. This agrees
    best with dense odometry on simulated drives (docs/decisions/calibration.md).

    Args:
        calibration: of the camera.
        T_body_camera: (4, 4); x and y of the body lie in the plane of the floor.
        points_m: (N, 3) points in view, in the camera frame.
    """
    twists = np.eye(6)[list(_PLANAR)] @ se3.adjoint(se3.invert(T_body_camera)).T
    here = moved_in_camera_m(calibration, points_m)
    found = np.empty((len(here), 6, len(twists)))
    for k, (v, w) in enumerate(twists.reshape(-1, 2, 3)):
        flow = v + np.cross(w, points_m)
        off = (moved_in_camera_m(calibration, points_m + _STEP * flow) - here) / _STEP - np.cross(w, here)
        found[..., k] = best_twists(points_m, off)
    return np.asarray((se3.adjoint(T_body_camera) @ found)[:, list(_PLANAR)])


def typical_motion_errors(calibration: Calibration) -> FloatArray:
    """`motion_errors` (K, 3, 3) of the base, of points one to four metres away. Raises CalibrationError: no camera."""
    _, camera = calibration.cameras
    assert calibration.T_base_camera is not None
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, _ACROSS), np.linspace(0, camera.height - 1, _DOWN))
    px = np.tile(np.stack([u.ravel(), v.ravel()], axis=-1), (len(_DISTANCES_M), 1))
    depth_m = np.repeat(_DISTANCES_M, _ACROSS * _DOWN)
    points_m = camera.back_project(px, depth_m)
    return motion_errors(calibration, calibration.T_base_camera, points_m)


def with_error(motions: FloatArray, error: FloatArray) -> FloatArray:
    """Motions (M, 3), x, y in metres and yaw in radians, as a camera with a `motion_errors` (3, 3) estimates them."""
    twists = se2.log(se2.from_parts(*motions.T))
    return np.stack(se2.to_parts(se2.exp(twists + twists @ error.T)), axis=-1)
