"""KeptKeyframes: a map's keyframes, which rest on disk until one asks for them."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry import FloatArray
from wheelsight.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.slam.sessions.journal import Record, read_record
from wheelsight.slam.sessions.records import unpack_keyframe

_RESTS = Keyframe(0.0, np.zeros(4), b"", b"")
_LOST = "use another copy of the map, or go on without this keyframe"


class KeptKeyframes(KeyframeStore):
    """A store whose first keyframes are those of a map folder; more may be added, and stay in memory.

    Those asked for last are held in memory, and the others read again. Going over the store leaves out keyframes that
    damage took from the folder: they keep their numbers, and asking for one raises MapError.

    Args:
        where: journal and record of each keyframe, by number.
        T_map_keyframe: (N, 4, 4) of all; NaN where damage took the pose too.
        memory_keyframes: how many are held in memory, at most.
    """

    def __init__(
        self, where: Mapping[int, tuple[Path, Record]], T_map_keyframe: FloatArray, memory_keyframes: int
    ) -> None:
        super().__init__()
        self._where, self._most = dict(where), memory_keyframes
        self._keyframes = [_RESTS] * len(T_map_keyframe)
        room = np.zeros((max(16, len(T_map_keyframe)), 4, 4))
        room[: len(T_map_keyframe)] = T_map_keyframe
        self._T_map_keyframe = room
        self._held: OrderedDict[int, Keyframe] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def missing(self) -> tuple[KeyframeId, ...]:
        """The keyframes that damage took."""
        return tuple(KeyframeId(number) for number in range(len(self)) if not self._is_there(number))

    def __iter__(self) -> Iterator[KeyframeId]:
        return (KeyframeId(number) for number in range(len(self)) if self._is_there(number))

    def __getitem__(self, number: KeyframeId) -> Keyframe:
        """Raises ArgumentError for a keyframe that it does not hold, and MapError where it cannot be read."""
        self._check([number])
        if self._keyframes[number] is not _RESTS:
            return super().__getitem__(number)
        with self._lock:
            held = self._held.get(number)
            if held is not None:
                self._held.move_to_end(number)
                return held
        read = self._read(number)
        with self._lock:
            self._held[number] = read
            while len(self._held) > self._most:
                self._held.popitem(last=False)
        return read

    def _is_there(self, number: int) -> bool:
        return self._keyframes[number] is not _RESTS or number in self._where

    def _read(self, number: KeyframeId) -> Keyframe:
        if number not in self._where:
            raise MapError(f"keyframe {number} is lost", fix=_LOST)
        path, record = self._where[number]
        try:
            return unpack_keyframe(read_record(path, record))
        except MapError as error:
            problem = (
                error.problem if error.path is not None else f"its record at byte {record.offset:,} {error.problem}"
            )
            raise MapError(problem, path=path, fix=error.fix) from error
