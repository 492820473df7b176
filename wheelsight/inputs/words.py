"""Words of a line as people's programs write them: with commas, semicolons or spaces between, and in quotes."""

from __future__ import annotations

import math
import re

_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_ODD = re.compile("[;,\"']")
_BETWEEN = re.compile(r"[\s,]+")
_QUOTES = "\"'"


def split_words(text: str) -> list[str]:
    """The words of a line, without quotes; empty ones at its end are left out.

    Semicolons part words if there are any, so that commas are decimal ones; else commas and white space do.
    """
    if not _ODD.search(text):
        return text.split()
    if ";" in text:
        words = text.split(";")
    elif (spaced := text.split()) and len(spaced) > 1 and any(_DECIMAL_COMMA.fullmatch(word) for word in spaced):
        words = spaced
    else:
        words = _BETWEEN.split(text.strip())
    words = [unquoted(word) for word in words]
    while words and not words[-1]:
        words.pop()
    return words


def unquoted(word: str) -> str:
    """A word without the white space and the pair of quotes around it."""
    word = word.strip()
    return word[1:-1].strip() if len(word) > 1 and word[0] == word[-1] and word[0] in _QUOTES else word


def numbers_with_commas(words: list[str]) -> list[str]:
    """The words, with a point in place of the decimal comma where one is a number with such."""
    return [word.replace(",", ".") if _DECIMAL_COMMA.fullmatch(word) else word for word in words]


def as_number(word: str) -> float:
    """The number that a word is, with point or decimal comma; NaN where it is none."""
    try:
        return float(word)
    except ValueError:
        return float(word.replace(",", ".")) if _DECIMAL_COMMA.fullmatch(word) else math.nan
