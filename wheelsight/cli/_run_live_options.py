"""Options of `wheelsight run`: what is followed, also as it is just now."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli._options import INPUT

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
