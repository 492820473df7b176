"""Files of a map folder: append-only journals, their contents, and the header `map.json`.

A journal begins with its name, its version, and a checksum of both. Each record has a head: a mark, kind, key, length,
a checksum of the content, and one of the head itself. Numbers are little-endian.

A robot may lose power at any moment. An incomplete record at the end of a file, the torn tail, is dropped and counted.
An invalid part before a valid record is disk damage: it is skipped, counted, and reported with its offset.
"""

from __future__ import annotations

import json
import math
import os
import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import IntEnum
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from wheelsight._version import __version__
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import MapError
from wheelsight.core.files import StrPath, output_error, write_text
from wheelsight.core.geometry import MOST_PIXELS, FloatArray, IntArray, se3
from wheelsight.core.geometry.motion_kernels import is_definite
from wheelsight.core.inputs import Kind, parse_json, read_bytes, read_text
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.graph import RelativePose

# Version 2 has another kind of keyframe records, which readers of version 1 would treat as lost.
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
# Limit when reading: a writer begins a new journal long before. Reading this many takes 2 s and 150 MB.
_MOST_RECORDS = 300_000
# Limit of bytes checksummed without success: twice the journal's length plus 64 MB. Disk damage checksums each of its
# bytes once. Checking a head takes as long as a checksum of 4 kB.
_VAIN_SHARE, _VAIN_BYTES, _BYTES_A_HEAD = 2, 64 << 20, 4096


class Record(NamedTuple):
    """Position of a record in its journal.

    Attributes:
        kind: a `RecordKind`.
        key: key, such as the number of a keyframe.
        offset: offset of its head in the file, bytes.
        length: length of its content, bytes.
        crc: CRC-32 of its content.
    """

    kind: int
    key: int
    offset: int
    length: int
    crc: int


@dataclass(frozen=True, slots=True)
class Damage:
    """Invalid bytes of a journal, with valid records after them."""

    path: Path
    offset: int
    length: int

    def __str__(self) -> str:
        return f"{self.path.name}: {self.length:,} bytes from byte {self.offset:,} on are damaged"


@dataclass(frozen=True, slots=True)
class JournalContents:
    """Contents of a journal.

    Attributes:
        records: valid records in order, with their content.
        damages: invalid parts between them.
        torn_bytes: number of bytes dropped at the end.
    """

    path: Path
    records: tuple[tuple[Record, memoryview], ...]
    damages: tuple[Damage, ...]
    torn_bytes: int


class JournalWriter:
    """Appends records to a new journal.

    Writes are unbuffered: appended data survives a kill of the process. After `flush`, it survives a loss of power.

    Raises OutputError if the file cannot be made or written; also raised by each method.
    """

    def __init__(self, path: StrPath) -> None:
        self.path, self.size = Path(path), 0
        try:
            self._stream: IO[bytes] = self.path.open("xb", buffering=0)
        except OSError as error:
            raise output_error(error, self.path) from error
        self._write(_with_crc(_FILE_HEAD.pack(_NAME, VERSION)))

    def append(self, kind: int, key: int, content: bytes) -> Record:
        """Write a record, and return its position."""
        record = Record(kind, key, self.size, len(content), zlib.crc32(content))
        self._write(_with_crc(_HEAD.pack(_MARK, kind, 0, key, record.length, record.crc)) + content)
        return record

    def flush(self) -> None:
        """Wait until all appended data is on disk."""
        try:
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise output_error(error, self.path) from error

    def close(self) -> None:
        """Flush, and close the file even if that fails."""
        try:
            self.flush()
        finally:
            self._stream.close()

    def _write(self, data: bytes) -> None:
        try:
            written = 0
            while written < len(data):  # a nearly full disk accepts only a part
                written += self._stream.write(data[written:])
        except OSError as error:
            raise output_error(error, self.path) from error
        self.size += len(data)


def read_journal(path: StrPath) -> JournalContents:
    """Return all valid records of a journal.

    Raises MapError if it cannot be read, is not a journal, is of a newer version, has too many records, or is damaged
    in more places than disk damage explains.
    """
    path = Path(path)
    data = memoryview(read_bytes(path, _JOURNAL, MapError))
    begin = 0
    if len(data) >= FIRST_RECORD and _is_sound(data[:FIRST_RECORD]):
        name, version = _FILE_HEAD.unpack_from(data)
        if name != _NAME:
            raise MapError("is no journal of a map", path=path, fix=_JOURNAL.fix)
        if version > VERSION:
            raise MapError(f"is of version {version}, newer than {VERSION}", path=path, fix=_NEWER)
        begin = FIRST_RECORD
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
    """Read the content of a record. Raises MapError with file and offset if it has changed."""
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


