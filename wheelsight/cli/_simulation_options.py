"""The options of `wheelsight simulate`, in the order of its help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli._options import OUTPUT
from wheelsight.cli._simulated_robot_options import (
    Base,
    Camera,
    Cover,
    DriveFile,
    Dropout,
    Duration,
    Gyro,
    Ice,
    Laps,
    LeftRadius,
    Lift,
    MotionBlur,
    NoSlip,
    Rate,
    Realism,
    Reverse,
    RightRadius,
    Size,
    Speed,
    StopAndTurn,
    Track,
    Unplug,
)

_WORLD, _PLAN = "The world", "A building of your own"


World = Annotated[
    str | None, typer.Argument(metavar="WORLD", help="What to drive through; see --list.", show_default=False)
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="Folder of the recording; made if need be.", show_default=False, rich_help_panel=OUTPUT
    ),
]
ShowList = Annotated[
    bool, typer.Option("--list", help="Show all worlds and cameras, and exit.", rich_help_panel=_WORLD)
]
Plan = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Floor plan to drive through in place of WORLD: of ROS map_server, or an image with --resolution.",
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
Seed = Annotated[
    int, typer.Option(help="Of everything random; the same seed makes the same bytes.", rich_help_panel=_WORLD)
]
Day = Annotated[
    int,
    typer.Option(
        metavar="N",
        help="Another day in the same building: other light, people, noise; chairs moved.",
        rich_help_panel=_WORLD,
    ),
]
PassersBy = Annotated[
    int, typer.Option("--passers-by", metavar="N", help="How many people walk about.", rich_help_panel=_WORLD)
]
Doors = Annotated[
    int, typer.Option("--doors", metavar="N", help="How many doors open and shut meanwhile.", rich_help_panel=_WORLD)
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite a recording in DIR.", rich_help_panel=OUTPUT)]


@dataclass(frozen=True, slots=True)
class SimulateOptions:
    """What a user typed."""

    world: World = None
    out: Out = None
    force: Force = False
    show_list: ShowList = False
    seed: Seed = 0
    day: Day = 0
    passers_by: PassersBy = 0
    doors: Doors = 0
    laps: Laps = 1
    speed: Speed = 0.8
    duration: Duration = None
    reverse: Reverse = False
    stop_and_turn: StopAndTurn = False
    drive: DriveFile = None
    camera: Camera = "kinect-v1"
    size: Size = "half"
    rate: Rate = None
    realism: Realism = "real"
    motion_blur: MotionBlur = False
    plan: Plan = None
    resolution: Resolution = None
    areas: AreasImage = None
    start: Start = None
    way: WayLength = None
    base: Base = "differential"
    left_radius: LeftRadius = None
    right_radius: RightRadius = None
    track: Track = None
    no_slip: NoSlip = False
    gyro: Gyro = False
    dropout: Dropout = None
    unplug: Unplug = None
    ice: Ice = None
    lift: Lift = None
    cover: Cover = None
