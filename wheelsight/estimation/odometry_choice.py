"""Which odometry localizes where the configuration names none: all sensors joined, where that is possible."""

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


# What a user reads about a choice, and which option chooses otherwise.
_SENTENCES: dict[tuple[OdometryName, ...], str] = {
    ("wheels", "dense"): "wheels and camera are joined (--odometry wheels,dense; dense: the camera alone)",
    ("wheels", "features"): "wheels and camera are joined (--odometry wheels,features; features: the camera alone)",
    ("wheels",): "the wheels alone are followed (--odometry wheels)",
    ("features",): "the camera is followed by its features (--odometry features; dense: by all pixels)",
    ("dense",): "the camera is followed by all pixels (--odometry dense; features: by these alone)",
}


@dataclass(frozen=True, slots=True)
class OwnParts:
    """Parts of a user's own in place of built-in ones; None: the built-in one.

    Attributes:
        visual_odometry: follows the camera; the configuration calls it `own`.
        loop_detector: names keyframes that may show the same place.

    Raises:
        ArgumentError: a part lacks its method.
    """

    visual_odometry: VisualOdometry | None = None
    loop_detector: LoopDetector | None = None

    def __post_init__(self) -> None:
        if self.visual_odometry is not None:
            need_method("visual_odometry", self.visual_odometry, "align")
        if self.loop_detector is not None:
            need_method("loop_detector", self.loop_detector, "candidates")

    def named_in(self, config: Config, choice: Choice) -> Config:
        """The configuration with its odometry named: what was chosen if it names none, and `own` for the camera's.

        A loop detector asks for loops that are closed while driving. Raises ConfigError where a part has no use.
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
    """Odometries, and one line about the sensor that they do not use and why; empty where all are used."""

    odometry: tuple[OdometryName, ...]
    unused: str = ""

    @property
    def sentence(self) -> str:
        """One line for a user: what localizes, and which option chooses otherwise."""
        return _SENTENCES[self.odometry]


@dataclass(frozen=True, slots=True)
class Sensors:
    """What is known of the events before the first one; of None, the calibration says whether there will be any.

    Attributes:
        frames, readings: how many frames and wheel readings there will be.
        wheels_from: where wheel readings come from that the recording does not hold; empty without such.
        name: of the source, for messages.
    """

    frames: int | None = None
    readings: int | None = None
    wheels_from: str = ""
    name: str = "the source"


_UNKNOWN = Sensors()


def choose_odometry(calibration: Calibration, config: Config, sensors: Sensors = _UNKNOWN) -> Choice:
    """Wheels and camera where both can be used together, else the one that can.

    The camera is followed by dense odometry, which is the more accurate. It is followed by features where settings of
    features alone differ from their defaults; and, without wheels, with the profile of a small computer, which
    dense odometry would keep busy. What the configuration says of `odometry` does not matter.

    Raises:
        ConfigError: a map is asked for, and there are wheels without images.
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
    """What localizes a robot that has wheels and a camera whose place on it is known: both joined."""
    return "wheels", _camera_odometry(config, beside_wheels=True)


def _camera_odometry(config: Config, *, beside_wheels: bool) -> OdometryName:
    """Dense odometry, or that by features: see `choose_odometry`."""
    defaults = Config(profile=config.profile)
    # Threads change no result, and a seed is of all that is random: neither says which odometry is wanted.
    dense = config.dense.model_copy(update={"threads": defaults.dense.threads})
    features = config.features.model_copy(update={"seed": defaults.features.seed})
    asks_dense = config.map is not None or dense != defaults.dense
    is_slow = config.profile == "pi" and not beside_wheels
    return "features" if (features != defaults.features or is_slow) and not asks_dense else "dense"


def _why_no_wheels(calibration: Calibration, what: str) -> str:
    """Why wheel readings cannot be joined with a camera; empty where they can."""
    if calibration.any_wheels is None:
        return f"{what} are not used: the calibration has no wheels (give them by --calibration)"
    if calibration.T_base_camera is None:
        return f"{what} are not used: the calibration has no T_base_camera (wheelsight calibrate base finds it)"
    return ""


def why_unused(what: str, config: Config, choice: Choice) -> str:
    """One sentence: why events of one kind are not used.

    Args:
        what: such as "1,001 wheel readings"; ends in FRAMES, READINGS or RATES.
        config: names the odometry that is followed.
        choice: what would have been followed where none is named.
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
    """Such as "1,234 frames", or "frames" of an unknown number."""
    return what if count is None else f"{count:,} {what}"
