"""Prediction: where a frame is to be expected before it is compared with anything."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.odometry.dense.keypoint_pose import KeypointPose
from wheelsight.odometry.dense.tracked import Tracked
from wheelsight.odometry.velocity import LONGEST_STEP_S, twist_between


@dataclass(frozen=True, slots=True, eq=False)
class PriorMotion:
    """What other sensors tell of a frame; each is None where they tell nothing.

    Attributes:
        T_last_frame: (4, 4) the motion since the frame tracked last.
        T_last_other: (4, 4) what that may be instead.
        twist: (6,) the camera's velocity (v, ω) in its own frame.
    """

    T_last_frame: FloatArray | None = None
    T_last_other: FloatArray | None = None
    twist: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Where a frame is expected.

    Attributes:
        last: the frame tracked last.
        T_map_camera: each (4, 4); the first counts unless another fits clearly better.
        T_map_other: (4, 4) where it may be instead, and is where grey values say so; or None.
        is_helped: whether it is another sensor that expects the first, rather than constant velocity.
        told: what keypoints say, or None.
    """

    last: Tracked
    T_map_camera: tuple[FloatArray, ...]
    T_map_other: FloatArray | None = None
    is_helped: bool = False
    told: KeypointPose | None = None

    def at(self, T_map_camera: FloatArray) -> Prediction:
        """The same, of a pose (4, 4) that is known better by now."""
        return replace(self, T_map_camera=(T_map_camera,))

    def seconds_to(self, stamp_s: float) -> float:
        """Since the frame tracked last."""
        return stamp_s - self.last.frame.stamp_s


def predict(last: Tracked, stamp_s: float, prior: PriorMotion) -> tuple[Prediction, FloatArray]:
    """Where a frame is expected after the last one, and its twist (6,)."""
    T_last_frame, T_prior = at_speed(last, stamp_s), prior.T_last_frame
    poses = [last.T_map_camera @ T_last_frame] if T_prior is None or last.twist.any() else []
    if T_prior is not None:
        poses, T_last_frame = [last.T_map_camera @ T_prior, *poses], T_prior
    T_map_other = None if prior.T_last_other is None else last.T_map_camera @ prior.T_last_other
    ahead = Prediction(last, tuple(poses), T_map_other, is_helped=T_prior is not None)
    return ahead, speed_of(T_last_frame, stamp_s - last.frame.stamp_s, prior.twist)


def at_speed(last: Tracked, stamp_s: float) -> FloatArray:
    """T_last_frame (4, 4) by constant velocity; after a longer gap, as if the camera had stood still."""
    seconds = stamp_s - last.frame.stamp_s
    twist = last.twist if 0 < seconds <= LONGEST_STEP_S else np.zeros(6)
    return se3.from_parts(so3.exp(twist[3:] * seconds), twist[:3] * seconds)


def speed_of(T_last_frame: FloatArray, seconds: float, told: FloatArray | None = None) -> FloatArray:
    """The velocity (6,) in its own frame that an expected motion (4, 4) means; after a gap, what is `told`, or 0."""
    if 0 < seconds <= LONGEST_STEP_S:
        return twist_between(np.eye(4), T_last_frame, seconds)
    return np.zeros(6) if told is None else told
