"""`FeatureExtractor` returns the ORB keypoints of a frame with depth and noise. `KeyframeMaker` turns a frame into a
keyframe. `FeatureSettings` configures both and the odometry.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, se3
from wheelsight.core.geometry.arrays import UInt64Array
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.settings import CHOSEN, ON_SIMULATOR, Settings, setting
from wheelsight.vision.features.feature_kernels import DepthImage, depth_at_keypoints
from wheelsight.vision.tracking_state import LONGEST_STEP_S, maps_without_lens

# Assumed depth of keypoints without depth in the rolling-shutter correction; it only scales a small parallax.
_TYPICAL_DEPTH_M = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """N ORB keypoints of one frame, in the frame of the colour camera (Zhang, section 3.1).

    Attributes:
        stamp_s: time of the frame, seconds.
        px: (N, 2) detected pixels, with lens distortion.
        level: (N,) level of the image pyramid, each `pyramid_scale` times smaller than the previous one.
        descriptors: (N, 4) uint64, the 256 bits of ORB.
        xy: (N, 2) on the plane z = 1, without lens distortion and rolling shutter.
        depth_m: (N,) along the colour camera's z axis, 0 where it is unreliable.
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
        """Copies of the first `count` keypoints."""
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
        """(N,) mask of keypoints with depth."""
        return self.depth_m > 0

    @property
    def points(self) -> FloatArray:
        """(N, 3) in the colour camera's frame, metres; zero without depth."""
        return np.column_stack([self.xy * self.depth_m[:, None], self.depth_m])


class FeatureExtractor:
    """Detects and describes keypoints spread over the image, with 3D points where depth is known.

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
        """The features of a frame, before the rolling-shutter correction (see `straighten`)."""
        px, level, descriptors = self._keypoints(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY))
        calibration = self._calibration
        xy = calibration.cameras[0].normalise(px)
        depth, T_color_camera = calibration.cameras[1], calibration.T_color_camera
        image = DepthImage(
            frame.depth_m,
            np.ascontiguousarray(T_color_camera[:3, :3]),
            T_color_camera[:3, 3].copy(),
            np.array([depth.fx, depth.fy, depth.cx, depth.cy]),
            calibration.is_registered,
            float(calibration.depth_noise.near_m),
            float(calibration.depth_noise.far_m),
            self._settings.depth_jump * max(1.0, self._settings.depth_jump_focal_px / depth.fx),
        )
        depth_m = depth_at_keypoints(image, px, xy)
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
        # OpenCV scales pixel indices of a level by `pyramid_scale`. The exact scale follows from the whole number of
        # pixels of a level, and the centre of pixel 0 moves too: 1.4 px at the far edge of 640.
        size = np.array([grey.shape[1], grey.shape[0]])
        scale = self._settings.pyramid_scale ** level[:, None]
        px = np.asarray((_pixels_of(kept) / scale + 0.5) * (size / np.rint(size / scale)) - 0.5)
        return px, level, words


def _pixels_of(keypoints: Sequence[cv2.KeyPoint]) -> FloatArray:
    """Pixels (N, 2) of keypoints."""
    return np.array(cv2.KeyPoint.convert(keypoints), float).reshape(-1, 2)


def keypoint_sigma_px(level: ArrayLike, settings: FeatureSettings) -> FloatArray:
    """Standard deviation (...) of a keypoint's pixel, detected on a pyramid level (...)."""
    return np.asarray(settings.sigma_px * settings.sigma_growth ** np.asarray(level, float))


def spread(px: FloatArray, strength: FloatArray, cell_px: int, wanted: int) -> IntArray:
    """Indices of at most `wanted` keypoints (N, 2): the strongest of each cell, then the second strongest, …"""
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
    """The features corrected for rolling shutter, to the exposure time of the middle row.

    Args:
        raw: features as detected.
        twist: (6,) the camera's velocity (v, ω) per second in its own frame, which moves each point to the time of
            the middle row (Ringaby & Forssén, ICCV 2011, for Kinect scans).
        rolling_shutter_s: time from the first row to the last.
        height: number of rows.
    """
    if rolling_shutter_s == 0 or not twist.any():
        return raw
    late_s = (raw.px[:, 1] / height - 0.5) * rolling_shutter_s
    depth_m = np.where(raw.has_depth, raw.depth_m, _TYPICAL_DEPTH_M)
    p = np.column_stack([raw.xy * depth_m[:, None], depth_m])
    moved = p + late_s[:, None] * (twist[:3] + np.cross(twist[3:], p))
    return replace(raw, xy=moved[:, :2] / moved[:, 2:], depth_m=np.where(raw.has_depth, moved[:, 2], 0.0))


