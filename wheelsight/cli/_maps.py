"""What `wheelsight map` does."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from wheelsight.cli._map_export import Exports
    from wheelsight.slam.sessions import Health, MapFolder, MapInfo

_MB = 1e6


def info(source: Path, as_json: bool) -> None:
    """Print the figures of a map."""
    from wheelsight.cli._console import console, facts_table, print_json, print_warning
    from wheelsight.slam.sessions import info_of

    folder = _opened(source)
    found = info_of(folder)
    if as_json:
        print_json(found.to_dict())
        return
    console().print(facts_table(f"map of {found.header.source or 'a drive'}", _facts(found)))
    for note in found.health.notes:
        print_warning(note)


def name(source: Path, called: str | None, at: str | None, *, show_list: bool, remove: bool) -> None:
    """Name a place, forget a name, or print all."""
    from wheelsight.cli._map_names import change, print_names
    from wheelsight.errors import ConfigError

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


def export(source: Path, wanted: Exports, force: bool) -> None:
    """Write a map for other programs."""
    from wheelsight.cli._map_export import export

    export(_opened(source), wanted, force)


def rebuild(source: Path, out: Path) -> None:
    """Write a map anew."""
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.slam.sessions import info_of, rebuild

    folder = _opened(source)
    _compile()
    with FrameProgress("rebuilding", None, unit="keyframes") as progress:
        new = rebuild(folder, out, on_keyframe=lambda doing, done, total: progress.reach(done, total, doing))
    told = info_of(new)
    surfels = f"{(told.surfel_bytes or 0) / _MB:.1f} MB of surfels"
    typer.echo(f"{told.keyframes:,} keyframes, {told.loops:,} loops, {surfels}: {out}")


def merge(first: Path, second: Path, out: Path) -> None:
    """Write two maps as one."""
    from wheelsight.cli._console import print_warning
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.slam.sessions import merge

    folders = _opened(first), _opened(second)
    _compile()
    with FrameProgress("merging", None, unit="keyframes") as progress:
        made = merge(*folders, out, on_keyframe=lambda doing, done, total: progress.reach(done, total, doing))
    if made.left_out:
        print_warning(f"{made.left_out:,} keyframes are left out: nobody knows where they lie in {first}.")
    of_first, of_second = made.keyframes
    joined, refused = made.loops
    told = f"{of_first:,} keyframes and {of_second:,}, joined by {joined:,} loops, {refused:,} refused"
    typer.echo(f"{told}: {out}")


def prune(source: Path, out: Path) -> None:
    """Write a map without what is shown twice."""
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.slam.sessions import prune

    folder = _opened(source)
    _compile()
    with FrameProgress("pruning", None, unit="keyframes") as progress:
        made = prune(folder, out, on_keyframe=lambda doing, done, total: progress.reach(done, total, doing))
    typer.echo(f"{len(made.folder.store):,} keyframes, {made.left_out:,} left out: {out}")


def _opened(source: Path) -> MapFolder:
    from wheelsight.slam.sessions import MapFolder, find_map

    return MapFolder.open(find_map(source))


def _compile() -> None:
    from wheelsight.cli._compiling import compile_missing

    compile_missing(["dense"])


def _facts(found: MapInfo) -> Iterator[tuple[str, str]]:
    header, camera = found.header, found.header.camera
    yield "made", f"{header.made} by {header.made_by}"
    lens = f"fx {camera.fx:.1f}, fy {camera.fy:.1f}, cx {camera.cx:.1f}, cy {camera.cy:.1f} px"
    yield "camera", f"{camera.width}×{camera.height}, {lens}"
    kilobytes = found.keyframe_bytes / 1e3
    yield "keyframes", f"{found.keyframes:,}" + (f", {kilobytes:.0f} kB each" if found.keyframes else "")
    if found.begin_s is not None and found.end_s is not None:
        yield "time", f"{found.end_s - found.begin_s:.1f} s"
        yield "way", f"{found.length_m:.1f} m from keyframe to keyframe"
    yield "edges", f"{found.edges:,} by odometry, {found.loops:,} loops; {_parts(found.parts)}"
    yield "surfels", _size(found.surfel_bytes, "none; wheelsight map rebuild makes them")
    yield "recognition", _size(found.recognition_bytes, "made when the map is used")
    told = "none; wheelsight map export --occupancy makes it"
    yield "occupancy", told if found.occupancy_bytes is None else f"{found.occupancy_bytes / 1e3:.0f} kB"
    if found.edits != 0:
        yield "edits", "cannot be read" if found.edits is None else f"{found.edits:,} zones and wiped places"
    if found.places != ():
        yield "places", "cannot be read" if found.places is None else ", ".join(found.places)
    yield "size", f"{found.bytes / _MB:.1f} MB"
    yield "health", _how_whole(found.health)


def _how_whole(health: Health) -> str:
    if not health.is_whole:
        return "damaged, see below"
    return "whole but for its end, see below" if health.notes else "whole"


def _parts(parts: int) -> str:
    return "all hang together" if parts <= 1 else f"in {parts:,} parts that do not hang together"


def _size(size: int | None, missing: str) -> str:
    return missing if size is None else f"{size / _MB:.1f} MB"
