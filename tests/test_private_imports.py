"""What begins with an underscore is imported within its own package alone, by tests too.

`tests/x/` mirrors `wheelsight/x/`, and may import what that may: a part's tests know the part, and no other.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from sources import PACKAGES, imports_in

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = (*PACKAGES, "tests", "benchmarks", "examples", "papers")
OWN = {*PACKAGES, "benchmarks", "papers", "examples"}
FILES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
# Left to be mended, where others work on both sides; a line goes as soon as its import has gone.
EXCEPTIONS: set[tuple[str, str]] = set()


def private_imports(source: str, package: str) -> Iterator[str]:
    """Private modules and names that a source in a package imports from other packages, up to the underscore."""
    for node in imports_in(source):
        names = [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{name}" for name in names]
        for name in names:
            private = private_part(name)
            home = package_with(private)
            if private and name.split(".")[0] in OWN and not f"{package}.".startswith(f"{home}."):
                yield private


def package_with(private: str) -> str:
    """The package of a private module, or of the module of a private name."""
    home = private.rpartition(".")[0]
    return home if (ROOT / home.replace(".", "/")).is_dir() else home.rpartition(".")[0]


def private_part(name: str) -> str:
    """A dotted name up to its first part with an underscore; empty where it has none. `__version__` is not private."""
    parts = name.split(".")
    private = [i for i, part in enumerate(parts) if part.startswith("_") and not part.endswith("__")]
    return ".".join(parts[: private[0] + 1]) if private else ""


def package_of(path: Path) -> str:
    """The package that a file is in, or whose tests are in its folder."""
    first, *rest = path.relative_to(ROOT).parent.parts
    if first == "tests" and rest[:1] not in (["benchmarks"], ["papers"]):
        first = "wheelsight"
    elif first == "tests":
        first = rest.pop(0)
    return ".".join((first, *rest))


def test_private_things_stay_within_their_package() -> None:
    found = {
        (path.relative_to(ROOT).as_posix(), private)
        for path in FILES
        for private in private_imports(path.read_text(encoding="utf-8"), package_of(path))
    }
    assert found == EXCEPTIONS, "test what is public, or make it public"


@pytest.mark.parametrize(
    ("line", "package", "found"),
    [
        ("from wheelsight.places._layout import x", "wheelsight_report", "wheelsight.places._layout"),
        ("from wheelsight.places import _layout as l", "wheelsight", "wheelsight.places._layout"),
        ("from wheelsight.places.describers import _x", "wheelsight_report", "wheelsight.places.describers._x"),
        ("from wheelsight.places.describers import _x", "wheelsight.places", None),
        ("import wheelsight.vision.dense._a.b", "wheelsight.vision", "wheelsight.vision.dense._a"),
        ("from wheelsight.vision.visual_odometry import x", "wheelsight.vision.dense", None),
        ("from wheelsight.places import _layout", "wheelsight.places", None),
        ("from wheelsight import __version__", "wheelsight.app.cli", None),
        ("from numpy._core import x", "wheelsight.app.cli", None),
    ],
)
def test_an_import_across_packages_is_found(line: str, package: str, found: str | None) -> None:
    assert list(private_imports(line, package)) == ([found] if found else [])
