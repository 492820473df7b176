"""Kernels are made of few files: a change of any other compiles none of them again.

What a kernel file imports is compiled into it, and `wheelsight.core.compiled` follows all of it. A kernel file that
imported a whole part would be compiled for a minute after each change of that part.
"""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path

import pytest
from sources import PACKAGES

import wheelsight
from wheelsight.app.run.kernels import kernel_files
from wheelsight.core.compiled import made_of

ROOT = Path(wheelsight.__file__).parent.parent
SIMULATOR = ROOT / "wheelsight_sim"
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*_kernels.py"))


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def imported(path: Path) -> set[Path]:
    """The files of wheelsight that a file's syntax tree imports, those that they import, and itself."""
    found: set[Path] = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if file_of(name) else str(node.module) for name in inner]
        found |= {file for name in names if (file := file_of(name))}
    return found.union({path}, *map(imported, found))


def file_of(name: str) -> Path | None:
    path = ROOT.joinpath(*name.split(".")).with_suffix(".py")
    return path if name.partition(".")[0] in PACKAGES and path.exists() else None


def test_the_painter_is_made_of_all_files() -> None:
    names = {path.stem for path in imported(SIMULATOR / "view_kernels.py")}
    assert names >= {"light_kernels", "texture_kernels", "arrays", "compiled"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_file_is_made_of_what_it_imports_and_of_few_files(path: Path) -> None:
    import_module(module_of(path))
    assert made_of(module_of(path)) == {module_of(file) for file in imported(path)}
    assert imported(path) <= set(kernel_files())


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_kernels_are_compiled_by_one_mechanism(path: Path) -> None:
    assert "njit" not in path.read_text(encoding="utf-8")
