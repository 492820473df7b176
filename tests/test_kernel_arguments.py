"""Kernels take few arguments: arrays that belong together come as a NamedTuple, whose fields mypy checks."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from sources import PACKAGES

ROOT = Path(__file__).resolve().parent.parent
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*_kernels.py"))
MOST = 8


def with_many_arguments(source: str) -> list[str]:
    """Functions of more arguments than `MOST`, with how many."""
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    counts = {node.name: len(node.args.posonlyargs + node.args.args + node.args.kwonlyargs) for node in functions}
    return [f"{name} has {count} arguments" for name, count in counts.items() if count > MOST]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_kernels_have_at_most_eight_arguments(path: Path) -> None:
    many = with_many_arguments(path.read_text(encoding="utf-8"))
    assert not many, f"{path.name}: {'; '.join(many)}: put what belongs together into a NamedTuple"


def test_a_ninth_argument_is_found() -> None:
    assert with_many_arguments("def f(a, b, c, d, e, f, g, h, *, i): pass") == ["f has 9 arguments"]
    assert with_many_arguments("def f(a, b, c, d, e, f, g, h): pass") == []
