from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from room_drive import make_room_drive
from synthetic import make_tum_recording


@pytest.fixture
def example(project_folder: Path, tmp_path: Path) -> Callable[..., str]:
    """Runs an example on a sound recording of eight frames, any warning an error; returns what it prints."""
    room = tmp_path / "room"
    make_tum_recording(room, frames=8)

    def run(name: str, *arguments: Path) -> str:
        script = project_folder / "examples" / name
        command = [sys.executable, "-W", "error", str(script), str(room), *map(str, arguments)]
        answer = subprocess.run(command, capture_output=True, text=True, check=False)
        assert answer.returncode == 0, answer.stderr
        assert answer.stderr == ""
        return answer.stdout

    return run


def test_all_in_one(example: Callable[..., str], tmp_path: Path) -> None:
    printed = example("all_in_one.py", tmp_path / "out")
    assert printed.startswith("8 of 8 frames have a pose")
    assert float(re.findall(r"ATE ([\d.]+) m", printed)[0]) < 0.01
    assert (tmp_path / "out" / "report.html").is_file()


def test_frame_by_frame(example: Callable[..., str]) -> None:
    lines = example("frame_by_frame.py").splitlines()
    assert len(lines) == 8
    assert lines[0].startswith("100.000 s  camera at +0.000 +0.000 +0.000 m")


def test_step_by_step(example: Callable[..., str]) -> None:
    printed = example("step_by_step.py")
    assert printed.startswith("8 poses over ")
    assert float(re.findall(r"ATE ([\d.]+) m", printed)[0]) < 0.02


def test_a_camera_that_is_covered_on_the_way_and_sees_bare_walls(project_folder: Path, tmp_path: Path) -> None:
    """As on the drive of `make demo`, whose truth is the base's besides."""
    make_tum_recording(tmp_path / "room", frames=12, covered=(0, 5, 6), blank=(8, 9))
    for name in ("step_by_step.py", "frame_by_frame.py"):
        command = [sys.executable, "-W", "error", str(project_folder / "examples" / name), str(tmp_path / "room")]
        answer = subprocess.run(command, capture_output=True, text=True, check=False)
        assert answer.returncode == 0, answer.stderr
    make_room_drive(tmp_path / "drive", frames=4)
    command = [sys.executable, str(project_folder / "examples" / "step_by_step.py"), str(tmp_path / "drive")]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert float(re.findall(r"ATE ([\d.]+) m", answer.stdout)[0]) < 0.03, answer.stderr


def test_every_example_is_tried(project_folder: Path) -> None:
    tried = Path(__file__).read_text()
    for script in (project_folder / "examples").glob("*.py"):
        assert f'"{script.name}"' in tried
