"""Where keypoints are, as it is kept on disk: in small steps, row by row, so that neighbours differ least."""

from __future__ import annotations

import zlib

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry import FloatArray, IntArray
from wheelsight.mapping import columns

_DAMAGED = "use another copy of the map"
# A keypoint is found to half a pixel, and its depth to millimetres; depth in memory goes in steps of 0.2 mm, too.
_STEPS = np.array([1 / 16, 1 / 16, 0.0002, 0.0002, 0.0002])
_COLUMN = "<i4"
_LARGEST = 2**30
_BYTES = 5 * 4


def packed(px: FloatArray, points: FloatArray) -> tuple[IntArray, bytes]:
    """In which order (N,) keypoints are kept, and where they are: pixels (N, 2) and points (N, 3), metres."""
    numbers = np.rint(np.hstack([px, points]) / _STEPS).clip(-_LARGEST, _LARGEST).astype(_COLUMN)
    order = np.lexsort((numbers[:, 0], numbers[:, 1]))
    rows = numbers[order]
    return order, zlib.compress(b"".join(columns.packed(np.ascontiguousarray(column)) for column in rows.T))


def unpacked(data: bytes, count: int) -> tuple[FloatArray, FloatArray]:
    """Pixels (count, 2) and points (count, 3) that `packed` made bytes of. Raises MapError for what is none."""
    expected = count * _BYTES
    flat = inflated(data, expected)
    width = 4 * count
    numbers = [columns.unpacked(flat[at : at + width], _COLUMN) for at in range(0, expected, max(width, 1))]
    rows = np.reshape(numbers, (5, count)).T * _STEPS
    return rows[:, :2].copy(), rows[:, 2:].copy()


def inflated(data: bytes, expected: int) -> bytes:
    """So many bytes of keypoints that zlib has compressed, and no more are made. Raises MapError for any other."""
    try:
        flat = zlib.decompressobj().decompress(data, expected + 1)
    except zlib.error as error:
        raise MapError("its keypoints cannot be read", fix=_DAMAGED) from error
    if len(flat) != expected:
        raise MapError("its keypoints are of another number than it says", fix=_DAMAGED)
    return flat
