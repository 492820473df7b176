"""`wheelsight run --realtime`, with wheels of the recording, of a file, a pipe and a port."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from room_drive import make_room_drive
from stand_ins import MemoryRecording
from typer.testing import Result

from wheelsight.app.cli.run import played, words
from wheelsight.app.run import RealTimeRecording
from wheelsight.core.settings import RealTimeSettings
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.recordings import open_recording

Command = Callable[..., Result]
Refusal = Callable[..., str]
JOINED = ("--realtime", "--odometry", "wheels,features")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 2.3 s."""
    folder = tmp_path_factory.mktemp("recordings") / "drive"
    make_room_drive(folder, frames=4)
    return folder


def metrics_in(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "metrics.json").read_text())


def test_a_recording_takes_as_long_as_it_took_and_says_how_that_went(
    wheelsight: Command, drive: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    result = wheelsight("run", drive, *JOINED, "--out", out)
    assert result.exit_code == 0, result.output
    recording, metrics = open_recording(drive), metrics_in(out)
    played = metrics["realtime"]
    assert played["frames"] == recording.frame_count
    assert played["readings"] == recording.wheel_count
    assert played["played_s"] > 2.2
    assert list(metrics["odometry"]) == ["wheels", "joined"]
    assert metrics["odometry"]["joined"]["frames"]["processed"] == played["frames"] - played["dropped"]
    assert metrics["odometry"]["wheels"]["wheel_readings"]["processed"] == recording.wheel_count
    assert (out / "joined" / "trajectory.txt").is_file()
    (line,) = (line for line in result.stdout.splitlines() if line.strip().startswith("Played in real time: "))
    assert metrics["odometry"]["joined"]["frames"]["dropped"]["overtaken"] == played["dropped"]
    assert f"latency {played['latency_median_ms']:.0f} ms median" in line


@pytest.mark.slow
def test_a_terminal_sees_how_it_keeps_up(
    wheelsight: Command, drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "160")
    result = wheelsight("run", drive, "--realtime", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert " frames/s " in result.stderr
    assert " ms late, " in result.stderr
    assert " dropped" in result.stderr
    frames = open_recording(drive).frame_count
    assert f"/{frames}" in result.stderr


def test_wheels_alone_are_played_too(
    wheelsight: Command, drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "160")
    result = wheelsight("run", drive, "--realtime", "--odometry", "wheels", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "readings/s answered, latency " in result.stdout
    count = open_recording(drive).wheel_count
    assert f"{count}/{count}" in result.stderr
    played = metrics_in(tmp_path / "out")["realtime"]
    assert (played["readings"], played["frames"]) == (count, 0)


@pytest.mark.slow
def test_wheels_of_a_file_take_the_place_of_the_recordings(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    lines = (drive / "wheels.csv").read_text().splitlines()
    (tmp_path / "half.csv").write_text("\n".join([lines[0], *lines[1::2]]) + "\n")
    result = wheelsight("run", drive, *JOINED, "--wheels-from", tmp_path / "half.csv", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    played = metrics_in(tmp_path / "out")["realtime"]
    assert played["wheels_from"] == str(tmp_path / "half.csv")
    assert played["readings"] == len(lines[1::2])


def test_wheels_from_a_port(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    # The controller's thread is of this process, and silent while that compiles kernels.
    assert wheelsight("run", drive, *JOINED[1:], "--out", tmp_path / "before").exit_code == 0
    with SimulatedController(tmp_path) as controller:
        controller.speeds = (30, 30)
        result = wheelsight("run", drive, *JOINED, "--wheels-from", controller.port, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    metrics = metrics_in(tmp_path / "out")
    assert metrics["realtime"]["wheels_from"] == str(controller.port)
    assert metrics["odometry"]["wheels"]["trajectory"]["length_m"] > 0.5
    assert "fell silent" not in result.stderr


def test_wheels_that_cannot_be_had_are_refused(refusal: Refusal, drive: Path, wheels: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "out")
    assert refusal("run", drive, "--odometry", "wheels,features", "--wheels-from", "x", *out) == (
        "--wheels-from joins wheels that turn just now (add --realtime)"
    )
    assert refusal("run", drive, *JOINED, "--baud", 9600, *out) == (
        "--baud is the rate of a port (add --wheels-from PORT)"
    )
    port = tmp_path / "ttyNONE"
    assert refusal("run", drive, *JOINED, "--wheels-from", port, *out).startswith(f"{port}: there is no such port (")
    assert "wheels.csv: is missing" in refusal("run", drive, *JOINED, "--wheels-from", tmp_path, *out)
    (tmp_path / "other.csv").write_text("stamp_s,left,right\n5,0,0\n6,0,0\n")
    said = refusal("run", drive, *JOINED, "--wheels-from", tmp_path / "other.csv", *out)
    assert "its readings are of 5.000 s to 6.000 s, the images of " in said
    assert said.endswith("(both must be stamped by one clock)")
    alone = ("--realtime", "--odometry", "wheels", "--wheels-from", drive)
    assert refusal("run", drive, *alone, *out).endswith("are played beside a camera (--odometry wheels,dense)")
    assert "has no images to play beside the wheels" in refusal("run", wheels, *alone, *out)
    assert not (tmp_path / "out").exists()


def test_what_the_bar_says_before_anything_was_answered() -> None:
    assert words(RealTimeRecording(MemoryRecording([]))) == ""


def test_it_is_played_by_the_settings_of_the_run() -> None:
    settings = RealTimeSettings(dropped_share=0.5)
    with played(MemoryRecording([]), True, None, None, settings) as source:
        assert isinstance(source, RealTimeRecording)
        assert source.settings is settings
