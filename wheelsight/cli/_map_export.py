"""What `wheelsight map export` does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from wheelsight.mapping import OccupancyGrid, SurfelMap
    from wheelsight.slam.sessions import MapFolder

_MB = 1e6
_SUFFIXES = {"--out": (".ply",), "--occupancy": (".yaml", ".yml"), "--picture": (".png",)}


@dataclass(frozen=True, slots=True)
class Exports:
    """What to write, where to; at least one of them.

    Attributes:
        points: PLY file of the surfels.
        occupancy: YAML file of the occupancy map.
        picture: PNG file of the same.
        resolution_m: side of its cells; None: as settings say.
        everything: all surfels, and not only stable ones.
    """

    points: Path | None
    occupancy: Path | None
    picture: Path | None
    resolution_m: float | None
    everything: bool


def export(folder: MapFolder, wanted: Exports, force: bool) -> None:
    """Write a map for other programs; nothing where any of it must not be written."""
    from wheelsight.cli._map_picture import write_picture

    _check(wanted, force)
    if wanted.points is not None:
        _write_points(folder, wanted.points, wanted.everything)
    if wanted.occupancy is None and wanted.picture is None:
        return
    grid = grid_of(folder, wanted.resolution_m)
    if wanted.occupancy is not None:
        _write_occupancy(grid, wanted.occupancy)
    if wanted.picture is not None:
        write_picture(grid, folder, wanted.picture)


def _check(wanted: Exports, force: bool) -> None:
    from wheelsight.cli._outputs import check_out
    from wheelsight.errors import ConfigError

    files = dict(zip(_SUFFIXES, (wanted.points, wanted.occupancy, wanted.picture), strict=True))
    if not any(files.values()):
        raise ConfigError("nothing is asked for", fix="--out points.ply, --occupancy plan.yaml or --picture plan.png")
    if wanted.resolution_m is not None and wanted.occupancy is None and wanted.picture is None:
        raise ConfigError("--resolution is of occupancy maps", fix="--occupancy plan.yaml or --picture plan.png")
    for option, path in files.items():
        if path is not None and path.suffix.lower() not in _SUFFIXES[option]:
            ends = " or ".join(_SUFFIXES[option])
            raise ConfigError(f"{option} is {str(path)!r}, which does not end in {ends}", fix=f"give a name in {ends}")
    for path in files.values():
        if path is not None:
            check_out(path, force)
    if wanted.occupancy is not None:
        check_out(wanted.occupancy.with_suffix(".pgm"), force)


def _write_points(folder: MapFolder, out: Path, everything: bool) -> None:
    from wheelsight.mapping import write_ply

    count = write_ply(folder.surfels() or _fused(folder), out, stable_only=not everything)
    typer.echo(f"{count:,} points, {out.stat().st_size / _MB:.1f} MB: {out}")


def grid_of(folder: MapFolder, resolution_m: float | None = None) -> OccupancyGrid:
    """The occupancy map of an open map, made with progress; of cells of so many metres, or as its settings say.

    Raises as `occupancy_of` does.
    """
    from wheelsight.cli._compiling import compile_missing
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.mapping import OccupancyMapper
    from wheelsight.slam.sessions import occupancy_of

    settings = folder.settings.occupancy
    if resolution_m is not None:
        settings = settings.model_copy(update={"resolution_m": resolution_m})
    compile_missing(["dense"])
    # Refused before any keyframe is read, where nobody knows where the camera sits.
    mapper = OccupancyMapper(folder.calibration, settings)
    with FrameProgress("occupancy", None, unit="keyframes") as progress:
        return occupancy_of(folder, settings, progress.reach, mapper)


def _write_occupancy(grid: OccupancyGrid, out: Path) -> None:
    from wheelsight.ros_map import write_ros_map

    about, image = write_ros_map(grid.to_ros(), out)
    rows, columns = grid.kind.shape
    size = f"{columns * grid.resolution_m:.1f} × {rows * grid.resolution_m:.1f} m in cells of {grid.resolution_m:g} m"
    typer.echo(f"{size}, {grid.free_m2():.1f} m² free: {about}, {image.name}")


def _fused(folder: MapFolder) -> SurfelMap:
    from wheelsight.cli._compiling import compile_missing
    from wheelsight.cli._console import print_note
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.slam.sessions import fused_anew

    print_note("the map has no surfels; they are fused of its keyframes")
    compile_missing(["dense"])
    with FrameProgress("fusing", None, unit="keyframes") as progress:
        return fused_anew(folder, on_keyframe=progress.reach)
