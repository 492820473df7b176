"""Kernels on the disk follow every file that they are made of, and are compiled no more often than that."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
from numba import types

from wheelsight.core.compiled import kernel, made_of

LOW = """
from wheelsight.core.compiled import kernel
from area._numbers import FACTOR

@kernel
def scaled(x: float) -> float:
    return FACTOR * x
"""
HIGH = """
from wheelsight.core.compiled import kernel
{imports}

@kernel(error_model="numpy")
def twice(x: float) -> float:
    return {call}(x) + {call}(x)
"""
RUN = """
from area._high_kernels import twice
print(twice(1.5), sum(twice.stats.cache_hits.values()), twice.stats.cache_path)
"""
DIE_BEFORE_IT_IS_KEPT = """
import os
from numba.core.caching import Cache
Cache.save_overload = lambda *_: os._exit(3)
"""
WAYS = {
    "a name": ("from area._low_kernels import scaled", "scaled"),
    "names on lines of their own": (
        "from area._low_kernels import (  # two (of them)\n FACTOR,\n scaled as s,\n)",
        "s",
    ),
    "a module by another name": ("import area._low_kernels as low", "low.scaled"),
    "a module of the package": ("from area import _low_kernels as low", "low.scaled"),
    "a name that the package hands on": ("from area import scaled", "scaled"),
}


class Area:
    """A small package with kernels in two files, and a number in a third."""

    def __init__(self, root: Path) -> None:
        self.folder = root / "area"
        self.folder.mkdir()
        self.write("__init__", "from area._low_kernels import scaled\n")
        self.write("_numbers", "FACTOR = 2.0\n")
        self.write("_low_kernels", LOW)
        self.import_by("a name")

    def write(self, module: str, text: str) -> None:
        (self.folder / f"{module}.py").write_text(text)

    def import_by(self, way: str) -> None:
        imports, call = WAYS[way]
        self.write("_high_kernels", HIGH.format(imports=imports, call=call))

    def start(self, code: str = RUN, **environment: str) -> subprocess.Popen[str]:
        """A process of its own; without Python's own caches, which know the second of a change alone."""
        path = os.pathsep.join([str(self.folder.parent), *sys.path])
        reported = os.environ | {"PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"} | environment
        command = [sys.executable, "-c", code]
        return subprocess.Popen(command, env=reported, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def run(self, **environment: str) -> tuple[float, int, Path]:
        """What twice(1.5) is, how many of its compiled forms were on the disk, and where."""
        return outcome(self.start(**environment))


def outcome(process: subprocess.Popen[str]) -> tuple[float, int, Path]:
    reported, problem = process.communicate(timeout=120)
    assert process.returncode == 0, problem
    value, hits, folder = reported.split()
    return float(value), int(hits), Path(folder)


@pytest.fixture
def area(tmp_path: Path) -> Area:
    return Area(tmp_path)


@pytest.fixture
def forgotten() -> Iterator[None]:
    """Takes a test's package out of this process again."""
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] == "area"]:
        del sys.modules[name]


@pytest.mark.usefixtures("forgotten")
@pytest.mark.parametrize("way", WAYS)
def test_each_way_to_import_is_followed(area: Area, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str) -> None:
    area.import_by(way)
    monkeypatch.syspath_prepend(tmp_path)
    import_module("area._high_kernels")
    handed_on = {"area"} if way == "a name that the package hands on" else set()
    assert made_of("area._high_kernels") - handed_on == {
        "area._high_kernels",
        "area._low_kernels",
        "area._numbers",
        "wheelsight.core.compiled",
    }


@pytest.mark.parametrize("cut", [False, True])
def test_an_index_that_cannot_be_read_is_made_again(area: Area, cut: bool) -> None:
    """Of a class that has been renamed, or of a write that was cut off."""
    _, _, folder = area.run()
    for index in folder.glob("*.nbi"):
        data = index.read_bytes()
        version = pickle.dumps(pickle.loads(data), protocol=4)
        index.write_bytes(data[: len(data) // 2] if cut else version + b"carea._numbers\nGone\n.")
    assert area.run()[:2] == (6.0, 0)
    assert area.run()[:2] == (6.0, 1)


def test_each_change_is_used_and_one_elsewhere_compiles_nothing_again(area: Area) -> None:
    """A start of Python and a compilation take a second: one package goes through all changes."""
    assert area.run()[:2] == (6.0, 0)
    area.write("__init__", "from area._low_kernels import scaled\n\nOTHER = 1\n")
    area.write("_other_kernels", LOW)
    (area.folder / "_low_kernels.py").touch()
    assert area.run()[:2] == (6.0, 1)
    area.write("_low_kernels", LOW.replace("FACTOR * x", "FACTOR * x + 1.0"))
    assert area.run()[:2] == (8.0, 0)
    area.write("_numbers", "FACTOR = 3.0\n")
    assert area.run()[:2] == (11.0, 0)


def test_what_may_not_stand_beside_its_file_stands_in_the_users_cache(area: Area, tmp_path: Path) -> None:
    (area.folder / "__pycache__").write_text("a file, so that no folder can be made here")
    environment = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "HOME": str(tmp_path), "NUMBA_CACHE_DIR": ""}
    _, hits, folder = area.run(**environment)
    assert hits == 0
    assert tmp_path / "cache" in folder.parents
    assert area.run(**environment)[:2] == (6.0, 1)


@pytest.mark.slow
def test_of_processes_that_start_at_once_one_compiles_and_the_others_wait(area: Area) -> None:
    reported = [outcome(process)[:2] for process in [area.start(), area.start(), area.start()]]
    assert sorted(reported) == [(6.0, 0), (6.0, 1), (6.0, 1)]


@pytest.mark.slow
def test_a_process_that_dies_while_it_compiles_holds_no_one_up(area: Area) -> None:
    dying = area.start(DIE_BEFORE_IT_IS_KEPT + RUN)
    dying.communicate(timeout=120)
    assert dying.returncode == 3
    assert area.run()[:2] == (6.0, 0)


def test_nothing_is_compiled_where_numba_is_reported(area: Area) -> None:
    process = area.start("from area import scaled; print(type(scaled).__name__)", NUMBA_DISABLE_JIT="1")
    assert process.communicate()[0] == "function\n"


def test_a_kernel_keeps_the_options_of_numba() -> None:
    @kernel
    def stops(x: float) -> float:
        return 1.0 / x

    @kernel(error_model="numpy")
    def goes_on(x: float) -> float:
        return 1.0 / x

    with pytest.raises(ZeroDivisionError):
        stops(0.0)
    assert goes_on(0.0) == float("inf")


def test_numbers_that_other_kernels_write_out_compile_it_once() -> None:
    """Numba's literal types: one function of the simulator was compiled 29 times."""

    @kernel
    def doubled(x: int) -> int:
        return 2 * x

    for number in (1, 2, 3):
        doubled.get_call_template((types.literal(number),), {})  # type: ignore[attr-defined]
    assert list(doubled.overloads) == [(types.int64,)]  # type: ignore[attr-defined]
