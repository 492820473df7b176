"""Mount: a motion that the camera saw, as the base's, checked for being one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.estimates import DEGENERATE_SCALE, MotionEstimate, Reason
from wheelsight.fusion.error_state import _relative_pose_kernels as relative
from wheelsight.fusion.error_state._measurements import RelativePose
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions

_ALL, _NONE = np.eye(6), np.zeros((0, 6))


class Mount:
    """Where the camera sits on the base: T_base_camera (4, 4)."""

    def __init__(self, T_base_camera: FloatArray) -> None:
        self.T_base_camera = T_base_camera
        self._T_camera_base = motions.inverse(T_base_camera)
        self._Ad_base_camera = motions.adjoint(T_base_camera)
        self._to_camera = DEGENERATE_SCALE[:, None] * motions.inverse_adjoint(T_base_camera)
        self._from_camera = self._Ad_base_camera / DEGENERATE_SCALE

    def spread(self, covariance: FloatArray) -> FloatArray:
        """Of a perturbation in the camera's frame (6, 6), in the base's."""
        return np.asarray(self._Ad_base_camera @ covariance @ self._Ad_base_camera.T)

    def measurement(self, motion: MotionEstimate, name: str) -> RelativePose | Reason:
        """What a motion against the pose remembered as `name` says, or why it says nothing."""
        if motion.T_reference_current is None or motion.covariance is None:
            return motion.reason or Reason.INVALID
        T, R = np.array(motion.T_reference_current, float), np.array(motion.covariance, float)
        split = _split(motion.degenerate)
        if T.shape != (4, 4) or R.shape != (6, 6) or split is None or not motions.is_pose(T, R):
            return Reason.INVALID
        seen, unseen = split
        if len(seen) == 0:
            return Reason.DEGENERATE
        shown, rows, spread = relative.shown(R, seen, unseen, DEGENERATE_SCALE, self._to_camera, self._from_camera)
        if not motions.is_definite(shown):
            return Reason.INVALID
        Z = motions.times(motions.times(self.T_base_camera, T), self._T_camera_base)
        share = motion.inliers / motion.matches if motion.matches > 0 else None
        return RelativePose(name, Z, rows, shown, spread, share, motion.fitting)


def motion_of(T: ArrayLike | None) -> FloatArray | None:
    """A rigid motion (4, 4), or None where it is none."""
    found = numbers_of(T)
    return found if found is not None and found.shape == (4, 4) and motions.is_motion(found) else None


def covariance_of(C: ArrayLike | None, size: int) -> FloatArray | None:
    """A covariance (size, size), made exactly symmetric, or None where it is none."""
    found = numbers_of(C)
    is_one = found is not None and found.shape == (size, size) and motions.is_covariance(found)
    return (found + found.T) / 2 if found is not None and is_one else None


def numbers_of(value: ArrayLike | None) -> FloatArray | None:
    """An array of numbers of any shape, or None where it is none."""
    try:
        return np.array(value, float)
    except (TypeError, ValueError):
        return None


def _split(hidden: FloatArray | None) -> tuple[FloatArray, FloatArray] | None:
    """Orthonormal rows (6 - K, 6) of the directions seen, and (K, 6) of those `hidden`; None where these are none."""
    if hidden is None:
        return _ALL, _NONE
    hidden = np.asarray(hidden, float)
    if hidden.ndim != 2 or hidden.shape[1] != 6 or not np.isfinite(hidden).all():
        return None
    if len(hidden) == 0:
        return _ALL, _NONE
    _, strength, rows = np.linalg.svd(hidden)
    rank = int((strength > 1e-6).sum())
    return rows[rank:], rows[:rank]
