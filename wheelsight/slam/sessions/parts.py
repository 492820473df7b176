"""MapParts: what a new map is made of: keyframes of other maps, which stay on disk, under numbers of their own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from wheelsight.geometry import BoolArray, FloatArray, IntArray
from wheelsight.keyframes import KeyframeId
from wheelsight.mapping import MapEdits, NamedPoses, SurfelMap
from wheelsight.places.recognition import Recognizer
from wheelsight.settings import RecognitionSettings
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.sessions.images import Size
from wheelsight.slam.sessions.journal import Record
from wheelsight.slam.sessions.kept import KeptKeyframes
from wheelsight.slam.sessions.map_folder import MapFolder
from wheelsight.slam.sessions.records import Place

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class MapParts:
    """Keyframes from 0 on without holes, where they are, and edges between them.

    Attributes:
        where: journal and record of each keyframe.
        places: where each was when it was kept.
        T_map_keyframe: (N, 4, 4) by now.
        edges: that hold.
        camera_px: width and height of their camera.
    """

    where: tuple[tuple[Path, Record], ...]
    places: tuple[Place, ...]
    T_map_keyframe: FloatArray
    edges: tuple[RelativePose, ...]
    camera_px: Size

    @classmethod
    def of(cls, folder: MapFolder) -> Self:
        """All keyframes of a map, in their order, but those that damage took, with image or pose."""
        kept = np.flatnonzero(are_there(folder))
        where, places = folder.contents.where, folder.contents.places
        records, at = [where[number] for number in kept.tolist()], [places[number] for number in kept.tolist()]
        numbers = new_numbers(kept, len(folder.store))
        T, edges = folder.store.T_map_keyframe[kept], renumbered(folder.edges, numbers)
        return cls(tuple(records), tuple(at), T, edges, folder.header.camera.size_px)

    def __len__(self) -> int:
        return len(self.where)

    def beside(self, other: MapParts) -> MapParts:
        """Both, the other one's keyframes after these."""
        shift = np.arange(len(other)) + len(self)
        T = np.concatenate([self.T_map_keyframe, other.T_map_keyframe])
        edges = (*self.edges, *renumbered(other.edges, shift))
        return MapParts((*self.where, *other.where), (*self.places, *other.places), T, edges, self.camera_px)

    def some(self, kept: Sequence[int] | IntArray) -> MapParts:
        """These keyframes alone, in ascending order, and edges between them."""
        rows = np.asarray(kept, np.int64)
        where, places = [self.where[row] for row in rows.tolist()], [self.places[row] for row in rows.tolist()]
        edges = renumbered(self.edges, new_numbers(rows, len(self)))
        return MapParts(tuple(where), tuple(places), self.T_map_keyframe[rows], edges, self.camera_px)

    def store(self, memory_keyframes: int) -> KeptKeyframes:
        """The keyframes, read when one asks for them."""
        return KeptKeyframes(dict(enumerate(self.where)), self.T_map_keyframe, memory_keyframes, self.camera_px)


def are_there(folder: MapFolder) -> BoolArray:
    """(N,) which keyframes of a map have both, image and pose."""
    there: BoolArray = np.asarray(np.isfinite(folder.store.T_map_keyframe).all(axis=(1, 2)))
    there[[int(number) for number in folder.store.missing]] = False
    return there


@dataclass(frozen=True, slots=True, eq=False)
class SaidOfMap:
    """What people said of a map: edits and names, which hang on its keyframes."""

    edits: MapEdits
    poses: NamedPoses

    def save(self, folder: MapFolder) -> None:
        """Keep them in a map that is open to write. Raises OutputError."""
        if len(self.edits):
            folder.save_edits(self.edits)
        if len(self.poses):
            folder.save_named_poses(self.poses)


def edits_as_known(folder: MapFolder) -> MapEdits:
    """The edits of a map; one that hung on a keyframe that damage took is where it was drawn. Raises MapError."""
    return folder.map_edits().carried(folder.store.T_map_keyframe, _own_numbers(folder))


def names_as_known(folder: MapFolder) -> NamedPoses:
    """The named poses of a map, likewise. Raises MapError."""
    return folder.named_poses().carried(folder.store.T_map_keyframe, _own_numbers(folder))


def _own_numbers(folder: MapFolder) -> IntArray:
    """(K,) of keyframes that stay in a map; -1 of those that damage took."""
    there = are_there(folder)
    return np.where(there, np.arange(len(there)), -1)


def carried(folder: MapFolder, kept: IntArray, first: int = 0, *, is_same_frame: bool = True) -> SaidOfMap:
    """What people said of a map for one that is made of its parts, see `MapEdits.carried`. Raises MapError.

    Args:
        folder: of which they said it.
        kept: rows of the new map's parts that are kept, in ascending order.
        first: row of the folder's first keyframe in these parts.
        is_same_frame: whether the new map has the folder's frame.
    """
    there = np.flatnonzero(are_there(folder))
    numbers = np.full(len(folder.store), -1)
    of_kept = new_numbers(kept, max(int(kept.max(initial=-1)) + 1, first + len(there)))
    numbers[there] = of_kept[first : first + len(there)]
    T = folder.store.T_map_keyframe
    edits = folder.map_edits().carried(T, numbers, is_same_frame=is_same_frame)
    return SaidOfMap(edits, folder.named_poses().carried(T, numbers, is_same_frame=is_same_frame))


def new_numbers(kept: IntArray, count: int) -> IntArray:
    """(count,) the number that each keyframe gets where these alone are kept; -1 for the others."""
    numbers = np.full(count, -1)
    numbers[kept] = np.arange(len(kept))
    return numbers


def renumbered(edges: Sequence[RelativePose], numbers: IntArray) -> tuple[RelativePose, ...]:
    """Edges between keyframes that have a new number (N,), others left out."""
    ends = ((edge, int(numbers[edge.first]), int(numbers[edge.second])) for edge in edges)
    return tuple(
        replace(edge, first=KeyframeId(first), second=KeyframeId(second))
        for edge, first, second in ends
        if min(first, second) >= 0
    )


def write_parts(
    parts: MapParts, new: MapFolder, made: tuple[Recognizer, SurfelMap | None, SaidOfMap], on_keyframe: Progress
) -> None:
    """Write parts into a map that has nothing yet.

    Args:
        parts: what to write.
        new: see `map_being_made`.
        made: of the keyframes: what recognises them, surfels that hang on them, and what people said.
        on_keyframe: called with what is being done, how many keyframes are done, and of how many.

    Raises MapError where a keyframe cannot be read, and OutputError.
    """
    recognizer, surfel_map, said = made
    store = parts.store(new.settings.memory_keyframes)
    for number, place in enumerate(parts.places):
        new.append_keyframe(number, store[KeyframeId(number)], parts.T_map_keyframe[number], place.T_odom_keyframe)
        on_keyframe("writing", number + 1, len(parts))
    new.append_edges(parts.edges)
    new.save_recognition(recognizer)
    if surfel_map is not None:
        new.save_surfels(surfel_map)
    said.save(new)


def recognizer_of(parts: MapParts, settings: RecognitionSettings | None, on_keyframe: Progress) -> Recognizer:
    """What recognises the keyframes of parts, made anew."""
    store, made = parts.store(1), Recognizer(settings)
    for number in store:
        made.add(number, store[number])
        on_keyframe("recognition", number + 1, len(parts))
    return made
