"""The occupancy map of a map folder: of its keyframes where they are by now, with its edits, as map_server reads it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry import FloatArray
from wheelsight.keyframes import KeyframeId
from wheelsight.mapping import OccupancyGrid, OccupancyMapper, OccupancySettings
from wheelsight.ros_map import write_ros_map
from wheelsight.slam.sessions.hanging import is_sure, lie_together
from wheelsight.slam.sessions.map_folder import OCCUPANCY_FILE, MapFolder
from wheelsight.slam.sessions.parts import edits_as_known

Progress = Callable[[int, int], None]

# On a step of a metre in which the robot turned by 90 degrees it was 0.2 m beside the straight line, on a longer one it
# may have been behind a wall.
_STRAIGHT_M = 1.0


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


def add_occupancy(new: MapFolder, on_keyframe: Callable[[str, int, int], None]) -> None:
    """Write the occupancy map of one that is being made, if it can be made: a map is whole without it.

    Why there is none `occupancy_of` says. Raises OutputError.
    """
    with suppress(MapError):
        so_far = MapFolder.open(new.path, settings=new.settings, is_incomplete_read=True)
        save_occupancy(so_far, lambda done, total: on_keyframe("occupancy", done, total))


def driven_way(folder: MapFolder) -> tuple[FloatArray, ...]:
    """Stretches (K, 3) of x, y, yaw of the base at the keyframes of a map that lie together; of no base, the camera.

    Within a stretch the robot drove from each to the next, about straight. Between stretches nobody knows where it
    drove, or it was another drive.
    """
    numbers = np.flatnonzero(lie_together(folder))
    if not len(numbers):
        return ()
    T = folder.store.T_map_keyframe[numbers]
    if folder.calibration.T_base_camera is not None:
        T = T @ np.linalg.inv(folder.calibration.T_base_camera)
    at = np.column_stack([T[:, :2, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])])
    driven = {
        (int(edge.first), int(edge.second))
        for edge in folder.edges
        if not edge.is_loop and is_sure(edge, folder.settings)
    }
    is_step = np.array([ends in driven for ends in pairwise(numbers.tolist())], bool)  # empty for one keyframe
    is_step &= np.linalg.norm(np.diff(at[:, :2], axis=0), axis=1) <= _STRAIGHT_M
    return tuple(np.split(at, np.flatnonzero(~is_step) + 1))
