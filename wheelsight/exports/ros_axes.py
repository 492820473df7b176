"""Poses, covariances and twists of ours in ROS's conventions (REP 103, REP 105, the comments of its messages)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.recordings.rosbag.robot_topics import BASE, LINK, T_LINK_OPTICAL
from wheelsight.trajectory import Trajectory


def body_frame(body: str) -> str:
    """What ROS calls the body whose poses a trajectory has."""
    return BASE if body == "base" else LINK


def upright(trajectory: Trajectory) -> Trajectory:
    """A trajectory whose frames have z up and whose body has x forward, as REP 103 asks for.

    That of a base has them. That of a camera begins in optical axes: both its frame and its body are turned.
    """
    if trajectory.body == "base":
        return trajectory
    turned = trajectory.moved(T_LINK_OPTICAL)
    # From the right: what perturbs from the left stays as it is.
    return replace(turned, T_frame_body=turned.T_frame_body @ se3.invert(T_LINK_OPTICAL))


def upright_points(p: FloatArray, body: str) -> FloatArray:
    """Points (N, 3) of a map in which a trajectory of `body` lies, in the axes of `upright`."""
    return p if body == "base" else se3.apply(T_LINK_OPTICAL, p)


def pose_covariances(trajectory: Trajectory) -> FloatArray | None:
    """Covariances (N, 6, 6) as PoseWithCovariance has them: of x, y, z and of turns about the fixed axes of the parent.

    Ours are of left perturbations (v, ω), which turn about the parent's origin: they move the position p by v + ω × p.
    """
    if trajectory.covariances is None:
        return None
    J = np.tile(np.eye(6), (len(trajectory), 1, 1))
    J[:, :3, 3:] = -so3.hat(trajectory.positions_m)
    return np.asarray(J @ trajectory.covariances @ np.swapaxes(J, 1, 2))


def twists(trajectory: Trajectory) -> FloatArray:
    """Twists (v, ω) (N, 6) of the body in its own axes, m/s and rad/s: the mean from the pose before to the one after.

    At both ends it is that of the one step there is; of a single pose it is zero.
    """
    count, T = len(trajectory), trajectory.T_frame_body
    if count < 2:
        return np.zeros((count, 6))
    before, after = np.arange(count) - 1, np.arange(count) + 1
    before[0], after[-1] = 0, count - 1
    lasted_s = trajectory.stamps_s[after] - trajectory.stamps_s[before]
    T_before_after = se3.compose(se3.invert(T[before]), T[after])
    # Of a motion that is even this is the twist at any of its moments, in the body's axes.
    return np.asarray(se3.log(T_before_after) / lasted_s[:, None])


def in_odom(lived: Trajectory, odom: Trajectory | None) -> Trajectory:
    """A trajectory without its leaps, as `odom` has it at the same stamps, with its covariances."""
    if odom is None:
        return lived
    _, rows, found = np.intersect1d(lived.stamps_s, odom.stamps_s, return_indices=True)
    T, C = odom.T_frame_body[found], lived.covariances
    if C is not None:
        Ad = se3.adjoint(se3.compose(T, se3.invert(lived.T_frame_body[rows])))
        C = Ad @ C[rows] @ np.swapaxes(Ad, 1, 2)
    return Trajectory(odom.stamps_s[found], T, C, body=odom.body, frame=odom.frame)


def map_to_odom(lived: Trajectory, corrected: Trajectory | None) -> tuple[FloatArray, FloatArray]:
    """Stamps (N,), and T_map_odom (N, 4, 4) at them: the identity where nothing corrected the way.

    Poses that the correction lacks are left out: where they lie in the map nobody knows.
    """
    if corrected is None:
        return lived.stamps_s, np.tile(np.eye(4), (len(lived), 1, 1))
    shared, rows, found = np.intersect1d(lived.stamps_s, corrected.stamps_s, return_indices=True)
    return shared, se3.compose(corrected.T_frame_body[found], se3.invert(lived.T_frame_body[rows]))
