"""Bags that hold far more than they seem to: refused in one line, before memory or the disk fills."""

from __future__ import annotations

import bz2
import os
import shutil
import sqlite3
import struct
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
from written_bags import ROS1, ROS2, camera_drive, odometry_drive, write_bag

from wheelsight.core.errors import RecordingError
from wheelsight.io.recordings import open_recording
from wheelsight.io.recordings.bags import chunks
from wheelsight.io.recordings.bags import recording as order
from wheelsight.io.recordings.bags.chunks import Allowance, store_of
from wheelsight.io.recordings.bags.recording import EventQueue, ImagePair, MessageQueue, Pairing
from wheelsight.io.recordings.bags.storage import Message
from wheelsight.io.recordings.bags.storage_formats import MAGIC

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MEGABYTE = 1 << 20
COMPRESS: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "bz2": bz2.compress,
    "lz4": lz4.frame.compress,
    "zstd": zstd.compress,
}


def refused(path: Path, match: str) -> RecordingError:
    """The error of a bag that is refused with less than 64 MB of memory."""
    tracemalloc.start()
    try:
        with pytest.raises(RecordingError, match=match) as caught:
            list(open_recording(path).events())
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 64 * MEGABYTE
    assert "\n" not in str(caught.value)
    return caught.value


def ros1_record(data: bytes, **fields: bytes) -> bytes:
    header = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in fields.items()
    )
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def ros1_bag(path: Path, way: str, content: bytes, stated: int | None = None, chunk_count: int = 1) -> Path:
    """A bag of one chunk, which its index names `chunk_count` times."""
    u32, time = struct.Struct("<I").pack, struct.pack("<II", 1_700_000_000, 0)
    compressed = COMPRESS[way](content)
    size = u32(len(content) if stated is None else stated)
    chunk = ros1_record(compressed, op=b"\5", compression=(way or "none").encode(), size=size)
    about = ros1_record(b"", topic=b"/odom", type=b"nav_msgs/Odometry", md5sum=b"*", message_definition=b"int8 x\n")
    connection = ros1_record(about[4:-4], op=b"\7", conn=u32(0), topic=b"/odom")
    place = len(b"#ROSBAG V2.0\n") + 4096
    info = ros1_record(
        u32(0) + u32(3),
        **{"op": b"\6", "ver": u32(1), "chunk_pos": struct.pack("<Q", place), "count": u32(1)},
        **{"start_time": time, "end_time": time},
    )
    index = struct.pack("<Q", place + len(chunk))
    head = ros1_record(b"", op=b"\3", index_pos=index, conn_count=u32(1), chunk_count=u32(chunk_count))
    filled = head[:-4] + u32(4096 - len(head)) + b" " * (4096 - len(head))
    path.write_bytes(b"#ROSBAG V2.0\n" + filled + chunk + connection + info * chunk_count)
    return path


def mcap_record(kind: int, data: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(data)) + data


