"""Two ways to one pose, by two references: where both meet, for hops from keyframe to keyframe drift less so."""

from __future__ import annotations

import numpy as np

from wheelsight.estimates import MotionEstimate
from wheelsight.geometry import FloatArray, se3
from wheelsight.geometry import motion_kernels as motions

# Of the shorter way's certainty: where its reference is against the other's was found by a hop like it.
_HOPS = 2.0
# How far apart both may lie to say the same: χ² of 6, 99.9 %.
_CHI2 = 22.5


def met(T_map_short: FloatArray, short: MotionEstimate, T_map_long: FloatArray, long: MotionEstimate) -> FloatArray:
    """T_map_camera (4, 4) by the motions against the last reference and the one before, each as sure as it says.

    Where they contradict each other, or one does not show all directions, it is the short one's.
    """
    if not (short.shows_all and long.shows_all):
        return T_map_short
    C_short, C_long = _HOPS * _at_its_end(short), _at_its_end(long)
    off = se3.log(se3.invert(T_map_short) @ T_map_long)
    innovation = np.linalg.solve(C_short + C_long, off)
    if not off @ innovation < _CHI2:
        return T_map_short
    return np.asarray(se3.nearest(T_map_short @ se3.exp(C_short @ innovation)))


def _at_its_end(motion: MotionEstimate) -> FloatArray:
    """Covariance (6, 6) of a motion's right perturbation, in the frame of the camera that moved."""
    assert motion.T_reference_current is not None
    assert motion.covariance is not None
    return np.asarray(motions.carried(motions.inverse(motion.T_reference_current), motion.covariance))
