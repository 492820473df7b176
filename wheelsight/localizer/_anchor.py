"""Anchor: the frame against which the camera's motions are told to the filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.estimates import DEGENERATE_SCALE, MotionEstimate
from wheelsight.geometry import FloatArray, se3

# Against an anchor that is held for a while, errors of single frames do not add up.
_FAR_M = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A frame's pose by camera odometry, T_world_camera (4, 4).

    `covariance` (6, 6) is what its alignment left uncertain, in its own frame: all motions told against it share that.
    """

    T_world_camera: FloatArray
    covariance: FloatArray

    @classmethod
    def at(cls, T_world_camera: FloatArray, motion: MotionEstimate) -> Anchor:
        """A frame at a pose, which `motion` against its own reference has told."""
        Ad = se3.adjoint(se3.invert(T_world_camera))
        return cls(T_world_camera, Ad @ _in_world(T_world_camera, motion)[1] @ Ad.T)

    def is_far_from(self, T_world_camera: FloatArray) -> bool:
        """Whether a pose (4, 4) is so far off that the next anchor is due; a turn by a radian counts as 1.5 m."""
        return bool(se3.view_shift_m(se3.invert(self.T_world_camera) @ T_world_camera) > _FAR_M)

    def motion_to(self, T_world_camera: FloatArray, motion: MotionEstimate) -> MotionEstimate:
        """The motion from here to a pose that odometry found by `motion` against a reference of its own.

        Its covariance is what the last alignment left uncertain; directions that this did not show are named.
        """
        T_anchor_world = se3.invert(self.T_world_camera)
        Ad = se3.adjoint(T_anchor_world)
        to_world, covariance = _in_world(T_world_camera, motion)
        covariance = Ad @ covariance @ Ad.T
        hidden = None
        if motion.degenerate is not None and not motion.shows_all:
            turned = (motion.degenerate / DEGENERATE_SCALE) @ (Ad @ to_world).T * DEGENERATE_SCALE
            hidden = np.linalg.qr(turned.T)[0].T
        T_anchor_camera = se3.nearest(T_anchor_world @ T_world_camera)
        return MotionEstimate(T_anchor_camera, covariance, None, motion.matches, motion.inliers, hidden)


def _in_world(T_world_camera: FloatArray, motion: MotionEstimate) -> tuple[FloatArray, FloatArray]:
    """What takes perturbations (6,) in the motion's reference to the world, (6, 6), and its covariance (6, 6) there."""
    assert motion.T_reference_current is not None
    assert motion.covariance is not None
    Ad = se3.adjoint(T_world_camera @ se3.invert(motion.T_reference_current))
    return Ad, Ad @ motion.covariance @ Ad.T
