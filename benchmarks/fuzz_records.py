"""Changes to files of records, whose lengths and checksums fit afterwards: bags, Matroska, journals, .sens, sqlite3.

A change of bytes alone is mostly refused by the first checksum. What is behind that is reached by these: records that
come twice, in another order, of another kind, with numbers beyond belief, or that unpack to gigabytes.
"""

from __future__ import annotations

import bz2
import re
import sqlite3
import struct
import sys
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import lz4.frame
import numpy as np

Rng = np.random.Generator
Change = Callable[[bytes, Rng], bytes]
_BOMB_MB = 1536  # more than one input may take
_MOST_UNPACKED = 1 << 24
_NUMBERS: tuple[bytes, ...] = (
    *(struct.pack("<q", value) for value in (0, 1, -1, 1 << 31, (1 << 31) - 1, 1 << 40, (1 << 63) - 1, -(1 << 63))),
    *(struct.pack("<i", value) for value in (0, 1, -1, 255, 65_536, 1 << 24, 400_000_000, (1 << 31) - 1, -(1 << 31))),
    *(struct.pack("<d", value) for value in (float("nan"), float("inf"), -float("inf"), 1e308, -1e-308, 0.0)),
    *(struct.pack("<f", value) for value in (float("nan"), float("inf"), 1e38, -1.0)),
    *(struct.pack(">I", value) for value in (0, 1, 65_535, (1 << 31) - 1, (1 << 32) - 1)),
    *(b"\0\0", b"\xff\xff", b"\xff\x7f"),
)


@dataclass(frozen=True, slots=True)
class Record:
    """A record of a file: of which kind, what its head says besides, and what it holds."""

    kind: bytes
    head: tuple[bytes, ...]
    content: bytes


def numbers_changed(data: bytes, rng: Rng) -> bytes:
    """A number in a file of bytes is another."""
    number = _NUMBERS[int(rng.integers(len(_NUMBERS)))]
    at = int(rng.integers(max(len(data) - len(number), 0) + 1))
    if rng.random() < 0.7:  # most formats align their numbers, and the first of them say how the rest is read
        at = min(int(rng.integers(1, 200)), at) // 4 * 4
    return data[:at] + number + data[at + len(number) :]


def records_changed(records: Sequence[Record], rng: Rng, of_bytes: Change) -> list[Record]:
    """Records of which one or two are changed."""
    changed = list(records)
    if not changed:
        return changed
    at, other = (int(rng.integers(len(changed))) for _ in range(2))
    record = changed[at]
    what = int(rng.integers(9))
    if what == 0:
        changed[at:at] = [record] * int(rng.choice([1, 2, 50, 3000]))
    elif what == 1:
        del changed[at]
    elif what == 2:
        changed[at], changed[other] = changed[other], record
    elif what == 3:
        changed[at] = replace(record, content=changed[other].content)
    elif what == 4:
        changed[at] = replace(record, content=numbers_changed(record.content, rng))
    elif what == 5:
        changed[at] = replace(record, content=of_bytes(record.content, rng))
    elif what == 6:
        kind = changed[other].kind if rng.random() < 0.5 else rng.bytes(len(record.kind))
        changed[at] = replace(record, kind=kind)
    elif what == 7 and record.head:
        head = list(record.head)
        field = int(rng.integers(len(head)))
        head[field] = _other_number(head[field], rng)
        changed[at] = replace(record, head=tuple(head))
    else:
        cut = int(rng.integers(len(record.content) + 1))
        more = bytes(int(rng.choice([0, 0, 1, 8, 100_000, 1 << 22])))
        changed[at] = replace(record, content=record.content[:cut] + more)
    return changed


def _other_number(field: bytes, rng: Rng) -> bytes:
    """Another of the same length."""
    fitting = [number for number in _NUMBERS if len(number) == len(field)]
    return fitting[int(rng.integers(len(fitting)))] if fitting else rng.bytes(len(field))


# Bombs: zeros, compressed.


