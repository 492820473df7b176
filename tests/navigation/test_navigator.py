"""Navigator: it arrives, goes round what the map does not know, and stands with a reason whenever it cannot go on."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from navigation.rooms import Ride, is_near
from patched import patched

from benchmarks.plain_rooms import Walls, walls_about
from wheelsight.app.run.drive_record import status_words
from wheelsight.core.errors import ArgumentError
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import se3
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.navigation import (
    BehaviourSettings,
    NavigationReason,
    NavigationSettings,
    NavigationState,
    NavigatorSettings,
    PlanningResult,
    WorkerInStep,
)
from wheelsight.navigation.controllers import ControlReason, ControlResult, MotionState, PurePursuitController
from wheelsight.navigation.planner import Plan
from wheelsight.navigation.planning import PlannerClient, PoseGoals

constants = patched({"behaviours._LOOK": (0.2, -0.4, 0.2), "behaviours._SEARCH_RAD": 0.3})
SIZE_M = (8.0, 6.0)
ROOM = walls_about(*SIZE_M)
BESIDE = (1.5, 3.0, 0.0)
GOAL = (6.0, 3.0, 0.0)
NEAR = (3.5, 3.0, 0.0)
# A wall across with a door in its middle.
DIVIDED = (*ROOM, ((4.0, 0.0), (4.0, 2.3)), ((4.0, 3.7), (4.0, 6.0)))
SHUT = (*ROOM, ((4.0, 0.0), (4.0, 6.0)))
HASTY = NavigationSettings(
    controller="pure_pursuit",
    navigator=NavigatorSettings(tries=1, held_s=1.0, lost_s=4.0),
    behaviours=BehaviourSettings(wait_s=0.5),
)


def ride(walls: tuple = ROOM, mapped: tuple | None = None, settings: NavigationSettings | None = None) -> Ride:
    known = None if mapped is None else Walls.of(*mapped)
    return Ride.of(Walls.of(*walls), BESIDE, SIZE_M, known, settings)


def whole_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the robot turn as far as it does outside of these tests."""
    monkeypatch.setattr("wheelsight.navigation.behaviours._LOOK", (1.0, -2.0, 1.0))
    monkeypatch.setattr("wheelsight.navigation.behaviours._SEARCH_RAD", 6.4)


@pytest.mark.parametrize("controller", ["mppi", "pure_pursuit"])
def test_it_arrives_and_says_how(controller: str) -> None:
    subject = ride(DIVIDED, settings=NavigationSettings(controller=controller))
    subject.navigator.go_to_pose((6.0, 4.0, np.pi / 2))
    subject.go(60)
    result = not_none(subject.navigator.result)
    assert result
    assert result.has_arrived
    assert result.reason is None
    assert is_near(subject.robot.base.pose, (6.0, 4.0, np.pi / 2))
    assert subject.states[:2] == ["planning", "driving"]
    assert subject.states[-1] == "arrived"
    assert result.planned_m == pytest.approx(result.way_m, rel=0.15)
    assert subject.clearance_m > 0.04
    assert subject.robot.base.stands


def test_what_the_map_does_not_know_is_gone_round() -> None:
    box = (((3.6, 2.5), (3.6, 3.3)), ((4.2, 2.5), (4.2, 3.3)), ((3.6, 2.5), (4.2, 2.5)), ((3.6, 3.3), (4.2, 3.3)))
    subject = ride((*ROOM, *box), mapped=ROOM)
    subject.navigator.go_to_pose(GOAL)
    subject.go(90)
    assert not_none(subject.navigator.result).has_arrived
    assert is_near(subject.robot.base.pose, GOAL)
    assert subject.clearance_m > 0.02
    assert not_none(subject.navigator.result).plans > 1


def somebody_at(x_m: float, y_m: float) -> tuple:
    """A square of 0.4 m."""
    corners = [(x_m + dx, y_m + dy) for dx, dy in ((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2))]
    return tuple(zip(corners, corners[1:] + corners[:1], strict=True))


