"""Drives to goals: what is kept of them, and that anyone who ends one stops the robot first."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rehearsed_drive import CALIBRATION, recorded, rehearsed_drive
from sessions.kept_views import write_map

from wheelsight.app.run import drives
from wheelsight.app.run.drive_record import TimeCause, time_cause
from wheelsight.app.run.drives import GoalDrive, NamedGoal, drive_in_map
from wheelsight.app.run.kernel_process import DrawnRobot, drawn_room
from wheelsight.config import load_config
from wheelsight.core.errors import ArgumentError, ConfigError, DeviceError
from wheelsight.core.estimates import Status
from wheelsight.core.messages import VelocityCommand
from wheelsight.core.robots import RobotLimits
from wheelsight.core.trajectory import read_tum
from wheelsight.navigation import (
    Feedback,
    MonitorReason,
    MonitorResult,
    MonitorState,
    NavigationReason,
    NavigationState,
)
from wheelsight.slam.maps import MapFolder
from wheelsight_report import write_drive

NEAR = NamedGoal.of((-0.7, -0.4), "the middle")


def test_a_goal_is_reached_and_all_of_it_is_reported(tmp_path: Path) -> None:
    drive, robot, config = rehearsed_drive()
    begin = robot.pose.copy()
    shown: list[Feedback] = []
    assert drive.go_to(NEAR, shown.append)
    assert drive.start is not None
    assert np.hypot(*(drive.start - begin)[:2]) < 0.05
    record = recorded(drive, config)
    assert record.has_arrived
    assert len(record.rows) == len(shown) > 20
    (goal,) = record.goals
    assert np.hypot(*(robot.pose - NEAR.pose)[:2]) < 0.15
    assert goal.off_m == pytest.approx(np.hypot(*(robot.pose - NEAR.pose)[:2]), abs=0.03)
    assert np.isnan(goal.off_deg)
    # Least at the end or the begin: from the hindmost point to the wall behind, or a side to the nearer wall.
    assert 0.5 < record.clearance_m < 1.3
    assert 1 <= len(record.images) <= 24
    write_drive(record, tmp_path)
    reported = json.loads((tmp_path / "drive.json").read_text())
    assert reported["goals"][0]["name"] == "the middle"
    assert reported["goals"][0]["goal"] == {"x_m": -0.7, "y_m": -0.4, "yaw_deg": None}
    assert [one["after"] for one in reported["transitions"]][-1] == "arrived"
    assert reported["way_m"] == pytest.approx(0.6, abs=0.1)
    assert reported["plans"][0]["poses"][0] == pytest.approx(begin, abs=0.05)
    way = read_tum(tmp_path / "trajectory.txt", "base")
    assert way.frame == "map"
    assert np.hypot(*(way.positions_m[-1, :2] - robot.pose[:2])) < 0.05
    assert load_config(tmp_path / "config.yaml") == config


class EnoughError(Exception):
    pass


def test_anyone_who_ends_a_drive_stops_the_robot_first() -> None:
    drive, robot, config = rehearsed_drive()
    moved: list[float] = []

    def end(feedback: Feedback) -> None:
        if feedback.forward_m_s > 0.15:
            moved.append(float(robot.pose[0]))
            raise EnoughError

    with pytest.raises(EnoughError):
        drive.go_to(NEAR, end)
    # It obeys at once: not even the command of the period before is driven.
    assert robot.pose[0] == moved[0]
    record = recorded(drive, config, is_interrupted=True)
    (goal,) = record.goals
    assert goal.result.reason is NavigationReason.CANCELED
    assert drive.navigator.state is NavigationState.FAILED
    assert not record.has_arrived
    assert drive.go_to(NEAR, lambda feedback: None), "it can be led on"
    assert recorded(drive, config, asked=2).goals[1].result.has_arrived


def test_what_went_wrong_is_reported_and_not_what_came_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = rehearsed_drive()[0]

    def unplug(feedback: Feedback) -> None:
        monkeypatch.setattr(DrawnRobot, "stop", refuse)
        raise DeviceError("the port is gone")

    def refuse(robot: DrawnRobot) -> None:
        raise DeviceError("the controller does not confirm")

    with pytest.raises(DeviceError, match="the port is gone"):
        drive.go_to(NEAR, unplug)
    assert drive.navigator.is_task_complete()


def test_stops_of_the_monitor_are_kept_with_reason_and_place() -> None:
    drive, robot, config = rehearsed_drive()
    held_s = (1.0, 2.0)

    def covered(command):  # no frames for a second
        events = DrawnRobot.step(robot, command)
        return [one for one in events if not (held_s[0] < robot.now_s < held_s[1] and hasattr(one, "depth_m"))]

    robot.step = covered  # type: ignore[method-assign]
    assert drive.go_to(NEAR, lambda feedback: None)
    record = recorded(drive, config)
    stops = [one for one in record.stops if one.begin_s > held_s[0]]
    assert [one.reason for one in stops] == ["no fresh depth frame", "the camera sends no frames"]
    for stop in stops:
        assert held_s[0] < stop.begin_s <= stop.end_s < held_s[1] + 0.3
        assert stop.pose is not None
        assert np.hypot(*(stop.pose - NEAR.pose)[:2]) < 0.7


def test_where_the_robot_stopped_by_itself_is_kept_beside_what_the_monitor_held() -> None:
    drive, robot, config = rehearsed_drive()

    def stopped(command):
        events = DrawnRobot.step(robot, command)
        robot.stop_reason = "no ticks come" if 1.0 < robot.now_s < 1.6 else ""
        return [one for one in events if not (1.0 < robot.now_s < 2.0 and hasattr(one, "depth_m"))]

    robot.step = stopped  # type: ignore[method-assign]
    assert drive.go_to(NEAR, lambda feedback: None)
    stops = [one for one in recorded(drive, config).stops if one.end_s > 1.0]
    assert sorted(one.reason for one in stops) == [
        "no fresh depth frame",
        "the camera sends no frames",
        "the robot stopped by itself: no ticks come",
    ]
    (own,) = [one for one in stops if "itself" in one.reason]
    assert 1.0 < own.begin_s < own.end_s < 1.65


def test_a_goal_without_a_name_is_called_by_its_coordinates() -> None:
    assert NamedGoal.of((1.0, -2.0)).name == "(1.00, -2.00) m"
    assert NamedGoal.of(np.array([1.0, -2.0, np.pi / 2])).name == "(1.00, -2.00) m, 90°"


@pytest.mark.parametrize("pose", [(1.0,), (np.inf, 0.0, 0.0)])
def test_what_is_no_goal_is_refused_and_the_robot_stands(pose: tuple[float, ...]) -> None:
    drive, robot, _ = rehearsed_drive()
    with pytest.raises(ArgumentError, match="a goal of"):
        drive.go_to(NamedGoal(np.array(pose), "nowhere"), lambda feedback: None)
    assert robot.now_s == 0.0


def test_without_a_map_there_is_no_drive() -> None:
    robot = rehearsed_drive()[1]
    with (
        pytest.raises(ConfigError, match="there is no map to drive in"),
        drive_in_map(robot, load_config(), in_step=True) as drive,
    ):
        assert isinstance(drive, GoalDrive)


class TakenError(Exception):
    """The navigator that a drive would make."""


@pytest.mark.parametrize("explores", [False, True])
def test_a_drive_takes_a_planner_and_a_controller_of_the_user(
    explores: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: dict[str, object] = {}

    def navigator(*_: object, **named: object) -> None:
        taken.update(named)
        raise TakenError

    monkeypatch.setattr(drives, "Navigator", navigator)
    own: dict[str, Any] = {"planner": object(), "controller": object(), "in_step": True}
    overrides = {"odometry": "wheels,dense"}
    if explores:
        config = load_config(overrides=overrides | {"loops.source": "keyframes"})
        made = drives.exploring(DrawnRobot(CALIBRATION), config, tmp_path / "map", **own)
    else:
        write_map(tmp_path / "home", 5)
        monkeypatch.setattr(drives, "occupancy_of", lambda *_, **__: drawn_room())
        with closing(MapFolder.open(tmp_path / "home")) as folder:
            robot = DrawnRobot(
                replace(folder.calibration, wheels=CALIBRATION.wheels, T_base_camera=CALIBRATION.T_base_camera)
            )
        config = load_config(overrides=overrides | {"known_map.path": str(tmp_path / "home")})
        made = drives.drive_in_map(robot, config, **own)
    with pytest.raises(TakenError), made:
        pass
    assert (taken["planner"], taken["controller"]) == (own["planner"], own["controller"])


def fed_back(
    state: NavigationState = NavigationState.DRIVING,
    asked: tuple[float, float] = (0.5, 0.0),
    measured: tuple[float, float] = (0.5, 0.0),
    reason: MonitorReason | None = None,
    **more: Any,
) -> Feedback:
    does = MonitorState.FREE if reason is None else MonitorState.SLOWED
    monitor = MonitorResult(VelocityCommand(*asked), does if any(asked) or not reason else MonitorState.STOPPED, reason)
    facts: dict[str, Any] = {"status": Status.TRACKING, "doing": "the kitchen", "to_go_m": 5.0, **more}
    return Feedback(
        1.0, state, facts["status"], None, *measured, None, facts["to_go_m"], None, np.empty((0, 3)), monitor,
        facts["doing"], 1, facts.get("robot_stop", ""),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("feedback", "cause"),
    [
        (fed_back(asked=(0.7, 0.0), measured=(0.66, 0.0)), TimeCause.FULL_SPEED),
        (fed_back(asked=(0.4, 0.0), measured=(0.3, 0.0)), TimeCause.GAINS_SPEED),
        (fed_back(asked=(0.3, 0.0), measured=(0.31, 0.0), to_go_m=0.3), TimeCause.BRAKES),
        (fed_back(asked=(0.4, 0.3), measured=(0.4, 0.3)), TimeCause.CAREFUL),
        (fed_back(asked=(0.0, 0.5), measured=(0.0, 0.5)), TimeCause.TURNS),
        (fed_back(asked=(0.0, 0.5), reason=MonitorReason.NOT_SEEN_LATELY), TimeCause.TURNS),
        (fed_back(asked=(0.2, 0.0), reason=MonitorReason.NOT_SEEN_LATELY), TimeCause.NOT_SEEN_LATELY),
        (fed_back(asked=(0.0, 0.0), reason=MonitorReason.NEVER_SEEN), TimeCause.NEVER_SEEN),
        (fed_back(asked=(0.3, 0.0), reason=MonitorReason.IN_ZONE), TimeCause.OBSTACLE),
        (fed_back(asked=(0.0, 0.0), reason=MonitorReason.NO_FRAME), TimeCause.SENSORS),
        (fed_back(robot_stop="its button"), TimeCause.SENSORS),
        (fed_back(asked=(0.3, 0.0), reason=MonitorReason.UNCONFIRMED), TimeCause.LOCALIZATION),
        (fed_back(NavigationState.RECOVERING, status=Status.LOST), TimeCause.LOCALIZATION),
        (fed_back(NavigationState.RECOVERING), TimeCause.RECOVERY),
        (fed_back(NavigationState.PLANNING, (0.0, 0.0)), TimeCause.PLANNING),
        (fed_back(NavigationState.PLANNING, (0.0, 0.0), doing="explore"), TimeCause.EXPLORING),
        (fed_back(NavigationState.ARRIVED, (0.0, 0.0)), TimeCause.STANDS),
    ],
)
def test_a_period_has_the_cause_that_a_person_would_name(feedback: Feedback, cause: TimeCause) -> None:
    assert time_cause(feedback, RobotLimits(forward_m_s=0.7)) is cause
