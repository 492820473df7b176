"""Tables of numbers whose first line names their columns, as people's programs write them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from wheelsight.errors import RecordingError
from wheelsight.inputs import as_number, lines_of, unquoted
from wheelsight.recordings._text import COMMENT, Line, parse_stamp, read_list

_FIX = "correct or remove the line"
_LARGEST = 1e15  # of numbers: squares of larger ones no longer add up
_LARGEST_COUNT = (1 << 64) - 1  # of the widest counter


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table of numbers; its number in the file, from 1, and the words of its columns."""

    path: Path
    number: int
    columns: dict[str, int]
    words: tuple[str, ...]

    @property
    def stamp_s(self) -> float:
        """Of column stamp_s. Raises RecordingError."""
        return parse_stamp(self.words[self.columns["stamp_s"]], self.path, self.number)

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


def read_table(path: Path, columns: Sequence[str]) -> tuple[list[Row], list[str]]:
    """The rows of a table whose first line names its columns, of which `columns` are read; and warnings.

    Its first line says what parts the columns: semicolons (numbers may then have decimal commas), tabs, commas or
    spaces; it may begin with #, be in capitals or have quotes. A last line that does not end was cut off while it was
    written; its numbers may lack digits, so it is left out.

    Raises:
        RecordingError: naming file and line, for a column that is missing, or a line of too few or too many words.
    """
    lines = lines_of(read_list(path))
    header, between = _header(lines, path, columns)
    places = {name: place for place, name in enumerate(_split(header.text.lstrip("# \t").lower(), between))}
    rows, warnings = [], []
    for number, text in enumerate(lines[header.number :], start=header.number + 1):
        bare = COMMENT.sub("", text).strip() if "#" in text else text.strip()
        if not bare:
            continue
        if number == len(lines):
            warnings.append(f"{path.name}:{number}: the last line is cut off and was left out")
            break
        words = _split(bare, between)
        while len(words) > len(places) and not words[-1]:
            words.pop()
        if len(words) != len(places):
            fix = "decimal commas need semicolons between the columns" if len(words) > len(places) else _FIX
            problem = f"{len(words)} values where {len(places)} are expected"
            raise RecordingError(problem, path=path, line=number, fix=fix)
        rows.append(Row(path, number, places, tuple(words)))
    return rows, warnings


def _header(lines: list[str], path: Path, columns: Sequence[str]) -> tuple[Line, str | None]:
    """The line that names the columns, and what parts them (None: white space)."""
    first = None
    for number, text in enumerate(lines, start=1):
        is_comment = text.lstrip().startswith("#")
        if not text.strip():
            continue
        between = next((mark for mark in ";\t," if mark in text), None)
        names = _split(text.lstrip("# \t").lower(), between)
        if all(column in names for column in columns):
            for name in names:
                if names.count(name) > 1:
                    raise RecordingError(f"has column {name!r} twice", path=path, line=number, fix="name each once")
            return Line(number, text), between
        if not is_comment:
            first = (number, next(column for column in columns if column not in names))
            break
    number, missing = first or (1, columns[0])
    expected = f"the first line must name the columns {', '.join(columns)}"
    raise RecordingError(f"has no column {missing}", path=path, line=number, fix=expected)


def _split(text: str, between: str | None) -> list[str]:
    words = text.strip().split(between)
    return [unquoted(word) for word in words] if "'" in text or '"' in text else [word.strip() for word in words]
