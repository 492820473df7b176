"""The gate for input files: only regular files within the size limit of their `Kind` are opened. Compressed data,
`.npz` arrays and images are expanded only within stated limits.
"""

from __future__ import annotations

import bz2
import codecs
import io
import lzma
import math
import os
import re
import stat
import struct
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from typing import IO, Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wheelsight.core.errors import InputError
from wheelsight.core.files import StrPath
from wheelsight.core.runtime import needed

# Opening a pipe waits for a writer, a device may act when opened, and files of /proc have no size. What is no regular
# file is therefore recognised by its directory entry, and never opened.


_MEGABYTE = 1 << 20
_ODD = (
    (stat.S_ISDIR, "is a folder, not a file"),
    (stat.S_ISFIFO, "is a pipe, not a file"),
    (stat.S_ISSOCK, "is a socket, not a file"),
    (stat.S_ISCHR, "is a device, not a file"),
    (stat.S_ISBLK, "is a device, not a file"),
)
_COPY = "give an ordinary file"
_KERNEL_FOLDERS = ("/proc", "/sys", "/dev")


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of file with its limits.

    Attributes:
        name: for messages, such as "a list".
        most_mb: megabytes (2^20 bytes).
        most_lines: of text.
        longest_line: in characters.
        missing: problem in the message if there is no such file.
        fix: in the message for a file that is missing or cannot be read.
    """

    name: str
    most_mb: float
    most_lines: int = 1_500_000
    longest_line: int = 1 << 16
    missing: str = "cannot be read: No such file or directory"
    fix: str | None = None


def read_bytes(path: StrPath, kind: Kind, error: type[InputError]) -> bytes:
    """Return the content of a file.

    Raises:
        InputError: of the type `error`, with the file: it is missing, no regular file, or larger than its kind.
    """
    with open_binary(path, kind, error) as stream:
        try:
            return stream.read(min(os.fstat(stream.fileno()).st_size, int(kind.most_mb * _MEGABYTE)))
        except OSError as problem:
            raise error(f"cannot be read: {problem.strerror}", path=path, fix=kind.fix) from problem


def open_binary(path: StrPath, kind: Kind, error: type[InputError]) -> BinaryIO:
    """Return an open stream of a file's bytes, for large files. Raises as `read_bytes`."""
    path = Path(path)
    try:
        _check(path.stat(), path, kind, error)
        # The entry may have been replaced since the check; a pipe then opens without waiting.
        stream = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY), "rb")
        try:
            _check(os.fstat(stream.fileno()), path, kind, error)
        except BaseException:
            stream.close()
            raise
        return stream
    except FileNotFoundError as missing:
        raise error(kind.missing, path=path, fix=kind.fix) from missing
    except OSError as problem:
        raise error(f"cannot be read: {problem.strerror}", path=path, fix=kind.fix) from problem
    except ValueError as problem:  # NUL, or half a character, in the path
        raise error("is no name of a file", path=str(path), fix=kind.fix) from problem


def read_text(path: StrPath, kind: Kind, error: type[InputError]) -> str:
    """Return the text of a file in UTF-8, or in UTF-16 with a byte order mark, without the mark.

    Raises:
        InputError: as `read_bytes`; or it is no text, holds NUL, or has too many or too long lines.
    """
    path = Path(path)
    data = read_bytes(path, kind, error)
    is_utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if is_utf16 else "utf-8-sig")
    except UnicodeDecodeError as problem:
        raise error("is not a text file", path=path, fix="save it as text in UTF-8") from problem
    nul = text.find("\0")
    if nul >= 0:
        line = len(lines_of(text[:nul]))
        raise error("holds a NUL character", path=path, line=line, fix="save it as text in UTF-8")
    if max(text.count("\n"), text.count("\r")) > kind.most_lines:
        raise error(f"has more lines than {kind.name} may have: {kind.most_lines}", path=path, fix="split it")
    begin = 0
    while len(text) - begin > kind.longest_line:
        end = max(text.rfind(mark, begin, begin + kind.longest_line + 1) for mark in "\n\r")
        if end < 0:
            line = len(lines_of(text[:begin]))
            raise error(f"is longer than {kind.longest_line} characters", path=path, line=line, fix="is it text?")
        begin = end + 1
    return text


