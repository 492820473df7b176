"""The same ticks from a port, a pipe, or a file."""

from __future__ import annotations

import itertools
import os
import threading
from pathlib import Path

import pytest

from wheelsight.app.telemetry import Telemetry
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import DeviceError, RecordingError
from wheelsight.core.messages import WheelTicks
from wheelsight.io.devices import TelemetryPipe, TelemetryReader, TicksFile, WheelLink, open_wheels
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.recordings import RecordingWriter

WHEELS = Wheels(0.17, 0.17, 0.6, 3200.0, counter_bits=32)
TICKS = [WheelTicks(1e9 + 0.02 * n, 100 * n, -50 * n) for n in range(50)]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    with RecordingWriter(tmp_path / "recording", None) as writer:
        for ticks in TICKS:
            writer.add(ticks)
    return tmp_path / "recording"


def test_a_recording_and_its_file(recording: Path) -> None:
    for where in (recording, recording / "wheels.csv"):
        source = open_wheels(where)
        assert isinstance(source, TicksFile)
        assert list(source.ticks()) == TICKS
    source = open_wheels(recording)
    ticks = source.ticks()
    next(ticks)
    source.close()
    assert list(ticks) == []


def test_a_file_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"wheels.csv: is missing"):
        open_wheels(tmp_path / "wheels.csv")
    (tmp_path / "notes").write_text("some text\n")
    with pytest.raises(RecordingError, match="notes:1"):
        open_wheels(tmp_path / "notes")


def test_a_port(tmp_path: Path) -> None:
    with SimulatedController(tmp_path) as controller:
        source = open_wheels(controller.port)
        assert isinstance(source, WheelLink)
        gathered = list(itertools.islice(source.ticks(), 5))
        source.close()
    assert len(gathered) == 5
    with pytest.raises(DeviceError, match="there is no such port"):
        open_wheels(tmp_path / "ttyNONE")


def test_a_pipe_gives_the_very_ticks_and_ends_with_the_daemon(tmp_path: Path) -> None:
    telemetry = Telemetry(WHEELS)
    with TelemetryPipe(tmp_path / "wheels") as pipe:
        source = open_wheels(pipe.path)
        assert isinstance(source, TelemetryReader)
        for ticks in TICKS:
            pipe.send(telemetry.line(ticks))
    assert list(source.ticks()) == TICKS
    source.close()


def test_a_pipe_is_waited_for_and_can_be_left(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "wheels")
    source = open_wheels(tmp_path / "wheels")
    reported: list[str] = []

    def leave() -> None:
        reported.append("left")
        source.close()

    threading.Timer(0.2, leave).start()
    assert list(source.ticks()) == []
    assert reported == ["left"]  # not before


def test_a_line_without_end_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    source = open_wheels(tmp_path / "pipe")
    with (tmp_path / "pipe").open("wb", buffering=0) as writer:
        writer.write(b"x" * 60_000)
        with pytest.raises(DeviceError, match="a line is longer than 4096 bytes"):
            next(iter(source.ticks()))
    source.close()


def test_a_line_begun_by_another_reader_is_passed_over_and_nonsense_is_refused(tmp_path: Path) -> None:
    telemetry = Telemetry(WHEELS)
    with TelemetryPipe(tmp_path / "wheels") as pipe:
        source = open_wheels(pipe.path)
        pipe.send('"yaw_rad":0.1}')
        pipe.send(telemetry.line(TICKS[0]))
        pipe.send("nonsense")
        ticks = source.ticks()
        assert next(ticks) == TICKS[0]
        with pytest.raises(DeviceError, match=r"wheels:3: a line is no telemetry"):
            next(ticks)
        source.close()
