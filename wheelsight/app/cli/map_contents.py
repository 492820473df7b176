"""Shows, names and exports the contents of a map: facts, names of places, points, occupancy, and a picture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wheelsight.app.cli.options import option_field
from wheelsight.core.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.core.geometry import FloatArray
    from wheelsight.mapping import NamedPoses, OccupancyGrid
    from wheelsight.slam.maps import MapFolder, MapInfo


_MB = 1e6
MapPath = Annotated[
    Path, typer.Argument(metavar="DIR", help="The map's folder, or that of the run that left it.", show_default=False)
]


def print_info(folder: MapFolder, as_json: bool) -> None:
    """Print figures of an open map, as a table or as JSON, and warnings about its health."""
    from wheelsight.app.cli.console import console, facts_table, print_json, print_warning
    from wheelsight.slam.maps import info_of

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
    parts = "all hang together" if found.parts <= 1 else f"in {found.parts:,} parts that do not hang together"
    yield "edges", f"{found.edges:,} by odometry, {found.loops:,} loops; {parts}"
    yield "surfels", _size(found.surfel_bytes, "none; wheelsight map rebuild makes them")
    yield "recognition", _size(found.recognition_bytes, "made when the map is used")
    absent = "none; wheelsight map export --occupancy makes it"
    yield "occupancy", absent if found.occupancy_bytes is None else f"{found.occupancy_bytes / 1e3:.0f} kB"
    if found.edits != 0:
        yield "edits", "cannot be read" if found.edits is None else f"{found.edits:,} zones and wiped places"
    if found.areas:
        yield "areas", ", ".join(found.areas)
    if found.places != ():
        yield "places", "cannot be read" if found.places is None else ", ".join(found.places)
    yield "size", f"{found.bytes / _MB:.1f} MB"
    health = found.health
    if health.incomplete:
        how_whole = f"{health.incomplete}; run it again"
    elif not health.is_whole:
        how_whole = "damaged, see below"
    else:
        how_whole = "whole but for its end, see below" if health.notes else "whole"
    yield "health", how_whole


def _size(size: int | None, missing: str) -> str:
    return missing if size is None else f"{size / _MB:.1f} MB"


_FORM = "X,Y,YAW_DEG in metres and degrees, such as 3.2,1.5,90; or X,Y for any heading"


def name_place(source: Path, called: str, at: str | None) -> None:
    """Name a place, or forget the name if no pose is given. Raises ConfigError, MapError, OutputError."""
    from wheelsight.mapping import NamedPose
    from wheelsight.slam.maps import MapFolder, find_map, in_largest_piece

    pose = None if at is None else pose_of("--at", at)
    folder = MapFolder.open(find_map(source), read_only=False)
    try:
        known = folder.named_poses()
        if pose is None:
            folder.save_named_poses(known.without(called))
            typer.echo(f"forgotten: {called}")
            return
        # A keyframe of unknown position must not carry a named pose.
        sure = in_largest_piece(folder).nonzero()[0]
        hung = NamedPose(called, pose).attached_to_nearest(folder.store.T_map_keyframe, sure)
        folder.save_named_poses(known.with_pose(hung))
        on = "no keyframe" if hung.keyframe is None else f"keyframe {hung.keyframe}"
        typer.echo(f"{hung.name} is at {pose_text(pose)}, and moves with {on}")
        # A place farther from all keyframes than floor is taken from them was probably mistyped
        from wheelsight.app.cli.console import print_warning
        from wheelsight.mapping import OccupancySettings

        if hung.T_map_keyframe is not None:
            off_m = math.dist(hung.pose[:2], hung.T_map_keyframe[:2, 3])
            far_m = OccupancySettings().far_m
            if off_m > far_m:
                print_warning(
                    f"{hung.name} is {off_m:.1f} m from the nearest keyframe, which shows the floor to {far_m:g} m: "
                    "no way will lead there (wheelsight map export MAP --picture plan.png shows the map)"
                )
    finally:
        folder.close()


def print_names(folder: MapFolder) -> None:
    """Print all named places of a map with their current poses."""
    from wheelsight.app.cli.console import console, facts_table

    where = places_of(folder)
    if not where:
        typer.echo("the map has no names: wheelsight map name MAP NAME --at X,Y,YAW_DEG")
        return
    console().print(facts_table("places", ((name, pose_text(pose)) for name, pose in where.items())))


def places_of(folder: MapFolder) -> dict[str, FloatArray]:
    """Current pose (3,) of each named place. Raises MapError."""
    return {one.name: one.pose_now(folder.store.T_map_keyframe) for one in names_of(folder)}


def names_of(folder: MapFolder) -> NamedPoses:
    """All named poses of existing keyframes. Raises MapError."""
    from wheelsight.slam.maps.contents import current_named_poses

    return current_named_poses(folder)


def pose_of(option: str, text: str) -> FloatArray:
    """(3,) x, y, yaw of "3.2,1.5,90" or "3.2,1.5", whose yaw is NaN. Raises ConfigError naming the option."""
    import numpy as np

    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{option} is {text!r}", fix=_FORM)
    x_m, y_m, *yaw_deg = numbers
    return np.array([x_m, y_m, math.radians(yaw_deg[0]) if yaw_deg else math.nan])


def pose_text(pose: FloatArray) -> str:
    """A pose as text, such as "3.20, 1.50 m, 90°"."""
    yaw = "any heading" if math.isnan(pose[2]) else f"{math.degrees(pose[2]):.0f}°"
    return f"{pose[0]:.2f}, {pose[1]:.2f} m, {yaw}"


_SUFFIXES = {"--out": (".ply",), "--occupancy": (".yaml", ".yml"), "--picture": (".png",)}


@dataclass(frozen=True, slots=True)
class MapExportOptions:
    """Options of `wheelsight map export`; at least one file is named."""

    source: MapPath
    out: Path | None = option_field("PLY file of the surfels to write.", "FILE", False)
    occupancy: Path | None = option_field("YAML file of the occupancy map; its PGM stands beside it.", "FILE", False)
    picture: Path | None = option_field("PNG file: a picture of that.", "FILE", False)
    resolution: float | None = option_field("Side of the occupancy map's cells.", "METRES", "0.05", min=0.01, max=1)
    everything: bool = option_field(
        "All surfels, and not only those seen often enough to be sure.", default=False, flag="--all"
    )
    force: bool = option_field("Overwrite what is there.", default=False)


def write_exports(folder: MapFolder, wanted: MapExportOptions) -> None:
    """Write a map for other programs: all files, or none if one cannot be written."""
    from wheelsight.app.cli.compiling import compile_missing
    from wheelsight.app.cli.console import print_note
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.io.ros_map import write_ros_map
    from wheelsight.slam.maps import fuse_keyframes
    from wheelsight_export.meshes import write_ply

    _check(wanted)
    if wanted.out is not None:
        surfels = folder.surfels()
        if not surfels:
            print_note("the map has no surfels; they are fused of its keyframes")
            compile_missing(["dense"])
            with FrameProgress("fusing", None, unit="keyframes") as progress:
                surfels = fuse_keyframes(folder, on_keyframe=progress.reach)
        count = write_ply(surfels, wanted.out, stable_only=not wanted.everything)
        typer.echo(f"{count:,} points, {wanted.out.stat().st_size / _MB:.1f} MB: {wanted.out}")
    if wanted.occupancy is None and wanted.picture is None:
        return
    grid = grid_of(folder, wanted.resolution)
    if wanted.occupancy is not None:
        about, image = write_ros_map(grid.to_ros(), wanted.occupancy)
        rows, columns = grid.kind.shape
        cell_m = grid.resolution_m
        size = f"{columns * cell_m:.1f} × {rows * cell_m:.1f} m in cells of {cell_m:g} m"
        typer.echo(f"{size}, {grid.free_m2():.1f} m² free: {about}, {image.name}")
    if wanted.picture is not None:
        write_picture(grid, folder, wanted.picture)


def _check(wanted: MapExportOptions) -> None:
    from wheelsight.app.cli.options import check_out
    from wheelsight.core.errors import ConfigError

    files = dict(zip(_SUFFIXES, (wanted.out, wanted.occupancy, wanted.picture), strict=True))
    if not any(files.values()):
        raise ConfigError("nothing is asked for", fix="--out points.ply, --occupancy plan.yaml or --picture plan.png")
    if wanted.resolution is not None and wanted.occupancy is None and wanted.picture is None:
        raise ConfigError("--resolution is of occupancy maps", fix="--occupancy plan.yaml or --picture plan.png")
    for option, path in files.items():
        if path is not None and path.suffix.lower() not in _SUFFIXES[option]:
            ends = " or ".join(_SUFFIXES[option])
            raise ConfigError(f"{option} is {str(path)!r}, which does not end in {ends}", fix=f"give a name in {ends}")
    for path in files.values():
        if path is not None:
            check_out(path, wanted.force)
    if wanted.occupancy is not None:
        check_out(wanted.occupancy.with_suffix(".pgm"), wanted.force)


def grid_of(folder: MapFolder, resolution_m: float | None = None) -> OccupancyGrid:
    """The occupancy map of an open map, with a progress bar; cells of `resolution_m`, or of the map's settings.

    Raises as `occupancy_of` does.
    """
    from wheelsight.app.cli.compiling import compile_missing
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.mapping import OccupancyMapper
    from wheelsight.slam.maps import occupancy_of

    settings = folder.settings.occupancy
    if resolution_m is not None:
        settings = settings.model_copy(update={"resolution_m": resolution_m})
    compile_missing(["dense"])
    # Without the camera's mount refuse before any keyframe is read.
    mapper = OccupancyMapper(folder.calibration, settings)
    with FrameProgress("occupancy", None, unit="keyframes") as progress:
        return occupancy_of(folder, settings, progress.reach, mapper)


def write_picture(grid: OccupancyGrid, folder: MapFolder, out: Path) -> None:
    """Write the plan with axes, driven paths, areas, speed zones and named places. Raises OutputError."""
    # Outlines of areas and speed zones, and named places
    from wheelsight.mapping import EditKind
    from wheelsight.mapping.occupancy import PlanLine, PlanMark, picture_of, save_picture
    from wheelsight.slam.maps import driven_way
    from wheelsight.slam.maps.contents import current_edits, current_named_poses

    T, drawn = folder.store.T_map_keyframe, {EditKind.AREA: (0, 158, 115), EditKind.SPEED: (230, 159, 0)}
    lines = []
    for edit in current_edits(folder).edits:
        if edit.kind in drawn:
            corners = edit.polygon_now(T)
            called = edit.name or f"{edit.limit_m_s:g} m/s"
            kind = "area" if edit.name else "speed zone"
            lines.append(PlanLine([*corners, corners[0]], drawn[edit.kind], kind, text=called))
    names = current_named_poses(folder)
    places = [(name, names.named(name).pose_now(T)[:2]) for name in names.names]
    marks = [PlanMark(xy, "square", drawn[EditKind.AREA], "place", name) for name, xy in places]
    image = picture_of(grid, [stretch[:, :2] for stretch in driven_way(folder)], lines, marks, has_axes=True)
    save_picture(image, out)
    # Grid lines, to read off corners of zones.
    (x, y), (rows, columns) = grid.origin, grid.kind.shape
    reach = f"x {x:.2f} to {x + columns * grid.resolution_m:.2f} m, y {y:.2f} to {y + rows * grid.resolution_m:.2f} m"
    typer.echo(f"{image.shape[1]} × {image.shape[0]} pixels: {out}; above its legend {reach}")
