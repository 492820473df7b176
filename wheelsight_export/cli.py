"""`wheelsight export`: writes a run, its map or a recording for other programs: as a bag, in other formats, or as
points and a mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

import typer

from wheelsight.app.cli.options import option
from wheelsight.core.errors import ConfigError, MapError, OutputError

Out = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Where to; a folder for nerfstudio and colmap.", show_default="beside the map"),
]
Voxel = Annotated[
    float | None,
    option(
        "How fine a mesh, or points or cells of a map, are.", "METRES", "0.02 of a mesh, else 0.05", min=0.001, max=10
    ),
]
Format = Annotated[
    str | None,
    option(
        "tum, kitti, euroc: the trajectory. nerfstudio, colmap: images of keyframes with poses. octomap: a tree.",
        "NAME",
        False,
        flag="--format",
    ),
]
Images = Annotated[
    str | None,
    option(
        "Camera images into the bag: exactly; or compressed, depth to millimetres.",
        "raw|png|jpeg",
        "none",
        flag="--images",
    ),
]
Body = Annotated[
    str | None,
    typer.Option(metavar="base|camera", help="Whose trajectory.", show_default="that which the run followed"),
]


def export(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Folder of a run, of a map, or a recording; a map's file.", show_default=False
        ),
    ],
    ply: Annotated[bool, typer.Option("--ply", help="Write surfels as points: colour, normal, radius.")] = False,
    mesh: Annotated[bool, typer.Option("--mesh", help="Write a surface of triangles, in colour.")] = False,
    bag: Annotated[
        Path | None,
        typer.Option("--bag", metavar="FILE", help="Write a bag: .mcap for ROS 2, .bag for ROS 1.", show_default=False),
    ] = None,
    form: Format = None,
    out: Out = None,
    everything: Annotated[
        bool, typer.Option("--all", help="All surfels, and not only those seen often enough to be sure.")
    ] = False,
    voxel: Voxel = None,
    images: Images = None,
    body: Body = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite what is there.")] = False,
) -> None:
    """Write a run, its map or a recording for other programs.

    --ply and --mesh write the map as PLY, which Open3D, MeshLab, CloudCompare and Blender open; a mesh needs
    scikit-image (extra mesh). --bag writes what Foxglove, RViz and Nav2 open: /odom, /tf, /trajectory, /diagnostics,
    /map, /map_points, wheels, and images on request; it needs rosbags (extra bags). Metres, in the map of the run's
    trajectory.

    [bold]Examples[/bold]

    wheelsight export results --ply

    wheelsight export results --mesh --voxel 0.01 --out kitchen.ply

    wheelsight export results --bag results.mcap

    wheelsight export recording --bag drive.bag --images jpeg

    wheelsight export results --format kitti --body camera --out poses.txt

    wheelsight export results --format nerfstudio --out kitchen
    """
    asked = Asked(source, out, everything, voxel, images, body, force)
    ways = {"--ply": ply, "--mesh": mesh, "--bag": bag is not None, "--format": form is not None}
    given = [name for name, is_given in ways.items() if is_given]
    if not given:
        fix = "--ply for points, --mesh for triangles, --bag FILE, --format NAME"
        raise ConfigError(f"one of {', '.join(ways)} is needed", fix=fix)
    if len(given) > 1:
        raise ConfigError(f"{' and '.join(given)} are two files", fix="give one of them at a time")
    check_asked(asked, given[0])
    if ply or mesh:
        export_surface(asked, mesh)
    elif bag is not None:
        export_to_bag(asked, bag)
    elif form is not None:
        export_in(asked, form)


_BODIES = ("base", "camera")
# Options that mean something for some ways alone.
_OF_WAYS = {
    "--all": ("--ply", "--mesh"),
    "--voxel": ("--mesh", "--bag", "--format"),
    "--images": ("--bag",),
    "--body": ("--format",),
    "--out": ("--ply", "--mesh", "--format"),
}
_CALLED = {"--ply": "--ply", "--mesh": "meshes", "--bag": "bags", "--format": "--format"}


@dataclass(frozen=True, slots=True)
class Asked:
    """The options, as they were given; see `export`."""

    source: Path
    out: Path | None
    everything: bool
    voxel_m: float | None
    images: str | None
    body: str | None
    force: bool


def check_asked(asked: Asked, way: str) -> None:
    """Check the options. Raises ConfigError for options of another format."""
    given = {
        "--all": asked.everything,
        "--voxel": asked.voxel_m is not None,
        "--images": asked.images is not None,
        "--body": asked.body is not None,
        "--out": asked.out is not None,
    }
    for name, ways in _OF_WAYS.items():
        if given[name] and way not in ways:
            fix = "name the file behind --bag" if name == "--out" else f"{' or '.join(ways)}, or no {name}"
            raise ConfigError(f"{name} is of {' and '.join(_CALLED[one] for one in ways)} alone", fix=fix)
    if asked.body is not None and asked.body not in _BODIES:
        raise ConfigError(f"--body is {asked.body!r}", fix=f"one of {', '.join(_BODIES)}")


def export_to_bag(asked: Asked, to: Path) -> None:
    """Write a bag with its layouts, and print its contents. Raises InputError."""
    from wheelsight.app.cli.console import print_warning
    from wheelsight.app.cli.options import check_out
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.core.runtime import needed
    from wheelsight_export import DEFAULT_VOXEL_M, BagParts, export_bag, exported_at
    from wheelsight_export.bag import layout_paths
    from wheelsight_export.bag_writing import ImageForm, check_bag_name

    if asked.images is not None and asked.images not in get_args(ImageForm):
        raise ConfigError(f"--images is {asked.images!r}", fix=f"one of {', '.join(get_args(ImageForm))}")
    check_bag_name(to)
    needed("rosbags")
    source = exported_at(asked.source)
    if to.exists() and asked.source.exists() and to.samefile(asked.source):
        raise OutputError("is what is to be exported", path=to, fix="choose another name")
    for path in (to, *layout_paths(to)):
        check_out(path, asked.force)
    parts = BagParts(asked.images, asked.voxel_m or DEFAULT_VOXEL_M)  # type: ignore[arg-type]
    with FrameProgress("writing", None, unit="messages") as progress:
        report = export_bag(source, to, parts, lambda done: progress.reach(done, None))
    for warning in report.warnings:
        print_warning(warning)
    width = max(map(len, report.topics))
    for topic, count in sorted(report.topics.items()):
        typer.echo(f"{topic:<{width}}  {count:>9,}")
    typer.echo(f"{sum(report.topics.values()):,} messages, {report.size_bytes / 1e6:.1f} MB: {to}")
    foxglove, rviz = report.layouts
    typer.echo(f"{foxglove}: its layout for Foxglove (Layouts, Import from file)")
    typer.echo(f"{rviz}: for RViz (-d)")


# Where to, beside what is exported, unless --out says.
_OUT = {
    "colmap": "colmap",
    "euroc": "trajectory_euroc.csv",
    "kitti": "trajectory_kitti.txt",
    "nerfstudio": "nerfstudio",
    "octomap": "map.bt",
    "tum": "trajectory_tum.txt",
}


def export_in(asked: Asked, form: str) -> None:
    """Write a trajectory, images with poses, or a tree. Raises InputError."""
    from wheelsight.app.cli.options import check_out
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight_export import (
        DEFAULT_VOXEL_M,
        TRAJECTORY_FORMATS,
        export_colmap,
        export_nerfstudio,
        export_octomap,
        export_trajectory,
        exported_at,
    )

    if form not in _OUT:
        raise ConfigError(f"--format is {form!r}", fix=f"one of {', '.join(_OUT)}")
    is_trajectory = form in TRAJECTORY_FORMATS
    if asked.body is not None and not is_trajectory:
        raise ConfigError("--body is of trajectories alone", fix=f"no --body with --format {form}")
    if asked.voxel_m is not None and is_trajectory:
        raise ConfigError("--voxel is of maps alone", fix=f"no --voxel with --format {form}")
    source = exported_at(asked.source)
    to = asked.out or asked.source / _OUT[form]
    voxel_m = asked.voxel_m or DEFAULT_VOXEL_M
    if is_trajectory:
        check_out(to, asked.force)
        found = export_trajectory(source, form, to, asked.body)
        typer.echo(f"{len(found):,} poses, T_{found.frame}_{found.body}: {to}")
    elif form == "octomap":
        if to.suffix != ".bt":
            fix = "a binary tree is what is written"
            raise ConfigError(f"--out is {str(to)!r}, which does not end in .bt", fix=fix)
        check_out(to, asked.force)
        with FrameProgress("casting", None, unit="keyframes") as progress:
            count = export_octomap(source, to, voxel_m, progress.reach)
        typer.echo(f"{count:,} keyframes, {to.stat().st_size / 1e6:.1f} MB: {to}")
    else:
        write = export_nerfstudio if form == "nerfstudio" else export_colmap
        with FrameProgress("writing", None, unit="keyframes") as progress:
            count = write(source, to, voxel_m, asked.force, progress.reach)
        typer.echo(f"{count:,} images: {to}")


_VOXEL_M = 0.02


def export_surface(asked: Asked, is_mesh: bool) -> None:
    """Write surfels as points, or as triangles. Raises InputError."""
    from wheelsight.app.cli.compiling import compile_missing
    from wheelsight.app.cli.options import check_out
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.app.run import MAP_FILE
    from wheelsight.app.run.kernels import usable_parts
    from wheelsight.core.inputs import is_there
    from wheelsight.mapping import load_map
    from wheelsight.slam.maps import MAP_FOLDER, MapFolder, is_map
    from wheelsight_export.meshes import mesh_of, write_mesh_ply, write_ply

    if not is_there(asked.source):
        raise MapError("there is no such folder or file", path=asked.source, fix="check the path")
    if not asked.source.is_dir():
        path = asked.source
    else:
        # A run's folder, or that of its joined or dense track
        folders = [asked.source / place / inner for place in ("", "joined", "dense") for inner in ("", MAP_FOLDER)]
        files = [folder / MAP_FILE for folder in folders if is_there(folder / MAP_FILE)]
        if not files:
            fix = "make one: wheelsight run RECORDING --odometry dense --map surfels --out DIR"
            raise MapError(f"holds no {MAP_FILE}", path=asked.source, fix=fix)
        path = files[0]
    folder = path.parent if is_map(path.parent) else None
    to = asked.out or (path if folder is None else folder).parent / ("mesh.ply" if is_mesh else "points.ply")
    if to.suffix.lower() != ".ply":
        raise ConfigError(f"--out is {str(to)!r}, which does not end in .ply", fix="PLY is what is written")
    check_out(to, asked.force)
    found = None if folder is None else MapFolder.open(folder).surfels()  # at current poses
    surfel_map = load_map(path) if found is None else found
    if not is_mesh:
        what = f"{write_ply(surfel_map, to, stable_only=not asked.everything):,} points"
    else:
        compile_missing([part for part in usable_parts() if part == "mesh"])
        with FrameProgress("meshing", None, unit="chunks") as progress:
            mesh = mesh_of(surfel_map, asked.voxel_m or _VOXEL_M, not asked.everything, progress.reach)
        write_mesh_ply(mesh, to)
        what = f"{len(mesh.triangles):,} triangles of {len(mesh.vertices):,} points"
    typer.echo(f"{what}, {to.stat().st_size / 1e6:.1f} MB: {to}")
