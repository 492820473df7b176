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

_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_ODD = re.compile("[;,\"']")
_BETWEEN = re.compile(r"[\s,]+")
_QUOTES = "\"'"


def split_words(text: str) -> list[str]:
    """Return the words of a line, without quotes and without empty ones at its end.

    Semicolons separate words if there are any, and commas are decimal ones; else commas and white space do.
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
    """Return a word without white space and quotes around it."""
    word = word.strip()
    return word[1:-1].strip() if len(word) > 1 and word[0] == word[-1] and word[0] in _QUOTES else word


def numbers_with_commas(words: list[str]) -> list[str]:
    """Return the words, with points for decimal commas."""
    return [word.replace(",", ".") if _DECIMAL_COMMA.fullmatch(word) else word for word in words]


def as_number(word: str) -> float:
    """Return the number of a word, with point or decimal comma; NaN for others."""
    try:
        return float(word)
    except ValueError:
        return float(word.replace(",", ".")) if _DECIMAL_COMMA.fullmatch(word) else math.nan


_PIECE = 1 << 22  # characters read at a time, so that a long text is never in memory line by line
_PLAIN_ROWS_ODD = "#\"'\r"


def plain_rows(text: str, whole: Sequence[bool], between: str | None) -> list[NDArray[Any]] | None:
    """Return the columns (N,) of lines of numbers; None if any line is blank, has a comment, or another width.

    numpy reads them at once; a reader of lines takes the rest, and names the problem.

    Args:
        text: rows, the last one with or without a line end.
        whole: for each column, whether it has whole numbers: int64, else float64.
        between: separator of numbers; None for white space.
    """
    text = text.rstrip()
    if not text or any(mark in text for mark in _PLAIN_ROWS_ODD):
        return None
    kinds = np.dtype([(f"column{i}", np.int64 if is_whole else np.float64) for i, is_whole in enumerate(whole)])
    pieces, begin = [], 0
    while begin < len(text):
        end = text.find("\n", begin + _PIECE)
        end = len(text) if end < 0 else end
        lines = text[begin:end].split("\n")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # whole numbers with a point, and only blank lines
                rows = np.loadtxt(lines, dtype=kinds, delimiter=between, comments=None, ndmin=1)
        except (ValueError, OverflowError, Warning):
            return None
        if len(rows) != len(lines):
            return None
        pieces.append(rows)
        begin = end + 1
    table = np.concatenate(pieces)
    return [np.ascontiguousarray(table[name]) for name in kinds.names or ()]


_DEEPEST = 64
_MOST_VALUES = 1_000_000
_LARGEST_INTEGER = 1 << 63


def parse_json(text: str | bytes) -> Any:
    """Return the value of a JSON text.

    Raises:
        ValueError: no JSON, nested deeper than 64 levels, more than a million values, NaN, infinity, or whole numbers
            beyond 64 bits.
    """

    def whole(digits: str) -> int:
        number = int(digits)
        if abs(number) >= _LARGEST_INTEGER:
            raise ValueError("holds a number beyond 64 bits")
        return number

    def refuse(constant: str) -> None:
        raise ValueError(f"holds {constant}, which is no JSON")

    try:
        document = json.loads(text, parse_constant=refuse, parse_int=whole)
    except RecursionError:
        raise ValueError("is nested too deeply") from None
    level, depth, count = [document], 0, 0
    while level:
        count += len(level)
        if depth > _DEEPEST:
            raise ValueError(f"is nested deeper than {_DEEPEST} levels")
        if count > _MOST_VALUES:
            raise ValueError(f"holds more than {_MOST_VALUES} values")
        groups = (
            value.values() if isinstance(value, dict) else value for value in level if isinstance(value, dict | list)
        )
        level = [inner for group in groups for inner in group]
        depth += 1
    return document


YAML_FILE = Kind("a YAML file", most_mb=1, most_lines=100_000, longest_line=1 << 20)
_DEEPEST_YAML = 32
# Each alias counts as its content. A map of a thousand areas with twenty corners each has 60 000.
_MOST_YAML_VALUES = 100_000
_LARGEST = 1e15  # metres, seconds or pixels: beyond, squares and sums of squares lose their differences
_EXPONENT = re.compile(r"[+-]?[\d.]+[eE][+-]?\d+")
_TAG = "tag:yaml.org,2002:"
_PLAIN = ("null", "bool", "int", "float", "seq", "map", "str")
_FIX = "correct the line, or put the text in quotes"
_Base: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_yaml(path: StrPath, error: type[InputError]) -> Any:
    """Return the value of a YAML file. Raises InputError of the type `error`, with file, line and fix."""
    return parse_yaml(read_text(path, YAML_FILE, error), path, error)


def parse_yaml(text: str, path: StrPath, error: type[InputError]) -> Any:
    """Return the value of a YAML text of the file at `path`: dicts, lists, text, numbers, booleans, None.

    Dates stay text. OpenCV's first line and tag of matrices are ignored.

    Raises:
        InputError: of the type `error`, with file, line and fix: no YAML, nesting deeper than 32 levels, more than
            100 000 values (aliases count as their content), other tags, whole numbers beyond 64 bits, other numbers
            beyond 1e15.
    """
    path = Path(path)
    text = text.replace("%YAML:1.0", "", 1) if text.startswith("%YAML:1.0") else text
    if odd := yaml.reader.Reader.NON_PRINTABLE.search(text):
        line = text.count("\n", 0, odd.start()) + 1
        raise error(f"holds the character {odd[0]!r}, which YAML does not allow", path=path, line=line, fix=_FIX)
    try:
        _check_size(text)
        return yaml.load(text, _Loader)
    except yaml.YAMLError as problem:
        mark = getattr(problem, "problem_mark", None)
        text = getattr(problem, "problem", None) or "its text ends too early"
        text = text if type(problem) is yaml.MarkedYAMLError else f"is not YAML: {text}"
        raise error(text, path=path, line=None if mark is None else mark.line + 1, fix=_FIX) from problem


def line_of(path: StrPath, names: Sequence[str], error: type[InputError]) -> int | None:
    """Return the line of the last of nested `names`, or of the innermost one that the file has, if any.

    Raises InputError of the type `error` if the file can no longer be read.
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


