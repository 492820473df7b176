"""A map without the keyframes that show nothing which others do not show, so that it does not grow day by day."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from wheelsight.errors import MapError
from wheelsight.files import StrPath
from wheelsight.geometry import IntArray, se3, so3
from wheelsight.keyframes import KeyframeId
from wheelsight.mapping import SurfelMap
from wheelsight.odometry.dense.grid import Level
from wheelsight.places.free_space import shown_share
from wheelsight.places.views import ViewMaker
from wheelsight.settings import PlaceVerificationSettings, RecognitionSettings
from wheelsight.slam.contraction import without
from wheelsight.slam.sessions.hanging import pieces_of
from wheelsight.slam.sessions.header import PRUNE
from wheelsight.slam.sessions.map_folder import MapFolder, make_room, map_being_made
from wheelsight.slam.sessions.occupancy import add_occupancy
from wheelsight.slam.sessions.parts import (
    MapParts,
    Progress,
    are_there,
    carried,
    new_numbers,
    recognizer_of,
    write_parts,
)


@dataclass(frozen=True, slots=True, eq=False)
class PrunedMap:
    """A map without some of its keyframes.

    Attributes:
        folder: the new map, open to read.
        left_out: how many keyframes it does not have.
    """

    folder: MapFolder
    left_out: int


def prune(
    folder: MapFolder,
    out: StrPath,
    recognition: RecognitionSettings | None = None,
    on_keyframe: Progress = lambda doing, done, total: None,
) -> PrunedMap:
    """Write a map into another folder without keyframes whose view another one shows; see `PruneSettings`.

    Those that stay are numbered anew and stay where they are. Edges of one that is left out are carried over to a
    neighbour, see `slam.contraction`; surfels that hung on it hang on the one that shows what it showed.

    Args:
        folder: an open map; it stays as it is.
        out: a folder that is empty or not there, or that a merge, rebuild or prune left when it was ended.
        recognition: or the defaults.
        on_keyframe: called with what is being done, how many keyframes are done, and of how many.

    Raises:
        MapError: there are no keyframes, or one cannot be read.
        OutputError: it cannot be written.
    """
    make_room(out)
    parts = MapParts.of(folder)
    if not len(parts):
        raise MapError("has no keyframes", path=folder.path, fix="give a map of a drive that kept some")
    shown_by = _shown_by(parts, folder, lambda done, total: on_keyframe("comparing", done, total))
    numbers = np.arange(len(parts))
    kept = np.flatnonzero(shown_by == numbers)
    edges = without(parts.edges, np.flatnonzero(shown_by != numbers).tolist())
    left = replace(parts, edges=edges).some(kept)
    recognizer = recognizer_of(left, recognition, on_keyframe)
    hangs_on = new_numbers(kept, len(parts))[shown_by]
    made = recognizer, _rehung(folder, left, hangs_on), carried(folder, kept)
    with map_being_made(out, PRUNE, folder) as new:
        write_parts(left, new, made, on_keyframe)
        add_occupancy(new, on_keyframe)
    return PrunedMap(MapFolder.open(out, settings=folder.settings), len(parts) - len(left))


def _shown_by(parts: MapParts, folder: MapFolder, on_keyframe: Callable[[int, int], None]) -> IntArray:
    """(N,) the keyframe that shows what each shows: itself, or an earlier one of the same piece that stays."""
    views, store, settings = ViewMaker(folder.calibration), parts.store(1), folder.settings.prune
    pieces, noise, free = pieces_of(parts, folder.settings), folder.calibration.depth_noise, PlaceVerificationSettings()
    T, shown_by = parts.T_map_keyframe, np.arange(len(parts))
    levels: list[Level] = []
    nearby = cKDTree(T[:, :3, 3]).query_ball_point(T[:, :3, 3], settings.near_m, return_sorted=True)
    for number in range(len(parts)):
        levels.append(views.of_keyframe(store[KeyframeId(number)]).grid.levels[-1])
        earlier = [k for k in nearby[number] if k < number and shown_by[k] == k and pieces[k] == pieces[number]]
        found = 0.0
        for other in earlier:
            T_other_this = se3.invert(T[other]) @ T[number]
            if so3.angle(T_other_this[:3, :3]) > settings.near_rad:
                continue
            share = shown_share(levels[number], levels[other], T_other_this, noise, free)
            if share >= settings.covered and share > found:
                found, shown_by[number] = share, other
        on_keyframe(number + 1, len(parts))
    return shown_by


def _rehung(folder: MapFolder, left: MapParts, hangs_on: IntArray) -> SurfelMap | None:
    """The map's surfels where they are, on keyframes (N,) of the new one; None where it has none."""
    old = folder.surfels()
    if old is None:
        return None
    surfels = old.surfels()
    # Of keyframes with numbers as the folder has them; of one that damage took surfels hang on nothing.
    of_parts = np.full(len(folder.store) + 1, -1)
    of_parts[np.flatnonzero(are_there(folder))] = hangs_on
    new = SurfelMap(old.settings)
    new.add(replace(surfels, keyframe=of_parts[surfels.keyframe].astype(np.int32)), old.stamp_s)
    new.restore(old.dropped, left.T_map_keyframe)
    return new
