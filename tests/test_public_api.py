"""What every public function promises alike: paths as text."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sources import PACKAGES

from wheelsight import Trajectory, read_kitti, read_tum, write_kitti, write_tum

DOCS = Path(__file__).resolve().parent.parent / "docs"
_NOT_IMPORTED = ("wheelsight.app.cli",)
# Made by readers, not by users.
_ANSWERS = tuple(
    f"{name}.__init__"
    for name in ("Exported", "FolderContents", "KeptKeyframes", "LabelFile", "LabelSource", "MapFolder")
)


def packages() -> list[str]:
    below = [
        module.name
        for root in map(importlib.import_module, PACKAGES)
        for module in pkgutil.walk_packages(root.__path__, f"{root.__name__}.")
        if module.ispkg and module.name not in _NOT_IMPORTED
    ]
    return list(dict.fromkeys([*PACKAGES, *below, *documented()]))


def documented() -> list[str]:
    """Modules that the pages of the API show, and those that examples on pages import."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in sorted(DOCS.rglob("*.md")))
    shown = re.findall(r"^(?:::: |from )(wheelsight(?:_\w+)?\.[\w.]+)", text, re.MULTILINE)
    return sorted({name for name in shown if is_module(name)})


def is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:  # a name within a module
        return False


def functions_of(package: str) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Public functions of a package, and those of its public classes."""
    module = importlib.import_module(package)
    for name in getattr(module, "__all__", [name for name in vars(module) if not name.startswith("_")]):
        found = getattr(module, name)
        if inspect.isfunction(found):
            yield name, found
        elif inspect.isclass(found):
            for below, method in vars(found).items():
                plain = getattr(method, "__func__", method)
                if inspect.isfunction(plain) and (not below.startswith("_") or below == "__init__"):
                    yield f"{name}.{below}", plain


@pytest.mark.parametrize("package", packages())
def test_what_takes_a_path_takes_text(package: str) -> None:
    """Readers alone, which `open_recording` chooses among, and what serves it, are handed folders."""
    wrong = []
    for name, function in functions_of(package):
        for parameter, kind in getattr(function, "__annotations__", {}).items():
            is_ours = function.__module__.partition(".")[0] in PACKAGES and name not in _ANSWERS
            takes_text = "StrPath" in str(kind) or "PathLike" in str(kind)
            if is_ours and parameter != "return" and re.search(r"\bPath\b", str(kind)) and not takes_text:
                wrong.append(f"{name}({parameter}: {kind})")
    assert not wrong


def test_text_does_for_paths(tmp_path: Path) -> None:
    way = Trajectory(np.arange(3.0), np.tile(np.eye(4), (3, 1, 1)))
    for write, read in ((write_tum, read_tum), (write_kitti, read_kitti)):
        write(way, str(tmp_path / "way.txt"))
        assert len(read(str(tmp_path / "way.txt"))) == 3
