"""wheelsight's dense odometry: against keyframes, and against the surfel map that it builds on the way."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2

from benchmarks.contenders.protocol import Contender
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import RgbdFrame

if TYPE_CHECKING:
    from wheelsight.vision.dense import DenseSettings


class WheelsightDense:
    """`DenseOdometry` as a user gets it."""

    def __init__(self, calibration: Calibration) -> None:
        from wheelsight.vision.dense import DenseOdometry

        self._odometry = DenseOdometry(calibration, _as_many_threads())

    def prepare(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame as the recording gives it, distortion and all."""
        return frame

    def track(self, prepared: RgbdFrame) -> FloatArray | None:
        """T_odom_camera (4, 4), or None."""
        return self._odometry.process(prepared).T_odom_body


class WheelsightSurfels:
    """`Localizer` with a map, as a user gets it: a frame is tracked against the map's view, and fused."""

    def __init__(self, calibration: Calibration) -> None:
        from wheelsight.config import load_config
        from wheelsight.estimation import Localizer

        threads = cv2.getNumThreads()
        settings = {"odometry": "dense", "map": "surfels", "dense.threads": threads, "surfels.threads": threads}
        self._localizer = Localizer(replace(calibration, T_base_camera=None), load_config(overrides=settings))

    def prepare(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame as the recording gives it, distortion and all."""
        return frame

    def track(self, prepared: RgbdFrame) -> FloatArray | None:
        """T_odom_camera (4, 4), or None."""
        estimate = self._localizer.process(prepared)
        return None if estimate is None else estimate.T_odom_body


def _as_many_threads() -> DenseSettings:
    """Default settings, but for the threads that measure.py holds all libraries to: OpenCV tells how many."""
    from wheelsight.vision.dense import DenseSettings

    return DenseSettings(threads=cv2.getNumThreads())


KEYFRAMES = Contender(
    name="wheelsight dense (keyframes)",
    start=WheelsightDense,
    settings="`DenseOdometry` with default settings",
)

SURFELS = Contender(
    name="wheelsight dense (surfels)",
    start=WheelsightSurfels,
    settings="`Localizer` with a map and default settings: a view is predicted, the frame aligned with it, and fused",
)
