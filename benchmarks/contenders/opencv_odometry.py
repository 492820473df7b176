"""OpenCV's `cv2.Odometry`: photometric and depth error together (Steinbrücker et al. 2011), from frame to frame."""

from __future__ import annotations

from functools import partial
from typing import Any

import cv2
import numpy as np

from benchmarks.contenders.frame_to_frame import FrameToFrame
from benchmarks.contenders.protocol import Contender
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import RgbdFrame


class OpencvOdometry(FrameToFrame):
    """RGB_DEPTH with the library's own settings; each frame's pyramids are built once and used twice."""

    def __init__(self, calibration: Calibration, register: bool = False) -> None:
        super().__init__(calibration, register)
        settings = cv2.OdometrySettings()
        settings.setCameraMatrix(self.K.astype(np.float32))
        self._odometry = cv2.Odometry(cv2.OdometryType_RGB_DEPTH, settings, cv2.OdometryAlgoType_COMMON)

    def native(self, frame: RgbdFrame) -> tuple[Any, Any]:
        """Depth in metres and the image in OpenCV's order of colours."""
        return frame.depth_m, cv2.cvtColor(frame.color, cv2.COLOR_RGB2BGR)

    def take_in(self, prepared: tuple[Any, Any]) -> Any:
        """A frame that can be both source and destination."""
        frame = cv2.OdometryFrame(*prepared)
        self._odometry.prepareFrame(frame)
        return frame

    def motion(self, previous: Any, current: Any) -> FloatArray | None:
        """T_previous_current (4, 4), or None where OpenCV says it failed."""
        found, T_previous_current = self._odometry.compute(current, previous)
        return np.asarray(T_previous_current, float) if found else None


RGB_DEPTH = Contender(
    name="OpenCV Odometry RGB_DEPTH",
    start=OpencvOdometry,
    settings="`cv2.Odometry`, type RGB_DEPTH, algorithm COMMON, frame to frame; default settings but for the camera "
    "matrix; depth in metres; `prepareFrame` once a frame",
    is_peer=True,
)

REGISTERED = Contender(
    name="OpenCV Odometry, depth registered",
    start=partial(OpencvOdometry, register=True),
    settings="the same, given depth that `cv2.registerDepth` brought into the colour camera",
    is_peer=True,
    registers=True,
)
