"""The tasks of `wheelsight map`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from wheelsight.app.cli.map_contents import Exports
    from wheelsight.app.cli.map_zones import AskedZone
    from wheelsight.slam.maps import MapFolder

_MB = 1e6


def info(source: Path, as_json: bool) -> None:
    """Print the figures of a map."""
    from wheelsight.app.cli.map_contents import print_info

    print_info(_opened(source, is_incomplete_read=True), as_json)


def name(source: Path, called: str | None, at: str | None, *, show_list: bool, remove: bool) -> None:
    """Name a place, forget a name, or print all."""
    from wheelsight.app.cli.map_contents import change, print_names
    from wheelsight.core.errors import ConfigError

    if sum((show_list, remove, at is not None)) != 1:
        fix = "NAME --at X,Y,YAW_DEG, NAME --remove, or --list"
        raise ConfigError("one of --at, --remove and --list is needed", fix=fix)
    if (called is None) != show_list:
        problem = "--list is of all names" if show_list else "NAME is missing"
        raise ConfigError(problem, fix="--list alone, or NAME --at X,Y,YAW_DEG")
    if called is None:
        print_names(_opened(source))
    else:
        change(source, called, at)


def zone(source: Path, asked: AskedZone) -> None:
    """Draw a zone or an area, forget one, or print all."""
    from wheelsight.app.cli.map_zones import change, print_zones

    asked.check()
    if asked.option is None:
        print_zones(_opened(source))
    else:
        change(source, asked)


def export(source: Path, wanted: Exports, force: bool) -> None:
    """Write a map for other programs."""
    from wheelsight.app.cli.map_contents import export

    export(_opened(source), wanted, force)


def rebuild(source: Path, out: Path) -> None:
    """Rewrite a map."""
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.slam.maps import info_of, rebuild

    folder = _opened(source)
    _compile()
    with FrameProgress("rebuilding", None, unit="keyframes") as progress:
        new = rebuild(folder, out, on_keyframe=lambda doing, done, total: progress.reach(done, total, doing))
    info = info_of(new)
    surfels = f"{(info.surfel_bytes or 0) / _MB:.1f} MB of surfels"
    typer.echo(f"{info.keyframes:,} keyframes, {info.loops:,} loops, {surfels}: {out}")


def merge(first: Path, second: Path, out: Path) -> None:
    """Write two maps as one."""
    from wheelsight.app.cli.console import print_warning
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.slam.maps import merge

    folders = _opened(first), _opened(second)
    _compile()
    with FrameProgress("merging", None, unit="keyframes") as progress:
        made = merge(*folders, out, on_keyframe=lambda doing, done, total: progress.reach(done, total, doing))
    if made.left_out:
        print_warning(f"{made.left_out:,} keyframes are left out: their place in {first} is unknown.")
    of_first, of_second = made.keyframes
    joined, refused = made.loops
    counts = f"{of_first:,} keyframes and {of_second:,}, joined by {joined:,} loops, {refused:,} refused"
    typer.echo(f"{counts}: {out}")


def prune(source: Path, out: Path) -> None:
    """Write a map without what is shown twice."""
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.slam.maps import prune

    folder = _opened(source)
    _compile()
    with FrameProgress("pruning", None, unit="keyframes") as progress:
        made = prune(folder, out, on_keyframe=lambda doing, done, total: progress.reach(done, total, doing))
    typer.echo(f"{len(made.folder.store):,} keyframes, {made.left_out:,} left out: {out}")


def _opened(source: Path, *, is_incomplete_read: bool = False) -> MapFolder:
    from wheelsight.slam.maps import MapFolder, find_map

    return MapFolder.open(find_map(source), is_incomplete_read=is_incomplete_read)


def _compile() -> None:
    from wheelsight.app.cli.compiling import compile_missing

    compile_missing(["dense"])
