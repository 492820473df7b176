"""`wheelsight map`: commands for the map folder that a run leaves for the next drive, and their options."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wheelsight.app.cli.compiling import compile_missing
from wheelsight.app.cli.console import CliCommand, Group, print_warning, takes
from wheelsight.app.cli.map_contents import (
    MapExportOptions,
    MapPath,
    name_place,
    print_info,
    print_names,
    write_exports,
)
from wheelsight.app.cli.map_zones import ZoneOptions, change_zones, print_zones
from wheelsight.app.cli.options import option
from wheelsight.core.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.slam.maps import MapFolder


def zone(options: ZoneOptions) -> None:
    """Mark where robots must not drive, must drive slowly, or what is gone; name an area; or list all marks.

    Zones and areas are in the map's edits.json. Each hangs on the nearest keyframe and moves with it, as where a loop
    closes; rebuild, merge and prune carry them over. wheelsight map export MAP --picture plan.png shows the
    map, and says from where to where it reaches.

    [bold]Examples[/bold]

    wheelsight map zone home --keep-out 2,-1 3,-1 3,0.5
    wheelsight map zone home --speed 0.3 -1,2 4,3
    wheelsight map zone home --wipe 5,0 5.4,0.4
    wheelsight map zone home --floor 1,1 2,3
    wheelsight map zone home --area kitchen 4,-3 7,-3 7,0 4,0
    wheelsight map zone home
    wheelsight map zone home --forget 2
    """
    options.check()
    if options.option is None:
        print_zones(_opened(options.source))
    else:
        change_zones(options)


maps_app = typer.Typer(cls=Group, no_args_is_help=True, rich_markup_mode="rich")


@maps_app.callback()
def _about() -> None:
    """The map that a run leaves for the next drive: info, name, zone, export, rebuild, merge, prune."""


@maps_app.command(cls=CliCommand)
def info(
    source: MapPath, as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False
) -> None:
    """Show what is in a map: keyframes, edges, loops, size, camera, and what is wrong with it, if anything.

    [bold]Examples[/bold]

    wheelsight map info results
    wheelsight map info results/map --json
    """
    print_info(_opened(source, is_incomplete_read=True), as_json)


@maps_app.command(cls=CliCommand)
def name(
    source: MapPath,
    called: Called = None,
    at: At = None,
    show_list: Annotated[bool, typer.Option("--list", help="Print all names and where they are by now.")] = False,
    remove: Annotated[bool, typer.Option("--remove", help="Forget the name.")] = False,
) -> None:
    """Name a place of a map; wheelsight drive goes to it by this name.

    Names are in the map's places.json. Each hangs on the nearest keyframe and moves with it, as where a loop closes;
    rebuild, merge and prune carry them over.

    [bold]Examples[/bold]

    wheelsight map name home kitchen --at 3.2,1.5,90
    wheelsight map name home --list
    wheelsight map name home kitchen --remove
    """
    if sum((show_list, remove, at is not None)) != 1:
        fix = "NAME --at X,Y,YAW_DEG, NAME --remove, or --list"
        raise ConfigError("one of --at, --remove and --list is needed", fix=fix)
    if (called is None) != show_list:
        problem = "--list is of all names" if show_list else "NAME is missing"
        raise ConfigError(problem, fix="--list alone, or NAME --at X,Y,YAW_DEG")
    if called is None:
        print_names(_opened(source))
    else:
        name_place(source, called, at)


# Else -1,2 would be an option; what is none is refused by the work.
maps_app.command(cls=CliCommand, context_settings={"ignore_unknown_options": True})(takes(ZoneOptions)(zone))


@maps_app.command(cls=CliCommand)
@takes(MapExportOptions)
def export(options: MapExportOptions) -> None:
    """Write the map where its keyframes are by now: surfels as points, and what of the floor is free.

    Where the map has no surfels, as one of a run that was killed, they are fused of its keyframes first. Nav2's
    map_server reads the occupancy map.

    [bold]Examples[/bold]

    wheelsight map export results --out kitchen.ply
    wheelsight map export results/map --all --out all_points.ply --force
    wheelsight map export results --occupancy plan.yaml --picture plan.png --resolution 0.05
    """
    write_exports(_opened(options.source), options)


@maps_app.command(cls=CliCommand)
def rebuild(source: MapPath, out: NewMap) -> None:
    """Rebuild a map from its keyframes at their current poses. Surfels are fused again, outdated keyframes left out.

    The old map stays as it is. Keyframes keep no colour: the new surfels are grey.

    [bold]Examples[/bold]

    wheelsight map rebuild results --out rebuilt
    wheelsight map rebuild results/map --out rebuilt
    """
    from wheelsight.slam.maps import info_of, rebuild

    folder = _opened(source)
    with _progress("rebuilding") as on_keyframe:
        new = info_of(rebuild(folder, out, on_keyframe=on_keyframe))
    surfels = f"{(new.surfel_bytes or 0) / 1e6:.1f} MB of surfels"
    typer.echo(f"{new.keyframes:,} keyframes, {new.loops:,} loops, {surfels}: {out}")


@maps_app.command(cls=CliCommand)
def merge(
    first: Annotated[
        Path, typer.Argument(metavar="A", help="A map, or the run that left it; its frame stays.", show_default=False)
    ],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one of the same camera.", show_default=False)],
    out: NewMap,
) -> None:
    """Make one map of two: keyframes of B are recognised in A, and a graph of both is solved.

    Two keyframes of B at least must be recognised, and agree on where B lies in A; else nothing is written.
    Surfels are fused again from the keyframes, in grey. Keyframes of unknown position in A are left out and reported.

    [bold]Examples[/bold]

    wheelsight map merge monday tuesday --out both
    wheelsight map merge ground_floor/map stairs/map --out house
    """
    from wheelsight.slam.maps import merge

    folders = _opened(first), _opened(second)
    with _progress("merging") as on_keyframe:
        made = merge(*folders, out, on_keyframe=on_keyframe)
    if made.left_out:
        print_warning(f"{made.left_out:,} keyframes are left out: their place in {first} is unknown.")
    of_first, of_second = made.keyframes
    joined, refused = made.loops
    counts = f"{of_first:,} keyframes and {of_second:,}, joined by {joined:,} loops, {refused:,} refused"
    typer.echo(f"{counts}: {out}")


@maps_app.command(cls=CliCommand)
def prune(source: MapPath, out: NewMap) -> None:
    """Leave out keyframes whose view another one shows, so that a map that is extended daily does not grow for ever.

    The old map stays as it is. Edges are carried over to keyframes that stay, and so are surfels.

    [bold]Examples[/bold]

    wheelsight map prune results --out pruned
    wheelsight map prune house/map --out house_pruned
    """
    from wheelsight.slam.maps import prune

    folder = _opened(source)
    with _progress("pruning") as on_keyframe:
        made = prune(folder, out, on_keyframe=on_keyframe)
    typer.echo(f"{len(made.folder.store):,} keyframes, {made.left_out:,} left out: {out}")


def _opened(source: Path, *, is_incomplete_read: bool = False) -> MapFolder:
    from wheelsight.slam.maps import MapFolder, find_map

    return MapFolder.open(find_map(source), is_incomplete_read=is_incomplete_read)


@contextmanager
def _progress(action: str) -> Iterator[Callable[[str, int, int], None]]:
    """Progress over keyframes, once the kernels are compiled."""
    from wheelsight.app.cli.progress import FrameProgress

    compile_missing(["dense"])
    with FrameProgress(action, None, unit="keyframes") as progress:
        yield lambda doing, done, total: progress.reach(done, total, doing)


NewMap = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", help="Folder of the new map; empty, or not there yet.", show_default=False),
]
Called = Annotated[str | None, typer.Argument(metavar="NAME", help="What the place is called.", show_default=False)]
At = Annotated[
    str | None,
    option(
        "Where it is in the map: metres, and the heading of a robot there, in degrees from x to y.",
        "X,Y[,YAW_DEG]",
        False,
    ),
]