@pytest.mark.parametrize("stops", [False, True])
def test_who_crosses_the_way_is_no_reason_for_another_plan_and_who_stops_in_it_is(stops: bool) -> None:
    subject = ride(ROOM, mapped=ROOM)
    subject.navigator.go_to_pose(GOAL)
    nearest_m = np.inf

    def walks() -> bool:
        nonlocal nearest_m
        y_m = 1.0 + 0.8 * subject.robot.now_s
        y_m = min(y_m, 3.0) if stops else y_m
        subject.robot.walls = Walls.of(*ROOM, *(somebody_at(4.0, y_m) if y_m < 5.5 else ()))
        nearest_m = min(nearest_m, float(np.hypot(*(subject.robot.base.pose[:2] - (4.0, y_m)))))
        return False

    subject.go(90, until=walks)
    result = not_none(subject.navigator.result)
    assert result.has_arrived
    assert subject.clearance_m > 0.02
    assert nearest_m < 2.5
    in_way = [one for one in result.transitions if one.why == "something is in the way"]
    assert bool(in_way) is stops


@pytest.mark.parametrize("leaves", [True, False])
def test_who_stands_where_it_is_to_go_is_waited_for_once(leaves: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """If he leaves it goes there; if not, it stands beside the goal, has not arrived, and says by how much."""
    whole_looks(monkeypatch)
    goal = (5.0, 3.0, 0.0)
    subject = ride((*ROOM, *somebody_at(5.9, 3.0)), mapped=ROOM)
    subject.navigator.go_to_pose(goal)
    subject.go(60, until=lambda: subject.navigator.feedback.doing.startswith("wait until there is room"))
    assert not subject.navigator.is_task_complete()
    beside = subject.robot.base.pose.copy()
    assert not is_near(beside, goal, off_m=0.05)
    if leaves:
        subject.robot.walls = Walls.of(*ROOM)
    yaws: list[float] = []

    def looks() -> bool:
        yaws.append(float(subject.robot.base.pose[2]))
        return not subject.navigator.feedback.doing.startswith("wait until there is room")

    subject.go(60, until=looks)
    assert max(yaws) > beside[2] + 0.5
    assert min(yaws) < beside[2] - 0.5
    subject.go(60)
    result = not_none(subject.navigator.result)
    assert result.has_arrived is leaves
    assert bool(result.goal_change) is not leaves
    if not leaves:
        assert result.reason is NavigationReason.BESIDE
        off = not_none(re.search(r"the robot does not fit at the goal: ([\d.]+) m and \d+° beside it", result.detail))
        assert 0.1 < float(off[1]) < 0.5
    assert bool(is_near(subject.robot.base.pose, goal if leaves else beside.tolist(), off_m=0.05))
    assert sum(transition.why.startswith("wait until there is room") for transition in result.transitions) == 1


def test_behind_a_shut_door_it_says_that_no_way_leads_there() -> None:
    subject = ride(SHUT, mapped=SHUT, settings=HASTY)
    subject.navigator.go_to_pose(GOAL)
    subject.go(20)
    result = not_none(subject.navigator.result)
    assert not result
    assert result.reason is NavigationReason.NO_PLAN
    assert subject.robot.base.stands


def test_a_door_that_the_map_has_open_and_somebody_shut_is_found_shut() -> None:
    impatient = HASTY.navigator.model_copy(update={"patience_s": 10.0})
    subject = ride(SHUT, mapped=DIVIDED, settings=HASTY.model_copy(update={"navigator": impatient}))
    subject.navigator.go_to_pose(GOAL)
    subject.go(60)
    result = not_none(subject.navigator.result)
    assert result.reason in (NavigationReason.NO_PLAN, NavigationReason.BLOCKED)
    assert result.recoveries > 0
    assert subject.clearance_m > 0.02
    assert subject.robot.base.pose[0] < 4.0


class OneAfterAnother(PoseGoals):
    """Goes on without a goal that is not reached."""

    def missed(self) -> bool:
        self.reached()
        return bool(self.left)


@pytest.mark.parametrize("goes_on", [True, False])
def test_a_goal_that_the_controller_finds_no_way_to_is_left_where_the_task_may_go_on(
    monkeypatch: pytest.MonkeyPatch, goes_on: bool
) -> None:
    command = PurePursuitController.command

    def blocked(subject: PurePursuitController, state: MotionState, plan: Plan, *seen: Any) -> ControlResult:
        is_far = plan.goal[0] > NEAR[0] + 1
        return ControlResult.standing(ControlReason.BLOCKED) if is_far else command(subject, state, plan, *seen)

    monkeypatch.setattr(PurePursuitController, "command", blocked)
    subject = ride(settings=HASTY)
    subject.navigator.begin((OneAfterAnother if goes_on else PoseGoals)([GOAL, NEAR]))
    subject.go(60)
    result = not_none(subject.navigator.result)
    assert result.has_arrived == goes_on
    assert is_near(subject.robot.base.pose, NEAR if goes_on else BESIDE, off_m=0.3)
    assert result.recoveries > 0
    assert any("on without what is there" in change.why for change in result.transitions) == goes_on
    assert goes_on or result.reason is NavigationReason.BLOCKED


@pytest.mark.parametrize("goal", [(np.nan, 1.0, 0.0), (1.0,), (1.0, 2.0, np.inf)])
def test_no_pose_is_no_goal(goal: tuple[float, ...]) -> None:
    subject = ride()
    with pytest.raises(ArgumentError, match="goal"):
        subject.navigator.go_to_pose(goal)
    assert subject.navigator.state is NavigationState.IDLE


def test_a_goal_outside_of_the_map_is_refused_at_once() -> None:
    subject = ride()
    subject.navigator.go_to_pose((20.0, 3.0))
    subject.go(5)
    result = not_none(subject.navigator.result)
    assert result.reason is NavigationReason.NO_PLAN
    assert "outside the map" in result.detail
    assert result.time_s < 1


def test_called_off_it_brakes_and_says_so() -> None:
    subject = ride()
    subject.navigator.go_to_pose(GOAL)
    subject.go(3)
    assert subject.robot.base.forward_m_s > 0.3
    subject.navigator.cancel_task()
    subject.go(3)
    assert not_none(subject.navigator.result).reason is NavigationReason.CANCELED
    assert subject.robot.base.stands


def test_another_goal_calls_off_the_one_before() -> None:
    subject = ride()
    subject.navigator.go_to_pose(GOAL)
    subject.go(2)
    subject.navigator.go_to_pose((2.5, 3.0))
    subject.go(40)
    assert not_none(subject.navigator.result).has_arrived
    assert np.hypot(*(subject.robot.base.pose[:2] - (2.5, 3.0))) < 0.12
    assert subject.states.count("failed") == 1


def test_lost_on_the_way_it_stands_and_goes_on_when_it_knows() -> None:
    subject = ride(settings=HASTY)
    subject.navigator.go_to_pose(GOAL)
    subject.go(3)
    lost_s = subject.robot.now_s

    def says(estimate: Estimate) -> Estimate:
        is_lost = estimate.stamp_s < lost_s + 3.0
        return replace(estimate, status=Status.LOST, T_odom_body=None, covariance=None) if is_lost else estimate

    subject.localization.says = says
    subject.go(2)
    assert subject.robot.base.stands
    assert subject.navigator.state is NavigationState.RECOVERING
    subject.go(60)
    assert not_none(subject.navigator.result).has_arrived


def test_of_a_place_that_is_known_too_badly_it_looks_about_and_gives_up_as_when_lost() -> None:
    """As before a bare wall, on wheels alone, after the camera and they have disagreed."""
    subject = ride(settings=HASTY)
    subject.navigator.go_to_pose(GOAL)
    subject.go(2)
    vague = np.diag([4.0, 4.0, 1e-6, 1e-6, 1e-6, 0.01])
    subject.localization.says = lambda estimate: replace(estimate, status=Status.COASTING, covariance=vague)
    subject.go(30)
    result = not_none(subject.navigator.result)
    assert result.reason is NavigationReason.LOST
    assert any("look for a known place" in change.why for change in result.transitions)
    assert subject.robot.base.stands


def by(status: Status, sigma_m: float = 1e-3, off_m: float = 0.0) -> Callable[[Estimate], Estimate]:
    """A localization that states a covariance in the map, and errs to the side by `off_m`."""
    C, T_map_odom = np.diag([sigma_m**2] * 3 + [1e-6] * 3), se3.from_plane(0.0, off_m, 0.0)
    return lambda estimate: replace(estimate, status=status, covariance_map=C, T_map_odom=T_map_odom)


def test_while_its_start_is_not_confirmed_it_drives_slowly_and_has_not_arrived() -> None:
    """It looks around at the goal; what it sees there refutes its place, and it gives up."""
    subject = ride(settings=HASTY)
    subject.localization.says = by(Status.UNCONFIRMED)
    subject.navigator.go_to_pose(NEAR)
    fastest_m_s = 0.0

    def looks() -> bool:
        nonlocal fastest_m_s
        fastest_m_s = max(fastest_m_s, subject.navigator.feedback.forward_m_s)
        return subject.navigator.state is NavigationState.RECOVERING

    subject.go(60, until=looks)
    assert subject.navigator.state is NavigationState.RECOVERING
    assert 0.1 < fastest_m_s < subject.navigator.settings.monitor.coasting_m_s + 0.02
    assert np.hypot(*(subject.robot.base.pose[:2] - NEAR[:2])) < 0.12
    subject.localization.says = by(Status.INITIALIZING)
    subject.go(30)
    result = not_none(subject.navigator.result)
    assert (result.has_arrived, result.reason) == (False, NavigationReason.LOST)
    assert subject.robot.base.stands


def test_at_a_goal_that_is_confirmed_while_it_looks_around_it_has_arrived() -> None:
    subject = ride(settings=HASTY)
    subject.localization.says = by(Status.UNCONFIRMED)
    subject.navigator.go_to_pose(NEAR)
    subject.go(40, until=lambda: subject.navigator.state is NavigationState.RECOVERING)
    subject.localization.says = by(Status.TRACKING)
    subject.go(40)
    assert not_none(subject.navigator.result).has_arrived


def test_a_plan_that_was_requested_just_before_the_goal_is_dropped_where_it_looks_around(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Else no decision takes the plan, and it counts as one that the planner never makes."""
    worker: WorkerInStep[PlanningResult] = WorkerInStep(0.1)
    subject = Ride.of(Walls.of(*ROOM), BESIDE, SIZE_M, None, HASTY, worker)
    subject.localization.says = by(Status.TRACKING, sigma_m=0.1)
    subject.navigator.go_to_pose(NEAR)
    subject.go(40, until=lambda: np.hypot(*(subject.robot.base.pose[:2] - NEAR[:2])) < 0.12)
    assert subject.navigator.state is NavigationState.DRIVING
    monkeypatch.setattr(PlannerClient, "is_silent", lambda self, now_s: False)  # the request is not the client's
    worker.ask(lambda: PlanningResult(None, np.zeros(3)), subject.robot.now_s + 60.0)
    subject.go(40, until=lambda: subject.navigator.state is NavigationState.RECOVERING)
    assert not worker.is_asked
    subject.go(60)
    assert not_none(subject.navigator.result).reason is NavigationReason.UNSURE


def test_a_pose_that_is_corrected_by_the_look_around_moves_the_robot_to_the_goal() -> None:
    subject = ride(settings=HASTY)
    subject.localization.says = by(Status.TRACKING, sigma_m=0.1, off_m=0.2)
    subject.navigator.go_to_pose(NEAR)
    subject.go(40, until=lambda: subject.navigator.state is NavigationState.RECOVERING)
    assert np.hypot(*(subject.robot.base.pose[:2] - NEAR[:2])) > 0.15
    subject.localization.says = by(Status.TRACKING)
    subject.go(60)
    assert not_none(subject.navigator.result).has_arrived
    assert np.hypot(*(subject.robot.base.pose[:2] - NEAR[:2])) < 0.12


def test_a_pose_that_stays_uncertain_is_no_arrival_and_it_says_how_far_off_it_may_be() -> None:
    subject = ride(settings=HASTY)
    subject.localization.says = by(Status.TRACKING, sigma_m=0.1)
    subject.navigator.go_to_pose(NEAR)
    subject.go(60)
    result = not_none(subject.navigator.result)
    assert (result.has_arrived, result.reason) == (False, NavigationReason.UNSURE)
    assert re.search(r"it may be 0\.2\d m and \d° off the goal", result.detail)
    assert result.recoveries == 1


def test_a_warning_about_a_sensor_is_reported_with_the_status() -> None:
    subject = ride(settings=HASTY)
    subject.navigator.go_to_pose(NEAR)
    subject.go(1)
    assert status_words(subject.navigator.feedback) == "knows where it is"
    subject.localization.warnings = ("the gyroscope was left out", "the left wheel was left out")
    subject.go(1)
    assert subject.navigator.feedback.warnings == subject.localization.warnings
    assert status_words(subject.navigator.feedback) == "knows where it is; the left wheel was left out"


def test_lost_for_good_it_gives_up() -> None:
    subject = ride(settings=HASTY)
    subject.navigator.go_to_pose(GOAL)
    subject.go(2)
    subject.localization.says = lambda estimate: replace(
        estimate, status=Status.LOST, T_odom_body=None, covariance=None
    )
    subject.go(30)
    assert not_none(subject.navigator.result).reason is NavigationReason.LOST
    assert subject.robot.base.stands


def test_not_yet_in_the_map_it_turns_to_look(monkeypatch: pytest.MonkeyPatch) -> None:
    whole_looks(monkeypatch)
    subject = ride()
    subject.localization.says = lambda estimate: replace(estimate, status=Status.INITIALIZING)
    subject.navigator.go_to_pose(NEAR)
    subject.go(6)
    assert subject.navigator.state is NavigationState.RECOVERING
    assert abs(subject.robot.base.pose[2]) > 0.5
    assert np.hypot(*(subject.robot.base.pose[:2] - BESIDE[:2])) < 0.05
    subject.localization.says = lambda estimate: estimate
    subject.go(60)
    assert not_none(subject.navigator.result).has_arrived


def test_begun_before_a_wall_that_leaves_no_room_to_turn_it_backs_up_to_look(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.navigation.behaviours._REFUSED_S", 0.5)
    face_m = BESIDE[0] + 0.9
    subject = ride((*ROOM, ((face_m, 2.0), (face_m, 4.0))), settings=NavigationSettings())
    subject.localization.says = lambda estimate: replace(estimate, status=Status.INITIALIZING)
    subject.navigator.go_to_pose(BESIDE[:2])
    subject.go(15, until=lambda: abs(subject.robot.base.pose[2]) > 1.0)
    assert abs(subject.robot.base.pose[2]) > 1.0
    assert subject.clearance_m > 0.04


def test_wheels_that_do_something_else_end_it() -> None:
    subject = ride()
    subject.navigator.go_to_pose(GOAL)
    subject.go(2)
    subject.robot.obeys = lambda command: VelocityCommand(command.forward_m_s, command.turn_rad_s + 0.8)
    subject.go(6)
    assert not_none(subject.navigator.result).reason is NavigationReason.DISOBEYS


def test_a_robot_that_stops_by_itself_ends_it() -> None:
    subject = ride(settings=HASTY)
    subject.navigator.go_to_pose(GOAL)
    subject.go(2)
    subject.robot.stop_reason, subject.robot.obeys = "its battery is empty", lambda command: STOP
    subject.go(10)
    result = not_none(subject.navigator.result)
    assert result.reason in (NavigationReason.ROBOT_STOPPED, NavigationReason.DISOBEYS)
    assert subject.robot.base.stands


def test_a_robot_that_stopped_by_itself_for_a_moment_goes_on() -> None:
    subject = ride(settings=HASTY)
    subject.navigator.go_to_pose(GOAL)
    subject.go(10, until=lambda: subject.robot.base.forward_m_s > 0.8)
    assert subject.robot.base.forward_m_s > 0.8

    def stands_until_reported(command: VelocityCommand) -> VelocityCommand:
        if command.is_stop:
            subject.robot.stop_reason = ""
        if not subject.robot.stop_reason:
            return command
        # At twice its limits' braking, as without the motors' voltage.
        subject.robot.base.forward_m_s = max(subject.robot.base.forward_m_s - 0.05, 0.0)
        return STOP

    subject.robot.stop_reason, subject.robot.obeys = "no wheel readings come", stands_until_reported
    subject.go(60)
    assert not_none(subject.navigator.result).has_arrived


def test_a_camera_that_dies_stops_it() -> None:
    subject = ride(settings=HASTY)
    subject.navigator.go_to_pose(GOAL)
    subject.go(2)
    subject.robot.has_camera = False
    before = subject.robot.base.pose.copy()
    subject.go(40)
    assert not not_none(subject.navigator.result).has_arrived
    assert np.hypot(*(subject.robot.base.pose - before)[:2]) < 1.2


def test_where_encoders_died_it_does_not_wait_for_ever() -> None:
    subject = ride(settings=HASTY)
    subject.navigator.go_to_pose(GOAL)
    subject.go(2)
    subject.robot.has_wheels = False
    result = subject.navigator.run()
    assert not result.has_arrived
    assert subject.robot.base.stands


def test_a_localization_that_fails_ends_it() -> None:
    subject = ride()
    subject.navigator.go_to_pose(GOAL)
    subject.go(2)

    def says(estimate: Estimate) -> Estimate:
        raise ArgumentError("depth of another size", fix="give it")

    subject.localization.says = says
    subject.go(5)
    result = not_none(subject.navigator.result)
    assert result.reason is NavigationReason.LOCALIZATION
    assert "depth of another size" in result.detail
    assert subject.robot.base.stands


def test_several_goals_one_after_another() -> None:
    subject = ride()
    subject.navigator.go_through_poses([(2.4, 2.7), (3.3, 3.2), (3.6, 4.0)])
    subject.go(90)
    assert not_none(subject.navigator.result).has_arrived
    assert np.hypot(*(subject.robot.base.pose[:2] - (3.6, 4.0))) < 0.12
    assert sum("a goal is reached" in transition.why for transition in subject.transitions) == 3


def test_a_recorded_way_is_followed_without_a_stop() -> None:
    subject = ride()
    turns = np.linspace(-np.pi / 2, np.pi / 4, 60)
    way = np.column_stack([2.0 + 1.2 * np.cos(turns), 3.0 + 1.2 * np.sin(turns), turns + np.pi / 2])
    subject.navigator.follow_way(way)
    driven: list[np.ndarray] = []

    def goes_on() -> bool:
        driven.append(subject.robot.base.pose.copy())
        return False

    subject.go(90, until=goes_on)
    assert not_none(subject.navigator.result).has_arrived
    farthest = max(float(np.hypot(*(np.array(driven)[:, :2] - point).T).min()) for point in way[:, :2])
    assert farthest < 0.35


def test_feedback_shows_how_far_it_is() -> None:
    subject = ride()
    subject.navigator.go_to_pose(GOAL)
    subject.go(2)
    first = subject.navigator.feedback
    subject.go(2)
    second = subject.navigator.feedback
    assert not_none(second.to_go_m) < not_none(first.to_go_m) < 5
    assert second.state is NavigationState.DRIVING
    assert second.goals_left == 1
    assert len(second.predicted)


class Found(PoseGoals):
    """Poses that the task found by itself."""

    is_asked_for = False


def test_where_no_one_asked_for_a_place_it_is_the_same_beside_it() -> None:
    subject = ride((*ROOM, *somebody_at(5.9, 3.0)), mapped=ROOM)
    subject.navigator.begin(Found([(5.0, 3.0, 0.0)]))
    subject.go(60)
    result = not_none(subject.navigator.result)
    assert result.has_arrived
    assert result.recoveries == 0
    assert result.goal_change == ""
