"""Text files of recordings: tables with named columns, lists of stamped numbers and of stamped files, and
`GrowingText`, which appends whole lines.
"""

from __future__ import annotations

import itertools
import math
import os
import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from operator import lt
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from wheelsight.core.errors import RecordingError
from wheelsight.core.files import check_name, output_error
from wheelsight.core.inputs import (
    Kind,
    as_number,
    is_there,
    lines_of,
    plain_rows,
    read_bytes,
    read_text,
    split_words,
    unquoted,
)
from wheelsight.core.stamps import column_unit
from wheelsight.io.recordings.recording import LeftOut

_SHARE_OUT_OF_ORDER_ALLOWED = 0.01
# Least mean length of sorted stretches that show a clock that was set back, not unsorted lines.
_FEWEST_IN_ORDER = 10
LARGEST_STAMP = 1e20  # over a hundred years in nanoseconds; no unit has larger stamps
_STAMP_NAME = re.compile(r"(?:time_?stamps?|stamps?|time|t)(?![a-z])", re.IGNORECASE)
_OTHER_UNIT = re.compile(r"(?<![a-z])(?:[nmuµ]s|[nmu]secs?|(?:nano|micro|milli)sec\w*)(?![a-z])", re.IGNORECASE)
COMMENT = re.compile(r"(^|\s)#.*")


class _Stamped(Protocol):
    @property
    def stamp_s(self) -> float: ...


# An hour of a gyroscope at 1 kHz has 3.6 million lines and 110 MB.
LIST = Kind("a list", most_mb=192, most_lines=6_000_000, missing="is missing", fix="each recording needs it")

IMAGE_LIST = replace(LIST, name="a list of images", most_mb=96, most_lines=500_000)

S = TypeVar("S", bound=_Stamped)


@dataclass(frozen=True, slots=True)
class Line:
    """A line that is not a comment, with its number in the file, from 1."""

    number: int
    text: str


def read_list(path: Path, kind: Kind = LIST) -> str:
    """The text of a list or table of a recording. Raises RecordingError naming the file."""
    return read_text(path, kind, RecordingError)


def read_lines(path: Path) -> list[Line]:
    """The lines of a text file without comments and blank lines. Any line ending and a byte order mark are accepted.

    Raises RecordingError where the file is missing, not text, not a regular file, or too large; names the file.
    """
    lines = enumerate(lines_of(read_list(path)), start=1)
    bare = (Line(number, COMMENT.sub("", line).strip()) for number, line in lines)
    return [line for line in bare if line.text]


def listed_lines(path: Path) -> tuple[list[Line], float]:
    """The lines of a list of images, and the units per second of their stamps, which a line above them may name.

    Only lines that begin with # are comments, since a name may contain it. A first line of column names is left out.

    Raises RecordingError as `read_lines`, and where the first line names an unknown unit.
    """
    lines: list[Line] = []
    per_second = 1.0
    for number, text in enumerate(lines_of(read_list(path, IMAGE_LIST)), start=1):
        bare = text.strip()
        if not lines and (unit := column_unit(bare.lstrip("# \t"))) is not None and unit.per_second is not None:
            per_second = unit.per_second
        if bare and not bare.startswith("#"):
            lines.append(Line(number, bare))
    name = unquoted(re.split(r"[;,\t]", lines[0].text)[0]) if lines else ""
    if not _STAMP_NAME.match(name):
        return lines, per_second
    if column_unit(lines[0].text) is None and _OTHER_UNIT.search(name):
        fix = "write them in seconds, or name their unit as in stamp_ms"
        raise RecordingError(f"stamps are {name!r}", path=path, line=lines[0].number, fix=fix)
    return lines[1:], per_second


def parse_stamp(word: str, path: Path, line: int) -> float:
    """A stamp in seconds. Raises RecordingError naming file and line."""
    stamp_s = as_number(word)
    if not abs(stamp_s) <= LARGEST_STAMP:
        fix = "begin the line with the time in seconds, such as 12.034"
        raise RecordingError(f"{word!r} is not a stamp in seconds", path=path, line=line, fix=fix)
    return stamp_s


