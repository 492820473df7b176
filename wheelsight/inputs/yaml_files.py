"""YAML from strangers: plain values alone; size, depth, aliases and numbers are bounded."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, NoReturn

import yaml

from wheelsight.errors import InputError
from wheelsight.files import StrPath
from wheelsight.inputs.gate import Kind, read_text

YAML_FILE = Kind("a YAML file", most_mb=1, most_lines=100_000, longest_line=1 << 20)
_DEEPEST = 32
# With every alias counted as what it stands for. A map of a thousand areas with twenty corners each has 60 000.
_MOST_VALUES = 100_000
_LARGEST_INTEGER = 1 << 63
_LARGEST = 1e15  # metres, seconds or pixels: beyond, squares and sums of squares are no longer told apart
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
                if len(self._open) > _DEEPEST:
                    _refuse(f"is nested deeper than {_DEEPEST} levels", event)
            elif isinstance(event, yaml.CollectionEndEvent):
                anchor, before = self._open.pop()
                self._name(anchor, self._count - before)
            elif isinstance(event, yaml.ScalarEvent):
                self._count += 1
                self._name(event.anchor, 1)
            if self._count > _MOST_VALUES:
                _refuse(f"holds more than {_MOST_VALUES} values, aliases counted as what they stand for", event)

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
            _refuse(f"alias {event.anchor!r} stands for what it lies in", event)
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
            _refuse(f"{_clipped(node.value)} is no {kind}", node, cause=error)
        if _is_beyond(value):
            _refuse(f"{_clipped(node.value)} is beyond every number that means something here", node)
        return value


def _matrix(loader: _Loader, node: Any) -> Any:
    return loader.construct_mapping(node, deep=True)


def _undefined(loader: _Loader, node: Any) -> NoReturn:
    _refuse(f"has the tag {_clipped(node.tag)}, which means nothing here", node)


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


def _refuse(problem: str, where: Any, cause: Exception | None = None) -> NoReturn:
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
