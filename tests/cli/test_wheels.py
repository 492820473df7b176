"""`wheels monitor` and `wheels serve` on a simulated controller, and every bad input in one line."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path

import pytest
from typer.testing import Result

from wheelsight.app.cli.wheels import Meter, live_line
from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.messages import WheelTicks
from wheelsight.io.devices import WheelLink, open_wheels
from wheelsight.io.devices.simulated_controller import SimulatedController

Command = Callable[..., Result]
Refusal = Callable[..., str]
WHEELS = Wheels(0.17, 0.17, 0.6, 3200.0, counter_bits=32)
M_PER_TICK = 2 * 3.141592653589793 * 0.17 / 3200


@pytest.fixture
def controller(tmp_path: Path) -> Iterator[SimulatedController]:
    with SimulatedController(tmp_path) as simulated:
        yield simulated


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    path = tmp_path / "robot.yaml"
    save_calibration(Calibration(wheels=WHEELS), path)
    return path


class Served:
    """`wheels serve` in a process of its own."""

    def __init__(self, controller: SimulatedController, calibration: Path, pipe: Path) -> None:
        self.pipe = pipe
        arguments = [controller.port, "--pipe", pipe, "--calibration", calibration]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "wheelsight", "wheels", "serve", *map(str, arguments)],
            stderr=subprocess.PIPE,
            text=True,
        )
        ends_s = time.monotonic() + 120
        while not pipe.exists():
            assert self.process.poll() is None
            assert time.monotonic() < ends_s
            time.sleep(0.02)

    def end(self, by: signal.Signals) -> str:
        self.process.send_signal(by)
        _, reported = self.process.communicate(timeout=60)
        return reported


@pytest.fixture
def served(controller: SimulatedController, calibration: Path, tmp_path: Path) -> Iterator[Served]:
    daemon = Served(controller, calibration, tmp_path / "wheels")
    yield daemon
    if daemon.process.poll() is None:
        daemon.end(signal.SIGTERM)


def read_lines(pipe: Path, count: int) -> list[dict[str, float]]:
    """Of a pipe that is opened again where it ends at once: a writer may not have noticed yet that a reader left."""
    lines: list[dict[str, float]] = []
    while len(lines) < count:
        with pipe.open() as stream:
            lines += [json.loads(line) for line in islice(stream, count - len(lines))]
    return lines


@pytest.mark.parametrize("by", [signal.SIGTERM, signal.SIGINT])
def test_serve_shows_poses_and_ends_cleanly(
    controller: SimulatedController, served: Served, by: signal.Signals
) -> None:
    controller.speeds = (60, 60)
    lines = read_lines(served.pipe, 30)
    assert all(after["stamp_s"] > before["stamp_s"] for before, after in pairwise(lines))
    for before, after in pairwise(lines):
        ticks = after["left_ticks"] - before["left_ticks"]
        assert after["x_m"] - before["x_m"] == pytest.approx(ticks * M_PER_TICK)
        passed_s = after["stamp_s"] - before["stamp_s"]
        assert after["v_m_s"] == pytest.approx(ticks * M_PER_TICK / passed_s, rel=1e-3)
    reported = served.end(by)
    assert served.process.returncode == 0
    assert not served.pipe.exists()
    assert "Traceback" not in reported
    assert "lines sent" in reported


@pytest.mark.slow
def test_readers_of_serve_come_and_go(controller: SimulatedController, served: Served) -> None:
    controller.speeds = (10, 20)
    for _ in range(3):
        assert len(read_lines(served.pipe, 5)) == 5
    source = open_wheels(served.pipe)
    ticks = source.ticks()
    assert next(ticks).stamp_s < next(ticks).stamp_s
    source.close()
    assert served.process.poll() is None


@pytest.mark.slow
def test_serve_waits_for_a_port_that_vanished(controller: SimulatedController, served: Served) -> None:
    read_lines(served.pipe, 3)
    controller.unplug()
    time.sleep(0.5)
    controller.left += 100  # pushed by hand
    controller.plug()
    lines = read_lines(served.pipe, 3)
    assert lines[-1]["left_ticks"] == 100
    assert "vanished" in served.end(signal.SIGTERM)


def test_monitor_prints_lines_where_no_terminal_watches(
    wheelsight: Command, controller: SimulatedController, calibration: Path
) -> None:
    controller.speeds = (60, -30)
    result = wheelsight("wheels", "monitor", controller.port, "--seconds", 1.5, "--calibration", calibration)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert "status: connected" in lines[-1]
    assert "format: framed" in lines[-1]
    assert "lost: 0; 0 damaged, 0 garbled, 0 repeated" in lines[-1]
    assert "\x1b" not in result.stdout


@pytest.mark.parametrize(
    ("wheels", "left", "right"),
    [(WHEELS, "+1.001 m/s", "-0.501 m/s"), (None, "+3000.000 ticks/s", "-1500.000 ticks/s")],
)
def test_monitor_shows_the_speeds_between_the_stamps(
    controller: SimulatedController, wheels: Wheels | None, left: str, right: str
) -> None:
    meter = Meter(wheels)
    with WheelLink(str(controller.port)) as link:
        report = link.report()
    line = ""
    for last in (WheelTicks(5.0, 100, 100), WheelTicks(5.2, 700, -200)):
        line = live_line(meter.look(replace(report, last=last)))
    assert f"left: 700 ticks, {left}; right: -200 ticks, {right}" in line


def test_monitor_draws_a_table_for_a_terminal(
    wheelsight: Command, controller: SimulatedController, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    result = wheelsight("wheels", "monitor", controller.port, "--seconds", 1)
    assert result.exit_code == 0, result.output
    for fact in ("status", "format", "left", "right", "frames", "lost", "controller", "port"):
        assert fact in result.stdout
    assert "\x1b[" in result.stdout


def test_a_simulated_controller_is_there_until_it_ends(
    wheelsight: Command, refusal: Refusal, tmp_path: Path, calibration: Path
) -> None:
    port, came = tmp_path / "ttyWHEELS", []

    def listen() -> None:
        ends_s = time.monotonic() + 60
        while not port.exists() and time.monotonic() < ends_s:
            time.sleep(0.01)
        with WheelLink(str(port)) as link:
            came.append(next(link.ticks()))

    listener = threading.Thread(target=listen)
    listener.start()
    result = wheelsight("wheels", "simulate", port, "--motion", "turns", "--calibration", calibration, "--seconds", 3)
    listener.join()
    assert result.exit_code == 0, result.output
    first, second = result.stderr.splitlines()
    assert first == f"{port}: a simulated controller, the framed protocol, until Ctrl-C; in another terminal:"
    assert second == f"wheelsight wheels monitor {port}"
    assert isinstance(came[0], WheelTicks)
    assert not port.is_symlink()
    assert "--motion is 'dance' (lap, turns or none)" in refusal("wheels", "simulate", port, "--motion", "dance")
    assert "exists, and" in refusal("wheels", "simulate", calibration)


def test_monitor_shows_a_wrong_baud_rate(wheelsight: Command, controller: SimulatedController) -> None:
    controller.is_muted = True
    controller.is_noisy = True
    result = wheelsight("wheels", "monitor", controller.port, "--seconds", 1.5)
    assert "noise: wrong baud rate?" in result.stdout.splitlines()[-1]


@pytest.fixture(params=["monitor", "serve", "record"])
def on_port(request: pytest.FixtureRequest, refusal: Refusal, calibration: Path, tmp_path: Path) -> Refusal:
    """A command on a port that must be refused."""
    commands = {
        "monitor": lambda port: ("wheels", "monitor", port),
        "serve": lambda port: ("wheels", "serve", port, "--pipe", tmp_path / "pipe", "--calibration", calibration),
        "record": lambda port: ("record", "--wheels", port, "--out", tmp_path / "out"),
    }
    return lambda port: refusal(*commands[request.param](port))


def test_no_such_port(on_port: Refusal, tmp_path: Path) -> None:
    assert on_port(tmp_path / "tty").startswith(f"{tmp_path / 'tty'}: there is no such port (")


def test_two_programs_on_one_port(on_port: Refusal, controller: SimulatedController) -> None:
    with WheelLink(str(controller.port)):
        expected = f"{controller.port}: the port is in use by another program (end that one first)"
        assert on_port(controller.port) == expected


def test_no_permission(on_port: Refusal, controller: SimulatedController, monkeypatch: pytest.MonkeyPatch) -> None:
    """Anyone who runs the tests may be root, who may open anything; so the system's answer is given for it."""
    open_it = os.open

    def denied(path: str, *rest: int) -> int:
        if str(path) == str(controller.port):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return open_it(path, *rest)

    monkeypatch.setattr(os, "open", denied)
    assert "no permission to open the port (join its group" in on_port(controller.port)


