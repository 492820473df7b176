"""Images of ROS messages into arrays: colour as RGB bytes, depth as metres; whatever cannot be read is refused."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wheelsight.errors import RecordingError
from wheelsight.geometry import MOST_PIXELS, ByteArray, Float32Array
from wheelsight.recordings._images import (
    DepthEncoding,
    check_scale,
    decoded_color,
    decoded_units,
    depth_of_units,
)

_Pixels = NDArray[Any]
_MILLIMETRES = 1000.0
_DEPTH: dict[str, type[np.generic]] = {"16uc1": np.uint16, "mono16": np.uint16, "z16": np.uint16, "32fc1": np.float32}


@dataclass(frozen=True, slots=True)
class _Layout:
    """How the pixels of an encoding lie: type and channels, and what makes red, green and blue of them."""

    dtype: type[np.generic]
    channels: int
    to_rgb: Callable[[_Pixels], _Pixels]


def _by(code: int) -> Callable[[_Pixels], _Pixels]:
    return lambda pixels: np.asarray(cv2.cvtColor(pixels, code))


def _as_is(pixels: _Pixels) -> _Pixels:
    return pixels


_GREY, _BGR = _by(cv2.COLOR_GRAY2RGB), _by(cv2.COLOR_BGR2RGB)
_COLOR = {
    "rgb": (3, _as_is),
    "bgr": (3, _BGR),
    "rgba": (4, _by(cv2.COLOR_RGBA2RGB)),
    "bgra": (4, _by(cv2.COLOR_BGRA2RGB)),
    "mono": (1, _GREY),
    # OpenCV names a Bayer pattern by its second row's second and third pixel, ROS by the first row and the second
    "bayer_rggb": (1, _by(cv2.COLOR_BayerBG2RGB)),
    "bayer_bggr": (1, _by(cv2.COLOR_BayerRG2RGB)),
    "bayer_gbrg": (1, _by(cv2.COLOR_BayerGR2RGB)),
    "bayer_grbg": (1, _by(cv2.COLOR_BayerGB2RGB)),
}
_LAYOUTS = {
    f"{name}{bits}": _Layout(dtype, channels, to_rgb)
    for name, (channels, to_rgb) in _COLOR.items()
    for bits, dtype in ((8, np.uint8), (16, np.uint16))
} | {
    "8uc1": _Layout(np.uint8, 1, _GREY),
    "8uc3": _Layout(np.uint8, 3, _BGR),
    "8uc4": _Layout(np.uint8, 4, _by(cv2.COLOR_BGRA2RGB)),
    "16uc1": _Layout(np.uint16, 1, _GREY),
    "16uc3": _Layout(np.uint16, 3, _BGR),
    **dict.fromkeys(("yuv422", "uyvy"), _Layout(np.uint8, 2, _by(cv2.COLOR_YUV2RGB_UYVY))),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), _Layout(np.uint8, 2, _by(cv2.COLOR_YUV2RGB_YUY2))),
}


def color_of(message: Any, path: Path) -> ByteArray:
    """The colour image (H, W, 3) of an Image or CompressedImage. Raises RecordingError naming the bag."""
    if hasattr(message, "format"):
        return decoded_color(bytes(message.data), path)
    layout = _LAYOUTS.get(message.encoding.lower())
    if layout is None:
        problem = f"colour images are encoded as {message.encoding!r}"
        raise RecordingError(problem, path=path, fix=f"known: {', '.join(sorted(_LAYOUTS))}")
    pixels = _pixels(message, layout.dtype, layout.channels, path)
    rgb = layout.to_rgb(pixels)
    return np.asarray(rgb if rgb.dtype == np.uint8 else rgb >> 8, np.uint8)


def depth_of(message: Any, factor: float | None, path: Path) -> Float32Array:
    """The depth image (H, W) in metres of an Image or CompressedImage, 0 where nothing was measured.

    Args:
        message: of whole numbers in millimetres, or of floats in metres.
        factor: units a metre, where it differs from that.
        path: of the bag.

    Raises:
        RecordingError: another encoding, no depth at all, or depth on a scale that cannot be.
    """
    if hasattr(message, "format"):
        raw = _compressed_depth(bytes(message.data), message.format, path)
    else:
        dtype = _DEPTH.get(message.encoding.lower())
        if dtype is None:
            problem = f"depth images are encoded as {message.encoding!r}"
            raise RecordingError(problem, path=path, fix="16UC1 in millimetres or 32FC1 in metres is read")
        raw = _pixels(message, dtype, 1, path)
    if raw.dtype != np.float32:
        return depth_of_units(raw, DepthEncoding(factor or _MILLIMETRES), path)
    with np.errstate(invalid="ignore", over="ignore"):  # damaged messages hold numbers that are none
        scaled_m = raw / np.float32(factor or 1.0)
        depth_m = np.where((scaled_m > 0) & np.isfinite(scaled_m), scaled_m, np.float32(0))
    check_scale(depth_m, path)
    return depth_m


def is_depth(encoding: str, topic: str) -> bool:
    """Whether images so encoded, on a topic so called, are depth; infrared is encoded likewise."""
    words = topic.lower()
    if "compresseddepth" in encoding.lower() or words.endswith("compresseddepth"):
        return True
    first = encoding.lower().split(";")[0].strip()
    if first not in _DEPTH or any(word in words for word in ("/ir", "infra", "confidence", "disparity")):
        return False
    return first != "mono16" or "depth" in words


def _pixels(message: Any, dtype: type[np.generic], channels: int, path: Path) -> _Pixels:
    """(H, W) or (H, W, channels) of an Image, its rows without what fills them up."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * np.dtype(dtype).itemsize
    data = np.asarray(message.data, np.uint8)
    if not 0 < height * width <= MOST_PIXELS or step < row or len(data) < step * height:
        problem = (
            f"an image says it is {width}×{height} {message.encoding} in rows of {step} bytes, and has {len(data)}"
        )
        raise RecordingError(problem, path=path, fix="check the camera's driver")
    rows = data[: step * height].reshape(height, step)[:, :row]
    pixels = np.ascontiguousarray(rows).view(np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<"))
    native = pixels.astype(dtype) if np.dtype(dtype).itemsize > 1 else pixels
    return native.reshape((height, width) if channels == 1 else (height, width, channels))


def _compressed_depth(data: bytes, format_: str, path: Path) -> _Pixels:
    """Millimetres or metres of compressedDepth, or of a PNG that is a plain depth image.

    compressedDepth has 12 bytes before its PNG: which way, and two numbers a, b of how floats became whole numbers n:
    z = a / (n - b), so that they are as fine as disparities are (image_transport_plugins).
    """
    start = data.find(b"\x89PNG", 0, 64)
    if start < 0:
        way = "RVL" if "rvl" in format_.lower() else repr(format_)
        raise RecordingError(f"depth images are compressed as {way}", path=path, fix="record them raw, or as PNG")
    raw = decoded_units(data[start:], path)
    if not format_.lower().startswith("32fc1"):
        return raw
    if start < 12:
        raise RecordingError("compressed depth lacks what tells its scale", path=path, fix="record it raw")
    a, b = struct.unpack_from("<ff", data, start - 8)
    above = raw.astype(np.float32) - np.float32(b)
    depth_m: Float32Array = np.divide(
        np.float32(a), above, out=np.zeros(raw.shape, np.float32), where=(raw > 0) & (above > 0)
    )
    return depth_m
