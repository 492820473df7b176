"""`OpenBag`: topics, messages and their types, by one interface over ROS 1, MCAP and sqlite3 files. `parts_of` finds
the files of a split bag.
"""

from __future__ import annotations

import re
import struct
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

from wheelsight.core.errors import RecordingError, WheelsightError
from wheelsight.core.inputs import Kind, decompress_into, open_binary, parse_yaml, read_text
from wheelsight.io.recordings.bags.chunks import BAG, Allowance, ChunkedReader, Connection, store_of
from wheelsight.io.recordings.bags.storage_formats import McapReader, Ros1Reader, SqliteReader

_ZSTD = b"\x28\xb5\x2f\xfd"  # begins a compressed message; plain CDR begins with a zero
_FIRST_S, _LAST_S = 2.0, 2.0
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
# Largest message other than images: transforms of a large robot have 100 kB, a calibration 4 kB.
_LARGEST_MESSAGE = 1 << 20
_HEADERS = ("std_msgs/msg/Header", "roslib/msg/Header")
_Reader = ChunkedReader | SqliteReader


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag: its name, its type such as "sensor_msgs/msg/Image", and its number of messages."""

    name: str
    type: str
    count: int


@dataclass(frozen=True, slots=True)
class Message:
    """An undecoded message: its topic, its time of receipt, and its bytes."""

    topic: str
    receipt_ns: int
    data: bytes

    @property
    def receipt_s(self) -> float:
        """The time of receipt in seconds."""
        return self.receipt_ns * 1e-9


@dataclass(frozen=True, slots=True)
class Header:
    """The header of a message: its stamp, 0 where it has none, and its frame."""

    stamp_s: float
    frame: str


@dataclass(frozen=True, slots=True)
class TransformTopic:
    """A transform of a topic of tf, which the bag serves as a topic of its own.

    Attributes:
        of: the topic that contains it, such as /tf.
        parent, child: its frames, without a leading slash.
        count: the number of messages with it, or an upper bound.
    """

    of: str
    parent: str
    child: str
    count: int

    @property
    def name(self) -> str:
        """The name for --topic, such as /tf:odom,base_link."""
        return f"{self.of}:{self.parent},{self.child}"

    def found_in(self, message: Any) -> Any | None:
        """The TransformStamped of a decoded message, or None."""
        for stamped in message.transforms:
            if (stamped.header.frame_id.lstrip("/"), stamped.child_frame_id.lstrip("/")) == (self.parent, self.child):
                return stamped
        return None


class OpenBag:
    """A bag whose files are open. Topics come from its index; messages are read on request.

    Attributes:
        topics: in order of name.
        start_ns, end_ns: the time of the first receipt, and just after the last.
        is_ros1: whether messages are serialized as in ROS 1.
        warnings: one sentence for each file whose end is missing.
    """

    def __init__(self, path: Path, readers: Sequence[_Reader], is_ros1: bool, warnings: tuple[str, ...] = ()) -> None:
        self.path, self.is_ros1, self.warnings = path, is_ros1, warnings
        self._readers = sorted(readers, key=lambda reader: reader.start_time)
        self._stores: dict[str, Any] = {}
        self._firsts: dict[str, Message] = {}
        self._transforms: dict[str, TransformTopic] = {}
        self._headless: dict[str, bool] = {}
        connections: list[Connection] = [connection for reader in readers for connection in reader.connections]
        counts: dict[str, int] = {}
        for connection in connections:
            counts[connection.topic] = counts.get(connection.topic, 0) + connection.msgcount
        self._of_topic = {connection.topic: connection for connection in connections}
        self.topics = tuple(Topic(name, self._of_topic[name].msgtype, counts[name]) for name in sorted(counts))
        filled = [reader for reader in readers if reader.message_count]
        self.start_ns = min((reader.start_time for reader in filled), default=0)
        self.end_ns = max((reader.end_time for reader in filled), default=0)

    def add_transforms(self, topics: Sequence[TransformTopic]) -> None:
        """Serve transforms as topics of their own."""
        for topic in topics:
            if topic.name not in self._transforms:
                self._transforms[topic.name] = topic
                self._of_topic[topic.name] = self._of_topic[topic.of]
                self.topics = (*self.topics, Topic(topic.name, self._of_topic[topic.of].msgtype, topic.count))

    def fields(self, topic: str) -> dict[str, str]:
        """The names and types, such as "int32", of plain fields of a topic's messages. Raises RecordingError."""
        connection = self._of_topic[topic]
        try:
            known = self._store(connection).fielddefs.get(connection.msgtype)
        except Exception as error:
            raise _refusal(self.path, error) from error
        if known is None:
            raise RecordingError(_undefined(connection.msgtype), path=self.path, fix=_DEFINED)
        return {name: of[1][0] for name, of in known[1] if of[0].name == "BASE"}

    def messages(
        self, topics: Sequence[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[Message]:
        """Messages of some topics in order of receipt, from `start_ns` on and before `stop_ns`.

        Raises RecordingError at damaged data.
        """
        try:
            for reader in self._readers:
                parts = [topic for name, topic in self._transforms.items() if name in topics]
                carriers = {topic.of for topic in parts}
                wanted = [one for one in reader.connections if one.topic in topics or one.topic in carriers]
                if wanted:
                    for connection, receipt_ns, data in reader.messages(wanted, start_ns, stop_ns):
                        if data[:4] == _ZSTD:
                            data = self._decompressed(data, connection.topic, reader)
                        yield from self.served(Message(connection.topic, receipt_ns, data), topics)
        except Exception as error:
            raise _refusal(self.path, error) from error

    def served(self, message: Message, topics: Sequence[str]) -> Iterator[Message]:
        """The message if its topic is one of these, and transforms in it that are served as topics of theirs."""
        if message.topic in topics:
            yield message
        for part in self._transforms.values():
            if part.name in topics and part.of == message.topic and part.child.encode() in message.data:
                with suppress(RecordingError):  # a damaged message
                    if part.found_in(self.decode(message)) is not None:
                        yield Message(part.name, message.receipt_ns, message.data)

    def _decompressed(self, data: bytes, topic: str, reader: _Reader) -> bytes:
        """The data of a message that is compressed by itself, which a bag may not state."""
        try:
            return reader.allowance.unpacked(data, "zstd")
        except ValueError as error:
            problem = f"a message of {topic} {error}"
            raise RecordingError(problem, path=self.path, fix="check what wrote it, and copy it again") from error

    def first(self, topic: str, count: int = 1) -> list[Message]:
        """The first messages of a topic, at most `count`. Raises RecordingError where there is none."""
        if count == 1 and topic in self._firsts:
            return [self._firsts[topic]]
        # A reader of MCAP examines all chunks in the range before the first message, and most topics begin early.
        begun = list(islice(self.messages([topic], stop_ns=self.start_ns + round(1e9 * _FIRST_S)), count))
        found = begun if len(begun) == count else list(islice(self.messages([topic]), count))
        if not found:
            raise self._without(topic)
        self._firsts[topic] = found[0]
        return found

    def last(self, topic: str) -> Message:
        """The last message of a topic, found by bisection of time. Raises RecordingError where there is none."""
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
            f"is damaged: its index has messages of {topic}, and the file has none", path=self.path, fix=fix
        )

    def header(self, message: Message) -> Header:
        """The header of a message, without decoding the rest; empty for a type without one. Raises RecordingError."""
        part = self._transforms.get(message.topic)
        if part is not None:
            found = part.found_in(self.decode(message))
            assert found is not None  # `messages` gives no others
            return Header(found.header.stamp.sec + 1e-9 * found.header.stamp.nanosec, part.parent)
        if message.topic not in self._headless:
            connection = self._of_topic[message.topic]
            self._headless[message.topic] = False
            with suppress(Exception):  # decoding raises the error
                fields = self._store(connection).fielddefs[connection.msgtype][1]
                self._headless[message.topic] = bool(fields) and fields[0][1][1] not in _HEADERS
        if self._headless[message.topic]:
            return Header(0.0, "")
        data = message.data
        order = "<" if self.is_ros1 or data[1:2] == b"\x01" else ">"
        try:
            # ROS 1 begins with the message's number. CDR begins with four bytes of its encoding; strings end with zero.
            seconds, ns, length = struct.unpack_from(f"{order}{'I' if self.is_ros1 else 'i'}II", data, 4)
            frame = data[16 : 16 + length].rstrip(b"\0").decode()
        except (struct.error, UnicodeDecodeError) as error:
            problem = f"a message of {message.topic} has no header that can be read: {error}"
            raise RecordingError(problem, path=self.path, fix="leave the topic out with --topic") from error
        return Header(seconds + 1e-9 * ns, frame.lstrip("/"))

    def has_units(self, topic: str, data: bytes) -> bool:
        """Whether an Image of the RealSense SDK ends with its depth unit; see `reader.depth_units_m`."""
        return self.is_ros1 and topic.startswith("/device_") and data[12:17] == b"\x01\0\0\x001"

    def _store(self, connection: Connection) -> Any:
        type_ = connection.msgtype
        if type_ not in self._stores:
            self._stores[type_] = store_of(type_, connection.language, connection.definition, self.is_ros1)
        return self._stores[type_]

    def decode(self, message: Message) -> Any:
        """The decoded message, with its fields as attributes. Raises RecordingError."""
        connection = self._of_topic[message.topic]
        type_ = connection.msgtype
        if type_ not in (IMAGE, COMPRESSED) and len(message.data) > _LARGEST_MESSAGE:
            problem = f"a message of {message.topic} has {len(message.data):,} bytes, more than {_LARGEST_MESSAGE:,}"
            raise RecordingError(problem, path=self.path, fix="leave the topic out with --topic")
        try:
            store, data = self._store(connection), message.data
            data = data[:-4] if type_ == IMAGE and self.has_units(message.topic, data) else data
            if type_ not in store.fielddefs:
                raise RecordingError(_undefined(type_))
            return (store.deserialize_ros1 if self.is_ros1 else store.deserialize_cdr)(data, type_)
        except Exception as error:  # rosbags raises errors of struct, numpy, its parser and its asserts
            why = error.problem if isinstance(error, RecordingError) else f"{type(error).__name__} {error}"
            problem = f"a message of {message.topic} is no {type_}: {why}"
            raise RecordingError(problem, path=self.path, fix="leave the topic out with --topic") from error


@contextmanager
def open_bag(path: Path) -> Iterator[OpenBag]:
    """Open the bag at a path that `parts_of` recognises, for the block.

    Raises:
        RecordingError: it has no index, is truncated, damaged, or not a bag; says what to do.
        ConfigError: rosbags is not installed.
    """
    parts = parts_of(path)
    is_ros1 = bool(parts) and parts[0].suffix == ".bag"
    with ExitStack() as stack:
        try:
            if path.is_dir() and parts == (path,):
                parts = named_parts(path)
            readers: list[_Reader] = []
            for part in parts:
                file = _decompressed_file(part, stack) if is_packed(part) else part
                kinds: dict[str, Callable[[Path], _Reader]] = {".bag": Ros1Reader, ".mcap": McapReader}
                readers.append(kinds.get(file.suffix, SqliteReader)(file))
                stack.enter_context(readers[-1])
            bag = OpenBag(path, readers, is_ros1, tuple(warning for reader in readers for warning in reader.warnings))
        except Exception as error:
            raise _refusal(path, error) from error
        yield bag


def _decompressed_file(part: Path, stack: ExitStack) -> Path:
    """A compressed file, decompressed into a temporary folder. Raises RecordingError."""
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="wheelsight-bag-")))
    target = folder / part.stem
    with open_binary(part, BAG, RecordingError) as source, target.open("wb") as unpacked:
        allowed = Allowance(part, source.seek(0, 2)).bytes_left
        source.seek(0)
        try:
            decompress_into(source, unpacked, "zstd", allowed)
        except ValueError as error:
            raise RecordingError(str(error), path=part, fix="check what wrote it, and copy it again") from error
        except OSError as error:
            problem = f"cannot be unpacked into {folder}: {error.strerror}"
            raise RecordingError(problem, path=part, fix="set TMPDIR to a folder with more room") from error
    return target


