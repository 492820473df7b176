"""What stamps look like: seconds, or what people take for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

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
