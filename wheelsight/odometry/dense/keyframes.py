"""Keyframes: views that are kept, to come back to and to witness by their features where a frame is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.odometry._stopwatch import Stopwatch
from wheelsight.odometry.dense.reference import Reference
from wheelsight.odometry.features.extraction import FeatureExtractor, Features
from wheelsight.odometry.features.landmarks import View
from wheelsight.odometry.features.settings import FeatureSettings
from wheelsight.odometry.features.tracking import Fix, ViewTracker

# A turn by a radian hides as much of a view as this many metres of way.
_TYPICAL_DEPTH_M = 1.5


@dataclass(eq=False)
class Keyframe:
    """A reference with the covariance (6, 6) of its pose, and with its features where it is to be recognised."""

    reference: Reference
    covariance: FloatArray
    view: View | None = None

    def distance_m(self, T_world_camera: FloatArray) -> float:
        """How far a view from there (4, 4) is from this one; a turn by a radian counts as 1.5 m."""
        T = se3.invert(self.reference.T_world_reference) @ T_world_camera
        return float(np.linalg.norm(T[:3, 3]) + _TYPICAL_DEPTH_M * so3.angle(T[:3, :3]))


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """Where a frame is by its keypoints.

    Attributes:
        T_world_camera: (4, 4).
        covariance: (6, 6) of its left perturbation (v, ω), that of the keyframe included.
        matches: keypoints that were matched; inliers: those that agree.
    """

    T_world_camera: FloatArray
    covariance: FloatArray
    matches: int
    inliers: int


class Witness:
    """Where a frame is by its keypoints and those of a keyframe: a second opinion that no smooth surface misleads.

    Surfaces that are alike under a motion, such as walls, floors and backs of people, fit just as well where the camera
    is not. Keypoints of the wrong place hardly ever agree on one motion (Zhang, section 3.3).
    """

    def __init__(self, calibration: Calibration) -> None:
        settings = FeatureSettings()
        T = calibration.T_color_depth
        self._T_color_camera: FloatArray = np.eye(4) if T is None else np.array(T)
        self._extractor = FeatureExtractor(calibration, settings)
        self._tracker = ViewTracker(calibration, settings, Stopwatch())
        self._asked = 0

    def look(self, frame: RgbdFrame) -> Features:
        """The keypoints of a frame."""
        return self._extractor.extract(frame)

    def view(self, features: Features, T_world_camera: FloatArray, covariance: FloatArray, twist: FloatArray) -> View:
        """Features of a keyframe whose pose (4, 4), and velocity (6,) in its own frame, are known."""
        T_world_color = T_world_camera @ se3.invert(self._T_color_camera)
        straight = self._tracker.straighten(features, se3.adjoint(self._T_color_camera) @ twist)
        return View(straight, T_world_color, covariance, np.full(len(features), -1))

    def locate(self, features: Features, keyframes: Iterable[Keyframe], twist: FloatArray) -> Sighting | None:
        """Where a frame is by the first keyframe that it shows; None where it shows none."""
        self._asked += 1
        velocity = se3.adjoint(self._T_color_camera) @ twist
        for keyframe in keyframes:
            if keyframe.view is not None:
                found = self._tracker.track(features, keyframe.view, velocity, None, self._asked)
                if isinstance(found, Fix):
                    T_world_camera = np.asarray(found.view.T_world_color @ self._T_color_camera)
                    return Sighting(T_world_camera, found.view.covariance, found.motion.matches, found.motion.inliers)
        return None
