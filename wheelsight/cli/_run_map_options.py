"""Options of `wheelsight run`: maps and loops."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_MAPS = "Loops and maps"

Map = Annotated[
    str | None,
    typer.Option(
        "--map",
        metavar="NAME",
        help="What dense odometry builds and tracks against: surfels.",
        show_default="keyframes alone",
        rich_help_panel=_MAPS,
    ),
]
Loops = Annotated[
    str | None,
    typer.Option(
        metavar="SOURCE",
        help="Correct the way by places that were recognised: keyframes, those that the camera sees again; matches, "
        "the recording's own and its loops.csv; or a file like that.",
        show_default="none",
        rich_help_panel=_MAPS,
    ),
]
MapFrom = Annotated[
    Path | None,
    typer.Option(
        "--map-from",
        metavar="DIR",
        help="Find oneself in a map of before: that of an earlier run with --map surfels.",
        show_default=False,
        rich_help_panel=_MAPS,
    ),
]
Extend = Annotated[
    bool, typer.Option("--extend", help="Add to the map of --map-from what this drive sees.", rich_help_panel=_MAPS)
]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,YAW_DEG",
        help="Where the base stands at first, in the map of --map-from or of the areas.",
        show_default="recognised; of areas, by ground truth",
        rich_help_panel=_MAPS,
    ),
]