def keep_growing(items: Sequence[S], lines: Sequence[int], path: Path) -> tuple[list[S], list[str]]:
    """The longest subsequence of `items` whose stamps strictly increase, and a warning where it leaves any out.

    Up to 1 % of the lines may be left out.

    Raises:
        RecordingError: more lines are out of order; names the first one, or the line at which a clock was set back.
    """
    stamps_s = [item.stamp_s for item in items]
    if all(map(lt, stamps_s, stamps_s[1:])):
        return list(items), []
    kept = _longest_growing(stamps_s)
    first = next(i for i, item in enumerate(items) if i >= len(kept) or kept[i] != i)
    problem = f"stamp {items[first].stamp_s:.6f} repeats another or is out of order"
    if len(items) - len(kept) > _SHARE_OUT_OF_ORDER_ALLOWED * len(items):
        # Sorting would interleave sorted stretches that overlap in time. A stretch begins where two stamps precede the
        # ones before them; a single one may be wrong.
        begins = [
            i
            for i in range(2, len(stamps_s))
            if stamps_s[i] < min(stamps_s[i - 2 : i]) and stamps_s[min(i + 1, len(stamps_s) - 1)] < stamps_s[i - 1]
        ]
        if begins and len(stamps_s) >= _FEWEST_IN_ORDER * (len(begins) + 1):
            at = begins[0]
            by_s = stamps_s[at - 1] - stamps_s[at]
            problem = f"stamp {stamps_s[at]:.6f} is {by_s:.3g} s earlier than the one before it: a clock was set back"
            fix = "cut the file before this line, or record again; sort the lines only if they were shuffled afterwards"
            raise RecordingError(problem, path=path, line=lines[at], fix=fix)
        fix = "sort the lines by stamp and keep one of each stamp"
        raise RecordingError(problem, path=path, line=lines[first], fix=fix)
    gone = len(items) - len(kept)
    warning = f"{path.name}:{lines[first]}: {problem}; {gone} of {len(items)} lines like it were left out"
    reason = f"{path.name}: stamps repeat others or are out of order"
    return [items[i] for i in kept], [LeftOut(warning, gone, len(items), reason)]


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


# Tables whose first line names their columns

_FIX = "correct or remove the line"
_LARGEST = 1e15  # of numbers: sums of squares of larger ones lose precision
_UNIT_APART = re.compile(r"\s+(?=[\[(])()")  # "time [ms] left" has two names
_LARGEST_COUNT = (1 << 64) - 1  # 64 bits, the widest counter


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table: its number in the file, from 1, its words, and the units per second of its stamp."""

    path: Path
    number: int
    columns: dict[str, int]
    words: tuple[str, ...]
    per_second: float = 1.0

    @property
    def stamp_s(self) -> float:
        """The stamp in seconds. Raises RecordingError."""
        return parse_stamp(self.words[self.columns["stamp_s"]], self.path, self.number) / self.per_second

    def __getitem__(self, column: str) -> float:
        """The number in a column. Raises RecordingError where it is not finite."""
        value = as_number(self.words[self.columns[column]])
        if not abs(value) <= _LARGEST:
            raise self._error(column, "a number")
        return value

    def whole(self, column: str) -> int:
        """The integer in a column, such as "7" or "7.0". Raises RecordingError."""
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
    """The columns of a table: stamps in seconds, the others by name, and the line number of each row, from 1."""

    stamps_s: list[float]
    values: dict[str, list[Any]]
    lines: Sequence[int]

    def __getitem__(self, name: str) -> list[Any]:
        return self.values[name]


def read_columns(path: Path, numbers: Sequence[str] = (), counts: Sequence[str] = ()) -> tuple[Columns, list[str]]:
    """The columns stamp_s, `numbers` and `counts` (integers) of a table, and warnings. See `read_table`.

    Raises RecordingError as `read_table`, and where a word is not a number, or not an integer.
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


def read_items(
    path: Path, make: Callable[..., S], numbers: Sequence[str] = (), counts: Sequence[str] = ()
) -> tuple[list[S], list[str]]:
    """`make(stamp_s, *numbers, *counts)` of each line of a table, at increasing stamps, and warnings.

    Raises RecordingError as `read_columns` and `keep_growing`.
    """
    table, warnings = read_columns(path, numbers, counts)
    items = list(map(make, table.stamps_s, *(table[name] for name in (*numbers, *counts))))
    growing, more = keep_growing(items, table.lines, path)
    return growing, warnings + more


def column_names(path: Path, columns: Sequence[str], kind: Kind = LIST) -> tuple[str, ...]:
    """All columns of a table. Raises RecordingError where one of `columns` is missing."""
    return _header(read_list(path, kind), path, columns).names


def read_table(path: Path, columns: Sequence[str], kind: Kind = LIST) -> tuple[list[Row], list[str]]:
    """The rows of a table whose first line names its columns, and warnings.

    The first line determines the separator: semicolon (numbers may then have decimal commas), tab, comma or space. It
    may begin with #, be in capitals or have quotes. In place of stamp_s a name with another unit is accepted, such as
    stamp_ms or `time [ns]`. A last line without a line end is left out, since its numbers may lack digits.

    Raises RecordingError where a column is missing, or a line has too few or too many words; names file and line.
    """
    text, warnings = read_list(path, kind), list[str]()
    return list(_rows(text, _header(text, path, columns), path, warnings)), warnings


@dataclass(frozen=True, slots=True)
class _Header:
    """The line that names the columns: its number, the separator (None: white space), and stamp units per second."""

    number: int
    between: str | None
    names: tuple[str, ...]
    per_second: float


