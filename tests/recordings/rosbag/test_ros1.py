"""Our reading of ROS 1's index gives what rosbags' does, whatever the chunks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag1 import Reader, Writer
from written_bags import ROS1, camera_drive, odometry_drive, stamp_ns, write_bag

from wheelsight.core.errors import RecordingError
from wheelsight.io.recordings.bags.storage_formats import Ros1Reader


def write_chunks(path: Path, threshold: int) -> Path:
    """Messages out of order by up to some chunks, as several writers' may be."""
    drive = odometry_drive(is_ros1=True)
    drive.messages += camera_drive(is_ros1=True).messages
    writer = Writer(path)
    writer.chunk_threshold = threshold
    order = sorted(drive.messages, key=lambda item: item[0])
    order = [message for at in range(0, len(order), 5) for message in reversed(order[at : at + 5])]
    with writer:
        known = {}
        for at_s, topic, message in order:
            if topic not in known:
                known[topic] = writer.add_connection(topic, message.__msgtype__, typestore=ROS1)
            writer.write(known[topic], stamp_ns(at_s), ROS1.serialize_ros1(message, message.__msgtype__))
    return path


@pytest.mark.parametrize("threshold", [1, 20_000, 1 << 20])
@pytest.mark.parametrize("topics", [("/odom",), ("/odom", "/camera/color/image_raw"), ()])
@pytest.mark.parametrize("span_s", [(None, None), (0.5, 1.5), (10.0, None)])
def test_messages_are_those_that_rosbags_reads(tmp_path: Path, threshold: int, topics, span_s) -> None:
    path = write_chunks(tmp_path / "drive.bag", threshold)
    span_ns = [None if at_s is None else stamp_ns(at_s) for at_s in span_s]
    found: list[Any] = []
    readers: tuple[Any, Any] = Ros1Reader(path), Reader(path)
    for reader in readers:
        with reader:
            wanted = [c for c in reader.connections if not topics or c.topic in topics]
            found.append(sorted((c.topic, at_ns, bytes(data)) for c, at_ns, data in reader.messages(wanted, *span_ns)))
            about = (reader.start_time, reader.end_time, reader.message_count)
            found.append([about, sorted((c.topic, c.msgtype, c.msgcount) for c in reader.connections)])
    assert found[0] == found[2]
    assert found[1] == found[3]


def test_they_come_in_order_of_time(tmp_path: Path) -> None:
    with Ros1Reader(write_chunks(tmp_path / "drive.bag", 1)) as reader:
        times_ns = [at_ns for _, at_ns, _ in reader.messages(reader.connections)]
    assert times_ns == sorted(times_ns)
    assert len(times_ns) == 60 + 3 * 6 + 1


def test_a_chunk_is_read_when_it_is_due(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "drive.bag", odometry_drive(is_ros1=True))
    data = bytearray(path.read_bytes())
    at = data.index(b"compression=none")
    data[at + len(b"compression=") : at + len(b"compression=none")] = b"nine"
    path.write_bytes(data)
    with Ros1Reader(path) as reader:  # opens, for only its index was read
        assert reader.message_count == 60
        with pytest.raises(RecordingError, match="its chunk at byte 4,109 is compressed by 'nine', which is not read"):
            next(iter(reader.messages(reader.connections)))
