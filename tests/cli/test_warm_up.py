"""`wheelsight warm-up`, and runs that find nothing compiled: what is said, and that Ctrl-C is answered."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from places.made_recording import write_drive
from typer.testing import Result

from wheelsight.app.cli import compiling as _compiling
from wheelsight.app.run import kernels
from wheelsight.app.run.kernels import PartCost, floor_map
from wheelsight.core.errors import OutputError
from wheelsight.mapping import save_map

Command = Callable[..., Result]
UNSURE = ", more on a slow or busy computer"


@pytest.fixture
def cold(monkeypatch: pytest.MonkeyPatch) -> list[Sequence[str]]:
    """Nothing is compiled; gives what was asked to be."""
    asked: list[Sequence[str]] = []

    def compile_kernels(parts: Sequence[str], on_kernel: Callable[[str, int], None]) -> None:
        asked.append(parts)
        on_kernel(parts[-1], 41)

    monkeypatch.setattr(kernels, "missing_parts", lambda parts: tuple(parts))
    monkeypatch.setattr(kernels, "compile_kernels", compile_kernels)
    monkeypatch.setattr(kernels, "remembered_costs", dict)
    monkeypatch.setattr(kernels, "COSTS", {part: PartCost(40, 30.0) for part in kernels.PARTS})
    return asked


def test_all_is_compiled_and_said_in_plain_lines(wheelsight: Command, cold: list[Sequence[str]]) -> None:
    result = wheelsight("warm-up")
    assert result.exit_code == 0, result.output
    assert cold == [kernels.usable_parts()]
    begun, done = result.stderr.splitlines()
    minutes = round(len(kernels.usable_parts()) / 2)
    assert begun == f"compiling kernels, once after installation: about {minutes} minutes{UNSURE}"
    assert done.startswith("compiled 41 kernels in ")


def test_what_this_computer_took_before_is_said(
    wheelsight: Command, cold: list[Sequence[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = kernels.usable_parts()
    monkeypatch.setattr(kernels, "remembered_costs", lambda: {part: PartCost(40, 120.0 / len(parts)) for part in parts})
    begun = wheelsight("warm-up").stderr.splitlines()[0]
    assert begun == "compiling kernels, once after installation: about 2 minutes, as measured here before"


def test_a_slow_computer_is_said_as_it_goes(
    wheelsight: Command, cold: list[Sequence[str]], wheels: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of the kernels take twice as long as was said for all of them; later ones as long as is said then."""
    clock_s = [1000.0]

    def compile_kernels(parts: Sequence[str], on_kernel: Callable[[str, int], None]) -> None:
        for kernel, seconds in ((0, 0.0), (20, 60.0), (40, 60.0)):
            clock_s[0] += seconds
            on_kernel(parts[-1], kernel)

    monkeypatch.setattr(kernels, "compile_kernels", compile_kernels)
    monkeypatch.setattr(_compiling, "time", SimpleNamespace(monotonic=lambda: clock_s[0]))
    result = wheelsight("run", wheels, "--odometry", "wheels", "--out", tmp_path / "out")
    said, longer, done = [line for line in result.stderr.splitlines() if "compile" in line or "compiling" in line]
    assert "about 30 seconds" in said
    assert longer == "this computer compiles more slowly than was said: about 40 seconds more"
    assert done == "compiled 40 kernels in 120 s"


