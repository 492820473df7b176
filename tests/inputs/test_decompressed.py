"""The gate for compressed data: sound data come out whole, bombs are stopped at the size that is allowed."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import sys
import tracemalloc
import zlib
from collections.abc import Callable
from functools import partial

import lz4.frame
import numpy as np
import pytest

from wheelsight.core.inputs import decompress_into, decompressed

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MEGABYTE = 1 << 20
COMPRESS: dict[str, Callable[[bytes], bytes]] = {
    "bz2": bz2.compress,
    "lz4": lz4.frame.compress,
    "xz": partial(lzma.compress, preset=0),
    "zlib": zlib.compress,
    "zstd": zstd.compress,
}
ways = pytest.mark.parametrize("way", COMPRESS)


def content(rng: np.random.Generator, size: int) -> bytes:
    return bytes(rng.integers(0, 4, size).astype(np.uint8))


@ways
@pytest.mark.parametrize("size", [0, 100, MEGABYTE + 1])
def test_content_comes_out_as_it_went_in(way: str, size: int, rng: np.random.Generator) -> None:
    raw = content(rng, size)
    packed = COMPRESS[way](raw)
    assert decompressed(packed, way, 4 * MEGABYTE, size) == raw
    assert decompressed(memoryview(packed), way, size) == raw
    # Writers may put several streams one after the other.
    assert decompressed(packed + packed, way, 8 * MEGABYTE) == raw + raw
    target = io.BytesIO()
    assert decompress_into(io.BytesIO(packed), target, way, size) == size
    assert target.getvalue() == raw


def test_gzip_is_zlib_with_another_header(rng: np.random.Generator) -> None:
    raw = content(rng, 1000)
    assert decompressed(gzip.compress(raw), "zlib", 1000) == raw


@ways
def test_another_size_than_stated_is_refused(way: str) -> None:
    packed = COMPRESS[way](bytes(1000))
    with pytest.raises(ValueError, match="beyond the 999 bytes that its header states"):
        decompressed(packed, way, MEGABYTE, 999)
    with pytest.raises(ValueError, match=f"states 1001 bytes of {way} content and holds 1000"):
        decompressed(packed, way, MEGABYTE, 1001)
    # zstd's own header states it, too.
    said = "states 1,000 bytes of zstd content, more than the 999" if way == "zstd" else "beyond the 999 bytes that are"
    with pytest.raises(ValueError, match=said):
        decompressed(packed, way, 999)
    with pytest.raises(ValueError, match=said):
        decompress_into(io.BytesIO(packed), io.BytesIO(), way, 999)


@ways
def test_a_stated_size_beyond_the_limit_is_refused_unread(way: str) -> None:
    with pytest.raises(ValueError, match=rf"states 4,096 MB of {way} content, more than the 1 MB allowed"):
        decompressed(b"", way, MEGABYTE, 1 << 32)


@ways
def test_what_is_cut_off_or_damaged_is_refused(way: str, rng: np.random.Generator) -> None:
    packed = COMPRESS[way](content(rng, 10_000))
    for share in (0.0, 0.3, 0.9):
        with pytest.raises(ValueError, match=f"holds (damaged )?{way} data"):
            decompressed(packed[: int(share * len(packed))], way, MEGABYTE)
    with pytest.raises(ValueError, match=f"holds damaged {way} data"):
        decompressed(b"\xff" * 40, way, MEGABYTE)


@ways
def test_a_bomb_takes_no_more_memory_than_is_allowed(way: str) -> None:
    bomb = COMPRESS[way](bytes(32 * MEGABYTE))
    assert len(bomb) < MEGABYTE
    tracemalloc.start()
    try:
        for stated in (None, MEGABYTE):
            with pytest.raises(ValueError, match=r"beyond|more than the 1 MB allowed"):
                decompressed(bomb, way, MEGABYTE, stated)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 24 * MEGABYTE  # xz has a dictionary of 8 MB
    sink = io.BytesIO()
    with pytest.raises(ValueError, match=r"beyond|more than the 1 MB allowed"):
        decompress_into(io.BytesIO(bomb), sink, way, MEGABYTE)
    assert sink.tell() <= MEGABYTE


def test_very_many_empty_streams_are_refused() -> None:
    with pytest.raises(ValueError, match="more than 10000 bz2 streams"):
        decompressed(bz2.compress(b"") * 10_001, "bz2", MEGABYTE)


def test_a_way_that_is_not_known_is_named() -> None:
    with pytest.raises(ValueError, match="is compressed by 'rar', which is not read"):
        decompressed(b"", "rar", MEGABYTE)
