"""Readers of the three storage formats: MCAP, ROS 1 bags and sqlite3. Each reads a bounded part of the file at a
time.
"""

from __future__ import annotations

import re
import sqlite3
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, Self
from zlib import crc32

from wheelsight.core.errors import RecordingError
from wheelsight.core.inputs import open_binary
from wheelsight.core.runtime import needed
from wheelsight.io.recordings.bags.chunks import (
    BAG,
    LONGEST_DEFINITION,
    MOST_CHUNK,
    MOST_CONNECTIONS,
    MOST_INDEX,
    Allowance,
    Chunk,
    ChunkedReader,
    ChunkMessage,
    Connection,
)

# MCAP: https://mcap.dev/spec. The reader of rosbags decompresses whatever a chunk holds, and keeps all chunks that
# overlap in time.

MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = range(1, 7)
_CHUNK_INDEX, _STATISTICS, _DATA_END = 0x08, 0x0B, 0x0F
_HEAD, _U16, _U32, _U64 = struct.Struct("<BQ"), struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
_MESSAGE_HEAD, _CHUNK_HEAD = struct.Struct("<HIQQ"), struct.Struct("<QQQI")
_FOOTER_BYTES = _HEAD.size + 20 + len(MAGIC)
_INDEX_HEAD, _INDEX_ENTRY = struct.Struct("<QQQQ"), struct.Struct("<HQ")
_STATISTICS_HEAD = struct.Struct("<QHIIIIQQI")
_MOST_DESCRIPTION = 1 << 20  # bytes of a record that describes a topic or a type
_RUN_BYTES = 1 << 20  # of messages outside of chunks that are read together, as one chunk
_LANGUAGES = {"ros2msg": "MSG", "ros2idl": "IDL", "omgidl": "IDL"}


