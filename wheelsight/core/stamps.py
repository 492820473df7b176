"""Stamps: the unit of a column of stamps, checks of single stamps, and `associate`, the one-to-one pairing of the
stamps of two sensors.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import ArgumentError, InputError
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray
from wheelsight.core.messages import Event

_FEWEST = 4  # stamps that show a unit
_EPOCH_S = 1e9, 5e9  # since 1970, from the year 2001 to 2128
_LEAST_STEP = 5.0  # of stamps in milliseconds: sensors of robots have 200 Hz or less, or finer units
_LARGEST_NUMBER = 1e8  # of a sequence; larger whole numbers are times since 1970
_LONGEST_STEP_S = 100.0


@dataclass(frozen=True, slots=True)
class StampUnit:
    """The unit of stamps.

    Attributes:
        name: "seconds", "milliseconds", "microseconds", "nanoseconds" or "numbers".
        per_second: units per second; None for numbers, whose rate is unknown.
    """

    name: str
    per_second: float | None


SECONDS = StampUnit("seconds", 1.0)
NUMBERS = StampUnit("numbers", None)
UNITS = (StampUnit("milliseconds", 1e3), StampUnit("microseconds", 1e6), StampUnit("nanoseconds", 1e9))


def unit_of(stamps: ArrayLike) -> StampUnit | None:
    """Return the likely unit of stamps (N,) of one sensor, or None if they may be seconds.

    Times since 1970 fit one unit only. For others the step decides: 0.1 s may be 100 or 100 000, but no sensor of a
    robot is silent for 100 s. Consecutive whole numbers are sequence numbers.
    """
    known = np.asarray(stamps, float)
    known = known[np.isfinite(known)]
    if len(known) < _FEWEST:
        return None
    step, middle = float(np.median(np.diff(known))), float(np.median(known))
    if 1 <= step < _LEAST_STEP and middle < _LARGEST_NUMBER and np.array_equal(known, np.rint(known)):
        return NUMBERS
    for unit in UNITS:
        assert unit.per_second is not None
        if _EPOCH_S[0] <= middle / unit.per_second < _EPOCH_S[1] and 0 < step / unit.per_second < _LONGEST_STEP_S:
            return unit
    if step < _LEAST_STEP:
        return None
    return UNITS[0] if step < 1e3 else UNITS[1] if step < 1e6 else UNITS[2]


class StampCheck:
    """Rejects sensors with stamps in milli-, micro- or nanoseconds, by their first stamps.

    A first stamp above 150 years in seconds is rejected at once, others by the steps between the first four. Whole
    numbers with steps of one to four may be seconds, and pass. Later stamps pass too: a leap is one of the clock.
    """

    def __init__(self) -> None:
        self.settled: set[type[Event]] = set()
        self._first: dict[str, list[float]] = {}

    def check(self, event: Event) -> None:
        """Check the next event. Raises ArgumentError."""
        name = type(event).__name__
        first = self._first.setdefault(name, [])
        if len(first) >= _FEWEST:
            self.settled.add(type(event))
        if len(first) >= _FEWEST or not np.isfinite(event.stamp_s):
            return
        what = f"stamp_s of {name} is {event.stamp_s:.10g}"
        if not first and abs(event.stamp_s) >= _EPOCH_S[1]:
            fix = "divide milliseconds by 1e3, microseconds by 1e6, nanoseconds by 1e9"
            raise ArgumentError(f"{what}: no seconds since any time", fix=fix)
        unit = unit_of([*first, event.stamp_s])
        if unit is not None and unit in UNITS:
            assert unit.per_second is not None
            fix = f"divide by 1e{round(np.log10(unit.per_second))}"
            raise ArgumentError(f"{what}: {unit.name}, not seconds", fix=fix)
        first.append(float(event.stamp_s))


# The name of a column of stamps, with its unit after "_", "/", "in" or in brackets.
_COLUMN = re.compile(
    r"[\"']?(?:time_?stamps?|stamps?|time|t)(?:\s*[\[(_/]\s*(?:in\s+)?|\s+in\s+)(?P<unit>[a-zµμ_]+)\s*[\])]?[\"']?(?=[\s,;]|$)",
    re.IGNORECASE,
)
_UNIT_NAMES = (
    (SECONDS, re.compile(r"s|sec|secs|seconds?", re.IGNORECASE)),
    (UNITS[0], re.compile(r"ms|msecs?|milli_?sec(?:ond)?s?", re.IGNORECASE)),
    (UNITS[1], re.compile(r"[uµμ]s|[uµμ]secs?|micro_?sec(?:ond)?s?", re.IGNORECASE)),
    (UNITS[2], re.compile(r"ns|nsecs?|nano_?sec(?:ond)?s?", re.IGNORECASE)),
)


def column_unit(text: str) -> StampUnit | None:
    """Return the unit in a line or a name that begins like a column of stamps, such as `time [ms]`.

    None if it begins otherwise, or has no unit, as `timestamp`.
    """
    found = _COLUMN.match(text.strip())
    if found is None:
        return None
    return next((unit for unit, name in _UNIT_NAMES if name.fullmatch(found["unit"])), None)


_LARGEST_VALUE = 2.0**62


def associate(stamps_a_s: ArrayLike, stamps_b_s: ArrayLike, max_gap_s: float) -> IntArray:
    """Return pairs (M, 2) of indices into stamps a (N,) and stamps b (K,), both sorted, in seconds.

    The pairing is one-to-one, without a gap over `max_gap_s`. It has the most pairs, and of those pairings the smallest
    sum of gaps. Both columns grow. Nearest partners are best unless two stamps share one; such stretches are solved by
    dynamic programming.

    Raises:
        InputError: stamps that are not finite or not sorted, or a gap that is negative or no number.
    """
    a, b = _sorted_stamps(stamps_a_s, "first"), _sorted_stamps(stamps_b_s, "second")
    if not (np.isfinite(max_gap_s) and max_gap_s >= 0):
        raise InputError(f"the largest gap is {max_gap_s}, not a number of seconds from 0 up")
    if not len(a) or not len(b):
        return np.empty((0, 2), np.int64)
    merged = np.concatenate([a, b])
    order = np.argsort(merged, kind="stable")
    number = np.empty(len(merged), np.int64)
    number[order] = np.concatenate([[0], np.cumsum(np.diff(merged[order]) > max_gap_s)])
    stretch_a, stretch_b = number[: len(a)], number[len(a) :]
    pairs_a, torn_a = _nearest_pairs(a, b, max_gap_s, stretch_a)
    pairs_b, torn_b = _nearest_pairs(b, a, max_gap_s, stretch_b)
    torn_both = torn_a & torn_b
    parts = [pairs_a[~torn_a[stretch_a[pairs_a[:, 0]]]], pairs_b[(torn_a & ~torn_b)[stretch_b[pairs_b[:, 0]]]][:, ::-1]]
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


def _nearest_pairs(a: FloatArray, b: FloatArray, max_gap_s: float, stretch_a: IntArray) -> tuple[IntArray, BoolArray]:
    """Return each a with its nearest b in reach, and for each stretch whether two of its a share a nearest b."""
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
    """Return the best pairs (M, 2) by dynamic programming over the stamps in reach of each other.

    `best[j]` is the value of the best pairing of the previous a with the first j of b. A pair is worth more than all
    gaps together, so one integer orders by number, then by sum of gaps. Its scale uses 63 bits, finer than the stamps.
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
    left = len(b)
    pairs = []
    for i in range(len(sources) - 1, -1, -1):
        last = min(left - starts[i], len(sources[i])) - 1
        if last >= 0 and sources[i][last] >= 0:
            left = int(sources[i][last])
            pairs.append((i, left))
    return np.array(pairs[::-1], np.int64).reshape(-1, 2)
