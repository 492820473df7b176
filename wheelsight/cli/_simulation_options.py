"""The options of `wheelsight simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

_ROBOT, _FAULTS, _PLAN = "The true robot", "Faults", "A building of your own"


def _times(what: str) -> Any:
    """An option of the times of a fault."""
    return typer.Option(metavar="FROM:TO", help=what, rich_help_panel=_FAULTS)


World = Annotated[
    str | None, typer.Argument(metavar="WORLD", help="What to drive through; see --list.", show_default=False)
]
Out = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Folder of the recording; made if need be.", show_default=False)
]
ShowList = Annotated[bool, typer.Option("--list", help="Show all worlds and cameras, and exit.")]
Plan = Annotated[
    Path | None,
    typer.Option(
        metavar="MAP.YAML|IMAGE",
        help="Floor plan to drive through in place of WORLD: ROS map_server's, or a bare image with --resolution.",
        show_default=False,
        rich_help_panel=_PLAN,
    ),
]
Resolution = Annotated[
    float | None,
    typer.Option(metavar="M", help="Metres a pixel of a bare image.", show_default=False, rich_help_panel=_PLAN),
]
AreasImage = Annotated[
    Path | None,
    typer.Option(
        "--areas",
        metavar="IMAGE",
        help="The plan's rooms, one colour each or parted by lines; they become areas.yaml.",
        show_default=False,
        rich_help_panel=_PLAN,
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,YAW_DEG",
        help="Where in the plan the base begins.",
        show_default="a roomy place, by --seed",
        rich_help_panel=_PLAN,
    ),
]
WayLength = Annotated[
    float | None,
    typer.Option(
        "--way",
        metavar="METRES",
        help="How long the tour is, about.",
        show_default="up to 100, or as --duration takes",
        rich_help_panel=_PLAN,
    ),
]
Laps = Annotated[int, typer.Option(help="How often the world's route is driven.")]
Camera = Annotated[str, typer.Option(metavar="NAME", help="Which camera to carry; see --list.")]
Size = Annotated[
    str, typer.Option(metavar="WxH|half|full", help="Size of the images in pixels, or by the camera's own.")
]
Rate = Annotated[float | None, typer.Option(metavar="HZ", help="Images a second.", show_default="the camera's own")]
Seed = Annotated[int, typer.Option(help="Of everything random; the same seed makes the same bytes.")]
Day = Annotated[
    int, typer.Option(metavar="N", help="Another day in the same building: other light, people, noise; chairs moved.")
]
Speed = Annotated[float, typer.Option(metavar="M/S", help="Speed on straights, up to 1.2 m/s.")]
Duration = Annotated[
    float | None, typer.Option(metavar="SECONDS", help="Stop after so long.", show_default="the whole route")
]
Reverse = Annotated[bool, typer.Option("--reverse", help="Drive the route from its end to its start.")]
DriveFile = Annotated[
    Path | None,
    typer.Option("--drive", metavar="CSV", help="Velocities to drive in place of the route.", show_default=False),
]
StopAndTurn = Annotated[
    bool, typer.Option("--stop-and-turn", help="Stop at each waypoint and turn on the spot, as UMBmark asks.")
]
PassersBy = Annotated[int, typer.Option("--passers-by", metavar="N", help="How many people walk about.")]
Doors = Annotated[int, typer.Option("--doors", metavar="N", help="How many doors open and shut meanwhile.")]
MotionBlur = Annotated[bool, typer.Option("--motion-blur", help="Smear colour by the motion during exposure.")]
Realism = Annotated[
    str,
    typer.Option(
        metavar="NAME", help="`real`: all that real sensors do; `ideal`: nothing but their noise, for closed forms."
    ),
]
Gyro = Annotated[bool, typer.Option("--gyro", help="Carry a gyroscope; DIR gets gyro.csv.")]
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
Dropout = Annotated[list[str] | None, _times("Seconds without wheel readings.")]
Unplug = Annotated[list[str] | None, _times("Seconds whose pulses are lost.")]
Ice = Annotated[
    list[str] | None,
    typer.Option(metavar="X,Y,R", help="A round patch of ice, in metres.", rich_help_panel=_FAULTS),
]
Lift = Annotated[list[str] | None, _times("Seconds with the left wheel in the air.")]
Cover = Annotated[list[str] | None, _times("Seconds with something lying on the camera.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite a recording in DIR.")]