def test_a_port_that_is_a_file(on_port: Refusal, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("text")
    assert on_port(tmp_path / "file").startswith(f"{tmp_path / 'file'}: is not a serial port (")


def test_a_pipe_path_that_is_a_file(
    refusal: Refusal, controller: SimulatedController, calibration: Path, tmp_path: Path
) -> None:
    (tmp_path / "notes").write_text("precious")
    message = refusal("wheels", "serve", controller.port, "--pipe", tmp_path / "notes", "--calibration", calibration)
    assert message == f"{tmp_path / 'notes'}: exists and is not a pipe (choose another path for the pipe)"
    assert (tmp_path / "notes").read_text() == "precious"


def test_a_calibration_that_does_not_serve(refusal: Refusal, controller: SimulatedController, tmp_path: Path) -> None:
    pipe = ("--pipe", tmp_path / "pipe")
    message = refusal("wheels", "serve", controller.port, *pipe, "--calibration", tmp_path / "none.yaml")
    assert message.startswith(f"{tmp_path / 'none.yaml'}: cannot be read")
    (tmp_path / "camera.yaml").write_text(
        "format: wheelsight-calibration-1\ncolor: {width: 64, height: 48, fx: 50, fy: 50, cx: 32, cy: 24}\n"
    )
    message = refusal("wheels", "serve", controller.port, *pipe, "--calibration", tmp_path / "camera.yaml")
    assert message.startswith(f"{tmp_path / 'camera.yaml'}: holds no wheels (")
    (tmp_path / "bad.yaml").write_text(
        "format: wheelsight-calibration-1\n"
        "wheels: {left_radius_m: -0.1, right_radius_m: 0.1, track_width_m: 0.5, ticks_per_turn: 100}\n"
    )
    message = refusal("wheels", "serve", controller.port, *pipe, "--calibration", tmp_path / "bad.yaml")
    assert "left_radius_m is -0.1, not positive" in message
