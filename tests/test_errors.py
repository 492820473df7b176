"""Errors: one root, one line each, with file, line and fix."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import pytest

from wheelsight.core import errors
from wheelsight.core.errors import CalibrationError, InputError, RecordingError, WheelsightError

ALL_ERRORS = [kind for _, kind in inspect.getmembers(errors, inspect.isclass) if issubclass(kind, Exception)]


@pytest.mark.parametrize("kind", ALL_ERRORS)
def test_everything_raised_on_purpose_has_one_root(kind: type[Exception]) -> None:
    assert issubclass(kind, WheelsightError)
    assert not issubclass(kind, (OSError, ValueError)), "callers must be able to tell them from accidents"


def test_the_tree_in_the_docstring_is_the_tree() -> None:
    for kind in ALL_ERRORS:
        assert f"{kind.__name__} " in f"{errors.__doc__} ".replace("\n", " "), kind


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({}, "is wrong"),
        ({"path": Path("a/rgb.txt")}, "a/rgb.txt: is wrong"),
        ({"path": "rgb.txt", "line": 3}, "rgb.txt:3: is wrong"),
        ({"path": "rgb.txt", "line": 3, "fix": "mend it"}, "rgb.txt:3: is wrong (mend it)"),
        ({"fix": "mend it"}, "is wrong (mend it)"),
        ({"path": "two  blanks/rgb.txt"}, "two  blanks/rgb.txt: is wrong"),
    ],
)
def test_a_message_names_place_problem_and_fix(keywords: dict[str, Any], message: str) -> None:
    error = InputError("is wrong", **keywords)
    assert str(error) == message
    assert error.problem == "is wrong"


def test_a_message_is_one_line_whatever_it_quotes() -> None:
    error = CalibrationError("is not YAML: while parsing\n  a block\n    mapping", path="c.yaml", fix="look\nat it")
    assert str(error) == "c.yaml: is not YAML: while parsing a block mapping (look at it)"


def test_a_message_is_no_longer_than_a_screen() -> None:
    error = InputError("x" * 10_000, path="y" * 10_000, line=3, fix="z" * 10_000)
    assert len(str(error)) <= 2000
    assert str(error).startswith("yyy")
    assert str(error).endswith("z)")
    assert error.problem == "x" * 10_000


def test_a_message_holds_nothing_that_acts_on_a_terminal_or_cannot_be_printed() -> None:
    error = InputError("is \x1b[31mred", path="a\udcff\x07.txt", fix="σ stays")
    assert str(error) == "a\\udcff\\x07.txt: is \\x1b[31mred (σ stays)"


def test_the_place_can_be_asked_for() -> None:
    error = RecordingError("is absent", path="rgb.txt", line=7, fix="remove the line")
    assert (error.path, error.line, error.fix) == (Path("rgb.txt"), 7, "remove the line")


def test_a_message_full_of_control_characters_fits_on_a_screen() -> None:
    assert len(str(RecordingError("\0" * 100_000, path="\x1b" * 5000, fix="\0" * 100_000))) < 2000