def lines_of(text: str) -> list[str]:
    """Return lines as editors count them: ended by line feed, carriage return, or both; the last may be empty."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def is_there(path: StrPath) -> bool:
    """Whether anything is at `path`, even a broken link: reading it then gives the error."""
    return os.path.lexists(path)


def _check(status: os.stat_result, path: Path, kind: Kind, error: type[InputError]) -> None:
    """Raise `error` for no ordinary file, or one larger than its kind."""
    for is_odd, problem in _ODD:
        if is_odd(status.st_mode):
            raise error(problem, path=path, fix=_COPY)
    if status.st_dev in _kernel_devices():
        raise error("is no file on a disk, but made by the system", path=path, fix=_COPY)
    if status.st_size > kind.most_mb * _MEGABYTE:
        holds, may = _size(status.st_size), _size(kind.most_mb * _MEGABYTE)
        problem = f"holds {holds}, more than {kind.name} may: {may}"
        raise error(problem, path=path, fix="is it the right file?")


def _size(size_bytes: float) -> str:
    return f"{size_bytes / _MEGABYTE:.0f} MB" if size_bytes >= _MEGABYTE else f"{size_bytes / 1024:.0f} kB"


@cache
def _kernel_devices() -> frozenset[int]:
    """Return the numbers of file systems whose files the kernel makes as they are read."""
    return frozenset(Path(folder).stat().st_dev for folder in _KERNEL_FOLDERS if os.path.ismount(folder))


# Compressed data: no more bytes are made than the header states and the user allows.


# Output of one step; memory grows with the content of a stream, not with its claim.
_STEP_BYTES = 1 << 20
# A file that consists of empty streams would take a decompressor each; recorders write one stream a block.
_MOST_STREAMS = 10_000
# Of an xz stream's dictionary: 64 MB is that of xz -9.
_MOST_XZ_MEMORY = 96 << 20
_ZSTD_HEAD = 18  # bytes, of a frame at most


def decompressed(data: bytes | memoryview, way: str, most_bytes: int, stated_bytes: int | None = None) -> bytes:
    """Return the content of compressed data, made step by step and never beyond a limit.

    Args:
        data: one stream or several, one after the other.
        way: "bz2", "lz4", "zstd", "xz" or "zlib".
        most_bytes: largest size that the user of the content allows.
        stated_bytes: size by the header beside the data, or None.

    Raises:
        ValueError: the stated size is beyond the limit, the content has another size, or the data are damaged. The
            text continues a sentence that begins with the name of the file.
        ConfigError: the library for this way is not installed.
    """
    _refuse_beyond(way, most_bytes, stated_bytes if stated_bytes is not None else _stated_by(way, data))
    limit = most_bytes if stated_bytes is None else stated_bytes
    parts: list[bytes] = []
    made = 0
    for part in _parts(way, iter((data,)), limit):
        parts.append(part)
        made += len(part)
        if made > limit:
            raise ValueError(_beyond(way, limit, stated_bytes is not None))
    if stated_bytes is not None and made != stated_bytes:
        raise ValueError(f"states {stated_bytes} bytes of {way} content and holds {made}")
    return parts[0] if len(parts) == 1 else b"".join(parts)


def decompress_into(source: BinaryIO, target: BinaryIO, way: str, most_bytes: int) -> int:
    """Copy the content of a compressed file into another; return its size. Raises as `decompressed`, and OSError."""
    made, first = 0, source.read(_STEP_BYTES)
    _refuse_beyond(way, most_bytes, _stated_by(way, first))
    for part in _parts(way, chain((first,), iter(lambda: source.read(_STEP_BYTES), b"")), most_bytes):
        made += len(part)
        if made > most_bytes:
            raise ValueError(_beyond(way, most_bytes, is_stated=False))
        target.write(part)
    return made


def _parts(way: str, pieces: Iterable[bytes | memoryview], limit: int) -> Iterator[bytes]:
    """Yield the content of compressed `pieces` in parts of at most a megabyte."""
    make, errors = _decompressors(way)
    decompressor, streams = make(), 1
    try:
        for piece in pieces:
            given = piece
            while len(given) or not (decompressor.eof or decompressor.needs_input):
                if decompressor.eof:
                    decompressor, streams = make(), streams + 1
                    if streams > _MOST_STREAMS:
                        raise ValueError(f"holds more than {_MOST_STREAMS} {way} streams")
                # One byte beyond the limit shows that there is more.
                part = decompressor.decompress(given, min(_STEP_BYTES, limit + 1))
                given = (decompressor.unused_data or b"") if decompressor.eof else b""
                if part:
                    yield part
    except errors as error:
        raise ValueError(f"holds damaged {way} data: {error}") from error
    if not decompressor.eof:
        raise ValueError(f"holds {way} data that are cut off")


class _Zlib:
    """zlib's decompressor with the names of the others."""

    def __init__(self) -> None:
        self._zlib = zlib.decompressobj(zlib.MAX_WBITS | 32)  # zlib's or gzip's header
        self.needs_input = True

    @property
    def eof(self) -> bool:
        """Whether the stream has ended."""
        return self._zlib.eof

    @property
    def unused_data(self) -> bytes:
        """Bytes after the stream."""
        return self._zlib.unused_data

    def decompress(self, data: bytes, most: int) -> bytes:
        """Return the next part of the content."""
        made = self._zlib.decompress(self._zlib.unconsumed_tail + data, most)
        self.needs_input = not self._zlib.unconsumed_tail and len(made) < most
        return made


