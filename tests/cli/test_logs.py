"""-v, -q and --log of every command."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from synthetic import make_tum_recording
from typer.testing import CliRunner

from wheelsight.app.cli import app

LOGGER = logging.getLogger("wheelsight")


def invoke(*arguments: object) -> tuple[int, str, str]:
    answer = CliRunner().invoke(app, [str(argument) for argument in arguments])
    return answer.exit_code, answer.stdout, answer.stderr


@pytest.fixture
def room(tmp_path: Path) -> Path:
    make_tum_recording(tmp_path / "room", frames=4, covered=(2,))
    return tmp_path / "room"


def test_a_log_holds_status_and_errors_with_times(room: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    code, _, stderr = invoke("run", room, "--out", tmp_path / "out", "--log", log)
    assert code == 0
    assert "INFO" not in stderr
    code, _, _ = invoke("--log", log, "run", tmp_path / "nowhere", "--out", tmp_path / "none")
    assert code == 2
    lines = log.read_text().splitlines()
    assert any("INFO wheelsight.estimation" in line and "dense is tracking, was initializing" in line for line in lines)
    assert any("INFO wheelsight.app.run.runs: room, dense: 3 poses; 4 frames" in line for line in lines)
    assert any("ERROR wheelsight.app.cli" in line and "nowhere" in line for line in lines)
    assert all(line[:4].isdigit() for line in lines)


def test_verbose_shows_events_and_more_of_it_frames_too(room: Path, tmp_path: Path) -> None:
    once = invoke("run", room, "--out", tmp_path / "once", "-v")[2]
    assert "INFO: 100.000 s: dense is tracking, was initializing" in once
    assert "DEBUG" not in once
    twice = invoke("run", room, "--out", tmp_path / "twice", "-v", "--verbose", "--odometry", "features")[2]
    assert "features is " in twice


def test_quiet_leaves_notes_out_and_keeps_results_and_errors(room: Path, tmp_path: Path) -> None:
    loud, quiet = (invoke("run", room, "--out", tmp_path / name, *more) for name, more in (("l", ()), ("q", ("-q",))))
    assert "the camera is followed by all pixels" in loud[2]
    assert quiet[2] == ""
    assert "3 of 4 with a pose" in quiet[1]
    code, _, stderr = invoke("-q", "run", tmp_path / "nowhere", "--out", tmp_path / "none")
    assert (code, stderr.startswith("error: ")) == (2, True)


def test_nothing_of_it_stays_after_the_command(room: Path, tmp_path: Path) -> None:
    before = list(LOGGER.handlers), LOGGER.level
    invoke("-v", "-q", "info", room, "--log", tmp_path / "x.log")
    assert (list(LOGGER.handlers), LOGGER.level) == before
    assert any(isinstance(handler, logging.NullHandler) for handler in LOGGER.handlers)
    assert "the camera is followed" in invoke("run", room, "--out", tmp_path / "out")[2]


def test_a_log_that_cannot_be_written_is_an_error_in_a_line(room: Path, tmp_path: Path) -> None:
    code, _, stderr = invoke("info", room, "--log", tmp_path / "no" / "x.log")
    assert code == 2
    assert stderr.count("\n") == 1
    assert "x.log: no log can be written: No such file or directory (--log FILE)" in stderr
