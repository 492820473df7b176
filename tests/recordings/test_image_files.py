"""Images into files: whole again by other readers, and PNG as small as it can quickly be."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from wheelsight.core.geometry import ByteArray
from wheelsight.io.recordings.images import FAST_PNG, write_color, write_units


@pytest.fixture
def picture(rng: np.random.Generator) -> ByteArray:
    """Smooth shades with noise of a few levels, as cameras give them."""
    shades = cv2.resize(rng.uniform(0, 255, (6, 8, 3)), (160, 120), interpolation=cv2.INTER_CUBIC)
    return np.clip(shades + rng.integers(-3, 4, shades.shape), 0, 255).astype(np.uint8)


def unpacked(path: Path, channels: int, sample: str) -> NDArray[np.integer]:
    """An image (H, W, channels) of a PNG whose rows all have filter 1 or none, by the standard's chunks and zlib."""
    data, at, packed = path.read_bytes(), 8, b""
    width, height = struct.unpack(">II", data[16:24])
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        packed += data[at + 8 : at + 8 + length] if data[at + 4 : at + 8] == b"IDAT" else b""
        at += 12 + length
    rows = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, -1)
    assert set(rows[:, 0]) == {1}
    step = channels * np.dtype(sample).itemsize
    raw = np.cumsum(rows[:, 1:].reshape(height, width, step), axis=1, dtype=np.uint8)
    return np.asarray(raw.reshape(height, -1).view(sample).reshape(height, width, channels))


def test_another_reader_opens_them(picture: ByteArray, tmp_path: Path) -> None:
    size = write_color(tmp_path / "color.png", picture, "png")
    assert size == (tmp_path / "color.png").stat().st_size
    np.testing.assert_array_equal(unpacked(tmp_path / "color.png", 3, "u1"), picture)
    units = picture[..., 0].astype(np.uint16) * 200
    write_units(tmp_path / "depth.png", units)
    np.testing.assert_array_equal(unpacked(tmp_path / "depth.png", 1, ">u2")[..., 0], units)


def test_runs_alone_make_files_smaller(picture: ByteArray) -> None:
    """After a filter nothing longer repeats; what looks for it pays for matches that are none."""
    matched = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB)
    sizes = [cv2.imencode(".png", picture, flags)[1].size for flags in (FAST_PNG, matched)]
    assert sizes[0] < 0.97 * sizes[1]
