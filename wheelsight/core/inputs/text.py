"""Parsers of text: words and rows of numbers, JSON and YAML, with bounds on size, depth and values."""

from __future__ import annotations

import json
import math
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, NoReturn

import numpy as np
import yaml
from numpy.typing import NDArray

from wheelsight.core.errors import InputError
from wheelsight.core.files import StrPath
from wheelsight.core.inputs.gate import Kind, read_text

# Words of a line as people's programs write them: with commas, semicolons or spaces between, and in quotes.


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


# Rows of plain numbers in bulk: what numpy reads at once; a reader of lines takes the rest, and says what is wrong.


# Characters read at a time, so that the lines of a long text never stand in memory one by one.
_PIECE = 1 << 22
_PLAIN_ROWS_ODD = "#\"'\r"


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
    if not text or any(mark in text for mark in _PLAIN_ROWS_ODD):
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


# JSON from strangers: depth, size and numbers are bounded.


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


# YAML from strangers: plain values alone; size, depth, aliases and numbers are bounded.


YAML_FILE = Kind("a YAML file", most_mb=1, most_lines=100_000, longest_line=1 << 20)
_YAML_FILES_DEEPEST = 32
# With every alias counted as what it stands for. A map of a thousand areas with twenty corners each has 60 000.
_YAML_FILES_MOST_VALUES = 100_000
_LARGEST = 1e15  # metres, seconds or pixels: beyond, squares and sums of squares lose their differences
_EXPONENT = re.compile(r"[+-]?[\d.]+[eE][+-]?\d+")
_TAG = "tag:yaml.org,2002:"
_PLAIN = ("null", "bool", "int", "float", "seq", "map", "str")
_FIX = "correct the line, or put the text in quotes"
_Base: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_yaml(path: StrPath, error: type[InputError]) -> Any:
    """What a YAML file holds. Raises InputError of the type `error`, naming file, line and fix."""
    return parse_yaml(read_text(path, YAML_FILE, error), path, error)


def parse_yaml(text: str, path: StrPath, error: type[InputError]) -> Any:
    """What a YAML text of the file at `path` holds: dicts, lists, text, numbers, booleans, None.

    Dates stay text, and OpenCV's first line and tag of matrices are passed over.

    Raises:
        InputError: of the type `error`, naming file, line and fix: text that is no YAML, nesting deeper than 32
            levels, more than 100 000 values (aliases count as what they stand for), tags of other kinds, whole numbers
            beyond 64 bits, other numbers beyond 1e15.
    """
    path = Path(path)
    text = text.replace("%YAML:1.0", "", 1) if text.startswith("%YAML:1.0") else text
    if odd := yaml.reader.Reader.NON_PRINTABLE.search(text):
        line = text.count("\n", 0, odd.start()) + 1
        raise error(f"holds the character {odd[0]!r}, which YAML does not allow", path=path, line=line, fix=_FIX)
    try:
        _Size().check(text)
        return yaml.load(text, _Loader)
    except yaml.YAMLError as problem:
        raise _told(problem, path, error) from problem


def line_of(path: StrPath, names: Sequence[str], error: type[InputError]) -> int | None:
    """The line on which the last of nested `names` stands, or the innermost above it that the file has, if any.

    Raises InputError of the type `error` where the file, which `read_yaml` has taken, can no longer be read.
    """
    node, line = yaml.compose(read_text(path, YAML_FILE, error), _Loader), None
    for name in names:
        entries = node.value if isinstance(node, yaml.MappingNode) else []
        found = [(key, value) for key, value in entries if key.value == name]
        if not found:
            break
        key, node = found[-1]
        line = key.start_mark.line + 1
    return line


