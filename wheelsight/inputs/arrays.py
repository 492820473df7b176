"""The gate for files of arrays (.npz): headers first, and of the numbers no more than these state and users allow."""

from __future__ import annotations

import io
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others are unpacked whole, whatever size they state
_SUFFIX = ".npy"
_LONGEST_HEADER = 10_000
_MAGIC = b"\x93NUMPY"
_LENGTHS = {b"\x01\x00": struct.Struct("<H"), b"\x02\x00": struct.Struct("<I"), b"\x03\x00": struct.Struct("<I")}
# Of numbers alone, row by row: never of objects, which could do something.
_HEADER = re.compile(
    rb"\{'descr': '(?P<dtype>[<>|][biuf][0-9]{1,2})', 'fortran_order': False, "
    rb"'shape': \((?P<shape>(?:[0-9]{1,18}, ?)*(?:[0-9]{1,18})?)\), ?\}[ ]*\n"
)
_MOST_DIMENSIONS = 8
_ENTRY = b"PK\x01\x02"


class ArrayHeader(NamedTuple):
    """What the header of an array says.

    Attributes:
        shape: of the array.
        dtype: of its numbers.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def nbytes(self) -> int:
        """Of its numbers."""
        return math.prod(self.shape) * self.dtype.itemsize


class ArrayFile:
    """The arrays of an .npz file, whose headers are read at once, and whose numbers when they are asked for.

    Args:
        data: of the file.
        most_arrays: it may hold.

    Raises:
        ValueError: it is no such file, or one of its headers is none. The text continues a sentence that begins with
            the name of the file; so do those of `read`.
    """

    def __init__(self, data: bytes, most_arrays: int = 64) -> None:
        if data.count(_ENTRY) > most_arrays:
            raise ValueError(f"holds more than {most_arrays} arrays")
        self._entries: dict[str, zipfile.ZipInfo] = {}
        self._headers: dict[str, ArrayHeader] = {}
        try:
            self._archive = zipfile.ZipFile(io.BytesIO(data))
            for entry in self._archive.infolist():
                name = entry.filename.removesuffix(_SUFFIX)
                if name in self._entries or entry.compress_type not in _PACKED or entry.flag_bits & 1:
                    raise ValueError(f"holds {entry.filename!r} in a way that is not read")
                self._entries[name] = entry
                with self._archive.open(entry) as stream:
                    self._headers[name] = _header(stream, entry)
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, struct.error) as error:
            raise ValueError(f"is no file of arrays: {error}") from error

    @property
    def headers(self) -> Mapping[str, ArrayHeader]:
        """By name, as the file states them."""
        return self._headers

    def read(self, name: str, most_bytes: int) -> NDArray[Any]:
        """An array, of so many bytes at most.

        Raises:
            ValueError: it states more, which is then not unpacked, or holds another number than it states.
            KeyError: there is none of that name.
        """
        header, entry = self._headers[name], self._entries[name]
        if header.nbytes > most_bytes:
            raise ValueError(f"states {header.nbytes:,} bytes of {name}, more than the {most_bytes:,} allowed")
        try:
            with self._archive.open(entry) as stream:
                _header(stream, entry)
                flat = stream.read(header.nbytes)
                if len(flat) != header.nbytes or stream.read(1):
                    raise ValueError(f"holds {name}, an array that is not what it says")
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError) as error:
            raise ValueError(f"holds {name}, which is damaged: {error}") from error
        return np.frombuffer(flat, header.dtype).reshape(header.shape).copy()


def _header(stream: IO[bytes], entry: zipfile.ZipInfo) -> ArrayHeader:
    """What an array begins with; its numbers follow in the stream. Raises ValueError for what is none of numbers.

    numpy's own reader takes whatever Python its tokenizer takes; this one takes what numpy writes.
    """
    magic = stream.read(len(_MAGIC) + 2)
    length = _LENGTHS.get(magic[len(_MAGIC) :]) if magic.startswith(_MAGIC) else None
    told = b"" if length is None else stream.read(length.size)
    size = length.unpack(told)[0] if length is not None and len(told) == length.size else 0
    match = _HEADER.fullmatch(stream.read(size)) if size <= _LONGEST_HEADER else None
    if match is None:
        raise ValueError(f"holds {entry.filename!r}, which is no array of numbers")
    shape = tuple(int(side) for side in match["shape"].split(b",") if side.strip())
    try:
        found = ArrayHeader(shape, np.dtype(match["dtype"].decode()))
    except TypeError as error:
        raise ValueError(f"holds {entry.filename!r}, of numbers of no kind") from error
    if len(shape) > _MOST_DIMENSIONS or stream.tell() + found.nbytes != entry.file_size:
        raise ValueError(f"holds {entry.filename!r}, an array that is not what it says")
    return found
