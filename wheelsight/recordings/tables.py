"""Tables of numbers whose first line names their columns, as people's programs write them."""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.errors import RecordingError
from wheelsight.inputs import Kind, as_number, plain_rows, unquoted
from wheelsight.recordings.protocol import LeftOut
from wheelsight.recordings.text import COMMENT, LARGEST_STAMP, LIST, parse_stamp, read_list
from wheelsight.stamps import column_unit

_FIX = "correct or remove the line"
_LARGEST = 1e15  # of numbers: squares of larger ones no longer add up
_UNIT_APART = re.compile(r"\s+(?=[\[(])()")  # "time [ms] left": one name, where white space parts names
_LARGEST_COUNT = (1 << 64) - 1  # of the widest counter


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table: its number in the file, from 1, the words of its columns, how stamps count."""

    path: Path
    number: int
    columns: dict[str, int]
    words: tuple[str, ...]
    per_second: float = 1.0

    @property
    def stamp_s(self) -> float:
        """Of column stamp_s, in seconds. Raises RecordingError."""
        return parse_stamp(self.words[self.columns["stamp_s"]], self.path, self.number) / self.per_second

    def __getitem__(self, column: str) -> float:
        """A finite number. Raises RecordingError."""
        value = as_number(self.words[self.columns[column]])
        if not abs(value) <= _LARGEST:
            raise self._error(column, "a number")
        return value

    def whole(self, column: str) -> int:
        """A whole number, "7" or "7.0". Raises RecordingError."""
        word = self.words[self.columns[column]]
        try:
            value = int(word)
        except ValueError:
            number = as_number(word)
            value = int(number) if math.isfinite(number) and number.is_integer() else _LARGEST_COUNT + 1
        if abs(value) > _LARGEST_COUNT:
            raise self._error(column, "a whole number")
        return value

    def _error(self, column: str, what: str) -> RecordingError:
        problem = f"{column} is {self.words[self.columns[column]]!r}, not {what}"
        return RecordingError(problem, path=self.path, line=self.number, fix=_FIX)


@dataclass(frozen=True, slots=True)
class Columns:
    """A table's columns: stamps (N,) in seconds, the others by name, and the number of each row's line, from 1."""

    stamps_s: list[float]
    values: dict[str, list[Any]]
    lines: Sequence[int]

    def __getitem__(self, name: str) -> list[Any]:
        return self.values[name]


def read_columns(path: Path, numbers: Sequence[str] = (), counts: Sequence[str] = ()) -> tuple[Columns, list[str]]:
    """Column stamp_s of a table, its `numbers` and its `counts`, which are whole; and warnings. See `read_table`.

    Raises:
        RecordingError: as `read_table`, and for what is no number, or no whole one.
    """
    text = read_list(path)
    header = _header(text, path, ("stamp_s", *numbers, *counts))
    columns = _plain_columns(text, header, numbers, counts)
    if columns is not None:
        return columns, []
    warnings: list[str] = []
    stamps_s, lines, values = [], [], {name: list[Any]() for name in (*numbers, *counts)}
    for row in _rows(text, header, path, warnings):
        stamps_s.append(row.stamp_s)
        lines.append(row.number)
        for name in numbers:
            values[name].append(row[name])
        for name in counts:
            values[name].append(row.whole(name))
    return Columns(stamps_s, values, lines), warnings


def column_names(path: Path, columns: Sequence[str], kind: Kind = LIST) -> tuple[str, ...]:
    """All columns that the first line of a table names; `columns` must be among them. Raises RecordingError."""
    return _header(read_list(path, kind), path, columns).names


def read_table(path: Path, columns: Sequence[str], kind: Kind = LIST) -> tuple[list[Row], list[str]]:
    """The rows of a table whose first line names its columns, of which `columns` are read; and warnings.

    Its first line says what parts the columns: semicolons (numbers may then have decimal commas), tabs, commas or
    spaces; it may begin with #, be in capitals or have quotes. For stamp_s any name of stamps with a unit may stand,
    such as stamp_ms or `time [ns]`. A last line that does not end was cut off while it was written; its numbers may
    lack digits, so it is left out.

    Raises:
        RecordingError: naming file and line, for a column that is missing, or a line of too few or too many words.
    """
    text, warnings = read_list(path, kind), list[str]()
    return list(_rows(text, _header(text, path, columns), path, warnings)), warnings


@dataclass(frozen=True, slots=True)
class _Header:
    """The line that names the columns: its number, what parts them (None: white space), and how stamps count."""

    number: int
    between: str | None
    names: tuple[str, ...]
    per_second: float


def _plain_columns(text: str, header: _Header, numbers: Sequence[str], counts: Sequence[str]) -> Columns | None:
    """The columns of a table of nothing but numbers, read at once; None for any other."""
    begin = _start_of_line(text, header.number + 1)
    if "\r" in text or not text.endswith("\n"):
        return None
    found = plain_rows(text[begin:], [name in counts for name in header.names], header.between)
    if found is None:
        return None
    by_name = dict(zip(header.names, found, strict=True))
    largest = {"stamp_s": LARGEST_STAMP, **dict.fromkeys(numbers, _LARGEST)}
    if not all((np.abs(by_name[name]) <= most).all() for name, most in largest.items()):
        return None
    stamps_s = (by_name["stamp_s"] / header.per_second).tolist()
    values = {name: by_name[name].tolist() for name in (*numbers, *counts)}
    return Columns(stamps_s, values, range(header.number + 1, header.number + 1 + len(stamps_s)))


def _start_of_line(text: str, number: int) -> int:
    begin = 0
    for _ in range(number - 1):
        begin = text.find("\n", begin) + 1
    return begin


def _rows(text: str, header: _Header, path: Path, warnings: list[str]) -> Iterator[Row]:
    places, last = {name: place for place, name in enumerate(header.names)}, 0
    for last, line in enumerate(_lines(text), start=1):
        bare = COMMENT.sub("", line).strip() if "#" in line else line.strip()
        if last <= header.number or not bare:
            continue
        words = _split(bare, header.between)
        while len(words) > len(places) and not words[-1]:
            words.pop()
        if len(words) != len(places):
            fix = "decimal commas need semicolons between the columns" if len(words) > len(places) else _FIX
            problem = f"{len(words)} values where {len(places)} are expected"
            raise RecordingError(problem, path=path, line=last, fix=fix)
        yield Row(path, last, places, tuple(words), header.per_second)
    if COMMENT.sub("", _rest(text)).strip() and last + 1 > header.number:
        told = f"{path.name}:{last + 1}: the last line is cut off and was left out"
        warnings.append(LeftOut(told, 1, last + 1, f"{path.name}: the last line is cut off"))


def _lines(text: str) -> Iterator[str]:
    """The lines that end, one by one, as `lines_of` counts them."""
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    begin = 0
    while (end := text.find("\n", begin)) >= 0:
        yield text[begin:end]
        begin = end + 1


def _rest(text: str) -> str:
    """What stands after the last line that ends."""
    return text[max(text.rfind("\n"), text.rfind("\r")) + 1 :]


def _header(text: str, path: Path, columns: Sequence[str]) -> _Header:
    """The line that names the columns."""
    first = None
    for number, line in enumerate(itertools.chain(_lines(text), [_rest(text)]), start=1):
        is_comment = line.lstrip().startswith("#")
        if not line.strip():
            continue
        between = next((mark for mark in ";\t," if mark in line), None)
        bare = line.lstrip("# \t").lower()
        names, per_second = _with_stamps(_split(bare if between else _UNIT_APART.sub(r"\1", bare), between))
        if all(column in names for column in columns):
            for name, count in Counter(names).items():
                if count > 1:
                    raise RecordingError(f"has column {name!r} twice", path=path, line=number, fix="name each once")
            return _Header(number, between, tuple(names), per_second)
        if not is_comment:
            first = (number, next(column for column in columns if column not in names))
            break
    number, missing = first or (1, columns[0])
    expected = f"the first line must name the columns {', '.join(columns)}"
    raise RecordingError(f"has no column {missing}", path=path, line=number, fix=expected)


def _with_stamps(names: list[str]) -> tuple[list[str], float]:
    """The names, with stamp_s for the one that is of stamps in some unit, and how many of these are a second."""
    if "stamp_s" in names:
        return names, 1.0
    found = [(i, unit.per_second) for i, name in enumerate(names) if (unit := column_unit(name)) is not None]
    if len(found) != 1:
        return names, 1.0
    place, per_second = found[0]
    return [*names[:place], "stamp_s", *names[place + 1 :]], per_second or 1.0


def _split(text: str, between: str | None) -> list[str]:
    words = text.strip().split(between)
    return [unquoted(word) for word in words] if "'" in text or '"' in text else [word.strip() for word in words]
