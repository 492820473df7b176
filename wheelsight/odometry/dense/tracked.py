"""Tracked: a frame whose pose is known, and what is answered of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from wheelsight.estimates import CameraEstimate, MotionEstimate
from wheelsight.geometry import FloatArray, se3
from wheelsight.keyframes import KeyframeId
from wheelsight.odometry.dense.grid import GridFrame
from wheelsight.odometry.dense.joint import Joint
from wheelsight.odometry.dense.keypoint_pose import KeypointPose
from wheelsight.odometry.frame_error import with_frame_error


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """A frame with its pose.

    Attributes:
        frame: on the ideal grid.
        T_map_camera: (4, 4).
        covariance: (6, 6) of the left perturbation (v, ω) of that.
        motion: against the reference that the pose was found by.
        keyframe: on which the pose hangs: it moves with that one.
        twist: (6,) velocity (v, ω) in the camera's own frame.
        overlap: the share of the frame that its reference shows finely enough.
        is_by_keyframe: whether that reference is a keyframe.
        residual: how far off its planes are in the mean, 1 for a perfect fit.
        told: what keypoints say, where the pose goes by them too.
        joint: how surfaces and keypoints met, where they did.
        turning_rad_s: (3,) how much faster the camera turned than at its reference, in that one's frame.
        doubt: (6, 6) in the frame's own axes, what most of the view has against the pose: see `Locator.by_regions`.
            Which of two references tells the pose better is weighed without it.
    """

    frame: GridFrame
    T_map_camera: FloatArray
    covariance: FloatArray
    motion: MotionEstimate
    keyframe: KeyframeId
    twist: FloatArray = field(default_factory=lambda: np.zeros(6))
    overlap: float = 1.0
    is_by_keyframe: bool = True
    residual: float = 1.0
    told: KeypointPose | None = None
    joint: Joint | None = None
    turning_rad_s: FloatArray = field(default_factory=lambda: np.zeros(3))
    doubt: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))

    def doubted(self) -> Tracked:
        """The same, as uncertain as what most of the view has against it says."""
        T, motion = self.motion.T_reference_current, self.motion
        if not self.doubt.any() or T is None or motion.covariance is None:
            return self
        covariance = with_frame_error(self.covariance, self.T_map_camera, self.doubt)
        motion = replace(motion, covariance=with_frame_error(motion.covariance, T, self.doubt))
        return replace(self, covariance=covariance, motion=motion, doubt=np.zeros((6, 6)))

    def moved(self, T_new_old: FloatArray) -> Tracked:
        """The same after its keyframe has moved by (4, 4), from the left, in the map."""
        T, covariance = moved(T_new_old, self.T_map_camera, self.covariance)
        return replace(self, T_map_camera=T, covariance=covariance)


@dataclass(frozen=True, slots=True, eq=False)
class DenseEstimate(CameraEstimate):
    """What dense odometry answers at a frame.

    Attributes:
        frame: on the ideal grid, its rows straightened; None where it has no pose. See `DenseOdometry.surface`. It is
            a megabyte: who keeps estimates lets go of it.
    """

    frame: GridFrame | None = field(default=None, kw_only=True)


def moved(T_new_old: FloatArray, T_map: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A pose (4, 4) and the covariance (6, 6) of its left perturbation, after a motion (4, 4) of the map there."""
    Ad = se3.adjoint(T_new_old)
    return np.asarray(se3.nearest(T_new_old @ T_map)), np.asarray(Ad @ covariance @ Ad.T)
