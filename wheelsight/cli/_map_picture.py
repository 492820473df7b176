"""The picture that `wheelsight map export` makes of a map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from wheelsight.mapping import OccupancyGrid
    from wheelsight.mapping.occupancy_picture import PlanLine, PlanMark
    from wheelsight.slam.sessions import MapFolder


def write_picture(grid: OccupancyGrid, folder: MapFolder, out: Path) -> None:
    """The plan, with axes, the way of its drives, and what people said of it. Raises OutputError."""
    from wheelsight.mapping.occupancy_picture import picture_of, save_picture
    from wheelsight.slam.sessions import driven_way

    image = picture_of(grid, [stretch[:, :2] for stretch in driven_way(folder)], *_said_of(folder), has_axes=True)
    save_picture(image, out)
    # By which corners of zones can be read off it.
    (x, y), (rows, columns) = grid.origin, grid.kind.shape
    reach = f"x {x:.2f} to {x + columns * grid.resolution_m:.2f} m, y {y:.2f} to {y + rows * grid.resolution_m:.2f} m"
    typer.echo(f"{image.shape[1]} × {image.shape[0]} pixels: {out}; above its legend {reach}")


def _said_of(folder: MapFolder) -> tuple[list[PlanLine], list[PlanMark]]:
    """Outlines of areas and of zones, and the places that have a name."""
    from wheelsight.mapping import EditKind
    from wheelsight.mapping.occupancy_picture import PlanLine, PlanMark
    from wheelsight.slam.sessions.parts import edits_as_known, names_as_known

    T, drawn = folder.store.T_map_keyframe, {EditKind.AREA: (0, 158, 115), EditKind.SPEED: (230, 159, 0)}
    lines = []
    for edit in edits_as_known(folder).edits:
        if edit.kind in drawn:
            corners = edit.polygon_now(T)
            called = edit.name or f"{edit.limit_m_s:g} m/s"
            kind = "area" if edit.name else "speed zone"
            lines.append(PlanLine([*corners, corners[0]], drawn[edit.kind], kind, text=called))
    names = names_as_known(folder)
    places = [(name, names.named(name).pose_now(T)[:2]) for name in names.names]
    return lines, [PlanMark(xy, "square", drawn[EditKind.AREA], "place", name) for name, xy in places]
