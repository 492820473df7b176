"""A part that does not answer stops the robot; the task goes on where it answers within four seconds, or fails."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from narrowing import not_none
from rehearsed_drive import QUICK, T_BASE_CAMERA

from wheelsight.app.run.kernel_process import DrawnRobot, TrueLocalization, drawn_room
from wheelsight.app.run.kernels import WHEELS
from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import DeviceError
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import Event, RgbdFrame, VelocityCommand, WheelTicks
from wheelsight.core.robots import STOPPED
from wheelsight.navigation import KnownFloor, NavigationReason, NavigationState, Navigator, PlanningResult, WorkerInStep
from wheelsight.navigation.collision_monitor import MonitorReason, MonitorState
from wheelsight.navigation.settings import SILENT_S

THERE, BACK = (0.9, 0.5), (-1.3, -0.4)
# As in rehearsed drives, but small: frames are drawn for a minute of driving.
CAMERA = PinholeCamera(80, 60, 65.5, 65.0, 40.0, 30.0)
CALIBRATION = Calibration.registered_camera(CAMERA, wheels=WHEELS, T_base_camera=T_BASE_CAMERA, source="test")


class Robot(DrawnRobot):
    """In the drawn room; its left wheel may slip, its camera may fall silent, and its program may stand still."""

    def __init__(self) -> None:
        super().__init__(CALIBRATION)
        self.slip, self.is_camera_silent, self.gap_s = 0.0, False, 0.0
        self.rolled_m, self.stops = 0.0, list[float]()

    def step(self, command: VelocityCommand) -> list[Event]:
        if self.gap_s:  # the motors are stopped meanwhile, as `LinkRobot` does it
            self.now_s, self.gap_s = self.now_s + self.gap_s, 0.0
            self.stop_reason = "the program stood still"
        events = super().step(command)
        return [event for event in events if not (self.is_camera_silent and isinstance(event, RgbdFrame))]

    def stop(self) -> None:
        super().stop()
        self.stops.append(self.now_s)

    def roll(self, command: VelocityCommand) -> WheelTicks:
        before = self.pose
        ticks = super().roll(command)
        forward, turn = command.forward_m_s * (1 - self.slip / 2), command.turn_rad_s + self.slip * command.forward_m_s
        if self.slip:
            seconds, yaw = 0.025, before[2]
            self.pose = before + np.array([forward * np.cos(yaw), forward * np.sin(yaw), turn]) * seconds
        self.rolled_m += float(np.hypot(*(self.pose - before)[:2]))
        return ticks


class Place(TrueLocalization):
    """Says where the robot is until it falls silent; late by so many periods."""

    is_silent, late, fails = False, 0, False

    def __init__(self, robot: DrawnRobot) -> None:
        super().__init__(robot)
        self.waiting: list[list[tuple[Event, Estimate | None]]] = []

    def process(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        if self.fails:
            raise DeviceError("the localization process has ended by signal 9")
        if self.is_silent:
            return []
        self.waiting.append(super().process(events))
        return self.waiting.pop(0) if len(self.waiting) > self.late else []


class Planner(WorkerInStep[PlanningResult]):
    """A plan is asked for, and does not come, while it hangs."""

    hangs = False

    @property
    def is_asked(self) -> bool:
        return self.hangs or super().is_asked

    def has_answer(self, now_s: float) -> bool:
        return not self.hangs and super().has_answer(now_s)

    def answer(self, now_s: float) -> PlanningResult | None:
        return None if self.hangs else super().answer(now_s)


class Ride:
    """A robot, its parts and its navigator."""

    def __init__(self) -> None:
        self.robot = Robot()
        self.place, self.planner = Place(self.robot), Planner(0.1)
        settings = load_config(overrides=QUICK).navigation
        self.navigator = Navigator(
            self.robot, self.place, KnownFloor(drawn_room()), settings, planning=self.planner, trusts_floor=True
        )

    def go(self, until: Callable[[], bool], seconds: float = 60.0) -> None:
        ends_s = self.robot.now_s + seconds
        while not until():
            assert self.robot.now_s < ends_s, self.navigator.state
            self.navigator.step()

    def drive_off(self) -> None:
        """To where it is under way."""
        self.navigator.go_to_pose(THERE)
        self.go(lambda: self.navigator.feedback.forward_m_s > 0.3)


@pytest.fixture
def ride() -> Ride:
    made = Ride()
    made.drive_off()
    return made


def stands(ride: Ride) -> bool:
    return abs(ride.navigator.feedback.forward_m_s) < 1e-3 and abs(ride.navigator.feedback.turn_rad_s) < 1e-3


def assert_gives_up(ride: Ride, why: str) -> None:
    """After four seconds, without having moved meanwhile; nothing goes on by itself when the part is back."""
    stood = ride.robot.rolled_m
    ride.go(ride.navigator.is_task_complete, 5.0)
    result = not_none(ride.navigator.result)
    assert (result.has_arrived, result.reason) == (False, NavigationReason.SILENT)
    assert why in result.detail
    ride.place.is_silent = ride.robot.is_camera_silent = ride.planner.hangs = False
    for _ in range(60):
        ride.navigator.step()
    assert ride.robot.rolled_m == pytest.approx(stood, abs=1e-6)


def test_a_silent_localization_stops_the_robot(ride: Ride) -> None:
    """Its left wheel rolls less than its encoder says: wheels alone would lead it astray, and it would not know."""
    begin_s, begin_m = ride.robot.now_s, ride.robot.rolled_m
    ride.robot.slip, ride.place.is_silent = 0.2, True
    ride.go(lambda: ride.navigator.feedback.status is Status.COASTING, 0.3)
    ride.go(lambda: not_none(ride.navigator.feedback.monitor).reason is MonitorReason.LOCALIZATION_SILENT, 1.0)
    assert ride.robot.stops[0] - begin_s <= 0.5
    assert ride.robot.rolled_m - begin_m <= 0.25
    assert ride.navigator.feedback.status is Status.FAILING
    ride.go(lambda: stands(ride), 0.2)
    assert_gives_up(ride, "the localization does not answer, for 4 s")


@pytest.mark.slow
def test_no_further_goal_is_driven_to_without_localization(ride: Ride) -> None:
    ride.place.is_silent = True
    for goal in (THERE, BACK, THERE):
        ride.navigator.go_to_pose(goal)
        assert not ride.navigator.run()
    assert ride.robot.rolled_m < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("late", "status"), [(2, Status.TRACKING), (6, Status.COASTING)])
def test_a_late_localization_slows_the_robot(ride: Ride, late: int, status: Status) -> None:
    """By 0.1 s nothing changes; by 0.3 s it goes as where wheels alone lead, and does arrive."""
    ride.place.late = late
    ride.go(lambda: len(ride.place.waiting) == late)
    for _ in range(4):
        ride.navigator.step()
    assert ride.navigator.feedback.status is status
    assert ride.navigator.run()
    assert not ride.robot.stops


@pytest.mark.slow
@pytest.mark.parametrize("part", ["localization", "camera", "planner"])
def test_what_answers_again_within_four_seconds_goes_on(ride: Ride, part: str) -> None:
    silence(ride, part)
    ride.go(lambda: stands(ride), 3.0)
    for _ in range(40):
        ride.navigator.step()
    assert not ride.navigator.is_task_complete()
    ride.place.is_silent = ride.robot.is_camera_silent = ride.planner.hangs = False
    ride.go(ride.navigator.is_task_complete)
    assert ride.navigator.result
    assert np.hypot(*(ride.robot.pose[:2] - THERE)) < 0.15


def silence(ride: Ride, part: str) -> None:
    if part == "localization":
        ride.place.is_silent = True
    elif part == "camera":
        ride.robot.is_camera_silent = True
    else:
        ride.planner.hangs = True


def test_a_silent_camera_stops_the_robot(ride: Ride) -> None:
    begin_s, begin_m = ride.robot.now_s, ride.robot.rolled_m
    ride.robot.is_camera_silent = True
    ride.go(lambda: stands(ride), 1.0)
    assert ride.robot.now_s - begin_s <= SILENT_S + 0.2
    assert ride.robot.rolled_m - begin_m <= 0.3
    assert_gives_up(ride, "the camera sends no frames, for 4 s")


def test_a_planner_that_hangs_stops_the_robot(ride: Ride) -> None:
    silence(ride, "planner")
    begin_s = ride.robot.now_s
    ride.go(lambda: bool(ride.robot.stops), 1.0)
    assert ride.robot.stops[0] - begin_s <= 0.5
    ride.go(lambda: stands(ride), 0.2)
    assert_gives_up(ride, "the planner does not answer, for 4 s")


@pytest.mark.slow
def test_a_robot_that_waits_for_its_first_plan_gives_up_at_last() -> None:
    ride = Ride()
    ride.planner.hangs = True
    ride.navigator.go_to_pose(THERE)
    ride.go(ride.navigator.is_task_complete, 40.0)
    result = not_none(ride.navigator.result)
    assert (result.reason, ride.robot.rolled_m) == (NavigationReason.SILENT, 0.0)


def test_a_localization_that_fails_stops_the_motors_at_once(ride: Ride) -> None:
    ride.place.fails = True
    ride.navigator.step()
    assert ride.robot.stop_reason == STOPPED
    assert not_none(ride.navigator.result).reason is NavigationReason.LOCALIZATION
    stood = ride.robot.rolled_m
    for _ in range(20):
        ride.navigator.step()
    assert ride.robot.rolled_m == stood


@pytest.mark.parametrize(("gap_s", "goes_on"), [pytest.param(2.0, True, marks=pytest.mark.slow), (5.0, False)])
def test_a_program_that_stood_still_for_long_is_given_its_task_again(ride: Ride, gap_s: float, goes_on: bool) -> None:
    ride.robot.gap_s = gap_s
    ride.navigator.step()
    assert (ride.navigator.state is not NavigationState.FAILED) is goes_on
    if goes_on:
        assert ride.navigator.run()
    else:
        assert "the program stood still for 5.1 s" in not_none(ride.navigator.result).detail
        ride.go(lambda: stands(ride), 1.0)
        assert not_none(ride.navigator.feedback.monitor).state is not MonitorState.SLOWED


@pytest.mark.slow
def test_time_between_two_tasks_is_no_gap(ride: Ride) -> None:
    assert ride.navigator.run()
    ride.robot.now_s += 60.0
    ride.navigator.go_to_pose(BACK)
    ride.navigator.step()
    assert ride.navigator.state is not NavigationState.FAILED
