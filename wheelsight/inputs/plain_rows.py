"""Rows of plain numbers in bulk: what numpy reads at once; a reader of lines takes the rest, and says what is wrong."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Characters read at a time, so that the lines of a long text never stand in memory one by one.
_PIECE = 1 << 22
_ODD = "#\"'\r"


def plain_rows(text: str, whole: Sequence[bool], between: str | None) -> list[NDArray[Any]] | None:
    """The columns (N,) of lines of numbers, or None where any line is anything else.

    Args:
        text: from the first row on; ends after the last one, with or without a line end.
        whole: of each column, whether it holds whole numbers: int64 then, else float64.
        between: what parts the numbers of a line; None for white space.

    Returns:
        The columns, all as long as `text` has lines: no line is blank, has a comment, or more or fewer numbers.
    """
    text = text.rstrip()
    if not text or any(mark in text for mark in _ODD):
        return None
    kinds = np.dtype([(f"column{i}", np.int64 if is_whole else np.float64) for i, is_whole in enumerate(whole)])
    pieces, begin = [], 0
    while begin < len(text):
        end = text.find("\n", begin + _PIECE)
        end = len(text) if end < 0 else end
        rows = _read(text[begin:end].split("\n"), kinds, between)
        if rows is None:
            return None
        pieces.append(rows)
        begin = end + 1
    table = np.concatenate(pieces)
    return [np.ascontiguousarray(table[name]) for name in kinds.names or ()]


def _read(lines: list[str], kinds: np.dtype[np.void], between: str | None) -> NDArray[np.void] | None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of whole numbers with a point, and of nothing but blank lines
            rows = np.loadtxt(lines, dtype=kinds, delimiter=between, comments=None, ndmin=1)
    except (ValueError, OverflowError, Warning):
        return None
    return rows if len(rows) == len(lines) else None