@cache
def bomb(way: str, megabytes: int = _BOMB_MB) -> bytes:
    """Megabytes of zeros, packed: by bz2, lz4, zlib, zstd, whose frame says its size, or zstd-mute, whose does not."""
    if way == "bz2":
        return _bz2_bomb(megabytes)
    if way == "lz4":
        return bytes(lz4.frame.compress(bytes(megabytes << 20)))
    if way == "zlib":
        packer, piece = zlib.compressobj(9), bytes(16 << 20)
        first, second = (packer.compress(piece) + packer.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
        adler = (megabytes << 20) % 65521 << 16 | 1
        return first + second * (megabytes // 16 - 1) + b"\x03\0" + struct.pack(">I", adler)
    # Blocks of one byte repeated, 128 kB each; the window is 8 MB, or the frame says its size.
    blocks = megabytes * 8
    block, last = (struct.pack("<I", (1 << 17) << 3 | 1 << 1 | end)[:3] + b"\0" for end in (0, 1))
    head = b"\xe0" + struct.pack("<Q", megabytes << 20) if way == "zstd" else b"\x00\x68"
    return b"\x28\xb5\x2f\xfd" + head + block * (blocks - 1) + last


def crc_of_zeros(count: int, begin: int) -> int:
    """The CRC-32 of so many zeros, a multiple of a megabyte, behind what has the CRC `begin`."""
    constant, columns = _crc_of_a_megabyte()
    for _ in range(count >> 20):
        crc = constant
        for bit, column in enumerate(columns):
            if begin >> bit & 1:
                crc ^= column
        begin = crc
    return begin


@cache
def _crc_of_a_megabyte() -> tuple[int, tuple[int, ...]]:
    """Over a megabyte of zeros a CRC changes linearly: its value behind 0, and by how much each bit changes that."""
    zeros = bytes(1 << 20)
    constant = zlib.crc32(zeros, 0)
    return constant, tuple(zlib.crc32(zeros, 1 << bit) ^ constant for bit in range(32))


def _bz2_bomb(megabytes: int) -> bytes:
    """One stream of equal blocks, each of which is the second of a shorter stream: 5 MB of zeros in 40 bytes."""
    short = bz2.compress(bytes(16 << 20), 1)
    bits, mark = f"{int.from_bytes(short, 'big'):0{8 * len(short)}b}", f"{0x314159265359:048b}"
    begins = [found.start() for found in re.finditer(mark, bits)]
    block = bits[begins[1] : begins[2]]
    count = (megabytes << 20) * len(begins) // (16 << 20)
    crc, of_block = 0, int(block[48:80], 2)
    for _ in range(count):
        crc = (crc << 1 & 0xFFFFFFFF | crc >> 31) ^ of_block
    whole = bits[: begins[0]] + block * count + f"{0x177245385090:048b}{crc:032b}"
    whole += "0" * (-len(whole) % 8)
    return int(whole, 2).to_bytes(len(whole) // 8, "big")


def _packed(way: str, data: bytes) -> bytes:
    """Data as a compression of bags packs it; zstd in raw blocks."""
    if way == "bz2":
        return bz2.compress(data, 1)
    if way == "lz4":
        return bytes(lz4.frame.compress(data))
    if way == "zstd":
        pieces = [data[at : at + (1 << 17)] for at in range(0, len(data), 1 << 17)] or [b""]
        blocks = (struct.pack("<I", len(piece) << 3 | (piece is pieces[-1]))[:3] + piece for piece in pieces)
        return b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", len(data)) + b"".join(blocks)
    return data


def _unpacked(way: str, data: bytes) -> bytes:
    """What is packed. Raises ValueError for a bomb that an earlier change has put there."""
    made = {
        "bz2": bz2.BZ2Decompressor,
        "lz4": lz4.frame.LZ4FrameDecompressor,
        "zstd": lambda: _zstd().ZstdDecompressor(),
    }
    if way not in made:
        return data
    found = bytes(made[way]().decompress(data, _MOST_UNPACKED))
    if len(found) == _MOST_UNPACKED:
        raise ValueError(way)
    return found


def _zstd() -> Any:
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd


# Bags of ROS 1: a head of fields `name=value`, and data.

_BAG_MAGIC = b"#ROSBAG V2.0\n"
_CHUNK, _CONNECTION, _CHUNK_INFO, _BAG_HEAD = b"\x05", b"\x07", b"\x06", b"\x03"


def _bag_records(data: bytes) -> list[Record]:
    found, at = [], 0
    while at < len(data):
        (length,) = struct.unpack_from("<I", data, at)
        head, at = data[at + 4 : at + 4 + length], at + 4 + length
        (length,) = struct.unpack_from("<I", data, at)
        content, at = data[at + 4 : at + 4 + length], at + 4 + length
        fields, begin = [], 0
        while begin < len(head):
            (size,) = struct.unpack_from("<I", head, begin)
            fields.append(head[begin + 4 : begin + 4 + size])
            begin += 4 + size
        kind = next((field[3:] for field in fields if field.startswith(b"op=")), b"\0")
        found.append(Record(kind, tuple(field for field in fields if not field.startswith(b"op=")), content))
    return found


def _bag_bytes(records: Sequence[Record]) -> bytes:
    parts = []
    for record in records:
        fields = (b"op=" + record.kind, *record.head)
        head = b"".join(struct.pack("<I", len(field)) + field for field in fields)
        parts.append(struct.pack("<I", len(head)) + head + struct.pack("<I", len(record.content)) + record.content)
    return b"".join(parts)


def _field(record: Record, name: bytes) -> bytes:
    return next((field[len(name) + 1 :] for field in record.head if field.startswith(name + b"=")), b"")


def _with_field(record: Record, name: bytes, value: bytes) -> Record:
    fields = tuple(field for field in record.head if not field.startswith(name + b"="))
    return replace(record, head=(*fields, name + b"=" + value))


def ros1_changed(data: bytes, rng: Rng, of_bytes: Change) -> bytes:
    """A bag of ROS 1: a record, a field of its head, a message in a chunk, or a chunk that unpacks to gigabytes."""
    if not data.startswith(_BAG_MAGIC):
        return data
    records = _bag_records(data[len(_BAG_MAGIC) :])
    chunks = [number for number, record in enumerate(records) if record.kind == _CHUNK]
    what = rng.random()
    if what < 0.15 and chunks:
        at = int(rng.choice(chunks))
        way = str(rng.choice(["bz2", "lz4"]))
        size = int(rng.choice([_BOMB_MB << 20, len(records[at].content), 0, (1 << 32) - 1]))
        bombed = _with_field(replace(records[at], content=bomb(way)), b"compression", way.encode())
        records[at] = _with_field(bombed, b"size", struct.pack("<I", size))
    elif what < 0.6 and chunks:
        at = int(rng.choice(chunks))
        way = _field(records[at], b"compression").decode()
        inside = records_changed(_bag_records(_unpacked(way, records[at].content)), rng, of_bytes)
        inside = [_with_head_changed(record, rng) if rng.random() < 0.1 else record for record in inside]
        content = _bag_bytes(inside)
        stated = struct.pack("<I", len(content) if rng.random() < 0.9 else int(rng.integers(1 << 32)))
        records[at] = _with_field(replace(records[at], content=_packed(way, content)), b"size", stated)
    elif what < 0.8:
        at = int(rng.integers(len(records)))
        records[at] = _with_head_changed(records[at], rng)
    else:
        records = records_changed(records, rng, of_bytes)
    return _BAG_MAGIC + _bag_bytes(_pointed(records))


def _with_head_changed(record: Record, rng: Rng) -> Record:
    """One field has another value, another name, or no end."""
    if not record.head:
        return record
    fields = list(record.head)
    at = int(rng.integers(len(fields)))
    name, _, value = fields[at].partition(b"=")
    others = (_other_number(value, rng), b"", b"\xff\xfe", value[:-1], b"x" * 5000, value + value)
    fields[at] = name + b"=" + others[int(rng.integers(len(others)))] if rng.random() < 0.9 else rng.bytes(5)
    return replace(record, head=tuple(fields))


def _pointed(records: Sequence[Record]) -> list[Record]:
    """The records with the places of the index and of chunks as they are by now."""
    places, at, pointed = [], len(_BAG_MAGIC), list(records)
    for record in records:
        places.append(at)
        at += len(_bag_bytes([record]))
    index = [place for record, place in zip(records, places, strict=True) if record.kind == _CONNECTION]
    chunks = iter([place for record, place in zip(records, places, strict=True) if record.kind == _CHUNK])
    for number, record in enumerate(records):
        if record.kind == _BAG_HEAD and len(_field(record, b"index_pos")) == 8 and index:
            pointed[number] = _with_field(record, b"index_pos", struct.pack("<Q", index[0]))
        elif record.kind == _CHUNK_INFO and len(_field(record, b"chunk_pos")) == 8:
            place = next(chunks, None)
            if place is not None:
                pointed[number] = _with_field(record, b"chunk_pos", struct.pack("<Q", place))
    return pointed


# MCAP: an operation, a length, and what it holds.

_MCAP_MAGIC = b"\x89MCAP0\r\n"
_MCAP_CHUNK, _DATA_END, _FOOTER = b"\x06", b"\x0f", b"\x02"


def _mcap_records(data: bytes) -> list[Record]:
    found, at = [], 0
    while at + 9 <= len(data):
        (length,) = struct.unpack_from("<Q", data, at + 1)
        found.append(Record(data[at : at + 1], (), data[at + 9 : at + 9 + length]))
        at += 9 + length
    return found


def _mcap_bytes(records: Sequence[Record]) -> bytes:
    return b"".join(record.kind + struct.pack("<Q", len(record.content)) + record.content for record in records)


def mcap_changed(data: bytes, rng: Rng, of_bytes: Change) -> bytes:
    """An MCAP file: a record, a message in a chunk, or a chunk that unpacks to gigabytes; mostly without an index."""
    if not (data.startswith(_MCAP_MAGIC) and data.endswith(_MCAP_MAGIC)):
        return data
    records = _mcap_records(data[len(_MCAP_MAGIC) : -len(_MCAP_MAGIC)])
    chunks = [number for number, record in enumerate(records) if record.kind == _MCAP_CHUNK]
    what = rng.random()
    if what < 0.7 and chunks:
        at = int(rng.choice(chunks))
        records[at] = _chunk_changed(records[at], rng, of_bytes, is_bomb=what < 0.15)
    else:
        records = records_changed(records, rng, of_bytes)
    if rng.random() < 0.6:  # places in the index are no longer right: a reader then goes through the file
        kinds = [record.kind for record in records]
        end = kinds.index(_DATA_END) if _DATA_END in kinds else len(records)
        records = [*records[:end], Record(_DATA_END, (), bytes(4)), Record(_FOOTER, (), bytes(20))]
    return _MCAP_MAGIC + _mcap_bytes(records) + _MCAP_MAGIC


def _chunk_changed(chunk: Record, rng: Rng, of_bytes: Change, *, is_bomb: bool) -> Record:
    start, end, size, crc, name = struct.unpack_from("<QQQII", chunk.content)
    way = chunk.content[32 : 32 + name].decode()
    content = chunk.content[32 + name + 8 :]
    if is_bomb:
        way = str(rng.choice(["zstd", "zstd-mute", "lz4"]))
        size = int(rng.choice([_BOMB_MB << 20, size, 0, 1 << 62]))
        content, way, crc = bomb(way), way.partition("-")[0], 0
    else:
        inside = _mcap_bytes(records_changed(_mcap_records(_unpacked(way, content)), rng, of_bytes))
        size = len(inside) if rng.random() < 0.9 else int(rng.choice([0, 1, len(inside) - 1, 1 << 40, 1 << 62]))
        content, crc = _packed(way, inside), 0
    head = struct.pack("<QQQII", start, end, size, crc, len(way)) + way.encode()
    return replace(chunk, content=head + struct.pack("<Q", len(content)) + content)


# sqlite3, as ROS 2 bags are: statements that change what a reader finds.

_STATEMENTS = (
    "UPDATE messages SET data = zeroblob(200000000) WHERE id = (SELECT min(id) FROM messages)",
    "UPDATE messages SET data = zeroblob({size})",
    "UPDATE messages SET data = x'' WHERE id % 2",
    "UPDATE messages SET data = NULL WHERE id % 3 = 0",
    "UPDATE messages SET data = 'text'",
    "UPDATE messages SET data = 5",
    "UPDATE messages SET data = ?bomb WHERE id % 2",
    "UPDATE messages SET data = ?mute WHERE id = (SELECT min(id) FROM messages)",
    "UPDATE messages SET timestamp = {number} WHERE id % 2",
    "UPDATE messages SET timestamp = 'noon'",
    "UPDATE messages SET timestamp = NULL",
    "UPDATE messages SET timestamp = 1e300",
    "UPDATE messages SET topic_id = {number} WHERE id % 2",
    "UPDATE messages SET topic_id = (SELECT max(id) FROM topics)",
    "UPDATE topics SET type = 'sensor_msgs/msg/Image'",
    "UPDATE topics SET type = 'none/such'",
    "UPDATE topics SET type = x'ff'",
    "UPDATE topics SET name = x'fffe' WHERE id = 1",
    "UPDATE topics SET name = (SELECT max(name) FROM topics)",
    "UPDATE topics SET name = 'a' || char(10) || char(27) || name",
    "UPDATE topics SET serialization_format = 'xml'",
    "UPDATE topics SET offered_qos_profiles = '[[[['",
    "UPDATE topics SET offered_qos_profiles = ''",
    "UPDATE schema SET schema_version = {number}",
    "UPDATE message_definitions SET encoded_message_definition = '{fields}'",
    "UPDATE message_definitions SET encoded_message_definition = ''",
    "UPDATE message_definitions SET encoded_message_definition = 'uint8[] data' || char(10) || 'x y z'",
    "UPDATE message_definitions SET encoding = 'ros2idl'",
    "DELETE FROM messages",
    "DELETE FROM messages WHERE id % 2",
    "DELETE FROM topics WHERE id = 1",
    "DELETE FROM message_definitions",
    "DROP TABLE messages",
    "DROP TABLE topics",
    "DROP TABLE schema",
    "DROP TABLE message_definitions",
    "ALTER TABLE messages RENAME COLUMN data TO content",
    "ALTER TABLE topics RENAME COLUMN type TO kind",
    "INSERT INTO messages (topic_id, timestamp, data) SELECT topic_id, timestamp, data FROM messages",
    "INSERT INTO topics (name, type, serialization_format, offered_qos_profiles, type_description_hash) "
    "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 20000) "
    "SELECT '/t' || i, 'std_msgs/msg/Header', 'cdr', '', '' FROM n",
    "CREATE VIEW other AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT * FROM n",
    "ALTER TABLE messages RENAME TO kept; CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT "
    "i + 1 FROM n) SELECT i AS id, 1 AS topic_id, i AS timestamp, zeroblob(100) AS data FROM n",
    "PRAGMA user_version = 5; PRAGMA application_id = 9",
)


def sqlite_changed(data: bytes, rng: Rng, of_bytes: Change) -> bytes:
    """A database after one statement; as it is where that does not fit it any more."""
    statement = _STATEMENTS[int(rng.integers(len(_STATEMENTS)))]
    number = int(rng.choice([-1, 0, 1 << 40, (1 << 63) - 1, -(1 << 63)]))
    fields = "\n".join(f"float64 x{i}" for i in range(int(rng.choice([0, 10, 1500, 20_000]))))
    statement = statement.format(size=int(rng.choice([0, 1, 4, 100, 5_000_000])), number=number, fields=fields)
    packed = {"?bomb": bomb("zstd"), "?mute": bomb("zstd-mute")}
    values = [packed[name] for name in packed if name in statement]
    for name in packed:
        statement = statement.replace(name, "?")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        path.write_bytes(data)
        connection = sqlite3.connect(path)
        try:
            if values:
                connection.execute(statement, values)
            else:
                connection.executescript(statement)
            connection.commit()
        except (sqlite3.Error, ValueError):  # an earlier change has damaged it
            return data
        finally:
            connection.close()
        return path.read_bytes()


def zstd_changed(data: bytes, rng: Rng, of_bytes: Change) -> bytes:
    """A file that zstd packed: what it holds is changed, or it unpacks to gigabytes."""
    if rng.random() < 0.3:
        return bomb(str(rng.choice(["zstd", "zstd-mute"])))
    try:
        inside = _unpacked("zstd", data)
    except Exception:  # an earlier change has damaged it
        return data
    changed = sqlite_changed if inside.startswith(b"SQLite format 3") else numbers_or_bytes_changed
    return _packed("zstd", changed(inside, rng, of_bytes))


def numbers_or_bytes_changed(data: bytes, rng: Rng, of_bytes: Change) -> bytes:
    """`numbers_changed`, or a change of bytes."""
    return numbers_changed(data, rng) if rng.random() < 0.7 else of_bytes(data, rng)


# Matroska: elements of an identity, a size, and what they hold, which for some are elements again.

_MASTER_NAMES = ("18538067", "1654ae6b", "ae", "e0", "e1", "1941a469", "61a7", "1f43b675", "a0", "1549a966", "1254c367")
_MASTERS = {bytes.fromhex(name) for name in _MASTER_NAMES}


def _elements(data: bytes, at: int, end: int) -> list[Record]:
    found = []
    while at < end:
        width = 9 - data[at].bit_length()
        kind, at = data[at : at + width], at + width
        width = 9 - data[at].bit_length()
        size = int.from_bytes(data[at : at + width], "big") & (1 << 7 * width) - 1
        at += width
        size = end - at if size == (1 << 7 * width) - 1 else size
        found.append(Record(kind, (), data[at : at + size]))
        at += size
    return found


def _element_bytes(records: Sequence[Record]) -> bytes:
    return b"".join(
        record.kind + (len(record.content) | 1 << 56).to_bytes(8, "big") + record.content for record in records
    )


def matroska_changed(data: bytes, rng: Rng, of_bytes: Change) -> bytes:
    """A Matroska file with one element changed, at any depth."""
    try:
        records = _elements(data, 0, len(data))
        masters = [number for number, record in enumerate(records) if record.kind in _MASTERS and record.content]
        if masters and rng.random() < 0.85:
            at = int(rng.choice(masters))
            records[at] = replace(records[at], content=matroska_changed(records[at].content, rng, of_bytes))
        else:
            records = records_changed(records, rng, of_bytes)
        return _element_bytes(records)
    except (IndexError, OverflowError):  # an earlier change has damaged it
        return data


# Journals of a map folder: a head and what it holds, each with a checksum.

_JOURNAL_HEAD, _JOURNAL_RECORD = struct.Struct("<8sII"), struct.Struct("<4sHHQIII")
_KEYS = (0, 1, 2, 3, 1000, 4_999_999, 5_000_000, 1 << 31, 1 << 40, (1 << 64) - 1)
_PICTURE = 4096
_SIZES_AT = 56  # in a keyframe: bytes before the lengths of its parts


def _journal_records(data: bytes) -> list[Record]:
    found, at = [], _JOURNAL_HEAD.size
    while at + _JOURNAL_RECORD.size <= len(data):
        _, kind, _, key, length, *_ = _JOURNAL_RECORD.unpack_from(data, at)
        at += _JOURNAL_RECORD.size
        found.append(Record(struct.pack("<H", kind), (struct.pack("<Q", key),), data[at : at + length]))
        at += length
    return found


def _journal_bytes(head: bytes, records: Sequence[Record]) -> bytes:
    parts = [head]
    for record in records:
        whole = struct.pack("<4s2sHQII", b"\xf5WSR", record.kind, 0, *struct.unpack("<Q", record.head[0]), 0, 0)
        whole = whole[:16] + struct.pack("<II", len(record.content), zlib.crc32(record.content))
        parts.append(whole + struct.pack("<I", zlib.crc32(whole)) + record.content)
    return b"".join(parts)


def first_journal(keyframes: Sequence[tuple[int, bytes]]) -> bytes:
    """A journal of version 1 of keyframes by number, as maps had them before 2026-11-27."""
    head = struct.pack("<8sI", b"WSJOURNL", 1)
    records = [Record(struct.pack("<H", 1), (struct.pack("<Q", number),), content) for number, content in keyframes]
    return _journal_bytes(head + struct.pack("<I", zlib.crc32(head)), records)


def journal_changed(data: bytes, rng: Rng, of_bytes: Change) -> bytes:
    """A journal: a record, its key, what it holds, or images of 17 million pixels; checksums fit."""
    records = _journal_records(data)
    if not records:
        return data
    at = int(rng.integers(len(records)))
    what = rng.random()
    if what < 0.25:
        key = struct.pack("<Q", _KEYS[int(rng.integers(len(_KEYS)))])
        records[at] = replace(records[at], head=(key,))
    elif what < 0.4 and b"WEBP" in records[at].content[_SIZES_AT:]:
        records[at] = replace(records[at], content=_with_pictures(records[at].content))
    elif what < 0.5:
        many = int(rng.choice([10, 300, 3000]))
        records[at:at] = [replace(records[at], head=(struct.pack("<Q", key),)) for key in range(many)]
    elif what < 0.6:  # heads without end: each asks for a checksum of all that follows
        head = _journal_bytes(b"", [replace(records[at], content=bytes(1000))])[: _JOURNAL_RECORD.size]
        return data + head * int(rng.choice([10, 3000])) + bytes(int(rng.choice([0, 1 << 20])))
    else:
        records = records_changed(records, rng, of_bytes)
    return _journal_bytes(data[: _JOURNAL_HEAD.size], records)


def _with_pictures(content: bytes) -> bytes:
    """A keyframe whose images are the largest that a header may tell, and pack into little."""
    sizes, at = struct.Struct("<5i"), _SIZES_AT
    depth, grey, *others = sizes.unpack_from(content, at)
    large, end = _large_picture(), at + sizes.size + 1
    step, rest = content[end - 1 : end], content[end + depth + grey :]
    return content[:at] + sizes.pack(len(large), len(large), *others) + step + large + large + rest


@cache
def _large_picture() -> bytes:
    image = np.zeros((_PICTURE, _PICTURE, 3), np.uint8)
    return cv2.imencode(".webp", image, (cv2.IMWRITE_WEBP_QUALITY, 101))[1].tobytes()


# .sens: a head of numbers, and frames of a colour image and depth that zlib packed.


def sens_changed(data: bytes, rng: Rng, of_bytes: Change) -> bytes:
    """A .sens: a number of its head or of a frame's, or a frame of other contents, with lengths that fit."""
    name = min(struct.unpack_from("<Q", data, 4)[0] if len(data) > 12 else 0, 1 << 20)
    begin = 12 + name + 4 * 64 + 36
    head, at, frames = data[:begin], begin, list[Record]()
    while at + 96 <= len(data):
        color, depth = struct.unpack_from("<QQ", data, at + 80)
        middle, end = at + 96 + color, at + 96 + color + depth
        frames.append(Record(data[at : at + 80], (data[at + 96 : middle],), data[middle:end]))
        at = end
    what = rng.random()
    if not frames or what < 0.4:
        at = len(head) - 44 + 4 * int(rng.integers(12)) if rng.random() < 0.7 else 4 * int(rng.integers(20))
        number = _other_number(bytes(4), rng)
        return data[: max(at, 0)] + number + data[max(at, 0) + 4 :]
    at = int(rng.integers(len(frames)))
    if what < 0.55:
        frames[at] = replace(frames[at], content=bomb("zlib"))
    elif what < 0.65:
        depth = zlib.compress(bytes(int(rng.choice([0, 1, 383, 385, 10_000_000]))))
        frames[at] = replace(frames[at], content=depth)
    elif what < 0.8:
        frames[at] = replace(frames[at], head=(of_bytes(frames[at].head[0], rng),))
    else:
        frames = records_changed(frames, rng, of_bytes)
    reported = (frame.kind + struct.pack("<QQ", len(frame.head[0]), len(frame.content)) for frame in frames)
    return head + b"".join(
        numbers + frame.head[0] + frame.content for numbers, frame in zip(reported, frames, strict=True)
    )


# Serial lines: frames of an encoding without zeros, and lines of text; and messages, one a line.


def serial_changed(data: bytes, rng: Rng, of_bytes: Change) -> bytes:
    """A serial line: pieces between zeros or line ends change places, come twice, or change to another format."""
    end = b"\0" if data.count(b"\0") > 3 else b"\n"
    pieces = [Record(piece[:1], (), piece[1:]) for piece in data.split(end)]
    changed = records_changed(pieces, rng, of_bytes)
    if rng.random() < 0.2:
        changed[int(rng.integers(len(changed) + 1)) : 0] = [Record(b"1", (), b",2\r")] * 30
    return end.join(piece.kind + piece.content for piece in changed)
