"""Messages of a bag's files, in order of receipt; the one place that knows the package rosbags."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

from wheelsight.errors import RecordingError
from wheelsight.extras import needed
from wheelsight.inputs import Kind, read_bytes
from wheelsight.recordings.rosbag.cut_mcap import CutMcap, McapFile, cut_mcap
from wheelsight.recordings.rosbag.files import METADATA, parts_of
from wheelsight.recordings.rosbag.ros1 import Ros1Reader

_ZSTD = b"\x28\xb5\x2f\xfd"  # begins what is compressed message by message; plain CDR begins with a zero
_FIRST_S, _LAST_S = 2.0, 2.0
# A split bag has a paragraph of it for each of its files.
_METADATA = Kind("metadata.yaml of a bag", 8)
_IDL_RULE = "=" * 80 + "\n"
# What rosbags says, and what to do about it; in order: the first that is found in its words.
_FIXES = (
    ("files are missing", "files that metadata.yaml names are missing", "remove metadata.yaml to read those there are"),
    ("not indexed", "has no index: its recorder did not end it", "rosbag reindex FILE"),
    ("index looks damaged", "is cut off: its index is not where it should be", "rosbag reindex FILE"),
    ("File end magic", "is cut off: it has no end", "mcap recover FILE -o whole.mcap"),
    ("Unindexed", "is cut off, and its messages are not in order of receipt", "mcap recover FILE -o whole.mcap"),
    ("Profile is not ros2", "is an MCAP file, but not of ROS 2", "record it with ros2 bag, or convert it"),
    ("type definitions", "does not say what its messages hold", "record with ROS 2 Iron or later, or as MCAP"),
    ("database", "is no sqlite3 database, or a damaged one", "sqlite3 FILE .recover"),
    ("malformed", "is a damaged sqlite3 database", "sqlite3 FILE .recover"),
    ("metadata", "metadata.yaml does not fit", "remove metadata.yaml: the files beside it are read without it"),
    ("seems to be empty", "is empty", "record again"),
    ("magic is invalid", "is no bag", "check what wrote it"),
    ("encryption", "is encrypted", "decrypt it first"),
)


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag: its name, its type such as "sensor_msgs/msg/Image", and how many messages there are."""

    name: str
    type: str
    count: int


@dataclass(frozen=True, slots=True)
class Message:
    """One message, not decoded: its topic, the time of its receipt, and its bytes."""

    topic: str
    receipt_ns: int
    data: bytes

    @property
    def receipt_s(self) -> float:
        """The same time in seconds."""
        return self.receipt_ns * 1e-9


