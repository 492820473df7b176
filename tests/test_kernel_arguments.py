"""Kernels take few arguments: arrays that belong together come as a NamedTuple, whose fields mypy checks."""

from __future__ import annotations

import ast
from fnmatch import fnmatch
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parent.parent / "wheelsight"
FILES = sorted(PACKAGE.rglob("*_kernels.py"))
MOST = 8
# Kernels of more arguments that are left, by their file; a file goes from here once it has none, and none is added.
EXCEPTIONS = {
    "fusion/*_look_kernels.py",
    "fusion/*_step_kernels.py",
    "mapping/_block_kernels.py",
    "mapping/_fusion_kernels.py",
    "mapping/_match_kernels.py",
    "mapping/_view_kernels.py",
    "odometry/dense/_alignment_kernels.py",
    "odometry/dense/_grid_kernels.py",
    "odometry/dense/_shown_kernels.py",
    "odometry/dense/_turn_kernels.py",
    "odometry/features/_hamming_kernels.py",
    "odometry/features/_kernels.py",
    "odometry/wheels/_gyro_kernels.py",
    "odometry/wheels/_kernels.py",
}


def with_many_arguments(source: str) -> list[str]:
    """Functions of more arguments than `MOST`, with how many."""
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    counts = {node.name: len(node.args.posonlyargs + node.args.args + node.args.kwonlyargs) for node in functions}
    return [f"{name} has {count} arguments" for name, count in counts.items() if count > MOST]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_kernels_have_at_most_eight_arguments(path: Path) -> None:
    many = with_many_arguments(path.read_text(encoding="utf-8"))
    if not any(fnmatch(path.relative_to(PACKAGE).as_posix(), pattern) for pattern in EXCEPTIONS):
        assert not many, f"{path.name}: {'; '.join(many)}: put what belongs together into a NamedTuple"


def test_a_ninth_argument_is_found() -> None:
    assert with_many_arguments("def f(a, b, c, d, e, f, g, h, *, i): pass") == ["f has 9 arguments"]
    assert with_many_arguments("def f(a, b, c, d, e, f, g, h): pass") == []
