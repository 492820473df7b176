"""Text files of recordings: lines with their numbers, lists of stamped files, stamps that must grow."""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from wheelsight.errors import RecordingError

_SHARE_OUT_OF_ORDER_ALLOWED = 0.01
_COMMENT = re.compile(r"(^|\s)#.*")


class _Stamped(Protocol):
    @property
    def stamp_s(self) -> float: ...


S = TypeVar("S", bound=_Stamped)


@dataclass(frozen=True, slots=True)
class Line:
    """One line that is no comment, with its number in the file, from 1."""

    number: int
    text: str


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table of numbers; its number in the file, from 1, and the words of the columns asked for."""

    path: Path
    number: int
    words: dict[str, str]

    @property
    def stamp_s(self) -> float:
        """Of column stamp_s. Raises RecordingError."""
        return parse_stamp(self.words["stamp_s"], self.path, self.number)

    def __getitem__(self, column: str) -> float:
        """A finite number. Raises RecordingError."""
        try:
            value = float(self.words[column])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise RecordingError(f"{column} is {self.words[column]!r}, not a number", path=self.path, line=self.number)
        return value

    def whole(self, column: str) -> int:
        """A whole number. Raises RecordingError."""
        try:
            return int(self.words[column])
        except ValueError as error:
            problem = f"{column} is {self.words[column]!r}, not a whole number"
            raise RecordingError(problem, path=self.path, line=self.number) from error


@dataclass(frozen=True, slots=True)
class ListedFile:
    """A file and its time in seconds, as a list file names them."""

    stamp_s: float
    path: Path


def read_lines(path: Path) -> list[Line]:
    """The lines of a text file without comments and blank lines; any line ends, with or without byte order mark.

    Raises:
        RecordingError: naming the file, if it is missing, no text, or holds nothing but comments.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError as error:
        raise RecordingError("is missing", path=path, fix="each recording needs it") from error
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", path=path) from error
    except UnicodeDecodeError as error:
        raise RecordingError("is not a text file", path=path) from error
    bare = (Line(number, _COMMENT.sub("", line).strip()) for number, line in enumerate(lines, start=1))
    return [line for line in bare if line.text]


def read_file_list(path: Path) -> tuple[list[ListedFile], list[str]]:
    """The files that a list names, one `stamp file` a line, at growing stamps; and warnings about lines left out.

    Raises:
        RecordingError: naming file and line, for a line that is none, stamps out of order, or an empty list.
    """
    lines = read_lines(path)
    if not lines:
        raise RecordingError("lists no images", path=path, fix="one `stamp file` a line is expected")
    files = []
    for line in lines:
        words = re.split(r"[\s,]+", line.text, maxsplit=1)
        if len(words) != 2:
            raise RecordingError("a stamp and a file are expected", path=path, line=line.number)
        files.append(ListedFile(parse_stamp(words[0], path, line.number), path.parent / words[1]))
    return keep_growing(files, [line.number for line in lines], path)


def read_table(path: Path, columns: Sequence[str]) -> tuple[list[Row], list[str]]:
    """The rows of a table with commas whose first line names its columns, of which `columns` are read; and warnings.

    A last line that does not end was cut off while it was written; its numbers may lack digits, so it is left out.

    Raises:
        RecordingError: naming file and line, for a column that is missing, or a line of too few or too many words.
    """
    lines = read_lines(path)
    names = [name.strip() for name in lines[0].text.split(",")] if lines else []
    for column in columns:
        if column not in names:
            expected = f"the first line must name the columns {', '.join(columns)}"
            raise RecordingError(
                f"has no column {column}", path=path, line=lines[0].number if lines else 1, fix=expected
            )
    warnings = []
    if len(lines) > 1 and not path.read_bytes().endswith((b"\n", b"\r")):
        warnings.append(f"{path.name}:{lines.pop().number}: the last line is cut off and was left out")
    rows = []
    for line in lines[1:]:
        words = [word.strip() for word in line.text.split(",")]
        if len(words) != len(names):
            raise RecordingError(f"{len(words)} values where {len(names)} are expected", path=path, line=line.number)
        rows.append(Row(path, line.number, dict(zip(names, words, strict=True))))
    return rows, warnings


def parse_stamp(word: str, path: Path, line: int) -> float:
    """A stamp in seconds. Raises RecordingError naming file and line."""
    try:
        stamp_s = float(word)
    except ValueError:
        stamp_s = math.nan
    if not math.isfinite(stamp_s):
        raise RecordingError(f"{word!r} is not a stamp in seconds", path=path, line=line)
    return stamp_s


def keep_growing(items: Sequence[S], lines: Sequence[int], path: Path) -> tuple[list[S], list[str]]:
    """The longest part of `items` whose stamps strictly grow, and a warning if that leaves any out.

    A few lines out of order, up to 1 % of the file, are left out; more say that the file is wrong.

    Raises:
        RecordingError: naming file and line of the first that would have to go.
    """
    kept = _longest_growing([item.stamp_s for item in items])
    if len(kept) == len(items):
        return list(items), []
    first = next(i for i, item in enumerate(items) if i >= len(kept) or kept[i] != i)
    problem = f"stamp {items[first].stamp_s:.6f} repeats another or is out of order"
    if len(items) - len(kept) > _SHARE_OUT_OF_ORDER_ALLOWED * len(items):
        raise RecordingError(
            problem, path=path, line=lines[first], fix="sort the lines by stamp and keep one of each stamp"
        )
    count = f"{len(items) - len(kept)} of {len(items)} lines"
    return [items[i] for i in kept], [f"{path.name}:{lines[first]}: {problem}; {count} like it were left out"]


def _longest_growing(stamps: Sequence[float]) -> list[int]:
    """Indices of a longest strictly growing subsequence (patience sorting); of equal stamps the first."""
    ends: list[float] = []
    indices: list[int] = []
    before: list[int] = []
    for i, stamp in enumerate(stamps):
        length = bisect_left(ends, stamp)
        before.append(indices[length - 1] if length else -1)
        if length == len(ends):
            ends.append(stamp)
            indices.append(i)
        elif stamp < ends[length]:
            ends[length], indices[length] = stamp, i
    chain = [indices[-1]] if indices else []
    while chain and before[chain[-1]] >= 0:
        chain.append(before[chain[-1]])
    return chain[::-1]
