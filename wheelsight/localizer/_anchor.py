"""Anchor: the frame against which the camera's motions are told to the filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.estimates import DEGENERATE_SCALE, MotionEstimate
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A frame's pose by camera odometry, T_map_camera (4, 4).

    `covariance` (6, 6) is what its alignment left uncertain, in its own frame: all motions told against it share that.
    """

    T_map_camera: FloatArray
    covariance: FloatArray

    @classmethod
    def at(cls, T_map_camera: FloatArray, motion: MotionEstimate) -> Anchor:
        """A frame at a pose, which `motion` against its own reference has told."""
        assert motion.T_reference_current is not None
        assert motion.covariance is not None
        return cls(T_map_camera, motions.carried(motions.inverse(motion.T_reference_current), motion.covariance))

    def motion_to(self, T_map_camera: FloatArray, motion: MotionEstimate) -> MotionEstimate:
        """The motion from here to a pose that odometry found by `motion` against a reference of its own.

        Its covariance is what the last alignment left uncertain; directions that this did not show are named.
        """
        assert motion.T_reference_current is not None
        assert motion.covariance is not None
        T_anchor_camera = motions.mended(motions.times(motions.inverse(self.T_map_camera), T_map_camera))
        T_anchor_reference = motions.times(T_anchor_camera, motions.inverse(motion.T_reference_current))
        covariance, hidden = motions.carried(T_anchor_reference, motion.covariance), None
        if motion.degenerate is not None and not motion.shows_all:
            Ad = motions.adjoint(T_anchor_reference)
            hidden = np.linalg.qr(((motion.degenerate / DEGENERATE_SCALE) @ Ad.T * DEGENERATE_SCALE).T)[0].T
        return MotionEstimate(T_anchor_camera, covariance, None, motion.matches, motion.inliers, hidden)


def is_far(motion: MotionEstimate, way_m: float) -> bool:
    """Whether a motion against an anchor goes so far that the next one is due; a turn by a radian counts as 1.5 m."""
    T = motion.T_reference_current
    return T is not None and bool(motions.view_shift_m(T) > way_m)
