"""Which odometry a run follows where nobody named one: all sensors joined, where that is possible."""

from __future__ import annotations

from dataclasses import dataclass

from wheelsight.config import Config, OdometryName
from wheelsight.errors import ConfigError
from wheelsight.pipeline.origin import frame_count_of, wheel_count_of, where
from wheelsight.pipeline.realtime import RealTimeRecording
from wheelsight.sources import EventSource

_FRAMES, _READINGS = "frames", "wheel readings"


# What a user is told of a choice, and what else there is.
_TOLD: dict[tuple[OdometryName, ...], str] = {
    ("wheels", "dense"): "wheels and camera are joined (--odometry wheels,dense; dense: the camera alone)",
    ("wheels", "features"): "wheels and camera are joined (--odometry wheels,features; features: the camera alone)",
    ("wheels",): "the wheels alone are followed (--odometry wheels)",
    ("features",): "the camera is followed by its features (--odometry features; dense: by all pixels)",
    ("dense",): "the camera is followed by all pixels (--odometry dense; features: by these alone)",
}


@dataclass(frozen=True, slots=True)
class Choice:
    """Odometries for a source, and one line about what is not used of it and why; empty where all is used."""

    odometry: tuple[OdometryName, ...]
    unused: str = ""

    @property
    def told(self) -> str:
        """One line for a user: what the run goes by, and which option chooses otherwise."""
        return _TOLD[self.odometry]


def default_odometry(source: EventSource, config: Config) -> Choice:
    """Wheels and camera where both can be used together, else what can; of `config` all but its odometry counts.

    The camera is followed by dense odometry where a map or settings of that are asked for, and beside wheels where none
    of features alone are; else by features. Wheels without images are followed alone. A source whose counts nobody
    knows gives what its calibration tells of.

    Raises:
        ConfigError: a map is asked for, and there are wheels without images.
    """
    calibration, frames, readings = source.calibration, frame_count_of(source), wheel_count_of(source)
    elsewhere = source.wheels if isinstance(source, RealTimeRecording) else None
    unasked = Config(profile=config.profile)
    asks_dense = config.map is not None or config.dense != unasked.dense
    by_camera: tuple[OdometryName, ...] = ("dense",) if asks_dense else ("features",)
    if readings == 0 and elsewhere is None:
        return Choice(by_camera)
    if frames == 0:
        for option, value in (("--map", config.map), ("--map-from", config.known_map.path)):
            if value is not None:
                raise ConfigError(f"{where(source)}: the recording has no images for {option}", fix="leave it out")
        return Choice(("wheels",))
    told = f"wheels from {elsewhere.where}" if elsewhere is not None else _counted(readings, _READINGS)
    if calibration.color is None:
        return Choice(("wheels",), f"{_counted(frames, _FRAMES)} are not used: the calibration has no cameras")
    if calibration.wheels is None:
        return Choice(by_camera, f"{told} are not used: the calibration has no wheels (give them by --calibration)")
    if calibration.T_base_camera is None:
        why = "the calibration has no T_base_camera (wheelsight calibrate base finds it)"
        return Choice(by_camera, f"{told} are not used: {why}")
    by_features = config.features != unasked.features and not asks_dense
    return Choice(("wheels", "features" if by_features else "dense"))


def unused_of(source: EventSource, config: Config, yaw_rates: int) -> tuple[str, ...]:
    """One sentence about each sensor of the source that a run of `config` does not use, and why.

    Args:
        source: what was followed.
        config: all settings of the run.
        yaw_rates: how many readings of a gyroscope came.
    """
    named, told = ",".join(config.odometry), list[str]()
    choice, calibration = default_odometry(source, config), source.calibration
    frames, readings = frame_count_of(source), wheel_count_of(source)
    has_frames = frames > 0 if frames is not None else calibration.color is not None
    has_readings = readings > 0 if readings is not None else calibration.wheels is not None
    is_left_out = {
        _counted(frames, _FRAMES): config.tracks == ("wheels",) and has_frames,
        _counted(readings, _READINGS): "wheels" not in config.odometry and has_readings,
    }
    for counted, is_unused in is_left_out.items():
        if is_unused:
            cannot = choice.unused.startswith(counted)
            told.append(choice.unused if cannot else f"{counted} are not used: --odometry {named} leaves them out")
    if yaw_rates and not (config.wheels.gyro and "wheels" in config.odometry):
        why = "--no-gyro leaves them out" if "wheels" in config.odometry else "they go with wheels"
        told.append(f"{yaw_rates:,} readings of the gyroscope are not used: {why}")
    return tuple(f"{sentence[0].upper()}{sentence[1:]}." for sentence in told)


def _counted(count: int | None, what: str) -> str:
    """Such as "1,234 frames", or "frames" where nobody knows how many."""
    return what if count is None else f"{count:,} {what}"
