"""`wheelsight export`: a run's map for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from wheelsight.mapping import SurfelMap

_VOXEL_M = 0.02


def export(
    source: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of a run with a map, or the map's file.", show_default=False)
    ],
    ply: Annotated[bool, typer.Option("--ply", help="Write surfels as points: colour, normal, radius.")] = False,
    mesh: Annotated[bool, typer.Option("--mesh", help="Write a surface of triangles, in colour.")] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Where to.", show_default="points.ply or mesh.ply beside the map"),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="All surfels, and not only those seen often enough to be sure.")
    ] = False,
    voxel: Annotated[
        float | None,
        typer.Option(metavar="METRES", min=0.001, max=10, help="How fine the mesh is.", show_default="0.02"),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite what is there.")] = False,
) -> None:
    """Write the map of a run as a PLY file, which Open3D, MeshLab, CloudCompare and Blender open.

    Metres, in the map of the run's trajectory. A mesh needs scikit-image, which the extra mesh brings.

    [bold]Examples[/bold]

    wheelsight export results --ply

    wheelsight export results --mesh --voxel 0.01 --out kitchen.ply

    wheelsight export results/map.surfels --ply --all --out all_points.ply
    """
    from wheelsight.cli._compiling import compile_missing
    from wheelsight.cli._outputs import check_out
    from wheelsight.errors import ConfigError
    from wheelsight.mapping import load_map
    from wheelsight.pipeline.kernels import usable_parts

    if ply and mesh:
        raise ConfigError("--ply and --mesh are two files", fix="give one of them at a time")
    if not (ply or mesh):
        raise ConfigError("one of --ply and --mesh is needed", fix="--ply for points, --mesh for triangles")
    if ply and voxel is not None:
        raise ConfigError("--voxel is of meshes alone", fix="--mesh, or no --voxel")
    path = _map_in(source)
    to = out or path.with_name("points.ply" if ply else "mesh.ply")
    if to.suffix.lower() != ".ply":
        raise ConfigError(f"--out is {str(to)!r}, which does not end in .ply", fix="PLY is what is written")
    check_out(to, force)
    surfel_map = load_map(path)
    if mesh:
        compile_missing([part for part in usable_parts() if part == "mesh"])
    told = _write_points(surfel_map, to, everything) if ply else _write_mesh(surfel_map, to, everything, voxel)
    typer.echo(f"{told}, {to.stat().st_size / 1e6:.1f} MB: {to}")


def _map_in(source: Path) -> Path:
    """The map's file: as given, in a run's folder, or in that of its joined or dense track. Raises MapError."""
    from wheelsight.errors import MapError
    from wheelsight.inputs import is_there
    from wheelsight.pipeline import MAP_FILE

    if not is_there(source):
        raise MapError("there is no such folder or file", path=source, fix="check the path")
    if not source.is_dir():
        return source
    found = [path for path in (source / place / MAP_FILE for place in ("", "joined", "dense")) if is_there(path)]
    if not found:
        fix = "make one: wheelsight run RECORDING --odometry dense --map surfels --out DIR"
        raise MapError(f"holds no {MAP_FILE}", path=source, fix=fix)
    return found[0]


def _write_points(surfel_map: SurfelMap, to: Path, everything: bool) -> str:
    from wheelsight.mapping import write_ply

    return f"{write_ply(surfel_map, to, stable_only=not everything):,} points"


def _write_mesh(surfel_map: SurfelMap, to: Path, everything: bool, voxel_m: float | None) -> str:
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.mapping import mesh_of, write_mesh_ply

    with FrameProgress("meshing", None, unit="chunks") as progress:
        mesh = mesh_of(surfel_map, voxel_m or _VOXEL_M, not everything, progress.reach)
    write_mesh_ply(mesh, to)
    return f"{len(mesh.triangles):,} triangles of {len(mesh.vertices):,} points"
