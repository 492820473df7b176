"""`wheelsight map`: the map that a run leaves for the next drive: told, named, exported, rebuilt, merged, pruned."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli import _map_options as options
from wheelsight.cli import _maps as work
from wheelsight.cli._help import Command, Group
from wheelsight.cli._map_export import Exports
from wheelsight.cli.map_zones import zone

app = typer.Typer(cls=Group, no_args_is_help=True, rich_markup_mode="rich")


@app.callback()
def _about() -> None:
    """The map that a run leaves for the next drive: info, name, zone, export, rebuild, merge, prune."""


@app.command(cls=Command)
def info(
    source: options.MapPath,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Tell what is in a map: keyframes, edges, loops, size, camera, and what is wrong with it, if anything.

    [bold]Examples[/bold]

    wheelsight map info results

    wheelsight map info results/map --json
    """
    work.info(source, as_json)


@app.command(cls=Command)
def name(
    source: options.MapPath,
    called: options.Called = None,
    at: options.At = None,
    show_list: Annotated[bool, typer.Option("--list", help="Print all names and where they are by now.")] = False,
    remove: Annotated[bool, typer.Option("--remove", help="Forget the name.")] = False,
) -> None:
    """Give a place of a map a name, by which wheelsight drive finds it.

    Names are in the map's places.json. Each hangs on the nearest keyframe and moves with it, as where a loop closes;
    rebuild, merge and prune carry them over.

    [bold]Examples[/bold]

    wheelsight map name home kitchen --at 3.2,1.5,90

    wheelsight map name home --list

    wheelsight map name home kitchen --remove
    """
    work.name(source, called, at, show_list=show_list, remove=remove)


# Else -1,2 would be an option; what is none is refused by the work.
app.command(cls=Command, context_settings={"ignore_unknown_options": True})(zone)


@app.command(cls=Command)
def export(
    source: options.MapPath,
    out: options.Points = None,
    occupancy: options.Occupancy = None,
    picture: options.Picture = None,
    resolution: options.Resolution = None,
    everything: Annotated[
        bool, typer.Option("--all", help="All surfels, and not only those seen often enough to be sure.")
    ] = False,
    force: options.Force = False,
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


@app.command(cls=Command)
def rebuild(source: options.MapPath, out: options.NewMap) -> None:
    """Make a map anew of its keyframes, where they are by now: surfels are fused again, what is outdated is left out.

    The old map stays as it is. Keyframes keep no colour: the new surfels are grey.

    [bold]Examples[/bold]

    wheelsight map rebuild results --out rebuilt

    wheelsight map rebuild results/map --out rebuilt
    """
    work.rebuild(source, out)


@app.command(cls=Command)
def merge(
    first: Annotated[
        Path, typer.Argument(metavar="A", help="A map, or the run that left it; its frame stays.", show_default=False)
    ],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one of the same camera.", show_default=False)],
    out: options.NewMap,
) -> None:
    """Make one map of two: keyframes of B are recognised in A, and a graph of both is solved.

    Two keyframes of B at least must be recognised, and agree on where B lies in A; else nothing is written.
    Surfels are fused anew of the keyframes, and grey. What nobody knows how it lies to A is left out, and told.

    [bold]Examples[/bold]

    wheelsight map merge monday tuesday --out both

    wheelsight map merge ground_floor/map stairs/map --out house
    """
    work.merge(first, second, out)


@app.command(cls=Command)
def prune(source: options.MapPath, out: options.NewMap) -> None:
    """Leave out keyframes whose view another one shows, so that a map that is extended daily does not grow for ever.

    The old map stays as it is. Edges are carried over to keyframes that stay, and so are surfels.

    [bold]Examples[/bold]

    wheelsight map prune results --out pruned

    wheelsight map prune house/map --out house_pruned
    """
    work.prune(source, out)