def _check_size(text: str) -> None:
    """Count the values of a document before any is made.

    Raises yaml.MarkedYAMLError: too deep, too many, or an alias of its own surroundings.
    """
    count, opened = 0, list[tuple[str | None, int]]()
    sizes: dict[str | None, int | None] = {}  # by anchor; None while it is open
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.AliasEvent):
            size = sizes.get(event.anchor, 1)
            if size is None:
                _yaml_error(f"alias {event.anchor!r} stands for what it lies in", event)
            count += size
        elif isinstance(event, yaml.CollectionStartEvent):
            opened.append((event.anchor, count))
            count, sizes[event.anchor] = count + 1, None
            if len(opened) > _DEEPEST_YAML:
                _yaml_error(f"is nested deeper than {_DEEPEST_YAML} levels", event)
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = opened.pop()
            sizes[anchor] = count - before
        elif isinstance(event, yaml.ScalarEvent):
            count, sizes[event.anchor] = count + 1, 1
        if count > _MOST_YAML_VALUES:
            _yaml_error(f"holds more than {_MOST_YAML_VALUES} values, aliases counted as what they stand for", event)


class _Loader(_Base):  # type: ignore[misc]
    """Makes plain values only; each failure is an error with its line."""

    yaml_constructors: ClassVar = {f"{_TAG}{name}": _Base.yaml_constructors[f"{_TAG}{name}"] for name in _PLAIN}
    yaml_implicit_resolvers: ClassVar = {
        first: [(tag, pattern) for tag, pattern in resolvers if tag.removeprefix(_TAG) in (*_PLAIN, "merge")]
        for first, resolvers in _Base.yaml_implicit_resolvers.items()
    }

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        """Return the value of a node. Raises only yaml.YAMLError."""
        try:
            value = super().construct_object(node, deep)
        except yaml.YAMLError:
            raise
        except Exception as error:  # constructors fail in ways of their own: int(""), the wrong key, too many digits
            kind = node.tag.removeprefix(_TAG)
            _yaml_error(f"{_clipped(node.value)} is no {kind}", node, cause=error)
        if _is_beyond(value):
            _yaml_error(f"{_clipped(node.value)} is beyond every number that means something here", node)
        return value


_Loader.add_constructor(f"{_TAG}opencv-matrix", lambda loader, node: loader.construct_mapping(node, deep=True))
_Loader.add_constructor(
    None, lambda _, node: _yaml_error(f"has the tag {_clipped(node.tag)}, which means nothing here", node)
)


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


def _yaml_error(problem: str, where: Any, cause: Exception | None = None) -> NoReturn:
    raise yaml.MarkedYAMLError(problem=problem, problem_mark=where.start_mark) from cause


def _clipped(value: Any) -> str:
    text = repr(value) if isinstance(value, str) else "a list or mapping"
    return text if len(text) <= 60 else f"{text[:57]}…"
