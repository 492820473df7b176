"""`wheelsight warm-up`, and runs that find nothing compiled: what is said, and that Ctrl-C is answered."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from places.made_recording import write_drive
from typer.testing import Result

from wheelsight.errors import OutputError
from wheelsight.mapping import save_map
from wheelsight.pipeline import kernels
from wheelsight.pipeline.rehearsal import floor_map

Command = Callable[..., Result]


@pytest.fixture
def cold(monkeypatch: pytest.MonkeyPatch) -> list[Sequence[str]]:
    """Nothing is compiled; gives what was asked to be."""
    asked: list[Sequence[str]] = []

    def compile_kernels(parts: Sequence[str], on_kernel: Callable[[str, int], None]) -> None:
        asked.append(parts)
        on_kernel(parts[-1], 41)

    monkeypatch.setattr(kernels, "missing_parts", lambda parts: tuple(parts))
    monkeypatch.setattr(kernels, "compile_kernels", compile_kernels)
    return asked


def test_all_is_compiled_and_said_in_plain_lines(wheelsight: Command, cold: list[Sequence[str]]) -> None:
    result = wheelsight("warm-up")
    assert result.exit_code == 0, result.output
    assert cold == [kernels.usable_parts()]
    begun, done = result.stderr.splitlines()
    assert begun == "compiling kernels, once after installation: about 4 minutes"
    assert done.startswith("compiled 41 kernels in ")


def test_what_is_compiled_is_not_compiled_again(wheelsight: Command) -> None:
    result = wheelsight("warm-up")
    assert (result.exit_code, result.stdout, result.stderr) == (0, "all kernels are compiled\n", "")


def test_a_run_says_so_before_it_begins(
    wheelsight: Command, cold: list[Sequence[str]], wheels: Path, tmp_path: Path
) -> None:
    result = wheelsight("run", wheels, "--odometry", "wheels", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert cold == [("wheels",)]
    assert result.stderr.splitlines()[0] == "compiling kernels, once after installation: about 10 seconds"
    assert (tmp_path / "out" / "report.html").is_file()


def test_a_simulation_says_so_before_it_renders(wheelsight: Command, cold: list[Sequence[str]], tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = wheelsight("simulate", "square", "--duration", 1, "--rate", 2, "--size", "32x24", "--out", out)
    assert result.exit_code == 0, result.output
    assert cold == [("simulation",)]
    assert "compiling kernels, once after installation: about 40 seconds" in result.stderr
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
        assert "compiling kernels, once after installation: about 10 seconds" in result.stderr


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
