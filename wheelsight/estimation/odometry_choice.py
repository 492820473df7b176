"""Choice of odometry if the configuration names none: all sensors are fused if that is possible."""

from __future__ import annotations

from dataclasses import dataclass

from wheelsight.config import OWN, Config, OdometryName
from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import need_method
from wheelsight.core.errors import ConfigError
from wheelsight.slam.place_recognition import LoopDetector
from wheelsight.slam.settings import FROM_KEYFRAMES, FROM_NOWHERE
from wheelsight.vision.visual_odometry import VisualOdometry

FRAMES, READINGS, RATES = "frames", "wheel readings", "readings of the gyroscope"


# Message for the user: the choice, and the option that chooses otherwise.
_SENTENCES: dict[tuple[OdometryName, ...], str] = {
    ("wheels", "dense"): "wheels and camera are joined (--odometry wheels,dense; dense: the camera alone)",
    ("wheels", "features"): "wheels and camera are joined (--odometry wheels,features; features: the camera alone)",
    ("wheels",): "the wheels alone are followed (--odometry wheels)",
    ("features",): "the camera is followed by its features (--odometry features; dense: by all pixels)",
    ("dense",): "the camera is followed by all pixels (--odometry dense; features: by these alone)",
}


@dataclass(frozen=True, slots=True)
class OwnParts:
    """Custom parts that replace built-in ones; None for the built-in one.

    Attributes:
        visual_odometry: tracks the camera; its name in the configuration is `own`.
        loop_detector: names keyframes that may show the same place.

    Raises:
        ArgumentError: a part without its method.
    """

    visual_odometry: VisualOdometry | None = None
    loop_detector: LoopDetector | None = None

    def __post_init__(self) -> None:
        if self.visual_odometry is not None:
            need_method("visual_odometry", self.visual_odometry, "align")
        if self.loop_detector is not None:
            need_method("loop_detector", self.loop_detector, "candidates")

    def named_in(self, config: Config, choice: Choice) -> Config:
        """Return the configuration with an odometry: `choice` if it names none, and `own` for a custom one.

        A loop detector enables loop closing while driving. Raises ConfigError if a part is not used.
        """
        names = config.odometry or choice.odometry
        if self.visual_odometry is not None and not config.odometry:
            names = tuple(name if name == "wheels" else OWN for name in names)
        if self.visual_odometry is None and OWN in names:
            raise ConfigError("odometry own is a part of your own", fix="Localizer(..., visual_odometry=...), or run")
        if self.visual_odometry is not None and OWN not in names:
            raise ConfigError(f"visual_odometry is not used: odometry is {', '.join(names)}", fix="leave odometry out")
        if self.loop_detector is not None:
            if names == ("wheels",) or config.fusion.filter == "ligocki":
                raise ConfigError("loop_detector is not used: no camera keeps keyframes", fix="leave it out")
            if config.loops.source not in (FROM_NOWHERE, FROM_KEYFRAMES):
                raise ConfigError(
                    f"loop_detector is not used: loops.source is {config.loops.source}", fix="leave it out"
                )
            loops = config.loops.model_copy(update={"source": FROM_KEYFRAMES})
            config = config.model_copy(update={"loops": loops})
        return config if config.odometry == names else config.with_odometry(names)


NO_PARTS = OwnParts()


@dataclass(frozen=True, slots=True)
class Choice:
    """Odometries, and one line on the sensor that they do not use; empty if all are used."""

    odometry: tuple[OdometryName, ...]
    unused: str = ""

    @property
    def sentence(self) -> str:
        """One line for a user: the choice, and the option that chooses otherwise."""
        return _SENTENCES[self.odometry]


@dataclass(frozen=True, slots=True)
class Sensors:
    """Known numbers of events before the first one. For None the calibration decides.

    Attributes:
        frames: number of frames.
        readings: number of wheel readings.
        wheels_from: source of wheel readings outside the recording, or empty.
        name: of the source, for messages.
    """

    frames: int | None = None
    readings: int | None = None
    wheels_from: str = ""
    name: str = "the source"


_UNKNOWN = Sensors()


def choose_odometry(calibration: Calibration, config: Config, sensors: Sensors = _UNKNOWN) -> Choice:
    """Return wheels and camera if both can be fused, else the one that is usable.

    Dense odometry tracks the camera, because it is more accurate. Features do if only settings of features differ from
    their defaults, or, without wheels, with the profile of a small computer. `config.odometry` is ignored.

    Raises:
        ConfigError: the configuration asks for a map, and there are wheels without images.
    """
    by_camera = (_camera_odometry(config, beside_wheels=False),)
    frames, readings, elsewhere = sensors.frames, sensors.readings, sensors.wheels_from
    if not elsewhere and (readings == 0 or (readings is None and calibration.any_wheels is None)):
        return Choice(by_camera, _why_no_wheels(calibration, READINGS) if readings is None else "")
    if frames == 0 or calibration.color is None:
        for option, value in (("--map", config.map), ("--map-from", config.known_map.path)):
            if value is not None:
                raise ConfigError(f"{sensors.name}: the recording has no images for {option}", fix="leave it out")
        unused = "" if frames == 0 else f"{counted(frames, FRAMES)} are not used: the calibration has no cameras"
        return Choice(("wheels",), unused)
    unused = _why_no_wheels(calibration, f"wheels from {elsewhere}" if elsewhere else counted(readings, READINGS))
    if unused:
        return Choice(by_camera, unused)
    return Choice(odometry_of_robot(config))


def odometry_of_robot(config: Config) -> tuple[OdometryName, OdometryName]:
    """Return the odometries of a robot with wheels and a camera whose mount is known: both fused."""
    return "wheels", _camera_odometry(config, beside_wheels=True)


def _camera_odometry(config: Config, *, beside_wheels: bool) -> OdometryName:
    """Return dense or feature odometry; see `choose_odometry`."""
    defaults = Config(profile=config.profile)
    # A seed is common to all: it indicates no odometry.
    features = config.features.model_copy(update={"seed": defaults.features.seed})
    asks_dense = config.map is not None or config.dense != defaults.dense
    is_slow = config.profile == "pi" and not beside_wheels
    return "features" if (features != defaults.features or is_slow) and not asks_dense else "dense"


def _why_no_wheels(calibration: Calibration, what: str) -> str:
    """Return why wheel readings cannot be fused with a camera; empty if they can."""
    if calibration.any_wheels is None:
        return f"{what} are not used: the calibration has no wheels (give them by --calibration)"
    if calibration.T_base_camera is None:
        return f"{what} are not used: the calibration has no T_base_camera (wheelsight calibrate base finds it)"
    return ""


def why_unused(what: str, config: Config, choice: Choice) -> str:
    """Return one sentence on why events of one kind are not used.

    Args:
        what: such as "1,001 wheel readings"; ends in FRAMES, READINGS or RATES.
        config: with the odometry in use.
        choice: default for a configuration without odometry.
    """
    by_wheels = "wheels" in config.odometry
    if what.endswith(RATES):
        why = "--no-gyro leaves them out" if by_wheels and not config.wheels.gyro else "they go with wheels"
        sentence = f"{what} are not used: {why}"
    elif choice.unused.startswith(what):
        sentence = choice.unused
    else:
        sentence = f"{what} are not used: --odometry {','.join(config.odometry)} leaves them out"
    return f"{sentence[0].upper()}{sentence[1:]}."


def counted(count: int | None, what: str) -> str:
    """Return a text such as "1,234 frames", or "frames" for an unknown number."""
    return what if count is None else f"{count:,} {what}"
