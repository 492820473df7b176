"""`wheelsight map`: the map that a run leaves for the next drive; what it holds, its points, and it made anew."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli import _maps as work

app = typer.Typer(no_args_is_help=True, rich_markup_mode="rich")

MapPath = Annotated[
    Path, typer.Argument(metavar="DIR", help="The map's folder, or that of the run that left it.", show_default=False)
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]


@app.callback()
def _about() -> None:
    """The map that a run leaves for the next drive: info, export, rebuild."""


@app.command()
def info(
    source: MapPath, as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False
) -> None:
    """Tell what is in a map: keyframes, edges, loops, size, camera, and what is wrong with it, if anything.

    [bold]Examples[/bold]

    wheelsight map info results

    wheelsight map info results/map --json
    """
    work.info(source, as_json)


@app.command()
def export(
    source: MapPath,
    out: Annotated[Path, typer.Option(metavar="FILE", help="PLY file to write.", show_default=False)],
    everything: Annotated[
        bool, typer.Option("--all", help="All surfels, and not only those seen often enough to be sure.")
    ] = False,
    force: Force = False,
) -> None:
    """Write the map's surfels as points, where its keyframes are by now: colour, normal, radius.

    Where the map has no surfels, as one of a run that was killed, they are fused of its keyframes first.

    [bold]Examples[/bold]

    wheelsight map export results --out kitchen.ply

    wheelsight map export results/map --all --out all_points.ply --force
    """
    work.export(source, out, everything, force)


@app.command()
def rebuild(
    source: MapPath,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of the new map; empty, or not there yet.", show_default=False)
    ],
) -> None:
    """Make a map anew of its keyframes, where they are by now: surfels are fused again, what is outdated is left out.

    The old map stays as it is. Keyframes keep no colour: the new surfels are grey.

    [bold]Examples[/bold]

    wheelsight map rebuild results --out rebuilt

    wheelsight map rebuild results/map --out rebuilt
    """
    work.rebuild(source, out)
