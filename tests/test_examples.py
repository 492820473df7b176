from __future__ import annotations

import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from room_drive import make_room_drive
from synthetic import make_tum_recording

Example = Callable[..., str]


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """A sound recording of eight frames."""
    make_tum_recording(tmp_path / "room", frames=8)
    return tmp_path / "room"


@pytest.fixture
def example(project_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Example:
    """Runs an example in this process, any warning an error; returns what it prints."""

    def run(name: str, *arguments: Path) -> str:
        script = project_folder / "examples" / name
        monkeypatch.setattr(sys, "argv", [str(script), *map(str, arguments)])
        runpy.run_path(str(script), run_name="__main__")
        told = capsys.readouterr()
        assert told.err == ""
        return told.out

    return run


def test_all_in_one(project_folder: Path, room: Path, tmp_path: Path) -> None:
    """In a process of its own, as a user runs it."""
    script = project_folder / "examples" / "all_in_one.py"
    command = [sys.executable, "-W", "error", str(script), str(room), str(tmp_path / "out")]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert answer.stderr == ""
    printed = answer.stdout
    assert printed.startswith("8 of 8 frames have a pose")
    assert float(re.findall(r"ATE ([\d.]+) m", printed)[0]) < 0.01
    assert (tmp_path / "out" / "report.html").is_file()


def test_frame_by_frame(example: Example, room: Path) -> None:
    lines = example("frame_by_frame.py", room).splitlines()
    assert len(lines) == 8
    assert lines[0].startswith("100.000 s  camera at +0.000 +0.000 +0.000 m")


def test_step_by_step(example: Example, room: Path) -> None:
    printed = example("step_by_step.py", room)
    assert printed.startswith("8 poses over ")
    assert float(re.findall(r"ATE ([\d.]+) m", printed)[0]) < 0.02


def test_a_camera_that_is_covered_on_the_way_and_sees_bare_walls(example: Example, tmp_path: Path) -> None:
    """As on the drive of `make demo`, whose truth is the base's besides."""
    make_tum_recording(tmp_path / "room", frames=12, covered=(0, 5, 6), blank=(8, 9))
    for name in ("step_by_step.py", "frame_by_frame.py"):
        assert example(name, tmp_path / "room")
    make_room_drive(tmp_path / "drive", frames=4)
    printed = example("step_by_step.py", tmp_path / "drive")
    assert float(re.findall(r"ATE ([\d.]+) m", printed)[0]) < 0.03


def test_every_example_is_tried(project_folder: Path) -> None:
    tried = Path(__file__).read_text()
    for script in (project_folder / "examples").glob("*.py"):
        assert f'"{script.name}"' in tried
