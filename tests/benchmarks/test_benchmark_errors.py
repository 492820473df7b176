"""Errors that the caller of a benchmark can correct are one line; those of the program keep their trace."""

from __future__ import annotations

import subprocess
import sys

import pytest

import benchmarks
from wheelsight.core.errors import ConfigError


def test_a_world_that_is_not_there_is_one_line() -> None:
    command = [sys.executable, "-m", "benchmarks.exploration", "--flats", "studi"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 1
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: there is no world studi (did you mean studio?")


def test_a_fault_of_the_program_keeps_its_trace(capsys: pytest.CaptureFixture[str]) -> None:
    for error in (ConfigError("a field", fix="mend it"), ZeroDivisionError("by zero")):
        benchmarks.tell(type(error), error, error.__traceback__)
    reported = capsys.readouterr().err.splitlines()
    assert reported == ["error: a field (mend it)", "ZeroDivisionError: by zero"]
