"""What peers that only compare two frames need: images without distortion, and motions chained to a trajectory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import cv2
import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.events import RgbdFrame
from wheelsight.geometry import Float32Array, FloatArray, PinholeCamera


class FrameToFrame(ABC):
    """Chains the motions between neighbouring frames.

    A frame whose motion is not found has no pose; the next is compared with the last that had one.
    Images are handed over as a camera of the same K without distortion would have taken them, since
    the peers know no distortion. With `register`, depth is first brought into the colour camera; the
    answer is the depth camera's pose all the same.
    """

    def __init__(self, calibration: Calibration, register: bool = False) -> None:
        self._register = _Registration(calibration) if register else None
        color, depth = calibration.cameras
        self.K = (color if register else depth).K
        self._color_maps = _undistortion_maps(color)
        self._depth_maps = _undistortion_maps(depth)
        self._previous: Any = None
        self._T_world_previous = np.eye(4)

    def prepare(self, frame: RgbdFrame) -> Any:
        """The undistorted frame in the peer's own form."""
        color = _undistorted(frame.color, self._color_maps, cv2.INTER_LINEAR)
        depth_m = _undistorted(frame.depth_m, self._depth_maps, cv2.INTER_NEAREST)
        if self._register is not None:
            depth_m = self._register.to_color(depth_m)
        return self.native(RgbdFrame(frame.stamp_s, color, depth_m, frame.index))

    def track(self, prepared: Any) -> FloatArray | None:
        """T_world_camera (4, 4), or None where the peer found no motion."""
        current = self.take_in(prepared)
        if self._previous is not None:
            T_previous_current = self.motion(self._previous, current)
            if T_previous_current is None:
                return None
            self._T_world_previous = self._T_world_previous @ T_previous_current
        self._previous = current
        if self._register is not None:
            return self._T_world_previous @ self._register.T_color_depth
        return self._T_world_previous

    @abstractmethod
    def native(self, frame: RgbdFrame) -> Any:
        """The frame in the types the peer takes; not timed."""

    def take_in(self, prepared: Any) -> Any:
        """What the peer computes once a frame, however often it is compared; timed."""
        return prepared

    @abstractmethod
    def motion(self, previous: Any, current: Any) -> FloatArray | None:
        """T_previous_current (4, 4), or None; timed."""


class _Registration:
    """Brings depth images into the colour camera, by the calibration's T_color_depth."""

    def __init__(self, calibration: Calibration) -> None:
        self.T_color_depth = np.eye(4) if calibration.T_color_depth is None else calibration.T_color_depth
        self._color, self._depth = calibration.cameras

    def to_color(self, depth_m: Float32Array) -> Float32Array:
        """Depth (H, W) as the colour camera without distortion would see it, holes of a pixel closed; 0 is none."""
        size = (self._color.width, self._color.height)
        K_depth, K_color = self._depth.K, self._color.K
        seen = cv2.registerDepth(K_depth, K_color, np.zeros(5), self.T_color_depth, depth_m, size, depthDilation=True)
        return np.nan_to_num(seen, nan=0.0).astype(np.float32)


def _undistortion_maps(camera: PinholeCamera) -> tuple[Any, Any] | None:
    if not camera.has_distortion:
        return None
    size = (camera.width, camera.height)
    return cv2.initUndistortRectifyMap(camera.K, np.array(camera.distortion), None, camera.K, size, cv2.CV_32FC1)


def _undistorted(image: Any, maps: tuple[Any, Any] | None, interpolation: int) -> Any:
    return image if maps is None else cv2.remap(image, *maps, interpolation)
