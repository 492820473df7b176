"""MCAP files by their index, or by a walk over their records where a kill or an empty battery left none.

Format: https://mcap.dev/spec. rosbags' own reader unpacks whatever a chunk holds, and keeps all chunks that overlap.
"""

from __future__ import annotations

import struct
from collections import Counter
from typing import NamedTuple
from zlib import crc32

from wheelsight.errors import RecordingError
from wheelsight.recordings.rosbag.chunks import MOST_INDEX, Chunk, ChunkedReader, Record
from wheelsight.recordings.rosbag.definitions import MOST_CONNECTIONS, Connection

MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = range(1, 7)
_CHUNK_INDEX, _STATISTICS, _DATA_END = 0x08, 0x0B, 0x0F
_HEAD, _U16, _U32, _U64 = struct.Struct("<BQ"), struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_FOOTER_BYTES = _HEAD.size + 20 + len(MAGIC)
_INDEX_HEAD, _INDEX_ENTRY = struct.Struct("<QQQQ"), struct.Struct("<HQ")
_STATISTICS_HEAD = struct.Struct("<QHIIIIQQI")
# Of a record that describes a topic or a type.
_MOST_DESCRIPTION = 1 << 20
# Messages outside of chunks are taken together so far, as if they were one.
_RUN_BYTES = 1 << 20
_LANGUAGES = {"ros2msg": "MSG", "ros2idl": "IDL", "omgidl": "IDL"}


class _Schema(NamedTuple):
    """A type: its name, and the language and text of its definition."""

    name: str
    language: str
    text: str