def _decompressors(way: str) -> tuple[Callable[[], Any], tuple[type[Exception], ...]]:
    """Return a decompressor's constructor, and its errors for damaged data."""
    if way == "bz2":
        return bz2.BZ2Decompressor, (OSError, EOFError)
    if way == "xz":
        return lambda: lzma.LZMADecompressor(lzma.FORMAT_XZ, _MOST_XZ_MEMORY), (lzma.LZMAError, EOFError)
    if way == "zlib":
        return _Zlib, (zlib.error,)
    if way == "lz4":
        return needed("lz4.frame").LZ4FrameDecompressor, (RuntimeError, EOFError)
    if way == "zstd":
        return _zstd().ZstdDecompressor, (_zstd().ZstdError, EOFError)
    raise ValueError(f"is compressed by {way!r}, which is not read")


def _zstd() -> Any:
    return needed("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")


def _stated_by(way: str, data: bytes | memoryview) -> int | None:
    """Return the size that zstd data state themselves, or None."""
    if way != "zstd":
        return None
    zstd = _zstd()
    try:
        stated: int | None = zstd.get_frame_info(data[:_ZSTD_HEAD]).decompressed_size
    except zstd.ZstdError:
        return None
    return stated


def _refuse_beyond(way: str, most_bytes: int, stated_bytes: int | None) -> None:
    if stated_bytes is not None and stated_bytes > most_bytes:
        raise ValueError(f"states {_mb(stated_bytes)} of {way} content, more than the {_mb(most_bytes)} allowed")


def _beyond(way: str, limit: int, is_stated: bool) -> str:
    return f"holds {way} content beyond the {_mb(limit)} that {'its header states' if is_stated else 'are allowed'}"


def _mb(size: int) -> str:
    return f"{size:,} bytes" if size < 1 << 20 else f"{size / (1 << 20):,.0f} MB"


# Files of arrays (.npz): headers first; then numbers within the limits of headers and users.


