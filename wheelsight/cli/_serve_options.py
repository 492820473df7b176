"""The options of `wheelsight serve`, in the order of its help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli._drive_options import KnownStart, MapPath, Rerun, SettingsOptions
from wheelsight.cli._drive_robot_options import Rate, RobotOptions
from wheelsight.cli._options import OUTPUT

_PAGE = "The page"

MapsFolder = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="DIR",
        help="Folder for maps that are made, each in one of its own; those that are there can be driven in.",
        show_default="none",
        rich_help_panel=OUTPUT,
    ),
]
Host = Annotated[
    str,
    typer.Option(
        metavar="ADDRESS",
        help="Where the page is served: this computer alone, or, behind a token, any that reaches the address.",
        rich_help_panel=_PAGE,
    ),
]
Port = Annotated[int, typer.Option(min=0, max=65535, help="0: any that is free.", rich_help_panel=_PAGE)]
Token = Annotated[
    str | None,
    typer.Option(
        metavar="TEXT",
        help="What each request must hold; 16 letters and digits at least.",
        show_default="made anew, and none on this computer alone",
        rich_help_panel=_PAGE,
    ),
]


@dataclass(frozen=True)
class PageOptions:
    """What a user typed of maps and of the page."""

    map_: MapPath = None
    known_start: KnownStart = None
    out: MapsFolder = None
    rerun: Rerun = None
    host: Host = "127.0.0.1"
    port: Port = 8765
    token: Token = None


@dataclass(frozen=True)
class ServeOptions(RobotOptions, SettingsOptions, PageOptions):
    """What a user typed; fields of the last base come first."""

    rate: Rate = 5.0
