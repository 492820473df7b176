"""`ChunkedReader` unpacks one chunk at a time, within limits, and yields records by time. `store_of` compiles
message definitions within bounds.
"""

from __future__ import annotations

import heapq
import struct
from abc import ABC, abstractmethod
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import accumulate
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, Self

from wheelsight.core.errors import RecordingError
from wheelsight.core.inputs import Kind, decompressed, open_binary
from wheelsight.core.runtime import needed

# All sizes are bounded: two kilobytes of bz2 can expand to six gigabytes, and an index can have any numbers.

BAG = Kind("a bag", 1 << 40)
# Recorders close a chunk at 0.8 to 4 MB, or after one message that is larger. Three raw images of 4096×3072 fit.
_MOST_UNPACKED = 128 << 20
MOST_CHUNK = 512 << 20  # of a chunk in the file
# An hour of a robot's chunks takes some 20 MB.
MOST_INDEX = 256 << 20
# One opening or pass unpacks _FREE_BYTES and _MOST_RATIO times the size of the file. Raw images of a simulated camera
# without noise shrink to a hundredth. bz2 takes eight times as long as the others: 7 s a gigabyte.
_FREE_BYTES, _MOST_RATIO, _COSTS = 512 << 20, 512, {"bz2": 4}
# Cost of one record besides its bytes, in time and memory.
_RECORD_BYTES = 512
# Bounds the messages of a pass: each takes more than 8 bytes of a file, at any compression.
_FREE_MESSAGES, _LEAST_MESSAGE_BYTES = 50_000, 8
# Memory for messages that wait for older ones, where chunks overlap in time.
_MOST_WAITING = 256 << 20
_DAMAGED = "check what wrote it, and copy it again"


class Chunk(NamedTuple):
    """Times of a chunk's first and last message, its offset in the file, its connections, and their message counts.

    The garbage collector ignores tuples of numbers; a bag may have a hundred thousand chunks. Empty connections mean
    that they are unknown.
    """

    start_ns: int
    end_ns: int
    place: int
    connections: tuple[int, ...] = ()
    counts: tuple[int, ...] = ()


class ChunkMessage(NamedTuple):
    """A message's connection, time, and the range of its bytes in the chunk."""

    connection: int
    time_ns: int
    begin: int
    end: int