_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others are unpacked whole, whatever size they state
_SUFFIX = ".npy"
_LONGEST_HEADER = 10_000
_MAGIC = b"\x93NUMPY"
_LENGTHS = {b"\x01\x00": struct.Struct("<H"), b"\x02\x00": struct.Struct("<I"), b"\x03\x00": struct.Struct("<I")}
# Of numbers alone, row by row; objects could run code.
_HEADER = re.compile(
    rb"\{'descr': '(?P<dtype>[<>|][biuf][0-9]{1,2})', 'fortran_order': False, "
    rb"'shape': \((?P<shape>(?:[0-9]{1,18}, ?)*(?:[0-9]{1,18})?)\), ?\}[ ]*\n"
)
_MOST_DIMENSIONS = 8
_ENTRY = b"PK\x01\x02"


class ArrayHeader(NamedTuple):
    """The header of an array."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def nbytes(self) -> int:
        """Of its numbers."""
        return math.prod(self.shape) * self.dtype.itemsize


class ArrayFile:
    """The arrays of an .npz file. Headers are read at once, numbers by `read`.

    Args:
        data: of the file.
        most_arrays: largest number of arrays.

    Raises:
        ValueError: it is no such file, or has an invalid header. The text continues a sentence that begins with the
            name of the file; so do those of `read`.
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
        """Headers by name."""
        return self._headers

    def read(self, name: str, most_bytes: int) -> NDArray[Any]:
        """Return an array of limited size in bytes.

        Raises:
            ValueError: it states more, and is not unpacked, or its size is not the stated one.
            KeyError: there is no array of that name.
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
    """Read the header of an array of numbers; these follow in the stream. Raises ValueError.

    numpy's own reader accepts any Python literal; this one accepts only what numpy writes.
    """
    magic = stream.read(len(_MAGIC) + 2)
    length = _LENGTHS.get(magic[len(_MAGIC) :]) if magic.startswith(_MAGIC) else None
    prefix = b"" if length is None else stream.read(length.size)
    size = length.unpack(prefix)[0] if length is not None and len(prefix) == length.size else 0
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


# Sizes of images by their headers; images are decoded only within a limit.


_PNG_BITS, _PNG_COLORS = (1, 2, 4, 8, 16), (0, 2, 3, 4, 6)
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_BARE = frozenset([0x01, *range(0xD0, 0xD9)])
_JPEG_SCAN = 0xDA
# Between the numbers of a header. No repetition within a repetition: a run of spaces would take exponential time.
PNM_GAP = rb"(?:\s|#[^\n]*\n)+"
_PNM = re.compile(rb"P[1-6]%b(\d{1,9})%b(\d{1,9})\s" % (PNM_GAP, PNM_GAP))
_PNM_REACH = 1024
_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_SAMPLES, _TIFF_TILE_WIDTH, _TIFF_TILE_HEIGHT = _TIFF_TAGS = (256, 257, 277, 322, 323)
_TIFF_MOST_FIELDS = 512
# An image of 33 million pixels in chunks of 8 kB has 12 000; more take long to read.
_MOST_PARTS = 100_000
# RIFF, its length, WEBP, VP8L, its length; a signature, and 14 bits each of width and height less one.
_WEBP = struct.Struct("<4sI4s4sIBI")


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Return width and height in pixels of a PNG, JPEG, TIFF, BMP or PNM image; None for other headers."""
    try:
        if data.startswith(b"\x89PNG\r\n\x1a\n"):
            return _png(data)
        if data.startswith(b"\xff\xd8"):
            return _jpeg(data)
        if data.startswith((b"II*\0", b"MM\0*")):
            return _tiff(data)
        if data.startswith(b"BM"):
            is_old = struct.unpack_from("<I", data, 14)[0] == 12
            width, height = _pair("<HH", data, 18) if is_old else _pair("<ii", data, 18)
            return abs(width), abs(height)
    except struct.error:
        return None
    found = _PNM.match(data[:_PNM_REACH])
    return None if found is None else (int(found[1]), int(found[2]))


