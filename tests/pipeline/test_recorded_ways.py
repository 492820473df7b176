"""Ways of before: read from trajectories that wheelsight wrote, and driven along again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rehearsed_drive import CALIBRATION, recorded, rehearsed_drive

from wheelsight.app.run.drives import read_way
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError, CalibrationError, TrajectoryError
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory, write_tum
from wheelsight.io.recordings import express_for
from wheelsight.navigation import NavigationState

WAY = np.array([(-1.3, -0.4, 0.0), (-1.0, -0.4, 0.1), (-0.7, -0.37, 0.1)])


def way_of(poses: np.ndarray = WAY, *, body: str = "base", frame: str = "map") -> Trajectory:
    T = np.array([se3.from_plane(*pose) for pose in poses])
    return Trajectory(np.arange(len(poses), dtype=np.float64), T, None, body, frame)


def test_a_way_is_read_as_it_was_written(tmp_path: Path) -> None:
    write_tum(way_of(), tmp_path / "trajectory.txt")
    for given in (tmp_path / "trajectory.txt", tmp_path):
        np.testing.assert_allclose(read_way(given, CALIBRATION), WAY, atol=1e-8)


def test_a_way_of_the_camera_is_reported_for_the_base(tmp_path: Path) -> None:
    write_tum(express_for("camera", way_of(), CALIBRATION), tmp_path / "way.txt")
    np.testing.assert_allclose(read_way(tmp_path / "way.txt", CALIBRATION), WAY, atol=1e-6)
    with pytest.raises(CalibrationError, match=r"way\.txt: its poses are of the camera, and the map's calibration has"):
        read_way(tmp_path / "way.txt", Calibration(wheels=CALIBRATION.wheels))


def test_of_a_run_the_file_that_knows_more_is_read(tmp_path: Path) -> None:
    (tmp_path / "joined").mkdir()
    write_tum(way_of(frame="odom"), tmp_path / "joined" / "trajectory.txt")
    write_tum(way_of(), tmp_path / "joined" / "trajectory_corrected.txt")
    np.testing.assert_allclose(read_way(tmp_path, CALIBRATION), WAY, atol=1e-8)


def test_poses_that_are_not_in_the_map_are_refused(tmp_path: Path) -> None:
    write_tum(way_of(frame="odom"), tmp_path / "odom.txt")
    with pytest.raises(TrajectoryError, match=r"odom\.txt: the field frames says that its poses are in odom, not in"):
        read_way(tmp_path / "odom.txt", CALIBRATION)


def test_a_camera_that_is_taken_for_a_base_is_refused(tmp_path: Path) -> None:
    write_tum(express_for("camera", way_of(), CALIBRATION), tmp_path / "way.txt")
    bare = [line for line in (tmp_path / "way.txt").read_text().splitlines() if not line.startswith("#")]
    (tmp_path / "way.txt").write_text("\n".join(bare))
    with pytest.raises(TrajectoryError, match=r"way\.txt: the quaternion at stamp 0\.000000 tips the base by 90°"):
        read_way(tmp_path / "way.txt", CALIBRATION)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("# frames: T_map_base\n", r"way\.txt: holds no poses"),
        ("0 1 nan 0 0 0 0 1\n", r"way\.txt:1: a value is not finite \(remove the line\)"),
        ("0 1 2 0\n", r"way\.txt:1: 4 values where 8 are expected"),
        ("hello\n", r"way\.txt:1: "),
    ],
)
def test_what_is_no_trajectory_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "way.txt").write_text(text)
    with pytest.raises(TrajectoryError, match=problem):
        read_way(tmp_path / "way.txt", CALIBRATION)


def test_what_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match=r"nowhere\.txt: "):
        read_way(tmp_path / "nowhere.txt", CALIBRATION)
    with pytest.raises(
        TrajectoryError, match=r"the folder holds neither trajectory\.txt nor trajectory_corrected\.txt"
    ):
        read_way(tmp_path, CALIBRATION)


def test_a_way_is_driven_to_its_end() -> None:
    drive, robot, config = rehearsed_drive()
    assert drive.follow(WAY, lambda feedback: None)
    (goal,) = recorded(drive, config).goals
    assert (goal.name, goal.is_place) == ("the end of a recorded way", True)
    np.testing.assert_array_equal(goal.goal, WAY[-1])
    assert np.hypot(*(robot.pose - WAY[-1])[:2]) < 0.15
    assert goal.off_m < 0.15


@pytest.mark.parametrize("way", [np.empty((0, 3)), WAY[:, :2], WAY[0], np.full((2, 3), np.nan)])
def test_what_is_no_way_is_refused_and_the_robot_stands(way: np.ndarray) -> None:
    drive, robot, _ = rehearsed_drive()
    with pytest.raises(ArgumentError, match="a way of shape"):
        drive.follow(way, lambda feedback: None)
    assert robot.now_s == 0.0
    assert drive.navigator.state is NavigationState.IDLE
