"""What other programs ask is checked; a stick moves a robot while it is pushed, and never by itself after a stop."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from wheelsight.app.page.session import DriveByHand, GoToPose, SetPose, Task
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight_ros2 import Inputs, Stick

FORWARD = VelocityCommand(0.3, 0.1)
NOW_S = 1000.0


def message(**fields: Any) -> Any:
    """Of nested dictionaries, as a ROS message has fields."""
    made = {name: message(**value) if isinstance(value, dict) else value for name, value in fields.items()}
    return SimpleNamespace(**made)


def pose(x: float = 1.0, y: float = 2.0, qz: float = 0.0, qw: float = 1.0, qx: float = 0.0) -> dict[str, Any]:
    return {"position": {"x": x, "y": y, "z": 0.0}, "orientation": {"x": qx, "y": 0.0, "z": qz, "w": qw}}


def header(frame: str = "map", stamp_s: float = NOW_S) -> dict[str, Any]:
    return {"frame_id": frame, "stamp": {"sec": int(stamp_s), "nanosec": 0}}


@dataclass
class Recorded:
    """Stands for a session."""

    tasks: list[Task] = field(default_factory=list)
    stops: list[str] = field(default_factory=list)
    refusal: str = ""
    begun: Task | None = None

    def ask(self, task: Task) -> str:
        self.tasks.append(task)
        return self.refusal

    def stop(self, reason: str) -> None:
        self.stops.append(reason)


@pytest.fixture
def led() -> Recorded:
    return Recorded()


@pytest.fixture
def inputs(led: Recorded) -> Inputs:
    made = Inputs(lambda: NOW_S)
    made.lead(led)
    return made


def test_poses_become_tasks(inputs: Inputs, led: Recorded) -> None:
    half = math.sqrt(0.5)
    inputs.receive("/goal_pose", message(header=header(), pose=pose(qz=half, qw=half)))
    inputs.receive("/clicked_point", message(header=header(stamp_s=0.0), point={"x": 3.0, "y": -4.0, "z": 0.5}))
    inputs.receive("/initialpose", message(header=header("/map"), pose={"pose": pose(5, 6, -half, half)}))
    goal, clicked, initial = led.tasks
    assert isinstance(goal, GoToPose)
    assert (goal.x_m, goal.y_m) == (1.0, 2.0)
    assert goal.yaw_rad == pytest.approx(math.pi / 2)
    assert clicked == GoToPose(type="goal", x_m=3.0, y_m=-4.0)
    assert isinstance(initial, SetPose)
    assert initial.pose == pytest.approx([5, 6, -math.pi / 2])
    assert inputs.refused == ""


@pytest.mark.parametrize(
    ("topic", "said", "problem"),
    [
        ("/cmd_vel", {"linear": {"x": math.nan}, "angular": {"z": 0.0}}, "linear.x is nan"),
        ("/cmd_vel", {"linear": {"x": 0.1}, "angular": {"z": math.inf}}, "angular.z is inf"),
        ("/cmd_vel", {"linear": {"x": "fast"}, "angular": {"z": 0.0}}, "linear.x is fast"),
        ("/cmd_vel", {"linear": {"x": True}, "angular": {"z": 0.0}}, "linear.x is True"),
        ("/cmd_vel", {"linear": {"x": 0.1}}, "angular.z is missing"),
        ("/cmd_vel", {}, "linear.x is missing"),
        ("/goal_pose", {"header": header("odom"), "pose": pose()}, "header.frame_id is 'odom'"),
        ("/goal_pose", {"header": header(stamp_s=NOW_S - 60), "pose": pose()}, "header.stamp is 60.0 s old"),
        ("/goal_pose", {"header": header(stamp_s=NOW_S + 60), "pose": pose()}, "header.stamp is 60.0 s ahead"),
        ("/goal_pose", {"header": header(), "pose": pose(math.nan)}, "pose.position.x is nan"),
        ("/goal_pose", {"header": header(), "pose": pose(1e6)}, "pose.position.x is 1e+06"),
        ("/goal_pose", {"header": header(), "pose": pose(qw=0.0)}, "no unit quaternion"),
        ("/goal_pose", {"header": header(), "pose": pose(qw=0.0, qx=1.0)}, "orientation is tilted"),
        ("/initialpose", {"header": header(), "pose": pose()}, "pose.pose.position.x is missing"),
        (
            "/clicked_point",
            {"header": {"frame_id": "map"}, "point": {"x": 0.0, "y": 0.0}},
            "header.stamp.sec is missing",
        ),
    ],
)
def test_nonsense_is_refused_in_a_line_and_counted(
    inputs: Inputs, led: Recorded, topic: str, said: dict[str, Any], problem: str
) -> None:
    inputs.receive(topic, message(**said))
    assert problem in inputs.refused
    assert inputs.refused.startswith(f"{topic}: ")
    assert inputs.counts == {topic: 1}
    assert led.tasks == []


def test_a_message_that_is_nothing_is_refused(inputs: Inputs) -> None:
    inputs.receive("/cmd_vel", None)
    assert inputs.refused == "/cmd_vel: linear.x is missing"


def test_without_a_session_nothing_is_led() -> None:
    inputs = Inputs(lambda: NOW_S)
    inputs.receive("/goal_pose", message(header=header(), pose=pose()))
    assert "no robot is led here" in inputs.refused


def test_the_reason_of_a_session_is_reported(inputs: Inputs, led: Recorded) -> None:
    led.refusal = "too much was asked at once"
    inputs.receive("/goal_pose", message(header=header(), pose=pose()))
    assert inputs.refused == "/goal_pose: too much was asked at once"


def test_stop_stops(inputs: Inputs, led: Recorded) -> None:
    inputs.receive("/wheelsight/stop", message())
    assert led.stops == ["another program pressed stop"]


def twist(forward_m_s: float) -> Any:
    return message(linear={"x": forward_m_s, "y": 9.0}, angular={"z": 0.0})


def test_a_pushed_stick_asks_once(inputs: Inputs, led: Recorded) -> None:
    inputs.receive("/cmd_vel", twist(0.0))
    assert led.tasks == []
    for _ in range(500):
        inputs.receive("/cmd_vel", twist(0.2))
    (task,) = led.tasks
    assert isinstance(task, DriveByHand)
    assert task.commands() == VelocityCommand(0.2, 0.0)


class At:
    def __init__(self) -> None:
        self.s = 10.0

    def __call__(self) -> float:
        return self.s


@pytest.fixture
def at() -> At:
    return At()


def test_a_command_holds_for_a_quarter_of_a_second_and_driving_ends_after_one(at: At) -> None:
    stick = Stick(at)
    assert stick.push(FORWARD)
    for passed_s, expected in ((0.0, FORWARD), (0.25, FORWARD), (0.26, STOP), (1.0, STOP), (1.01, None), (5.0, None)):
        at.s = 10.0 + passed_s
        assert stick.commands() == expected
    assert stick.push(FORWARD)
    assert stick.commands() == FORWARD


def test_zeros_hold_the_robot_and_then_end(at: At) -> None:
    stick = Stick(at)
    assert stick.push(FORWARD)
    for _ in range(19):
        at.s += 0.05
        assert not stick.push(STOP)
        assert stick.commands() == STOP
    at.s += 0.06
    assert stick.commands() is None


def test_a_stick_that_stays_pushed_does_not_begin_again_after_its_task_was_ended(at: At) -> None:
    """As by STOP, or by a goal of the page: nothing follows its commands any more."""
    stick = Stick(at)
    assert stick.push(FORWARD)
    assert stick.commands() == FORWARD
    for _ in range(200):
        at.s += 0.05
        assert not stick.push(FORWARD)
    # Released for a moment, and pushed again.
    assert not stick.push(STOP)
    at.s += 0.05
    assert stick.push(FORWARD)


def test_gaps_of_a_bad_network_are_no_release(at: At) -> None:
    stick = Stick(at)
    assert stick.push(FORWARD)
    for _ in range(20):
        at.s += 0.9
        assert not stick.push(FORWARD)
    at.s += 1.1
    assert stick.push(FORWARD)


def test_commands_that_are_followed_need_no_other_task_after_a_zero(at: At) -> None:
    stick = Stick(at)
    assert stick.push(FORWARD)
    for command in (STOP, FORWARD, STOP, FORWARD):
        at.s += 0.05
        assert stick.commands() is not None
        assert not stick.push(command)
        assert stick.commands() == command
