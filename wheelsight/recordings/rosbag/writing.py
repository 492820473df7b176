"""Bags written by rosbags' writers: whole or not at all, or message by message as a robot drives."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from wheelsight.errors import ConfigError
from wheelsight.extras import needed
from wheelsight.files import StrPath, check_name, output_error
from wheelsight.recordings.rosbag.messages import Messages, nanoseconds

WRITTEN = (".mcap", ".bag")
_FOREVER = (9223372036, 854775807)  # rmw's "infinite", in seconds and nanoseconds


class BagFile:
    """A bag that is open to be written.

    Attributes:
        make: what makes its messages.
        count: messages written by now.
        size_bytes: of these.
    """

    def __init__(self, writer: Any, make: Messages) -> None:
        self.make, self.count, self.size_bytes = make, 0, 0
        self._writer = writer
        self._connections: dict[str, Any] = {}

    def add(self, topic: str, message: Any, stamp_s: float, *, is_latched: bool = False) -> None:
        """Append a message, received at `stamp_s`; a latched one is kept for those who listen later.

        Raises OSError where it cannot be written.
        """
        self.add_bytes(topic, message.__msgtype__, self.make.bytes_of(message), stamp_s, is_latched=is_latched)

    def add_bytes(self, topic: str, type_: str, data: bytes, stamp_s: float, *, is_latched: bool = False) -> None:
        """The same of a message's bytes."""
        connection = self._connections.get(topic)
        if connection is None:
            connection = self._connections[topic] = self._connected(topic, type_, is_latched)
        self._writer.write(connection, nanoseconds(stamp_s), data)
        self.count += 1
        self.size_bytes += len(data)

    def flush(self) -> None:
        """Hand what was added to the system, so that a kill of this program loses none of it; of MCAP alone.

        A reader finds it without the index that the end of the file would have.
        """
        storage = self._writer.storage
        if storage.chunk.msgs:
            storage.close_chunk()
        storage.bio.flush()

    def _connected(self, topic: str, type_: str, is_latched: bool) -> Any:
        how: dict[str, Any] = {}
        if is_latched and self.make.is_ros1:
            how["latching"] = 1
        elif is_latched:
            how["offered_qos_profiles"] = [_latched()]
        return self._writer.add_connection(topic, type_, typestore=self.make.types, **how)


@contextmanager
def new_bag(path: StrPath) -> Iterator[BagFile]:
    """A bag to be filled by the block: MCAP of ROS 2, or a .bag of ROS 1, by its name.

    It is there once the block ends well; else nothing is left of it.

    Raises:
        ConfigError: another ending, or rosbags is not installed.
        OutputError: it cannot be written, or the disk is full.
    """
    path = Path(path)
    check_bag_name(path)
    try:
        with _temporary(path) as folder:
            made = folder / f"bag{path.suffix.lower()}"
            with _writer(made, folder) as writer:
                yield BagFile(writer, Messages(made.suffix == ".bag"))
            written = made if made.is_file() else folder / "bag" / "bag.mcap"
            with written.open("rb") as stream:
                os.fsync(stream.fileno())
            written.replace(path)
    except OSError as error:
        raise output_error(error, path) from error


@contextmanager
def growing_bag(path: StrPath) -> Iterator[BagFile]:
    """An MCAP file of ROS 2 that is there from the beginning and grows; see `BagFile.flush`.

    Whatever ends the program leaves what was flushed; the block's end adds the index. Raises as `new_bag`.
    """
    path = Path(path)
    check_growing_name(path)
    try:
        with _temporary(path) as folder:
            writer = _writer(folder / "bag.mcap", folder)
            writer.open()
            written = folder / "bag" / "bag.mcap"
            with suppress(PermissionError):  # of Windows, where it moves once it is closed
                written.replace(path)
                shutil.rmtree(folder)  # lest a kill leave it
            try:
                yield BagFile(writer, Messages(is_ros1=False))
            except OSError:  # what comes after half a record is lost to every reader: nothing more is written
                with suppress(Exception):
                    writer.abort()
                raise
            finally:
                written.parent.mkdir(parents=True, exist_ok=True)  # for metadata.yaml, which a file alone needs not
                if writer.storage is not None:
                    writer.close()
                if written.is_file():
                    written.replace(path)
    except OSError as error:
        raise output_error(error, path) from error


def check_bag_name(path: Path) -> None:
    """Raises ConfigError, OutputError for a name that no bag can have."""
    if path.suffix.lower() not in WRITTEN:
        raise ConfigError(
            f"{str(path)!r} does not end in .mcap or .bag", fix="MCAP for ROS 2 and Foxglove, .bag for ROS 1"
        )
    check_name(path)


def check_growing_name(path: Path) -> None:
    """Likewise, for a bag that is to be one while it grows."""
    check_bag_name(path)
    if path.suffix.lower() != ".mcap":
        raise ConfigError(f"{str(path)!r} cannot grow: a ROS 1 bag is none without its index", fix="name it .mcap")


def check_library() -> None:
    """Raises ConfigError where rosbags is not installed."""
    needed("rosbags")


@contextmanager
def _temporary(path: Path) -> Iterator[Path]:
    """A folder beside a file, on its disk, for the block; its name tells whose it is."""
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _writer(made: Path, folder: Path) -> Any:
    """One of rosbags' writers, not open yet."""
    if made.suffix == ".bag":
        return needed("rosbags.rosbag1").Writer(made)
    rosbag2 = needed("rosbags.rosbag2")
    return rosbag2.Writer(folder / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)


def _latched() -> Any:
    """The quality of service of a topic whose last message is kept, as /map and /tf_static have it."""
    ros = needed("rosbags.interfaces")
    forever = ros.QosTime(*_FOREVER)
    return ros.Qos(
        ros.QosHistory.KEEP_LAST,
        1,
        ros.QosReliability.RELIABLE,
        ros.QosDurability.TRANSIENT_LOCAL,
        forever,
        forever,
        ros.QosLiveliness.AUTOMATIC,
        forever,
        False,
    )