def _plain_columns(text: str, header: _Header, numbers: Sequence[str], counts: Sequence[str]) -> Columns | None:
    """The columns of a table that has numbers only, parsed as one array; None for any other table."""
    if "\r" in text or not text.endswith("\n"):
        return None
    begin = 0
    for _ in range(header.number):
        begin = text.find("\n", begin) + 1
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


def _header(text: str, path: Path, columns: Sequence[str]) -> _Header:
    """The line that names the columns. Raises RecordingError where it lacks one of `columns`."""
    first = None
    for number, line in enumerate(itertools.chain(_lines(text), [_rest(text)]), start=1):
        is_comment = line.lstrip().startswith("#")
        if not line.strip():
            continue
        between = next((mark for mark in ";\t," if mark in line), None)
        bare = line.lstrip("# \t").lower()
        names, per_second = _split(bare if between else _UNIT_APART.sub(r"\1", bare), between), 1.0
        units = [(i, unit.per_second) for i, name in enumerate(names) if (unit := column_unit(name)) is not None]
        if "stamp_s" not in names and len(units) == 1:  # stamps in another unit
            names[units[0][0]], per_second = "stamp_s", units[0][1] or 1.0
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


def _rows(text: str, header: _Header, path: Path, warnings: list[str]) -> Iterator[Row]:
    """The rows below the header; adds a warning where the last line is incomplete. Raises RecordingError."""
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
        warning = f"{path.name}:{last + 1}: the last line is cut off and was left out"
        warnings.append(LeftOut(warning, 1, last + 1, f"{path.name}: the last line is cut off"))


def _lines(text: str) -> Iterator[str]:
    """The complete lines, as `lines_of` counts them."""
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    begin = 0
    while (end := text.find("\n", begin)) >= 0:
        yield text[begin:end]
        begin = end + 1


def _rest(text: str) -> str:
    """The incomplete line after the last line end, or an empty text."""
    return text[max(text.rfind("\n"), text.rfind("\r")) + 1 :]


def _split(text: str, between: str | None) -> list[str]:
    words = text.strip().split(between)
    return [unquoted(word) for word in words] if "'" in text or '"' in text else [word.strip() for word in words]


# Lists of stamped files, with lines `stamp file`

_STAMP = r"[+-]?\d+,\d+(?=[\s;\"'])|[^\s,;\"']+"
_ENTRY = re.compile(rf"[\"']?(?P<stamp>{_STAMP})[\"']?(?:\s*[,;]\s*|\s+)(?P<rest>.*\S)")
_IMAGE = re.compile(r".+?\.(?:png|jpe?g|tiff?|bmp|p[gpn]m)(?=[\s,;]|$)", re.IGNORECASE)
_NUMBER_FIRST = re.compile(r"\d+(?:\.\d+)?[\s,;]")
_PARTS = re.compile(r"[\s,;]")
_NAMES_TRIED = 20


@dataclass(frozen=True, slots=True)
class ListedFile:
    """A file and its time in seconds."""

    stamp_s: float
    path: Path


def read_file_list(path: Path, rate_hz: float | None = None) -> tuple[list[ListedFile], list[str]]:
    """The files of a list with lines `stamp file`, at increasing stamps, and warnings.

    White space, comma or semicolon separates the two. Quotes, further columns and a first line of names are ignored.
    Names may lack the folder that is called as the list, and may have backslashes.

    Args:
        rate_hz: units per second of the stamps; None for the unit in a first line or comment, else seconds.

    Raises:
        RecordingError: a line is invalid, stamps are out of order, or the list is empty; names file and line.
    """
    lines, per_second = listed_lines(path)
    if not lines:
        raise RecordingError("lists no images", path=path, fix="one `stamp file` a line is expected")
    stamps_s, names = [], []
    for line in lines:
        entry = _ENTRY.fullmatch(line.text)
        name = "" if entry is None else _name_in(entry["rest"], path, line.number)
        if entry is None or not name:
            fix = "one `stamp file` a line is expected"
            raise RecordingError("a stamp and a file are expected", path=path, line=line.number, fix=fix)
        stamps_s.append(parse_stamp(entry["stamp"], path, line.number) / (rate_hz or per_second))
        names.append(name)
    found, warnings = find_files(names, path, path.stem)
    files = [ListedFile(stamp_s, file) for stamp_s, file in zip(stamps_s, found, strict=True)]
    growing, more = keep_growing(files, [line.number for line in lines], path)
    return growing, warnings + more


