"""`Config`, all settings of a run. `load_config` reads it from YAML, and `save_config` writes it beside the results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import ValidationError, field_serializer, field_validator, model_validator

from wheelsight.core.checks import ClockSettings
from wheelsight.core.errors import ConfigError
from wheelsight.core.files import StrPath, settings_text, write_text
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.inputs import line_of, read_yaml
from wheelsight.core.settings import (
    ASKED,
    CHOSEN,
    LiveCameraSettings,
    LivePageSettings,
    LocalizerSettings,
    RealTimeSettings,
    RecognitionSettings,
    RecorderSettings,
    Settings,
    ViewerSettings,
    bounds,
    conflict,
    setting,
)
from wheelsight.core.settings.base import RemovedSetting, SettingFault, over_profile, split_removed
from wheelsight.core.settings.calibration import CameraCalibrationSettings, ExtrinsicsSettings
from wheelsight.core.settings.fusion import AxisWeights, FusionSettings, OdometryTerm, Weights
from wheelsight.io.recordings.recording import OpenOptions
from wheelsight.mapping import SurfelSettings
from wheelsight.navigation.settings import NavigationSettings
from wheelsight.slam.settings import FROM_KEYFRAMES, LoopSettings, SessionSettings
from wheelsight.vision.dense import DenseSettings
from wheelsight.vision.features import FeatureSettings
from wheelsight.wheels import WheelSettings

OdometryName = Literal["features", "dense", "wheels", "own"]
TrackName = Literal["features", "dense", "wheels", "own", "rectified", "joined"]
OWN: OdometryName = "own"
"""Name of a user's own visual odometry, which only Python code can pass: `Localizer(visual_odometry=...)`."""


def _numbers(text: str, names: tuple[str, ...]) -> list[float]:
    """The numbers of a text such as "1.5,2,90"."""
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != len(names):
        raise ValueError(f"should be {len(names)} numbers: {','.join(names)}")
    return numbers


class StartSettings(Settings):
    """Pose of the base in the map at the first wheel reading."""

    x_m: float = setting(..., "position, metres", ASKED, ge=-1e6, le=1e6)
    y_m: float = setting(..., "likewise", ASKED, ge=-1e6, le=1e6)
    yaw_deg: float = setting(..., "heading, degrees from x to y", ASKED, ge=-3600, le=3600)

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any) -> Any:
        names = tuple(cls.model_fields)
        return (
            dict(zip(names, _numbers(given, ("X", "Y", "YAW_DEG")), strict=True)) if isinstance(given, str) else given
        )

    @property
    def T_odom_base(self) -> FloatArray:
        """(4, 4), in the plane."""
        return se3.from_plane(self.x_m, self.y_m, np.radians(self.yaw_deg))


class KnownMapSettings(Settings):
    """The map of an earlier drive, in which a drive localizes itself; see docs/sessions.md."""

    path: str | None = setting(None, "folder of the map, or of the run that wrote it", ASKED)
    extend: bool = setting(False, "whether the drive extends the map; else the map does not change", ASKED)
    start: StartSettings | None = setting(None, "where the drive begins; None: the place is recognised", ASKED)
    start_sigma_m: float = setting(0.5, "σ of each coordinate of `start`, metres", CHOSEN, gt=0, le=100)
    start_sigma_rad: float = setting(0.25, "σ of the heading of `start`, radians", CHOSEN, gt=0, le=3)


_Weight = Annotated[float, bounds(ge=0, le=1)]


class WeightSettings(Settings):
    """Weights of Trinh's eq. 5: alpha of the last coordinate, beta of odometry, gamma of the area."""

    with_area: tuple[_Weight, _Weight, _Weight] = setting(
        ..., "where the area determines the coordinate; sum to 1", "Trinh, eq. 5"
    )
    without_area: tuple[_Weight, _Weight] = setting(..., "alpha and beta elsewhere; sum to 1", "Trinh, eq. 5")

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any) -> Any:
        """Of text, both cases have the same ratio of alpha and beta."""
        if not isinstance(given, str):
            return given
        alpha, beta, gamma = _numbers(given, ("ALPHA", "BETA", "GAMMA"))
        left = alpha + beta
        without = (alpha / left, beta / left) if left > 0 else (0.0, 1.0)
        return {"with_area": (alpha, beta, gamma), "without_area": without}

    @model_validator(mode="after")
    def _check(self) -> Self:
        try:
            self.as_weights()
        except ConfigError as error:
            raise ValueError(f"is wrong: {error}") from error
        return self

    def as_weights(self) -> Weights:
        """The weights as rectifiers take them."""
        return Weights(AxisWeights(*self.with_area), AxisWeights(*self.without_area))


