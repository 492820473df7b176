"""wheelsight's dense odometry: against keyframes, and against the surfel map that it builds on the way."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.contenders.protocol import Contender
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import RgbdFrame


class WheelsightDense:
    """`DenseOdometry` as a user gets it."""

    def __init__(self, calibration: Calibration) -> None:
        from wheelsight.vision.dense import DenseOdometry

        self._odometry = DenseOdometry(calibration)

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

        settings = load_config(overrides={"odometry": "dense", "map": "surfels"})
        self._localizer = Localizer(replace(calibration, T_base_camera=None), settings)

    def prepare(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame as the recording gives it, distortion and all."""
        return frame

    def track(self, prepared: RgbdFrame) -> FloatArray | None:
        """T_odom_camera (4, 4), or None."""
        estimate = self._localizer.process(prepared)
        return None if estimate is None else estimate.T_odom_body


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
