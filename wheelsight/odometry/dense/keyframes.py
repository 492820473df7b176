"""Keyframes: views that are kept, to come back to and to witness by their features where a frame is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import MotionEstimate
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.odometry.dense.reference import Reference
from wheelsight.odometry.features.extraction import FeatureExtractor, Features
from wheelsight.odometry.features.landmarks import View
from wheelsight.odometry.features.settings import FeatureSettings
from wheelsight.odometry.features.tracking import Fix, ViewTracker
from wheelsight.odometry.stopwatch import Stopwatch

# Poses of one frame by its surfaces and by its keypoints that lie no farther apart say the same; so many times as far
# apart too where keypoints are no surer: far ones hardly tell a turn from a way aside. χ² of 6, 99 %.
_AGREE_M, _AGREE_RAD, _VAGUE, _CHI2 = 0.04, 0.035, 4.0, 16.8
# Keypoints are believed against surfaces where so many agree, and such a share of all that were matched.
_CLEAR_INLIERS, _CLEAR_SHARE = 60, 0.6
_LIKELY_SHARE = 0.5


@dataclass(eq=False)
class Keyframe:
    """A reference with the covariance (6, 6) of its pose, and with its features where it is to be recognised."""

    reference: Reference
    covariance: FloatArray
    view: View | None = None

    def with_motion(self, covariance: FloatArray) -> FloatArray:
        """The covariance (6, 6) of a pose that lies off this one by a motion with its covariance (6, 6)."""
        Ad = se3.adjoint(self.reference.T_map_reference)
        return np.asarray(self.covariance + Ad @ covariance @ Ad.T)

    def distance_m(self, T_map_camera: FloatArray) -> float:
        """How far a view from there (4, 4) is from this one; a turn by a radian counts as 1.5 m."""
        return float(se3.view_shift_m(se3.invert(self.reference.T_map_reference) @ T_map_camera))


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """Where a frame is by its keypoints.

    Attributes:
        T_map_camera: (4, 4).
        covariance: (6, 6) of its left perturbation (v, ω), that of the keyframe included.
        matches: keypoints that were matched; inliers: those that agree.
    """

    T_map_camera: FloatArray
    covariance: FloatArray
    matches: int
    inliers: int

    @property
    def is_likely(self) -> bool:
        """Whether it is a place that was seen before rather than one that looks alike in parts."""
        return self.inliers >= _LIKELY_SHARE * self.matches

    @property
    def is_clear(self) -> bool:
        """Whether keypoints are to be believed even where surfaces say otherwise."""
        return self.inliers >= max(_CLEAR_INLIERS, _CLEAR_SHARE * self.matches)

    def agrees_with(self, T_map_camera: FloatArray) -> bool:
        """Whether a pose (4, 4) is as near as two ways to find one leave them."""
        T = se3.invert(self.T_map_camera) @ T_map_camera
        apart = max(float(np.linalg.norm(T[:3, 3])) / _AGREE_M, float(so3.angle(T[:3, :3])) / _AGREE_RAD)
        off = se3.log(self.T_map_camera @ se3.invert(T_map_camera))
        return bool(apart < 1 or (apart < _VAGUE and off @ np.linalg.solve(self.covariance, off) < _CHI2))

    def motion_from(self, T_map_reference: FloatArray) -> MotionEstimate:
        """As a motion against a reference at (4, 4)."""
        T_reference_map = se3.invert(T_map_reference)
        Ad = se3.adjoint(T_reference_map)
        counts = (None, self.matches, self.inliers)
        return MotionEstimate(T_reference_map @ self.T_map_camera, Ad @ self.covariance @ Ad.T, *counts)


class Witness:
    """Where a frame is by its keypoints and those of a keyframe: a second opinion that no smooth surface misleads.

    Surfaces that are alike under a motion, such as walls, floors and backs of people, fit just as well where the camera
    is not. Keypoints of the wrong place hardly ever agree on one motion (Zhang, section 3.3).
    """

    def __init__(self, calibration: Calibration) -> None:
        settings = FeatureSettings()
        calibration, self._straight = _without_lens(calibration)
        T = calibration.T_color_depth
        self._T_color_camera: FloatArray = np.eye(4) if T is None else np.array(T)
        self._extractor = FeatureExtractor(calibration, settings)
        self._tracker = ViewTracker(calibration, settings, Stopwatch())
        self._asked = 0

    def look(self, frame: RgbdFrame) -> Features:
        """The keypoints of a frame."""
        if self._straight is not None:
            map_u, map_v = self._straight
            depth_m = cv2.remap(frame.depth_m, map_u, map_v, cv2.INTER_NEAREST)
            frame = replace(frame, depth_m=np.asarray(depth_m, np.float32))
        return self._extractor.extract(frame)

    def view(self, features: Features, T_map_camera: FloatArray, covariance: FloatArray, twist: FloatArray) -> View:
        """Features of a keyframe whose pose (4, 4), and velocity (6,) in its own frame, are known."""
        T_map_color = T_map_camera @ se3.invert(self._T_color_camera)
        straight = self._tracker.straighten(features, se3.adjoint(self._T_color_camera) @ twist)
        return View(straight, T_map_color, covariance, np.full(len(features), -1))

    def locate(self, features: Features, keyframes: Iterable[Keyframe], twist: FloatArray) -> Sighting | None:
        """Where a frame is by the first keyframe that it shows; None where it shows none."""
        self._asked += 1
        velocity = se3.adjoint(self._T_color_camera) @ twist
        for keyframe in keyframes:
            if keyframe.view is not None:
                found = self._tracker.track(features, keyframe.view, velocity, None, self._asked)
                if isinstance(found, Fix):
                    T_map_camera = np.asarray(found.view.T_map_color @ self._T_color_camera)
                    return Sighting(T_map_camera, found.view.covariance, found.motion.matches, found.motion.inliers)
        return None


def _without_lens(calibration: Calibration) -> tuple[Calibration, Any]:
    """A calibration whose depth camera has no lens of its own, and the maps that bring depth there, if it had one."""
    depth = calibration.cameras[1]
    if calibration.is_registered or not depth.has_distortion:
        return calibration, None
    size = (depth.width, depth.height)
    maps = cv2.initUndistortRectifyMap(depth.K, np.array(depth.distortion), None, depth.K, size, cv2.CV_32FC1)
    return replace(calibration, depth=replace(depth, distortion=(0.0,) * 5)), maps