class PlaceSettings(Settings):
    """Areas that rectify the wheels. Without a model all is None; with one, the defaults are set."""

    model: str | None = setting(None, "model that names areas, from wheelsight places train", ASKED)
    areas: str | None = setting(None, "areas.yaml; None: the one in the recording's folder", ASKED)
    rectify: Literal["probabilistic", "paper"] | None = setting(
        None, "probabilistic: by a filter with covariance, the default; paper: by Trinh's eq. 5", ASKED
    )
    start: StartSettings | None = setting(None, "None: from the recording's ground truth", ASKED)
    odometry_term: OdometryTerm | None = setting(
        None, "odometry in eq. 5: its own coordinate, or the last one and the motion since", ASKED
    )
    weights: WeightSettings | None = setting(None, "of eq. 5", ASKED)

    @model_validator(mode="before")
    @classmethod
    def _resolve(cls, given: Any) -> Any:
        """Set the defaults of a run with a model; without one, settings that are given are refused later."""
        if not isinstance(given, dict) or given.get("model") is None:
            return given
        defaults: dict[str, Any] = {"rectify": "probabilistic"}
        if given.get("rectify") == "paper":
            usual = (weights.as_array().tolist() for weights in (Weights().with_area, Weights().without_area))
            with_area, without_area = usual
            weights = {"with_area": with_area, "without_area": without_area[:2]}
            defaults = {"odometry_term": "increment", "weights": weights}
        return defaults | {name: value for name, value in given.items() if value is not None}


class EvaluationSettings(Settings):
    """Comparison of an estimate with the ground truth."""

    with_scale: bool = setting(False, "estimate a scale too when aligning, which hides errors of scale", ASKED)
    max_gap_s: float = setting(
        0.02, "largest time between an estimated and a true pose, seconds", CHOSEN, ge=0, le=3600
    )


class ReportSettings(Settings):
    """Contents of report.html beside the curves."""

    pictures: int = setting(4, "frames drawn with their matches", CHOSEN, ge=0, le=100)


def _is_given(given: Mapping[str, Any], section: str, name: str) -> bool:
    """Whether a file or an option has a setting."""
    below = given.get(section)
    return below is not None and (not isinstance(below, dict) or below.get(name) is not None)


# All available sensors, joined: the name in files and options. In a Config it is an empty tuple.
AUTOMATIC = "auto"


def _can_join(names: Sequence[str]) -> bool:
    """Whether these are wheels and one odometry by a camera."""
    return len(names) == 2 and "wheels" in names


