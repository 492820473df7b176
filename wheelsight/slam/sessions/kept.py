"""KeptKeyframes: a map's keyframes, which rest on disk until one asks for them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry import FloatArray
from wheelsight.geometry.arrays import UInt64Array
from wheelsight.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.slam.sessions import old_records
from wheelsight.slam.sessions.images import Size
from wheelsight.slam.sessions.journal import Record, read_record
from wheelsight.slam.sessions.keyframe_records import unpack_descriptors, unpack_keyframe
from wheelsight.slam.sessions.records import Kind

_LOST = "use another copy of the map, or go on without this keyframe"


class KeptKeyframes(KeyframeStore):
    """A store whose first keyframes are those of a map folder; more may be added.

    Those asked for last are held in memory, and the others read again: see `KeyframeStore.hold`. Going over the store
    leaves out keyframes that damage took from the folder: they keep their numbers, and asking for one raises MapError.

    Args:
        where: journal and record of each keyframe, by number.
        T_map_keyframe: (N, 4, 4) of all; NaN where damage took the pose too.
        memory_keyframes: how many are held in memory, at most.
        camera_px: width and height of the map's camera; larger images are none of its keyframes.
    """

    def __init__(
        self,
        where: Mapping[int, tuple[Path, Record]],
        T_map_keyframe: FloatArray,
        memory_keyframes: int,
        camera_px: Size,
    ) -> None:
        super().__init__()
        count = len(T_map_keyframe)
        self.hold(memory_keyframes)
        self._lost = frozenset(range(count)) - where.keys()
        self._keyframes = [None] * count
        self._readers = {number: partial(read_keyframe, *found, camera_px) for number, found in where.items()}
        room = np.zeros((max(16, count), 4, 4))
        room[:count] = T_map_keyframe
        self._T_map_keyframe = room

    @property
    def missing(self) -> tuple[KeyframeId, ...]:
        """The keyframes that damage took."""
        return tuple(KeyframeId(number) for number in sorted(self._lost))

    def __iter__(self) -> Iterator[KeyframeId]:
        return (KeyframeId(number) for number in range(len(self)) if number not in self._lost)

    def __getitem__(self, number: KeyframeId) -> Keyframe:
        """Raises ArgumentError for a keyframe that it does not hold, and MapError where it cannot be read."""
        if number in self._lost:
            raise MapError(f"keyframe {number} is lost", fix=_LOST)
        return super().__getitem__(number)


def read_keyframe(path: Path, record: Record, camera_px: Size) -> Keyframe:
    """The keyframe of a record, of images as large as its camera's at most. Raises MapError, naming file and place."""
    unpack = old_records.unpack_keyframe if record.kind == Kind.FIRST_KEYFRAME else unpack_keyframe
    try:
        return unpack(read_record(path, record), camera_px)
    except MapError as error:
        problem = error.problem if error.path is not None else f"its record at byte {record.offset:,} {error.problem}"
        raise MapError(problem, path=path, fix=error.fix) from error


def read_descriptors(path: Path, record: Record) -> UInt64Array:
    """The descriptors (N, 4) alone of the keyframe of a record. Raises MapError."""
    content = read_record(path, record)
    is_first = record.kind == Kind.FIRST_KEYFRAME
    return old_records.unpack_descriptors(content) if is_first else unpack_descriptors(content)
