"""Who leads a navigator: by `go_to`, and by the loop that docs/navigation.md shows."""

from __future__ import annotations

from pathlib import Path

import pytest
from documentation_blocks import python_blocks
from narrowing import not_none
from navigation.rooms import Ride, StandInLocalization, is_near

from benchmarks.plain_rooms import RoomRobot, Walls, walls_about
from wheelsight.core.errors import ArgumentError
from wheelsight.core.messages import Event, VelocityCommand
from wheelsight.navigation import Feedback, KnownFloor, NavigationReason, NavigationState, Navigator
from wheelsight.navigation.controllers import stands

SIZE_M = (8.0, 6.0)
ROOM = walls_about(*SIZE_M)
BEGIN, GOAL = (4.0, 3.0, 0.0), (6.0, 3.0, 0.0)
PERIOD_S = 0.05


def ride() -> Ride:
    return Ride.of(Walls.of(*ROOM), BEGIN, SIZE_M)


def test_go_to_drives_there_stands_and_shows_each_period() -> None:
    subject, reported = ride(), list[Feedback]()
    result = subject.navigator.go_to(GOAL, reported.append)
    assert result.has_arrived
    assert result is subject.navigator.result
    assert is_near(subject.robot.base.pose, GOAL)
    assert subject.robot.base.stands
    assert len(reported) == round(subject.robot.now_s / PERIOD_S)
    assert [one.stamp_s for one in reported] == pytest.approx([PERIOD_S * (k + 1) for k in range(len(reported))])
    assert reported[-1].state is NavigationState.ARRIVED
    to_go_m = [one.to_go_m for one in reported if one.to_go_m is not None]
    assert to_go_m[0] == pytest.approx(2.0, abs=0.1)
    assert to_go_m[-1] < 0.15


def test_go_to_goes_on_until_a_robot_stands_whose_task_is_over() -> None:
    """It is called off at full speed, by who hears each period."""
    subject = ride()

    def ends(feedback: Feedback) -> None:
        if feedback.forward_m_s > 0.3:
            subject.navigator.cancel_task()

    result = subject.navigator.go_to(GOAL, ends)
    assert (result.has_arrived, result.reason) == (False, NavigationReason.CANCELED)
    base = subject.robot.base
    assert stands(base.forward_m_s, base.turn_rad_s)
    assert not is_near(base.pose, GOAL)
    assert not is_near(subject.robot.base.pose, GOAL)
    assert subject.robot.now_s > result.time_s + 0.2


def test_go_to_refuses_what_is_no_pose_before_anything_moves() -> None:
    subject, reported = ride(), list[Feedback]()
    with pytest.raises(ArgumentError):
        subject.navigator.go_to((1.0,), reported.append)
    assert (reported, subject.robot.now_s) == ([], 0.0)
    assert subject.navigator.state is NavigationState.IDLE


class UnpluggedError(Exception):
    pass


def test_go_to_raises_what_the_robot_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    def unplug(robot: RoomRobot, command: VelocityCommand) -> list[Event]:
        raise UnpluggedError

    subject = ride()
    monkeypatch.setattr(RoomRobot, "step", unplug)
    with pytest.raises(UnpluggedError):
        subject.navigator.go_to(GOAL)


def test_the_loop_of_the_page_arrives(project_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loops = [text for _, text in python_blocks(project_folder / "docs" / "navigation.md") if "is_task_complete" in text]
    (block,) = loops
    assert f"go_to_pose({GOAL})" in block
    walls = Walls.of(*ROOM)
    robot = RoomRobot(walls, BEGIN)
    names = {"robot": robot, "localization": StandInLocalization(robot), "floor": KnownFloor(walls.grid(*SIZE_M))}
    exec(block, names)
    navigator = names["navigator"]
    assert isinstance(navigator, Navigator)
    assert not_none(navigator.result).has_arrived
    assert is_near(robot.base.pose, GOAL)
    *lines, last = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("2.0 m to go to (6.00, 3.00) m")
    assert len(lines) > 50
    assert last == "arrived"