def _whole_records(data: memoryview, begin: int, path: Path) -> Iterator[Record]:
    """Yield the valid records. After damage, continue at the next mark of a valid record.

    A mark may lie within the content claimed by a valid head. Checksumming all such contents could take quadratic time,
    so the total is limited. Raises MapError if more is checksummed than disk damage explains.
    """
    raw, at, wasted = data.obj, begin, 0
    assert isinstance(raw, bytes)
    while 0 <= at <= len(data) - HEAD_BYTES:
        record = None
        if _is_sound(data[at : at + HEAD_BYTES]):
            mark, kind, _, key, length, crc = _HEAD.unpack_from(data, at)
            record = Record(kind, key, at, length, crc) if mark == _MARK else None
        end = at + HEAD_BYTES + (0 if record is None else record.length)
        if record is not None and end <= len(data) and zlib.crc32(data[at + HEAD_BYTES : end]) == record.crc:
            yield record
            at = end
            continue
        wasted += _BYTES_A_HEAD + (end - at if end <= len(data) else 0)
        if wasted > _VAIN_SHARE * len(data) + _VAIN_BYTES:
            raise MapError("is damaged in more places than a disk damages", path=path, fix=_DAMAGED)
        at = raw.find(_MARK, at + 1)


def _with_crc(head: bytes) -> bytes:
    return head + _CRC.pack(zlib.crc32(head))


def _is_sound(head: memoryview) -> bool:
    """Return whether the last four bytes are the checksum of those before."""
    return bool(_CRC.unpack(head[-_CRC.size :])[0] == zlib.crc32(head[: -_CRC.size]))


# Contents of records other than keyframes: initial poses of keyframes, edges, and changed poses.

_PLACE_RECORD = struct.Struct("<d?7x12d12d")
_MOTION, _COVARIANCE = 12, 36
_EDGE_RECORD = np.dtype([("ends", "<i8", 2), ("is_loop", "<i8"), ("T", "<f8", _MOTION), ("C", "<f8", _COVARIANCE)])
_POSE_RECORD = np.dtype([("number", "<i8"), ("T", "<f8", _MOTION)])
# Above these limits, sums of squares overflow. No robot drives 1000 km within a map.
_FARTHEST_M, _LARGEST_VARIANCE = 1e6, 1e18
_UNKNOWN = np.full((4, 4), np.nan)


