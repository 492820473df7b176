from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hand_fed_camera import CALIBRATION, live_frame
from stand_ins import leave_pages_bare
from synthetic import make_tum_recording
from typer.main import get_command
from typer.testing import CliRunner, Result

from wheelsight.app.cli import app
from wheelsight.app.run import kernels
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.messages import WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import RecordingWriter
from wheelsight.wheels import integrate_log


@pytest.fixture(autouse=True)
def compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels are compiled on the way, not all of them ahead; what is said of that has its own test."""
    monkeypatch.setattr(kernels, "missing_parts", lambda parts: ())


@pytest.fixture(autouse=True)
def bare_pages(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if "drawn_pages" not in request.fixturenames:
        leave_pages_bare(monkeypatch)


@pytest.fixture(scope="session")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six seconds of frames at 15 Hz, each of which shows its number."""
    folder = tmp_path_factory.mktemp("film") / "film"
    with RecordingWriter(folder, CALIBRATION) as writer:
        for number in range(90):
            writer.add(live_frame(number, number / 15).frame)
    return folder


@pytest.fixture
def drawn_pages() -> None:
    """Asked for by tests that want the page of a run as it is."""


@pytest.fixture(scope="session", autouse=True)
def built_commands() -> Iterator[None]:
    """Typer builds all commands for each one that is typed; here they are built once, which hundreds of tests need."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("typer.testing._get_command", cache(get_command))
        yield


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


@pytest.fixture(scope="session")
def one_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `room` is a copy of."""
    folder = tmp_path_factory.mktemp("one_room")
    make_tum_recording(folder, frames=10)
    return folder


@pytest.fixture
def room(one_room: Path, tmp_path: Path) -> Path:
    """A sound recording of ten frames."""
    return Path(shutil.copytree(one_room, tmp_path / "room"))


@pytest.fixture
def wheels(tmp_path: Path) -> Path:
    """A sound recording of wheels alone: 200 readings of a bend, with its truth."""
    robot = Wheels(0.17, 0.17, 0.52, 3200.0)
    stamps_s, left, right = 0.02 * np.arange(200), 30 * np.arange(200), 40 * np.arange(200)
    with RecordingWriter(tmp_path / "wheels", Calibration(wheels=robot, source="our robot")) as writer:
        path = integrate_log(robot, stamps_s, left, right).trajectory()
        writer.add_ground_truth(Trajectory(path.stamps_s, path.T_frame_body, body="base"))
        for reading in zip(stamps_s.tolist(), left.tolist(), right.tolist(), strict=True):
            writer.add(WheelTicks(*reading))
    return tmp_path / "wheels"
