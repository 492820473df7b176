"""What is answered while it is likely that a sensor is wrong: the other's pose, or one whose covariance covers both."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from wheelsight.estimates import Reason
from wheelsight.fusion import FusedEstimate, covering_pose
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions
from wheelsight.localizer._camera_poses import BasePose
from wheelsight.odometry.extrinsics import Culprit


def doubted(
    answer: FusedEstimate, by_wheels: FusedEstimate, seen: BasePose, culprits: Collection[Culprit]
) -> FusedEstimate:
    """The answer that covers wheels and camera; it is where those are who are not accused.

    Args:
        answer: of the filter that joins both.
        by_wheels: of the one that hears the wheels alone; it has a pose.
        seen: where the camera alone has the base.
        culprits: who may be wrong.
    """
    assert by_wheels.T_odom_body is not None
    assert by_wheels.covariance is not None
    reason = answer.reason or Reason.CONTRADICTION
    first, second = (by_wheels.T_odom_body, by_wheels.covariance), (seen.T, seen.covariance)
    if set(culprits) == {Culprit.WHEELS}:
        first, second = second, first
    T, C = covering_pose(*first, *second)
    return replace(by_wheels, T_odom_body=T, covariance=C, doubtful=True, slip=False, reason=reason)


def covered(answer: FusedEstimate, T_wheels_camera: FloatArray) -> FusedEstimate:
    """The answer to a frame, less certain by what wheels and camera have gone apart (4, 4)."""
    if answer.T_odom_body is None or answer.covariance is None:
        return answer
    other = motions.times(answer.T_odom_body, T_wheels_camera)
    _, C = covering_pose(answer.T_odom_body, answer.covariance, motions.mended(other), np.zeros((6, 6)))
    return replace(answer, covariance=C)
