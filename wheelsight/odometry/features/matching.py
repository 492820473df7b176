"""Which keypoints show the same point: Hamming distance, both ways (Zhang, section 3.1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wheelsight.geometry import FloatArray, IntArray
from wheelsight.geometry.arrays import UInt64Array
from wheelsight.odometry.features import _hamming_kernels

_CELL_PX = 16


class Matches(NamedTuple):
    """M pairs: indices (M,) into the first set and (M,) into the second."""

    first: IntArray
    second: IntArray


def match_all(first: UInt64Array, second: UInt64Array, max_hamming: int) -> Matches:
    """Pairs of descriptors (N, 4) and (M, 4) that are each other's nearest of all, at most `max_hamming` bits apart."""
    nearest, distance, nearest_back = _hamming_kernels.nearest_both_ways(first, second)
    i = np.flatnonzero((nearest >= 0) & (distance <= max_hamming))
    i = i[nearest_back[nearest[i]] == i]
    return Matches(i, nearest[i])


def match_near(
    expected_px: FloatArray,
    expected: UInt64Array,
    px: FloatArray,
    descriptors: UInt64Array,
    radius_px: float,
    max_hamming: int,
) -> Matches:
    """Pairs of expected keypoints (N, 2), (N, 4) and seen ones (M, 2), (M, 4) within a radius, each used once.

    Pixels that are NaN, and lie nowhere, match nothing.
    """
    if len(px) == 0 or len(expected_px) == 0:
        return Matches(np.zeros(0, np.int64), np.zeros(0, np.int64))
    columns, rows = np.maximum(px.max(axis=0), 0).astype(np.int64) // _CELL_PX + 1
    cell = px.clip(0).astype(np.int64) // _CELL_PX
    number = cell[:, 1] * columns + cell[:, 0]
    order = np.argsort(number, kind="stable")
    starts = np.searchsorted(number[order], np.arange(columns * rows + 1))
    found = _hamming_kernels.nearest_within(
        expected_px, expected, px, descriptors, order, starts, columns, rows, _CELL_PX, radius_px, max_hamming
    )
    i = np.flatnonzero(found >= 0)
    return Matches(i, found[i])
