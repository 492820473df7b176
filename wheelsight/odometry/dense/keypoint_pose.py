"""KeypointPose: what keypoints tell of a frame, and how far that counts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wheelsight.estimates import MotionEstimate
from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.odometry.dense.settings_parts import VerificationSettings
from wheelsight.odometry.features.landmarks import View


@dataclass(frozen=True, slots=True, eq=False)
class KeypointPose:
    """Where a frame is by its keypoints.

    Attributes:
        T_map_camera: (4, 4).
        covariance: (6, 6) of its left perturbation (v, ω), that of the keyframe included.
        matches: keypoints that were matched; inliers: those that agree.
        settings: when it counts.
            Neighbouring keypoints err alike, as neighbouring pixels do: `correlation` of them count as one.
        motion_covariance: (6, 6) of the same perturbation, that of the keyframe left out.
        view: the frame's keypoints, rows straightened, and the landmarks that they show.
    """

    T_map_camera: FloatArray
    covariance: FloatArray
    matches: int
    inliers: int
    settings: VerificationSettings = field(default_factory=VerificationSettings)
    motion_covariance: FloatArray | None = None
    view: View | None = None

    @property
    def is_likely(self) -> bool:
        """Whether it is a place that was seen before rather than one that looks alike in parts."""
        return self.inliers >= self.settings.likely_share * self.matches

    @property
    def is_usable(self) -> bool:
        """Whether it is estimated together with surfaces: most agree, or so many that they are no chance."""
        return self.is_likely or self.inliers >= self.settings.clear_inliers

    @property
    def is_clear(self) -> bool:
        """Whether keypoints are to be believed even where surfaces say otherwise."""
        return self.inliers >= max(self.settings.clear_inliers, self.settings.clear_share * self.matches)

    def agrees_with(self, T_map_camera: FloatArray) -> bool:
        """Whether a pose (4, 4) is as near as two ways to find one leave them."""
        limits = self.settings
        T = se3.invert(self.T_map_camera) @ T_map_camera
        off_m, off_rad = float(np.linalg.norm(T[:3, 3])), float(so3.angle(T[:3, :3]))
        off = se3.log(self.T_map_camera @ se3.invert(T_map_camera))
        is_within = off @ np.linalg.solve(self.covariance, off) < limits.agree_chi2
        return bool(max(off_m / limits.agree_m, off_rad / limits.agree_rad) < 1 or is_within)

    def motion_from(self, T_map_reference: FloatArray) -> MotionEstimate:
        """As a motion against a reference at (4, 4)."""
        T_reference_map = se3.invert(T_map_reference)
        Ad = se3.adjoint(T_reference_map)
        counts = (None, self.matches, self.inliers)
        return MotionEstimate(T_reference_map @ self.T_map_camera, Ad @ self.covariance @ Ad.T, *counts)

    def information_from(self, T_map_reference: FloatArray) -> FloatArray:
        """Information (6, 6) of the left perturbation of its motion against a reference at (4, 4)."""
        Ad = se3.adjoint(se3.invert(T_map_reference))
        covariance = self.covariance if self.motion_covariance is None else self.motion_covariance
        return np.asarray(np.linalg.inv(Ad @ covariance @ Ad.T), float)
