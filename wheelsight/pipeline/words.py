"""Numbers as a person reads them: three digits and a unit that fits; what is not known says so."""

from __future__ import annotations

import math

UNKNOWN = "unknown"


def number(value: float | None, digits: int = 3) -> str:
    """`value` to so many significant digits, without an exponent where a person would write none."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if value == 0:
        return "0"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    if places > 7:
        return f"{value:.{digits - 1}e}"
    return f"{value:,.{max(places, 0)}f}"


def length(metres: float | None) -> str:
    """A length or an error in mm, cm, m or km."""
    if metres is None or not math.isfinite(metres):
        return UNKNOWN
    if metres == 0:
        return "0 m"
    for limit, factor, unit in ((0.01, 1e3, "mm"), (1.0, 1e2, "cm"), (1e4, 1.0, "m")):
        if abs(metres) < limit:
            return f"{number(metres * factor)} {unit}"
    return f"{number(metres / 1e3)} km"


def duration(seconds: float | None) -> str:
    """A time in µs, ms, s, or minutes and seconds."""
    if seconds is None or not math.isfinite(seconds):
        return UNKNOWN
    if seconds == 0:
        return "0 s"
    if seconds < 1e-4:
        return f"{number(seconds * 1e6)} µs"
    if seconds < 0.9995:  # what is more reads as 1 s
        return f"{number(seconds * 1e3)} ms"
    if seconds < 120:
        return f"{number(seconds)} s"
    return f"{round(seconds) // 60} min {round(seconds) % 60} s"


def angle(degrees: float | None) -> str:
    """An angle in degrees."""
    text = number(degrees)
    return text if text == UNKNOWN else f"{text}°"


def percent(share: float | None) -> str:
    """A share of 0 to 1 as a percentage; only the whole is 100 %, only nothing is 0 %."""
    if share is None or not math.isfinite(share):
        return UNKNOWN
    if 0.999 <= share < 1:
        return "over 99.9 %"
    if 0 < share <= 0.001:
        return "under 0.1 %"
    return f"{100 * share:.1f} %".replace(".0 %", " %")


def count(n: int, singular: str, plural: str | None = None) -> str:
    """`n` things: "1 frame", "1,200 frames"."""
    return f"{n:,} {singular if n == 1 else plural or singular + 's'}"
