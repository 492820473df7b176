"""The options of `wheelsight map`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_ZONES = "What is there"

MapPath = Annotated[
    Path, typer.Argument(metavar="DIR", help="The map's folder, or that of the run that left it.", show_default=False)
]
NewMap = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", help="Folder of the new map; empty, or not there yet.", show_default=False),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]
Called = Annotated[str | None, typer.Argument(metavar="NAME", help="What the place is called.", show_default=False)]
At = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y[,YAW_DEG]",
        help="Where it is in the map: metres, and the heading of a robot there, in degrees from x to y.",
        show_default=False,
    ),
]
Corners = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="X,Y...",
        help="Corners in the order of the outline, metres in the map; two are opposite corners of a rectangle.",
        show_default=False,
    ),
]
KeepOut = Annotated[bool, typer.Option("--keep-out", help="Nobody drives there.", rich_help_panel=_ZONES)]
Speed = Annotated[
    float | None,
    typer.Option(
        metavar="M_S",
        help="Nobody drives faster there, in metres a second.",
        show_default=False,
        rich_help_panel=_ZONES,
    ),
]
Wipe = Annotated[
    bool, typer.Option("--wipe", help="Obstacles that the map has there are gone: free.", rich_help_panel=_ZONES)
]
AreaName = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="It is called so, for wheelsight drive --to NAME.",
        show_default=False,
        rich_help_panel=_ZONES,
    ),
]
AreasFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="All areas of an areas.yaml, whose corners must be in this map's frame; that of a simulated world is in "
        "the building's.",
        show_default=False,
        rich_help_panel=_ZONES,
    ),
]
Forget = Annotated[
    int | None,
    typer.Option(
        metavar="NUMBER", help="Forget the one of this number in the list.", show_default=False, rich_help_panel=_ZONES
    ),
]
Points = Annotated[
    Path | None, typer.Option(metavar="FILE", help="PLY file of the surfels to write.", show_default=False)
]
Occupancy = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="YAML file of the occupancy map; its PGM stands beside it.", show_default=False),
]
Picture = Annotated[Path | None, typer.Option(metavar="FILE", help="PNG file: a picture of that.", show_default=False)]
Resolution = Annotated[
    float | None,
    typer.Option(metavar="METRES", min=0.01, max=1, help="Side of the occupancy map's cells.", show_default="0.05"),
]