class Config(Settings):
    """All settings of a run, with the defaults of `wheelsight run` and `Localizer`.

    Without names, `odometry` is an empty tuple, in files `auto`: all available sensors, joined. `Localizer`, `run` and
    the command line resolve it by one rule, `estimation.choose_odometry`; `with_odometry` sets its choice.
    """

    profile: Literal["pi"] | None = setting(
        None, "other defaults for one kind of computer: docs/small-computers.md", ASKED
    )
    odometry: tuple[OdometryName, ...] = setting(
        (), "one name or several, in the order of the report; auto: all available sensors, joined", ASKED
    )
    recording: OpenOptions = OpenOptions()
    features: FeatureSettings = FeatureSettings()
    dense: DenseSettings = DenseSettings()
    fusion: FusionSettings = FusionSettings()
    map: Literal["surfels"] | None = setting(None, "map that dense odometry builds and tracks against", ASKED)
    surfels: SurfelSettings = SurfelSettings()
    wheels: WheelSettings = WheelSettings()
    extrinsics: ExtrinsicsSettings = ExtrinsicsSettings()
    camera_calibration: CameraCalibrationSettings = CameraCalibrationSettings()
    clocks: ClockSettings = ClockSettings()
    localizer: LocalizerSettings = LocalizerSettings()
    places: PlaceSettings = PlaceSettings()
    loops: LoopSettings = LoopSettings()
    recognition: RecognitionSettings = RecognitionSettings()
    sessions: SessionSettings = SessionSettings()
    known_map: KnownMapSettings = KnownMapSettings()
    navigation: NavigationSettings = NavigationSettings()
    evaluation: EvaluationSettings = EvaluationSettings()
    report: ReportSettings = ReportSettings()
    viewer: ViewerSettings = ViewerSettings()
    realtime: RealTimeSettings = RealTimeSettings()
    camera: LiveCameraSettings = LiveCameraSettings()
    recorder: RecorderSettings = RecorderSettings()
    page: LivePageSettings = LivePageSettings()

    @field_validator("odometry", mode="before")
    @classmethod
    def _split(cls, names: Any) -> Any:
        """The names of a text such as "wheels,features"; none for "auto"."""
        if names == AUTOMATIC:
            return ()
        if isinstance(names, tuple | list) and not names:
            raise ValueError(f"names none (known: {', '.join(get_args(OdometryName))}, {AUTOMATIC})")
        return tuple(name.strip() for name in names.split(",")) if isinstance(names, str) else names

    @field_validator("odometry")
    @classmethod
    def _refuse_repeats(cls, names: tuple[OdometryName, ...]) -> tuple[OdometryName, ...]:
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"names {name} twice (known: {', '.join(get_args(OdometryName))})")
        return names

    @field_serializer("odometry")
    def _plain(self, names: tuple[OdometryName, ...]) -> str | list[str]:
        return (names[0] if len(names) == 1 else list(names)) if names else AUTOMATIC

    @model_validator(mode="before")
    @classmethod
    def _resolve(cls, given: Any) -> Any:
        """Apply the profile below all; join wheels and a camera by default; close loops for a known map."""
        if not isinstance(given, dict):
            return given
        _, removed = split_removed(given)
        if removed:
            first, more = removed[0], len(removed) - 1
            if not more:
                raise conflict(first.name, first.problem, first.fix)
            fix = f"{first.fix}, or keep the rest: wheelsight config --config FILE --drop-removed > NEW.yaml"
            raise conflict(first.name, f"{first.problem}, and {more} more names are gone too", fix)
        given = over_profile(given.get("profile"), given)
        if _is_given(given, "known_map", "path") and not _is_given(given, "loops", "source"):
            given = {**given, "loops": {**(given.get("loops") or {}), "source": FROM_KEYFRAMES}}
        fusion = given.get("fusion") or {}
        if not isinstance(fusion, dict) or fusion.get("filter") is not None:
            return given
        names = given.get("odometry", AUTOMATIC)
        names = [name.strip() for name in names.split(",")] if isinstance(names, str) else names
        joins = names == [AUTOMATIC] or (isinstance(names, tuple | list) and _can_join(names))
        return {**given, "fusion": {**fusion, "filter": "default" if joins else "none"}}

    @model_validator(mode="after")
    def _refuse_conflicts_of_known_map(self) -> Self:
        known = self.known_map
        if known.path is None:
            for name in ("extend", "start"):
                if getattr(known, name):
                    raise conflict(f"known_map.{name}", "is given without a map", "add --map-from DIR")
            return self
        if self.odometry and len([name for name in self.odometry if name != "wheels"]) != 1:
            raise conflict("known_map.path", "is for one odometry by a camera", "--odometry dense, or wheels,dense")
        if self.fusion.filter == "ligocki":
            raise conflict("known_map.path", "is for the default filter", "no --fusion ligocki")
        if self.loops.source != FROM_KEYFRAMES:
            raise conflict("known_map.path", "is found by loops", f"--loops {FROM_KEYFRAMES}")
        return self

    @model_validator(mode="after")
    def _refuse_conflicts(self) -> Self:
        places, joined_by, is_named = self.places, self.fusion.filter, bool(self.odometry)
        if is_named and joined_by != "none" and not _can_join(self.odometry):
            problem = "joins wheels with one camera odometry, not " + " and ".join(self.odometry)
            raise conflict("fusion.filter", problem, "--odometry wheels,dense or wheels,features")
        if is_named and self.map is not None and "dense" not in self.odometry:
            raise conflict("map", "is built by dense odometry", "add --odometry dense")
        if places.model is None:
            given = [name for name, value in places if value is not None]
            if given:
                raise conflict(f"places.{given[0]}", "is given without a model of places", "add --places MODEL")
        elif is_named and "wheels" not in self.odometry:
            raise conflict("places.model", "rectifies wheels, and there are none", "add --odometry wheels")
        elif joined_by == "ligocki":
            raise conflict("places.model", "is a measurement of the default filter alone", "no --fusion ligocki")
        elif places.rectify != "paper":
            for name in ("odometry_term", "weights"):
                if getattr(places, name) is not None:
                    raise conflict(f"places.{name}", "is of the paper's eq. 5 alone", "add --rectify paper")
        return self

    @property
    def tracks(self) -> tuple[TrackName, ...]:
        """Tracks of a run: each named odometry alone, wheels rectified by places, and joined sensors.

        Empty until the odometry is named.
        """
        if not self.odometry:
            return ()
        rectified: tuple[TrackName, ...] = () if self.places.model is None else ("rectified",)
        return (*self.odometry, *rectified, *(() if self.fusion.filter == "none" else ("joined",)))

    def with_odometry(self, names: tuple[OdometryName, ...]) -> Config:
        """Return these settings with named odometries. An automatic configuration joins them if possible.

        Raises:
            ConfigError: they conflict with other settings, such as a map with wheels alone.
        """
        fusion = self.to_dict()["fusion"]
        if not self.odometry and self.fusion.filter == "default" and not _can_join(names):
            fusion["filter"] = "none"
        try:
            return Config.model_validate(self.to_dict() | {"odometry": names, "fusion": fusion})
        except ValidationError as invalid:
            fault = SettingFault.of(invalid, Config)
            problem, fix = fault.message(".".join(fault.location))
            raise ConfigError(problem, fix=fix) from None

    def without_known_map(self) -> Config:
        """Return these settings without a known map."""
        return self if self.known_map.path is None else self.model_copy(update={"known_map": KnownMapSettings()})

    def to_dict(self) -> dict[str, Any]:
        """Return all settings as plain nested values for YAML and JSON."""
        return self.model_dump(mode="json")

    def alone(self, track: TrackName) -> Config:
        """Return the settings of one of `tracks` by itself. If sensors are joined, only their track has the map."""
        if track == "joined":
            return self
        has_map = track == "dense" and self.fusion.filter == "none"
        apart = self.fusion.model_copy(update={"filter": "none"})
        alone = {"fusion": apart, "map": self.map if has_map else None}
        if track == "rectified":
            return self.model_copy(update={"odometry": ("wheels",), **alone})
        return self.model_copy(update={"odometry": (track,), "places": PlaceSettings(), **alone})


