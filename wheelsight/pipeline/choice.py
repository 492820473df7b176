"""Which odometry a run of a source follows, and what of the source it does not use."""

from __future__ import annotations

from wheelsight.config import Config
from wheelsight.localizer.choice import (
    FRAMES,
    NO_PARTS,
    RATES,
    READINGS,
    Choice,
    OwnParts,
    Sensors,
    choose_odometry,
    counted,
    why_unused,
)
from wheelsight.pipeline.origin import frame_count_of, wheel_count_of, where
from wheelsight.pipeline.realtime import RealTimeRecording
from wheelsight.sources import EventSource


def default_odometry(source: EventSource, config: Config) -> Choice:
    """`localizer.choose_odometry` by what the source has. Raises ConfigError."""
    elsewhere = source.wheels.where if isinstance(source, RealTimeRecording) and source.wheels is not None else ""
    sensors = Sensors(frame_count_of(source), wheel_count_of(source), elsewhere, where(source))
    return choose_odometry(source.calibration, config, sensors)


def resolved(source: EventSource, config: Config, parts: OwnParts = NO_PARTS) -> Config:
    """The configuration with its odometry named: `default_odometry` where it is automatic. Raises ConfigError."""
    if config.odometry and parts == NO_PARTS:
        return config
    return parts.named_in(config, default_odometry(source, config))


def unused_of(source: EventSource, config: Config, yaw_rates: int) -> tuple[str, ...]:
    """One sentence about each sensor of the source that a run of `config` does not use, and why.

    Args:
        source: what was followed.
        config: all settings of the run, its odometry named.
        yaw_rates: how many readings of a gyroscope came.
    """
    choice, calibration = default_odometry(source, config), source.calibration
    frames, readings = frame_count_of(source), wheel_count_of(source)
    has_frames = frames > 0 if frames is not None else calibration.color is not None
    has_readings = readings > 0 if readings is not None else calibration.any_wheels is not None
    by_wheels = "wheels" in config.odometry
    is_left_out = {
        counted(frames, FRAMES): config.tracks == ("wheels",) and has_frames,
        counted(readings, READINGS): not by_wheels and has_readings,
        counted(yaw_rates, RATES): bool(yaw_rates) and not (config.wheels.gyro and by_wheels),
    }
    return tuple(why_unused(what, config, choice) for what, is_unused in is_left_out.items() if is_unused)
