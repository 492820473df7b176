"""What `wheelsight export --bag` does."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import typer

from wheelsight.cli._exporting import Asked


def export_to_bag(asked: Asked, to: Path) -> None:
    """Write a bag with its layouts, and say what is in it. Raises InputError."""
    from wheelsight.cli._console import print_warning
    from wheelsight.cli._outputs import check_out
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.errors import ConfigError
    from wheelsight.exports import DEFAULT_VOXEL_M, BagParts, export_bag, exported_at
    from wheelsight.exports.layouts import layout_paths
    from wheelsight.recordings.rosbag.robot_topics import ImageForm
    from wheelsight.recordings.rosbag.writing import check_bag_name, check_library

    if asked.images is not None and asked.images not in get_args(ImageForm):
        raise ConfigError(f"--images is {asked.images!r}", fix=f"one of {', '.join(get_args(ImageForm))}")
    check_bag_name(to)
    check_library()
    source = exported_at(asked.source)
    _refuse_itself(asked.source, to)
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


def _refuse_itself(source: Path, to: Path) -> None:
    """Raises OutputError where a bag would be written over what it is made of."""
    from wheelsight.errors import OutputError

    if to.exists() and source.exists() and to.samefile(source):
        raise OutputError("is what is to be exported", path=to, fix="choose another name")
