"""Files of ROS 2 by our own readers, against rosbags' own: the same messages, with an index and without."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag2 import Reader
from written_bags import Drive, camera_drive, odometry_drive, stamp_ns, write_bag

from wheelsight.io.recordings.bags.storage_formats import McapReader, SqliteReader

SPANS = pytest.mark.parametrize("span_s", [(None, None), (0.5, 1.5), (10.0, None)])
TOPICS = pytest.mark.parametrize("topics", [("/odom",), ("/odom", "/camera/color/image_raw"), ()])


def drive() -> Drive:
    both = odometry_drive()
    both.messages += camera_drive(frames=150).messages  # of 2.3 MB: three chunks
    return both


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bags")
    ways: dict[str, dict[str, str]] = {"mcap": {}, "zstd": {"mode": "storage"}, "db3": {"storage": "sqlite3"}}
    found = {name: write_bag(folder / name, drive(), **how) for name, how in ways.items()}
    return {name: next(file for file in at.iterdir() if file.suffix != ".yaml") for name, at in found.items()}


def read(reader: Any, topics: Sequence[str], span_s: Sequence[float | None]) -> list[Any]:
    span_ns = [None if at_s is None else stamp_ns(at_s) for at_s in span_s]
    with reader:
        wanted = [c for c in reader.connections if not topics or c.topic in topics]
        found = [(at_ns, c.topic, bytes(data)) for c, at_ns, data in reader.messages(wanted, *span_ns)]
        assert [at_ns for at_ns, *_ in found] == sorted(at_ns for at_ns, *_ in found)
        about = (reader.start_time, reader.end_time, reader.message_count)
        return [sorted(found), about, sorted((c.topic, c.msgtype, c.msgcount) for c in reader.connections)]


@SPANS
@TOPICS
@pytest.mark.parametrize("way", ["mcap", "zstd", "db3"])
def test_messages_are_those_that_rosbags_reads(files, way: str, topics, span_s) -> None:
    path = files[way]
    own = SqliteReader(path) if way == "db3" else McapReader(path)
    assert read(own, topics, span_s) == read(Reader(path), topics, span_s)


@SPANS
@pytest.mark.parametrize("way", ["mcap", "zstd"])
def test_a_walk_over_the_records_finds_what_the_index_does(files, tmp_path: Path, way: str, span_s) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(files[way].read_bytes()[:-9])
    assert read(McapReader(cut), (), span_s) == read(McapReader(files[way]), (), span_s)


def test_messages_outside_of_chunks_are_read(files, tmp_path: Path) -> None:
    """As a writer that makes no chunks leaves them, which also makes no index of them."""
    path = tmp_path / "plain.mcap"
    data = files["mcap"].read_bytes()
    parts, at = [data[: 8 + 9 + int.from_bytes(data[9:17], "little")]], 8
    while data[at] != 0x0F:
        size = int.from_bytes(data[at + 1 : at + 9], "little")
        if data[at] == 0x06:  # times, size, checksum, no compression, size
            parts.append(data[at + 9 + 28 + 4 + 8 : at + 9 + size])
        at += 9 + size
    assert len(parts) > 2
    path.write_bytes(b"".join(parts) + b"\x0f" + (4).to_bytes(8, "little") + bytes(4) + bytes(100))
    assert read(McapReader(path), (), (None, None)) == read(McapReader(files["mcap"]), (), (None, None))
