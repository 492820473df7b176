"""Systematic errors of a camera: how errors of its calibration affect estimated motions, and the error that all
pixels of a frame share.
"""

from __future__ import annotations

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.depth_errors import NOMINAL_ERRORS, PointErrors
from wheelsight.core.geometry import FloatArray, se3, so3


def errors_of(calibration: Calibration) -> PointErrors:
    """Return the point errors of a camera by its calibration, or those of nominal values."""
    return NOMINAL_ERRORS if calibration.point_errors is None else calibration.point_errors


def moved_in_camera_m(calibration: Calibration, points_m: FloatArray) -> FloatArray:
    """Return the displacement (K, N, 3), metres, of points (N, 3) in the camera frame by each of these errors."""
    T_color_camera = calibration.T_color_camera
    moved_m = errors_of(calibration).moved_m(se3.apply(T_color_camera, points_m))
    return np.asarray(moved_m @ T_color_camera[:3, :3])


def place_errors(calibration: Calibration, T_first_second: FloatArray, points_m: FloatArray) -> FloatArray:
    """(K, 6) left perturbations (v, ω) by each point error of a relative pose (4, 4) estimated from two views.

    The first view observes a point p at p + δ(p), the second one at q + δ(q), where T q = p. For equal views δ cancels;
    else the distance of the point and its pixel differ, and so does δ. The pose is the rigid motion that fits best.

    Args:
        calibration: of the camera of both views.
        T_first_second: (4, 4).
        points_m: (N, 3) points in both views, in the first view's frame; at least three, not collinear.
    """
    seen_m = se3.apply(se3.invert(T_first_second), points_m)
    moved_m = moved_in_camera_m(calibration, seen_m) @ T_first_second[:3, :3].T
    return best_twists(points_m, moved_in_camera_m(calibration, points_m) - moved_m)


def best_twists(points_m: FloatArray, moved_m: FloatArray) -> FloatArray:
    """(K, 6) twists (v, ω) that fit displacements (K, N, 3) of points (N, 3) best, with weights 1/z.

    These are between those of pixels (1/z²) and uniform ones, and agree best with dense odometry on simulated drives
    (docs/decisions/calibration.md).
    """
    of_points = np.concatenate([np.tile(np.eye(3), (len(points_m), 1, 1)), -so3.hat(points_m)], axis=-1)
    weighted = of_points / points_m[:, 2, None, None]
    H = np.einsum("nij,nik->jk", weighted, of_points)
    return np.asarray(np.linalg.solve(H, np.einsum("nij,kni->jk", weighted, moved_m)).T)


def frame_covariance(calibration: Calibration) -> FloatArray:
    """Covariance (6, 6) of (v, ω) in the camera's own frame by errors common to all pixels of a frame."""
    return np.diag(np.square([*[calibration.frame_sigma_m] * 3, *[calibration.frame_sigma_rad] * 3]))
