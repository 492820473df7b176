"""The options of `wheelsight map`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
