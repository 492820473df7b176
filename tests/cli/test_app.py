from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, cast

import pytest
import typer
from typer import Context
from typer.core import TyperGroup
from typer.main import get_command
from typer.testing import CliRunner, Result

from wheelsight import __version__
from wheelsight.app.cli import app
from wheelsight.app.cli.console import laid_out, takes

Command = Callable[..., Result]

HEAVY = {"cv2", "numba", "numpy", "plotly", "pydantic", "scipy", "yaml"}


def python(code: str, **environment: str) -> str:
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ | environment
    )
    return answer.stdout


def test_help_names_every_command_and_loads_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "from wheelsight.app.cli import app\n"
        "app(['--help'], standalone_mode=False)\n"
        "print('loaded:', *sys.modules)\n"
    )
    answer = python(code)
    for command in registered_commands():
        assert f" {command} " in answer
    loaded = {name.split(".")[0] for name in answer.split("loaded: ")[1].split()}
    assert loaded & HEAVY == set()


GROUP = cast(TyperGroup, get_command(app))


def registered_commands() -> list[str]:
    return GROUP.list_commands(Context(GROUP))


def all_commands() -> list[str]:
    """Also those of groups, such as "map info"."""
    found = []
    for name in registered_commands():
        below = GROUP.commands[name]
        found += [f"{name} {inner}" for inner in below.commands] if isinstance(below, TyperGroup) else [name]
    return found


def page_of(wheelsight: Command, monkeypatch: pytest.MonkeyPatch, command: str, columns: int = 80) -> list[str]:
    monkeypatch.setattr("typer.rich_utils.MAX_WIDTH", columns)
    result = wheelsight(*command.split(), "--help")
    assert result.exit_code == 0, result.output
    return result.output.splitlines()


def test_commands_stand_in_groups_a_line_each(wheelsight: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = page_of(wheelsight, monkeypatch, "")
    panels = [line.strip("╭╮─ ") for line in lines if line.startswith("╭")]
    assert panels == [
        *("Options", "Run and look", "Record", "Calibrate", "Maps", "Drive", "Many recordings", "Set up"),
    ]
    inside = lines[lines.index(next(line for line in lines if "Run and look" in line)) :]
    rows = [line for line in inside if line.startswith("│")]
    assert [row.split()[1] for row in rows] == registered_commands()


@pytest.mark.parametrize("command", all_commands())
def test_help_of_each_command_fits_80_columns_and_shows_examples(
    wheelsight: Command, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    lines = page_of(wheelsight, monkeypatch, command)
    assert max(map(len, lines)) <= 80
    assert "…" not in "".join(lines)
    assert "<bool>" not in "".join(lines)
    examples = lines[[line.strip() for line in lines].index("Examples") + 1 :]
    assert examples[0].startswith(f" $ wheelsight {command}")


@pytest.mark.parametrize("command", ["run", "simulate", "drive", "serve", "record", "batch"])
def test_long_help_stands_in_panels(wheelsight: Command, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    """None so long that one has to search it."""
    lines = page_of(wheelsight, monkeypatch, command)
    sizes, panel = dict[str, int](), ""
    for line in lines:
        if line.startswith("╭"):
            panel = line.strip("╭╮─ ")
        elif re.match(r"│ [* ]*(--|[A-Z])", line):
            sizes[panel] = sizes.get(panel, 0) + 1
    assert len(sizes) >= 3
    assert "Output" in sizes
    assert max(sizes.values()) <= 11


def test_paragraphs_are_as_wide_as_the_terminal() -> None:
    reported = """What it does.

    One line
    and another.

    [bold]Examples[/bold]

    wheelsight one

    wheelsight two --long
    """
    shown = "What it does.\n\nOne line and another.\n\n[bold]Examples[/bold]\n$ wheelsight one\n$ wheelsight two --long"
    assert laid_out(reported) == shown


def test_a_commands_options_are_the_fields_of_a_class() -> None:
    @dataclass(frozen=True)
    class Asked:
        name: str
        times: Annotated[int, typer.Option("--times", min=1)] = 2

    said = []

    @takes(Asked)
    def greet(asked: Asked) -> None:
        said.append(asked)

    single = typer.Typer()
    single.command()(greet)
    assert CliRunner().invoke(single, ["you", "--times", "3"]).exit_code == 0
    assert CliRunner().invoke(single, ["you"]).exit_code == 0
    assert CliRunner().invoke(single, ["you", "--times", "0"]).exit_code == 2
    assert said == [Asked("you", 3), Asked("you")]


def test_compiled_kernels_that_can_be_kept_nowhere_are_reported_in_one_line(room: Path, tmp_path: Path) -> None:
    """As for a user without a home of its own, who may not write into the installed package."""
    code = (
        "from numba.core import caching\n"
        "caching.CompileResultCacheImpl._locator_classes = []\n"
        "from wheelsight.app.cli import main\n"
        "main()\n"
    )
    command = [sys.executable, "-c", code, "run", str(room), "--out", str(tmp_path / "out")]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 2
    assert answer.stderr == (
        "error: no folder can keep the compiled kernels (set NUMBA_CACHE_DIR to one that you may write to)\n"
    )


def test_version(wheelsight: Command) -> None:
    assert wheelsight("--version").output == f"wheelsight {__version__}\n"


def test_wrong_arguments_give_usage(wheelsight: Command) -> None:
    for wrong in (["fly"], ["run"], ["run", "somewhere"], ["info", "x", "--nothing"], ["evaluate", "x"]):
        result = wheelsight(*wrong)
        assert result.exit_code == 2
        assert "Usage:" in result.stderr


def test_a_bug_keeps_its_traceback(wheelsight: Command, monkeypatch: pytest.MonkeyPatch, room: Path) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("wheelsight.io.recordings.open_recording", broken)
    result = wheelsight("info", room)
    assert isinstance(result.exception, ZeroDivisionError)


def test_errors_stay_on_one_line_in_a_narrow_terminal_and_hold_no_control_characters(tmp_path: Path) -> None:
    folder = tmp_path / ("a long name with [brackets] " * 3)
    answer = subprocess.run(
        [sys.executable, "-m", "wheelsight", "info", str(folder)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"COLUMNS": "40", "TERM": "xterm-256color"},
    )
    assert answer.returncode == 2
    assert answer.stderr == f"error: {folder}: there is no such folder (check the path)\n"
