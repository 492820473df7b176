"""Journals: files that records are put to the end of, and that are never rewritten in place.

A file begins with its name, its version and a checksum of both. Each record has a head: a mark, its kind, its key, how
long it is, a checksum of what it holds, and one of the head itself. Numbers are in little-endian order.

A robot may lose power at any moment. What is not whole at the end of a file is dropped and counted: the torn tail. What
is not whole before a record that is whole was damaged on the disk: it is skipped, counted, and told with its place.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NamedTuple

from wheelsight.errors import MapError
from wheelsight.files import StrPath, output_error
from wheelsight.inputs import Kind, read_bytes

# 2: keyframes of another kind than 1 has, which older readers would pass over as lost.
VERSION = 2
_NAME = b"WSJOURNL"
_MARK = b"\xf5WSR"
_FILE_HEAD = struct.Struct("<8sI")
_HEAD = struct.Struct("<4sHHQII")
_CRC = struct.Struct("<I")
HEAD_BYTES = _HEAD.size + _CRC.size
FIRST_RECORD = _FILE_HEAD.size + _CRC.size
_JOURNAL = Kind("a journal of a map", most_mb=2048, fix="give a folder that `wheelsight run` left as its map")
_NEWER = "read it with the wheelsight that wrote it, or a newer one"
_DAMAGED = "use another copy of the map"
# Of a journal that is read: a writer begins another one long before, and to go through so many takes 2 s and 150 MB.
_MOST_RECORDS = 300_000
# Bytes that are checksummed in vain, in a journal twice as long at most and 64 MB besides: where a disk damages a
# journal that is each of its bytes once. To look at a head takes as long as to checksum 4 kB.
_VAIN_SHARE, _VAIN_BYTES, _BYTES_A_HEAD = 2, 64 << 20, 4096


class Record(NamedTuple):
    """Where a record is in its journal.

    Attributes:
        kind: what it holds.
        key: such as the number of a keyframe.
        offset: of its head in the file, bytes.
        length: of what it holds, bytes.
        crc: of what it holds.
    """

    kind: int
    key: int
    offset: int
    length: int
    crc: int


@dataclass(frozen=True, slots=True)
class Damage:
    """Bytes of a journal, with whole records after them, that are no record."""

    path: Path
    offset: int
    length: int

    def __str__(self) -> str:
        return f"{self.path.name}: {self.length:,} bytes from byte {self.offset:,} on are damaged"


@dataclass(frozen=True, slots=True)
class JournalContents:
    """What a journal holds.

    Attributes:
        path: the file.
        records: those that are whole, in their order, with what they hold.
        damages: what was skipped between them.
        torn_bytes: what was dropped at the end.
    """

    path: Path
    records: tuple[tuple[Record, memoryview], ...]
    damages: tuple[Damage, ...]
    torn_bytes: int


class JournalWriter:
    """Puts records to the end of a new journal.

    Nothing is kept back: what was appended outlives the process. `flush` makes it outlive a loss of power, too.

    Raises:
        OutputError: the file cannot be made or written; also by each of its methods.
    """

    def __init__(self, path: StrPath) -> None:
        self.path, self.size = Path(path), 0
        try:
            self._stream: IO[bytes] = self.path.open("xb", buffering=0)
        except OSError as error:
            raise output_error(error, self.path) from error
        self._write(_with_crc(_FILE_HEAD.pack(_NAME, VERSION)))

    def append(self, kind: int, key: int, content: bytes) -> Record:
        """Write a record."""
        record = Record(kind, key, self.size, len(content), zlib.crc32(content))
        self._write(_with_crc(_HEAD.pack(_MARK, kind, 0, key, record.length, record.crc)) + content)
        return record

    def flush(self) -> None:
        """Wait until all that was appended is on the disk."""
        try:
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise output_error(error, self.path) from error

    def close(self) -> None:
        """The same, and close the file, whatever went wrong."""
        try:
            self.flush()
        finally:
            self._stream.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        self._stream.close()

    def _write(self, data: bytes) -> None:
        try:
            written = 0
            while written < len(data):  # a disk that is nearly full takes a part
                written += self._stream.write(data[written:])
        except OSError as error:
            raise output_error(error, self.path) from error
        self.size += len(data)


def read_journal(path: StrPath) -> JournalContents:
    """All records of a journal that are whole.

    Raises:
        MapError: naming the file: it cannot be read, is no journal, is of a newer version, holds too many records, or
            is damaged in more places than a disk damages.
    """
    path = Path(path)
    data = memoryview(read_bytes(path, _JOURNAL, MapError))
    begin = _first_record(data, path)
    records, damages = list[tuple[Record, memoryview]](), list[Damage]()
    end = begin
    for record in _whole_records(data, begin, path):
        if len(records) == _MOST_RECORDS:
            raise MapError(f"holds more than {_MOST_RECORDS:,} records", path=path, fix="is it the right file?")
        if record.offset > end:
            damages.append(Damage(path, end, record.offset - end))
        end = record.offset + HEAD_BYTES + record.length
        records.append((record, data[end - record.length : end]))
    if begin == 0 and not records and len(data) >= FIRST_RECORD:
        raise MapError("is no journal of a map", path=path, fix=_JOURNAL.fix)
    return JournalContents(path, tuple(records), tuple(damages), len(data) - end)


def read_record(path: StrPath, record: Record) -> bytes:
    """What a record holds, read anew. Raises MapError, naming file and place, where it is not what it was."""
    path = Path(path)
    try:
        with path.open("rb") as stream:
            stream.seek(record.offset + HEAD_BYTES)
            content = stream.read(record.length)
    except OSError as error:
        raise MapError(f"cannot be read: {error.strerror}", path=path, fix="copy the whole folder") from error
    if len(content) != record.length or zlib.crc32(content) != record.crc:
        raise MapError(f"its record at byte {record.offset:,} is damaged", path=path, fix=_DAMAGED)
    return content


def _first_record(data: memoryview, path: Path) -> int:
    """Where records begin: after the head of the file, or at 0 where that is not whole. Raises MapError."""
    if len(data) < FIRST_RECORD or not _is_sound(data[:FIRST_RECORD]):
        return 0
    name, version = _FILE_HEAD.unpack_from(data)
    if name != _NAME:
        raise MapError("is no journal of a map", path=path, fix=_JOURNAL.fix)
    if version > VERSION:
        raise MapError(f"is of version {version}, newer than {VERSION}", path=path, fix=_NEWER)
    return FIRST_RECORD


def _whole_records(data: memoryview, begin: int, path: Path) -> Iterator[Record]:
    """One after the other; behind what is damaged, on from the next mark that a whole record begins with.

    A mark may stand within what a sound head names its content: to checksum each such content would take time that
    grows with the square of their number. Raises MapError where more is checksummed in vain than damage explains.
    """
    raw, at, vain = data.obj, begin, 0
    assert isinstance(raw, bytes)
    while 0 <= at <= len(data) - HEAD_BYTES:
        record = _head_at(data, at)
        end = at + HEAD_BYTES + (0 if record is None else record.length)
        if record is not None and end <= len(data) and zlib.crc32(data[at + HEAD_BYTES : end]) == record.crc:
            yield record
            at = end
            continue
        vain += _BYTES_A_HEAD + (end - at if end <= len(data) else 0)
        if vain > _VAIN_SHARE * len(data) + _VAIN_BYTES:
            raise MapError("is damaged in more places than a disk damages", path=path, fix=_DAMAGED)
        at = raw.find(_MARK, at + 1)


def _head_at(data: memoryview, at: int) -> Record | None:
    """The record that a sound head names, whether or not its content is whole."""
    if not _is_sound(data[at : at + HEAD_BYTES]):
        return None
    mark, kind, _, key, length, crc = _HEAD.unpack_from(data, at)
    return Record(kind, key, at, length, crc) if mark == _MARK else None


def _with_crc(head: bytes) -> bytes:
    return head + _CRC.pack(zlib.crc32(head))


def _is_sound(head: memoryview) -> bool:
    """Whether the last four bytes are the checksum of those before."""
    return bool(_CRC.unpack(head[-_CRC.size :])[0] == zlib.crc32(head[: -_CRC.size]))
