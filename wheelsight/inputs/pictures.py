"""How large an image is, told by its first bytes, before anything of it is decoded."""

from __future__ import annotations

import re
import struct

_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_BARE = frozenset([0x01, *range(0xD0, 0xD9)])
_JPEG_SCAN = 0xDA
_PNM = re.compile(rb"P[1-6](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})\s")
_PNM_REACH = 1024
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257
_TIFF_MOST_FIELDS = 512


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Width and height in pixels of a PNG, JPEG, TIFF, BMP or PNM image; None where its header is none of theirs."""
    try:
        if data.startswith(b"\x89PNG\r\n\x1a\n"):
            return _pair(">II", data, 16) if data[12:16] == b"IHDR" else None
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
    """How often decoding goes over the whole image: a progressive JPEG names its scans, all others have one."""
    return max(data.count(b"\xff\xda"), 1) if data.startswith(b"\xff\xd8") else 1


def _pair(form: str, data: bytes, begin: int) -> tuple[int, int]:
    first, second = struct.unpack_from(form, data, begin)
    return first, second


def _jpeg(data: bytes) -> tuple[int, int] | None:
    """By the first frame header: segments are passed over by their lengths, thumbnails with them."""
    at = 2
    while True:
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


def _tiff(data: bytes) -> tuple[int, int] | None:
    order = "<" if data[:2] == b"II" else ">"
    (begin,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, begin)
    found: dict[int, int] = {}
    for at in range(begin + 2, begin + 2 + 12 * min(count, _TIFF_MOST_FIELDS), 12):
        tag, kind = _pair(f"{order}HH", data, at)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT):
            found[tag] = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", data, at + 8)[0]
    if len(found) < 2 or count > _TIFF_MOST_FIELDS:
        return None
    return found[_TIFF_WIDTH], found[_TIFF_HEIGHT]
