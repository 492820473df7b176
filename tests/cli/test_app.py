from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import Result

from wheelsight import __version__

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
        "from wheelsight.cli import app\n"
        "app(['--help'], standalone_mode=False)\n"
        "print('loaded:', *sys.modules)\n"
    )
    answer = python(code)
    for command in ("info", "run", "batch", "evaluate", "export"):
        assert f" {command} " in answer
    loaded = {name.split(".")[0] for name in answer.split("loaded: ")[1].split()}
    assert loaded & HEAVY == set()


@pytest.mark.parametrize("command", ["info", "run", "batch", "evaluate", "export"])
def test_help_of_each_command_shows_an_example(wheelsight: Command, command: str) -> None:
    result = wheelsight(command, "--help")
    assert result.exit_code == 0
    assert f"wheelsight {command} " in result.output.split("Examples")[1]


def test_compiled_kernels_that_can_be_kept_nowhere_are_told_in_one_line(room: Path, tmp_path: Path) -> None:
    """As for a user without a home of its own, who may not write into the installed package."""
    code = (
        "from numba.core import caching\n"
        "caching.CompileResultCacheImpl._locator_classes = []\n"
        "from wheelsight.cli import main\n"
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

    monkeypatch.setattr("wheelsight.recordings.open_recording", broken)
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