class RecordKind(IntEnum):
    """Kinds of records. Maps from before 2026-11-27 have `FIRST_KEYFRAME`."""

    FIRST_KEYFRAME = 1
    PLACE = 2
    EDGES = 3
    WITHDRAWN = 4
    POSES = 5
    KEYFRAME = 6


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Pose of a keyframe when it was added.

    Attributes:
        T_map_keyframe: (4, 4) at that time.
        T_odom_keyframe: (4, 4) pose in odom, or None.
    """

    stamp_s: float
    T_map_keyframe: FloatArray
    T_odom_keyframe: FloatArray | None = None


def pack_place(place: Place) -> bytes:
    """Return the record of a place."""
    T_odom = _UNKNOWN if place.T_odom_keyframe is None else place.T_odom_keyframe
    has_odom = place.T_odom_keyframe is not None
    return _PLACE_RECORD.pack(place.stamp_s, has_odom, *_flat_motion(place.T_map_keyframe), *_flat_motion(T_odom))


def unpack_place(content: bytes) -> Place:
    """Return the place of a record. Raises MapError."""
    if len(content) != _PLACE_RECORD.size:
        raise MapError("is no place of a keyframe", fix=_DAMAGED)
    stamp_s, has_odom, *numbers = _PLACE_RECORD.unpack(content)
    if not np.isfinite(stamp_s):
        raise MapError("is a keyframe of no time", fix=_DAMAGED)
    T_odom = _motions_of(np.array(numbers[_MOTION:]))[0] if has_odom else None
    return Place(stamp_s, _motions_of(np.array(numbers[:_MOTION]))[0], T_odom)


def pack_edges(edges: Sequence[RelativePose]) -> bytes:
    """Return the record of edges."""
    table = np.zeros(len(edges), _EDGE_RECORD)
    for row, edge in zip(table, edges, strict=True):
        row["ends"], row["is_loop"] = (edge.first, edge.second), edge.is_loop
        row["T"], row["C"] = _flat_motion(edge.T_first_second), edge.covariance.ravel()
    return table.tobytes()


def unpack_edges(content: bytes) -> tuple[RelativePose, ...]:
    """Return the edges of a record. Raises MapError."""
    table = _record_table(content, _EDGE_RECORD, "edges")
    T = _motions_of(table["T"])
    edges = []
    for row, T_first_second in zip(table, T, strict=True):
        first, second = (KeyframeId(int(end)) for end in row["ends"])
        C = np.array(row["C"], float).reshape(6, 6)
        is_sound = first != second and min(first, second) >= 0 and bool((np.abs(C) < _LARGEST_VARIANCE).all())
        if not is_sound or not is_definite(C):
            raise MapError("holds an invalid edge", fix=_DAMAGED)
        edges.append(RelativePose(first, second, T_first_second, C, bool(row["is_loop"])))
    return tuple(edges)


def pack_poses(numbers: Sequence[int] | IntArray, T_map_keyframe: FloatArray) -> bytes:
    """Return the record of keyframe numbers (K,) and poses (K, 4, 4)."""
    table = np.zeros(len(numbers), _POSE_RECORD)
    table["number"], table["T"] = numbers, T_map_keyframe[:, :3].reshape(-1, _MOTION)
    return table.tobytes()


def unpack_poses(content: bytes) -> tuple[IntArray, FloatArray]:
    """Return the numbers and poses of a record. Raises MapError."""
    table = _record_table(content, _POSE_RECORD, "poses")
    return table["number"].astype(np.int64), _motions_of(table["T"])


def pack_numbers(numbers: Sequence[int]) -> bytes:
    """Return the record of numbers, such as those of withdrawn edges."""
    return np.asarray(numbers, "<i8").tobytes()


def unpack_numbers(content: bytes) -> tuple[int, ...]:
    """Return the numbers of a record. Raises MapError."""
    return tuple(_record_table(content, np.dtype("<i8"), "numbers").tolist())


def _record_table(content: bytes, dtype: np.dtype, what: str) -> np.ndarray:
    if len(content) % dtype.itemsize:
        raise MapError(f"holds {len(content)} bytes, which are no {what}", fix=_DAMAGED)
    return np.frombuffer(content, dtype)


def _flat_motion(T: FloatArray) -> FloatArray:
    return np.asarray(T, float)[:3].ravel()


def _motions_of(rows: FloatArray) -> FloatArray:
    """Return poses (K, 4, 4) from their upper three rows, flat. Raises MapError for invalid ones."""
    T = np.zeros((rows.size // _MOTION, 4, 4))
    T[:, :3], T[:, 3, 3] = rows.reshape(-1, 3, 4), 1.0
    if not (np.abs(rows) < _FARTHEST_M).all() or (len(T) and not se3.is_valid(T, tolerance=1e-4)):
        raise MapError("holds poses that are no rigid motions", fix=_DAMAGED)
    return T


@dataclass(frozen=True, slots=True)
class Health:
    """Damage of a map folder.

    Attributes:
        torn_bytes: number of bytes dropped at the ends of journals, after a kill or a loss of power.
        dropped: number of keyframes at the end that are incomplete.
        missing: keyframes lost to damage.
        beyond: keyframes left out for an impossibly large number.
        unfinished: what was making the map, see `MapHeader`; "" if it is finished.
    """

    torn_bytes: int = 0
    dropped: int = 0
    damages: tuple[Damage, ...] = ()
    missing: tuple[int, ...] = ()
    beyond: tuple[int, ...] = ()
    unfinished: str = ""
    is_being_made: bool = False

    @property
    def is_whole(self) -> bool:
        """Whether there is no damage other than a torn tail."""
        return not self.damages and not self.missing and not self.beyond and not self.incomplete

    @property
    def incomplete(self) -> str:
        """Reason why the map is unusable after an interrupted rebuild, merge, prune or removal; "" if it is usable."""
        if self.unfinished in ("", DRIVE):
            return ""
        why = f"{self.unfinished} is still making it" if self.is_being_made else f"{self.unfinished} was ended"
        return f"incomplete: {why}"

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence on each problem."""
        notes = [f"The map is {self.incomplete}; {RUN_AGAIN}."] if self.incomplete else []
        if self.unfinished == DRIVE:
            notes.append("A drive still writes it." if self.is_being_made else _CUT_OFF)
        if self.torn_bytes or self.dropped:
            what = f"{self.torn_bytes:,} bytes and {self.dropped} keyframes at the end"
            notes.append(f"The drive was cut off: {what} were not whole and are left out.")
        notes += [f"{damage}." for damage in self.damages]
        if self.missing:
            notes.append(f"{len(self.missing)} keyframes are lost: {_shown(self.missing)}.")
        if self.beyond:
            notes.append(f"Keyframes of impossible numbers are left out: {_shown(self.beyond)}.")
        return tuple(notes)


