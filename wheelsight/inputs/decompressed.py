"""The gate for everything that is compressed: no more bytes are made than its header states and its user allows."""

from __future__ import annotations

import bz2
import lzma
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import Any, BinaryIO

from wheelsight.extras import needed

# Output of one step; memory grows with what a stream really holds, not with what it claims.
_STEP_BYTES = 1 << 20
# A file that consists of empty streams would take a decompressor each; recorders write one stream a block.
_MOST_STREAMS = 10_000
# Of an xz stream's dictionary: 64 MB is that of xz -9.
_MOST_XZ_MEMORY = 96 << 20
_ZSTD_HEAD = 18  # bytes, of a frame at most


def decompressed(data: bytes | memoryview, way: str, most_bytes: int, stated_bytes: int | None = None) -> bytes:
    """The content of compressed data, made step by step and never beyond a limit.

    Args:
        data: one stream or several, one after the other.
        way: "bz2", "lz4", "zstd", "xz" or "zlib".
        most_bytes: the most that the user of the content allows.
        stated_bytes: the size that the header beside the data states; None where there is none.

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
    """Copy the content of a compressed file into another one; its size. Raises as `decompressed`, and OSError."""
    made, first = 0, source.read(_STEP_BYTES)
    _refuse_beyond(way, most_bytes, _stated_by(way, first))
    for part in _parts(way, chain((first,), iter(lambda: source.read(_STEP_BYTES), b"")), most_bytes):
        made += len(part)
        if made > most_bytes:
            raise ValueError(_beyond(way, most_bytes, is_stated=False))
        target.write(part)
    return made


def _parts(way: str, pieces: Iterable[bytes | memoryview], limit: int) -> Iterator[bytes]:
    """The content part by part; `pieces` are the compressed bytes. No part has over a megabyte."""
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
    """zlib's decompressor with the names that all others have."""

    def __init__(self) -> None:
        self._zlib = zlib.decompressobj(zlib.MAX_WBITS | 32)  # zlib's or gzip's header
        self.needs_input = True

    @property
    def eof(self) -> bool:
        """Whether the stream has ended."""
        return self._zlib.eof

    @property
    def unused_data(self) -> bytes:
        """What follows the stream."""
        return self._zlib.unused_data

    def decompress(self, data: bytes, most: int) -> bytes:
        """The next part of the content."""
        made = self._zlib.decompress(self._zlib.unconsumed_tail + data, most)
        self.needs_input = not self._zlib.unconsumed_tail and len(made) < most
        return made


def _decompressors(way: str) -> tuple[Callable[[], Any], tuple[type[Exception], ...]]:
    """What makes a decompressor, and what it raises at damaged data."""
    if way == "bz2":
        return bz2.BZ2Decompressor, (OSError, EOFError)
    if way == "xz":
        return lambda: lzma.LZMADecompressor(lzma.FORMAT_XZ, _MOST_XZ_MEMORY), (lzma.LZMAError, EOFError)
    if way == "zlib":
        return _Zlib, (zlib.error,)
    if way == "lz4":
        return needed("lz4.frame").LZ4FrameDecompressor, (RuntimeError, EOFError)
    if way == "zstd":
        zstd = _zstd()
        return zstd.ZstdDecompressor, (zstd.ZstdError, EOFError)
    raise ValueError(f"is compressed by {way!r}, which is not read")


def _zstd() -> Any:
    return needed("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")


def _stated_by(way: str, data: bytes | memoryview) -> int | None:
    """The size that the data themselves state, as most of zstd's do; None where they do not."""
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
