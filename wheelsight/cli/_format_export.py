"""What `wheelsight export --format` does."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wheelsight.cli._exporting import Asked

if TYPE_CHECKING:
    from wheelsight.exports import Exported

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
    from wheelsight.errors import ConfigError
    from wheelsight.exports import TRAJECTORY_FORMATS, exported_at

    if form not in _OUT:
        raise ConfigError(f"--format is {form!r}", fix=f"one of {', '.join(_OUT)}")
    is_trajectory = form in TRAJECTORY_FORMATS
    if asked.body is not None and not is_trajectory:
        raise ConfigError("--body is of trajectories alone", fix=f"no --body with --format {form}")
    if asked.voxel_m is not None and is_trajectory:
        raise ConfigError("--voxel is of maps alone", fix=f"no --voxel with --format {form}")
    source = exported_at(asked.source)
    to = asked.out or asked.source / _OUT[form]
    if is_trajectory:
        _trajectory(source, form, to, asked)
    elif form == "octomap":
        _octomap(source, to, asked)
    else:
        _images(source, form, to, asked)


def _trajectory(source: Exported, form: str, to: Path, asked: Asked) -> None:
    from wheelsight.cli._outputs import check_out
    from wheelsight.exports import export_trajectory

    check_out(to, asked.force)
    found = export_trajectory(source, form, to, asked.body)
    typer.echo(f"{len(found):,} poses, T_{found.frame}_{found.body}: {to}")


def _images(source: Exported, form: str, to: Path, asked: Asked) -> None:
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.exports import DEFAULT_VOXEL_M, export_colmap, export_nerfstudio

    write = export_nerfstudio if form == "nerfstudio" else export_colmap
    with FrameProgress("writing", None, unit="keyframes") as progress:
        count = write(source, to, asked.voxel_m or DEFAULT_VOXEL_M, asked.force, progress.reach)
    typer.echo(f"{count:,} images: {to}")


def _octomap(source: Exported, to: Path, asked: Asked) -> None:
    from wheelsight.cli._outputs import check_out
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.errors import ConfigError
    from wheelsight.exports import DEFAULT_VOXEL_M, export_octomap

    if to.suffix != ".bt":
        raise ConfigError(f"--out is {str(to)!r}, which does not end in .bt", fix="a binary tree is what is written")
    check_out(to, asked.force)
    with FrameProgress("casting", None, unit="keyframes") as progress:
        count = export_octomap(source, to, asked.voxel_m or DEFAULT_VOXEL_M, progress.reach)
    typer.echo(f"{count:,} keyframes, {to.stat().st_size / 1e6:.1f} MB: {to}")