def mcap_text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def mcap_bag(path: Path, *chunked: tuple[str, bytes, int | None]) -> Path:
    """A file without an index, of chunks by their compression, content and the size that they state."""
    parts = [MAGIC, mcap_record(1, mcap_text("ros2") + mcap_text("test"))]
    parts.append(mcap_record(3, struct.pack("<H", 1) + mcap_text("nav_msgs/msg/Odometry") + mcap_text("ros2msg") * 2))
    channel = struct.pack("<HH", 1, 1) + mcap_text("/odom") + mcap_text("cdr") + struct.pack("<I", 0)
    parts.append(mcap_record(4, channel))
    for way, content, stated in chunked:
        packed = COMPRESS[way](content)
        head = struct.pack("<QQQI", 0, 1, len(content) if stated is None else stated, 0)
        parts.append(mcap_record(6, head + mcap_text(way) + struct.pack("<Q", len(packed)) + packed))
    parts += [mcap_record(15, bytes(4)), mcap_record(2, bytes(20)), MAGIC]
    path.write_bytes(b"".join(parts))
    return path


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if a chunk could have 4 MB alone."""
    monkeypatch.setattr(chunks, "_MOST_UNPACKED", 4 * MEGABYTE)


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize("way", ["bz2", "lz4"])
def test_a_chunk_of_ros1_holds_no_more_than_it_states(tmp_path: Path, way: str) -> None:
    bomb = bytes(8 * MEGABYTE)
    refused(ros1_bag(tmp_path / "a.bag", way, bomb), rf"states 8 MB of {way} content, more than the 4 MB allowed")
    refused(ros1_bag(tmp_path / "b.bag", way, bomb, 1000), rf"holds {way} content beyond the 1,000 bytes that its head")
    refused(ros1_bag(tmp_path / "c.bag", way, bytes(10), 1000), rf"states 1000 bytes of {way} content and holds 10")


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize("way", ["lz4", "zstd"])
def test_a_chunk_of_mcap_holds_no_more_than_it_states(tmp_path: Path, way: str) -> None:
    bomb = bytes(8 * MEGABYTE)
    refused(mcap_bag(tmp_path / "a.mcap", (way, bomb, None)), rf"states 8 MB of {way} content, more than the 4 MB")
    refused(mcap_bag(tmp_path / "b.mcap", (way, bomb, 999)), rf"holds {way} content beyond the 999 bytes that its head")
    refused(mcap_bag(tmp_path / "c.mcap", (way, bytes(9), 99)), rf"states 99 bytes of {way} content and holds 9")
    refused(mcap_bag(tmp_path / "d.mcap", ("", bytes(9), 99)), "states 99 bytes and holds 9")


@pytest.mark.parametrize("way", ["bz2", "lz4"])
def test_gigabytes_are_refused_by_the_chunks_header_alone(tmp_path: Path, way: str) -> None:
    path = ros1_bag(tmp_path / "a.bag", way, b"", 3 << 30)
    refused(path, rf"its chunk at byte 4,109 states 3,072 MB of {way} content, more than the 128 MB allowed")


def test_zeros_are_no_records(tmp_path: Path) -> None:
    """They would be walked over nine bytes at a time."""
    refused(mcap_bag(tmp_path / "a.mcap", ("zstd", bytes(MEGABYTE), None)), "holds bytes that are no record")
    refused(ros1_bag(tmp_path / "a.bag", "bz2", bytes(MEGABYTE)), "its chunk at byte 4,109")


def test_a_chunk_in_a_chunk_is_refused(tmp_path: Path) -> None:
    refused(mcap_bag(tmp_path / "a.mcap", ("zstd", mcap_record(6, bytes(100)), None)), "holds bytes that are no record")


def test_many_chunks_are_refused_by_their_sum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "_FREE_BYTES", 8 * MEGABYTE)
    content = mcap_record(9, bytes(2 * MEGABYTE))
    path = mcap_bag(tmp_path / "a.mcap", *[("zstd", content, None)] * 30)
    refused(path, r"holds more than 8 MB and 512 times its size once it is unpacked")


def test_very_many_records_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "_FREE_BYTES", MEGABYTE)
    path = mcap_bag(tmp_path / "a.mcap", ("zstd", mcap_record(7, b"") * 20_000, None))
    refused(path, r"holds more than [12],\d\d\d records")


def test_more_messages_than_the_file_can_hold_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "_FREE_MESSAGES", 100)
    message = mcap_record(5, struct.pack("<HIQQ", 1, 0, 1, 1))
    path = mcap_bag(tmp_path / "a.mcap", ("zstd", message * 2000, None))
    refused(path, r"holds more messages than \d+ bytes can")


def test_chunks_that_overlap_in_time_do_not_fill_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "_MOST_WAITING", MEGABYTE)
    content = b"".join(mcap_record(5, struct.pack("<HIQQ", 1, 0, at, at) + os.urandom(100_000)) for at in (1, 9))
    path = mcap_bag(tmp_path / "a.mcap", *[("", content, None)] * 20)
    refused(path, "its chunks overlap in time by more than 1 MB")


@pytest.mark.parametrize("count", [1, 5000])
def test_an_index_that_names_one_chunk_again_and_again_reads_it_once(tmp_path: Path, count: int) -> None:
    message = ros1_record(bytes(8), op=b"\2", conn=bytes(4), time=struct.pack("<II", 1_700_000_000, 0))
    path = ros1_bag(tmp_path / "a.bag", "bz2", message * 3, chunk_count=count)
    with chunks_of(path) as reader:
        assert len(list(reader.messages(reader.connections))) == 3


def chunks_of(path: Path):
    from wheelsight.io.recordings.bags.storage_formats import Ros1Reader

    return Ros1Reader(path)


def test_an_index_of_more_chunks_than_there_are_is_damaged(tmp_path: Path) -> None:
    path = ros1_bag(tmp_path / "a.bag", "bz2", bytes(10))
    data = bytearray(path.read_bytes())
    at = data.index(b"chunk_count=") + len(b"chunk_count=")
    data[at : at + 4] = b"\xff" * 4
    path.write_bytes(data)
    refused(path, "its index is not where it should be")


def db3_of(folder: Path, **how: str) -> Path:
    written = write_bag(folder / "drive", odometry_drive(), storage="sqlite3", **how)
    return next(written.glob("*.db3*"))


def test_a_message_of_gigabytes_is_refused(tmp_path: Path) -> None:
    path = db3_of(tmp_path)
    with sqlite3.connect(path) as database:
        database.execute("UPDATE messages SET data = ?", (zstd.compress(bytes(200 * MEGABYTE)),))
    database.close()
    refused(path, r"a message of /odom states 200 MB of zstd content, more than the 128 MB allowed")


def test_a_file_of_gigabytes_does_not_fill_the_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chunks, "_FREE_BYTES", 8 * MEGABYTE)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "room"))
    (tmp_path / "room").mkdir()
    packed = db3_of(tmp_path, mode="file")
    packed.write_bytes(zstd.compress(bytes(100 * MEGABYTE)))
    refused(packed.parent, r"drive\.db3\.zstd: states 100 MB of zstd content, more than the 10 MB allowed")
    assert not list((tmp_path / "room").iterdir())


def test_a_table_that_computes_its_values_is_refused(tmp_path: Path) -> None:
    path = db3_of(tmp_path)
    with sqlite3.connect(path) as database:
        database.execute("ALTER TABLE messages RENAME TO others")
        database.execute(
            "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,"
            " data BLOB AS (zeroblob(900000000)) VIRTUAL)"
        )
        database.execute("INSERT INTO messages (id, topic_id, timestamp) VALUES (1, 1, 1)")
    database.close()
    refused(path, "holds a table messages that computes its values")


@pytest.mark.parametrize("column", ["timestamp", "data"])
@pytest.mark.parametrize("value", [None, "x", 1.5])
def test_values_of_other_kinds_are_refused(tmp_path: Path, column: str, value: object) -> None:
    path = db3_of(tmp_path)
    with sqlite3.connect(path) as database:
        columns = {"topic_id": 1, "timestamp": 1, "data": b"x"} | {column: value}
        database.execute("CREATE TABLE loose (id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
        database.execute("DROP TABLE messages")
        database.execute("ALTER TABLE loose RENAME TO messages")
        database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", (*columns.values(),))
    database.close()
    refused(path, "times are no numbers|time is no number, or whose data are no bytes")


DEFINITIONS = {
    "many fields": ("".join(f"float64 f{number}\n" for number in range(20_000)), "is longer than 64 kB"),
    "itself": ("A a\n" + "=" * 80 + "\nMSG: nav_msgs/A\nA a\n", "a type that contains itself"),
    "doubled": (
        "A0 a\n" + "".join(f"{'=' * 80}\nMSG: nav_msgs/A{n}\nA{n + 1} a\nA{n + 1} b\n" for n in range(40)) + "\n"
        f"{'=' * 80}\nMSG: nav_msgs/A40\nint8 x\n",
        "more than 4096 fields",
    ),
    "a fixed array": ("int8[4000000000] a\n", "more than 4096 fields"),
    "nothing, very often": (f"E[4000000000] e\n{'=' * 80}\nMSG: nav_msgs/E\n", "repeats a type without fields"),
    "nothing, as often as it says": (f"E[] e\n{'=' * 80}\nMSG: nav_msgs/E\n", "repeats a type without fields"),
    "no language": ("\x00 ((((((", "nav_msgs/msg/Odometry|Could not parse"),
}


@pytest.mark.parametrize("name", DEFINITIONS)
def test_definitions_are_bounded(name: str) -> None:
    text, problem = DEFINITIONS[name]
    with pytest.raises(Exception, match=problem):
        store_of("nav_msgs/msg/Odometry", "MSG", text, True)


@pytest.mark.parametrize(
    ("definition", "field"),
    [
        ("string data\n", ""),
        ("string data\nint8 more\n", ""),
        ("string date\n", "data"),
        ("int8 data\n", "data"),
        ("string[] data\n", "data"),
        (f"X data\n{'=' * 80}\nMSG: std_msgs/X\nint8 x\n", "data"),
    ],
)
def test_a_type_of_ros_that_a_bag_defines_otherwise_is_refused(definition: str, field: str) -> None:
    if not field:
        assert store_of("std_msgs/msg/String", "MSG", definition, False).types["std_msgs/msg/String"]
        return
    with pytest.raises(RecordingError, match=f"of std_msgs/msg/String does not have ROS's field {field}"):
        store_of("std_msgs/msg/String", "MSG", definition, False)


@pytest.mark.parametrize("is_ros1", [True, False])
def test_a_field_of_a_field_that_is_otherwise_is_refused(is_ros1: bool) -> None:
    store = ROS1 if is_ros1 else ROS2
    text, _ = store.generate_msgdef("nav_msgs/msg/Odometry", ros_version=1 if is_ros1 else 2)
    assert store_of("nav_msgs/msg/Odometry", "MSG", text, is_ros1)
    for sound, odd, where in (
        ("float64 z", "float64 zz", "geometry_msgs/msg/"),
        ("float64[36] covariance", "float64[35] covariance", "geometry_msgs/msg/PoseWithCovariance"),
        ("string frame_id", "int64 frame_id", "std_msgs/msg/Header"),
    ):
        assert sound in text
        with pytest.raises(RecordingError, match=f"its definition of {where}.*does not have ROS's field"):
            store_of("nav_msgs/msg/Odometry", "MSG", text.replace(sound, odd), is_ros1)


def messages_of_one_receipt(count: int) -> list[Message]:
    return [Message("/image", 0, bytes(MEGABYTE)) for _ in range(count)]


def test_images_that_wait_for_a_partner_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their partners do not come, so that none has been passed by."""
    monkeypatch.setattr(order, "_MOST_ALONE_BYTES", 4 * MEGABYTE)
    pairing = Pairing(0.02)
    messages = messages_of_one_receipt(20)
    for number, message in enumerate(messages):
        pairing.add("color", float(number), message)
    assert not list(pairing.settled(0.0))
    for number in range(20):
        pairing.add("depth", float(number), messages[number])
    # The five that are still there, of either kind, are the last.
    assert [frame.stamp_s for frame in pairing.settled(float("inf"))] == [15, 16, 17, 18, 19]
    assert pairing.crowded == {"color": 15, "depth": 15}


