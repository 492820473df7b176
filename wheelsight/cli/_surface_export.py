"""What `wheelsight export --ply` and `--mesh` do."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wheelsight.cli._exporting import Asked

if TYPE_CHECKING:
    from wheelsight.mapping import SurfelMap

_VOXEL_M = 0.02


def export_surface(asked: Asked, is_mesh: bool) -> None:
    """Write surfels as points, or as triangles. Raises InputError."""
    from wheelsight.cli._compiling import compile_missing
    from wheelsight.cli._outputs import check_out
    from wheelsight.errors import ConfigError
    from wheelsight.pipeline.kernels import usable_parts

    path = _map_in(asked.source)
    to = asked.out or _beside(path) / ("mesh.ply" if is_mesh else "points.ply")
    if to.suffix.lower() != ".ply":
        raise ConfigError(f"--out is {str(to)!r}, which does not end in .ply", fix="PLY is what is written")
    check_out(to, asked.force)
    surfel_map = _loaded(path)
    if is_mesh:
        compile_missing([part for part in usable_parts() if part == "mesh"])
    write = _write_mesh if is_mesh else _write_points
    typer.echo(f"{write(surfel_map, to, asked)}, {to.stat().st_size / 1e6:.1f} MB: {to}")


def _map_in(source: Path) -> Path:
    """The map's file: as given, in a run's folder, or in that of its joined or dense track. Raises MapError."""
    from wheelsight.errors import MapError
    from wheelsight.inputs import is_there
    from wheelsight.pipeline import MAP_FILE
    from wheelsight.slam.sessions import MAP_FOLDER

    if not is_there(source):
        raise MapError("there is no such folder or file", path=source, fix="check the path")
    if not source.is_dir():
        return source
    folders = [source / place / inner for place in ("", "joined", "dense") for inner in ("", MAP_FOLDER)]
    found = [path for path in (folder / MAP_FILE for folder in folders) if is_there(path)]
    if not found:
        fix = "make one: wheelsight run RECORDING --odometry dense --map surfels --out DIR"
        raise MapError(f"holds no {MAP_FILE}", path=source, fix=fix)
    return found[0]


def _beside(path: Path) -> Path:
    """Where points of a map's file go: beside it, or beside the map folder that holds it."""
    from wheelsight.slam.sessions import is_map

    return path.parent.parent if is_map(path.parent) else path.parent


def _loaded(path: Path) -> SurfelMap:
    """A map's file; of a map folder, where its keyframes are by now."""
    from wheelsight.mapping import load_map
    from wheelsight.slam.sessions import MapFolder, is_map

    found = MapFolder.open(path.parent).surfels() if is_map(path.parent) else None
    return load_map(path) if found is None else found


def _write_points(surfel_map: SurfelMap, to: Path, asked: Asked) -> str:
    from wheelsight.mapping import write_ply

    return f"{write_ply(surfel_map, to, stable_only=not asked.everything):,} points"


def _write_mesh(surfel_map: SurfelMap, to: Path, asked: Asked) -> str:
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.mapping import mesh_of, write_mesh_ply

    with FrameProgress("meshing", None, unit="chunks") as progress:
        mesh = mesh_of(surfel_map, asked.voxel_m or _VOXEL_M, not asked.everything, progress.reach)
    write_mesh_ply(mesh, to)
    return f"{len(mesh.triangles):,} triangles of {len(mesh.vertices):,} points"