class KeyframeMaker:
    """Makes keyframes of the frames of one camera, as an ideal camera at the pose of the depth camera sees them."""

    def __init__(self, calibration: Calibration) -> None:
        self._color, self._depth = calibration.cameras
        self._T_color_camera = calibration.T_color_camera
        self._rays = None if calibration.is_registered else self._depth.rays()
        self._maps = maps_without_lens(self._depth) if self._depth.has_distortion else None

    def keyframe(self, frame: RgbdFrame, features: Features) -> Keyframe:
        """The keyframe of a frame and its features; compression takes as long as tracking a frame."""
        depth_m, grey = frame.depth_m, np.asarray(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), np.uint8)
        if self._rays is not None:
            px, is_inside = self._color.project(se3.apply(self._T_color_camera, (self._rays * depth_m[..., None])))
            px = np.where((is_inside & (depth_m > 0))[..., None], px, -2.0).astype(np.float32)
            grey = np.asarray(cv2.remap(grey, px[..., 0], px[..., 1], cv2.INTER_LINEAR), np.uint8)
        elif self._maps is not None:
            depth_m = np.asarray(cv2.remap(depth_m, *self._maps, cv2.INTER_NEAREST), np.float32)
            grey = np.asarray(cv2.remap(grey, *self._maps, cv2.INTER_LINEAR), np.uint8)
        depth = self._depth
        intrinsics = np.array([depth.fx, depth.fy, depth.cx, depth.cy])
        p_camera = se3.apply(se3.invert(self._T_color_camera), features.points)
        points = np.where(features.has_depth[:, None], p_camera, 0.0)
        return Keyframe.of_images(
            frame.stamp_s,
            intrinsics,
            depth_m,
            grey.astype(np.float32),
            KeyframeFeatures(features.px, points, features.descriptors),
        )