def scan_count(data: bytes) -> int:
    """Return how often decoding passes over the image: the scans of a progressive JPEG, else 1."""
    return max(data.count(b"\xff\xda"), 1) if data.startswith(b"\xff\xd8") else 1


def lossless_webp_size(data: bytes) -> tuple[int, int] | None:
    """Return width and height in pixels of a single lossless WebP image, else None."""
    if len(data) < _WEBP.size:
        return None
    riff, _, webp, lossless, _, signature, bits = _WEBP.unpack_from(data)
    is_one = (riff, webp, lossless, signature) == (b"RIFF", b"WEBP", b"VP8L", 0x2F)
    return (1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)) if is_one else None


def picture_within(data: bytes, most_px: tuple[int, int]) -> NDArray[Any] | None:
    """Return an unchanged image (h, w) or (h, w, C), blue before red.

    None for a damaged image, a format that neither `picture_size` nor `lossless_webp_size` knows, or one wider or
    higher than `most_px` by its header, which is not decoded.
    """
    import cv2

    size = picture_size(data) or lossless_webp_size(data)
    if size is None or not all(0 < side <= most for side, most in zip(size, most_px, strict=True)):
        return None
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    return None if image is None or image.shape[1::-1] != size else np.asarray(image)


def _pair(form: str, data: bytes, begin: int) -> tuple[int, int]:
    first, second = struct.unpack_from(form, data, begin)
    return first, second


def _png(data: bytes) -> tuple[int, int] | None:
    """By the first chunk, if all chunks end within the data: decoders allocate the stated length."""
    at, kinds, kind = 8, [], b""
    while at < len(data) and kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", data, at)
        kinds.append(kind)
        at += 12 + length
        if at > len(data) or len(kinds) > _MOST_PARTS:
            return None
    width, height, bits, color, _, _, interlace = struct.unpack_from(">IIBBBBB", data, 16)
    is_still = kinds[0] == b"IHDR" and kinds.count(b"IHDR") == 1 and b"acTL" not in kinds
    return (width, height) if is_still and bits in _PNG_BITS and color in _PNG_COLORS and interlace < 2 else None


def _jpeg(data: bytes) -> tuple[int, int] | None:
    """By the first frame header; segments, and thumbnails in them, are skipped by their lengths."""
    at = 2
    for _ in range(_MOST_PARTS):
        if data[at : at + 1] != b"\xff":
            return None
        marker = data[at + 1] if at + 1 < len(data) else _JPEG_SCAN
        if marker == 0xFF:  # a fill byte
            at += 1
        elif marker in _JPEG_BARE:
            at += 2
        elif marker in _JPEG_FRAMES:
            height, width = _pair(">HH", data, at + 5)
            return width, height
        elif marker == _JPEG_SCAN or marker == 0xD9:
            return None
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    return None


def _tiff(data: bytes) -> tuple[int, int] | None:
    """Of the image, or of one of its tiles if that is larger."""
    order = "<" if data[:2] == b"II" else ">"
    (begin,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, begin)
    found: dict[int, int] = {}
    for at in range(begin + 2, begin + 2 + 12 * min(count, _TIFF_MOST_FIELDS), 12):
        tag, kind = _pair(f"{order}HH", data, at)
        if tag in _TIFF_TAGS:
            found[tag] = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", data, at + 8)[0]
    if not {_TIFF_WIDTH, _TIFF_HEIGHT} <= found.keys() or count > _TIFF_MOST_FIELDS or found.get(_TIFF_SAMPLES, 1) > 4:
        return None
    sides = ((_TIFF_WIDTH, _TIFF_TILE_WIDTH), (_TIFF_HEIGHT, _TIFF_TILE_HEIGHT))
    width, height = (max(found.get(tag, 0) for tag in side) for side in sides)
    return width, height
