"""The options of `wheelsight drive`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli._options import OUTPUT, SETTINGS

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
        help="A name of the map (wheelsight map name), X,Y,YAW_DEG in it, or X,Y for any heading. May be given again: "
        "one after another.",
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
