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
    typer.Option(
        "--camera",
        metavar="NAME|FILE",
        help="Calibration to use: the name of a shipped one, such as freiburg1, or a calibration.yaml. With --live: "
        "the camera, as for wheelsight record.",
        show_default="what the recording itself says",
        rich_help_panel=INPUT,
    ),
]
RealTime = Annotated[
    bool,
    typer.Option(
        "--realtime",
        help="Play the recording in real time; frames that come too fast are dropped.",
        rich_help_panel=_REAL_TIME,
    ),
]
WheelsFrom = Annotated[
    str | None,
    typer.Option(
        metavar="FROM",
        help="Wheel readings in real time from elsewhere: a serial port, the pipe of wheels serve, or a wheels.csv.",
        show_default="the recording's own",
        rich_help_panel=_REAL_TIME,
    ),
]
Baud = Annotated[
    int | None,
    typer.Option(
        min=1, metavar="RATE", help="Baud rate of the port.", show_default="115200", rich_help_panel=_REAL_TIME
    ),
]
Live = Annotated[
    bool,
    typer.Option(
        "--live",
        help="Follow what --camera and --wheels show just now, until Ctrl-C or --seconds, in place of a recording.",
        rich_help_panel=_LIVE,
    ),
]
Wheels = Annotated[
    str | None,
    typer.Option(
        metavar="PORT",
        help="With --live: serial port of the wheel controller.",
        show_default="none",
        rich_help_panel=_LIVE,
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option(
        min=0,
        metavar="SECONDS",
        help="With --live: stop so long after ready.",
        show_default="at Ctrl-C",
        rich_help_panel=_LIVE,
    ),
]
Record = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="With --live: record what is followed, too.",
        show_default="not recorded",
        rich_help_panel=_LIVE,
    ),
]


# Odometry and areas


_ODOMETRY, _AREAS = "Odometry", "Areas that rectify wheels"

Odometry = Annotated[
    str | None,
    setting_option(
        "odometry",
        "--odometry",
        metavar="NAME[,NAME]",
        help="How motion is estimated: features, dense, wheels, or several; wheels and a camera are joined too.",
        show_default="all sensors that the recording has, joined",
        rich_help_panel=_ODOMETRY,
    ),
]
Fusion = Annotated[
    str | None,
    setting_option(
        "fusion.filter",
        "--fusion",
        metavar="NAME",
        help="How wheels and camera are joined: default, ligocki (eq. 2), or none.",
        show_default="default, where both are named",
        rich_help_panel=_ODOMETRY,
    ),
]
Reference = Annotated[
    str | None,
    setting_option(
        "features.reference",
        "--reference",
        metavar="NAME",
        help="What a frame is aligned with: previous or keyframes.",
        show_default="keyframes",
        rich_help_panel=_ODOMETRY,
    ),
]
Integration = Annotated[
    str | None,
    setting_option(
        "wheels.integration",
        "--integration",
        metavar="NAME",
        help="How wheels are integrated: arc, midpoint or euler.",
        show_default="arc",
        rich_help_panel=_ODOMETRY,
    ),
]
Gyro = Annotated[
    bool | None,
    setting_option(
        "wheels.gyro",
        "--gyro/--no-gyro",
        help="Join a gyroscope with the wheels.",
        show_default="--gyro",
        rich_help_panel=_ODOMETRY,
    ),
]
Seed = Annotated[
    int | None,
    setting_option(
        "features.seed", "--seed", help="Seed of all random choices.", show_default="0", rich_help_panel=_ODOMETRY
    ),
]
Model = Annotated[
    str | None,
    setting_option(
        "places.model",
        "--places",
        metavar="MODEL",
        help="Rectify wheels, joined or alone, by the areas that frames show.",
        show_default=False,
        rich_help_panel=_AREAS,
    ),
]
Rectify = Annotated[
    str | None,
    setting_option(
        "places.rectify",
        "--rectify",
        metavar="WAY",
        help="probabilistic: a filter with covariance; paper: eq. 5.",
        show_default="probabilistic",
        rich_help_panel=_AREAS,
    ),
]
Areas = Annotated[
    str | None,
    setting_option(
        "places.areas",
        "--areas",
        metavar="FILE",
        help="areas.yaml of the model.",
        show_default="that in the recording's folder",
        rich_help_panel=_AREAS,
    ),
]
OdometryTerm = Annotated[
    str | None,
    setting_option(
        "places.odometry_term",
        "--odometry-term",
        metavar="NAME",
        help="Odometry in eq. 5: increment or absolute.",
        show_default="increment",
        rich_help_panel=_AREAS,
    ),
]
Weights = Annotated[
    str | None,
    setting_option(
        "places.weights",
        "--weights",
        metavar="A,B,G",
        help="alpha, beta, gamma of eq. 5.",
        show_default="0,0.9,0.1",
        rich_help_panel=_AREAS,
    ),
]


# Maps and loops


_MAPS = "Loops and maps"

Map = Annotated[
    str | None,
    setting_option(
        "map",
        "--map",
        metavar="NAME",
        help="What dense odometry builds and tracks against: surfels.",
        show_default="keyframes alone",
        rich_help_panel=_MAPS,
    ),
]
Loops = Annotated[
    str | None,
    setting_option(
        "loops.source",
        "--loops",
        metavar="SOURCE",
        help="Correct the way by places that were recognised: keyframes, those that the camera sees again; matches, "
        "the recording's own and its loops.csv; or a file like that.",
        show_default="none",
        rich_help_panel=_MAPS,
    ),
]
MapFrom = Annotated[
    Path | None,
    setting_option(
        "known_map.path",
        "--map-from",
        metavar="DIR",
        help="Find oneself in a map of before: that of an earlier run with --map surfels.",
        show_default=False,
        rich_help_panel=_MAPS,
    ),
]
Extend = Annotated[
    bool,
    setting_option(
        "known_map.extend", "--extend", help="Add to the map of --map-from what this drive sees.", rich_help_panel=_MAPS
    ),
]
Start = Annotated[
    str | None,
    setting_option(
        "places.start",
        "--start",
        metavar="X,Y,YAW_DEG",
        help="Where the base stands at first, in the map of --map-from or of the areas.",
        show_default="recognised; of areas, by ground truth",
        rich_help_panel=_MAPS,
    ),
]


# All options


Out = Annotated[
    Path,
    typer.Option(
        metavar="DIR", help="Folder for the results; made if need be.", show_default=False, rich_help_panel=OUTPUT
    ),
]
SettingsFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Settings in YAML; options given here win over it.",
        show_default=False,
        rich_help_panel=SETTINGS,
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite results in DIR.", rich_help_panel=OUTPUT)]


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What a user typed; None where an option was left out."""

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
