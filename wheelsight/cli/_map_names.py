"""What `wheelsight map name` does, and how poses are written."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wheelsight.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.geometry import FloatArray
    from wheelsight.mapping import NamedPose, NamedPoses
    from wheelsight.slam.sessions import MapFolder

_FORM = "X,Y,YAW_DEG in metres and degrees, such as 3.2,1.5,90; or X,Y for any heading"


def change(source: Path, called: str, at: str | None) -> None:
    """Name a place, or forget the name where it is nowhere. Raises ConfigError, MapError, OutputError."""
    from wheelsight.mapping import NamedPose
    from wheelsight.slam.sessions import MapFolder, find_map, lie_together

    pose = None if at is None else pose_of("--at", at)
    folder = MapFolder.open(find_map(source), read_only=False)
    try:
        known = folder.named_poses()
        if pose is None:
            folder.save_named_poses(known.without(called))
            typer.echo(f"forgotten: {called}")
            return
        # On a keyframe of which nobody knows where it lies it would go astray.
        sure = lie_together(folder).nonzero()[0]
        hung = NamedPose(called, pose).hung_on_nearest(folder.store.T_map_keyframe, sure)
        folder.save_named_poses(known.with_pose(hung))
        on = "no keyframe" if hung.keyframe is None else f"keyframe {hung.keyframe}"
        typer.echo(f"{hung.name} is at {told(pose)}, and moves with {on}")
        _warn_where_nobody_saw(hung)
    finally:
        folder.close()


def _warn_where_nobody_saw(place: NamedPose) -> None:
    """A place farther from all keyframes than floor is taken from them was probably mistyped."""
    from wheelsight.cli._console import print_warning
    from wheelsight.mapping import OccupancySettings

    if place.T_map_keyframe is None:
        return
    off_m = math.dist(place.pose[:2], place.T_map_keyframe[:2, 3])
    far_m = OccupancySettings().far_m
    if off_m > far_m:
        print_warning(
            f"{place.name} is {off_m:.1f} m from the nearest keyframe, which shows the floor to {far_m:g} m: "
            "no way will lead there (wheelsight map export MAP --picture plan.png shows the map)"
        )


def print_names(folder: MapFolder) -> None:
    """All names of a map, each with where it is by now."""
    from wheelsight.cli._console import console, facts_table

    where = places_of(folder)
    if not where:
        typer.echo("the map has no names: wheelsight map name MAP NAME --at X,Y,YAW_DEG")
        return
    console().print(facts_table("places", ((name, told(pose)) for name, pose in where.items())))


def places_of(folder: MapFolder) -> dict[str, FloatArray]:
    """(3,) of each name where it is by now. Raises MapError."""
    return {one.name: one.pose_now(folder.store.T_map_keyframe) for one in names_of(folder)}


def names_of(folder: MapFolder) -> NamedPoses:
    """All that hang on keyframes that are there. Raises MapError."""
    from wheelsight.slam.sessions.parts import names_as_known

    return names_as_known(folder)


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


def told(pose: FloatArray) -> str:
    """Such as "3.20, 1.50 m, 90°"."""
    yaw = "any heading" if math.isnan(pose[2]) else f"{math.degrees(pose[2]):.0f}°"
    return f"{pose[0]:.2f}, {pose[1]:.2f} m, {yaw}"
