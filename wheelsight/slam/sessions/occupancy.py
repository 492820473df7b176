"""The occupancy map of a map folder: of its keyframes where they are by now, with its edits, as map_server reads it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry import FloatArray
from wheelsight.keyframes import KeyframeId
from wheelsight.mapping import OccupancyGrid, OccupancyMapper, OccupancySettings
from wheelsight.ros_map import write_ros_map
from wheelsight.slam.sessions.hanging import lie_together
from wheelsight.slam.sessions.map_folder import OCCUPANCY_FILE, MapFolder
from wheelsight.slam.sessions.parts import edits_as_known

Progress = Callable[[int, int], None]


def occupancy_of(
    folder: MapFolder,
    settings: OccupancySettings | None = None,
    on_keyframe: Progress = lambda done, total: None,
    mapper: OccupancyMapper | None = None,
) -> OccupancyGrid:
    """The floor of a map, with what its edits say.

    It is of the largest part that hangs together by edges that are sure: where another part lies nobody knows.

    Args:
        folder: an open map.
        settings: or the map's.
        on_keyframe: called with how many are read, and of how many, where any is to be.
        mapper: that keeps some of its keyframes already, and is of these settings.

    Raises:
        MapError: the calibration does not say where the camera sits, a keyframe or the edits cannot be read, or the map
            would have too many cells.
    """
    made = mapper or OccupancyMapper(folder.calibration, settings or folder.settings.occupancy)
    together = lie_together(folder)
    todo = [KeyframeId(int(number)) for number in np.flatnonzero(together) if number not in made]
    for done, number in enumerate(todo, start=1):
        made.keep(number, folder.store[number])
        on_keyframe(done, len(todo))
    made.move(folder.store.T_map_keyframe, together)
    return edits_as_known(folder).applied(made.grid(), folder.store.T_map_keyframe)


def save_occupancy(
    folder: MapFolder, on_keyframe: Progress = lambda done, total: None, mapper: OccupancyMapper | None = None
) -> OccupancyGrid | None:
    """Write the occupancy map of an open map into its folder; None where nobody knows where the camera sits.

    Raises as `occupancy_of` does, and OutputError.
    """
    if folder.calibration.T_base_camera is None:
        return None
    grid = occupancy_of(folder, None, on_keyframe, mapper)
    write_ros_map(grid.to_ros(), folder.path / OCCUPANCY_FILE)
    return grid


def with_occupancy(folder: MapFolder, on_keyframe: Callable[[str, int, int], None]) -> MapFolder:
    """A new map, whose occupancy map is written by now, if it can be made: a map is whole without it.

    Why there is none `occupancy_of` says. Raises OutputError.
    """
    with suppress(MapError):
        save_occupancy(folder, lambda done, total: on_keyframe("occupancy", done, total))
    return folder


def driven_way(folder: MapFolder) -> FloatArray:
    """(N, 2) where the base was at the keyframes of a map that lie together, in their order; of no base, the camera."""
    T = folder.store.T_map_keyframe[lie_together(folder)]
    if folder.calibration.T_base_camera is not None:
        T = T @ np.linalg.inv(folder.calibration.T_base_camera)
    return T[:, :2, 3]
