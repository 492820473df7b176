"""`wheelsight map`: the map that a run leaves for the next drive: told, exported, made anew, merged and pruned."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli import _maps as work
from wheelsight.cli._map_export import Exports

app = typer.Typer(no_args_is_help=True, rich_markup_mode="rich")

MapPath = Annotated[
    Path, typer.Argument(metavar="DIR", help="The map's folder, or that of the run that left it.", show_default=False)
]
NewMap = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", help="Folder of the new map; empty, or not there yet.", show_default=False),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]


@app.callback()
def _about() -> None:
    """The map that a run leaves for the next drive: info, export, rebuild, merge, prune."""


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
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="PLY file of the surfels to write.", show_default=False)
    ] = None,
    occupancy: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="YAML file of the occupancy map; its PGM stands beside it.", show_default=False
        ),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="PNG file: a picture of that.", show_default=False)
    ] = None,
    resolution: Annotated[
        float | None,
        typer.Option(metavar="METRES", min=0.01, max=1, help="Side of the occupancy map's cells.", show_default="0.05"),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="All surfels, and not only those seen often enough to be sure.")
    ] = False,
    force: Force = False,
) -> None:
    """Write the map where its keyframes are by now: surfels as points, and what of the floor is free.

    Where the map has no surfels, as one of a run that was killed, they are fused of its keyframes first. Nav2's
    map_server reads the occupancy map.

    [bold]Examples[/bold]

    wheelsight map export results --out kitchen.ply

    wheelsight map export results/map --all --out all_points.ply --force

    wheelsight map export results --occupancy plan.yaml --picture plan.png --resolution 0.05
    """
    work.export(source, Exports(out, occupancy, picture, resolution, everything), force)


@app.command()
def rebuild(source: MapPath, out: NewMap) -> None:
    """Make a map anew of its keyframes, where they are by now: surfels are fused again, what is outdated is left out.

    The old map stays as it is. Keyframes keep no colour: the new surfels are grey.

    [bold]Examples[/bold]

    wheelsight map rebuild results --out rebuilt

    wheelsight map rebuild results/map --out rebuilt
    """
    work.rebuild(source, out)


@app.command()
def merge(
    first: Annotated[
        Path, typer.Argument(metavar="A", help="A map, or the run that left it; its frame stays.", show_default=False)
    ],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one of the same camera.", show_default=False)],
    out: NewMap,
) -> None:
    """Make one map of two: keyframes of B are recognised in A, and a graph of both is solved.

    Two keyframes of B at least must be recognised, and agree on where B lies in A; else nothing is written.
    Surfels are fused anew of the keyframes, and grey. What nobody knows how it lies to A is left out, and told.

    [bold]Examples[/bold]

    wheelsight map merge monday tuesday --out both

    wheelsight map merge ground_floor/map stairs/map --out house
    """
    work.merge(first, second, out)


@app.command()
def prune(source: MapPath, out: NewMap) -> None:
    """Leave out keyframes whose view another one shows, so that a map that is extended daily does not grow for ever.

    The old map stays as it is. Edges are carried over to keyframes that stay, and so are surfels.

    [bold]Examples[/bold]

    wheelsight map prune results --out pruned

    wheelsight map prune house/map --out house_pruned
    """
    work.prune(source, out)
