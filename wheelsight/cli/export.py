"""`wheelsight export`: a run, its map or a recording for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Out = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Where to; a folder for nerfstudio and colmap.", show_default="beside the map"),
]
Voxel = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        min=0.001,
        max=10,
        help="How fine a mesh, or points or cells of a map, are.",
        show_default="0.02 of a mesh, else 0.05",
    ),
]
Format = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="NAME",
        help="tum, kitti, euroc: the trajectory. nerfstudio, colmap: images of keyframes with poses. octomap: a tree.",
        show_default=False,
    ),
]
Images = Annotated[
    str | None,
    typer.Option(
        "--images",
        metavar="raw|png|jpeg",
        help="Camera images into the bag: exactly; or compressed, depth to millimetres.",
        show_default="none",
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
    from wheelsight.cli._exporting import Asked, check_asked
    from wheelsight.errors import ConfigError

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
        from wheelsight.cli._surface_export import export_surface

        export_surface(asked, mesh)
    elif bag is not None:
        from wheelsight.cli._bag_export import export_to_bag

        export_to_bag(asked, bag)
    elif form is not None:
        from wheelsight.cli._format_export import export_in

        export_in(asked, form)
