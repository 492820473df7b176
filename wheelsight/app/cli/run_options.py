"""The options of `wheelsight run`, in the order of its help, and `wheelsight config`, which prints the resulting
settings.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from wheelsight.app.cli.options import (
    INPUT,
    OUTPUT,
    SETTINGS,
    CalibrationFile,
    DepthFactor,
    MaxGap,
    Profile,
    RateHz,
    Rerun,
    Topics,
    option,
    setting_option,
    settings_from,
)

# Sensors


_REAL_TIME, _LIVE = "In real time", "Live, in place of a recording"

LiveRecording = Annotated[
    Path | None,
    typer.Argument(
        metavar="RECORDING",
        help="Folder of the recording, or a ROS bag; [bold]sample[/bold] is one that comes along; none with --live.",
        show_default=False,
    ),
]
LiveCamera = Annotated[
    str | None,
    option(
        "Calibration to use: the name of a shipped one, such as freiburg1, or a calibration.yaml. With --live: "
        "the camera, as for wheelsight record.",
        "NAME|FILE",
        "what the recording itself says",
        INPUT,
        flag="--camera",
    ),
]
RealTime = Annotated[
    bool,
    option(
        "Play the recording in real time; frames that come too fast are dropped.", panel=_REAL_TIME, flag="--realtime"
    ),
]
WheelsFrom = Annotated[
    str | None,
    option(
        "Wheel readings in real time from elsewhere: a serial port, the pipe of wheels serve, or a wheels.csv.",
        "FROM",
        "the recording's own",
        _REAL_TIME,
    ),
]
Baud = Annotated[int | None, option("Baud rate of the port.", "RATE", "115200", _REAL_TIME, min=1)]
Live = Annotated[
    bool,
    option(
        "Follow what --camera and --wheels show just now, until Ctrl-C or --seconds, in place of a recording.",
        panel=_LIVE,
        flag="--live",
    ),
]
Wheels = Annotated[str | None, option("With --live: serial port of the wheel controller.", "PORT", "none", _LIVE)]
Seconds = Annotated[
    float | None, option("With --live: stop so long after ready.", "SECONDS", "at Ctrl-C", _LIVE, min=0)
]
Record = Annotated[Path | None, option("With --live: record what is followed, too.", "DIR", "not recorded", _LIVE)]


# Odometry and areas


_ODOMETRY, _AREAS = "Odometry", "Areas that rectify wheels"

Odometry = Annotated[
    str | None,
    setting_option(
        "odometry",
        "--odometry",
        "How motion is estimated: features, dense, wheels, or several; wheels and a camera are joined too.",
        "NAME[,NAME]",
        "all sensors that the recording has, joined",
        _ODOMETRY,
    ),
]
Fusion = Annotated[
    str | None,
    setting_option(
        "fusion.filter",
        "--fusion",
        "How wheels and camera are joined: default, ligocki (eq. 2), or none.",
        "NAME",
        "default, where both are named",
        _ODOMETRY,
    ),
]
Reference = Annotated[
    str | None,
    setting_option(
        "features.reference",
        "--reference",
        "What a frame is aligned with: previous or keyframes.",
        "NAME",
        "keyframes",
        _ODOMETRY,
    ),
]
Integration = Annotated[
    str | None,
    setting_option(
        "wheels.integration",
        "--integration",
        "How wheels are integrated: arc, midpoint or euler.",
        "NAME",
        "arc",
        _ODOMETRY,
    ),
]
Gyro = Annotated[
    bool | None,
    setting_option(
        "wheels.gyro", "--gyro/--no-gyro", "Join a gyroscope with the wheels.", shown="--gyro", panel=_ODOMETRY
    ),
]
Seed = Annotated[
    int | None, setting_option("features.seed", "--seed", "Seed of all random choices.", shown="0", panel=_ODOMETRY)
]
Model = Annotated[
    str | None,
    setting_option(
        "places.model",
        "--places",
        "Rectify wheels, joined or alone, by the areas that frames show.",
        "MODEL",
        False,
        _AREAS,
    ),
]
Rectify = Annotated[
    str | None,
    setting_option(
        "places.rectify",
        "--rectify",
        "probabilistic: a filter with covariance; paper: eq. 5.",
        "WAY",
        "probabilistic",
        _AREAS,
    ),
]
Areas = Annotated[
    str | None,
    setting_option(
        "places.areas", "--areas", "areas.yaml of the model.", "FILE", "that in the recording's folder", _AREAS
    ),
]
OdometryTerm = Annotated[
    str | None,
    setting_option(
        "places.odometry_term",
        "--odometry-term",
        "Odometry in eq. 5: increment or absolute.",
        "NAME",
        "increment",
        _AREAS,
    ),
]
Weights = Annotated[
    str | None,
    setting_option("places.weights", "--weights", "alpha, beta, gamma of eq. 5.", "A,B,G", "0,0.9,0.1", _AREAS),
]


# Maps and loops


_MAPS = "Loops and maps"

Map = Annotated[
    str | None,
    setting_option(
        "map", "--map", "What dense odometry builds and tracks against: surfels.", "NAME", "keyframes alone", _MAPS
    ),
]
Loops = Annotated[
    str | None,
    setting_option(
        "loops.source",
        "--loops",
        "Correct the way by places that were recognised: keyframes, those that the camera sees again; matches, "
        "the recording's own and its loops.csv; or a file like that.",
        "SOURCE",
        "none",
        _MAPS,
    ),
]
MapFrom = Annotated[
    Path | None,
    setting_option(
        "known_map.path",
        "--map-from",
        "Find oneself in a map of before: that of an earlier run with --map surfels.",
        "DIR",
        False,
        _MAPS,
    ),
]
Extend = Annotated[
    bool,
    setting_option("known_map.extend", "--extend", "Add to the map of --map-from what this drive sees.", panel=_MAPS),
]
Start = Annotated[
    str | None,
    setting_option(
        "places.start",
        "--start",
        "Where the base stands at first, in the map of --map-from or of the areas.",
        "X,Y,YAW_DEG",
        "recognised; of areas, by ground truth",
        _MAPS,
    ),
]


# All options


Out = Annotated[Path, option("Folder for the results; made if need be.", "DIR", False, OUTPUT)]
SettingsFile = Annotated[
    Path | None, option("Settings in YAML; options given here win over it.", "FILE", False, SETTINGS)
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite results in DIR.", rich_help_panel=OUTPUT)]


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of `run`; None where one was left out."""

    out: Out
    recording: LiveRecording = None
    camera: LiveCamera = None
    calibration: CalibrationFile = None
    depth_factor: DepthFactor = None
    max_gap: MaxGap = None
    rate_hz: RateHz = None
    topic: Topics = None
    force: Force = False
    rerun: Rerun = None
    odometry: Odometry = None
    fusion: Fusion = None
    reference: Reference = None
    integration: Integration = None
    gyro: Gyro = None
    seed: Seed = None
    map_: Map = None
    loops: Loops = None
    map_from: MapFrom = None
    extend: Extend = False
    start: Start = None
    config: SettingsFile = None
    profile: Profile = None
    places: Model = None
    rectify: Rectify = None
    areas: Areas = None
    odometry_term: OdometryTerm = None
    weights: Weights = None
    realtime: RealTime = False
    wheels_from: WheelsFrom = None
    baud: Baud = None
    live: Live = False
    wheels: Wheels = None
    seconds: Seconds = None
    record: Record = None

    def settings(self) -> dict[str, object]:
        """Values of the options that set settings, by their dotted names, as `settings_from` takes them."""
        return {
            "profile": self.profile,
            "odometry": self.odometry,
            "fusion.filter": self.fusion,
            "map": self.map_,
            "loops.source": self.loops,
            "known_map.path": None if self.map_from is None else str(self.map_from),
            "known_map.extend": self.extend or None,
            "recording.camera": None if self.live else self.camera,  # of a live run it names a device
            "recording.calibration": self.calibration,
            "recording.depth_factor": self.depth_factor,
            "recording.max_gap_s": self.max_gap,
            "recording.rate_hz": self.rate_hz,
            "recording.topics": self.topic,
            "features.reference": self.reference,
            "features.seed": self.seed,
            "wheels.integration": self.integration,
            "wheels.gyro": self.gyro,
            "places.model": self.places,
            "places.areas": self.areas,
            "places.rectify": self.rectify,
            "places.start" if self.map_from is None else "known_map.start": self.start,
            "places.odometry_term": self.odometry_term,
            "places.weights": self.weights,
        }


# wheelsight config


def config_config(
    profile: Profile = None,
    config: SettingsFile = None,
    changed: Annotated[bool, typer.Option("--changed", help="Only what is not as by default.")] = False,
    drop_removed: Annotated[
        bool, typer.Option("--drop-removed", help="Leave out settings that only earlier versions had.")
    ] = False,
) -> None:
    """Print all settings as YAML, as `wheelsight run` takes them by --config.

    docs/configuration.md says of each what it is, and why it is what it is.

    [bold]Examples[/bold]

    wheelsight config --profile pi --changed

    wheelsight config > settings.yaml

    wheelsight config --config old-run/config.yaml --drop-removed --changed > settings.yaml
    """
    from wheelsight.app.cli.console import print_warning
    from wheelsight.config import removed_settings
    from wheelsight.core.files import settings_text
    from wheelsight.core.settings.base import differing

    settings = settings_from({"profile": profile}, config, drop_removed=drop_removed).to_dict()
    for one in removed_settings(config) if drop_removed and config is not None else ():
        if one.differs:
            print_warning(f"{one.name} = {one.value} is lost: it {one.problem}")
    shown = differing(settings, settings_from({}).to_dict()) if changed else settings
    typer.echo(settings_text(shown), nl=False)
