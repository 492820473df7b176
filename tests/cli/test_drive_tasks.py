"""`wheelsight drive`: along an earlier way, and back to the start; the robot is drawn, and knows where it is."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rehearsed_drive import CALIBRATION, QUICK, rehearsed_drive
from sessions.kept_views import write_map
from typer.testing import Result

from wheelsight.app.run.drives import GoalDrive
from wheelsight.app.run.kernel_process import DrawnRobot, TrueLocalization
from wheelsight.core.calibration import save_calibration
from wheelsight.core.geometry import se3
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.core.messages import STOP
from wheelsight.core.trajectory import Trajectory, read_tum, write_tum

Command = Callable[..., Result]
Refusal = Callable[..., str]
NEAR = "-0.7,-0.4"


@pytest.fixture
def home(tmp_path: Path) -> Path:
    write_map(tmp_path / "home", 5)
    return tmp_path / "home"


@pytest.fixture
def way(tmp_path: Path) -> Path:
    """0.6 m straight on from where the drawn robot stands."""
    T = np.array([se3.from_plane(x_m, -0.4, 0.0) for x_m in np.linspace(-1.3, -0.7, 7)])
    write_tum(Trajectory(np.arange(7.0), T, None, "base", "map"), tmp_path / "way.txt")
    return tmp_path / "way.txt"


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> tuple[GoalDrive, DrawnRobot]:
    """What any drive in a map is from now on; one that is lost gives up soon."""
    monkeypatch.setitem(QUICK, "navigation.navigator.lost_s", 1.0)
    drive, robot, _ = rehearsed_drive()
    monkeypatch.setattr("wheelsight.app.cli.drive.robot_of", lambda *_: nullcontext(robot))
    monkeypatch.setattr("wheelsight.app.run.drives.drive_in_map", lambda *_, **__: nullcontext(drive))
    return drive, robot


@pytest.fixture
def words(home: Path, tmp_path: Path) -> tuple[Any, ...]:
    """What every command begins with."""
    save_calibration(CALIBRATION, tmp_path / "robot.yaml")
    return ("drive", "--robot", "p", "--yes", "--calibration", tmp_path / "robot.yaml", "--map", home)


def test_the_robot_drives_along_a_way_of_before(
    wheelsight: Command, drawn: tuple[GoalDrive, DrawnRobot], words: tuple[Any, ...], way: Path, tmp_path: Path
) -> None:
    result = wheelsight(*words, "--follow", way, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith(f"arrived at the end of {way}: ")
    np.testing.assert_allclose(drawn[1].pose[:2], (-0.7, -0.4), atol=0.15)
    reported = json.loads((tmp_path / "out" / "drive.json").read_text())
    assert (reported["has_arrived"], reported["goals_asked"]) == (True, 1)
    # What a drive leaves is a way to follow.
    assert len(read_tum(tmp_path / "out" / "trajectory.txt")) > 10


def blocked_until(robot: DrawnRobot, asked: list[object], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the wheels stand, whatever the command, until a person was asked to check them."""
    step = robot.step
    monkeypatch.setattr(robot, "step", lambda command: step(command if asked else STOP))