KEYFRAMES, GRAPH = "keyframes", "graph"
_SUFFIX = ".journal"
# Limit when reading: more than a thousand hours of driving leave.
_MOST_EDGES = 5_000_000
# Tables are as long as the largest keyframe number. Half of all keyframes, or several journals of a short map, may be
# lost. A larger number is damage, and would allocate memory for keyframes that never existed.
_LOST_SHARE, _LOST_KEYFRAMES = 2, 10_000
# Ten digits would be more journals than a folder has files.
_JOURNAL_NAME = re.compile(r"[0-9]{1,9}")
RUN_AGAIN = "run it again"
_CUT_OFF = "The drive was ended before its map was finished: what it saw last may be missing."


@dataclass(frozen=True, slots=True, eq=False)
class FolderContents:
    """Contents of all journals of a map folder.

    Attributes:
        where: journal and record of each valid keyframe, by number.
        places: pose of each keyframe when it was added, by number.
        T_map_keyframe: (N, 4, 4) current poses; NaN if lost to damage.
        edge_count: number of edges, with withdrawn ones.
    """

    where: dict[int, tuple[Path, Record]]
    places: dict[int, Place]
    T_map_keyframe: FloatArray
    edges: tuple[RelativePose, ...]
    edge_count: int
    health: Health


def read_contents(folder: Path) -> FolderContents:
    """Return the contents of all journals. Raises MapError for an unreadable file or impossible contents."""
    where: dict[int, tuple[Path, Record]] = {}
    torn_bytes, damages = 0, list[Damage]()
    for journal in map(read_journal, journals_of(folder, KEYFRAMES)):
        torn_bytes += journal.torn_bytes
        damages += journal.damages
        kinds = RecordKind.KEYFRAME, RecordKind.FIRST_KEYFRAME
        where |= {record.key: (journal.path, record) for record, _ in journal.records if record.kind in kinds}
    graph = _Graph()
    for journal in map(read_journal, journals_of(folder, GRAPH)):
        torn_bytes += journal.torn_bytes
        damages += journal.damages
        for record, content in journal.records:
            try:
                graph.add_record(record, bytes(content))
            except MapError as error:
                problem = f"its record at byte {record.offset:,} {error.problem}"
                raise MapError(problem, path=journal.path, fix=error.fix) from error
    known = where.keys() & graph.places.keys()
    end = _LOST_SHARE * len(known) + _LOST_KEYFRAMES
    beyond = tuple(sorted(number for number in known if number >= end))
    count = 1 + max(known.difference(beyond), default=-1)
    missing = tuple(number for number in range(count) if number not in known)
    dropped = sum(number >= count for number in where.keys() | graph.places.keys()) - len(beyond)
    T_map_keyframe = np.full((count, 4, 4), np.nan)
    for number, T in graph.T.items():
        if 0 <= number < count:
            T_map_keyframe[number] = T
    held = {number: where[number] for number in sorted(known) if number < count}
    edges = tuple(edge for _, edge in sorted(graph.edges.items()) if max(edge.first, edge.second) < count)
    health = Health(torn_bytes, dropped, tuple(damages), missing, beyond)
    places = {number: place for number, place in graph.places.items() if number < count}
    return FolderContents(held, places, T_map_keyframe, edges, graph.edge_count, health)


