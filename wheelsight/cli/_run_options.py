"""The options of `wheelsight run` alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Out = Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results; made if need be.", show_default=False)]
Odometry = Annotated[
    str | None,
    typer.Option(
        metavar="NAME[,NAME]",
        help="How motion is estimated: features, dense, wheels, or several; wheels and a camera are joined too.",
        show_default="all sensors that the recording has, joined",
    ),
]
Map = Annotated[
    str | None,
    typer.Option(
        "--map",
        metavar="NAME",
        help="What dense odometry builds and tracks against: surfels.",
        show_default="keyframes alone",
    ),
]
Loops = Annotated[
    str | None,
    typer.Option(
        metavar="keyframes|matches|FILE",
        help="Correct the way by places that were recognised: those that the camera sees again, the recording's own "
        "matches and loops.csv, or a file like that.",
        show_default="none",
    ),
]
MapFrom = Annotated[
    Path | None,
    typer.Option(
        "--map-from",
        metavar="DIR",
        help="Find oneself in a map of before: that of an earlier run with --map surfels.",
        show_default=False,
    ),
]
Extend = Annotated[bool, typer.Option("--extend", help="Add to the map of --map-from what this drive sees.")]
Fusion = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="How wheels and camera are joined: default, ligocki (eq. 2), or none.",
        show_default="default, where both are named",
    ),
]
SettingsFile = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Settings in YAML; options given here win over it.", show_default=False),
]
Reference = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="What a frame is aligned with: previous or keyframes.", show_default="keyframes"),
]
Integration = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="How wheels are integrated: arc, midpoint or euler.", show_default="arc"),
]
Gyro = Annotated[
    bool | None, typer.Option("--gyro/--no-gyro", help="Join a gyroscope with the wheels.", show_default="--gyro")
]
Model = Annotated[
    str | None,
    typer.Option(
        "--places",
        metavar="MODEL",
        help="Rectify wheels, joined or alone, by the areas that frames show.",
        show_default=False,
    ),
]
Rectify = Annotated[
    str | None,
    typer.Option(
        metavar="WAY", help="probabilistic: a filter with covariance; paper: eq. 5.", show_default="probabilistic"
    ),
]
Areas = Annotated[
    str | None,
    typer.Option(metavar="FILE", help="areas.yaml of the model.", show_default="that in the recording's folder"),
]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,YAW_DEG",
        help="Where the base stands at first, in the map of --map-from or of the areas.",
        show_default="recognised; of areas, by ground truth",
    ),
]
OdometryTerm = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Odometry in eq. 5: increment or absolute.", show_default="increment"),
]
Weights = Annotated[
    str | None, typer.Option(metavar="A,B,G", help="alpha, beta, gamma of eq. 5.", show_default="0,0.9,0.1")
]
RealTime = Annotated[
    bool, typer.Option("--realtime", help="Play the recording in real time; frames that come too fast are dropped.")
]
WheelsFrom = Annotated[
    str | None,
    typer.Option(
        metavar="PORT|PIPE|FILE",
        help="Wheel readings in real time from elsewhere: a serial port, the pipe of wheels serve, or a wheels.csv.",
        show_default="the recording's own",
    ),
]
Baud = Annotated[int | None, typer.Option(min=1, metavar="RATE", help="Baud rate of the port.", show_default="115200")]
Live = Annotated[
    bool,
    typer.Option(
        "--live",
        help="Follow what --camera and --wheels show just now, until Ctrl-C or --seconds, in place of a recording.",
    ),
]
Wheels = Annotated[
    str | None,
    typer.Option(metavar="PORT", help="With --live: serial port of the wheel controller.", show_default="none"),
]
Seconds = Annotated[
    float | None,
    typer.Option(min=0, metavar="SECONDS", help="With --live: stop so long after ready.", show_default="at Ctrl-C"),
]
Record = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="With --live: record what is followed, too.", show_default="not recorded"),
]
LiveRecording = Annotated[
    Path | None,
    typer.Argument(metavar="[RECORDING]", help="Folder of the recording; none with --live.", show_default=False),
]
LiveCamera = Annotated[
    str | None,
    typer.Option(
        "--camera",
        metavar="NAME|FILE",
        help="Calibration to use: the name of a shipped one, such as freiburg1, or a calibration.yaml. With --live: "
        "the camera, as for wheelsight record.",
        show_default="what the recording itself says",
    ),
]
Seed = Annotated[int | None, typer.Option(help="Seed of all random choices.", show_default="0")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite results in DIR.")]
