"""Compiled Hamming distances between 256-bit descriptors, held as four 64-bit words."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from wheelsight.compiled import kernel

_FAR = 1000


@intrinsic
def _ctpop(typing_context: Any, word: Any) -> Any:
    """The processor's own bit count, which numba has no name for."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


_count_bits: Any = _ctpop


@kernel
def hamming(a: Any, b: Any) -> Any:
    """Number of bits in which two descriptors (4,) differ."""
    bits = _count_bits(a[0] ^ b[0]) + _count_bits(a[1] ^ b[1]) + _count_bits(a[2] ^ b[2]) + _count_bits(a[3] ^ b[3])
    return np.int64(bits)


@kernel
def nearest_both_ways(first: Any, second: Any) -> Any:
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


@kernel
def nearest_within(
    expected_px: Any,
    expected: Any,
    px: Any,
    descriptors: Any,
    order: Any,
    starts: Any,
    columns: int,
    rows: int,
    cell_px: int,
    radius_px: float,
    max_hamming: int,
) -> Any:
    """For each expected keypoint the index of the nearest descriptor within `radius_px`, or -1.

    Seen keypoints are sorted into cells: `order[starts[c]:starts[c + 1]]` lie in cell c. A seen keypoint wanted by
    several goes to the one whose descriptor is nearest.
    """
    found = np.full(len(expected), -1, np.int64)
    owner, owned_at = np.full(len(px), -1, np.int64), np.full(len(px), _FAR, np.int64)
    for i in range(len(expected)):
        u, v = expected_px[i, 0], expected_px[i, 1]
        if not (np.isfinite(u) and np.isfinite(v)):
            continue
        left, right = max(0, int((u - radius_px) // cell_px)), min(columns - 1, int((u + radius_px) // cell_px))
        top, bottom = max(0, int((v - radius_px) // cell_px)), min(rows - 1, int((v + radius_px) // cell_px))
        if left > right:
            continue
        best, second_best, best_j = _FAR, _FAR, -1
        for row in range(top, bottom + 1):
            places = order[starts[row * columns + left] : starts[row * columns + right + 1]]
            best, second_best, best_j = _best_of(
                u, v, expected[i], px, descriptors, places, radius_px, best, second_best, best_j
            )
        # Ambiguous in its own neighbourhood: a repeated texture, better left out.
        if best_j < 0 or best > max_hamming or best > 0.9 * second_best + 1:
            continue
        if best < owned_at[best_j]:
            if owner[best_j] >= 0:
                found[owner[best_j]] = -1
            owner[best_j], owned_at[best_j], found[i] = i, best, best_j
    return found


@kernel
def _best_of(
    u: float,
    v: float,
    expected: Any,
    px: Any,
    descriptors: Any,
    places: Any,
    radius_px: float,
    best: int,
    second_best: int,
    best_j: int,
) -> Any:
    """The best two distances and the best index so far, after a look at the keypoints `places` near (u, v)."""
    for j in places:
        if (px[j, 0] - u) ** 2 + (px[j, 1] - v) ** 2 > radius_px**2:
            continue
        d = hamming(expected, descriptors[j])
        if d < best:
            best, second_best, best_j = d, best, j
        elif d < second_best:
            second_best = d
    return best, second_best, best_j
