"""JSON from strangers: depth, size and numbers are bounded."""

from __future__ import annotations

import json
from typing import Any

_DEEPEST = 64
_MOST_VALUES = 1_000_000
_LARGEST_INTEGER = 1 << 63


def parse_json(text: str | bytes) -> Any:
    """What a JSON text holds.

    Raises:
        ValueError: it is no JSON, is nested deeper than 64 levels, holds more than a million values, NaN, infinity, or
            whole numbers beyond 64 bits.
    """
    try:
        document = json.loads(text, parse_constant=_refuse, parse_int=_whole)
    except RecursionError:
        raise ValueError("is nested too deeply") from None
    level, depth, count = [document], 0, 0
    while level:
        count += len(level)
        if depth > _DEEPEST:
            raise ValueError(f"is nested deeper than {_DEEPEST} levels")
        if count > _MOST_VALUES:
            raise ValueError(f"holds more than {_MOST_VALUES} values")
        level = [inner for value in level for inner in _inside(value)]
        depth += 1
    return document


def _inside(value: Any) -> Any:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()


def _whole(digits: str) -> int:
    number = int(digits)
    if abs(number) >= _LARGEST_INTEGER:
        raise ValueError("holds a number beyond 64 bits")
    return number


def _refuse(constant: str) -> None:
    raise ValueError(f"holds {constant}, which is no JSON")
