"""`record` on a simulated controller: whatever ends it leaves a valid recording."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from full_disk import FullDisk
from typer.testing import Result

from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.io.devices import open_wheels
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.recordings import open_recording

Command = Callable[..., Result]


@pytest.fixture
def controller(tmp_path: Path) -> Iterator[SimulatedController]:
    with SimulatedController(tmp_path) as simulated:
        simulated.speeds = (60, 50)
        yield simulated


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    path = tmp_path / "robot.yaml"
    save_calibration(Calibration(wheels=Wheels(0.17, 0.17, 0.6, 3200.0)), path)
    return path


def recording(controller: SimulatedController, out: Path, *more: object) -> subprocess.Popen[str]:
    """`record` in a process of its own, once it has written something."""
    words = ["--wheels", controller.port, "--out", out, *more]
    process = subprocess.Popen(
        [sys.executable, "-m", "wheelsight", "record", *map(str, words)], stderr=subprocess.PIPE, text=True
    )
    wait(lambda: rows(out) > 5)
    return process


def rows(out: Path) -> int:
    path = out / "wheels.csv"
    return len(path.read_text().splitlines()) - 1 if path.exists() else 0


def wait(is_so: Callable[[], bool]) -> None:
    ends_s = time.monotonic() + 120
    while not is_so():
        assert time.monotonic() < ends_s, "it did not come"
        time.sleep(0.02)


def check(out: Path) -> int:
    """Readings at growing stamps and with the wheels' speed; how many."""
    ticks = list(open_wheels(out).ticks())
    for before, after in pairwise(ticks):
        assert after.stamp_s > before.stamp_s
        periods = (after.left - before.left) / 60
        assert periods == (after.right - before.right) / 50
        assert periods == int(periods) >= 1
    return len(ticks)


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_whatever_ends_it_leaves_a_valid_recording(
    controller: SimulatedController, calibration: Path, tmp_path: Path, by: signal.Signals
) -> None:
    out = tmp_path / "out"
    process = recording(controller, out, "--calibration", calibration)
    process.send_signal(by)
    _, reported = process.communicate(timeout=60)
    assert process.returncode == (-signal.SIGKILL if by is signal.SIGKILL else 0)
    assert "Traceback" not in reported
    assert check(out) > 5
    assert open_recording(out).calibration.wheels == load_calibration(calibration).wheels


@pytest.mark.slow
def test_a_port_that_vanishes_keeps_what_was_recorded_and_is_waited_for(
    controller: SimulatedController, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    process = recording(controller, out)
    controller.unplug()
    time.sleep(0.3)
    kept = rows(out)
    assert process.poll() is None
    controller.plug()
    wait(lambda: rows(out) > kept + 10)
    process.send_signal(signal.SIGINT)
    _, reported = process.communicate(timeout=60)
    assert "the port vanished: waiting for it" in reported
    assert check(out) > kept + 10


def test_recording_for_a_given_time_without_calibration(
    wheelsight: Command, controller: SimulatedController, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    result = wheelsight("record", "--wheels", controller.port, "--out", out, "--seconds", 0.6)
    assert result.exit_code == 0, result.output
    assert check(out) > 0
    assert f"{check(out)} wheel readings are in {out}" in result.stderr
    assert not (out / "calibration.yaml").exists()


def test_a_folder_in_use_is_refused_and_left_as_it_was(
    refusal: Callable[..., str], wheelsight: Command, controller: SimulatedController, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "wheels.csv").write_text("precious")
    message = refusal("record", "--wheels", controller.port, "--out", out, "--seconds", 0)
    assert message == f"{out}: is not empty (choose another --out, or add --force to overwrite)"
    assert (out / "wheels.csv").read_text() == "precious"
    assert wheelsight("record", "--wheels", controller.port, "--out", out, "--seconds", 0.3, "--force").exit_code == 0
    assert check(out) > 5


def test_what_is_refused_leaves_nothing(
    refusal: Callable[..., str], controller: SimulatedController, tmp_path: Path
) -> None:
    before, out = set(tmp_path.iterdir()), tmp_path / "new" / "out"
    assert "absent" in refusal("record", "--wheels", tmp_path / "absent", "--out", out)
    assert "absent.yaml" in refusal(
        "record", "--wheels", controller.port, "--out", out, "--calibration", tmp_path / "absent.yaml"
    )
    assert set(tmp_path.iterdir()) == before


def test_a_full_disk_is_one_line(
    wheelsight: Command, controller: SimulatedController, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    FullDisk("wheels.csv", room=len("stamp_s,left,right\n")).take_over(monkeypatch)
    result = wheelsight("record", "--wheels", controller.port, "--out", tmp_path / "out", "--seconds", 5)
    assert result.exit_code == 2
    wheels = tmp_path / "out" / "wheels.csv"
    assert result.stderr.splitlines()[-1].startswith(f"error: {wheels}: no space left on the disk")
    assert wheels.read_text() == "stamp_s,left,right\n"
