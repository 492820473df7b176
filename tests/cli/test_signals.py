"""What ends a command, in a process of its own: SIGTERM, SIGHUP, and a terminal that is closed."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import cycle
from pathlib import Path

import pytest
from synthetic import make_tum_recording

from wheelsight.core.runtime import ENDING
from wheelsight.core.trajectory import read_tum
from wheelsight.io.devices import open_wheels
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.devices.wire_formats import LinkCommand
from wheelsight.io.recordings import open_recording

# A command whose localizer takes a tenth of a second for each event, and writes into a file how many it has got.
SLOW_RUN = """
import os, time
from pathlib import Path
from wheelsight.estimation import localizer
process, got = localizer.Localizer.process, []
def counted(self, event):
    got.append(event)
    Path(os.environ["COUNT"]).write_text(str(len(got)))
    time.sleep(0.1)
    return process(self, event)
localizer.Localizer.process = counted
from wheelsight.app.cli import main
main()
"""
# A command that goes on for a minute whatever it is to do.
LONG_COMMAND = """
import time
from wheelsight.app.cli.console import CliCommand
def invoke(self, ctx):
    print("ready", flush=True)
    time.sleep(60)
CliCommand.invoke = invoke
from wheelsight.app.cli import main
main()
"""
LONG_WORDS = {
    "merge": ("map", "merge", "a", "b", "--out", "c"),
    "calibrate": ("calibrate", "wheels", "a", "--out", "b"),
    "train": ("places", "train", "a", "--out", "b"),
    "warm-up": ("warm-up",),
}


@contextmanager
def begun(words: Sequence[object], *, ignores: Sequence[int] = ()) -> Iterator[subprocess.Popen[str]]:
    """A program whose signals do what they do in a terminal, however these tests were started."""

    def as_in_a_terminal() -> None:
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN if number in ignores else signal.SIG_DFL)

    command = [sys.executable, *map(str, words)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, preexec_fn=as_in_a_terminal) as process:
        try:
            yield process
        finally:
            process.kill()


class Terminal:
    """Of its own; it is closed once `close` is called."""

    def __init__(self) -> None:
        self.ours, self.theirs = os.openpty()
        os.set_blocking(self.ours, False)

    def begin(self, words: Sequence[object]) -> subprocess.Popen[bytes]:
        """A program that it controls: closing it sends SIGHUP, and what is written then fails."""

        def controlled() -> None:
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)
            for number in ENDING:
                signal.signal(number, signal.SIG_DFL)

        process = subprocess.Popen(
            [sys.executable, *map(str, words)],
            stdin=self.theirs,
            stdout=self.theirs,
            stderr=self.theirs,
            start_new_session=True,
            preexec_fn=controlled,
            env={**os.environ, "TERM": "xterm-256color"},
        )
        os.close(self.theirs)
        return process

    def read(self) -> bytes:
        with suppress(OSError):
            return os.read(self.ours, 65536)
        return b""

    def close(self) -> None:
        os.close(self.ours)


def until(is_so: Callable[[], bool], process: subprocess.Popen[str] | subprocess.Popen[bytes] | None = None) -> None:
    ends_s = time.monotonic() + 240
    while not is_so():
        assert time.monotonic() < ends_s, "it did not come"
        assert process is None or process.poll() is None, "it ended before"
        time.sleep(0.02)


def rows(recording: Path) -> int:
    path = recording / "wheels.csv"
    return len(path.read_text().splitlines()) - 1 if path.exists() else 0


@pytest.fixture
def controller(tmp_path: Path) -> Iterator[SimulatedController]:
    with SimulatedController(tmp_path) as simulated:
        simulated.speeds = (60, 50)
        yield simulated


@pytest.fixture
def count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where `SLOW_RUN` counts."""
    monkeypatch.setenv("COUNT", str(tmp_path / "count"))
    return tmp_path / "count"


def test_a_recording_outlives_its_terminal(controller: SimulatedController, tmp_path: Path) -> None:
    terminal, out = Terminal(), tmp_path / "out"
    process = terminal.begin(["-m", "wheelsight", "record", "--wheels", controller.port, "--out", out])
    until(lambda: bool(terminal.read()) or rows(out) > 20, process)
    until(lambda: rows(out) > 20, process)
    terminal.close()
    assert process.wait(60) == 0
    assert len(list(open_wheels(out).ticks())) > 20


