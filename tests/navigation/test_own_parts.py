"""A planner and a controller of a user's own lead the robot; limits, collision monitor and reasons stay ours."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from navigation.rooms import Ride, StandInLocalization, is_near

from benchmarks.plain_rooms import RoomRobot, Walls, walls_about
from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import VelocityCommand
from wheelsight.navigation import (
    ControlReason,
    ControlResult,
    KnownFloor,
    NavigationReason,
    NavigationSettings,
    Navigator,
    NavigatorSettings,
    Plan,
    PlanFailure,
    PlanReason,
    WorkerBeside,
)
from wheelsight.navigation.planner import OwnPlanner

SIZE_M = (8.0, 6.0)
ROOM = walls_about(*SIZE_M)
SHUT = (*ROOM, ((4.0, 0.0), (4.0, 6.0)))
START, GOAL = (1.5, 3.0, 0.0), (6.0, 3.0, 0.0)
HASTY = NavigationSettings(controller="pure_pursuit", navigator=NavigatorSettings(tries=1, held_s=1.0))
# A navigator that soon takes a robot that comes no farther for blocked.
LOITERING = NavigationSettings(
    controller="pure_pursuit", navigator=NavigatorSettings(tries=1, held_s=1.0, patience_s=5.0)
)


class Straight:
    """A planner that knows no walls."""

    def plan(self, costmap: Any, start: FloatArray, goal: FloatArray) -> Plan | PlanFailure:
        return Plan.along([start[:2], goal[:2]], None if len(goal) < 3 else float(goal[2]))


class Answers:
    """A part that answers what a test says."""

    def __init__(self, answer: Callable[[], Any]) -> None:
        self._answer, self.calls = answer, 0

    def plan(self, *of: Any) -> Any:
        self.calls += 1
        return self._answer()

    def command(self, *of: Any) -> Any:
        self.calls += 1
        return self._answer()


def fails() -> Any:
    raise ValueError("no network")


def ride(walls: tuple, mapped: tuple | None = None, settings: NavigationSettings = HASTY, **parts: Any) -> Ride:
    robot, transitions = RoomRobot(Walls.of(*walls), START), list[Any]()
    localization, floor = StandInLocalization(robot), KnownFloor(Walls.of(*(mapped or walls)).grid(*SIZE_M))
    how: dict[str, Any] = {"trusts_floor": True, "on_transition": transitions.append}
    return Ride(robot, localization, Navigator(robot, localization, floor, settings, **how, **parts), transitions)


@pytest.mark.slow
def test_a_planner_of_a_users_own_leads_to_the_goal() -> None:
    class Round:
        """By way of a corner, which no planner of ours would take."""

        def plan(self, costmap: Any, start: FloatArray, goal: FloatArray) -> Plan | PlanFailure:
            via: list[Any] = [] if start[0] > 3 else [(3.5, 4.5)]
            return Plan.along([start[:2], *via, goal[:2]], float(goal[2]))

    subject, highest_m = ride(ROOM, planner=Round()), [0.0]

    def climbs() -> bool:
        highest_m.append(float(subject.robot.base.pose[1]))
        return False

    subject.navigator.go_to_pose(GOAL)
    subject.go(90, until=climbs)
    assert not_none(subject.navigator.result).has_arrived
    assert is_near(subject.robot.base.pose, GOAL)
    assert max(highest_m) == pytest.approx(4.5, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("is_mapped", [True, False])
def test_a_path_through_a_wall_ends_before_the_wall(is_mapped: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.navigation.navigator._LOITER_S", 5.0)
    subject = ride(SHUT, SHUT if is_mapped else ROOM, LOITERING, planner=Straight())
    subject.navigator.go_to_pose(GOAL)
    subject.go(120)
    result = not_none(subject.navigator.result)
    assert not result.has_arrived
    assert result.reason is NavigationReason.BLOCKED
    assert subject.clearance_m > 0.02
    assert subject.robot.base.stands


@pytest.mark.slow
def test_a_controller_that_drives_at_a_wall_is_stopped_by_the_monitor_and_kept_to_the_limits() -> None:
    class Ahead:
        def command(self, *of: Any) -> ControlResult:
            return ControlResult(VelocityCommand(9.0, 0.0))

    subject, speeds = ride(SHUT, ROOM, planner=Straight(), controller=Ahead()), [0.0]

    def drives() -> bool:
        speeds.append(subject.robot.base.forward_m_s)
        return False

    subject.navigator.go_to_pose(GOAL)
    subject.go(20, until=drives)
    limits = HASTY.limits
    assert 0.3 < max(speeds) <= limits.forward_m_s + 1e-6
    assert np.diff(speeds).max() <= limits.acceleration_m_s2 * 0.05 + 1e-6
    assert subject.clearance_m > 0.02


@pytest.mark.slow
def test_a_controller_of_a_users_own_arrives_and_one_that_only_says_so_does_not() -> None:
    class Creep:
        def command(self, state: Any, plan: Any, field: Any, people: Any) -> ControlResult:
            if np.hypot(*(plan.poses[-1, :2] - state.pose[:2])) < 0.08:
                return ControlResult.standing(ControlReason.ARRIVED)
            return ControlResult(VelocityCommand(0.3, 0.0))

    subject = ride(ROOM, controller=Creep())
    subject.navigator.go_to_pose(GOAL)
    subject.go(60)
    assert not_none(subject.navigator.result).has_arrived
    assert is_near(subject.robot.base.pose, GOAL)
    liar = ride(ROOM, controller=Answers(lambda: ControlResult.standing(ControlReason.ARRIVED)))
    liar.navigator.go_to_pose(GOAL)
    liar.go(60)
    result = not_none(liar.navigator.result)
    assert (result.has_arrived, result.reason) == (False, NavigationReason.BLOCKED)
    assert result.detail == ControlReason.MISSED
    assert is_near(liar.robot.base.pose, START)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (fails, "Answers.plan raised ValueError: no network"),
        (lambda: None, "Answers.plan answered NoneType, not a Plan or PlanFailure"),
        (lambda: Plan.along([(np.nan, 0), (1, 1)]), "Answers.plan raised ArgumentError: places of shape (2, 2)"),
        (lambda: plan_of(np.full((3, 3), np.nan)), "Answers.plan answered poses that are not finite"),
        (lambda: plan_of(np.zeros((3, 2))), "poses of shape (3, 2) and directions of shape (3,), not (N, 3) and (N,)"),
        (lambda: plan_of([["a", "b", "c"]]), "Answers.plan answered a plan without numbers"),
    ],
)
def test_a_planner_that_fails_ends_the_task_with_its_reason(answer: Callable[[], Any], why: str) -> None:
    subject = ride(ROOM, planner=Answers(answer))
    subject.navigator.go_to_pose(GOAL)
    subject.go(20)
    result = not_none(subject.navigator.result)
    assert result.reason is NavigationReason.NO_PLAN
    assert result.detail.startswith(f"{PlanReason.PART}: ")
    assert why in result.detail
    assert is_near(subject.robot.base.pose, START)


def plan_of(poses: Any) -> Plan:
    return Plan(poses, np.ones(len(poses), np.int64), 1.0, 0.5, np.zeros(3), "", "map", 1.0, 0)


def test_a_planner_that_fails_in_its_thread_ends_the_task_too() -> None:
    with_worker = WorkerBeside[Any]("planner")
    try:
        subject = ride(ROOM, planner=Answers(fails), planning=with_worker)
        subject.navigator.go_to_pose(GOAL)
        subject.go(600)
    finally:
        with_worker.close()
    assert "raised ValueError: no network" in not_none(subject.navigator.result).detail


@pytest.mark.slow
def test_a_planner_that_fails_on_the_way_stops_the_robot() -> None:
    subject = ride(ROOM, planner=(planner := Straight()))
    subject.navigator.go_to_pose(GOAL)
    subject.go(60, until=lambda: bool(subject.robot.base.pose[0] > 3))
    planner.plan = fails  # type: ignore[assignment]
    subject.robot.walls = Walls.of(*ROOM, ((5.0, 2.0), (5.0, 4.0)))
    subject.go(60)
    result = not_none(subject.navigator.result)
    assert result.reason is NavigationReason.NO_PLAN
    assert subject.robot.base.stands
    assert subject.robot.base.pose[0] < 5
    assert subject.clearance_m > 0.02


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (fails, "Answers.command raised ValueError: no network"),
        (lambda: (0.1, 0.2), "Answers.command answered tuple, not a ControlResult"),
        (
            lambda: ControlResult(VelocityCommand(np.nan, 0.0)),
            "Answers.command raised ArgumentError: forward_m_s is nan",
        ),
        (lambda: ControlResult(VelocityCommand(0.1), None, np.zeros((2, 2))), "Answers.command: predicted is of shape"),
    ],
)
def test_a_controller_that_fails_stops_the_robot_with_a_reason(answer: Callable[[], Any], why: str) -> None:
    part = Answers(lambda: ControlResult(VelocityCommand(0.4)) if part.calls < 12 else answer())
    subject = ride(ROOM, controller=part)
    subject.navigator.go_to_pose(GOAL)
    subject.go(30)
    result = not_none(subject.navigator.result)
    assert result.reason is NavigationReason.CONTROLLER
    assert result.detail.startswith(why)
    assert subject.robot.base.stands
    assert START[0] + 0.01 < subject.robot.base.pose[0] < GOAL[0]


def test_what_is_no_part_is_refused_at_once() -> None:
    cases: tuple[tuple[str, Any, str], ...] = (
        ("planner", Straight, "planner is the class Straight, not an object with a method plan"),
        ("controller", Straight(), "controller is a Straight, not an object with a method command"),
    )
    for name, part, why in cases:
        with pytest.raises(ArgumentError, match=why):
            ride(ROOM, **{name: part})


def test_a_plan_of_few_places_is_as_dense_as_the_look_ahead_needs(rng: np.random.Generator) -> None:
    places = rng.uniform(0, 5, (6, 2))
    costmap: Any = type("Flat", (), {"frame": "odom"})()
    plan = OwnPlanner(Answers(lambda: Plan.along(places, yaw=3.0))).plan(
        costmap, places[0], np.array([*places[-1], 3.0])
    )
    assert isinstance(plan, Plan)
    steps = np.diff(plan.poses, axis=0)
    assert np.hypot(*steps[:, :2].T).max() <= 0.05 + 1e-9
    assert np.abs(np.angle(np.exp(1j * steps[:, 2]))).max() <= 0.1 + 1e-9
    drives = np.hypot(*steps[:, :2].T) > 1e-9
    headings = np.arctan2(steps[drives, 1], steps[drives, 0])
    np.testing.assert_allclose(np.cos(headings - plan.poses[1:][drives, 2]), 1, atol=1e-9)
    assert plan.length_m == pytest.approx(np.hypot(*np.diff(places, axis=0).T).sum())
    assert (plan.frame, plan.goal_change) == ("odom", "")
    np.testing.assert_allclose(plan.goal, [*places[-1], 3.0])


@pytest.mark.slow
def test_a_plan_that_ends_beside_the_goal_is_no_arrival() -> None:
    class Short:
        def plan(self, costmap: Any, start: FloatArray, goal: FloatArray) -> Plan | PlanFailure:
            return Plan.along([start[:2], goal[:2] - (0.6, 0.0)], float(goal[2]))

    subject = ride(ROOM, planner=Short())
    subject.navigator.go_to_pose(GOAL)
    subject.go(120)
    result = not_none(subject.navigator.result)
    assert result.reason is NavigationReason.BESIDE
    assert result.detail == "Short.plan leads beside the goal: 0.60 m and 0° beside it"