class McapReader(ChunkedReader):
    """As `ChunkedReader` has it."""

    def _read_index(self) -> list[Chunk]:
        self._schemas: dict[int, _Schema] = {}
        self._channels: dict[int, tuple[int, str]] = {}  # schema and topic
        self._bounds: dict[int, int] = {}  # ends of the parts that are no chunks, by their places
        counts: Counter[int] = Counter()
        begin = self._check_head()
        summary, is_whole = self._summary_place(begin)
        chunks: list[Chunk] = []
        if summary is not None:
            chunks, counts = self._read_summary(summary)
        if not (chunks and self._schemas and self._channels):
            chunks, counts = self._scan(begin, summary or self._size, is_whole)
        self.connections = [
            Connection(channel, topic, *self._schemas.get(schema, _Schema("", "NONE", "")), counts[channel])
            for channel, (schema, topic) in self._channels.items()
        ]
        return chunks

    def _check_head(self) -> int:
        """Where the data begin. Raises RecordingError for another kind of file."""
        magic = self._file.read(len(MAGIC))
        if not magic:
            raise RecordingError("is empty", path=self.path, fix="record again")
        if magic != MAGIC:
            raise RecordingError("is no bag", path=self.path, fix="check what wrote it")
        kind, size = _HEAD.unpack(self._exactly(_HEAD.size, _MOST_DESCRIPTION))
        if kind != _HEADER:
            raise ValueError("its first record is no header")
        if _text(self._exactly(size, _MOST_DESCRIPTION), 0)[0] != "ros2":
            fix = "record it with ros2 bag, or convert it"
            raise RecordingError("is an MCAP file, but not of ROS 2", path=self.path, fix=fix)
        return self._file.tell()

    def _summary_place(self, begin: int) -> tuple[int | None, bool]:
        """Where the summary begins, None where there is none; and whether the file has its end."""
        self._file.seek(self._size - len(MAGIC))
        if self._file.read() != MAGIC or self._size < begin + _FOOTER_BYTES:
            return None, False
        self._file.seek(self._size - _FOOTER_BYTES)
        kind, size, summary = struct.unpack("<BQQ", self._file.read(17))
        if (kind, size) != (_FOOTER, 20) or (summary and not begin <= summary <= self._size - _FOOTER_BYTES):
            raise ValueError("its footer does not say where its summary is")
        return summary or None, True

    def _read_summary(self, place: int) -> tuple[list[Chunk], Counter[int]]:
        """The chunks and the number of messages of each channel, by the summary; schemas and channels are kept."""
        self._file.seek(place)
        data = self._exactly(self._size - _FOOTER_BYTES - place, MOST_INDEX)
        chunks, counted, counts = list[Chunk](), Counter[int](), None
        at = 0
        while at + _HEAD.size <= len(data):
            kind, size = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            if size > len(data) - at:
                raise ValueError("a record of its summary goes beyond its end")
            record, at = data[at : at + size], at + size
            self._describe(kind, record)
            if kind == _CHUNK_INDEX:
                chunks.append(_chunk_of(record))
                counted.update(dict(zip(chunks[-1].connections, chunks[-1].counts, strict=True)))
            elif kind == _STATISTICS:
                *_, length = _STATISTICS_HEAD.unpack_from(record)
                entries = record[_STATISTICS_HEAD.size : _STATISTICS_HEAD.size + length]
                counts = Counter(dict(_INDEX_ENTRY.iter_unpack(entries)))
        return chunks, counted if counts is None else counts

    def _describe(self, kind: int, record: bytes) -> None:
        """Keep what a record says of a type or a topic."""
        if kind not in (_SCHEMA, _CHANNEL):
            return
        (number,) = _U16.unpack_from(record)
        if kind == _SCHEMA:
            name, at = _text(record, 2)
            encoding, at = _text(record, at)
            text, _ = _text(record, at)
            self._schemas.setdefault(number, _Schema(name, _LANGUAGES.get(encoding, "NONE"), text))
            return
        (schema,) = _U16.unpack_from(record, 2)
        topic, at = _text(record, 4)
        encoding, _ = _text(record, at)
        if encoding == "cdr":
            self._channels.setdefault(number, (schema, topic))
        if max(len(self._channels), len(self._schemas)) > MOST_CONNECTIONS:
            raise ValueError(f"has more than {MOST_CONNECTIONS:,} topics")

    def _scan(self, begin: int, end: int, is_whole: bool) -> tuple[list[Chunk], Counter[int]]:
        """The chunks, and runs of messages outside of any, by a walk over the records from `begin` to `end`."""
        chunks, counts = list[Chunk](), Counter[int]()
        run: _Run | None = None
        at = begin
        while at + _HEAD.size <= end:
            self._file.seek(at)
            kind, size = _HEAD.unpack(self._file.read(_HEAD.size))
            after = at + _HEAD.size + size
            # Zeros follow where the system was cut off while it made room.
            if kind in (0, _DATA_END, _FOOTER) or after > end:
                break
            if kind == _MESSAGE:
                channel, _, time_ns, _ = _MESSAGE_HEAD.unpack(self._file.read(min(size, _MESSAGE_HEAD.size)))
                run = run or _Run(at)
                run.add(channel, time_ns, after)
            elif kind in (_SCHEMA, _CHANNEL):
                self._describe(kind, self._exactly(size, _MOST_DESCRIPTION))
            elif kind == _CHUNK and (chunk := self._scanned(at)) is not None:
                chunks.append(chunk)
            if run is not None and (kind != _MESSAGE or run.end - run.begin > _RUN_BYTES):
                chunks.append(self._ended(run))
                run = None
            at = after
        if run is not None:
            chunks.append(self._ended(run))
        if not is_whole:
            self._say_without_end(self._size - at)
        for chunk in chunks:
            counts.update(dict(zip(chunk.connections, chunk.counts, strict=True)))
        return chunks, counts

    def _ended(self, run: _Run) -> Chunk:
        self._bounds[run.begin] = run.end
        return Chunk(run.start_ns, run.end_ns, run.begin, tuple(run.counts), tuple(run.counts.values()))

    def _scanned(self, place: int) -> Chunk | None:
        """A chunk without an index, unpacked to see what it holds; None where that is no message."""
        content, records = self._opened(place)
        at = 0
        while at < len(content):
            kind, size = _HEAD.unpack_from(content, at)
            begin, at = at + _HEAD.size, at + _HEAD.size + size
            if kind in (_SCHEMA, _CHANNEL):
                self._describe(kind, content[begin:at])
        if not records:
            return None
        counts = Counter(record.connection for record in records)
        times_ns = [record.time_ns for record in records]
        return Chunk(min(times_ns), max(times_ns), place, tuple(counts), tuple(counts.values()))

    def _content(self, place: int) -> bytes:
        self._file.seek(place)
        if place in self._bounds:
            return self._packed(self._bounds[place] - place)
        kind, size = _HEAD.unpack(self._exactly(_HEAD.size, _MOST_DESCRIPTION))
        if kind != _CHUNK:
            raise ValueError("is none: its index leads elsewhere")
        record = self._packed(size)
        _, _, stated, crc = _CHUNK_HEAD.unpack_from(record)
        way, at = _text(record, _CHUNK_HEAD.size)
        (length,) = _U64.unpack_from(record, at)
        data = record[at + 8 : at + 8 + length]
        if len(data) != length:
            raise ValueError("says that it is longer than its record")
        content = self.allowance.unpacked(data, way, stated)
        if crc and crc32(content) != crc:
            raise ValueError("has a wrong checksum")
        return content

    def _walk(self, content: bytes, most: int) -> tuple[list[Record], int]:
        found: list[Record] = []
        at = count = 0
        while at < len(content):
            kind, size = _HEAD.unpack_from(content, at)
            begin, at = at + _HEAD.size, at + _HEAD.size + size
            count += 1
            if at > len(content) or kind in (0, _CHUNK):
                raise ValueError("holds bytes that are no record")
            if count > most:
                raise ValueError(f"holds more than {most:,} records")
            if kind == _MESSAGE:
                if size < _MESSAGE_HEAD.size:
                    raise ValueError("holds a message that is too short")
                channel, _, time_ns, _ = _MESSAGE_HEAD.unpack_from(content, begin)
                found.append(Record(channel, time_ns, begin + _MESSAGE_HEAD.size, at))
        return found, count

    def _say_without_end(self, lost_bytes: int) -> None:
        lost = f"; {lost_bytes:,} bytes after them are no whole record" if lost_bytes else ""
        sentence = (
            f"{self.path.name} has no end, as where its recorder was killed. All messages are read that are whole"
        )
        self.warnings = (f"{sentence}{lost}. Without an index that takes longer: mcap recover makes one.",)


