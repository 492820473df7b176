"""Sizes are those that OpenCV decodes, and reported without decoding."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest

from wheelsight.core.inputs import picture_size, picture_within, scan_count

SIZE = (37, 21)


@pytest.mark.parametrize("kind", [".png", ".jpg", ".bmp", ".tiff", ".pgm", ".ppm", ".pbm"])
def test_the_size_is_that_of_the_decoded_image(kind: str, rng: np.random.Generator) -> None:
    shape = (SIZE[1], SIZE[0]) if kind in (".pgm", ".pbm") else (SIZE[1], SIZE[0], 3)
    written, data = cv2.imencode(kind, rng.integers(0, 255, shape, np.uint8))
    assert written
    assert picture_size(data.tobytes()) == SIZE


def test_a_thumbnail_before_the_image_is_passed_over(rng: np.random.Generator) -> None:
    image = cv2.imencode(".jpg", rng.integers(0, 255, (SIZE[1], SIZE[0], 3), np.uint8))[1].tobytes()
    thumbnail = cv2.imencode(".jpg", np.zeros((5, 6, 3), np.uint8))[1].tobytes()
    segment = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    assert picture_size(image[:2] + segment + image[2:]) == SIZE


def test_scans_of_a_progressive_jpeg_are_counted(rng: np.random.Generator) -> None:
    image = rng.integers(0, 255, (16, 16, 3), np.uint8)
    assert scan_count(cv2.imencode(".jpg", image)[1].tobytes()) == 1
    assert scan_count(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()) > 5
    assert scan_count(cv2.imencode(".png", image)[1].tobytes()) == 1


def chunk(kind: bytes, data: bytes, length: int | None = None) -> bytes:
    size = len(data) if length is None else length
    return struct.pack(">I", size) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@pytest.mark.parametrize(
    "parts",
    [
        chunk(b"IHDR", struct.pack(">IIBBBBB", 16, 12, 16, 0, 0, 0, 0)) + chunk(b"IDAT", b"x", length=0xFF7F0076),
        chunk(b"IHDR", struct.pack(">IIBBBBB", 16, 12, 255, 255, 255, 0, 54)),
        chunk(b"IHDR", struct.pack(">IIBBBBB", 16, 12, 16, 0, 0, 0, 0)) + chunk(b"acTL", bytes(8)),
        chunk(b"IDAT", b"x") + chunk(b"IHDR", struct.pack(">IIBBBBB", 16, 12, 16, 0, 0, 0, 0)),
    ],
)
def test_a_png_whose_parts_contradict_it_has_no_size(parts: bytes) -> None:
    """OpenCV makes room for a chunk of four gigabytes, and takes ten seconds to fill it, before it looks for them."""
    assert picture_size(b"\x89PNG\r\n\x1a\n" + parts + chunk(b"IEND", b"")) is None


@pytest.mark.parametrize("white", [b" ", b"\n", b"#\n", b" #a\n"])
def test_a_header_of_white_space_is_read_in_a_moment(white: bytes) -> None:
    """Repetitions within repetitions of a regular expression would take years."""
    assert picture_size(b"P5\n9" + white * 400) is None
    assert picture_size(b"P5" + white * 100 + b"9" + white * 20 + b"7\n255\n") in ((9, 7), None)


@pytest.mark.parametrize("count", [99_000, 101_000])
def test_what_would_take_long_to_go_through_has_no_size(count: int) -> None:
    """Each is of so many parts; readers are to refuse in a moment what is made to hold them up."""
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 16, 12, 16, 0, 0, 0, 0))
    png = b"\x89PNG\r\n\x1a\n" + header + count * chunk(b"tEXt", b"") + chunk(b"IEND", b"")
    frame = b"\xff\xc0" + struct.pack(">HBHHB", 8, 8, 12, 16, 1)
    size = (16, 12) if count < 100_000 else None
    assert picture_size(png) == size
    assert picture_size(b"\xff\xd8" + count * b"\xff\x01" + frame) == size
    assert picture_size(b"\xff\xd8" + count * b"\xff" + frame) == size


def test_a_tile_larger_than_its_image_counts() -> None:
    fields = ((256, 16), (257, 16), (322, 1 << 16), (323, 1 << 15))
    packed = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in fields)
    assert picture_size(b"II*\0" + struct.pack("<IH", 8, len(fields)) + packed) == (1 << 16, 1 << 15)


@pytest.mark.parametrize(
    "data",
    [b"", b"\x89PNG", b"\x89PNG\r\n\x1a\n" + bytes(20), b"\xff\xd8", b"\xff\xd8\xff", b"\xff\xd8\xff\xe0\0\x04", b"BM"]
    + [b"II*\0\xff\xff\xff\xff", b"P5", b"P6 10", b"GIF89a\x10\0\x10\0", b"\xff\xd8" + b"\xff" * 10],
)
def test_what_has_no_such_header_has_no_size(data: bytes) -> None:
    assert picture_size(data) is None


@pytest.mark.parametrize("suffix", [".png", ".webp", ".pgm", ".bmp", ".tiff"])
def test_images_are_decoded_within_a_size_alone(rng: np.random.Generator, suffix: str) -> None:
    image = rng.integers(0, 256, (30, 40, 3) if suffix == ".webp" else (30, 40)).astype(np.uint8)
    data = cv2.imencode(suffix, image, [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
    found = picture_within(data, (40, 30))
    assert found is not None
    assert (found == image).all()
    for most_px in ((39, 30), (40, 29), (0, 0)):
        assert picture_within(data, most_px) is None
    assert picture_within(data[: len(data) // 2], (40, 30)) is None or suffix not in (".png", ".webp")


def test_depth_that_says_to_be_huge_is_not_decoded() -> None:
    """16 bits of 30000 x 30000 pixels are 1.8 GB."""
    data = bytearray(cv2.imencode(".png", np.ones((4, 4), np.uint16))[1].tobytes())
    data[16:24] = struct.pack(">II", 30_000, 30_000)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    assert picture_size(bytes(data)) == (30_000, 30_000)
    assert picture_within(bytes(data), (4096, 4096)) is None


def test_images_with_loss_or_in_motion_have_no_size() -> None:
    lossy = cv2.imencode(".webp", np.zeros((8, 8, 3), np.uint8), [cv2.IMWRITE_WEBP_QUALITY, 80])[1].tobytes()
    for data in (lossy, b"", b"RIFF", lossy[:12] + b"VP8X" + lossy[16:]):
        assert picture_within(data, (100, 100)) is None