def load_config(
    path: StrPath | None = None,
    overrides: Mapping[str, Any] | None = None,
    called: Mapping[str, str] | None = None,
    *,
    drop_removed: bool = False,
) -> Config:
    """Read settings from a YAML file; all others keep their defaults.

    Args:
        path: the file, or None for defaults only.
        overrides: values by dotted name, such as {"features.seed": 3}; they win over the file.
        called: names of overrides in messages, such as {"features.seed": "--seed"}.
        drop_removed: ignore names in the file that only earlier versions have, as in the config.yaml of an old run.

    Raises:
        ConfigError: with file, line, setting and fix.
    """
    path = None if path is None else Path(path)
    settings = {} if path is None else _read(path)
    if drop_removed:
        settings, _ = split_removed(settings)
    for name, value in (overrides or {}).items():
        settings = _with(settings, name.split("."), value)
    try:
        return Config.model_validate(settings)
    except ValidationError as invalid:
        fault = SettingFault.of(invalid, Config)
        name = ".".join(fault.location)
        option = next((option for option in overrides or {} if f"{name}.".startswith(f"{option}.")), None)
        if option is not None:
            name = (called or {}).get(option, option) + name.removeprefix(option).replace(".", " ")
        problem, fix = fault.message(name)
        if option is not None or path is None:
            raise ConfigError(problem, fix=fix if fix != "remove the line" else "leave it out") from None
        fix = None if fix is None else fix.replace("--config FILE", f"--config {path}")
        raise ConfigError(problem, path=path, line=line_of(path, fault.location, ConfigError), fix=fix) from None


def removed_settings(path: StrPath) -> list[RemovedSetting]:
    """Settings in a YAML file that only earlier versions have. Raises ConfigError."""
    return split_removed(_read(Path(path)))[1]


def save_config(config: Config, path: StrPath) -> None:
    """Write all settings, defaults included, as YAML for `load_config`. Raises OutputError."""
    path = Path(path)
    write_text(path, settings_text(config.to_dict()))


def _read(path: Path) -> dict[str, Any]:
    document = read_yaml(path, ConfigError)
    if document is None:
        return {}
    if not isinstance(document, dict):
        raise ConfigError("must hold names and values", path=path, fix="such as: features: {seed: 1}")
    return document


def _with(settings: Mapping[str, Any], name: list[str], value: Any) -> dict[str, Any]:
    """Return a copy of nested `settings` with another value of a dotted name."""
    head, *rest = name
    below = settings.get(head)
    inner = _with(below if isinstance(below, Mapping) else {}, rest, value) if rest else value
    return {**settings, head: inner}
