"""Images into files, as fast as a camera gives them: PNG, which keeps all, or JPEG for colour."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from wheelsight.errors import OutputError
from wheelsight.files import write_bytes
from wheelsight.geometry import ByteArray

ColorFormat = Literal["png", "jpeg"]
SUFFIXES: dict[str, str] = {"png": ".png", "jpeg": ".jpg"}
JPEG_QUALITY = 95


def _png_flags() -> tuple[int, ...]:
    """Of the fastest PNG that still compresses.

    The filter is said, for without that a compression level of 1 tries all five a row: 12 ms instead of 18 ms for
    colour of 640×480. After a filter bytes are noise with runs of zeros, in which nothing longer repeats: looking for
    runs alone takes 9 to 10 ms and leaves files smaller, too (docs/decisions/0109).
    """
    flags: tuple[int, ...] = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)
    name, sub = getattr(cv2, "IMWRITE_PNG_FILTER", None), getattr(cv2, "IMWRITE_PNG_FILTER_SUB", None)
    return flags if name is None or sub is None else (*flags, name, sub)  # older OpenCV has neither


FAST_PNG = _png_flags()


def write_color(path: Path, color: ByteArray, encoding: ColorFormat) -> int:
    """Write colour (H, W, 3), red green blue; how many bytes that were. Raises OutputError."""
    flags = FAST_PNG if encoding == "png" else (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
    return _write(path, SUFFIXES[encoding], cv2.cvtColor(color, cv2.COLOR_RGB2BGR), flags)


def write_units(path: Path, units: NDArray[np.uint16]) -> int:
    """Write an image (H, W) of 16 bits as PNG; how many bytes that were. Raises OutputError."""
    return _write(path, ".png", units, FAST_PNG)


def _write(path: Path, kind: str, image: NDArray[np.integer | np.floating], flags: tuple[int, ...]) -> int:
    is_encoded, data = cv2.imencode(kind, image, flags)
    if not is_encoded:
        raise OutputError(f"the image cannot be encoded as {kind[1:].upper()}", path=path)
    write_bytes(path, data.tobytes())
    return int(data.size)
