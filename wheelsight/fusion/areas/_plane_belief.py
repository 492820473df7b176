"""PlaneBelief: a Gaussian over the base's pose in the plane and over what is wrong with the wheels."""

from __future__ import annotations

import numpy as np

from wheelsight.fusion.areas import _kernels as kernels
from wheelsight.geometry import FloatArray, se2

PLANE = np.array([0, 1, 5])  # vx, vy, ωz of a (6,) perturbation


class PlaneBelief:
    """Mean and covariance of x, y in metres, yaw in radians, and the wheels' errors: scale, drift, turn.

    Scale is the ratio by which the way is wrong, drift the heading's in rad/m, turn the ratio by which turns are.

    Args:
        x_m, y_m, yaw_rad: at the start.
        sigmas: (6,) of the state at the start.
        walk: (3,) how far the variances of scale, drift and turn grow in one metre.
    """

    def __init__(self, x_m: float, y_m: float, yaw_rad: float, sigmas: FloatArray, walk: FloatArray) -> None:
        self.mean = np.array([x_m, y_m, yaw_rad, 0.0, 0.0, 0.0])
        self.covariance = np.diag(np.square(sigmas))
        self._walk = walk

    def move(self, step: FloatArray, step_covariance: FloatArray) -> None:
        """Go on by a step of the wheels (3,), forward, left, yaw, with its covariance (3, 3)."""
        kernels.step(self.mean, self.covariance, step, step_covariance, self._walk)

    def correct(self, mean: FloatArray, covariance: FloatArray, axes: FloatArray) -> None:
        """The position takes mean (2,) and covariance (2, 2) along `axes`, in which they were 0 and the identity.

        `axes` (2, 2) is a root of the position's covariance: `axes @ axes.T`. All else follows by its correlation.
        """
        gain = np.linalg.solve(axes, self.covariance[:2]).T
        self.mean += gain @ mean
        grown = self.covariance + gain @ (covariance - np.eye(2)) @ gain.T
        self.covariance = (grown + grown.T) / 2


def pose_of(one: PlaneBelief, other: PlaneBelief, share: float) -> tuple[FloatArray, FloatArray]:
    """x, y, yaw (3,) and their covariance (3, 3) where `one` is right with probability `share`, else `other`."""
    apart = one.mean[:3] - other.mean[:3]
    apart[2] = se2.wrap_angle(apart[2])
    within = share * one.covariance[:3, :3] + (1 - share) * other.covariance[:3, :3]
    return other.mean[:3] + share * apart, within + share * (1 - share) * np.outer(apart, apart)
