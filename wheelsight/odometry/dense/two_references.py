"""One pose by two references: where both meet, for chains of keyframe-to-keyframe motions drift less so."""

from __future__ import annotations

import numpy as np

from wheelsight.estimates import MotionEstimate
from wheelsight.geometry import FloatArray, se3
from wheelsight.geometry import motion_kernels as motions
from wheelsight.odometry.dense.settings_parts import KeyframeSettings


def joined(
    T_map_short: FloatArray,
    short: MotionEstimate,
    T_map_long: FloatArray,
    long: MotionEstimate,
    settings: KeyframeSettings,
    shared: FloatArray,
) -> FloatArray:
    """T_map_camera (4, 4) by the motions against the last keyframe and the one before, each as sure as it says.

    Where they contradict each other, or one does not show all directions, it is the short one's. That one's covariance
    counts several times, since where its keyframe is against the other's was found by a motion like it. What both have
    wrong of the frame is `shared` (6, 6), a right perturbation: it speaks for neither.
    """
    if not (short.shows_all and long.shows_all):
        return T_map_short
    C_short, C_long = settings.short_motions * (_at_its_end(short) - shared), _at_its_end(long) - shared
    off = se3.log(se3.invert(T_map_short) @ T_map_long)
    C = np.ascontiguousarray(C_short + C_long)
    if not (np.isfinite(C).all() and motions.is_definite(C)):  # what is left of both is less than rounding
        return T_map_short
    innovation = np.linalg.solve(C, off)
    if not off @ innovation < settings.joined_chi2:
        return T_map_short
    return np.asarray(se3.nearest(T_map_short @ se3.exp(C_short @ innovation)))


def _at_its_end(motion: MotionEstimate) -> FloatArray:
    """Covariance (6, 6) of a motion's right perturbation, in the frame of the camera that moved."""
    assert motion.T_reference_current is not None
    assert motion.covariance is not None
    return np.asarray(motions.carried(motions.inverse(motion.T_reference_current), motion.covariance))