@dataclass
class _Graph:
    """Contents of the graph journals, updated record by record."""

    places: dict[int, Place] = field(default_factory=dict)
    T: dict[int, FloatArray] = field(default_factory=dict)
    edges: dict[int, RelativePose] = field(default_factory=dict)
    edge_count: int = 0

    def add_record(self, record: Record, content: bytes) -> None:
        """Add the content of a record. Raises MapError for an inconsistent one."""
        if record.kind == RecordKind.PLACE:
            place = unpack_place(content)
            self.places[record.key], self.T[record.key] = place, place.T_map_keyframe
        elif record.kind == RecordKind.EDGES:
            if record.key > _MOST_EDGES:
                raise MapError(f"holds edge {record.key}", fix=_DAMAGED)
            # Keyed by the first edge's number, so that damage before it does not shift the withdrawn ones.
            found = unpack_edges(content)
            self.edges |= dict(enumerate(found, start=record.key))
            self.edge_count = max(self.edge_count, record.key + len(found))
        elif record.kind == RecordKind.WITHDRAWN:
            for number in unpack_numbers(content):
                self.edges.pop(number, None)
        elif record.kind == RecordKind.POSES:
            numbers, T = unpack_poses(content)
            self.T.update(zip(numbers.tolist(), T, strict=True))


def _numbered(folder: Path, kind: str) -> Iterator[tuple[int, Path]]:
    """Yield journals with their numbers, without other files of similar names."""
    for path in folder.glob(f"{kind}-*{_SUFFIX}"):
        digits = path.stem.removeprefix(f"{kind}-")
        if _JOURNAL_NAME.fullmatch(digits):
            yield int(digits), path


def _shown(numbers: tuple[int, ...]) -> str:
    return ", ".join(map(str, numbers[:5])) + (" and more" if len(numbers) > 5 else "")


def journal_name(kind: str, number: int) -> str:
    """Return a name such as keyframes-00002.journal."""
    return f"{kind}-{number:05d}{_SUFFIX}"


def journals_of(folder: Path, kind: str) -> list[Path]:
    """Return the journals of a kind in the order in which they were written."""
    return [path for _, path in sorted(_numbered(folder, kind))]


def next_number(folder: Path, kind: str) -> int:
    """Return the number of the next journal."""
    return 1 + max((number for number, _ in _numbered(folder, kind)), default=-1)


FORMAT, HEADER_VERSION = "wheelsight-map-folder", 1
HEADER_FILE = "map.json"
DRIVE, REBUILD, MERGE, PRUNE, REMOVAL = MAKERS = ("drive", "rebuild", "merge", "prune", "removal")
"""Long operations that write or remove a map."""
_NO_MAP = "give a folder that `wheelsight run` left as its map"
_FILE = Kind("the header of a map", most_mb=1, fix=_NO_MAP, missing="is no map: map.json is missing")
# Largest difference of focal lengths, and of the principal point relative to the image size, between cameras that count
# as the same. Estimated: two calibrations of one Kinect differ by 1 %.
_CAMERA_SHARE = 0.02
_LENS = ("fx", "fy", "cx", "cy")
_SIZE = ("width", "height")


@dataclass(frozen=True, slots=True)
class MapCamera:
    """Camera of a map: image size and intrinsics, by which another camera is compared.

    Attributes:
        width, height: size of depth images, pixels.
        fx, fy, cx, cy: intrinsics of the depth camera, pixels.
        is_registered: whether colour and depth share one pixel grid.
        depth_factor: depth units per metre, if the run overrode its format's; else None.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    is_registered: bool
    depth_factor: float | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of depth images; keyframes have none that are larger."""
        return self.width, self.height

    @classmethod
    def of(cls, calibration: Calibration, depth_factor: float | None = None) -> MapCamera:
        """Return the depth camera of a calibration. Raises CalibrationError if there is none."""
        _, depth = calibration.cameras
        fx, fy, cx, cy = (float(getattr(depth, name)) for name in _LENS)
        return cls(int(depth.width), int(depth.height), fx, fy, cx, cy, calibration.is_registered, depth_factor)

    def why_other(self, other: MapCamera) -> str | None:
        """Return how another camera differs by more than `_CAMERA_SHARE`; None if it does not."""
        if (self.width, self.height) != (other.width, other.height):
            return f"its images are {self.width}×{self.height}, these {other.width}×{other.height}"
        limits = {"fx": self.fx, "fy": self.fy, "cx": self.width, "cy": self.height}
        for name, size in limits.items():
            mine, theirs = getattr(self, name), getattr(other, name)
            if abs(mine - theirs) > _CAMERA_SHARE * size:
                return f"its {name} is {mine:.1f} px, here {theirs:.1f}"
        if self.is_registered != other.is_registered:
            mine, here = ("", " not") if self.is_registered else (" not", "")
            return f"its depth is{mine} registered to colour, here it is{here}"
        factors = self.depth_factor, other.depth_factor
        if factors[0] is not None and factors[1] is not None and abs(factors[0] / factors[1] - 1) > _CAMERA_SHARE:
            return f"its depth factor is {factors[0]:g}, here {factors[1]:g}"
        return None


