"""What the words of goals mean in a map: names, areas and coordinates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import TYPE_CHECKING

from wheelsight.errors import MapError

if TYPE_CHECKING:
    from wheelsight.geometry import FloatArray
    from wheelsight.mapping import MapEdit, MapEdits, NamedPoses, OccupancyGrid
    from wheelsight.slam.sessions import MapFolder


def poses_of(words: Sequence[str], folder: MapFolder) -> list[FloatArray]:
    """(3,) of each goal as people write it: a name of the map, an area of it, or coordinates.

    A yaw of NaN is any heading. A name that a place and an area have is the place's; of an area it is where there is
    most room.

    Raises:
        ConfigError: coordinates that are none.
        MapError: a name that the map does not have; tells the nearest and all. An area without free floor.
    """
    from wheelsight.cli._map_export import grid_of
    from wheelsight.cli._map_names import names_of
    from wheelsight.slam.sessions.parts import edits_as_known

    names, edits = names_of(folder), edits_as_known(folder)
    # Made once, and only where an area is asked for: it takes seconds.
    grid = cache(partial(grid_of, folder))
    return [_goal_of(word, names, edits, folder, grid) for word in words]


def _goal_of(
    word: str, names: NamedPoses, edits: MapEdits, folder: MapFolder, grid: Callable[[], OccupancyGrid]
) -> FloatArray:
    from wheelsight.cli._map_names import pose_of
    from wheelsight.mapping.place_names import unknown_name

    if word in names.names:
        return names.named(word).pose_now(folder.store.T_map_keyframe)
    for area in edits.areas:
        if area.name == word:
            return _goal_in(area, folder, grid)
    if "," in word:
        return pose_of("--to", word)
    raise unknown_name(word, {*names.names, *edits.area_names})


def _goal_in(area: MapEdit, folder: MapFolder, grid: Callable[[], OccupancyGrid]) -> FloatArray:
    """(3,) where in an area of a map there is most room, with any heading.

    Raises:
        MapError: no free floor of the map lies in it.
    """
    import numpy as np

    from wheelsight.mapping import roomiest_place

    at = roomiest_place(grid(), area.polygon_now(folder.store.T_map_keyframe))
    if at is None:
        fix = (
            f"wheelsight map zone MAP --area '{area.name}' X,Y X,Y X,Y draws it anew; "
            "wheelsight map export MAP --picture plan.png shows where the map has free floor"
        )
        raise MapError(f"no free floor of the map lies in the area {area.name!r}", path=folder.path, fix=fix)
    return np.array([*at, np.nan])
