"""What stamps look like: seconds, or what people take for them."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import ArgumentError
from wheelsight.events import Event

_FEWEST = 4
# Seconds since 1970, from the year 2001 to 2128.
_EPOCH_S = 1e9, 5e9
# Between two frames or readings, by the rates of sensors on robots: 200 Hz or less, and faster ones in finer units.
_LEAST_STEP = 5.0
# From here on whole seconds are no numbers but times since 1970.
_LARGEST_NUMBER = 1e8
# A step between two stamps that are plainly seconds, whatever their epoch.
_LONGEST_STEP_S = 100.0


@dataclass(frozen=True, slots=True)
class StampUnit:
    """What stamps count that are no seconds.

    Attributes:
        name: "milliseconds", "microseconds", "nanoseconds" or "numbers".
        per_second: how many there are in a second; None for numbers, whose rate they do not tell.
    """

    name: str
    per_second: float | None


SECONDS = StampUnit("seconds", 1.0)
NUMBERS = StampUnit("numbers", None)
UNITS = (StampUnit("milliseconds", 1e3), StampUnit("microseconds", 1e6), StampUnit("nanoseconds", 1e9))


def unit_of(stamps: ArrayLike) -> StampUnit | None:
    """The unit that stamps (N,) of one sensor seem to count, or None where they may be seconds.

    Stamps that are times since 1970 in one unit alone are told by that, others by the step between two: 0.1 s may be
    100 or 100 000, but no robot's sensor is silent for 100 s. Whole numbers, one after another, number what they stamp.
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
    """Refuses stamps of sensors that count milli-, micro- or nanoseconds, each by its first stamps.

    No clock tells of 150 years in seconds: such a first stamp is refused at once. Others are known by the steps between
    the first four. Whole numbers that step by one to four may be seconds, and pass; so does all that comes later, where
    a leap is a clock's.
    """

    def __init__(self) -> None:
        self._first: dict[str, list[float]] = {}

    def check(self, event: Event) -> None:
        """Look at one more event. Raises ArgumentError."""
        name = type(event).__name__
        first = self._first.setdefault(name, [])
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


# A column of stamps by its name, alone or before what parts columns; its unit after "_", "/", "in" or in brackets.
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
    """The unit that a line or a name tells that begins with that of a column of stamps, such as `time [ms]`.

    None where it begins otherwise, or tells no unit: `timestamp` may be in any.
    """
    found = _COLUMN.match(text.strip())
    if found is None:
        return None
    return next((unit for unit, name in _UNIT_NAMES if name.fullmatch(found["unit"])), None)
