"""Systematic errors of a camera: how errors of its calibration affect estimated motions, and the error that all
pixels of a frame share.
"""

from __future__ import annotations

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.depth_errors import NOMINAL_ERRORS, PointErrors
from wheelsight.core.geometry import FloatArray, se2, se3, so3

_STEP = 1e-4
_PLANAR = (0, 1, 5)  # of (v, ω): along x, along y, about z
# Assumed points without an image: all over the image, one to four metres away.
_ACROSS, _DOWN, _DISTANCES_M = 9, 7, (1.0, 1.5, 2.0, 3.0, 4.0)


def errors_of(calibration: Calibration) -> PointErrors:
    """Return the point errors of a camera by its calibration, or those of nominal values."""
    return NOMINAL_ERRORS if calibration.point_errors is None else calibration.point_errors


def moved_in_camera_m(calibration: Calibration, points_m: FloatArray) -> FloatArray:
    """Return the displacement (K, N, 3), metres, of points (N, 3) in the camera frame by each of these errors."""
    T_color_camera = calibration.T_color_camera
    moved_m = errors_of(calibration).moved_m(se3.apply(T_color_camera, points_m))
    return np.asarray(moved_m @ T_color_camera[:3, :3])


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
        found[..., k] = _best_twists(points_m, off)
    return np.asarray((se3.adjoint(T_body_camera) @ found)[:, list(_PLANAR)])


def place_errors(calibration: Calibration, T_first_second: FloatArray, points_m: FloatArray) -> FloatArray:
    """(K, 6) left perturbations (v, ω) by each point error of a relative pose (4, 4) estimated from two views.

    The first view observes a point p at p + δ(p), the second one at q + δ(q), where T q = p. For equal views δ cancels;
    else the distance of the point and its pixel differ, and so does δ. The pose is the rigid motion that fits best,
    with the weights of `motion_errors`.

    Args:
        calibration: of the camera of both views.
        T_first_second: (4, 4).
        points_m: (N, 3) points in both views, in the first view's frame; at least three, not collinear.
    """
    seen_m = se3.apply(se3.invert(T_first_second), points_m)
    moved_m = moved_in_camera_m(calibration, seen_m) @ T_first_second[:3, :3].T
    return _best_twists(points_m, moved_in_camera_m(calibration, points_m) - moved_m)


def _best_twists(points_m: FloatArray, moved_m: FloatArray) -> FloatArray:
    """(K, 6) twists (v, ω) that fit displacements (K, N, 3) of points (N, 3) best, with weights 1/z."""
    of_points = np.concatenate([np.tile(np.eye(3), (len(points_m), 1, 1)), -so3.hat(points_m)], axis=-1)
    weighted = of_points / points_m[:, 2, None, None]
    H = np.einsum("nij,nik->jk", weighted, of_points)
    return np.asarray(np.linalg.solve(H, np.einsum("nij,kni->jk", weighted, moved_m)).T)


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


def frame_covariance(calibration: Calibration) -> FloatArray:
    """Covariance (6, 6) of (v, ω) in the camera's own frame by errors common to all pixels of a frame."""
    return np.diag(np.square([*[calibration.frame_sigma_m] * 3, *[calibration.frame_sigma_rad] * 3]))


def with_frame_error(covariance: FloatArray, T_reference_frame: FloatArray, of_frame: FloatArray) -> FloatArray:
    """Covariance (6, 6) of a pose's (4, 4) left perturbation, plus the error `of_frame` (6, 6) in the frame's axes."""
    Ad = se3.adjoint(T_reference_frame)
    return np.asarray(covariance + Ad @ of_frame @ Ad.T)