# sqlite3 bags of ROS 2 before Iron have no definitions of messages; MCAP bags always have.
_DEFINED = "where ROS has this type, ros2 bag convert into mcap stores its definition; or record /odom or /joint_states"


def _undefined(type_: str) -> str:
    return f"the bag does not define its type {type_}"


def _refusal(path: Path, error: Exception) -> Exception:
    """The error itself if it is wheelsight's; any other, of rosbags or below, as RecordingError."""
    if isinstance(error, WheelsightError):
        return error
    cause = f"{type(error).__name__}: {error}"
    return RecordingError(f"is damaged, or no bag ({cause})", path=path, fix="check what wrote it, and copy it again")


METADATA = "metadata.yaml"
SUFFIXES = (".bag", ".mcap", ".db3")
_PACKED = ".zstd"
_ROS2 = (".mcap", ".db3", f".mcap{_PACKED}", f".db3{_PACKED}")
_PART = re.compile(r"(?P<stem>.+)_(?P<number>\d+)")
_FIX = "remove metadata.yaml: the files beside it are read without it"
# A bag split into a thousand files has 200 kB.
_METADATA = Kind("metadata.yaml of a bag", 0.25, fix=_FIX)
_INFORMATION = "rosbag2_bagfile_information"
_LATEST_VERSION = 9
_STORAGES = ("mcap", "sqlite3")


