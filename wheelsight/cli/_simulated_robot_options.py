"""Options of `wheelsight simulate`: the robot, its camera, how it drives, and what goes wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

_DRIVE, _CAMERA, _ROBOT, _FAULTS = "The drive", "The camera", "The true robot", "Faults"


def _times(what: str) -> Any:
    """An option of the times of a fault."""
    return typer.Option(metavar="FROM:TO", help=what, rich_help_panel=_FAULTS)


Laps = Annotated[int, typer.Option(help="How often the world's route is driven.", rich_help_panel=_DRIVE)]
Speed = Annotated[float, typer.Option(metavar="M/S", help="Speed on straights, up to 1.2 m/s.", rich_help_panel=_DRIVE)]
Duration = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="Stop after so long.", show_default="the whole route", rich_help_panel=_DRIVE),
]
Reverse = Annotated[
    bool, typer.Option("--reverse", help="Drive the route from its end to its start.", rich_help_panel=_DRIVE)
]
DriveFile = Annotated[
    Path | None,
    typer.Option(
        "--drive",
        metavar="CSV",
        help="Velocities to drive in place of the route.",
        show_default=False,
        rich_help_panel=_DRIVE,
    ),
]
StopAndTurn = Annotated[
    bool,
    typer.Option(
        "--stop-and-turn", help="Stop at each waypoint and turn on the spot, as UMBmark asks.", rich_help_panel=_DRIVE
    ),
]
Camera = Annotated[
    str, typer.Option(metavar="NAME", help="Which camera to carry; see --list.", rich_help_panel=_CAMERA)
]
Size = Annotated[
    str,
    typer.Option(
        metavar="WxH|half|full", help="Size of the images in pixels, or by the camera's own.", rich_help_panel=_CAMERA
    ),
]
Rate = Annotated[
    float | None,
    typer.Option(metavar="HZ", help="Images a second.", show_default="the camera's own", rich_help_panel=_CAMERA),
]
MotionBlur = Annotated[
    bool, typer.Option("--motion-blur", help="Smear colour by the motion during exposure.", rich_help_panel=_CAMERA)
]
Realism = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="`real`: all that real sensors do; `ideal`: nothing but their noise, for closed forms.",
        rich_help_panel=_CAMERA,
    ),
]
Base = Annotated[
    str,
    typer.Option(
        metavar="KIND",
        help="`differential`: a wheelchair; `mecanum`, `omni-3`, `omni-4`, `increments`: a base that drives sideways.",
        rich_help_panel=_ROBOT,
    ),
]
LeftRadius = Annotated[
    float | None,
    typer.Option(metavar="M", help="Of the left wheel.", show_default="0.17", rich_help_panel=_ROBOT),
]
RightRadius = Annotated[
    float | None,
    typer.Option(metavar="M", help="Of the right wheel.", show_default="0.17", rich_help_panel=_ROBOT),
]
Track = Annotated[
    float | None,
    typer.Option(metavar="M", help="Distance between the wheels.", show_default="0.52", rich_help_panel=_ROBOT),
]
NoSlip = Annotated[bool, typer.Option("--no-slip", help="Let wheels never slip.", rich_help_panel=_ROBOT)]
Gyro = Annotated[bool, typer.Option("--gyro", help="Carry a gyroscope; DIR gets gyro.csv.", rich_help_panel=_ROBOT)]
Dropout = Annotated[list[str] | None, _times("Seconds without wheel readings.")]
Unplug = Annotated[list[str] | None, _times("Seconds whose pulses are lost.")]
Ice = Annotated[
    list[str] | None,
    typer.Option(metavar="X,Y,R", help="A round patch of ice, in metres.", rich_help_panel=_FAULTS),
]
Lift = Annotated[list[str] | None, _times("Seconds with the left wheel in the air.")]
Cover = Annotated[list[str] | None, _times("Seconds with something lying on the camera.")]
