"""Kernels that numba has cached must not outlive the kernels of other files that were compiled into them.

Numba keeps a compiled function until the text of its own file changes, whatever its file imports. So each file that
imports kernels carries a checksum of all that it compiles in: after a change below, its text must change too.
"""

from __future__ import annotations

import re
import zlib
from pathlib import Path

import pytest

import wheelsight

PACKAGE = Path(wheelsight.__file__).parent
CHECKSUM = re.compile(r"^_COMPILED_IN = .*\n", re.MULTILINE)
IMPORT = re.compile(r"^from wheelsight((?:\.\w+)*\.\w*kernels) import", re.MULTILINE)


def imported(path: Path) -> set[Path]:
    """The kernel files that a kernel file imports, and those that they import."""
    names = IMPORT.findall(path.read_text(encoding="utf-8"))
    direct = {PACKAGE.joinpath(*name.strip(".").split(".")).with_suffix(".py") for name in names}
    return direct.union(*map(imported, direct))


def checksum(paths: set[Path]) -> int:
    texts = [CHECKSUM.sub("", path.read_text(encoding="utf-8")) for path in sorted(paths)]
    return zlib.crc32("".join(texts).encode())


FILES = sorted(path for path in PACKAGE.rglob("_*kernels.py") if imported(path))


def test_the_painter_is_made_of_all_files() -> None:
    names = {path.stem for path in imported(PACKAGE / "simulation" / "_paint_kernels.py")}
    assert names >= {"_light_kernels", "_picture_kernels", "_texture_kernels", "_wall_kernels"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_a_file_changes_with_what_it_compiles_in(path: Path) -> None:
    line = f"_COMPILED_IN = 0x{checksum(imported(path)):08X}"
    text = path.read_text(encoding="utf-8")
    assert f"\n{line}\n" in text, f"{path.name} compiles in kernels that have changed: let it say {line}"
