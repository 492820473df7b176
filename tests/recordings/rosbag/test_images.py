"""Encodings of images: each against what it was made of."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from written_bags import DEPTH, HEIGHT, WIDTH, Messages, color_image, depth_mm, png

from wheelsight.core.errors import RecordingError
from wheelsight.io.recordings.bags.images import color_of, depth_of, is_depth

BAG = Path("drive.bag")
MAKE = Messages(is_ros1=False)
COLOR = color_image(0)
# Colours that change slowly over the image: what demosaicing and halved chroma lose of it is little.
SMOOTH = np.stack(
    np.broadcast_arrays(np.arange(40, 40 + WIDTH), np.arange(200, 200 - HEIGHT, -1)[:, None], 90), axis=-1
).astype(np.uint8)


def image(encoding: str, pixels: np.ndarray, step: int = 0):
    return MAKE.image(0.0, "camera", encoding, pixels, step)


def alpha(pixels: np.ndarray) -> np.ndarray:
    return np.concatenate([pixels, np.full_like(pixels[..., :1], 77)], axis=-1)


@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("rgb8", COLOR),
        ("bgr8", COLOR[..., ::-1]),
        ("8UC3", COLOR[..., ::-1]),
        ("rgba8", alpha(COLOR)),
        ("bgra8", alpha(COLOR[..., ::-1])),
        ("rgb16", COLOR.astype(np.uint16) << 8),
        ("bgr16", COLOR[..., ::-1].astype(np.uint16) << 8),
    ],
)
@pytest.mark.parametrize("fill", [0, 13])
def test_colours_come_out_exactly(encoding: str, pixels: np.ndarray, fill: int) -> None:
    row = pixels[0].nbytes
    np.testing.assert_array_equal(color_of(image(encoding, pixels, row + fill), BAG), COLOR)


@pytest.mark.parametrize("encoding", ["mono8", "mono16", "8UC1"])
def test_grey_has_three_equal_channels(encoding: str) -> None:
    grey = COLOR[..., 0]
    pixels = grey.astype(np.uint16) << 8 if encoding == "mono16" else grey
    np.testing.assert_array_equal(color_of(image(encoding, pixels), BAG), np.repeat(grey[..., None], 3, axis=2))


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_are_reported_by_their_first_four_pixels(pattern: str, bits: int) -> None:
    mosaic = np.empty((HEIGHT, WIDTH), np.uint8)
    for place, name in enumerate(pattern):
        row, column = divmod(place, 2)
        mosaic[row::2, column::2] = SMOOTH[row::2, column::2, "rgb".index(name)]
    pixels = mosaic if bits == 8 else mosaic.astype(np.uint16) << 8
    found = color_of(image(f"bayer_{pattern}{bits}", pixels), BAG)
    np.testing.assert_allclose(found[2:-2, 2:-2].astype(int), SMOOTH[2:-2, 2:-2], atol=1)


@pytest.mark.parametrize("encoding", ["yuv422", "uyvy", "yuv422_yuy2", "yuyv"])
def test_chroma_that_two_pixels_share(encoding: str) -> None:
    r, g, b = (SMOOTH[..., channel].astype(float) for channel in range(3))
    y = 16 + (65.738 * r + 129.057 * g + 25.064 * b) / 256  # ITU-R BT.601
    u = 128 + (-37.945 * r - 74.494 * g + 112.439 * b) / 256
    v = 128 + (112.439 * r - 94.154 * g - 18.285 * b) / 256
    chroma = np.where(np.arange(WIDTH) % 2, np.roll(v, 1, axis=1), u)
    parts = (chroma, y) if encoding in ("yuv422", "uyvy") else (y, chroma)
    pixels = np.rint(np.stack(parts, axis=-1)).astype(np.uint8)
    np.testing.assert_allclose(color_of(image(encoding, pixels), BAG).astype(int), SMOOTH, atol=4)


def test_compressed_colour() -> None:
    message = MAKE.compressed(0.0, "camera", "rgb8; png compressed bgr8", png(COLOR[..., ::-1]))
    np.testing.assert_array_equal(color_of(message, BAG), COLOR)
    jpeg = cv2.imencode(".jpg", SMOOTH[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, 95))[1].tobytes()
    found = color_of(MAKE.compressed(0.0, "camera", "jpeg", jpeg), BAG)
    np.testing.assert_allclose(found.astype(int), SMOOTH, atol=6)


DEPTH_M = (depth_mm(0) / 1000).astype(np.float32)


def test_depth_in_whole_millimetres_and_in_metres() -> None:
    np.testing.assert_allclose(depth_of(image("16UC1", depth_mm(0)), None, BAG), DEPTH_M, rtol=1e-6)
    np.testing.assert_allclose(depth_of(image("mono16", depth_mm(0)), None, BAG), DEPTH_M, rtol=1e-6)
    floats = np.where(DEPTH_M > 0, DEPTH_M, np.nan).astype(np.float32)
    floats[10, 10], floats[11, 11] = np.inf, -1.0
    wanted = DEPTH_M.copy()
    wanted[10, 10] = wanted[11, 11] = 0
    np.testing.assert_allclose(depth_of(image("32FC1", floats), None, BAG), wanted, rtol=1e-6)


def test_depth_units_may_be_given() -> None:
    np.testing.assert_allclose(depth_of(image("16UC1", depth_mm(0)), 500.0, BAG), 2 * DEPTH_M, rtol=1e-6)
    np.testing.assert_allclose(depth_of(image("32FC1", 10 * DEPTH_M), 10.0, BAG), DEPTH_M, rtol=1e-6)


def test_big_endian_rows() -> None:
    message = image("16UC1", depth_mm(0).byteswap())
    message.is_bigendian = 1
    np.testing.assert_allclose(depth_of(message, None, BAG), DEPTH_M, rtol=1e-6)


def test_compressed_depth() -> None:
    header = struct.pack("<iff", 0, 0.0, 0.0)
    message = MAKE.compressed(0.0, "camera", "16UC1; compressedDepth png", header + png(depth_mm(0)))
    np.testing.assert_allclose(depth_of(message, None, BAG), DEPTH_M, rtol=1e-6)
    plain = MAKE.compressed(0.0, "camera", "16UC1; png compressed", png(depth_mm(0)))
    np.testing.assert_allclose(depth_of(plain, None, BAG), DEPTH_M, rtol=1e-6)


def test_compressed_floats_are_as_fine_as_disparities() -> None:
    """image_transport_plugins: with z_q = 100 and z_max = 10, a = z_q (z_q + 1) and b = 1 - a / z_max."""
    a = 100.0 * 101.0
    b = 1 - a / 10.0
    with np.errstate(divide="ignore"):
        units = np.where(DEPTH_M > 0, a / DEPTH_M + b, 0).astype(np.uint16)
    data = struct.pack("<iff", 0, a, b) + png(units)
    found = depth_of(MAKE.compressed(0.0, "camera", "32FC1; compressedDepth png", data), None, BAG)
    np.testing.assert_array_equal(found == 0, DEPTH_M == 0)
    np.testing.assert_allclose(found, DEPTH_M, rtol=1e-3)


@pytest.mark.parametrize(
    ("encoding", "topic", "expected"),
    [
        ("16UC1", DEPTH, True),
        ("32FC1", "/camera/depth/image", True),
        ("mono16", "/camera/depth/image_raw", True),
        ("mono16", "/thermal/image_raw", False),
        ("16UC1", "/camera/ir/image_raw", False),
        ("16UC1", "/camera/infra1/image_rect_raw", False),
        ("16UC1; compressedDepth png", "/camera/depth/image_raw/compressedDepth", True),
        ("rgb8; jpeg compressed bgr8", "/camera/depth/image_raw/compressed", False),
        ("bgr8", "/camera/depth/view", False),
    ],
)
def test_depth_is_reported_from_infrared(encoding: str, topic: str, expected: bool) -> None:
    assert is_depth(encoding, topic) is expected


def test_what_cannot_be_read_says_why() -> None:
    short = image("rgb8", COLOR)
    short.data = short.data[:-1]
    huge = image("rgb8", COLOR)
    huge.width = 1 << 30
    for message, problem in (
        (short, "has 9215"),
        (huge, "1073741824×48"),
        (image("nv12", COLOR), "encoded as 'nv12'"),
        (MAKE.compressed(0.0, "camera", "jpeg", b"\xff\xd8 no end"), "cut off"),
    ):
        with pytest.raises(RecordingError, match=problem):
            color_of(message, BAG)
    rvl = MAKE.compressed(0.0, "camera", "16UC1; compressedDepth rvl", bytes(100))
    for message, problem in (
        (rvl, "compressed as RVL"),
        (image("rgb8", COLOR), "depth images are encoded as 'rgb8'"),
        (image("16UC1", np.zeros((HEIGHT, WIDTH), np.uint16)), "measured nothing"),
        (image("32FC1", 1000 * DEPTH_M), "median depth is"),
    ):
        with pytest.raises(RecordingError, match=problem):
            depth_of(message, None, BAG)
