"""What peers that model neither a lens nor two cameras are handed: images without distortion, registered depth."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera
from wheelsight.core.messages import RgbdFrame


class PlainImages:
    """Frames as a camera of the same K without distortion would have taken them.

    Args:
        calibration: of the recording.
        register: bring depth into the colour camera.

    Attributes:
        camera: whose view the frames' depth shows, but for its distortion.
        T_view_depth: (4, 4) from the depth camera to that one; identity unless registered.
    """

    def __init__(self, calibration: Calibration, register: bool = False) -> None:
        self._color, self._depth = calibration.cameras
        self._register = register
        self.camera = self._color if register else self._depth
        T_color_depth = calibration.T_color_depth
        self.T_view_depth: FloatArray = np.array(T_color_depth) if register and T_color_depth is not None else np.eye(4)
        self._color_maps = _undistortion_maps(self._color)
        self._depth_maps = _undistortion_maps(self._depth)

    def of(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame without distortion."""
        color = _undistorted(frame.color, self._color_maps, cv2.INTER_LINEAR)
        depth_m = _undistorted(frame.depth_m, self._depth_maps, cv2.INTER_NEAREST)
        return RgbdFrame(frame.stamp_s, color, self._to_color(depth_m) if self._register else depth_m, frame.index)

    def _to_color(self, depth_m: Float32Array) -> Float32Array:
        """Depth (H, W) as the colour camera without distortion would see it, holes of a pixel closed; 0 is none."""
        size = (self._color.width, self._color.height)
        Ks = (self._depth.K, self._color.K)
        seen = cv2.registerDepth(*Ks, np.zeros(5), self.T_view_depth, depth_m, size, depthDilation=True)
        return np.nan_to_num(seen, nan=0.0).astype(np.float32)


def _undistortion_maps(camera: PinholeCamera) -> tuple[Any, Any] | None:
    if not camera.has_distortion:
        return None
    size = (camera.width, camera.height)
    return cv2.initUndistortRectifyMap(camera.K, np.array(camera.distortion), None, camera.K, size, cv2.CV_32FC1)


def _undistorted(image: Any, maps: tuple[Any, Any] | None, interpolation: int) -> Any:
    return image if maps is None else cv2.remap(image, *maps, interpolation)
