"""What a recording's wheel readings say of their counters: that they roll over unsaid, or faster than can be told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wheelsight.calibration import Wheels
from wheelsight.events import WheelReading, WheelTicks
from wheelsight.geometry import FloatArray

_FEWEST_READINGS = 10
# A leap goes over so much of all values that a counter shows, all other steps over less than so much of them.
_LEAST_REACH = 32
_LEAP_SHARE, _STEP_SHARE = 0.5, 0.1
# Leaps tell a modulus to so much: the step that went with each is known from those beside it.
_SAME = 0.03


def counter_warnings(wheels: Wheels | None, readings: Sequence[WheelReading]) -> list[str]:
    """A sentence for counters that leap as if they rolled over unsaid, and one for such as roll over unseen."""
    ticks = [reading for reading in readings if isinstance(reading, WheelTicks)]
    if wheels is None or len(ticks) < _FEWEST_READINGS:
        return []
    return [*_leaps(wheels, ticks), *_unseen(wheels, ticks)]


def _leaps(wheels: Wheels, ticks: Sequence[WheelTicks]) -> list[str]:
    first = ticks[0]
    sides = {
        "left": np.array([reading.left - first.left for reading in ticks], float),
        "right": np.array([reading.right - first.right for reading in ticks], float),
    }
    found = {side: told for side, counts in sides.items() if (told := _leap(counts, wheels.counter_span)) is not None}
    if not found:
        return []
    moduli = [modulus for _, modulus in found.values()]
    index, side = min((index, side) for side, (index, _) in found.items())
    before, after = (getattr(ticks[i], side) for i in (index, index + 1))
    remedy = _remedy(float(np.median(moduli)))
    return [
        f"The {side} counter leaps from {before} to {after} at {ticks[index + 1].stamp_s:.3f} s: it seems to wrap at "
        f"{remedy}."
    ]


def _leap(counts: FloatArray, span: int) -> tuple[int, float] | None:
    """Where counts (N,) leap first, and the modulus that explains it; None where nothing does."""
    reach = float(np.ptp(counts))
    steps = np.diff(counts)
    if span:
        steps = steps - span * np.floor(steps / span + 0.5)
    is_leap = np.abs(steps) > _LEAP_SHARE * reach
    others = np.abs(steps[~is_leap])
    if (
        not is_leap.any()
        or reach < _LEAST_REACH
        or len(others) < _FEWEST_READINGS // 2
        or others.max() > _STEP_SHARE * reach
    ):
        return None
    usual = np.interp(np.flatnonzero(is_leap), np.flatnonzero(~is_leap), steps[~is_leap])
    moduli = np.abs(steps[is_leap] - usual)
    is_one = np.ptp(moduli) <= _SAME * moduli.max()
    if not is_one or (len(moduli) < 2 and _bits(float(moduli[0])) is None):
        return None  # a counter that was reset leaps as well, once and from anywhere
    return int(np.flatnonzero(is_leap)[0]), float(np.median(moduli))


def _bits(modulus: float) -> int | None:
    bits = round(np.log2(modulus))
    return bits if abs(modulus / 2.0**bits - 1) < _SAME else None


def _remedy(modulus: float) -> str:
    bits = _bits(modulus)
    if bits is not None:
        return f"{2**bits}: set wheels.counter_bits to {bits} in the calibration"
    return f"about {modulus:.0f}: set wheels.counter_modulus in the calibration"


def _unseen(wheels: Wheels, ticks: Sequence[WheelTicks]) -> list[str]:
    """Where at the usual period a wheel at its top speed goes on by half of what its counter can count."""
    if not wheels.counter_span:
        return []
    period_s = float(np.median(np.diff([reading.stamp_s for reading in ticks])))
    half_m = 0.5 * wheels.counter_span * min(wheels.left_m_per_tick, wheels.right_m_per_tick)
    if period_s <= 0 or wheels.max_speed_m_s * period_s < half_m:
        return []
    slow_m_s = half_m / period_s
    return [
        f"Counters of {wheels.counter_span} values, read each {1e3 * period_s:.3g} ms, may roll over unseen at "
        f"{wheels.max_speed_m_s:g} m/s, so readings are refused: where wheels never roll so fast, set "
        f"wheels.max_speed_m_s to what they do, below {slow_m_s:.2g}."
    ]
