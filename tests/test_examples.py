from __future__ import annotations

import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from documentation_blocks import python_blocks
from room_drive import make_room_drive
from synthetic import make_tum_recording
from typer.testing import CliRunner

import wheelsight
from wheelsight import Event, Localizer, read_tum
from wheelsight.app.cli import app
from wheelsight.core.estimates import Estimate

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
        output = capsys.readouterr()
        assert output.err == ""
        return output.out

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


@pytest.mark.slow
def test_readme_examples_and_command_line_give_the_same_poses(
    project_folder: Path, example: Example, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the bit, of a drive by wheels and camera, by what stands in README and examples. `step_by_step.py` is another
    method, by hand.
    """
    drive, answered = tmp_path / "drive", list[Estimate]()
    make_room_drive(drive, frames=8)
    result = CliRunner().invoke(app, ["run", str(drive), "--out", str(tmp_path / "cli")])
    assert result.exit_code == 0, result.output
    output = example("all_in_one.py", drive, tmp_path / "example")
    cli, by_example = tmp_path / "cli" / "joined", tmp_path / "example" / "joined"
    for name in ("trajectory.txt", "odom.txt", "covariances.csv"):
        assert (cli / name).read_bytes() == (by_example / name).read_bytes()
    assert without_times(cli / "status.csv") == without_times(by_example / "status.csv")
    odom, best = read_tum(cli / "odom.txt"), read_tum(cli / "trajectory.txt")
    frames = len((cli / "status.csv").read_text().splitlines()) - 1
    assert output.startswith(f"{frames} of {frames} frames have a pose")

    class Watched(Localizer):
        def process(self, event: Event) -> Estimate | None:
            estimate = super().process(event)
            if estimate is not None and estimate.T_odom_body is not None:
                answered.append(estimate)
            return estimate

    monkeypatch.setattr(wheelsight, "Localizer", Watched, raising=False)
    (block,) = (block for _, block in python_blocks(project_folder / "README.md") if "localizer.process" in block)
    exec(compile(block.replace("path/to/recording", str(drive)), "README.md", "exec"), {})
    by_stamp = {estimate.stamp_s: estimate.T_odom_body for estimate in answered}
    np.testing.assert_allclose(list(by_stamp), odom.stamps_s, atol=1e-6)
    np.testing.assert_allclose(np.array(list(by_stamp.values())), odom.T_frame_body, atol=2e-6)  # as files have them
    of_filter = {estimate.stamp_s: estimate.T_filter_body for estimate in answered}
    np.testing.assert_allclose(np.array(list(of_filter.values())), best.T_frame_body, atol=2e-6)
    lines = [line for line in example("frame_by_frame.py", drive).splitlines() if " base at " in line]
    printed = {values[0]: values[1:] for values in (re.findall(r"[+-]?\d+\.\d{3}", line)[:4] for line in lines)}
    places = np.array([[float(value) for value in printed[f"{stamp_s:.3f}"]] for stamp_s in best.stamps_s])
    np.testing.assert_allclose(places, best.positions_m, atol=5.1e-4)
    assert len(lines) > 100


def without_times(status: Path) -> list[list[str]]:
    """The fields of a status file but that of the milliseconds."""
    rows = [line.split(",") for line in status.read_text().splitlines()]
    (column,) = (number for number, name in enumerate(rows[0]) if name == "time_ms")
    return [[field for number, field in enumerate(row) if number != column] for row in rows]


def test_every_example_is_tried(project_folder: Path) -> None:
    tried = Path(__file__).read_text()
    for script in (project_folder / "examples").glob("*.py"):
        assert f'"{script.name}"' in tried