class McapReader(ChunkedReader):
    """An MCAP file, read by its index, or by a scan of its records where it has none."""

    def read_index(self) -> list[Chunk]:
        """See `ChunkedReader`."""
        self._schemas: dict[int, tuple[str, str, str]] = {}  # name, language and text of a type
        self._channels: dict[int, tuple[int, str]] = {}  # schema and topic
        self._bounds: dict[int, int] = {}  # ends of runs of messages outside of chunks, by their offsets
        magic = self._file.read(len(MAGIC))
        if not magic:
            raise RecordingError("is empty", path=self.path, fix="record again")
        if magic != MAGIC:
            raise RecordingError("is no bag", path=self.path, fix="check what wrote it")
        kind, size = _HEAD.unpack(self.exactly(_HEAD.size, _MOST_DESCRIPTION))
        if kind != _HEADER:
            raise ValueError("its first record is no header")
        if _text(self.exactly(size, _MOST_DESCRIPTION), 0)[0] != "ros2":
            fix = "record it with ros2 bag, or convert it"
            raise RecordingError("is an MCAP file, but not of ROS 2", path=self.path, fix=fix)
        begin = self._file.tell()
        summary, is_whole = self._summary_place(begin)
        chunks: list[Chunk] = []
        counts: Counter[int] = Counter()
        if summary is not None:
            chunks, counts = self._read_summary(summary)
        if not (chunks and self._schemas and self._channels):
            chunks, counts = self._scan(begin, summary or self._size, is_whole)
        self.connections = [
            Connection(channel, topic, *self._schemas.get(schema, ("", "NONE", "")), counts[channel])
            for channel, (schema, topic) in self._channels.items()
        ]
        return chunks

    def _summary_place(self, begin: int) -> tuple[int | None, bool]:
        """The offset of the summary, None where there is none, and whether the file is complete."""
        self._file.seek(self._size - len(MAGIC))
        if self._file.read() != MAGIC or self._size < begin + _FOOTER_BYTES:
            return None, False
        self._file.seek(self._size - _FOOTER_BYTES)
        kind, size, summary = struct.unpack("<BQQ", self._file.read(17))
        if (kind, size) != (_FOOTER, 20) or (summary and not begin <= summary <= self._size - _FOOTER_BYTES):
            raise ValueError("its footer does not say where its summary is")
        return summary or None, True

    def _read_summary(self, place: int) -> tuple[list[Chunk], Counter[int]]:
        """The chunks and the message count of each channel. Also sets the schemas and channels."""
        self._file.seek(place)
        data = self.exactly(self._size - _FOOTER_BYTES - place, MOST_INDEX)
        chunks, counts = list[Chunk](), None
        at = 0
        while at + _HEAD.size <= len(data):
            kind, size = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            if size > len(data) - at:
                raise ValueError("a record of its summary goes beyond its end")
            record, at = data[at : at + size], at + size
            self._describe(kind, record)
            if kind == _CHUNK_INDEX:
                chunks.append(_indexed_chunk(record))
            elif kind == _STATISTICS:
                *_, length = _STATISTICS_HEAD.unpack_from(record)
                entries = record[_STATISTICS_HEAD.size : _STATISTICS_HEAD.size + length]
                counts = Counter(dict(_INDEX_ENTRY.iter_unpack(entries)))
        return chunks, _message_counts(chunks) if counts is None else counts

    def _describe(self, kind: int, record: bytes) -> None:
        """Add the type or topic that a record describes. Ignores other records."""
        if kind not in (_SCHEMA, _CHANNEL):
            return
        (number,) = _U16.unpack_from(record)
        if kind == _SCHEMA:
            name, at = _text(record, 2)
            encoding, at = _text(record, at)
            text, _ = _text(record, at)
            self._schemas.setdefault(number, (name, _LANGUAGES.get(encoding, "NONE"), text))
            return
        (schema,) = _U16.unpack_from(record, 2)
        topic, at = _text(record, 4)
        encoding, _ = _text(record, at)
        if encoding == "cdr":
            self._channels.setdefault(number, (schema, topic))
        if max(len(self._channels), len(self._schemas)) > MOST_CONNECTIONS:
            raise ValueError(f"has more than {MOST_CONNECTIONS:,} topics")

    def _scan(self, begin: int, end: int, is_whole: bool) -> tuple[list[Chunk], Counter[int]]:
        """As `_read_summary`, from the records themselves. Runs of messages outside of chunks count as chunks."""
        chunks, run = list[Chunk](), list[tuple[int, int]]()  # channel and time of each message of the run
        at = run_begin = run_end = begin

        def end_run() -> None:
            if run:
                self._bounds[run_begin] = run_end
                chunks.append(_chunk_of(run_begin, run))
                run.clear()

        while at + _HEAD.size <= end:
            self._file.seek(at)
            kind, size = _HEAD.unpack(self._file.read(_HEAD.size))
            after = at + _HEAD.size + size
            # Zeros follow where the system was cut off while it made room.
            if kind in (0, _DATA_END, _FOOTER) or after > end:
                break
            if kind == _MESSAGE:
                channel, _, time_ns, _ = _MESSAGE_HEAD.unpack(self._file.read(min(size, _MESSAGE_HEAD.size)))
                run_begin = run_begin if run else at
                run_end = after
                run.append((channel, time_ns))
            elif kind in (_SCHEMA, _CHANNEL):
                self._describe(kind, self.exactly(size, _MOST_DESCRIPTION))
            elif kind == _CHUNK:
                chunks += self._scan_chunk(at)
            if kind != _MESSAGE or run_end - run_begin > _RUN_BYTES:
                end_run()
            at = after
        end_run()
        if not is_whole:
            lost = f"; {self._size - at:,} bytes after them are no whole record" if at < self._size else ""
            self.warnings = (
                f"{self.path.name} has no end, as where its recorder was killed. All complete messages are read{lost}. "
                "Without an index that takes longer: mcap recover makes one.",
            )
        return chunks, _message_counts(chunks)

    def _scan_chunk(self, place: int) -> list[Chunk]:
        """The chunk at an offset, if it has messages. Also adds its schemas and channels."""
        content, records = self.opened(place)
        at = 0
        while at < len(content):
            kind, size = _HEAD.unpack_from(content, at)
            begin, at = at + _HEAD.size, at + _HEAD.size + size
            if kind in (_SCHEMA, _CHANNEL):
                self._describe(kind, content[begin:at])
        messages = [(record.connection, record.time_ns) for record in records]
        return [_chunk_of(place, messages)] if messages else []

    def content_at(self, place: int) -> bytes:
        """See `ChunkedReader`."""
        self._file.seek(place)
        if place in self._bounds:
            return self.exactly(self._bounds[place] - place, MOST_CHUNK)
        kind, size = _HEAD.unpack(self.exactly(_HEAD.size, _MOST_DESCRIPTION))
        if kind != _CHUNK:
            raise ValueError("is none: its index leads elsewhere")
        record = self.exactly(size, MOST_CHUNK)
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

    def walk(self, content: bytes, most: int) -> tuple[list[ChunkMessage], int]:
        """See `ChunkedReader`."""
        found: list[ChunkMessage] = []
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
                found.append(ChunkMessage(channel, time_ns, begin + _MESSAGE_HEAD.size, at))
        return found, count


