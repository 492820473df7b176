"""The options of `wheelsight drive`, in the order of its help; `wheelsight serve` shares those of the robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from wheelsight.app.cli.options import OUTPUT, SETTINGS, Profile

# The robot


_SIMULATED, _REAL, _EITHER = "A simulated robot", "A real robot", "Either robot"

Sim = Annotated[
    str | None,
    typer.Option(
        metavar="WORLD|PLAN",
        help="Drive in the simulator: a world of wheelsight simulate --list, or a floor plan's file.",
        show_default=False,
        rich_help_panel=_SIMULATED,
    ),
]
Resolution = Annotated[
    float | None,
    typer.Option(
        metavar="M",
        help="Metres a pixel of a plan that is a bare image.",
        show_default=False,
        rich_help_panel=_SIMULATED,
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,YAW_DEG",
        help="Where the robot truly stands at first, in the world.",
        show_default="the world's own",
        rich_help_panel=_SIMULATED,
    ),
]
Seed = Annotated[int, typer.Option(help="Of everything random.", rich_help_panel=_SIMULATED)]
Day = Annotated[
    int,
    typer.Option(metavar="N", help="Another day: other light and people, chairs moved.", rich_help_panel=_SIMULATED),
]
People = Annotated[
    int, typer.Option("--people", metavar="N", help="How many people walk about.", rich_help_panel=_SIMULATED)
]
Realism = Annotated[
    str, typer.Option(metavar="NAME", help="real or ideal, as for simulate.", rich_help_panel=_SIMULATED)
]
CameraName = Annotated[
    str | None,
    typer.Option(
        "--camera",
        metavar="NAME",
        help="Of a simulated robot as for simulate; of a real one the live camera, as for record.",
        show_default="kinect-v1; any that is plugged in",
        rich_help_panel=_EITHER,
    ),
]
Size = Annotated[str, typer.Option(metavar="WxH|half|full", help="Size of the images.", rich_help_panel=_SIMULATED)]
Rate = Annotated[float, typer.Option(metavar="HZ", help="Images a second.", rich_help_panel=_SIMULATED)]
RobotPort = Annotated[
    str | None,
    typer.Option(
        "--robot",
        metavar="PORT",
        help="Drive the robot whose wheel controller is at a serial port, by a live camera.",
        show_default=False,
        rich_help_panel=_REAL,
    ),
]
CalibrationFile = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="FILE",
        help="calibration.yaml of the robot: wheels, camera, and where that sits.",
        show_default=False,
        rich_help_panel=_REAL,
    ),
]
Baud = Annotated[int, typer.Option(min=1, metavar="RATE", help="Baud rate of the port.", rich_help_panel=_REAL)]
Yes = Annotated[
    bool,
    typer.Option(
        "--yes",
        help="Do not ask whether the floor around the robot is free and somebody is at the stop button: both are so.",
        rich_help_panel=_REAL,
    ),
]


@dataclass(frozen=True)
class RobotOptions:
    """What a user typed of the robot; a base of commands' options, after which others come in the help."""

    sim: Sim = None
    resolution: Resolution = None
    start: Start = None
    seed: Seed = 0
    day: Day = 0
    people: People = 0
    realism: Realism = "real"
    camera: CameraName = None
    size: Size = "half"
    rate: Rate = 10.0
    robot: RobotPort = None
    calibration: CalibrationFile = None
    baud: Baud = 115200
    yes: Yes = False

    @property
    def is_simulated(self) -> bool:
        """Whether no real robot is named."""
        return self.robot is None


# The drive


_TASK = "Where to"

MapPath = Annotated[
    Path | None,
    typer.Option(
        "--map", metavar="DIR", help="The map, or the run that left it.", show_default=False, rich_help_panel=_TASK
    ),
]
To = Annotated[
    list[str] | None,
    typer.Option(
        metavar="GOAL",
        help="A name of the map (wheelsight map name), an area of it (wheelsight map zone), X,Y,YAW_DEG in it, or X,Y "
        "for any heading. May be given again: one after another.",
        show_default=False,
        rich_help_panel=_TASK,
    ),
]
Follow = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Along a way that was driven before: the trajectory.txt of a run or a drive in this map, or its folder. "
        "In place of --to.",
        show_default=False,
        rich_help_panel=_TASK,
    ),
]
Back = Annotated[
    bool, typer.Option("--back", help="Return to where the drive began, at the end.", rich_help_panel=_TASK)
]
Explore = Annotated[
    bool,
    typer.Option(
        "--explore",
        help="Look at all floor that can be reached, and leave a map of it in the folder of --out.",
        rich_help_panel=_TASK,
    ),
]
KnownStart = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,YAW_DEG",
        help="Where the robot stands at first, in the map; as --start of wheelsight run.",
        show_default="the place is recognised",
        rich_help_panel=_TASK,
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder for drive.json, trajectory.txt, drive.png and drive.html.",
        show_default="none",
        rich_help_panel=OUTPUT,
    ),
]
SettingsFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Settings in YAML.", show_default=False, rich_help_panel=SETTINGS),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="A setting by its dotted name, such as navigation.limits.forward_m_s=0.5; wins over --config. May be "
        "given again.",
        show_default=False,
        rich_help_panel=SETTINGS,
    ),
]
Rerun = Annotated[
    str | None,
    typer.Option(
        "--rerun",
        metavar="FILE.rrd|spawn",
        help="Show the drive in Rerun as it goes: written to a file, or in a viewer that is started here.",
        show_default="not shown",
        rich_help_panel=OUTPUT,
    ),
]
Force = Annotated[
    bool, typer.Option("--force", help="Overwrite results in the folder of --out.", rich_help_panel=OUTPUT)
]


@dataclass(frozen=True)
class SettingsOptions:
    """What a user typed of settings."""

    config: SettingsFile = None
    profile: Profile = None
    set_: Set = None


@dataclass(frozen=True)
class TaskOptions:
    """What a user typed of the task, and of what is left of it."""

    map_: MapPath = None
    to: To = None
    follow: Follow = None
    back: Back = False
    explore: Explore = False
    known_start: KnownStart = None
    out: Out = None
    rerun: Rerun = None
    force: Force = False


@dataclass(frozen=True)
class DriveOptions(RobotOptions, SettingsOptions, TaskOptions):
    """What a user typed; fields of the last base come first."""
