"""Which odometry a run follows where nobody named one: all sensors joined, where that is possible."""

from __future__ import annotations

from dataclasses import dataclass

from wheelsight.config import Config, OdometryName
from wheelsight.odometry.dense import DenseSettings
from wheelsight.odometry.features import FeatureSettings
from wheelsight.pipeline.realtime import RealTimeRecording
from wheelsight.recordings import Recording


@dataclass(frozen=True, slots=True)
class Choice:
    """Odometries for a recording, and one line about what is not used of it and why; empty where all is used."""

    odometry: tuple[OdometryName, ...]
    unused: str = ""


def default_odometry(recording: Recording, config: Config) -> Choice:
    """Wheels and camera where both can be used together, else what can; of `config` all but its odometry counts.

    Beside wheels the camera is followed by dense odometry, or by features where settings of these alone are given; by
    itself by features.
    """
    calibration, frames, readings = recording.calibration, recording.frame_count, recording.wheel_count
    elsewhere = recording.wheels if isinstance(recording, RealTimeRecording) else None
    if not frames or (not readings and elsewhere is None):
        return Choice(("features",))
    told = f"wheels from {elsewhere.where} are" if elsewhere is not None else f"{readings:,} wheel readings are"
    if calibration.color is None:
        return Choice(("wheels",), f"{frames:,} frames are not used: the calibration has no cameras")
    if calibration.wheels is None:
        return Choice(("features",), f"{told} not used: the calibration has no wheels (give them by --calibration)")
    if calibration.T_base_camera is None:
        why = "the calibration has no T_base_camera (wheelsight calibrate base finds it)"
        return Choice(("features",), f"{told} not used: {why}")
    asks_dense = config.map is not None or config.dense != DenseSettings()
    by_features = config.features != FeatureSettings() and not asks_dense
    return Choice(("wheels", "features" if by_features else "dense"))
