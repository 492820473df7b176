"""What peers that only compare two frames need: motions chained to a trajectory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from benchmarks.contenders.plain_images import PlainImages
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import RgbdFrame


class FrameToFrame(ABC):
    """Chains the motions between neighbouring frames.

    A frame whose motion is not found has no pose; the next is compared with the last that had one.
    Images are handed over without distortion, which the peers do not know. With `register`, depth is first brought
    into the colour camera; the answer is the depth camera's pose all the same.
    """

    def __init__(self, calibration: Calibration, register: bool = False) -> None:
        self._images = PlainImages(calibration, register)
        self.K = self._images.camera.K
        self._previous: Any = None
        self._T_odom_previous = np.eye(4)

    def prepare(self, frame: RgbdFrame) -> Any:
        """The undistorted frame in the peer's own form."""
        return self.native(self._images.of(frame))

    def track(self, prepared: Any) -> FloatArray | None:
        """T_odom_camera (4, 4), or None where the peer found no motion."""
        current = self.take_in(prepared)
        if self._previous is not None:
            T_previous_current = self.motion(self._previous, current)
            if T_previous_current is None:
                return None
            self._T_odom_previous = self._T_odom_previous @ T_previous_current
        self._previous = current
        return self._T_odom_previous @ self._images.T_view_depth

    @abstractmethod
    def native(self, frame: RgbdFrame) -> Any:
        """The frame in the types the peer takes; not timed."""

    def take_in(self, prepared: Any) -> Any:
        """What the peer computes once a frame, however often it is compared; timed."""
        return prepared

    @abstractmethod
    def motion(self, previous: Any, current: Any) -> FloatArray | None:
        """T_previous_current (4, 4), or None; timed."""
