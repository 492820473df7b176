"""Tracked: a frame whose pose is known, and where the next one is to be expected."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from wheelsight.estimates import Reason
from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.odometry._velocity import LONGEST_STEP_S, twist_between
from wheelsight.odometry.dense.grid import GridFrame
from wheelsight.odometry.dense.settings import DenseSettings


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """A frame with its pose, the covariance (6, 6) of that, and its velocity (6,) in its own frame.

    `overlap` is the share of the frame that its reference shows finely enough, `is_by_keyframe` whether that is one,
    and `residual` how far off its planes are in the mean, 1 for a perfect fit.
    """

    frame: GridFrame
    T_map_camera: FloatArray
    covariance: FloatArray
    twist: FloatArray = field(default_factory=lambda: np.zeros(6))
    overlap: float = 1.0
    is_by_keyframe: bool = True
    residual: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Where a frame is expected before it is compared with anything.

    Attributes:
        T_map_camera: each (4, 4); the first counts unless another fits clearly better.
        T_map_other: (4, 4) where it may be instead, and is where grey values say so; or None.
        is_helped: whether it is another sensor that expects the first, rather than constant velocity.
    """

    T_map_camera: tuple[FloatArray, ...]
    T_map_other: FloatArray | None = None
    is_helped: bool = False

    def at(self, T_map_camera: FloatArray) -> Expected:
        """The same, of a pose (4, 4) that is known better by now."""
        return replace(self, T_map_camera=(T_map_camera,))


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What others tell of a frame: T_last_frame (4, 4), what it may be instead, and its twist (6,); each or None."""

    T_last_frame: FloatArray | None = None
    T_last_other: FloatArray | None = None
    twist: FloatArray | None = None


def expected(last: Tracked, stamp_s: float, told: Told) -> tuple[Expected, FloatArray]:
    """Where a frame is expected after the last one, and its twist (6,)."""
    T_last_frame, prior = at_speed(last, stamp_s), told.T_last_frame
    poses = [last.T_map_camera @ T_last_frame] if prior is None or last.twist.any() else []
    if prior is not None:
        poses, T_last_frame = [last.T_map_camera @ prior, *poses], prior
    T_map_other = None if told.T_last_other is None else last.T_map_camera @ told.T_last_other
    ahead = Expected(tuple(poses), T_map_other, is_helped=prior is not None)
    return ahead, speed_of(T_last_frame, stamp_s - last.frame.stamp_s, told.twist)


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


def fine_share(frame: GridFrame, T_reference_frame: FloatArray, least: float) -> float:
    """The share of a frame's points that its reference saw at `least` so many times as finely."""
    level = frame.levels[-1]
    fx, fy, cx, cy = level.intrinsics
    rows, columns = np.nonzero(level.depth_m)
    z = level.depth_m[rows, columns]
    points = np.column_stack([z * (columns - cx) / fx, z * (rows - cy) / fy, z])
    there = points @ T_reference_frame[2, :3] + T_reference_frame[2, 3]
    return float(np.count_nonzero(z >= least * there) / max(len(z), 1))


def implausible(last: Tracked, T_map_camera: FloatArray, seconds: float, settings: DenseSettings) -> Reason | None:
    """The reason against a pose (4, 4) that no camera comes to in so short a time, or None."""
    T = se3.invert(last.T_map_camera) @ T_map_camera
    fast = np.linalg.norm(T[:3, 3]) > settings.max_speed_m_s * seconds
    turning = so3.angle(T[:3, :3]) > settings.max_turn_rad_s * seconds
    return Reason.IMPLAUSIBLE_MOTION if fast or turning else None
