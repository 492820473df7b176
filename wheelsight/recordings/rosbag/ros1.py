"""Bags of ROS 1 by the index at their end alone: an hour's has some hundred thousand chunks, each read when it is due.

rosbags' own reader looks at every chunk and every message's place before it answers: 13 s for such a bag. It also
unpacks whatever a chunk holds. Records are read by rosbags; format: https://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

from wheelsight.errors import RecordingError
from wheelsight.extras import needed
from wheelsight.recordings.rosbag.chunks import MOST_INDEX, Chunk, ChunkedReader, Record
from wheelsight.recordings.rosbag.definitions import MOST_CONNECTIONS, Connection

_MAGIC = b"#ROSBAG V2.0\n"
_CHUNK_INFO, _MESSAGE, _CHUNK = 6, 2, 5
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
_TIME = struct.Struct("<II")
_INFO_FIELDS = (b"op=", b"start_time=", b"end_time=", b"chunk_pos=")
_MESSAGE_FIELDS = (b"op=", b"conn=", b"time=")
_MOST_HEADER = 1 << 20
_WAYS = {"none": "", "bz2": "bz2", "lz4": "lz4"}


class Ros1Reader(ChunkedReader):
    """As `ChunkedReader` has it. Raises ConfigError where rosbags is not installed."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._format = needed("rosbags.rosbag1.reader")

    def _read_index(self) -> list[Chunk]:
        magic = self._file.read(len(_MAGIC))
        if not magic:
            raise RecordingError("is empty", path=self.path, fix="record again")
        if magic != _MAGIC:
            raise RecordingError("is no bag of ROS 1, version 2.0", path=self.path, fix="check what wrote it")
        header = self._format.Header.read(BytesIO(self._header()), self._format.RecordType.BAGHEADER)
        place, count = header.get_uint64("index_pos"), header.get_uint32("chunk_count")
        if header.get("encryptor"):
            raise RecordingError("is encrypted", path=self.path, fix="decrypt it first")
        if place == 0:
            problem = "has no index: its recorder did not end it"
            raise RecordingError(problem, path=self.path, fix=f"rosbag reindex {self.path.name}")
        if count == 0:
            return []
        try:
            if place > self._size:
                raise ValueError("it begins behind the end of the file")
            self._file.seek(place)
            known, data = self._known(header.get_uint32("conn_count"))
            chunks = list(_chunk_infos(data, count))
        except (self._format.ReaderError, struct.error, LookupError, ValueError) as error:
            problem = f"is cut off or damaged: its index is not where it should be ({error})"
            raise RecordingError(problem, path=self.path, fix=f"rosbag reindex {self.path.name}") from error
        counts: Counter[int] = Counter()
        for chunk in chunks:
            counts.update(dict(zip(chunk.connections, chunk.counts, strict=True)))
        self.connections = [connection._replace(msgcount=counts[connection.id]) for connection in known]
        return chunks

    def _known(self, count: int) -> tuple[list[Connection], bytes]:
        """The connections, and the rest of the index."""
        if count > MOST_CONNECTIONS:
            raise ValueError(f"has more than {MOST_CONNECTIONS:,} topics")
        index = BytesIO(self._exactly(self._size - self._file.tell(), MOST_INDEX))
        rosbags = self._format.Reader(self.path)
        rosbags.bio = index
        read = [rosbags.read_connection() for _ in range(count)]
        known = [Connection(c.id, c.topic, c.msgtype, "MSG", c.msgdef.data, 0) for c in read]
        return known, index.read()

    def _header(self) -> bytes:
        """A record's header with its length before it."""
        size = self._exactly(4, 4)
        return size + self._exactly(_U32.unpack(size)[0], _MOST_HEADER)

    def _content(self, place: int) -> bytes:
        if place > self._size:
            raise ValueError("lies behind the end of the file")
        self._file.seek(place)
        header: Any = self._format.Header.read(BytesIO(self._header()))
        if header.get_uint8("op") != _CHUNK:
            raise ValueError("is none: its index leads elsewhere")
        name, stated = header.get_string("compression"), header.get_uint32("size")
        data = self._packed(_U32.unpack(self._exactly(4, 4))[0])
        return self.allowance.unpacked(data, _WAYS.get(name, name), stated)

    def _walk(self, content: bytes, most: int) -> tuple[list[Record], int]:
        found: list[Record] = []
        places = _Places(_MESSAGE_FIELDS)
        at = count = 0
        while at < len(content):
            (size,) = _U32.unpack_from(content, at)
            header, at = content[at + 4 : at + 4 + size], at + 4 + size
            (size,) = _U32.unpack_from(content, at)
            begin, at = at + 4, at + 4 + size
            count += 1
            if at > len(content):
                raise ValueError("holds a record that goes beyond its end")
            if count > most:
                raise ValueError(f"holds more than {most:,} records")
            op, conn, time = places.of(header)
            if header[op] == _MESSAGE:
                if min(conn, time) < 0:
                    raise ValueError("holds a message without time or connection")
                seconds, nanoseconds = _TIME.unpack_from(header, time)
                found.append(Record(_U32.unpack_from(header, conn)[0], seconds * 10**9 + nanoseconds, begin, at))
        return found, count


def _chunk_infos(data: bytes, count: int) -> Iterator[Chunk]:
    """The chunks that an index describes. Raises struct.error, LookupError or ValueError where it is damaged."""
    places = _Places(_INFO_FIELDS)
    at = 0
    for _ in range(count):
        (size,) = _U32.unpack_from(data, at)
        header, at = data[at + 4 : at + 4 + size], at + 4 + size
        op, start, end, place = places.of(header)
        (size,) = _U32.unpack_from(data, at)
        if min(start, end, place) < 0 or header[op] != _CHUNK_INFO or at + 4 + size > len(data):
            raise ValueError(f"a record of the index at {at} describes no chunk")
        start_s, start_ns = _TIME.unpack_from(header, start)
        end_s, end_ns = _TIME.unpack_from(header, end)
        words = struct.unpack_from(f"<{size // 8 * 2}I", data, at + 4)
        place_in_file = _U64.unpack_from(header, place)[0]
        yield Chunk(start_s * 10**9 + start_ns, end_s * 10**9 + end_ns, place_in_file, words[::2], words[1::2])
        at += 4 + size


class _Places:
    """Where the values of some fields begin in a header. One writer keeps one order: they are looked for once."""

    def __init__(self, names: tuple[bytes, ...]) -> None:
        self._names = names
        self._found: tuple[int, ...] = ()
        self._expected: list[tuple[bytes, int]] = []

    def of(self, header: bytes) -> tuple[int, ...]:
        """The places in the order of the names, -1 for one that is missing. Raises LookupError without the first."""
        for name, at in self._expected:
            if not header.startswith(name, at):
                break
        else:
            if self._expected:
                return self._found
        found, at = {}, 0
        while at < len(header):
            (size,) = _U32.unpack_from(header, at)
            name = header[at + 4 : at + 4 + size].partition(b"=")[0] + b"="
            found[name] = at + 4 + len(name)
            at += 4 + size
        places = (found[self._names[0]], *(found.get(name, -1) for name in self._names[1:]))
        if -1 not in places:
            self._found = places
            self._expected = [(name, at - len(name)) for name, at in zip(self._names, places, strict=True)]
        return places