def _name_in(rest: str, path: Path, line: int) -> str:
    """The file's name in the text after a stamp. Raises RecordingError."""
    if rest[0] in "\"'" and rest.find(rest[0], 1) > 0:
        return rest[1 : rest.find(rest[0], 1)].strip()
    rest = rest.rstrip(" \t,;")
    if not _PARTS.search(rest) or is_there(path.parent / rest):
        return rest
    if _NUMBER_FIRST.match(rest):
        fix = "write stamps with a decimal point, the file next, and quotes around a name with spaces"
        raise RecordingError(f"{rest!r} is no file", path=path, line=line, fix=fix)
    image = _IMAGE.match(rest)
    return rest if image is None else image[0]


def find_files(names: Sequence[str], path: Path, folder: str) -> tuple[list[Path], list[str]]:
    """The paths of a list's files, and a warning where they are found under other paths than the list names.

    Args:
        path: of the list; names are relative to its folder.
        folder: the subfolder to search for names without a folder.
    """
    beside = path.parent
    tried = names[:: max(len(names) // _NAMES_TRIED, 1)]
    ways: tuple[Callable[[str], Path], ...] = (
        lambda name: beside / name,
        lambda name: beside / name.replace("\\", "/"),
        lambda name: beside / folder / name,
        lambda name: beside / folder / re.split(r"[\\/]", name)[-1],
    )
    for number, way in enumerate(ways):
        if any(is_there(way(name)) for name in tried):
            warning = f"{path.name}: its names are not those of files; the files in {way(names[0]).parent} were taken."
            return _each_once(way, names), [warning] if number > 1 else []
    return _each_once(ways[0], names), []


def _each_once(way: Callable[[str], Path], names: Sequence[str]) -> list[Path]:
    """Return the path of each name; a list of one image 200 000 times makes one path."""
    known = {name: way(name) for name in dict.fromkeys(names)}
    return [known[name] for name in names]


def pair_of_files(line: Line, path: Path) -> tuple[tuple[float, str], tuple[float, str]]:
    """The two stamps and names of a line `stamp file stamp file`; further columns are ignored.

    Raises RecordingError where the line is invalid; names file and line.
    """
    words = split_words(line.text)
    has_more = len(words) > 4 and all(_IMAGE.fullmatch(word) for word in (words[1], words[3]))
    if len(words) != 4 and not has_more:
        problem = "`stamp color-file stamp depth-file` is expected"
        fix = "remove the file to have images paired by stamp"
        raise RecordingError(problem, path=path, line=line.number, fix=fix)
    first, second = ((parse_stamp(words[i], path, line.number), words[i + 1]) for i in (0, 2))
    return first, second


# Text files that grow during a recording

_LIST = Kind("a list of a recording to resume", 1 << 10)  # ten hours of readings at 300 Hz have 300 MB


class GrowingText:
    """A text file to which whole lines are appended without buffering. A partial write is undone.

    Otherwise a full disk or Ctrl-C would leave half a line, which readers refuse.

    Args:
        resume: whether to append to the complete lines of an existing file; else the file is overwritten.

    Attributes:
        earlier: the existing lines, without comments and the header; empty where the file is new.

    Raises:
        OutputError: the file cannot be created.
        RecordingError: the file to resume is not a regular file.
    """

    def __init__(self, path: Path, header: str, resume: bool = False) -> None:
        self._path = path
        self._length = 0
        self.earlier: tuple[str, ...] = ()
        check_name(path)
        try:
            kept = read_bytes(path, _LIST, RecordingError) if resume and is_there(path) else b""
            # Complete lines, up to the first zero byte, which a power cut may leave.
            kept = kept[: kept.find(b"\0")] if b"\0" in kept else kept
            kept = kept[: kept.rfind(b"\n") + 1]
            self._stream = path.open("r+b" if kept else "wb", buffering=0)
            if kept:
                self._length = len(kept)
                self._stream.truncate(self._length)
                self._stream.seek(self._length)
        except OSError as error:
            raise output_error(error, path) from error
        if not kept:
            self.append(header)
            return
        lines, first = kept.decode("utf-8", "replace").splitlines(), header.splitlines()
        self.earlier = tuple(line for line in lines if line.strip() and line[0] != "#" and line not in first)

    def append(self, text: str) -> None:
        """Write whole lines. Raises OutputError, and adds nothing, where the disk is full or the folder was removed."""
        data = memoryview(text.encode("utf-8", "backslashreplace"))
        try:
            rest = data
            while rest:
                rest = rest[self._stream.write(rest) :]
        except BaseException as error:
            with suppress(OSError):
                os.ftruncate(self._stream.fileno(), self._length)
                self._stream.seek(self._length)
            if isinstance(error, OSError):
                raise output_error(error, self._path) from error
            raise
        self._length += len(data)

    def close(self) -> None:
        """Close the file. Without it, only data in the system's buffers is lost."""
        self._stream.close()


def seconds(stamp_s: float) -> str:
    """A number with all its decimals and without exponent, so that it reads back exactly."""
    return np.format_float_positional(stamp_s, min_digits=6)
