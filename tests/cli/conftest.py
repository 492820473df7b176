from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from synthetic import make_tum_recording
from typer.testing import CliRunner, Result

from wheelsight.cli import app


@pytest.fixture
def wheelsight() -> Callable[..., Result]:
    """Runs a command in this process: wheelsight("info", folder)."""
    return lambda *arguments: CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def refusal(wheelsight: Callable[..., Result]) -> Callable[..., str]:
    """Runs a command that must refuse its input with exit code 2 and one line; returns what follows "error: "."""

    def refuse(*arguments: object) -> str:
        result = wheelsight(*arguments)
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        lines = result.stderr.splitlines()
        assert len(lines) == 1, result.stderr
        assert lines[0].startswith("error: ")
        return lines[0].removeprefix("error: ")

    return refuse


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """A sound recording of ten frames."""
    folder = tmp_path / "room"
    make_tum_recording(folder, frames=10)
    return folder
