"""SmallerImages: frames halved before anything looks at them, for computers that are slow."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.events import RgbdFrame
from wheelsight.geometry import ByteArray, Float32Array, FloatArray, PinholeCamera
from wheelsight.odometry.dense import halved_depth
from wheelsight.odometry.features import MatchedPixels
from wheelsight.threads import Rows


class SmallerImages:
    """Halves the images of both cameras until they are wide enough and no wider.

    Args:
        calibration: of frames as they come.
        most_width_px: an image wider than this is halved; None leaves all as they are.
        depth_jump: share of a depth that tells two surfaces apart, for depth is not averaged over both.

    Attributes:
        calibration: of frames as they leave.
    """

    def __init__(self, calibration: Calibration, most_width_px: int | None, depth_jump: float) -> None:
        self._color_halvings = _halvings(calibration.color, most_width_px)
        self._depth_halvings = _halvings(calibration.depth, most_width_px)
        self._jump, self._rows = depth_jump, Rows(1)
        self.calibration = calibration
        if calibration.color is not None and calibration.depth is not None:
            self.calibration = replace(
                calibration,
                color=calibration.color.halved(self._color_halvings),
                depth=calibration.depth.halved(self._depth_halvings),
                color_sigma_px=calibration.color_sigma_px / 2**self._color_halvings,
            )

    def frame(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame with smaller images."""
        if not (self._color_halvings or self._depth_halvings):
            return frame
        return replace(frame, color=self._color(frame.color), depth_m=self._depth(frame.depth_m))

    def in_full(self, matches: MatchedPixels | None) -> MatchedPixels | None:
        """Pixels of smaller colour images as those of the frames that came."""
        if matches is None or not self._color_halvings:
            return matches
        return replace(matches, px=self._in_full(matches.px), reference_px=self._in_full(matches.reference_px))

    def _color(self, color: ByteArray) -> ByteArray:
        if not self._color_halvings:
            return color
        height, width = (size >> self._color_halvings for size in color.shape[:2])
        whole = color[: height << self._color_halvings, : width << self._color_halvings]
        return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8)

    def _depth(self, depth_m: Float32Array) -> Float32Array:
        for halving in range(self._depth_halvings):
            # The same slope is twice the step from pixel to pixel.
            depth_m = halved_depth(depth_m, self._jump * (1 << halving), self._rows)
        return depth_m

    def _in_full(self, px: FloatArray) -> FloatArray:
        return np.asarray((px + 0.5) * 2**self._color_halvings - 0.5)


def _halvings(camera: PinholeCamera | None, most_width_px: int | None) -> int:
    times = 0
    while camera is not None and most_width_px is not None and camera.width >> times > most_width_px:
        times += 1
    return times
