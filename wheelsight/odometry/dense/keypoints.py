"""KeypointTracker: where frames are by their keypoints, frame by frame and wherever a keyframe is seen again."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.geometry.motion_kernels import is_definite
from wheelsight.keyframes import KeyframeFeatures
from wheelsight.odometry._lens import maps_without_lens
from wheelsight.odometry.dense.keypoint_pose import KeypointPose
from wheelsight.odometry.dense.settings_parts import VerificationSettings
from wheelsight.odometry.dense.tracked import Tracked
from wheelsight.odometry.dense.views import KnownView
from wheelsight.odometry.features.extraction import FeatureExtractor, Features, keypoint_sigma_px
from wheelsight.odometry.features.landmarks import LandmarkMap, View
from wheelsight.odometry.features.settings import FeatureSettings
from wheelsight.odometry.features.tracking import Fix, MapTracker, ViewTracker
from wheelsight.odometry.stopwatch import Stopwatch

# A variance that is a smaller share of all is what rounding left.
_LEAST_SHARE, _ALL = 1e-12, np.eye(6)


class KeypointTracker:
    """Finds frames by ORB keypoints: against the frame before, then against the landmarks of near keyframes (Zhang, 3).

    It carries quick turns and shows far things, where surfaces alone are lost. Surfaces that are alike under a motion,
    such as walls, floors and backs of people, fit just as well where the camera is not; keypoints of the wrong place
    hardly ever agree on one motion.

    Args:
        calibration: of the cameras.
        settings: when keypoints count.
        has_landmarks: else frames are found by the frame before alone.
        threads: with more than one, keypoints are looked for beside other work.
        fastest: metres and radians a second that the camera moves at most.
    """

    def __init__(
        self,
        calibration: Calibration,
        settings: VerificationSettings,
        *,
        has_landmarks: bool = True,
        threads: int = 1,
        fastest: tuple[float, float] = (np.inf, np.inf),
    ) -> None:
        features = FeatureSettings(keypoints=settings.keypoints, candidates=2 * settings.keypoints)
        calibration, self._straight = _without_lens(calibration)
        self._T_color_camera = calibration.T_color_camera
        self._noise, self._color_sigma_px = calibration.depth_noise, calibration.color_sigma_px
        self._settings, self._has_landmarks, self._fastest = settings, has_landmarks, fastest
        self._extractor = FeatureExtractor(calibration, features)
        self._by_view = ViewTracker(calibration, features, Stopwatch())
        self._by_landmarks = MapTracker(calibration, features)
        self._features = features
        self._landmarks = LandmarkMap(features)
        self._last: View | None = None
        self._asked = 0
        self._pool = ThreadPoolExecutor(1, "wheelsight-keypoints") if threads > 1 else None

    def look(self, frame: RgbdFrame) -> Future[Features]:
        """The keypoints of a frame, as soon as they are found."""
        if self._pool is not None:
            return self._pool.submit(self._look, frame)
        found: Future[Features] = Future()
        found.set_result(self._look(frame))
        return found

    def _look(self, frame: RgbdFrame) -> Features:
        if self._straight is not None:
            map_u, map_v = self._straight
            depth_m = cv2.remap(frame.depth_m, map_u, map_v, cv2.INTER_NEAREST)
            frame = replace(frame, depth_m=np.asarray(depth_m, np.float32))
        return self._extractor.extract(frame)

    def straightened(self, features: Features, twist: FloatArray) -> Features:
        """As if all rows were read at once, of a camera whose velocity (6,) in its own frame is known."""
        return self._by_view.straighten(features, self._in_color(twist))

    def kept(self, features: Features) -> KeyframeFeatures:
        """Straightened features as a keyframe has them: their points in the camera's frame."""
        points = se3.apply(se3.invert(self._T_color_camera), features.points)
        points[~features.has_depth] = 0.0
        return KeyframeFeatures(features.px, points, features.descriptors)

    def recalled(self, stamp_s: float, kept: KeyframeFeatures) -> Features:
        """What `kept` made of features that have depth; on which level each was found is not known by then."""
        has_depth = kept.points[:, 2] > 0
        points = se3.apply(self._T_color_camera, kept.points[has_depth])
        z_m = points[:, 2].copy()
        level = np.full(len(z_m), self._features.pyramid_levels // 2)
        sigmas = np.hypot(keypoint_sigma_px(level, self._features), self._color_sigma_px), self._noise.sigma_m(z_m)
        told = kept.px[has_depth], level, kept.descriptors[has_depth]
        return Features(stamp_s, *told, points[:, :2] / z_m[:, None], z_m, *sigmas)

    def track(self, features: Features, twist: FloatArray) -> KeypointPose | None:
        """Where a frame is by the one before and the landmarks around; None where they tell nothing.

        Args:
            features: of the frame, rows not straightened.
            twist: (6,) the camera's expected velocity in its own frame.
        """
        if self._last is None:
            return None
        self._asked += 1
        found = self._by_view.track(features, self._last, self._in_color(twist), None, self._asked)
        if not isinstance(found, Fix):
            return None
        if self._is_too_fast(found, self._last, features.stamp_s - self._last.features.stamp_s):
            return None
        if self._has_landmarks:
            refined = self._by_landmarks.track(features, found, self._last, self._landmarks)
            found = refined if isinstance(refined, Fix) else found
        return self._pose(found)

    def recognise(self, features: Features, keyframes: Iterable[KnownView], twist: FloatArray) -> KeypointPose | None:
        """Where a frame is by the first keyframe that it shows; None where it shows none."""
        self._asked += 1
        for keyframe in keyframes:
            view = self._view(keyframe)
            if view is not None:
                found = self._by_view.track(features, view, self._in_color(twist), None, self._asked)
                told = self._pose(found) if isinstance(found, Fix) else None
                if told is not None:
                    return told
        return None

    def remember(self, tracked: Tracked, features: Features) -> None:
        """Take a frame, whose pose is known by now, as the last one; landmarks that it shows are seen once more.

        Where it shows few of those known last, what it shows beside them becomes landmarks.
        """
        told = tracked.told
        T_map_color = tracked.T_map_camera @ se3.invert(self._T_color_camera)
        if told is not None and told.view is not None:
            view = replace(told.view, T_map_color=T_map_color, covariance=tracked.covariance, keyframe=tracked.keyframe)
        else:
            straight, unknown = self.straightened(features, tracked.twist), np.full(len(features), -1)
            view = View(straight, T_map_color, tracked.covariance, unknown, tracked.keyframe)
        if self._has_landmarks:
            seen = np.flatnonzero(view.landmark >= 0)
            self._landmarks.see_again(view.landmark[seen], view.features, seen, T_map_color)
            known = self._landmarks.keyframes[-1].landmark if self._landmarks.keyframes else np.zeros(1, int)
            if len(seen) < self._features.keyframe_share * np.count_nonzero(known >= 0):
                view = self._landmarks.add_keyframe(view, tracked.keyframe)
                self._landmarks.forget_keypoints()
        self._last = view

    def forget(self) -> None:
        """No landmark is known any more, nor a last frame."""
        self._landmarks, self._last = LandmarkMap(self._features), None

    def move(self, T_new_old: FloatArray) -> None:
        """Landmarks and the last frame go with their keyframes, which have moved in the map by (K, 4, 4)."""
        self._landmarks.move(T_new_old)
        self._last = None if self._last is None else self._last.moved(T_new_old)

    def _is_too_fast(self, found: Fix, last: View, seconds: float) -> bool:
        """Whether no camera goes so far in so short a time: paint that repeats agrees a period farther on, too."""
        T = se3.invert(last.T_map_color) @ found.view.T_map_color
        way_m, turn_rad = float(np.linalg.norm(T[:3, 3])), float(so3.angle(T[:3, :3]))
        return seconds > 0 and (way_m > self._fastest[0] * seconds or turn_rad > self._fastest[1] * seconds)

    def _in_color(self, twist: FloatArray) -> FloatArray:
        return np.asarray(se3.adjoint(self._T_color_camera) @ twist)

    def _pose(self, found: Fix) -> KeypointPose | None:
        """None where keypoints lie so that they do not tell all of the motion, and rounding hides how sure it is."""
        motion, view = found.motion, found.view
        assert motion.T_reference_current is not None
        assert motion.covariance is not None
        Ad = se3.adjoint(view.T_map_color @ se3.invert(motion.T_reference_current))
        T_map_camera = np.asarray(view.T_map_color @ self._T_color_camera)
        counts = (motion.matches, motion.inliers)
        own = np.asarray(Ad @ motion.covariance @ Ad.T)
        alike = self._settings.correlation
        covariance = view.covariance + (alike - 1) * own
        covariance = (covariance + covariance.T) / 2
        if not (np.isfinite(covariance).all() and is_definite(covariance - _LEAST_SHARE * np.trace(covariance) * _ALL)):
            return None
        return KeypointPose(T_map_camera, covariance, *counts, self._settings, alike * own, view)

    def _view(self, keyframe: KnownView) -> View | None:
        """A keyframe's features, with the colour camera's pose."""
        features = keyframe.features
        if features is None:
            return None
        T_map_color = keyframe.reference.T_map_reference @ se3.invert(self._T_color_camera)
        return View(features, T_map_color, keyframe.covariance, np.full(len(features), -1), keyframe.keyframe)


def _without_lens(calibration: Calibration) -> tuple[Calibration, Any]:
    """A calibration whose depth camera has no lens of its own, and the maps that bring depth there, if it had one."""
    depth = calibration.cameras[1]
    if calibration.is_registered or not depth.has_distortion:
        return calibration, None
    return replace(calibration, depth=replace(depth, distortion=(0.0,) * 5)), maps_without_lens(depth)
