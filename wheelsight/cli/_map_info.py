"""What `wheelsight map info` prints."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wheelsight.slam.sessions import Health, MapFolder, MapInfo

_MB = 1e6


def print_info(folder: MapFolder, as_json: bool) -> None:
    """The figures of an open map, as a table or as JSON; and what is wrong with it, as warnings."""
    from wheelsight.cli._console import console, facts_table, print_json, print_warning
    from wheelsight.slam.sessions import info_of

    found = info_of(folder)
    if as_json:
        print_json(found.to_dict())
        return
    console().print(facts_table(f"map of {found.header.source or 'a drive'}", _facts(found)))
    for note in found.health.notes:
        print_warning(note)


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
    if found.areas:
        yield "areas", ", ".join(found.areas)
    if found.places != ():
        yield "places", "cannot be read" if found.places is None else ", ".join(found.places)
    yield "size", f"{found.bytes / _MB:.1f} MB"
    yield "health", _how_whole(found.health)


def _how_whole(health: Health) -> str:
    if health.incomplete:
        return f"{health.incomplete}; run it again"
    if not health.is_whole:
        return "damaged, see below"
    return "whole but for its end, see below" if health.notes else "whole"


def _parts(parts: int) -> str:
    return "all hang together" if parts <= 1 else f"in {parts:,} parts that do not hang together"


def _size(size: int | None, missing: str) -> str:
    return missing if size is None else f"{size / _MB:.1f} MB"