class _Size:
    """Counts the values of a document as its parser comes by them, before any is made."""

    def __init__(self) -> None:
        self._open: list[tuple[str | None, int]] = []
        self._named: dict[str, int | None] = {}  # values below an anchor; None while it is open
        self._count = 0

    def check(self, text: str) -> None:
        """Raises yaml.MarkedYAMLError for too deep, too many, or an alias of what it lies in."""
        for event in yaml.parse(text, _Loader):
            if isinstance(event, yaml.AliasEvent):
                self._alias(event)
            elif isinstance(event, yaml.CollectionStartEvent):
                self._begin(event.anchor)
                if len(self._open) > _YAML_FILES_DEEPEST:
                    _yaml_files_refuse(f"is nested deeper than {_YAML_FILES_DEEPEST} levels", event)
            elif isinstance(event, yaml.CollectionEndEvent):
                anchor, before = self._open.pop()
                self._name(anchor, self._count - before)
            elif isinstance(event, yaml.ScalarEvent):
                self._count += 1
                self._name(event.anchor, 1)
            if self._count > _YAML_FILES_MOST_VALUES:
                _yaml_files_refuse(
                    f"holds more than {_YAML_FILES_MOST_VALUES} values, aliases counted as what they stand for", event
                )

    def _begin(self, anchor: str | None) -> None:
        self._open.append((anchor, self._count))
        self._count += 1
        if anchor is not None:
            self._named[anchor] = None

    def _name(self, anchor: str | None, values: int) -> None:
        if anchor is not None:
            self._named[anchor] = values

    def _alias(self, event: Any) -> None:
        values = self._named.get(event.anchor, 1)
        if values is None:
            _yaml_files_refuse(f"alias {event.anchor!r} stands for what it lies in", event)
        self._count += values


class _Loader(_Base):  # type: ignore[misc]
    """Makes plain values only; whatever fails on the way is an error with its line."""

    yaml_constructors: ClassVar = {f"{_TAG}{name}": _Base.yaml_constructors[f"{_TAG}{name}"] for name in _PLAIN}
    yaml_implicit_resolvers: ClassVar = {
        first: [(tag, pattern) for tag, pattern in resolvers if tag.removeprefix(_TAG) in (*_PLAIN, "merge")]
        for first, resolvers in _Base.yaml_implicit_resolvers.items()
    }

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        """The value of a node. Raises yaml.YAMLError alone."""
        try:
            value = super().construct_object(node, deep)
        except yaml.YAMLError:
            raise
        except Exception as error:  # constructors fail in ways of their own: int(""), the wrong key, too many digits
            kind = node.tag.removeprefix(_TAG)
            _yaml_files_refuse(f"{_clipped(node.value)} is no {kind}", node, cause=error)
        if _is_beyond(value):
            _yaml_files_refuse(f"{_clipped(node.value)} is beyond every number that means something here", node)
        return value


def _matrix(loader: _Loader, node: Any) -> Any:
    return loader.construct_mapping(node, deep=True)


def _undefined(loader: _Loader, node: Any) -> NoReturn:
    _yaml_files_refuse(f"has the tag {_clipped(node.tag)}, which means nothing here", node)


_Loader.add_constructor(f"{_TAG}opencv-matrix", _matrix)
_Loader.add_constructor(None, _undefined)


def _is_beyond(value: Any) -> bool:
    if isinstance(value, int):
        return abs(value) >= _LARGEST_INTEGER
    if isinstance(value, str):  # YAML 1.1 reads 1e30, without a dot, as text
        if len(value) > 40 or not _EXPONENT.fullmatch(value):
            return False
        try:
            value = float(value)
        except ValueError:
            return False
        return bool(abs(value) > _LARGEST)
    return isinstance(value, float) and math.isfinite(value) and abs(value) > _LARGEST


def _yaml_files_refuse(problem: str, where: Any, cause: Exception | None = None) -> NoReturn:
    raise yaml.MarkedYAMLError(problem=problem, problem_mark=where.start_mark) from cause


def _clipped(value: Any) -> str:
    text = repr(value) if isinstance(value, str) else "a list or mapping"
    return text if len(text) <= 60 else f"{text[:57]}…"


def _told(problem: yaml.YAMLError, path: Path, error: type[InputError]) -> InputError:
    mark = getattr(problem, "problem_mark", None)
    line = None if mark is None else mark.line + 1
    said = getattr(problem, "problem", None) or "its text ends too early"
    own = type(problem) is yaml.MarkedYAMLError
    return error(said if own else f"is not YAML: {said}", path=path, line=line, fix=_FIX)
