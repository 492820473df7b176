"""Features of one frame: ORB keypoints spread over the image, with depth and honest noise (Zhang, section 3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError
from wheelsight.events import RgbdFrame
from wheelsight.geometry import BoolArray, FloatArray, IntArray
from wheelsight.geometry.arrays import UInt64Array
from wheelsight.odometry.features import _kernels
from wheelsight.odometry.features.settings import FeatureSettings

# Depth of keypoints that have none, where one is needed to straighten rows: it only scales a small parallax.
_TYPICAL_DEPTH_M = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """N keypoints of one frame, in the frame of the colour camera.

    Attributes:
        stamp_s: of the frame, seconds.
        px: (N, 2) where they were detected, distorted pixels.
        level: (N,) of the image pyramid, each `pyramid_scale` times smaller than the one before.
        descriptors: (N, 4) uint64, the 256 bits of ORB.
        xy: (N, 2) on the plane z = 1, without lens distortion and rolling shutter.
        depth_m: (N,) along the colour camera's z axis, 0 where there is none to trust.
        sigma_px, sigma_m: (N,) standard deviations of pixel and depth.
    """

    stamp_s: float
    px: FloatArray
    level: IntArray
    descriptors: UInt64Array
    xy: FloatArray
    depth_m: FloatArray
    sigma_px: FloatArray
    sigma_m: FloatArray

    def __len__(self) -> int:
        return len(self.px)

    def some(self, count: int) -> Features:
        """The first ones, copied."""
        return replace(
            self,
            px=self.px[:count].copy(),
            level=self.level[:count].copy(),
            descriptors=self.descriptors[:count].copy(),
            xy=self.xy[:count].copy(),
            depth_m=self.depth_m[:count].copy(),
            sigma_px=self.sigma_px[:count].copy(),
            sigma_m=self.sigma_m[:count].copy(),
        )

    @property
    def has_depth(self) -> BoolArray:
        """(N,) which keypoints have depth."""
        return self.depth_m > 0

    @property
    def points(self) -> FloatArray:
        """(N, 3) in the colour camera's frame, metres; zero without depth."""
        return np.column_stack([self.xy * self.depth_m[:, None], self.depth_m])


class FeatureExtractor:
    """Detects, spreads, describes and lifts keypoints to 3D.

    Raises CalibrationError for an unregistered depth camera with lens distortion.
    """

    def __init__(self, calibration: Calibration, settings: FeatureSettings) -> None:
        if not calibration.is_registered and calibration.cameras[1].has_distortion:
            raise CalibrationError(
                "a distorted depth camera beside an unregistered colour camera is not supported",
                fix="undistort the depth images, or register them to colour",
            )
        self._calibration = calibration
        self._settings = settings
        self._orb, self._faint = (
            cv2.ORB.create(
                settings.candidates, settings.pyramid_scale, settings.pyramid_levels, fastThreshold=threshold
            )
            for threshold in (settings.fast_threshold, settings.fast_threshold_faint)
        )

    def extract(self, frame: RgbdFrame) -> Features:
        """The features of a frame, rows not yet straightened (see `straighten`)."""
        px, level, descriptors = self._keypoints(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY))
        calibration = self._calibration
        xy = calibration.cameras[0].normalise(px)
        depth_m = _kernels.depth_at_keypoints(self._image_of(frame), px, xy)
        sigma_px = np.hypot(keypoint_sigma_px(level, self._settings), calibration.color_sigma_px)
        sigma_m = calibration.depth_noise.sigma_m(depth_m)
        return Features(frame.stamp_s, px, level, descriptors, xy, depth_m, sigma_px, sigma_m)

    def _keypoints(self, grey: np.ndarray) -> tuple[FloatArray, IntArray, UInt64Array]:
        """Pixels (N, 2), pyramid levels (N,) and descriptors (N, 4), spread over the image."""
        candidates = self._orb.detect(grey, None)
        if len(candidates) < self._settings.keypoints // 2:
            candidates = self._faint.detect(grey, None)
        px = _pixels_of(candidates)
        strength = np.fromiter((k.response for k in candidates), float, len(candidates))
        chosen = spread(px, strength, self._settings.cell_px, self._settings.keypoints)
        kept, descriptors = self._orb.compute(grey, [candidates[i] for i in chosen])
        level = np.fromiter((k.octave for k in kept), np.int64, len(kept))
        words = np.zeros((0, 4), np.uint64) if len(kept) == 0 else np.ascontiguousarray(descriptors).view(np.uint64)
        px = _in_full_image(_pixels_of(kept), level, grey.shape, self._settings.pyramid_scale)
        return px, level, words

    def _image_of(self, frame: RgbdFrame) -> _kernels.DepthImage:
        """The depth of a frame, as kernels read it."""
        calibration, depth = self._calibration, self._calibration.cameras[1]
        T_color_camera = calibration.T_color_camera
        return _kernels.DepthImage(
            frame.depth_m,
            np.ascontiguousarray(T_color_camera[:3, :3]),
            T_color_camera[:3, 3].copy(),
            np.array([depth.fx, depth.fy, depth.cx, depth.cy]),
            calibration.is_registered,
            float(calibration.depth_noise.near_m),
            float(calibration.depth_noise.far_m),
            self._settings.depth_jump * max(1.0, self._settings.depth_jump_focal_px / depth.fx),
        )