def test_under_nohup_a_recording_goes_on(controller: SimulatedController, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["-m", "wheelsight", "record", "--wheels", controller.port, "--out", out]
    with begun(words, ignores=[signal.SIGHUP]) as process:
        until(lambda: rows(out) > 5, process)
        process.send_signal(signal.SIGHUP)
        kept = rows(out)
        until(lambda: rows(out) > kept + 25, process)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0


def test_stderr_may_go_before_the_program_does(controller: SimulatedController, tmp_path: Path) -> None:
    """As where it is read by a program over a network."""
    out = tmp_path / "out"
    with begun(["-m", "wheelsight", "record", "--wheels", controller.port, "--out", out]) as process:
        until(lambda: rows(out) > 5, process)
        assert process.stderr is not None
        process.stderr.close()
        controller.unplug()  # which is said
        time.sleep(0.3)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
    assert len(list(open_wheels(out).ticks())) > 5


@pytest.mark.slow
def test_a_run_leaves_what_it_found(tmp_path: Path, count: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=40)
    out = tmp_path / "out"
    with begun(["-c", SLOW_RUN, "run", tmp_path / "room", "--out", out]) as process:
        until(lambda: count.exists() and int(count.read_text() or 0) > 5, process)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=240)
    assert process.returncode == 128 + signal.SIGTERM, said
    assert said.splitlines()[-1] == f"interrupted; what was found until then is in {out}"
    check_run(out)


@pytest.mark.slow
def test_a_run_outlives_its_terminal(tmp_path: Path, count: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=40)
    terminal, out = Terminal(), tmp_path / "out"
    process = terminal.begin(["-c", SLOW_RUN, "run", tmp_path / "room", "--out", out])
    until(lambda: terminal.read() == b"" and count.exists() and int(count.read_text() or 0) > 5, process)
    terminal.close()
    assert process.wait(240) == 128 + signal.SIGHUP
    check_run(out)


def check_run(out: Path) -> None:
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["interrupted"]
    assert 5 <= metrics["frames"]["processed"] < 40
    assert len(read_tum(out / "trajectory.txt")) == metrics["frames"]["with_pose"]
    assert (out / "report.html").is_file()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "number"), list(zip(LONG_WORDS, cycle(ENDING), strict=False)))
def test_what_only_computes_says_that_it_was_interrupted(name: str, number: signal.Signals) -> None:
    with begun(["-c", LONG_COMMAND, *LONG_WORDS[name]]) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n", process.communicate()
        process.send_signal(number)
        _, said = process.communicate(timeout=60)
    assert (process.returncode, said) == (128 + number, "error: interrupted\n")


@pytest.mark.slow
def test_a_simulation_is_a_shorter_recording(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    out = tmp_path / "out"
    with begun(["-m", "wheelsight", "simulate", "square", "--size", "64x48", "--out", out]) as process:
        lines = out / "rgb.txt"
        until(lambda: lines.is_file() and len(lines.read_text().splitlines()) > 4, process)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=240)
    assert process.returncode == 128 + signal.SIGTERM
    frames = open_recording(out).frame_count
    assert said.splitlines()[-1] == f"interrupted; {out} holds the drive up to there, {frames} frames"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_drive_stops_its_robot_and_leaves_its_record(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    out = tmp_path / "out"
    words = ["-m", "wheelsight", "drive", "--sim", "studio", "--size", "160x120", "--rate", "5", "--explore"]
    with begun([*words, "--out", out]) as process:
        assert process.stderr is not None
        said = [process.stderr.readline()]
        while said[-1] and "state: driving" not in said[-1]:
            said.append(process.stderr.readline())
        process.send_signal(signal.SIGTERM)
        said += process.communicate(timeout=600)[1].splitlines()
    assert process.returncode == 128 + signal.SIGTERM, said
    assert said[-1] == "interrupted; the robot was stopped first, and stands"
    assert json.loads((out / "drive.json").read_text())["interrupted"] is True
    assert (out / "map" / "map.json").is_file()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_real_robot_stands_once_the_terminal_of_its_program_is_closed(
    controller: SimulatedController, tmp_path: Path
) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    day, out, terminal = tmp_path / "day", tmp_path / "out", Terminal()
    small = ["--size", "160x120", "--rate", "5", "--duration", "20", "--out", day]
    with begun(["-m", "wheelsight", "simulate", "square", *small]) as simulating:
        assert simulating.wait(600) == 0
    controller.motors = lambda duties, seconds: (int(8 * duties[0] * seconds), int(8 * duties[1] * seconds))
    words = ["drive", "--robot", controller.port, "--calibration", day / "calibration.yaml", "--yes", "--explore"]
    process = terminal.begin(["-m", "wheelsight", *words, "--camera", f"recording:{day}", "--out", out])
    until(lambda: bool(terminal.read()) or controller.duties != (0, 0), process)
    until(lambda: terminal.read() == b"" and controller.duties != (0, 0), process)
    before = len(controller.commands)
    terminal.close()
    assert process.wait(600) == 128 + signal.SIGHUP
    after = controller.commands[before:]
    stopped = [kind for kind, _ in after].index(LinkCommand.STOP)
    assert stopped <= 20  # a period of the drive's loop is 50 ms, and a reply is waited for
    assert not any(int.from_bytes(body, "little") for kind, body in after[stopped:] if kind == LinkCommand.DRIVE)
    assert json.loads((out / "drive.json").read_text())["interrupted"] is True
