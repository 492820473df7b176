"""The options of `wheelsight drive`, in the order of its help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli._drive_robot_options import RobotOptions
from wheelsight.cli._options import OUTPUT, SETTINGS, Profile

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
