"""Fields of a calibration.yaml, one by one: names, numbers and motions, each refused by its name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray

Part = TypeVar("Part")


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