@dataclass(frozen=True, slots=True)
class MapHeader:
    """Header of a map folder.

    Attributes:
        made: time of creation, ISO 8601 in UTC.
        unfinished: what makes the map, or was interrupted: one of `MAKERS`; "" if it is finished.
    """

    camera: MapCamera
    made_by: str
    made: str
    source: str = ""
    unfinished: str = ""
    version: int = HEADER_VERSION

    @classmethod
    def new(cls, camera: MapCamera, source: str = "", unfinished: str = "") -> MapHeader:
        """Return the header of a map that begins now."""
        made = datetime.now(UTC).isoformat(timespec="seconds")
        return cls(camera, f"wheelsight {__version__}", made, source, unfinished)

    @property
    def is_usable(self) -> bool:
        """Whether it is finished, or made by a drive: a part of a drive is a map, and a part of a merge is not."""
        return self.unfinished in ("", DRIVE)

    def save(self, folder: StrPath) -> None:
        """Write map.json. Raises OutputError."""
        camera = {name: getattr(self.camera, name) for name in (*_SIZE, *_LENS, "is_registered", "depth_factor")}
        fields = {"made_by": self.made_by, "made": self.made, "source": self.source, "camera": camera}
        document: dict[str, Any] = {"format": FORMAT, "version": self.version, **fields}
        if self.unfinished:
            document["unfinished"] = self.unfinished
        document["crc32"] = _crc(document)
        write_text(Path(folder) / HEADER_FILE, json.dumps(document, indent=2) + "\n")


def read_header(folder: StrPath) -> MapHeader:
    """Read map.json. Raises MapError if it is missing, damaged, or of a newer version."""
    path = Path(folder) / HEADER_FILE
    text = read_text(path, _FILE, MapError)
    try:
        document = parse_json(text)
    except ValueError as error:
        raise MapError(f"is damaged: {error}", path=path, fix=_DAMAGED) from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise MapError(f"is not of format {FORMAT!r}", path=path, fix=_NO_MAP)
    version = document.get("version")
    if type(version) is not int or version < 1:
        raise MapError(f"its version is {version!r}", path=path, fix=_DAMAGED)
    if version > HEADER_VERSION:
        problem = f"is of version {version}, newer than {HEADER_VERSION}, which this wheelsight reads"
        raise MapError(problem, path=path, fix="open it with the wheelsight that wrote it, or a newer one")
    crc = document.pop("crc32", None)
    if crc != _crc(document):
        raise MapError("its checksum is wrong: it is damaged, or was edited", path=path, fix=_DAMAGED)
    try:
        return _header(document)
    except (KeyError, TypeError, ValueError) as error:
        raise MapError(f"is damaged: {type(error).__name__}", path=path, fix=_DAMAGED) from error


def _header(document: dict[str, Any]) -> MapHeader:
    camera, factor = document["camera"], document["camera"]["depth_factor"]
    width, height = (int(camera[name]) for name in _SIZE)
    fx, fy, cx, cy = (float(camera[name]) for name in _LENS)
    if min(width, height) < 1 or width * height > MOST_PIXELS or not all(map(math.isfinite, (fx, fy, cx, cy))):
        raise ValueError("no camera has such images")
    depth_factor = None if factor is None else float(factor)
    if depth_factor is not None and not 0 < depth_factor < math.inf:
        raise ValueError("no camera has such units")
    of_camera = MapCamera(width, height, fx, fy, cx, cy, bool(camera["is_registered"]), depth_factor)
    made_by, made, source = (str(document[name]) for name in ("made_by", "made", "source"))
    unfinished = document.get("unfinished", "")
    if unfinished not in ("", *MAKERS):
        raise ValueError("nothing makes maps so")
    return MapHeader(of_camera, made_by, made, source, unfinished, document["version"])


def _crc(document: dict[str, Any]) -> int:
    """Return a checksum of all values, independent of order and layout."""
    return zlib.crc32(json.dumps(document, sort_keys=True, separators=(",", ":")).encode())