def parts_of(path: Path) -> tuple[Path, ...]:
    """The paths to open for the bag at `path`, in order of time, by file names only; empty where it is not a bag.

    A folder with metadata.yaml is returned itself. Without one, its files are parts of one bag where their names differ
    in a last number only. A folder with two bags is not a bag.
    """
    if path.is_file():
        return (path,) if path.suffix in SUFFIXES else ()
    try:
        entries = list(path.iterdir())
    except OSError:
        entries = []
    if (path / METADATA).is_file() and any(entry.name.endswith(_ROS2) for entry in entries):
        return (path,)
    plain = [entry for entry in entries if entry.suffix in SUFFIXES and entry.is_file()]
    if len(plain) == 1:
        return (plain[0],)
    parts = {file: _PART.fullmatch(file.stem) for file in plain}
    kinds = {(match["stem"], file.suffix) if match else None for file, match in parts.items()}
    if len(kinds) != 1 or None in kinds:
        return ()
    numbers = {file: int(match["number"]) for file, match in parts.items() if match is not None}
    return tuple(sorted(numbers, key=lambda file: numbers[file]))


def named_parts(folder: Path) -> tuple[Path, ...]:
    """The files of a folder that its metadata.yaml names, in order of time.

    Raises RecordingError where metadata.yaml is invalid, names no files or missing ones, or an unknown compression.
    """
    path = folder / METADATA
    document = parse_yaml(read_text(path, _METADATA, RecordingError), path, RecordingError)
    about = document.get(_INFORMATION) if isinstance(document, dict) else None
    names = about.get("relative_file_paths") if isinstance(about, dict) else None
    if not isinstance(about, dict) or not isinstance(names, list) or not names:
        raise RecordingError("does not name the files of a bag", path=path, fix=_FIX)
    version, storage = about.get("version"), about.get("storage_identifier")
    if not isinstance(version, int) or not 0 < version <= _LATEST_VERSION:
        raise RecordingError(f"is of version {version}; 1 to {_LATEST_VERSION} are read", path=path, fix=_FIX)
    if storage not in _STORAGES:
        raise RecordingError(f"its storage is {storage!r}; {' and '.join(_STORAGES)} are read", path=path, fix=_FIX)
    form, mode = about.get("compression_format"), str(about.get("compression_mode") or "none").lower()
    if mode != "none" and form != "zstd":
        problem = f"its files are compressed as {form!r}; zstd is read"
        raise RecordingError(problem, path=path, fix="decompress it first")
    # Old recorders write the folder too. The name alone cannot lead out of the folder.
    parts = [folder / PurePosixPath(str(name)).name for name in names]
    missing = [part.name for part in parts if not part.exists()]
    if missing:
        problem = f"files that metadata.yaml names are missing: {', '.join(missing)}"
        raise RecordingError(problem, path=folder, fix="remove metadata.yaml to read those there are")
    for part in parts:
        if not part.name.endswith(_ROS2):
            raise RecordingError(f"names {part.name}, which is no file of a bag", path=path, fix=_FIX)
    return tuple(dict.fromkeys(parts))


def is_packed(part: Path) -> bool:
    """Whether a file is compressed."""
    return part.suffix == _PACKED
