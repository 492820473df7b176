"""Bags of ROS 1 by the index at their end alone: an hour's has some hundred thousand chunks, each read when it is due.

rosbags' own reader looks at every chunk and every message's place before it answers: 13 s for such a bag.
Records and compression are rosbags'; format: https://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import heapq
import struct
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from io import BytesIO
from itertools import accumulate
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from wheelsight.errors import RecordingError
from wheelsight.extras import needed

_CHUNK_INFO, _MESSAGE = 6, 2
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
_TIME = struct.Struct("<II")
_FIELD = b"chunk_pos="


class _Chunk(NamedTuple):
    """Times of a chunk's first and last message, its place in the file, its connections, and how many messages of each.

    Tuples of numbers alone: of so many objects, the garbage collector must not look at each again and again.
    """

    start_ns: int
    end_ns: int
    place: int
    connections: tuple[int, ...]
    counts: tuple[int, ...]


class Ros1Reader:
    """As rosbags' readers are, as far as `OpenBag` uses them."""

    def __init__(self, path: Path) -> None:
        self._format = needed("rosbags.rosbag1.reader")
        self._rosbags = self._format.Reader(path)
        self.connections: list[Any] = []
        self._chunks: list[_Chunk] = []
        self._ended_ns: list[int] = []  # the latest end of each chunk and those before it

    def __enter__(self) -> Ros1Reader:
        self._file = self._rosbags.bio = self._rosbags.path.open("rb")
        try:
            self._read_index()
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    @property
    def message_count(self) -> int:
        """Of all connections."""
        return sum(connection.msgcount for connection in self.connections)

    @property
    def start_time(self) -> int:
        """Nanoseconds of the first message."""
        return min((chunk.start_ns for chunk in self._chunks), default=0)

    @property
    def end_time(self) -> int:
        """Just after the last."""
        return max((chunk.end_ns for chunk in self._chunks), default=-1) + 1

    def messages(
        self, connections: Sequence[Any], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Any, int, bytes]]:
        """Connection, time and bytes of messages from `start` on and before `stop`, in order of time."""
        wanted = {connection.id: connection for connection in connections}
        start_ns, stop_ns = start or 0, 1 << 63 if stop is None else stop
        waiting: list[tuple[int, int, int, bytes]] = []
        number = 0
        for at in range(bisect_left(self._ended_ns, start_ns), len(self._chunks)):
            chunk = self._chunks[at]
            if chunk.start_ns >= stop_ns:
                break
            if chunk.end_ns < start_ns or wanted.keys().isdisjoint(chunk.connections):
                continue
            while waiting and waiting[0][0] < chunk.start_ns:
                time_ns, _, connection, data = heapq.heappop(waiting)
                yield wanted[connection], time_ns, data
            for connection, time_ns, data in self._messages_of(chunk):
                if connection in wanted and start_ns <= time_ns < stop_ns:
                    heapq.heappush(waiting, (time_ns, number, connection, data))
                    number += 1
        while waiting:
            time_ns, _, connection, data = heapq.heappop(waiting)
            yield wanted[connection], time_ns, data

    def _read_index(self) -> None:
        magic = self._file.readline(64)
        if not magic:
            raise RecordingError("is empty", path=self._rosbags.path, fix="record again")
        if magic != b"#ROSBAG V2.0\n":
            raise RecordingError("is no bag of ROS 1, version 2.0", path=self._rosbags.path, fix="check what wrote it")
        header = self._format.Header.read(self._file, self._format.RecordType.BAGHEADER)
        place, count = header.get_uint64("index_pos"), header.get_uint32("chunk_count")
        if place == 0:
            raise self._format.ReaderError("Bag is not indexed")
        if count == 0:
            return
        self._file.seek(place)
        try:
            known = [self._rosbags.read_connection() for _ in range(header.get_uint32("conn_count"))]
            self._chunks = sorted(_chunk_infos(self._file.read(), count), key=attrgetter("start_ns"))
        except (self._format.ReaderError, struct.error, LookupError, ValueError) as error:
            raise self._format.ReaderError(f"Bag index looks damaged: {error}") from error
        self._ended_ns = list(accumulate((chunk.end_ns for chunk in self._chunks), max))
        counts = dict.fromkeys((connection.id for connection in known), 0)
        for chunk in self._chunks:
            for connection, messages in zip(chunk.connections, chunk.counts, strict=True):
                counts[connection] = counts.get(connection, 0) + messages
        self.connections = [connection._replace(msgcount=counts[connection.id]) for connection in known]

    def _messages_of(self, chunk: _Chunk) -> Iterator[tuple[int, int, bytes]]:
        """Connection, time and bytes of each message in a chunk, in the order of the file."""
        self._file.seek(chunk.place)
        about = self._rosbags.read_chunk()
        self._file.seek(about.datapos)
        records = BytesIO(about.decompressor(self._format.read_bytes(self._file, about.datasize)))
        size = len(records.getbuffer())
        while records.tell() < size:
            header = self._format.Header.read(records)
            data = self._format.read_bytes(records, self._format.read_uint32(records))
            if header.get_uint8("op") == _MESSAGE:
                yield header.get_uint32("conn"), header.get_time("time"), data


def _chunk_infos(data: bytes, count: int) -> Iterator[_Chunk]:
    """The records of an index that tell of chunks. Raises struct.error, LookupError or ValueError where they do not."""
    at, places = 0, dict[bytes, int]()
    for _ in range(count):
        (size,) = _U32.unpack_from(data, at)
        header, at = data[at + 4 : at + 4 + size], at + 4 + size
        # One writer puts all fields in one order: they are looked for once.
        if not places or not header.startswith(_FIELD, places[_FIELD] - len(_FIELD)):
            places = _places_in(header)
        (size,) = _U32.unpack_from(data, at)
        if header[places[b"op="]] != _CHUNK_INFO or at + 4 + size > len(data):
            raise ValueError(f"a record of the index at {at} tells of no chunk")
        start_s, start_ns = _TIME.unpack_from(header, places[b"start_time="])
        end_s, end_ns = _TIME.unpack_from(header, places[b"end_time="])
        (place,) = _U64.unpack_from(header, places[_FIELD])
        words = struct.unpack_from(f"<{size // 8 * 2}I", data, at + 4)
        yield _Chunk(start_s * 10**9 + start_ns, end_s * 10**9 + end_ns, place, words[::2], words[1::2])
        at += 4 + size


def _places_in(header: bytes) -> dict[bytes, int]:
    """Where the value of each field that a chunk's record needs begins."""
    found, at = {}, 0
    while at < len(header):
        (size,) = _U32.unpack_from(header, at)
        name = header[at + 4 : at + 4 + size].partition(b"=")[0] + b"="
        found[name] = at + 4 + len(name)
        at += 4 + size
    return {name: found[name] for name in (b"op=", b"start_time=", b"end_time=", _FIELD)}