def _chunk_of(place: int, messages: Sequence[tuple[int, int]]) -> Chunk:
    """The chunk at an offset, by channel and time of each of its messages."""
    counts = Counter(channel for channel, _ in messages)
    times_ns = [time_ns for _, time_ns in messages]
    return Chunk(min(times_ns), max(times_ns), place, tuple(counts), tuple(counts.values()))


def _message_counts(chunks: Sequence[Chunk]) -> Counter[int]:
    """The number of messages of each connection."""
    counts: Counter[int] = Counter()
    for chunk in chunks:
        counts.update(dict(zip(chunk.connections, chunk.counts, strict=True)))
    return counts


def _indexed_chunk(record: bytes) -> Chunk:
    """The chunk that a record of the summary describes. A message index has 15 bytes, and 16 for each message."""
    start_ns, end_ns, place, length = _INDEX_HEAD.unpack_from(record)
    (size,) = _U32.unpack_from(record, _INDEX_HEAD.size)
    at = _INDEX_HEAD.size + 4
    offsets = sorted((offset, channel) for channel, offset in _INDEX_ENTRY.iter_unpack(record[at : at + size]))
    (index_bytes,) = _U64.unpack_from(record, at + size)
    ends = [*(offset for offset, _ in offsets[1:]), place + length + index_bytes]
    counts = [max(end - begin - 15, 0) // 16 for (begin, _), end in zip(offsets, ends, strict=False)]
    return Chunk(start_ns, end_ns, place, tuple(channel for _, channel in offsets), tuple(counts))


def _text(record: bytes, at: int) -> tuple[str, int]:
    """The text at an offset, after its length, and the offset of its end. Raises ValueError."""
    (size,) = _U32.unpack_from(record, at)
    data = record[at + 4 : at + 4 + size]
    if len(data) != size:
        raise ValueError("holds text that goes beyond its record")
    return data.decode(), at + 4 + size


# ROS 1: https://wiki.ros.org/Bags/Format/2.0. Only the index at the end is read on opening: an hour has some hundred
# thousand chunks. The reader of rosbags examines every chunk and message first, 13 s for such a bag, and decompresses
# whatever a chunk holds. It parses the records here.

_MAGIC = b"#ROSBAG V2.0\n"
_CHUNK_INFO, _ROS1_MESSAGE, _ROS1_CHUNK = 6, 2, 5
_TIME = struct.Struct("<II")
_MOST_HEADER = 1 << 20
_WAYS = {"none": "", "bz2": "bz2", "lz4": "lz4"}


class Ros1Reader(ChunkedReader):
    """A bag of ROS 1. Raises ConfigError where rosbags is not installed."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._format = needed("rosbags.rosbag1.reader")

    def read_index(self) -> list[Chunk]:
        """See `ChunkedReader`."""
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
            topics = header.get_uint32("conn_count")
            if topics > MOST_CONNECTIONS:
                raise ValueError(f"has more than {MOST_CONNECTIONS:,} topics")
            index = BytesIO(self.exactly(self._size - place, MOST_INDEX))
            rosbags = self._format.Reader(self.path)
            rosbags.bio = index
            read = [rosbags.read_connection() for _ in range(topics)]
            chunks = list(_chunk_infos(index.read(), count))
        except (self._format.ReaderError, struct.error, LookupError, ValueError) as error:
            problem = f"is cut off or damaged: its index is not where it should be ({error})"
            raise RecordingError(problem, path=self.path, fix=f"rosbag reindex {self.path.name}") from error
        counts = _message_counts(chunks)
        self.connections = [Connection(c.id, c.topic, c.msgtype, "MSG", c.msgdef.data, counts[c.id]) for c in read]
        return chunks

    def _header(self) -> bytes:
        """The next record's header, after its length."""
        size = self.exactly(4, 4)
        return size + self.exactly(_U32.unpack(size)[0], _MOST_HEADER)

    def content_at(self, place: int) -> bytes:
        """See `ChunkedReader`."""
        if place > self._size:
            raise ValueError("lies behind the end of the file")
        self._file.seek(place)
        header: Any = self._format.Header.read(BytesIO(self._header()))
        if header.get_uint8("op") != _ROS1_CHUNK:
            raise ValueError("is none: its index leads elsewhere")
        name, stated = header.get_string("compression"), header.get_uint32("size")
        data = self.exactly(_U32.unpack(self.exactly(4, 4))[0], MOST_CHUNK)
        return self.allowance.unpacked(data, _WAYS.get(name, name), stated)

    def walk(self, content: bytes, most: int) -> tuple[list[ChunkMessage], int]:
        """See `ChunkedReader`."""
        found: list[ChunkMessage] = []
        fields = _FieldOffsets((b"op=", b"conn=", b"time="))
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
            op, conn, time = fields.of(header)
            if header[op] == _ROS1_MESSAGE:
                if min(conn, time) < 0:
                    raise ValueError("holds a message without time or connection")
                seconds, nanoseconds = _TIME.unpack_from(header, time)
                found.append(ChunkMessage(_U32.unpack_from(header, conn)[0], seconds * 10**9 + nanoseconds, begin, at))
        return found, count


def _chunk_infos(data: bytes, count: int) -> Iterator[Chunk]:
    """The chunks that an index describes. Raises struct.error, LookupError or ValueError where it is damaged."""
    fields = _FieldOffsets((b"op=", b"start_time=", b"end_time=", b"chunk_pos="))
    at = 0
    for _ in range(count):
        (size,) = _U32.unpack_from(data, at)
        header, at = data[at + 4 : at + 4 + size], at + 4 + size
        op, start, end, place = fields.of(header)
        (size,) = _U32.unpack_from(data, at)
        if min(start, end, place) < 0 or header[op] != _CHUNK_INFO or at + 4 + size > len(data):
            raise ValueError(f"a record of the index at {at} describes no chunk")
        start_s, start_ns = _TIME.unpack_from(header, start)
        end_s, end_ns = _TIME.unpack_from(header, end)
        words = struct.unpack_from(f"<{size // 8 * 2}I", data, at + 4)
        place_in_file = _U64.unpack_from(header, place)[0]
        yield Chunk(start_s * 10**9 + start_ns, end_s * 10**9 + end_ns, place_in_file, words[::2], words[1::2])
        at += 4 + size


class _FieldOffsets:
    """Finds the values of some fields in headers. A writer keeps one order, so the last offsets are tried first."""

    def __init__(self, names: tuple[bytes, ...]) -> None:
        self._names = names
        self._found: tuple[int, ...] = ()
        self._expected: list[tuple[bytes, int]] = []

    def of(self, header: bytes) -> tuple[int, ...]:
        """The offset of each value, -1 for a missing field. Raises LookupError without the first field."""
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


# The sqlite3 storage of ROS 2, `.db3`. A database can contain programs: a table that computes its values can make
# gigabytes from a few bytes, and pages that refer to each other form endless loops. Only plain tables are read, in a
# bounded number of steps.

_LONGEST_VALUE = 128 << 20  # bytes, of a message
_MOST_SCHEMA = 1000  # tables and indexes; a bag has some ten
# Steps of sqlite's virtual machine in one query. A row takes some ten steps, and at least twenty bytes of the file.
_FREE_STEPS, _STEPS_PER_BYTE, _STEPS_PER_CHECK = 10_000_000, 2, 100_000
_VIRTUAL = re.compile(r"\s*CREATE\s+VIRTUAL", re.IGNORECASE)


class SqliteReader:
    """A sqlite3 file of ROS 2, with the interface of `ChunkedReader`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.connections: list[Connection] = []
        self.warnings: tuple[str, ...] = ()
        self.start_time, self.end_time, self.message_count = 0, 0, 0

    def __enter__(self) -> Self:
        with open_binary(self.path, BAG, RecordingError) as stream:
            self._size = stream.seek(0, 2)
        if not self._size:
            raise RecordingError("is empty", path=self.path, fix="record again")
        self.allowance = Allowance(self.path, self._size)
        try:
            where = f"{self.path.resolve().as_uri()}?mode=ro&immutable=1"
            # A pass may continue in another thread.
            self._database = sqlite3.connect(where, uri=True, check_same_thread=False)
        except sqlite3.Error as error:
            raise self._refusal(error) from error
        try:
            self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(_LONGEST_VALUE, max(self._size, 1 << 20)))
            self._database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
            self._database.set_progress_handler(self._count_steps, _STEPS_PER_CHECK)
            self._steps_left = 0
            for pragma in ("trusted_schema = OFF", "cell_size_check = ON"):
                self._database.execute(f"PRAGMA {pragma}")
            self._read_index(has_definitions="message_definitions" in self._checked_tables())
        except sqlite3.Error as error:
            self._database.close()
            raise self._refusal(error) from error
        except BaseException:
            self._database.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._database.close()

    def messages(
        self, connections: Sequence[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Connection, time and bytes of messages from `start` on and before `stop`, in order of time."""
        wanted = {connection.id: connection for connection in connections}
        query = f"SELECT rowid, topic_id, timestamp FROM messages WHERE topic_id IN ({','.join('?' * len(wanted))})"
        values: list[int] = [*wanted]
        for condition, value in (("timestamp >= ?", start), ("timestamp < ?", stop)):
            if value is not None:
                query += f" AND {condition}"
                values.append(min(max(value, -(1 << 63)), (1 << 63) - 1))
        try:
            rows = self._rows(f"{query} ORDER BY timestamp", values)
            for number, (row, topic, time_ns) in enumerate(rows):
                if number >= self.allowance.most_messages:
                    raise self._refusal(f"more messages than {self._size:,} bytes can hold")
                # Sorted rows without data stay small: sqlite keeps them in memory or in a temporary file.
                (data,) = self._database.execute("SELECT data FROM messages WHERE rowid = ?", (row,)).fetchone()
                if not isinstance(time_ns, int) or not isinstance(data, bytes):
                    raise self._refusal("a message whose time is no number, or whose data are no bytes")
                yield wanted[topic], time_ns, data
        except (sqlite3.Error, TypeError) as error:
            raise self._refusal(error) from error

    def _count_steps(self) -> bool:
        """Count steps of a query. Returns whether sqlite has to stop it."""
        self._steps_left -= _STEPS_PER_CHECK
        return self._steps_left < 0

    def _rows(self, query: str, values: Sequence[Any] = ()) -> Iterator[Any]:
        self._steps_left = _FREE_STEPS + _STEPS_PER_BYTE * self._size
        return self._database.execute(query, values)

    def _checked_tables(self) -> dict[str, str]:
        """Names and definitions of the tables. Raises RecordingError where one is missing or not plain."""
        found: dict[str, str] = {}
        for name, text in self._rows("SELECT name, sql FROM sqlite_master WHERE type = 'table'"):
            found[name] = str(text)
            if len(found) > _MOST_SCHEMA:
                raise self._refusal(f"more than {_MOST_SCHEMA} tables")
        for name in ("messages", "topics", "message_definitions"):
            if name not in found and name != "message_definitions":
                raise self._refusal(f"no table {name}")
            columns = list(self._rows("SELECT hidden FROM pragma_table_xinfo(?)", (name,)))
            if _VIRTUAL.match(found.get(name, "")) or any(hidden for (hidden,) in columns):
                raise self._refusal(f"a table {name} that computes its values")
        return found

    def _read_index(self, has_definitions: bool) -> None:
        counts: dict[Any, int] = {}
        query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY topic_id"
        for topic, count, first_ns, last_ns in self._rows(query):
            if not isinstance(first_ns, int) or not isinstance(last_ns, int):
                raise self._refusal("messages whose times are no numbers")
            self.start_time = min(self.start_time, first_ns) if counts else first_ns
            self.end_time = max(self.end_time, last_ns + 1) if counts else last_ns + 1
            counts[topic] = count
        definitions: dict[str, tuple[str, str]] = {}
        if has_definitions:
            query = "SELECT topic_type, encoding, substr(encoded_message_definition, 1, ?) FROM message_definitions"
            for type_, language, text in self._rows(f"{query} LIMIT ?", (LONGEST_DEFINITION + 1, MOST_CONNECTIONS)):
                if language in ("ros2msg", "ros2idl") and isinstance(text, str):
                    definitions.setdefault(type_, (_LANGUAGES[language], text))
        for number, name, type_, form in self._rows("SELECT id, name, type, serialization_format FROM topics"):
            if len(self.connections) >= MOST_CONNECTIONS:
                raise self._refusal(f"more than {MOST_CONNECTIONS:,} topics")
            if not (isinstance(number, int) and isinstance(name, str) and isinstance(type_, str)):
                raise self._refusal("a topic without number, name or type")
            if form == "cdr":
                defined = definitions.get(type_, ("NONE", ""))
                self.connections.append(Connection(number, name, type_, *defined, counts.get(number, 0)))
        self.message_count = sum(connection.msgcount for connection in self.connections)

    def _refusal(self, found: str | Exception) -> RecordingError:
        damaged = "is no sqlite3 database, or a damaged one: "
        problem = f"{damaged}{found}" if isinstance(found, Exception) else f"holds {found}"
        return RecordingError(problem, path=self.path, fix=f"sqlite3 {self.path.name} .recover")