class Allowance:
    """Bounds the decompressed size and the number of messages of a file.

    Attributes:
        bytes_left: the number of bytes that may still be decompressed.
        most_messages: the largest number of messages of a pass.
    """

    def __init__(self, path: Path, size_bytes: int) -> None:
        self._path = path
        self.bytes_left = _FREE_BYTES + _MOST_RATIO * size_bytes
        self.most_messages = _FREE_MESSAGES + size_bytes // _LEAST_MESSAGE_BYTES

    def unpacked(self, data: bytes, way: str, stated_bytes: int | None = None) -> bytes:
        """The decompressed content of a message or a chunk. Raises ValueError, and RecordingError as `take`."""
        if not way:
            if stated_bytes is not None and stated_bytes != len(data):
                raise ValueError(f"states {stated_bytes} bytes and holds {len(data)}")
            return data
        cost = _COSTS.get(way, 1)
        if stated_bytes is not None and stated_bytes <= _MOST_UNPACKED:
            self.take(cost * stated_bytes)
            return decompressed(data, way, stated_bytes, stated_bytes)
        content = decompressed(data, way, min(_MOST_UNPACKED, self.bytes_left // cost), stated_bytes)
        self.take(cost * len(content))
        return content

    def take(self, size_bytes: int, records: int = 0) -> None:
        """Count decompressed bytes and records. Raises RecordingError beyond the bound."""
        self.bytes_left -= size_bytes + _RECORD_BYTES * records
        if self.bytes_left < 0:
            problem = f"holds more than {_FREE_BYTES >> 20} MB and {_MOST_RATIO} times its size once it is unpacked"
            raise RecordingError(problem, path=self._path, fix=_DAMAGED)


class ChunkedReader(ABC):
    """A file of chunks, open within its `with` block.

    Attributes:
        connections: of topics, with their message counts.
        warnings: one sentence for each missing part of the file.
        allowance: the bounds that are left.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.connections: list[Connection] = []
        self.warnings: tuple[str, ...] = ()
        self._chunks: list[Chunk] = []
        self._ended_ns: list[int] = []  # the latest end of each chunk and those before it
        self._last: tuple[int, bytes, list[ChunkMessage]] | None = None  # place, content and records of the last chunk

    def __enter__(self) -> Self:
        self._file = open_binary(self.path, BAG, RecordingError)
        try:
            self._size = self._file.seek(0, 2)
            self._file.seek(0)
            self.allowance = Allowance(self.path, self._size)
            chunks = {chunk.place: chunk for chunk in self.read_index()}
            self._chunks = sorted(chunks.values(), key=attrgetter("start_ns"))
            self._ended_ns = list(accumulate((chunk.end_ns for chunk in self._chunks), max))
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    @abstractmethod
    def read_index(self) -> list[Chunk]:
        """The chunks, after `connections` were set. Raises RecordingError, ValueError, LookupError or struct.error."""

    @abstractmethod
    def content_at(self, place: int) -> bytes:
        """The decompressed content of a chunk. Raises as `read_index`."""

    @abstractmethod
    def walk(self, content: bytes, most: int) -> tuple[list[ChunkMessage], int]:
        """The messages of a chunk in file order, and the number of records. Raises ValueError beyond `most` of them."""

    @property
    def message_count(self) -> int:
        """The number of messages of all connections."""
        return sum(connection.msgcount for connection in self.connections)

    @property
    def start_time(self) -> int:
        """The time of the first message, nanoseconds."""
        return min((chunk.start_ns for chunk in self._chunks), default=0)

    @property
    def end_time(self) -> int:
        """The time just after the last message, nanoseconds."""
        return max((chunk.end_ns for chunk in self._chunks), default=-1) + 1

    def messages(
        self, connections: Sequence[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Connection, time and bytes of messages from `start` on and before `stop`, in order of time."""
        wanted = {connection.id: connection for connection in connections}
        start_ns, stop_ns = start or 0, 1 << 64 if stop is None else stop
        waiting: list[tuple[int, int, int, bytes]] = []
        number = waiting_bytes = 0
        for at in range(bisect_left(self._ended_ns, start_ns), len(self._chunks)):
            chunk = self._chunks[at]
            if chunk.start_ns >= stop_ns:
                break
            if chunk.end_ns < start_ns or (chunk.connections and wanted.keys().isdisjoint(chunk.connections)):
                continue
            while waiting and waiting[0][0] < chunk.start_ns:
                time_ns, _, connection, data = heapq.heappop(waiting)
                waiting_bytes -= len(data) + _RECORD_BYTES
                yield wanted[connection], time_ns, data
            content, records = self.opened(chunk.place)
            for connection, time_ns, begin, end in records:
                if connection in wanted and start_ns <= time_ns < stop_ns:
                    heapq.heappush(waiting, (time_ns, number, connection, content[begin:end]))
                    number += 1
                    waiting_bytes += end - begin + _RECORD_BYTES
                    if waiting_bytes > _MOST_WAITING:
                        raise self._refusal(f"its chunks overlap in time by more than {_MOST_WAITING >> 20} MB")
            if number > self.allowance.most_messages:
                raise self._refusal(f"holds more messages than {self._size:,} bytes can")
        while waiting:
            time_ns, _, connection, data = heapq.heappop(waiting)
            yield wanted[connection], time_ns, data

    def opened(self, place: int) -> tuple[bytes, list[ChunkMessage]]:
        """Content and messages of the chunk at an offset. The last chunk is cached."""
        if self._last is None or self._last[0] != place:
            self._last = None
            try:
                content = self.content_at(place)
                records, count = self.walk(content, self.allowance.bytes_left // _RECORD_BYTES)
            except (ValueError, LookupError, struct.error) as error:
                raise self._refusal(f"its chunk at byte {place:,} {error}") from error
            self.allowance.take(0, count)
            self._last = place, content, records
        return self._last[1], self._last[2]

    def exactly(self, size: int, most: int) -> bytes:
        """The next bytes of the file. Raises ValueError where the file ends before, or beyond `most` bytes."""
        if size > most:
            raise ValueError(f"would have {size:,} bytes, more than {most >> 20} MB")
        if size > self._size - self._file.tell():
            raise ValueError("goes beyond the end of the file")
        data = self._file.read(size)
        if len(data) != size:
            raise ValueError("is cut off")
        return data

    def _refusal(self, problem: str) -> RecordingError:
        return RecordingError(problem, path=self.path, fix=_DAMAGED)


# Message types. A definition is untrusted text that becomes a program: length, fields and repetitions are bounded.

# The longest type in use, Odometry with all comments, has 8 kB as text and 20 kB as IDL.
LONGEST_DEFINITION = 1 << 16
# Includes fields of fields: an Odometry has 90, 72 of them in covariances.
_MOST_FIELDS = 4096
_IDL_RULE = "=" * 80 + "\n"
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms"
MOST_CONNECTIONS = 10_000  # a robot's bag has some hundred


# In metres, radians, their rates, or pixels. Squares and products of larger, damaged numbers overflow.
_LARGEST = 1e9


def are_measured(values: Iterable[float]) -> bool:
    """Whether all numbers are plausible measurements: not NaN, infinite or beyond 1e9."""
    return all(abs(value) <= _LARGEST for value in values)


class Connection(NamedTuple):
    """A topic of a bag, by one writer.

    Attributes:
        msgtype: such as "sensor_msgs/msg/Image".
        language: of the definition: "MSG", "IDL", or "NONE" where there is none.
        msgcount: the number of messages, by the index.
    """

    id: int
    topic: str
    msgtype: str
    language: str
    definition: str
    msgcount: int


# A store compiles a program for each type; bags with the same definitions share them.
@lru_cache(maxsize=128)
def store_of(type_: str, language: str, definition: str, is_ros1: bool) -> Any:
    """A type store with a type, by the bag's definition, else ROS's. Raises RecordingError, or errors of rosbags."""
    typesys = needed("rosbags.typesys")
    if language == "NONE":
        return typesys.get_typestore(typesys.Stores.ROS1_NOETIC if is_ros1 else typesys.Stores.LATEST)
    if len(definition) > LONGEST_DEFINITION:
        raise RecordingError(f"its definition is longer than {LONGEST_DEFINITION >> 10} kB")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    if language == "MSG":
        types = dict(typesys.get_types_from_msg(definition, type_))
    else:  # IDL, in one or several parts
        parts = [part.partition("\n")[2] for part in definition.split(_IDL_RULE) if part.startswith("IDL: ")]
        types = {name: of for part in parts or [definition] for name, of in typesys.get_types_from_idl(part).items()}
    known = {**store.fielddefs, **types}
    _check(type_, known)
    standard = dict(typesys.get_typestore(typesys.Stores.ROS1_NOETIC if is_ros1 else typesys.Stores.LATEST).fielddefs)
    for name in TF:
        standard.setdefault(name, typesys.get_types_from_msg(_TRANSFORMS, name)[name])
    if type_ in standard:
        _compare(type_, known, type_, standard)
    store.register(types)
    return store


def _check(type_: str, types: Mapping[str, Any]) -> None:
    """Raise RecordingError for a type that contains itself, has too many fields, or repeats a type without fields."""
    counts: dict[str, int | None] = {}

    def fields_of(name: str) -> int:
        """The number of scalar values of a message whose sequences have one element."""
        if name not in types:  # rosbags refuses it by name
            return 1
        if name not in counts:
            counts[name] = None
            counts[name] = sum(values_of(field) for _, field in types[name][1])
        count = counts[name]
        if count is None:
            raise RecordingError(f"its definition has a type that contains itself: {name}")
        if count > _MOST_FIELDS:
            raise RecordingError(f"its definition has more than {_MOST_FIELDS} fields")
        return count

    def values_of(field: Any) -> int:
        kind, what = field
        if kind.name in ("BASE", "NAME"):
            return 1 if kind.name == "BASE" else fields_of(what)
        element, size = what
        count = values_of(element)
        if not count:
            raise RecordingError("its definition repeats a type without fields")
        return count * size if kind.name == "ARRAY" else count

    fields_of(type_)


def _compare(type_: str, types: Mapping[str, Any], name: str, standard: Mapping[str, Any]) -> None:
    """Raise RecordingError for a type without a field of ROS's, or with another type of it. More fields are allowed."""
    found = dict(types[type_][1]) if type_ in types else {}
    for field, wanted in standard[name][1]:
        if field not in found or not _is_alike(found[field], wanted):
            raise RecordingError(f"its definition of {type_} does not have ROS's field {field}")
        (kind, what), (_, of_ros) = _element(found[field]), _element(wanted)
        if kind.name == "NAME":
            _compare(what, types, of_ros, standard)


def _is_alike(found: Any, wanted: Any) -> bool:
    """Whether two fields are both numbers, text or messages, and arrays have equal lengths."""
    if found[0].name not in (wanted[0].name, *(("ARRAY",) if wanted[0].name == "SEQUENCE" else ())):
        return False
    if wanted[0].name == "ARRAY" and found[1][1] != wanted[1][1]:
        return False
    (kind, what), (kind_of_ros, of_ros) = _element(found), _element(wanted)
    is_text = kind.name == "BASE" and ("string" in what[0]) != ("string" in of_ros[0])
    return bool(kind is kind_of_ros and not is_text)


def _element(field: Any) -> Any:
    return field[1][0] if field[0].name in ("ARRAY", "SEQUENCE") else field