def test_frames_that_wait_for_older_events_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing says that no older event comes."""
    monkeypatch.setattr(order, "_MOST_BYTES", 8 * MEGABYTE)
    queue, stamps_s = EventQueue(), []
    for number, message in enumerate(messages_of_one_receipt(20)):
        queue.add(ImagePair(float(number), message, message, 0.0))
        stamps_s += [item.stamp_s for item in queue.until(-float("inf"))]
        assert number + 1 - len(stamps_s) <= 4
    assert [*stamps_s, *(item.stamp_s for item in queue.until(float("inf")))] == list(range(20))


def test_images_that_wait_for_a_topic_that_stops_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither does receipt go on, nor does the other topic, of which the index says that there is more."""
    monkeypatch.setattr(order, "_MOST_BYTES", 8 * MEGABYTE)
    queue, stamps_s = MessageQueue({"/image": 20, "/odom": 20}, 0.5), []
    for number, message in enumerate(messages_of_one_receipt(20)):
        assert queue.received(message) == (number == 19)
        queue.add(float(number), message)
        stamps_s += [stamp_s for stamp_s, _ in queue.ready()]
        assert number + 1 - len(stamps_s) <= 8
    assert [*stamps_s, *(stamp_s for stamp_s, _ in queue.rest())] == list(range(20))


