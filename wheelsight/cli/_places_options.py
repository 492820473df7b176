"""The options of `wheelsight places`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Kind(StrEnum):
    """What a frame is told by."""

    HISTOGRAMS = "histograms"
    LAYOUT = "layout"


Recordings = Annotated[
    list[Path], typer.Argument(metavar="RECORDING...", help="Folders of recordings.", show_default=False)
]
Model = Annotated[Path, typer.Argument(metavar="MODEL", help="What places train wrote.", show_default=False)]
LabelFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--labels",
        metavar="FILE",
        help="CSV of labels, from_s,to_s,area or stamp_s,area; one for each recording, in their order.",
        show_default="by areas and trajectory",
    ),
]
Labels = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="CSV of labels, from_s,to_s,area or stamp_s,area.", show_default="by areas and trajectory"
    ),
]
Areas = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="areas.yaml with polygons.", show_default="that in the recording's folder"),
]
Trajectory = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Where the robot went, TUM text.", show_default="the recording's ground truth"),
]
Description = Annotated[
    Kind, typer.Option(help="What a frame is told by: the paper's histograms, or layout, with geometry.")
]
Trees = Annotated[int, typer.Option(metavar="T", min=1, max=1000, help="How many trees; the paper tries 1 to 6.")]
Depth = Annotated[int, typer.Option(metavar="D", min=1, max=64, help="Splits from root to leaf, at most.")]
Seed = Annotated[
    int, typer.Option(min=0, max=2**32 - 1, help="Of everything random; the same seed grows the same forest.")
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]

Page = Annotated[Path, typer.Option(metavar="PAGE", help="HTML page to write.", show_default=False)]
PageIfWanted = Annotated[
    Path | None, typer.Option(metavar="PAGE", help="HTML page with figures to write.", show_default="none")
]
ModelToWrite = Annotated[
    Path, typer.Option(metavar="MODEL", help="Model to write, such as floor.places.", show_default=False)
]
Table = Annotated[Path, typer.Option(metavar="FILE", help="CSV to write.", show_default=False)]
Every = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", min=0.01, help="Time between thumbnails.", show_default="1, for up to 600"),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
