"""wheelsight's feature odometry: ORB and 3D–3D alignment, against keyframes or the previous frame (Zhang)."""

from __future__ import annotations

from functools import partial
from typing import Literal

from benchmarks.contenders.protocol import Contender
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import RgbdFrame

SEED = 0


class WheelsightFeatures:
    """`FeatureOdometry` as a user gets it."""

    def __init__(self, calibration: Calibration, reference: Literal["keyframes", "previous"]) -> None:
        from wheelsight.vision.features import FeatureOdometry, FeatureSettings

        self._odometry = FeatureOdometry(calibration, FeatureSettings(reference=reference, seed=SEED))

    def prepare(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame as the recording gives it, distortion and all."""
        return frame

    def track(self, prepared: RgbdFrame) -> FloatArray | None:
        """T_odom_camera (4, 4), or None."""
        return self._odometry.process(prepared).T_odom_body


KEYFRAMES = Contender(
    name="wheelsight features (keyframes)",
    start=partial(WheelsightFeatures, reference="keyframes"),
    settings=f"`FeatureOdometry` with default settings, seed {SEED}",
)

PREVIOUS = Contender(
    name="wheelsight features (previous)",
    start=partial(WheelsightFeatures, reference="previous"),
    settings=f"`FeatureOdometry` against the previous frame, as Zhang describes it, seed {SEED}",
)