class _Run:
    """Messages that follow each other outside of chunks."""

    def __init__(self, begin: int) -> None:
        self.begin = self.end = begin
        self.start_ns, self.end_ns = 1 << 64, 0
        self.counts: Counter[int] = Counter()

    def add(self, channel: int, time_ns: int, end: int) -> None:
        """Count a message in."""
        self.counts[channel] += 1
        self.start_ns, self.end_ns = min(self.start_ns, time_ns), max(self.end_ns, time_ns)
        self.end = end


def _chunk_of(record: bytes) -> Chunk:
    """A chunk by its record in the summary; a message index has 15 bytes, and 16 for each message."""
    start_ns, end_ns, place, length = _INDEX_HEAD.unpack_from(record)
    (size,) = _U32.unpack_from(record, _INDEX_HEAD.size)
    at = _INDEX_HEAD.size + 4
    offsets = sorted((offset, channel) for channel, offset in _INDEX_ENTRY.iter_unpack(record[at : at + size]))
    (index_bytes,) = _U64.unpack_from(record, at + size)
    ends = [*(offset for offset, _ in offsets[1:]), place + length + index_bytes]
    counts = [max(end - begin - 15, 0) // 16 for (begin, _), end in zip(offsets, ends, strict=False)]
    return Chunk(start_ns, end_ns, place, tuple(channel for _, channel in offsets), tuple(counts))


def _text(record: bytes, at: int) -> tuple[str, int]:
    """Text with its length before it, and where it ends. Raises ValueError."""
    (size,) = _U32.unpack_from(record, at)
    data = record[at + 4 : at + 4 + size]
    if len(data) != size:
        raise ValueError("holds text that goes beyond its record")
    return data.decode(), at + 4 + size
