"""Formats numbers for people, three digits and a fitting unit, or a word for an unknown value; and tables of files."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence

import numpy as np

UNKNOWN = "unknown"
_MOST_PLACES = 4
# Limit, factor and name of each unit.
_UNITS = {
    "m": ((0.1, 1e3, "mm"), (1.0, 1e2, "cm"), (1e4, 1.0, "m"), (math.inf, 1e-3, "km")),
    "s": ((1e-3, 1e6, "µs"), (1.0, 1e3, "ms"), (math.inf, 1.0, "s")),
}


def number(value: float | None, digits: int = 3) -> str:
    """Format `value` with the given number of significant digits, in plain notation where the exponent is small."""
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


def column(name: str, values: Sequence[float | None], unit: str = "", digits: int = 3) -> tuple[str, list[str]]:
    """Head and cells of a column in one unit, which the head names: of lengths ("m") and times ("s") the one that fits.

    The unit goes by the largest value, the places after the point by the smallest, four at most. None is a dash.
    """
    known = [abs(value) for value in values if value is not None and math.isfinite(value)]
    factor, unit = 1.0, unit if known else ""
    for limit, scale, unit_name in reversed(_UNITS.get(unit, ())):
        factor, unit = (scale, unit_name) if max(known) < limit else (factor, unit)
    scaled = [None if value is None else value * factor for value in values]
    least = min((value * factor for value in known if value > 0), default=1.0)
    places = min(max(digits - 1 - math.floor(math.log10(least)), 0), _MOST_PLACES)
    cells = ["–" if v is None else UNKNOWN if not math.isfinite(v) else f"{v:,.{places}f}" for v in scaled]
    return f"{name} [{unit}]" if unit else name, cells


Table = tuple[tuple[str, ...], list[tuple[str, ...]]]
"""Heads of the columns, and the rows of cells."""


def table(*columns: tuple[str, Sequence[str]]) -> Table:
    """A table of columns, each with its head and its cells."""
    return tuple(head for head, _ in columns), list(zip(*(cells for _, cells in columns), strict=True))


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


def times(n: int) -> str:
    """How often: "once", "3 times"."""
    return "once" if n == 1 else f"{n} times"


def stamp(stamp_s: float) -> str:
    """A stamp as in trajectory.txt, so that rows of several files can be joined."""
    return np.format_float_positional(stamp_s, min_digits=6)


def csv_text(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """The text of a CSV file."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    return text.getvalue()
