"""Kernels that numba has cached must not outlive the kernels of other files that were compiled into them.

Numba keeps a compiled function until the text of its own file changes, whatever its file imports. So each file that
imports kernels carries a checksum of all that it compiles in: after a change below, its text must change too.
"""

from __future__ import annotations

import re
import zlib
from pathlib import Path

import pytest

from wheelsight import simulation

FOLDER = Path(simulation.__file__).parent
CHECKSUM = re.compile(r"^_COMPILED_IN = .*\n", re.MULTILINE)
IMPORT = re.compile(r"^from wheelsight\.simulation\.(_\w+_kernels) import", re.MULTILINE)


def imported(module: str) -> set[str]:
    """The kernel files that a kernel file imports, and those that they import."""
    direct = set(IMPORT.findall((FOLDER / f"{module}.py").read_text(encoding="utf-8")))
    return direct.union(*(imported(name) for name in direct))


def checksum(modules: set[str]) -> int:
    texts = [CHECKSUM.sub("", (FOLDER / f"{name}.py").read_text(encoding="utf-8")) for name in sorted(modules)]
    return zlib.crc32("".join(texts).encode())


MODULES = sorted(path.stem for path in FOLDER.glob("_*_kernels.py") if imported(path.stem))


def test_the_painter_is_made_of_all_files() -> None:
    assert imported("_paint_kernels") >= {"_light_kernels", "_picture_kernels", "_texture_kernels", "_wall_kernels"}


@pytest.mark.parametrize("module", MODULES)
def test_a_file_changes_with_what_it_compiles_in(module: str) -> None:
    line = f"_COMPILED_IN = 0x{checksum(imported(module)):08X}"
    text = (FOLDER / f"{module}.py").read_text(encoding="utf-8")
    assert f"\n{line}\n" in text, f"{module}.py compiles in kernels that have changed: let it say {line}"
