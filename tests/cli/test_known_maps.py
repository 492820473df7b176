from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from synthetic import CAMERA, make_tum_recording
from typer.testing import Result

from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.trajectory import Trajectory, read_tum
from wheelsight.estimation import loop_updates
from wheelsight.slam import drive_graph

Command = Callable[..., Result]
Refusal = Callable[..., str]
# The camera hardly moves in two seconds.
QUICK = """
loops: {latency_s: 0.3, apart_s: 2.5}
dense: {keyframe_way_m: 0.02, keyframe_overlap: 0.97}
"""


@pytest.fixture
def monday(wheelsight: Command, one_room: Path, tmp_path: Path) -> Path:
    """A run that has left a map of the room."""
    out = tmp_path / "monday"
    result = wheelsight("run", one_room, "--odometry", "dense", "--map", "surfels", "--out", out)
    assert result.exit_code == 0, result.output
    return out


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (("--odometry", "dense", "--extend"), "--extend is given without a map (add --map-from DIR)"),
        (
            ("--odometry", "features,dense", "--map-from", "monday"),
            "--map-from is for one odometry by a camera (--odometry dense, or wheels,dense)",
        ),
        (
            ("--odometry", "wheels", "--map-from", "monday"),
            "--map-from is for one odometry by a camera (--odometry dense, or wheels,dense)",
        ),
        (
            ("--odometry", "wheels,dense", "--fusion", "ligocki", "--map-from", "monday"),
            "--map-from is for the default filter (no --fusion ligocki)",
        ),
        (
            ("--odometry", "dense", "--loops", "matches", "--map-from", "monday"),
            "--map-from is found by loops (--loops keyframes)",
        ),
    ],
)
def test_options_that_contradict_are_refused(
    refusal: Refusal, room: Path, tmp_path: Path, options: tuple[str, ...], problem: str
) -> None:
    assert refusal("run", room, *options, "--out", tmp_path / "out") == problem
    assert not (tmp_path / "out").exists()


def test_a_map_that_is_not_there_is_refused(refusal: Refusal, room: Path, tmp_path: Path) -> None:
    nowhere = tmp_path / "nowhere"
    reported = refusal("run", room, "--odometry", "dense", "--map-from", nowhere, "--out", tmp_path / "out")
    assert reported.startswith(str(nowhere))
    assert not (tmp_path / "out").exists()


def test_a_map_of_another_camera_is_refused(refusal: Refusal, monday: Path, room: Path, tmp_path: Path) -> None:
    other = PinholeCamera(CAMERA.width, CAMERA.height, 300.0, 300.0, CAMERA.cx, CAMERA.cy)
    save_calibration(Calibration.registered_camera(other), room / "calibration.yaml")
    reported = refusal("run", room, "--odometry", "dense", "--map-from", monday, "--out", tmp_path / "out")
    assert "is of another camera: " in reported
    assert "300" in reported
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_next_drive_is_found_and_another_room_is_not(
    wheelsight: Command, monday: Path, one_room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (drive_graph, loop_updates):
        monkeypatch.setattr(module, "JOIN_APART_M", 0.1)
    truth = read_tum(one_room / "groundtruth.txt")
    slowly = np.linspace(truth.stamps_s[-1], truth.stamps_s[0], 30)
    way = Trajectory(500.0 + np.arange(30) / 15, truth.at(slowly), body="camera")  # the same way, backwards
    settings = tmp_path / "quick.yaml"
    settings.write_text(QUICK)
    asked = ("--odometry", "dense", "--map-from", monday, "--config", settings)
    kept = {path.name: path.read_bytes() for path in (monday / "map").iterdir()}
    make_tum_recording(tmp_path / "tuesday", 30, trajectory=way)
    found = wheelsight("run", tmp_path / "tuesday", *asked, "--out", tmp_path / "found")
    assert found.exit_code == 0, found.output
    assert "warning" not in found.stderr
    assert found.stdout.startswith(f"Recognised in the map {monday} ")
    corrected = read_tum(tmp_path / "found" / "trajectory_corrected.txt")
    first = read_tum(monday / "trajectory.txt").T_frame_body[0]
    T_map_room = first @ np.linalg.inv(truth.T_frame_body[0])
    off_m = np.linalg.norm(corrected.positions_m - (T_map_room @ way.T_frame_body)[:, :3, 3], axis=1)
    assert len(corrected) == 30
    assert off_m.max() < 0.05
    make_tum_recording(tmp_path / "elsewhere", 15, trajectory=way.select(slice(0, 15)), seed=3)
    lost = wheelsight("run", tmp_path / "elsewhere", *asked, "--out", tmp_path / "lost")
    assert lost.exit_code == 0, lost.output
    assert lost.stdout.startswith(f"The place was not recognised in the map {monday}: there are no poses in it.\n")
    assert "verdict: red, Do not rely on it: the place was not recognised in the map\n" in lost.stdout
    assert json.loads((tmp_path / "lost" / "metrics.json").read_text())["frames"]["with_pose"] == 0
    assert not (tmp_path / "lost" / "trajectory_corrected.txt").exists()
    assert {path.name: path.read_bytes() for path in (monday / "map").iterdir()} == kept
