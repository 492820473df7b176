"""Which stamps of two sensors belong together: one-to-one, as many as possible, as near as possible."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import InputError
from wheelsight.geometry import BoolArray, FloatArray, IntArray

_LARGEST_VALUE = 2.0**62


def associate(stamps_a_s: ArrayLike, stamps_b_s: ArrayLike, max_gap_s: float) -> IntArray:
    """Pairs (M, 2) of indices into stamps a (N,) and stamps b (K,), both sorted, in seconds.

    Of all one-to-one pairings without a gap over `max_gap_s` this has the most pairs, and of those with the most
    pairs the smallest sum of gaps. Both columns grow: uncrossing two crossed pairs never makes a gap worse.

    Where no two stamps share a nearest partner, nearest is best; only the stretches where some do are solved
    by dynamic programming.

    Raises:
        InputError: stamps that are not finite or not sorted, or a gap that is no number from 0 up.
    """
    a, b = _sorted_stamps(stamps_a_s, "first"), _sorted_stamps(stamps_b_s, "second")
    if not (np.isfinite(max_gap_s) and max_gap_s >= 0):
        raise InputError(f"the largest gap is {max_gap_s}, not a number of seconds from 0 up")
    if not len(a) or not len(b):
        return np.empty((0, 2), np.int64)
    stretch_a, stretch_b = _stretches(a, b, max_gap_s)
    pairs_a, torn_a = _nearest_pairs(a, b, max_gap_s, stretch_a)
    pairs_b, torn_b = _nearest_pairs(b, a, max_gap_s, stretch_b)
    torn_both = torn_a & torn_b
    parts = [
        pairs_a[~torn_a[stretch_a[pairs_a[:, 0]]]],
        pairs_b[(torn_a & ~torn_b)[stretch_b[pairs_b[:, 0]]]][:, ::-1],
    ]
    for stretch in np.flatnonzero(torn_both):
        (i, i_end), (j, j_end) = (np.searchsorted(s, [stretch, stretch + 1]) for s in (stretch_a, stretch_b))
        parts.append(_best_pairs(a[i:i_end], b[j:j_end], max_gap_s) + np.array([i, j]))
    pairs = np.concatenate(parts)
    return pairs[np.argsort(pairs[:, 0], kind="stable")]


def _sorted_stamps(stamps_s: ArrayLike, which: str) -> FloatArray:
    stamps_s = np.asarray(stamps_s, float)
    if stamps_s.ndim != 1 or not np.isfinite(stamps_s).all():
        raise InputError(f"the {which} stamps are not a list of finite numbers")
    if (np.diff(stamps_s) < 0).any():
        raise InputError(f"the {which} stamps are not sorted", fix="sort them first")
    return stamps_s


def _stretches(a: FloatArray, b: FloatArray, max_gap_s: float) -> tuple[IntArray, IntArray]:
    """Numbers (N,), (K,) of the stretch each stamp lies in; no pair joins two stretches."""
    merged = np.concatenate([a, b])
    order = np.argsort(merged, kind="stable")
    number = np.empty(len(merged), np.int64)
    number[order] = np.concatenate([[0], np.cumsum(np.diff(merged[order]) > max_gap_s)])
    return number[: len(a)], number[len(a) :]


def _nearest_pairs(a: FloatArray, b: FloatArray, max_gap_s: float, stretch_a: IntArray) -> tuple[IntArray, BoolArray]:
    """Each a with its nearest b in reach, and for each stretch whether two of its a share a nearest b."""
    right = np.searchsorted(b, a).clip(1, max(1, len(b) - 1))
    left = right - 1
    right = right.clip(max=len(b) - 1)
    nearest = np.where(np.abs(b[left] - a) <= np.abs(b[right] - a), left, right)
    chosen = np.flatnonzero(np.abs(b[nearest] - a) <= max_gap_s)
    pairs = np.stack([chosen, nearest[chosen]], axis=-1)
    shared = np.flatnonzero(np.diff(pairs[:, 1]) == 0)
    torn = np.zeros(len(a) + len(b), np.bool_)
    torn[stretch_a[pairs[shared, 0]]] = True
    return pairs, torn


def _best_pairs(a: FloatArray, b: FloatArray, max_gap_s: float) -> IntArray:
    """The best pairs (M, 2) by dynamic programming over the stamps in reach of each other.

    `best[j]` is the value of the best pairing of the a seen so far with the first j of b. A pair is worth
    more than all gaps together, so one integer orders by number first and by sum of gaps second; the scale
    uses the 63 bits there are, finer than the stamps' own resolution.
    """
    most = min(len(a), len(b)) + 1
    scale = _LARGEST_VALUE / (most**2 * max(max_gap_s, 1e-12))
    prize = int(most * max_gap_s * scale) + 1
    reach_s = max_gap_s + 2 * np.spacing(np.abs(a))
    starts, ends = np.searchsorted(b, a - reach_s), np.searchsorted(b, a + reach_s, side="right")
    best = np.zeros(len(b) + 1, np.int64)
    known = 0
    sources: list[IntArray] = []
    for stamp, start, end in zip(a, starts, ends, strict=True):
        best[known + 1 : end + 1] = best[known]
        known = max(known, end)
        gaps_s = np.abs(b[start:end] - stamp)
        without = best[start + 1 : end + 1]
        taking = np.where(gaps_s <= max_gap_s, best[start:end] + prize - np.rint(gaps_s * scale).astype(np.int64), -1)
        value = np.maximum.accumulate(np.maximum(without, taking))
        last_taking = np.maximum.accumulate(np.where(taking == value, np.arange(start, end), -1))
        sources.append(np.where(value > without, last_taking, -1))
        best[start + 1 : end + 1] = value
    return _trace_back(sources, starts, len(b))


def _trace_back(sources: list[IntArray], starts: IntArray, left: int) -> IntArray:
    """The pairs (M, 2) behind the best value: `sources[i][j]` is what a_i takes when b_j is the last one free."""
    pairs = []
    for i in range(len(sources) - 1, -1, -1):
        last = min(left - starts[i], len(sources[i])) - 1
        if last >= 0 and sources[i][last] >= 0:
            left = int(sources[i][last])
            pairs.append((i, left))
    return np.array(pairs[::-1], np.int64).reshape(-1, 2)
