"""KeypointLocator: where a frame is by its keypoints, to verify what surfaces say and to recognise keyframes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import MotionEstimate
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.keyframes import KeyframeFeatures
from wheelsight.odometry._lens import maps_without_lens
from wheelsight.odometry.dense.settings_parts import VerificationSettings
from wheelsight.odometry.dense.views import KnownView
from wheelsight.odometry.features.extraction import FeatureExtractor, Features
from wheelsight.odometry.features.landmarks import View
from wheelsight.odometry.features.settings import FeatureSettings
from wheelsight.odometry.features.tracking import Fix, ViewTracker
from wheelsight.odometry.stopwatch import Stopwatch


@dataclass(frozen=True, slots=True, eq=False)
class KeypointPose:
    """Where a frame is by its keypoints.

    Attributes:
        T_map_camera: (4, 4).
        covariance: (6, 6) of its left perturbation (v, ω), that of the keyframe included.
        matches: keypoints that were matched; inliers: those that agree.
        settings: when it counts.
    """

    T_map_camera: FloatArray
    covariance: FloatArray
    matches: int
    inliers: int
    settings: VerificationSettings = field(default_factory=VerificationSettings)

    @property
    def is_likely(self) -> bool:
        """Whether it is a place that was seen before rather than one that looks alike in parts."""
        return self.inliers >= self.settings.likely_share * self.matches

    @property
    def is_clear(self) -> bool:
        """Whether keypoints are to be believed even where surfaces say otherwise."""
        return self.inliers >= max(self.settings.clear_inliers, self.settings.clear_share * self.matches)

    def agrees_with(self, T_map_camera: FloatArray) -> bool:
        """Whether a pose (4, 4) is as near as two ways to find one leave them."""
        limits = self.settings
        T = se3.invert(self.T_map_camera) @ T_map_camera
        off_m, off_rad = float(np.linalg.norm(T[:3, 3])), float(so3.angle(T[:3, :3]))
        apart = max(off_m / limits.agree_m, off_rad / limits.agree_rad)
        off = se3.log(self.T_map_camera @ se3.invert(T_map_camera))
        is_within = apart < limits.vague and off @ np.linalg.solve(self.covariance, off) < limits.agree_chi2
        return bool(apart < 1 or is_within)

    def motion_from(self, T_map_reference: FloatArray) -> MotionEstimate:
        """As a motion against a reference at (4, 4)."""
        T_reference_map = se3.invert(T_map_reference)
        Ad = se3.adjoint(T_reference_map)
        counts = (None, self.matches, self.inliers)
        return MotionEstimate(T_reference_map @ self.T_map_camera, Ad @ self.covariance @ Ad.T, *counts)


class KeypointLocator:
    """Geometric verification: where a frame is by its keypoints and those of a keyframe; no smooth surface misleads it.

    Surfaces that are alike under a motion, such as walls, floors and backs of people, fit just as well where the camera
    is not. Keypoints of the wrong place hardly ever agree on one motion (Zhang, section 3.3).
    """

    def __init__(self, calibration: Calibration, settings: VerificationSettings) -> None:
        features = FeatureSettings()
        calibration, self._straight = _without_lens(calibration)
        self._T_color_camera = calibration.T_color_camera
        self._settings = settings
        self._extractor = FeatureExtractor(calibration, features)
        self._tracker = ViewTracker(calibration, features, Stopwatch())
        self._asked = 0

    def look(self, frame: RgbdFrame) -> Features:
        """The keypoints of a frame."""
        if self._straight is not None:
            map_u, map_v = self._straight
            depth_m = cv2.remap(frame.depth_m, map_u, map_v, cv2.INTER_NEAREST)
            frame = replace(frame, depth_m=np.asarray(depth_m, np.float32))
        return self._extractor.extract(frame)

    def straightened(self, features: Features, twist: FloatArray) -> Features:
        """As if all rows were read at once, of a camera whose velocity (6,) in its own frame is known."""
        return self._tracker.straighten(features, se3.adjoint(self._T_color_camera) @ twist)

    def kept(self, features: Features) -> KeyframeFeatures:
        """Straightened features as a keyframe has them: their points in the camera's frame."""
        points = se3.apply(se3.invert(self._T_color_camera), features.points)
        points[~features.has_depth] = 0.0
        return KeyframeFeatures(features.px, points, features.descriptors)

    def locate(self, features: Features, keyframes: Iterable[KnownView], twist: FloatArray) -> KeypointPose | None:
        """Where a frame is by the first keyframe that it shows; None where it shows none."""
        self._asked += 1
        velocity = se3.adjoint(self._T_color_camera) @ twist
        for keyframe in keyframes:
            view = self._view(keyframe)
            if view is not None:
                found = self._tracker.track(features, view, velocity, None, self._asked)
                if isinstance(found, Fix):
                    T_map_camera = np.asarray(found.view.T_map_color @ self._T_color_camera)
                    counts = (found.motion.matches, found.motion.inliers)
                    return KeypointPose(T_map_camera, found.view.covariance, *counts, self._settings)
        return None

    def _view(self, keyframe: KnownView) -> View | None:
        """A keyframe's features, with the colour camera's pose."""
        features = keyframe.features
        if features is None:
            return None
        T_map_color = keyframe.reference.T_map_reference @ se3.invert(self._T_color_camera)
        return View(features, T_map_color, keyframe.covariance, np.full(len(features), -1))


def _without_lens(calibration: Calibration) -> tuple[Calibration, Any]:
    """A calibration whose depth camera has no lens of its own, and the maps that bring depth there, if it had one."""
    depth = calibration.cameras[1]
    if calibration.is_registered or not depth.has_distortion:
        return calibration, None
    return replace(calibration, depth=replace(depth, distortion=(0.0,) * 5)), maps_without_lens(depth)
