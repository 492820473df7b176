"""How large an image is, by its first bytes, and images that are decoded only where that is within a limit."""

from __future__ import annotations

import re
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PNG_BITS, _PNG_COLORS = (1, 2, 4, 8, 16), (0, 2, 3, 4, 6)
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_BARE = frozenset([0x01, *range(0xD0, 0xD9)])
_JPEG_SCAN = 0xDA
_PNM = re.compile(rb"P[1-6](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})\s")
_PNM_REACH = 1024
_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_SAMPLES, _TIFF_TILE_WIDTH, _TIFF_TILE_HEIGHT = _TIFF_TAGS = (256, 257, 277, 322, 323)
_TIFF_MOST_FIELDS = 512
# Of an image of 33 million pixels whose program writes chunks of 8 kB, 12 000; what has more takes long to go through.
_MOST_PARTS = 100_000
# RIFF, its length, WEBP, VP8L, its length; a signature, and 14 bits each of width and height less one.
_WEBP = struct.Struct("<4sI4s4sIBI")


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Width and height in pixels of a PNG, JPEG, TIFF, BMP or PNM image; None where its header is none of theirs."""
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
    """How often decoding goes over the whole image: a progressive JPEG names its scans, all others have one."""
    return max(data.count(b"\xff\xda"), 1) if data.startswith(b"\xff\xd8") else 1


def lossless_webp_size(data: bytes) -> tuple[int, int] | None:
    """Width and height in pixels of a single lossless WebP image; None for any other."""
    if len(data) < _WEBP.size:
        return None
    riff, _, webp, lossless, _, signature, bits = _WEBP.unpack_from(data)
    is_one = (riff, webp, lossless, signature) == (b"RIFF", b"WEBP", b"VP8L", 0x2F)
    return (1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)) if is_one else None


def picture_within(data: bytes, most_px: tuple[int, int]) -> NDArray[Any] | None:
    """An image as it stands, (h, w) or (h, w, C), blue before red.

    None for what is no image of the kinds that `picture_size` and `lossless_webp_size` know, is damaged, or is wider or
    higher in pixels than `most_px` by its header; then nothing of it is decoded.
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
    """By the first chunk, if all chunks end within the data: room would be made for one that says it is larger."""
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
    """By the first frame header: segments are passed over by their lengths, thumbnails with them."""
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
    """Of the image, or of one of its tiles where that is larger."""
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