def test_a_terminal_sees_how_far_it_is(cold: list[Sequence[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []

    def compile_kernels(parts: Sequence[str], on_kernel: Callable[[str, int], None]) -> None:
        for number, part in enumerate(parts):
            for kernel in (0, 20, 40, 50):
                on_kernel(part, 50 * number + kernel)

    class Console:
        def status(self, text: str) -> AbstractContextManager[Any]:
            return nullcontext(SimpleNamespace(update=shown.append))

    monkeypatch.setattr(kernels, "compile_kernels", compile_kernels)
    monkeypatch.setattr(_compiling, "console", lambda stderr: Console())
    clock_s = count(0.0, 7.5)  # as fast as was said
    monkeypatch.setattr(_compiling, "time", SimpleNamespace(monotonic=lambda: next(clock_s)))
    parts = ("wheels", "navigation")
    assert _compiling.compile_ahead(parts) == 100
    assert shown[1] == "wheels 1/2, kernel 20/40, 0:15, about 0:45 left"
    assert shown[3] == "wheels 1/2, kernel 50, 0:30, about 0:30 left"
    assert shown[5].startswith("navigation 2/2, kernel 20/40, 0:45, about 0:15 left")
    assert max(map(len, shown)) < 58  # with the spinner, on 60 columns


def test_what_is_compiled_is_not_compiled_again(wheelsight: Command) -> None:
    result = wheelsight("warm-up")
    assert (result.exit_code, result.stdout, result.stderr) == (0, "all kernels are compiled\n", "")


def test_a_run_says_so_before_it_begins(
    wheelsight: Command, cold: list[Sequence[str]], wheels: Path, tmp_path: Path
) -> None:
    result = wheelsight("run", wheels, "--odometry", "wheels", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert cold == [("wheels",)]
    assert result.stderr.splitlines()[0] == f"compiling kernels, once after installation: about 30 seconds{UNSURE}"
    assert (tmp_path / "out" / "report.html").is_file()


def test_a_simulation_says_so_before_it_renders(wheelsight: Command, cold: list[Sequence[str]], tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = wheelsight("simulate", "square", "--duration", 1, "--rate", 2, "--size", "32x24", "--out", out)
    assert result.exit_code == 0, result.output
    assert cold == [("simulation",)]
    assert f"compiling kernels, once after installation: about 30 seconds{UNSURE}" in result.stderr
    assert (out / "plan.png").is_file()


def test_models_of_places_say_so_before_they_look(
    wheelsight: Command, cold: list[Sequence[str]], tmp_path: Path
) -> None:
    drive, model = tmp_path / "drive", tmp_path / "floor.places"
    write_drive(drive, with_labels=True)
    for command in (
        ("train", drive, "--description", "histograms", "--out", model),
        ("test", model, drive),
        ("predict", model, drive, "--out", tmp_path / "p.csv"),
    ):
        cold.clear()
        result = wheelsight("places", *command)
        assert result.exit_code == 0, result.output
        assert cold == [("places",)]
        assert f"compiling kernels, once after installation: about 30 seconds{UNSURE}" in result.stderr


def test_a_mesh_says_so_before_it_is_made(wheelsight: Command, cold: list[Sequence[str]], tmp_path: Path) -> None:
    pytest.importorskip("skimage")
    save_map(floor_map(), tmp_path / "map.surfels")
    result = wheelsight("export", tmp_path / "map.surfels", "--mesh")
    assert result.exit_code == 0, result.output
    assert cold == [("mesh",)]
    assert (tmp_path / "mesh.ply").is_file()


def test_ctrl_c_leaves_nothing_half_done(
    wheelsight: Command,
    cold: list[Sequence[str]],
    wheels: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(kernels, "compile_kernels", interrupt)
    result = wheelsight("run", wheels, "--odometry", "wheels", "--out", tmp_path / "out")
    assert result.exit_code == 130
    assert result.stderr.splitlines()[-1].startswith("interrupted while compiling; ")
    assert list((tmp_path / "out").iterdir()) == []


def test_a_run_goes_on_where_nothing_can_be_compiled_ahead(
    wheelsight: Command, cold: list[Sequence[str]], wheels: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OutputError("kernels could not be compiled: no room")

    monkeypatch.setattr(kernels, "compile_kernels", fail)
    result = wheelsight("run", wheels, "--odometry", "wheels", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "warning: kernels could not be compiled: no room" in result.stderr
    assert wheelsight("warm-up").exit_code == 2