def _pixels_of(keypoints: Sequence[cv2.KeyPoint]) -> FloatArray:
    """(N, 2)."""
    return np.array(cv2.KeyPoint.convert(keypoints), float).reshape(-1, 2)


def keypoint_sigma_px(level: ArrayLike, settings: FeatureSettings) -> FloatArray:
    """Standard deviation (...) of a keypoint's pixel, found on a pyramid level (...)."""
    return np.asarray(settings.sigma_px * settings.sigma_growth ** np.asarray(level, float))


def _in_full_image(px: FloatArray, level: IntArray, shape: tuple[int, ...], factor: float) -> FloatArray:
    """Where the centres of pyramid pixels lie in the full image (height, width); OpenCV gives `px` (N, 2).

    OpenCV multiplies a level's pixel indices by `factor` a level. But the centre of pixel 0 moves too, and a level has
    a whole number of pixels, so that it is not scaled by exactly that: 1.4 px at the far edge of 640.
    """
    size = np.array([shape[1], shape[0]])
    scale = factor ** level[:, None]
    return np.asarray((px / scale + 0.5) * (size / np.rint(size / scale)) - 0.5)


def spread(px: FloatArray, strength: FloatArray, cell_px: int, wanted: int) -> IntArray:
    """Indices (at most `wanted`,) of keypoints (N, 2): the strongest of each cell, then the second strongest, …"""
    if len(px) <= wanted:
        return np.arange(len(px))
    column, row = np.asarray(px // cell_px, np.int64).T
    cell = row * (column.max() + 1) + column
    order = np.lexsort((-strength, cell))
    first_of_cell = np.searchsorted(cell[order], cell[order], side="left")
    rank = np.empty(len(px), np.int64)
    rank[order] = np.arange(len(px)) - first_of_cell
    return np.lexsort((-strength, rank))[:wanted]


def straighten(raw: Features, twist: FloatArray, rolling_shutter_s: float, height: int) -> Features:
    """The features as a camera would see them that exposes all rows at the stamp, that of the middle row.

    Rows of a rolling shutter are exposed one after another while the camera moves on. With the camera's velocity
    `twist` (6,), (v, ω) in its own frame a second, each point is carried to the middle row's time; Ringaby &
    Forssén, ICCV 2011, do so for Kinect scans.
    """
    if rolling_shutter_s == 0 or not twist.any():
        return raw
    late_s = (raw.px[:, 1] / height - 0.5) * rolling_shutter_s
    depth_m = np.where(raw.has_depth, raw.depth_m, _TYPICAL_DEPTH_M)
    p = np.column_stack([raw.xy * depth_m[:, None], depth_m])
    moved = p + late_s[:, None] * (twist[:3] + np.cross(twist[3:], p))
    return replace(raw, xy=moved[:, :2] / moved[:, 2:], depth_m=np.where(raw.has_depth, moved[:, 2], 0.0))
