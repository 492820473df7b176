from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from room_drive import make_room_drive
from typer.testing import Result

from wheelsight.config import load_config
from wheelsight.io.recordings import open_recording

Command = Callable[..., Result]


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A sound recording of wheels and images."""
    make_room_drive(tmp_path / "drive", frames=4)
    return tmp_path / "drive"


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_pages")
def test_several_are_summed_up_in_one_row_each(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = wheelsight("run", drive, "--odometry", "wheels,features", "--out", out)
    assert result.exit_code == 0, result.output
    rows = [line.split() for line in result.stdout.splitlines()]
    first_words = [row[0] for row in rows if row]
    assert first_words.count("wheels") == first_words.count("features") == 1
    assert result.stdout.splitlines()[-1] == f"report: {out / 'report.html'}"
    assert (out / "report.html").is_file()
    assert (out / "features" / "trajectory.txt").is_file()


@pytest.mark.slow
def test_a_terminal_sees_all_events_pass_by(
    wheelsight: Command, drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "140")
    result = wheelsight("run", drive, "--odometry", "wheels,features", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    source = open_recording(drive)
    events = source.wheel_count + source.frame_count
    assert f"{events}/{events}" in result.stderr
    assert "events/s" in result.stderr
    assert "joined tracking, wheels tracking, features tracking" in result.stderr


def test_why_one_was_not_evaluated_stands_below(wheelsight: Command, tmp_path: Path) -> None:
    make_room_drive(tmp_path / "drive", frames=4, mounted=False)
    result = wheelsight("run", tmp_path / "drive", "--odometry", "wheels,features", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "wheelsight calibrate base finds T_base_camera; or --fusion none" in result.output
    names = ("--odometry", "wheels,features", "--fusion", "none")
    result = wheelsight("run", tmp_path / "drive", *names, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "wheels not evaluated: ground truth: a trajectory of 'camera' cannot be converted to 'base'" in result.stdout


def test_unknown_and_doubled_names_are_one_line(refusal: Callable[..., str], drive: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "out")
    assert refusal("run", drive, "--odometry", "wheels,sonar", *out).startswith("--odometry is 'sonar' (known: ")
    assert "names wheels twice (known: " in refusal("run", drive, "--odometry", "wheels,wheels", *out)


def test_what_joining_came_to_is_said(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    result = wheelsight("run", drive, "--odometry", "wheels,features", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    verdict = metrics["verdict"]
    assert metrics["odometry"]["joined"]["verdict"] == verdict
    assert f"\nverdict: {verdict['tone']}, {verdict['phrase']}\n" in result.stdout
    for found in verdict["findings"]:
        said = found["short"] if found["tone"] == "green" else f"{found['sentence']} To do: {found['remedy']}."
        assert said in result.stdout
    assert {"poses", "slip", "doubtful", "degenerate", "coasting", "3σ"} <= {
        one["about"] for one in verdict["findings"]
    }
    assert "Begun at the true start, it ends " in result.stdout
    assert re.search(r"ATE, RMSE \[[mc]?m\]", result.stdout)
    result = wheelsight("run", drive, "--odometry", "wheels,features", "--fusion", "none", "--out", tmp_path / "none")
    assert "slip" not in result.stdout


def test_without_a_name_all_sensors_are_joined(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    result = wheelsight("run", drive, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert result.stderr == "wheels and camera are joined (--odometry wheels,dense; dense: the camera alone)\n"
    assert (tmp_path / "out" / "joined" / "trajectory.txt").is_file()
    assert load_config(tmp_path / "out" / "config.yaml").odometry == ("wheels", "dense")


def test_what_is_not_joined_is_said_in_one_line(wheelsight: Command, tmp_path: Path) -> None:
    make_room_drive(tmp_path / "drive", frames=4, mounted=False)
    result = wheelsight("run", tmp_path / "drive", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    chosen, line = result.stderr.splitlines()
    assert chosen == "the camera is followed by all pixels (--odometry dense; features: by these alone)"
    assert line.startswith("warning: ")
    assert "wheel readings are not used: the calibration has no T_base_camera" in line


def test_a_file_of_settings_names_it_too(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    (tmp_path / "settings.yaml").write_text("odometry: features\n")
    result = wheelsight("run", drive, "--config", tmp_path / "settings.yaml", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "trajectory.txt").is_file()
