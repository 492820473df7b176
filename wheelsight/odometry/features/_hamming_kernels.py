"""Compiled Hamming distances between 256-bit descriptors, held as four 64-bit words."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import FloatArray, IntArray, UInt64Array
from wheelsight.geometry.hamming_kernels import hamming

_FAR = 1000


@kernel
def nearest_both_ways(first: UInt64Array, second: UInt64Array) -> Any:
    """For each of (N, 4) the nearest of (M, 4) and its distance; and for each of the second its nearest in the first.

    The lower index wins where distances are equal; -1 where the other set is empty.
    """
    n, m = len(first), len(second)
    nearest, distance = np.full(n, -1, np.int64), np.full(n, _FAR, np.int64)
    nearest_back, distance_back = np.full(m, -1, np.int64), np.full(m, _FAR, np.int64)
    for i in range(n):
        for j in range(m):
            d = hamming(first[i], second[j])
            if d < distance[i]:
                distance[i], nearest[i] = d, j
            if d < distance_back[j]:
                distance_back[j], nearest_back[j] = d, i
    return nearest, distance, nearest_back


class Cells(NamedTuple):
    """Seen keypoints (N, 2) and descriptors (N, 4), sorted into square cells, `columns` by `rows`.

    `order[starts[c]:starts[c + 1]]` lie in cell c.
    """

    px: FloatArray
    descriptors: UInt64Array
    order: IntArray
    starts: IntArray
    columns: int
    rows: int
    cell_px: int


@kernel
def nearest_within(
    expected_px: FloatArray,
    expected: UInt64Array,
    seen: Cells,
    radius_px: float,
    max_hamming: int,
    distinct_share: float,
) -> Any:
    """For each expected keypoint the index of the nearest descriptor within `radius_px`, or -1.

    A seen keypoint wanted by several goes to the one whose descriptor is nearest.
    """
    px, descriptors, order, starts, columns, rows, cell_px = seen
    found = np.full(len(expected), -1, np.int64)
    owner, owned_at = np.full(len(px), -1, np.int64), np.full(len(px), _FAR, np.int64)
    for i in range(len(expected)):
        u, v = expected_px[i, 0], expected_px[i, 1]
        if not (np.isfinite(u) and np.isfinite(v)):
            continue
        left, right = _cells_around(u, radius_px, cell_px, columns)
        top, bottom = _cells_around(v, radius_px, cell_px, rows)
        best, second_best, best_j = _FAR, _FAR, -1
        for row in range(top, bottom + 1 if left <= right else top):
            for j in order[starts[row * columns + left] : starts[row * columns + right + 1]]:
                if (px[j, 0] - u) ** 2 + (px[j, 1] - v) ** 2 > radius_px**2:
                    continue
                d = hamming(expected[i], descriptors[j])
                if d < best:
                    best, second_best, best_j = d, best, j
                elif d < second_best:
                    second_best = d
        # Ambiguous in its own neighbourhood: a repeated texture, better left out.
        if best_j < 0 or best > max_hamming or best > distinct_share * second_best + 1:
            continue
        if best < owned_at[best_j]:
            if owner[best_j] >= 0:
                found[owner[best_j]] = -1
            owner[best_j], owned_at[best_j], found[i] = i, best, best_j
    return found


@kernel
def _cells_around(x: float, radius_px: float, cell_px: int, count: int) -> Any:
    """First and last of `count` cells in a row, or column, that lie within the radius; the first is larger for none."""
    return max(0, int((x - radius_px) // cell_px)), min(count - 1, int((x + radius_px) // cell_px))
