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


def unused_of(recording: Recording, config: Config, yaw_rates: int) -> tuple[str, ...]:
    """One sentence about each sensor of the recording that a run of `config` does not use, and why.

    Args:
        yaw_rates: how many readings of a gyroscope the recording was found to have.
    """
    named, told = ",".join(config.odometry), list[str]()
    choice = default_odometry(recording, config)
    is_left_out = {
        f"{recording.frame_count:,} frames": config.tracks == ("wheels",) and recording.frame_count > 0,
        f"{recording.wheel_count:,} wheel readings": "wheels" not in config.odometry and recording.wheel_count > 0,
    }
    for readings, is_unused in is_left_out.items():
        if is_unused:
            cannot = choice.unused.startswith(readings)
            told.append(choice.unused if cannot else f"{readings} are not used: --odometry {named} leaves them out")
    if yaw_rates and not (config.wheels.gyro and "wheels" in config.odometry):
        why = "--no-gyro leaves them out" if "wheels" in config.odometry else "they go with wheels"
        told.append(f"{yaw_rates:,} readings of the gyroscope are not used: {why}")
    return tuple(f"{sentence}." for sentence in told)
