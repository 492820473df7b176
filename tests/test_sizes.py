"""A function and a file stay short enough to be read from the top down."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from sources import PACKAGES

ROOT = Path(__file__).resolve().parent.parent
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
LONGEST_FUNCTION, LONGEST_FILE = 80, 900


def too_long(source: str, is_command: bool) -> Iterator[str]:
    """The functions of a file that are; of a command line's, whose options and help are no code, the body counts."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        begin = node.lineno
        if is_command and not node.name.startswith("_") and ast.get_docstring(node) is not None:
            begin = node.body[0].end_lineno or begin
        if (node.end_lineno or begin) - begin + 1 > LONGEST_FUNCTION:
            yield node.name


def is_command(path: Path) -> bool:
    """Whether it holds commands: modules of the command line, or `cli` of a package beside it."""
    return "cli" in (path.parent.name, path.stem) and not path.name.startswith("_")


def test_functions_and_files_are_short() -> None:
    functions, files = set(), set()
    for path in SOURCES:
        source = path.read_text(encoding="utf-8")
        functions |= {(path.name, name) for name in too_long(source, is_command(path))}
        if len(source.splitlines()) > LONGEST_FILE:
            files.add(path.relative_to(ROOT).as_posix())
    assert functions == set()
    assert files == set()


def test_what_is_too_long_is_found() -> None:
    def function(lines: int, docstring: int = 0) -> str:
        docstring_lines = '    """Does.\n' + "\n" * (docstring - 2) + '    """\n' if docstring else ""
        return "def work():\n" + docstring_lines + "    pass\n" * (lines - docstring - 1)

    assert list(too_long(function(80), is_command=False)) == []
    assert list(too_long(function(81), is_command=False)) == ["work"]
    assert list(too_long(function(81, docstring=5), is_command=False)) == ["work"]
    assert list(too_long(function(81, docstring=5), is_command=True)) == []
    assert list(too_long("class Thing:\n    " + function(81).replace("\n", "\n    "), is_command=False)) == ["work"]
