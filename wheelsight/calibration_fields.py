"""Fields of a calibration.yaml, one by one: names, numbers and motions, each refused by its name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np

from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray
from wheelsight.geometry.arrays import is_number

Part = TypeVar("Part")


class Range(NamedTuple):
    """What a number may be, ends included.

    Attributes:
        unit: for messages; in m and s it is told what a number in mm and ms would be.
        fix: what to do about a number outside.
    """

    least: float
    most: float
    unit: str
    fix: str | None = None


def check_range(name: str, value: float, allowed: Range) -> None:
    """Raise CalibrationError, naming the range, for a number outside it."""
    least, most, unit, fix = allowed
    if least <= value <= most:
        return
    if fix is None and unit in _WHOLE_UNITS:
        fix = f"give {_WHOLE_UNITS[unit]}"
        fix += f": {value:g} m{unit} are {value / 1000:g}" if abs(value) > most else ""
    raise CalibrationError(f"{name} is {value:g}, not {least:g} to {most:g} {unit}".rstrip(), fix=fix)


def need_numbers(part: object, names: tuple[str, ...]) -> None:
    """Raise CalibrationError for a field of a part that is no number, as text is."""
    for name in names:
        value = getattr(part, name)
        if not is_number(value):
            raise CalibrationError(f"{name} of {type(part).__name__} is a {type(value).__name__}, not a number")


_WHOLE_UNITS = {"m": "metres", "s": "seconds"}


def made(kind: Callable[..., Part], name: str, numbers: dict[str, Any]) -> Part:
    """A part of these fields; what it refuses names the part."""
    try:
        return kind(**numbers)
    except CalibrationError as error:
        raise CalibrationError(f"field {name}: {error.problem}", fix=error.fix) from error


def mapping(value: Any, name: str, known: tuple[str, ...]) -> dict[str, Any]:
    """A mapping all of whose keys are known."""
    if not isinstance(value, dict):
        raise CalibrationError(f"field {name} must hold names and values")
    for key in value:
        if key not in known:
            raise CalibrationError(f"field {name} has an unknown entry {key!r}", fix=f"known: {', '.join(known)}")
    return value


def motion(value: Any, name: str) -> FloatArray | None:
    """A (4, 4) of four rows of four numbers, or None."""
    if value is None:
        return None
    try:
        T = np.array(value, float)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"field {name} must be four rows of four numbers") from error
    if T.shape != (4, 4):
        raise CalibrationError(f"field {name} must be four rows of four numbers")
    return T


def whole(value: Any, name: str, of_what: str = " of pixels") -> int:
    """A number without a fraction."""
    found = number(value, name)
    if found != int(found):
        raise CalibrationError(f"field {name} is {value!r}, not a whole number{of_what}")
    return int(found)


def number(value: Any, name: str) -> float:
    """A finite number."""
    try:
        found = float(value)  # from text too: YAML 1.1 reads 1e-3, without a dot, as text
    except (TypeError, ValueError):
        found = np.nan
    if isinstance(value, bool) or not np.isfinite(found):
        raise CalibrationError(f"field {name} is {value!r}, not a number")
    return found