class FeatureSettings(Settings):
    """Settings of feature odometry; unknown names are refused."""

    reference: Literal["keyframes", "previous"] = setting(
        "keyframes",
        "align with landmarks of near keyframes, or with the previous frame as in the paper",
        "Zhang, Fig. 3, for the previous frame; keyframes drift less",
    )
    seed: int = setting(0, "of RANSAC; one seed gives one trajectory", CHOSEN, ge=0, lt=2**32)

    keypoints: int = setting(1000, "kept in each frame, spread over the image", CHOSEN, ge=50, le=20_000)
    candidates: int = setting(2000, "detected before spreading", CHOSEN, ge=50, le=50_000)
    fast_threshold: int = setting(
        20,
        "grey levels by which a corner's ring must differ",
        "Rublee et al. 2011 (ORB); docs/decisions/0023",
        gt=0,
        le=255,
    )
    fast_threshold_faint: int = setting(
        7, "the same where an image has too few clear corners", "docs/decisions/0023", gt=0, le=255
    )
    pyramid_levels: int = setting(8, "image scales", "Rublee et al. 2011 (ORB), as OpenCV has it", ge=1, le=12)
    pyramid_scale: float = setting(
        1.2, "scale factor from level to level", "Rublee et al. 2011 (ORB), as OpenCV has it", gt=1, le=2
    )
    sigma_px: float = setting(
        0.65,
        "standard deviation of a keypoint's pixel on the full image",
        "measured by python -m benchmarks.sensor on two Kinect recordings",
        gt=0,
        le=10,
    )
    sigma_growth: float = setting(
        1.12,
        "factor per level: less than that of the level's pixels",
        "measured by python -m benchmarks.sensor on two Kinect recordings",
        ge=1,
        le=2,
    )
    cell_px: int = setting(
        64, "cells in which keypoints compete when they are spread", "docs/decisions/0023", ge=8, le=4096
    )
    depth_jump: float = setting(
        0.03,
        "share of the depth by which readings around a keypoint may differ, at 525 px focal length and more, in "
        "proportion, at less; beyond that is an edge",
        CHOSEN,
        gt=0,
        le=1,
    )
    depth_jump_focal_px: float = setting(
        525.0,
        "focal length of `depth_jump`, that of a Kinect: a surface seen at a slant differs from pixel to pixel by "
        "its slope times the pixel's angle",
        "a Kinect's",
        gt=0,
        le=1e5,
    )

    max_hamming: int = setting(64, "bits by which descriptors of one point may differ", CHOSEN, ge=1, le=256)
    distinct_share: float = setting(
        0.9,
        "of the bits by which the second best descriptor nearby differs, which the best must stay below (and 1 "
        "bit): else the texture repeats itself",
        CHOSEN,
        gt=0,
        le=1,
    )
    search_radius_px: float = setting(12.0, "around a landmark's predicted pixel", CHOSEN, gt=0, le=1000)
    prior_radii: float = setting(
        3.0,
        "search radii around what an expected motion predicts: it is a hint, not a measurement",
        CHOSEN,
        gt=0,
        le=100,
    )
    prior_share: float = setting(
        0.25,
        "of the reference's points; with fewer found, the expected motion is wrong or much has left the image, and"
        " all keypoints are searched",
        CHOSEN,
        ge=0,
        le=1,
    )
    ransac_iterations: int = setting(300, "at most; fewer when most pairs agree", CHOSEN, gt=0, le=100_000)
    ransac_chi2: float = setting(
        36.0,
        "χ² of a pair that agrees with a hypothesis; wide, since three noisy points make a rough one",
        CHOSEN,
        gt=0,
        le=1e4,
    )
    triangle_m: float = setting(
        0.05,
        "least side of the three points of a hypothesis; smaller ones do not determine a rotation",
        CHOSEN,
        gt=0,
        le=10,
    )
    triangle_change_m: float = setting(
        0.05, "by which a side may differ between both frames, and by", CHOSEN, ge=0, le=10
    )
    triangle_change_share: float = setting(
        0.03, "of its length, as depth is uncertain: else the points do not belong together", CHOSEN, ge=0, le=1
    )
    inlier_chi2: float = setting(
        16.3,
        "χ² of a pair that agrees with a motion: of three numbers, 99.9 % lie below",
        "computed: χ² of 3",
        gt=0,
        le=1e4,
    )
    refinement_steps: int = setting(8, "of Gauss and Newton, at most", CHOSEN, gt=0, le=1000)
    min_inliers: int = setting(15, "point pairs that must agree before a motion is believed", CHOSEN, ge=4, le=20_000)
    max_sigma_m: float = setting(0.10, "a motion less certain than this is no answer", CHOSEN, gt=0, le=10)
    max_sigma_rad: float = setting(0.05, "a rotation less certain than this is no answer", CHOSEN, gt=0, le=3)
    max_speed_m_s: float = setting(5.0, "a faster motion is implausible", CHOSEN, gt=0, le=100)
    max_turn_rad_s: float = setting(8.0, "a faster turn is implausible", CHOSEN, gt=0, le=100)

    longest_step_s: float = setting(
        LONGEST_STEP_S,
        "over a longer gap between two frames their mean velocity says little about that at the frame",
        ON_SIMULATOR,
        gt=0,
        le=10,
    )

    keyframe_share: float = setting(
        0.45, "of a keyframe's landmarks; when fewer are seen, a new keyframe is made", CHOSEN, gt=0, le=1
    )
    local_keyframes: int = setting(30, "nearest keyframes whose landmarks are searched", CHOSEN, gt=0, le=1000)
    view_distance_m: float = setting(
        2.0, "keyframes are near where the points this far before the cameras are", CHOSEN, gt=0, le=100
    )
    kept_keyframes: int = setting(300, "held in memory; the oldest go first", CHOSEN, gt=0, le=100_000)
    lost_after: int = setting(
        10,
        "failed frames in a row, after which the state is lost",
        "Zhang, Fig. 3, N; the paper names no figure",
        gt=0,
        le=1_000_000,
    )
