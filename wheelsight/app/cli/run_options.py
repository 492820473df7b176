"""The options of `wheelsight run`, in the order of its help, and `wheelsight config`, which prints the resulting
settings.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import typer

from wheelsight.app.cli.options import (
    INPUT,
    OUTPUT,
    SETTINGS,
    CalibrationFile,
    DepthFactor,
    Domain,
    Foxglove,
    Interface,
    LinkToken,
    MaxGap,
    Namespace,
    Profile,
    RateHz,
    Rerun,
    Ros2,
    Topics,
    option,
    option_field,
    settings_from,
)

_REAL_TIME, _LIVE = "In real time", "Live, in place of a recording"
_ODOMETRY, _AREAS, _MAPS = "Odometry", "Areas that rectify wheels", "Loops and maps"

SettingsFile = Annotated[
    Path | None, option("Settings in YAML; options given here win over it.", "FILE", False, SETTINGS)
]


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of `run`; None where one was left out."""

    out: Annotated[Path, option("Folder for the results; made if need be.", "DIR", False, OUTPUT)]
    recording: Annotated[
        Path | None,
        typer.Argument(
            metavar="RECORDING",
            help="Folder of the recording, or a ROS bag; [bold]sample[/bold] is one that comes along; none with "
            "--live.",
            show_default=False,
        ),
    ] = None
    camera: str | None = option_field(
        "Calibration to use: the name of a shipped one, such as freiburg1, or a calibration.yaml. With --live: "
        "the camera, as for wheelsight record.",
        "NAME|FILE",
        "what the recording itself says",
        INPUT,
    )
    calibration: CalibrationFile = None
    depth_factor: DepthFactor = None
    max_gap: MaxGap = None
    rate_hz: RateHz = None
    topic: Topics = None
    force: bool = option_field("Overwrite results in DIR.", default=False, panel=OUTPUT)
    rerun: Rerun = None
    trace: Path | None = option_field(
        "Write what each thread does, for ui.perfetto.dev or chrome://tracing.", "FILE.json", "not written", OUTPUT
    )
    odometry: str | None = option_field(
        "How motion is estimated: features, dense, wheels, or several; wheels and a camera are joined too.",
        "NAME[,NAME]",
        "all sensors that the recording has, joined",
        _ODOMETRY,
        setting="odometry",
    )
    fusion: str | None = option_field(
        "How wheels and camera are joined: default, ligocki (eq. 2), or none.",
        "NAME",
        "default, where both are named",
        _ODOMETRY,
        setting="fusion.filter",
    )
    reference: str | None = option_field(
        "What a frame is aligned with: previous or keyframes.",
        "NAME",
        "keyframes",
        _ODOMETRY,
        setting="features.reference",
    )
    integration: str | None = option_field(
        "How wheels are integrated: arc, midpoint or euler.", "NAME", "arc", _ODOMETRY, setting="wheels.integration"
    )
    gyro: bool | None = option_field(
        "Join a gyroscope with the wheels.",
        shown="--gyro",
        panel=_ODOMETRY,
        flag="--gyro/--no-gyro",
        setting="wheels.gyro",
    )
    seed: int | None = option_field("Seed of all random choices.", shown="0", panel=_ODOMETRY, setting="features.seed")
    map_: str | None = option_field(
        "What dense odometry builds and tracks against: surfels.", "NAME", "keyframes alone", _MAPS, setting="map"
    )
    loops: str | None = option_field(
        "Correct the way by places that were recognised: keyframes, those that the camera sees again; matches, "
        "the recording's own and its loops.csv; or a file like that.",
        "SOURCE",
        "none",
        _MAPS,
        setting="loops.source",
    )
    map_from: Path | None = option_field(
        "Find oneself in a map of before: that of an earlier run with --map surfels.",
        "DIR",
        False,
        _MAPS,
        setting="known_map.path",
    )
    extend: bool = option_field(
        "Add to the map of --map-from what this drive sees.", default=False, panel=_MAPS, setting="known_map.extend"
    )
    start: str | None = option_field(
        "Where the base stands at first, in the map of --map-from or of the areas.",
        "X,Y,YAW_DEG",
        "recognised; of areas, by ground truth",
        _MAPS,
        setting="places.start",
    )
    config: SettingsFile = None
    profile: Profile = None
    places: str | None = option_field(
        "Rectify wheels, joined or alone, by the areas that frames show.",
        "MODEL",
        False,
        _AREAS,
        setting="places.model",
    )
    rectify: str | None = option_field(
        "probabilistic: a filter with covariance; paper: eq. 5.",
        "WAY",
        "probabilistic",
        _AREAS,
        setting="places.rectify",
    )
    areas: str | None = option_field(
        "areas.yaml of the model.", "FILE", "that in the recording's folder", _AREAS, setting="places.areas"
    )
    odometry_term: str | None = option_field(
        "Odometry in eq. 5: increment or absolute.", "NAME", "increment", _AREAS, setting="places.odometry_term"
    )
    weights: str | None = option_field(
        "alpha, beta, gamma of eq. 5.", "A,B,G", "0,0.9,0.1", _AREAS, setting="places.weights"
    )
    realtime: bool = option_field(
        "Play the recording in real time; frames that come too fast are dropped.", default=False, panel=_REAL_TIME
    )
    wheels_from: str | None = option_field(
        "Wheel readings in real time from elsewhere: a serial port, the pipe of wheels serve, or a wheels.csv.",
        "FROM",
        "the recording's own",
        _REAL_TIME,
    )
    baud: int | None = option_field("Baud rate of the port.", "RATE", "115200", _REAL_TIME, min=1)
    live: bool = option_field(
        "Follow what --camera and --wheels show just now, until Ctrl-C or --seconds, in place of a recording.",
        default=False,
        panel=_LIVE,
    )
    wheels: str | None = option_field("With --live: serial port of the wheel controller.", "PORT", "none", _LIVE)
    seconds: float | None = option_field("With --live: stop so long after ready.", "SECONDS", "at Ctrl-C", _LIVE, min=0)
    record: Path | None = option_field("With --live: record what is followed, too.", "DIR", "not recorded", _LIVE)
    foxglove: Foxglove = None
    link_token: LinkToken = None
    ros2: Ros2 = None
    domain: Domain = 0
    namespace: Namespace = ""
    interface: Interface = None

    def settings(self) -> dict[str, object]:
        """Values of the options that set settings, by their dotted names, as `settings_from` takes them."""
        given = {one.metadata.get("setting"): getattr(self, one.name) for one in fields(self)}
        given |= {f"recording.{name}": getattr(self, name) for name in ("calibration", "depth_factor", "rate_hz")}
        given |= {"recording.max_gap_s": self.max_gap, "recording.topics": self.topic, "profile": self.profile}
        given["recording.camera"] = None if self.live else self.camera  # of a live run it names a device
        given["known_map.path"] = None if self.map_from is None else str(self.map_from)
        given["known_map.extend"] = self.extend or None
        if self.map_from is not None:
            given["known_map.start"] = given.pop("places.start")
        return {name: value for name, value in given.items() if name}


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