def test_after_a_person_has_checked_the_wheels_the_goal_is_driven_to_again(
    wheelsight: Command, drawn: tuple[GoalDrive, DrawnRobot], words: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[object] = []
    blocked_until(drawn[1], asked, monkeypatch)

    def are_fine(watch: object) -> bool:
        asked.append(watch)
        return True

    monkeypatch.setattr("wheelsight.app.cli.drive._are_wheels_fine", are_fine)
    result = wheelsight(*words, "--to", NEAR)
    assert result.exit_code == 0, result.output
    assert len(asked) == 1
    assert result.stdout.startswith("arrived at (")


def test_where_no_person_can_answer_wheels_that_do_not_follow_end_the_drive(
    wheelsight: Command, drawn: tuple[GoalDrive, DrawnRobot], words: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked_until(drawn[1], [], monkeypatch)
    result = wheelsight(*words, "--to", NEAR)
    assert result.exit_code == 1
    assert "the wheels do not follow their commands" in result.stderr


# A turn takes 2 s; to come back from 0.6 m ahead it turns about twice, which takes 10.
@pytest.mark.parametrize("goal", ["-1.3,-0.4,34", pytest.param(NEAR, marks=pytest.mark.slow)])
def test_back_returns_to_where_the_drive_began(
    wheelsight: Command, drawn: tuple[GoalDrive, DrawnRobot], words: tuple[Any, ...], tmp_path: Path, goal: str
) -> None:
    drive, robot = drawn
    begin = robot.pose.copy()
    result = wheelsight(*words, "--to", goal, "--back", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    there, back, _spent = result.stdout.splitlines()
    assert there.startswith("arrived at (")
    assert back.startswith("arrived at the start: ")
    assert drive.start is not None
    np.testing.assert_allclose(drive.start, begin, atol=0.05)
    np.testing.assert_allclose(robot.pose[:2], begin[:2], atol=0.15)
    assert abs(wrap_angle(robot.pose[2] - begin[2])) < np.radians(10)
    assert "--back was left out" not in result.stderr
    reported = json.loads((tmp_path / "out" / "drive.json").read_text())
    assert (reported["has_arrived"], reported["goals_asked"], len(reported["goals"])) == (True, 2, 2)


def test_back_is_left_out_aloud_where_a_goal_was_not_reached(
    wheelsight: Command, drawn: tuple[GoalDrive, DrawnRobot], words: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = TrueLocalization.process
    # The localization falls silent on the way.
    monkeypatch.setattr(
        TrueLocalization, "process", lambda self, events: answers(self, events) if self._robot.now_s < 1.0 else []
    )
    result = wheelsight(*words, "--to", NEAR, "--back")
    assert result.exit_code == 1, result.output
    assert result.stderr.splitlines()[-1] == "error: --back was left out: a goal before it was not reached"


def test_back_is_left_out_aloud_where_the_start_is_not_known(
    wheelsight: Command, drawn: tuple[GoalDrive, DrawnRobot], words: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(TrueLocalization, "process", lambda self, events: [(event, None) for event in events])
    result = wheelsight(*words, "--to", NEAR, "--back")
    assert drawn[0].start is None
    assert result.exit_code == 1, result.output
    *_, why, left_out = result.stderr.splitlines()
    assert "was not reached: it does not know where it is" in why
    assert left_out.startswith("error: --back was left out: it was never known where in the map the robot is")


def test_a_way_and_other_goals_exclude_each_other(
    refusal: Refusal, words: tuple[Any, ...], way: Path, tmp_path: Path
) -> None:
    reported = refusal(*words, "--follow", way, "--to", NEAR)
    assert reported == "--follow ends where its way does (leave out --follow or --to)"
    reported = refusal("drive", "--sim", "flat", "--explore", "--follow", way, "--out", tmp_path / "out")
    assert reported == "--explore finds its own way (leave out --explore or --follow)"
    reported = refusal("drive", "--sim", "flat", "--follow", way)
    assert reported.startswith("there is no map to drive in (--map DIR")


def test_what_is_no_way_is_refused_in_a_line(refusal: Refusal, words: tuple[Any, ...], tmp_path: Path) -> None:
    (tmp_path / "way.txt").write_text("0 1 inf 0 0 0 0 1\n")
    reported = refusal(*words, "--follow", tmp_path / "way.txt", "--out", tmp_path / "out")
    assert reported == f"{tmp_path / 'way.txt'}:1: a value is not finite (remove the line)"
    assert refusal(*words, "--follow", tmp_path / "nowhere.txt").startswith(f"{tmp_path / 'nowhere.txt'}: ")
    assert not (tmp_path / "out").exists()


def test_help_shows_how_a_way_is_followed(wheelsight: Command) -> None:
    reported = " ".join(wheelsight("drive", "--help").output.split())
    assert "--follow" in reported
    assert "--follow drive/trajectory.txt --back" in reported
