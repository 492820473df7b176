"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from wheelsight.config import Config
    from wheelsight.recordings import Recording

# Panels of the help that several commands have.
INPUT, OUTPUT, SETTINGS = "Input", "Output", "Settings"

RecordingPath = Annotated[
    Path,
    typer.Argument(
        metavar="RECORDING",
        help="Folder of the recording, or a ROS bag; [bold]sample[/bold] is one that comes along.",
        show_default=False,
    ),
]
Camera = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE",
        help="Calibration to use: the name of a shipped one, such as freiburg1, or a calibration.yaml.",
        show_default="what the recording itself says",
        rich_help_panel=INPUT,
    ),
]
CalibrationFile = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FILE",
        help="calibration.yaml whose parts (cameras, mount, wheels, gyro) stand in place of the recording's; what it "
        "leaves out stays. May be given again: each is laid over those before.",
        show_default=False,
        rich_help_panel=INPUT,
    ),
]
DepthFactor = Annotated[
    float | None,
    typer.Option(
        help="Depth units a metre in the depth images.", show_default="as its format says", rich_help_panel=INPUT
    ),
]
MaxGap = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="Largest distance in time of a colour and a depth image.",
        show_default="0.02",
        rich_help_panel=INPUT,
    ),
]
RateHz = Annotated[
    float | None,
    typer.Option(
        "--rate-hz",
        metavar="HZ",
        help="How many a second the images' stamps count: 30 for numbers of a 30 Hz camera, 1000 for milliseconds.",
        show_default="stamps are seconds",
        rich_help_panel=INPUT,
    ),
]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="ROLE=TOPIC",
        help="Of a bag: which topic is color, depth, color_info, depth_info, wheels, gyro or truth; none leaves one "
        "out. May be given again. Joints, fields, places or frames of wheels: wheels=/joints:left,right, "
        "wheels=/ticks:2,3, wheels=/tf:odom,base_link; a topic each: wheels=/lwheel,/rwheel.",
        show_default="by type, frame and name",
        rich_help_panel=INPUT,
    ),
]
Profile = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Settings for one kind of computer: pi, for a small one. --config and other options win over it; "
        "wheelsight config --profile pi shows them.",
        show_default="none",
        rich_help_panel=SETTINGS,
    ),
]


# What --start says beside --map-from.
STARTS_IN_KNOWN_MAP = "--start in the known map"
_SETTINGS = {
    "--profile": "profile",
    "--odometry": "odometry",
    "--fusion": "fusion.filter",
    "--map": "map",
    "--loops": "loops.source",
    "--map-from": "known_map.path",
    "--extend": "known_map.extend",
    STARTS_IN_KNOWN_MAP: "known_map.start",
    "--reference": "features.reference",
    "--integration": "wheels.integration",
    "--gyro": "wheels.gyro",
    "--places": "places.model",
    "--areas": "places.areas",
    "--rectify": "places.rectify",
    "--start": "places.start",
    "--odometry-term": "places.odometry_term",
    "--weights": "places.weights",
    "--seed": "features.seed",
    "--camera": "recording.camera",
    "--calibration": "recording.calibration",
    "--depth-factor": "recording.depth_factor",
    "--max-gap": "recording.max_gap_s",
    "--rate-hz": "recording.rate_hz",
    "--topic": "recording.topics",
}


def settings_from(options: Mapping[str, object], file: Path | None = None) -> Config:
    """The configuration of a file, and over it the options that were given (are not None). Raises ConfigError."""
    from wheelsight.config import load_config

    overrides = {_SETTINGS[option]: value for option, value in options.items() if value not in (None, [])}
    return load_config(file, overrides, called={name: option for option, name in _SETTINGS.items()})


def open_source(folder: Path, settings: Config) -> Recording:
    """The recording in a folder, or the sample, read as the settings say. Raises InputError."""
    from wheelsight.cli._console import print_note
    from wheelsight.recordings import SAMPLE_NAME, open_recording

    if folder == Path(SAMPLE_NAME) and folder.exists():
        print_note(f"{folder} is the one in the current folder, not the recording that comes with wheelsight")

    return open_recording(folder, settings.recording.open_options())


Rerun = Annotated[
    str | None,
    typer.Option(
        "--rerun",
        metavar="FILE.rrd|spawn",
        help="Show the run in Rerun as it goes: written to a file, or in a viewer that is started here.",
        show_default="not shown",
        rich_help_panel=OUTPUT,
    ),
]
