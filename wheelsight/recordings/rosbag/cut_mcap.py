"""MCAP files as rosbags can read them, damaged or without an end, as a kill or an empty battery leaves them.

What is whole of the latter is read.
"""

from __future__ import annotations

import io
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_ANY_SIZE = 1 << 20  # bytes for which there is room
# Records that end the part of a file that holds messages, and those that hold them.
_DATA_END, _FOOTER = 0x0F, 0x02
# A footer that tells of no summary: a reader then goes through the file.
_END = _HEAD.pack(_DATA_END, 4) + bytes(4) + _HEAD.pack(_FOOTER, 20) + bytes(20) + MAGIC


@dataclass(frozen=True, slots=True)
class McapFile:
    """A file that stands in for its path where rosbags opens one: of its stream no more is read than there is.

    Damaged records say that they are as large as may be, and rosbags asks for so much.

    Attributes:
        path: the file.
    """

    path: Path

    @property
    def name(self) -> str:
        """The file's."""
        return self.path.name

    @property
    def suffix(self) -> str:
        """Of its name."""
        return self.path.suffix

    def __str__(self) -> str:
        return str(self.path)

    def exists(self) -> bool:
        """Whether it is there."""
        return self.path.exists()

    def is_dir(self) -> bool:
        """It is a file."""
        return False

    def open(self, mode: str = "rb") -> Any:
        """A stream."""
        return _Bounded(self._raw(mode))

    def _raw(self, mode: str) -> io.RawIOBase:
        return io.FileIO(self.path, mode.replace("b", ""))


@dataclass(frozen=True, slots=True)
class CutMcap(McapFile):
    """A file that begins as MCAP, and ends as if its last whole record were followed by an end.

    Attributes:
        whole_bytes: of its whole records.
        lost_bytes: after them.
    """

    whole_bytes: int
    lost_bytes: int

    def _raw(self, mode: str) -> io.RawIOBase:
        return _Ended(self.path.open(mode), self.whole_bytes)  # type: ignore[arg-type]


def cut_mcap(path: Path) -> CutMcap | None:
    """What is whole of a file that is MCAP and lacks its end; None of any other. Raises OSError."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            return None
        stream.seek(-min(len(MAGIC), size), os.SEEK_END)
        if stream.read() == MAGIC and size > len(MAGIC):
            return None
        whole = _whole_bytes(stream, size)
    return None if whole is None else CutMcap(path, whole, size - whole)


def _whole_bytes(stream: BinaryIO, size: int) -> int | None:
    """Where the last whole record of the data ends; None where not even the header is whole."""
    at = len(MAGIC)
    while at + _HEAD.size <= size:
        stream.seek(at)
        kind, length = _HEAD.unpack(stream.read(_HEAD.size))
        if kind in (_DATA_END, _FOOTER) or at + _HEAD.size + length > size:
            break
        at += _HEAD.size + length
    return at if at > len(MAGIC) else None


class _Bounded(io.BufferedReader):
    """Room is made for what is asked for: so it is asked for no more than is left."""

    def __init__(self, raw: io.RawIOBase) -> None:
        super().__init__(raw)
        self._size = self.seek(0, os.SEEK_END)
        self.seek(0)

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > _ANY_SIZE:
            size = min(size, max(self._size - self.tell(), 0))
        return super().read(size)


class _Ended(io.RawIOBase):
    """The first bytes of a stream, and an end of our own."""

    def __init__(self, stream: BinaryIO, whole_bytes: int) -> None:
        self._stream, self._whole, self._at = stream, whole_bytes, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        begins = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._whole + len(_END)}
        self._at = begins[whence] + offset
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        room = memoryview(buffer).cast("B")
        if self._at < self._whole:
            self._stream.seek(self._at)
            data = self._stream.read(min(len(room), self._whole - self._at))
        else:
            data = _END[self._at - self._whole :][: len(room)]
        room[: len(data)] = data
        self._at += len(data)
        return len(data)

    def close(self) -> None:
        self._stream.close()
        super().close()