class OpenBag:
    """A bag whose files are open. Its topics come from its index; no message is read before it is asked for.

    Attributes:
        path: as it was given.
        topics: in order of name.
        start_ns, end_ns: the time of the first receipt and just after the last.
        is_ros1: whether messages are serialized as ROS 1 does.
        warnings: one sentence each on files that lack their end.
    """

    def __init__(self, path: Path, readers: Sequence[Any], is_ros1: bool, warnings: tuple[str, ...] = ()) -> None:
        self.path, self.is_ros1, self.warnings = path, is_ros1, warnings
        self._readers = sorted(readers, key=lambda reader: reader.start_time)
        self._stores: dict[str, Any] = {}
        self._firsts: dict[str, Message] = {}
        connections = [connection for reader in readers for connection in reader.connections]
        counts: dict[str, int] = {}
        for connection in connections:
            counts[connection.topic] = counts.get(connection.topic, 0) + connection.msgcount
        self._of_topic = {connection.topic: connection for connection in connections}
        self.topics = tuple(Topic(name, self._of_topic[name].msgtype, counts[name]) for name in sorted(counts))
        filled = [reader for reader in readers if reader.message_count]
        self.start_ns = min((reader.start_time for reader in filled), default=0)
        self.end_ns = max((reader.end_time for reader in filled), default=0)

    def messages(
        self, topics: Sequence[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[Message]:
        """Messages of some topics in order of receipt, from `start_ns` on and before `stop_ns`.

        Raises RecordingError at what is damaged.
        """
        try:
            for reader in self._readers:
                wanted = [connection for connection in reader.connections if connection.topic in topics]
                if wanted:
                    for connection, receipt_ns, data in reader.messages(wanted, start_ns, stop_ns):
                        yield Message(connection.topic, receipt_ns, _plain(data))
        except Exception as error:  # rosbags lets through what zlib, lz4, sqlite, struct and its own asserts raise
            raise _refusal(self.path, error) from error

    def first(self, topic: str, count: int = 1) -> list[Message]:
        """The first messages of a topic that has any, fewer where there are fewer. Raises RecordingError."""
        if count == 1 and topic in self._firsts:
            return [self._firsts[topic]]
        # A reader of MCAP looks at every chunk that it may need before it answers: most topics begin at once.
        begun = list(islice(self.messages([topic], stop_ns=self.start_ns + round(1e9 * _FIRST_S)), count))
        found = begun if len(begun) == count else list(islice(self.messages([topic]), count))
        if not found:
            raise self._without(topic)
        self._firsts[topic] = found[0]
        return found

    def last(self, topic: str) -> Message:
        """The last message of a topic that has any, by halving the time in which it lies. Raises RecordingError."""
        low_ns, high_ns, width_ns = self.start_ns, self.end_ns, round(1e9 * _LAST_S)
        start_ns = max(low_ns, high_ns - width_ns)
        while high_ns - low_ns > width_ns:
            if next(self.messages([topic], start_ns), None) is None:
                high_ns = start_ns
            else:
                low_ns = start_ns
            start_ns = (low_ns + high_ns) // 2
        found = deque(self.messages([topic], low_ns), maxlen=1)
        if not found:
            raise self._without(topic)
        return found[0]

    def _without(self, topic: str) -> RecordingError:
        fix = f"rosbag reindex {self.path.name}" if self.is_ros1 else f"mcap recover {self.path.name} -o whole.mcap"
        return RecordingError(
            f"is damaged: its index tells of messages of {topic}, and none is there", path=self.path, fix=fix
        )

    def decode(self, message: Message) -> Any:
        """A message's fields as attributes. Raises RecordingError."""
        type_ = self._of_topic[message.topic].msgtype
        try:
            store = self._stores.get(type_) or self._learn(message.topic, type_)
            read = store.deserialize_ros1 if self.is_ros1 else store.deserialize_cdr
            return read(message.data, type_)
        except Exception as error:
            problem = f"a message of {message.topic} is no {type_}: {type(error).__name__} {error}"
            raise RecordingError(problem, path=self.path, fix="leave the topic out with --topic") from error

    def _learn(self, topic: str, type_: str) -> Any:
        """A store that knows a type: as the bag defines it, else as ROS does."""
        definition = self._of_topic[topic].msgdef
        store = _store_of(type_, definition.format.name, definition.data, self.is_ros1)
        self._stores[type_] = store
        return store


# A store makes a program for each type: bags of one robot, which define theirs alike, share them.
@lru_cache(maxsize=128)
def _store_of(type_: str, language: str, definition: str, is_ros1: bool) -> Any:
    typesys = needed("rosbags.typesys")
    if language == "NONE":
        return typesys.get_typestore(typesys.Stores.ROS1_NOETIC if is_ros1 else typesys.Stores.LATEST)
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(_defined(type_, language, definition, typesys))
    return store


def _defined(type_: str, language: str, definition: str, typesys: Any) -> dict[str, Any]:
    """The types of a definition in ROS's own language, or in one or several of IDL."""
    if language == "MSG":
        return dict(typesys.get_types_from_msg(definition, type_))
    parts = [part.partition("\n")[2] for part in definition.split(_IDL_RULE) if part.startswith("IDL: ")]
    return {name: of for part in parts or [definition] for name, of in typesys.get_types_from_idl(part).items()}


@contextmanager
def open_bag(path: Path) -> Iterator[OpenBag]:
    """The bag at a path that `parts_of` knows, for the block.

    Raises:
        RecordingError: it has no index, is cut off, damaged, or no bag; says what to do.
        ConfigError: rosbags is not installed.
    """
    parts = parts_of(path)
    is_ros1 = parts[0].suffix == ".bag"
    reader: Any = Ros1Reader if is_ros1 else needed("rosbags.rosbag2").Reader
    with ExitStack() as stack:
        try:
            if path.is_dir() and parts == (path,):
                read_bytes(path / METADATA, _METADATA, RecordingError)  # rosbags reads it however large it is
            cut = {part: found for part in parts if part.suffix == ".mcap" and (found := cut_mcap(part)) is not None}
            readers = [stack.enter_context(reader(cut.get(part) or _standing_for(part))) for part in parts]
            bag = OpenBag(path, readers, is_ros1, tuple(map(_without_end, cut.values())))
        except Exception as error:
            raise _refusal(path, error) from error
        yield bag


def _standing_for(part: Path) -> Path | McapFile:
    return McapFile(part) if part.suffix == ".mcap" else part


def _without_end(cut: CutMcap) -> str:
    lost = f"; {cut.lost_bytes:,} bytes after them are no whole record" if cut.lost_bytes else ""
    told = f"{cut.name} has no end, as where its recorder was killed. All messages are read that are whole"
    return f"{told}{lost}. Without an index that takes longer: mcap recover makes one."


def _plain(data: bytes) -> bytes:
    """A message without the compression that metadata.yaml would have told of, had it come along."""
    if data[:4] != _ZSTD:
        return data
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return bytes(zstd.decompress(data))


def _refusal(path: Path, error: Exception) -> RecordingError:
    if isinstance(error, RecordingError):
        return error
    told = f"{type(error).__name__}: {error}"
    for words, problem, fix in _FIXES:
        if words in told:
            return RecordingError(problem, path=path, fix=fix.replace("FILE", path.name))
    return RecordingError(f"is damaged, or no bag ({told})", path=path, fix="check what wrote it, and copy it again")
