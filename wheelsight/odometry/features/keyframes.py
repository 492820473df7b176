"""KeyframeMaker: a frame as a keyframe of the store, seen by an ideal camera in the place of the depth camera."""

from __future__ import annotations

import cv2
import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.events import RgbdFrame
from wheelsight.geometry import ByteArray, Float32Array, FloatArray, se3
from wheelsight.keyframes import Keyframe, KeyframeFeatures
from wheelsight.odometry._lens import maps_without_lens
from wheelsight.odometry.features.extraction import Features


class KeyframeMaker:
    """Makes keyframes of the frames of one camera; lens distortion and the gap between its two lenses are taken out."""

    def __init__(self, calibration: Calibration) -> None:
        self._color, self._depth = calibration.cameras
        self._T_color_camera = calibration.T_color_camera
        self._rays = None if calibration.is_registered else self._depth.rays()
        self._maps = maps_without_lens(self._depth) if self._depth.has_distortion else None

    def keyframe(self, frame: RgbdFrame, features: Features) -> Keyframe:
        """A frame with what was found in it; both images are compressed, which takes as long as to track a frame."""
        depth_m, grey = frame.depth_m, np.asarray(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), np.uint8)
        if self._rays is not None:
            grey = self._seen_from_depth(grey, depth_m, self._rays)
        elif self._maps is not None:
            depth_m = np.asarray(cv2.remap(depth_m, *self._maps, cv2.INTER_NEAREST), np.float32)
            grey = np.asarray(cv2.remap(grey, *self._maps, cv2.INTER_LINEAR), np.uint8)
        depth = self._depth
        intrinsics = np.array([depth.fx, depth.fy, depth.cx, depth.cy])
        return Keyframe.of_images(
            frame.stamp_s, intrinsics, depth_m, grey.astype(np.float32), self._features_of(features)
        )

    def _features_of(self, features: Features) -> KeyframeFeatures:
        p_camera = se3.apply(se3.invert(self._T_color_camera), features.points)
        points = np.where(features.has_depth[:, None], p_camera, 0.0)
        return KeyframeFeatures(features.px, points, features.descriptors)

    def _seen_from_depth(self, grey: ByteArray, depth_m: Float32Array, rays: FloatArray) -> ByteArray:
        """Grey (h, w) of the colour camera where the depth camera's pixels show the same points; 0 where unknown."""
        px, is_inside = self._color.project(se3.apply(self._T_color_camera, (rays * depth_m[..., None])))
        px = np.where((is_inside & (depth_m > 0))[..., None], px, -2.0).astype(np.float32)
        return np.asarray(cv2.remap(grey, px[..., 0], px[..., 1], cv2.INTER_LINEAR), np.uint8)