def test_a_sound_bag_stays_far_below_what_is_allowed(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "drive.bag", camera_drive(is_ros1=True), compression="bz2")
    allowed = Allowance(path, path.stat().st_size)
    with chunks_of(path) as reader:
        assert len(list(reader.messages(reader.connections))) == 19
        assert allowed.bytes_left - reader.allowance.bytes_left < MEGABYTE


def test_names_in_metadata_pass_the_gate(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "drive", odometry_drive())
    (file,) = folder.glob("*.mcap")
    file.rename(tmp_path / "elsewhere.mcap")
    os.mkfifo(file)
    assert "is a pipe, not a file" in str(refused(folder, "drive.mcap: is a pipe, not a file"))
    file.unlink()
    file.symlink_to("/dev/zero")
    refused(folder, "drive.mcap: is a device, not a file")
    file.unlink()
    file.mkdir()
    refused(folder, "drive.mcap: is a folder, not a file")
    file.rmdir()
    text = (folder / "metadata.yaml").read_text()
    shutil.move(tmp_path / "elsewhere.mcap", folder / "drive.mcap")
    for name in ("/dev/zero", "../../etc/passwd", "/proc/self/mem"):
        (folder / "metadata.yaml").write_text(text.replace("- drive.mcap", f"- {name}"))
        refused(folder, f"files that metadata.yaml names are missing: {Path(name).name}")
    (folder / "metadata.yaml").write_text(text)
    assert open_recording(folder).wheel_count == 60


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("x: " + "[" * 200, "metadata.yaml:1: is nested deeper"),
        ("- " * 200_000, "holds 391 kB, more than metadata.yaml of a bag may: 256 kB"),
        ("a: &a [x,x,x,x,x,x,x,x,x]\n", "does not name the files of a bag"),
        ("[]", "does not name the files"),
        ("rosbag2_bagfile_information: {version: 99, relative_file_paths: [drive.mcap]}", "is of version 99"),
        ("rosbag2_bagfile_information: {version: 4, relative_file_paths: [{a: b}]}", "its storage is None"),
    ],
)
def test_hostile_metadata_is_refused(tmp_path: Path, change: str, problem: str) -> None:
    folder = write_bag(tmp_path / "drive", odometry_drive())
    (folder / "metadata.yaml").write_text(change)
    refused(folder, problem)
