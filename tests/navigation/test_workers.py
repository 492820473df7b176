"""Workers: in step a time is charged, beside no one waits; and a robot drives on while its next plan is made."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from navigation.rooms import Ride, is_near
from navigation.test_floors import CHAIR, Seen

from benchmarks.plain_rooms import CALIBRATION, Walls, walls_about
from wheelsight.core.errors import MapError
from wheelsight.core.estimates import Estimate
from wheelsight.core.geometry import se3
from wheelsight.navigation import (
    GrowingFloor,
    MonitorReason,
    NavigationSettings,
    NavigationState,
    NavigatorSettings,
    PlanningResult,
    SeenFloor,
    WorkerBeside,
    WorkerInStep,
)

SIZE_M = (8.0, 6.0)
ROOM = walls_about(*SIZE_M)
BESIDE, GOAL = (1.5, 3.0, 0.0), (6.0, 3.0, 0.0)


class Held:
    """A worker whose answers wait until somebody lets them go."""

    def __init__(self) -> None:
        self.is_held, self.is_busy, self.asked = False, False, 0
        self._work: Callable[[], object] | None = None

    @property
    def is_asked(self) -> bool:
        return self._work is not None

    def ask(self, work: Callable[[], object], now_s: float) -> None:
        self._work, self.asked = work, self.asked + 1

    def has_answer(self, now_s: float) -> bool:
        return self._work is not None and not self.is_held

    def answer(self, now_s: float) -> object:
        if self._work is None or self.is_held:
            return None
        work, self._work = self._work, None
        return work()

    def drop(self) -> None:
        self._work = None

    def close(self) -> None:
        """No thread."""


class Slow:
    """A thread whose answers count 0.8 s of simulated time after the request."""

    def __init__(self, worker: WorkerBeside[PlanningResult]) -> None:
        self._worker, self._asked_s = worker, 0.0

    def ask(self, work: Callable[[], PlanningResult], now_s: float) -> None:
        self._asked_s = now_s
        self._worker.ask(work, now_s)

    def has_answer(self, now_s: float) -> bool:
        while now_s - self._asked_s >= 0.8 and self._worker.is_busy:
            time.sleep(0.001)
        return now_s - self._asked_s >= 0.8 and self._worker.has_answer(now_s)

    def answer(self, now_s: float) -> PlanningResult | None:
        return self._worker.answer(now_s) if self.has_answer(now_s) else None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._worker, name)


def ride(planning: object = None, **navigator: float) -> Ride:
    settings = NavigationSettings(controller="pure_pursuit", navigator=NavigatorSettings(**navigator))
    walls = Walls.of(*ROOM)
    subject = Ride.of(walls, BESIDE, SIZE_M, None, settings, planning)  # type: ignore[arg-type]
    subject.navigator.go_to_pose(GOAL)
    return subject


def reported(subject: WorkerBeside[int]) -> int:
    waiting = threading.Event()
    for _ in range(1000):
        answer = subject.answer(0.0)
        if answer is not None:
            return answer
        waiting.wait(0.01)
    raise AssertionError("no answer")


def test_in_step_the_time_that_it_takes_goes_by() -> None:
    subject: WorkerInStep[int] = WorkerInStep(0.15)
    subject.ask(lambda: 1, 2.0)
    assert subject.answer(2.1) is None
    assert subject.is_asked
    subject.ask(lambda: 2, 2.1)
    assert subject.answer(2.2) is None
    assert subject.answer(2.25) == 2
    assert subject.answer(2.3) is None
    subject.ask(lambda: 3, 3.0)
    subject.drop()
    assert subject.answer(9.0) is None


def test_beside_no_one_waits_and_the_newest_is_reported() -> None:
    begun, may_go, done = threading.Event(), threading.Event(), list[int]()

    def slowly() -> int:
        begun.set()
        assert may_go.wait(10)
        return 1

    def work(number: int) -> int:
        done.append(number)
        return number

    with closing(WorkerBeside[int]("a test")) as subject:
        subject.ask(slowly, 0.0)
        assert begun.wait(10)
        assert subject.answer(0.0) is None
        subject.ask(lambda: work(2), 0.0)
        subject.ask(lambda: work(3), 0.0)
        assert subject.is_busy
        may_go.set()
        assert reported(subject) == 3
        assert done == [3]
        assert not subject.is_asked
        assert not subject.is_busy


def test_what_is_not_wanted_any_more_is_not_reported() -> None:
    begun, may_go = threading.Event(), threading.Event()

    def slowly() -> int:
        begun.set()
        assert may_go.wait(10)
        return 1

    with closing(WorkerBeside[int]("a test")) as subject:
        subject.ask(slowly, 0.0)
        assert begun.wait(10)
        subject.drop()
        assert not subject.is_asked
        assert subject.is_busy
        may_go.set()
        subject.ask(lambda: 2, 0.0)
        assert reported(subject) == 2


def test_what_goes_wrong_beside_is_raised_to_who_asks() -> None:
    def fails() -> int:
        raise MapError("too many cells")

    with closing(WorkerBeside[int]("a test")) as subject:
        subject.ask(fails, 0.0)
        with pytest.raises(MapError, match="too many"):
            reported(subject)


def test_a_plan_in_step_costs_simulated_time() -> None:
    subject = ride(WorkerInStep[PlanningResult](0.5))
    subject.go(3, until=lambda: subject.navigator.state is NavigationState.DRIVING)
    begun, drives = subject.transitions[:2]
    assert drives.stamp_s - begun.stamp_s == pytest.approx(0.55, abs=0.051)
    assert np.hypot(*(subject.robot.base.pose - BESIDE)[:2]) < 1e-6


def test_with_a_planner_beside_it_arrives() -> None:
    with closing(WorkerBeside[PlanningResult]("planning")) as planning:
        subject = ride(planning)
        subject.go(120)
        assert not_none(subject.navigator.result).has_arrived
        assert is_near(subject.robot.base.pose, GOAL)
        assert subject.clearance_m > 0.04


def moved_by(subject: Ride, x_m: float) -> None:
    """The map moves below the robot: what it says of the robot stays, `odom` is elsewhere."""
    T = se3.from_plane(x_m, 0.0, 0.0)

    def says(estimate: Estimate) -> Estimate:
        return replace(estimate, T_map_odom=T)

    subject.localization.says = says


def test_it_drives_on_while_its_next_plan_is_made() -> None:
    planning = Held()
    subject = ride(planning)
    subject.go(2.5)
    planning.is_held = True
    moved_by(subject, 0.15)
    subject.go(1.0, until=lambda: planning.is_asked)
    assert planning.asked == 2
    before = subject.robot.base.pose.copy()
    subject.go(0.35)  # a planner that takes much longer than ever before is one that hangs
    assert planning.is_asked
    assert subject.navigator.state is NavigationState.DRIVING
    assert np.hypot(*(subject.robot.base.pose - before)[:2]) > 0.1
    planning.is_held = False
    subject.go(60)
    assert not_none(subject.navigator.result).has_arrived
    assert any("moved below" in one.why for one in subject.transitions)


@pytest.mark.parametrize("is_beside", [False, True])
def test_a_plan_that_takes_longer_than_a_robot_may_drive_interrupts_it_alone(is_beside: bool) -> None:
    """It brakes after 0.4 s, and continues with the plan once that is made."""
    with closing(WorkerBeside[PlanningResult]("planning")) as beside:
        planning = Slow(beside) if is_beside else WorkerInStep[PlanningResult](0.8)
        subject = ride(planning)
        subject.go(5, until=lambda: subject.navigator.feedback.forward_m_s > 0.3)
        moved_by(subject, 0.15)
        silent = MonitorReason.PLANNER_SILENT
        subject.go(3, until=lambda: not_none(subject.navigator.feedback.monitor).reason is silent)
        assert not_none(subject.navigator.feedback.monitor).reason is silent
        subject.go(90)
        assert not_none(subject.navigator.result).has_arrived


def test_where_its_plan_is_shut_it_stands_until_the_next_is_made() -> None:
    planning = Held()
    subject = ride(planning)
    subject.go(2.0)
    planning.is_held = True
    x = float(subject.robot.base.pose[0]) + 1.9
    box = (
        ((x, 2.6), (x, 3.4)),
        ((x + 0.2, 2.6), (x + 0.2, 3.4)),
        ((x, 2.6), (x + 0.2, 2.6)),
        ((x, 3.4), (x + 0.2, 3.4)),
    )
    subject.robot.walls = Walls.of(*ROOM, *box)
    subject.go(6, until=lambda: subject.robot.base.stands)
    subject.go(1.0)
    assert subject.navigator.state is NavigationState.PLANNING
    assert subject.robot.base.stands
    assert planning.asked == 2
    planning.is_held = False
    subject.go(90)
    assert not_none(subject.navigator.result).has_arrived
    assert subject.clearance_m > 0.02


def test_a_floor_is_as_it_was_until_its_grid_is_made() -> None:
    seen, worker = Seen(), Held()
    seen.look((0.0, 0.0, 0.0))
    floor = GrowingFloor(seen, CALIBRATION, CHAIR, worker=worker)  # type: ignore[arg-type]
    floor.update(np.zeros(3), 0.0)
    before = floor.layer.state.shape, floor.grid
    worker.is_held = True
    seen.look((-2.0, -1.0, np.pi))
    floor.update(np.zeros(3), 0.05)
    seen.look((-2.0, -1.0, 2.0))
    floor.update(np.zeros(3), 0.1)
    assert worker.asked == 2
    assert floor.layer.state.shape == before[0]
    assert floor.grid is before[1]
    worker.is_held = False
    floor.update(np.zeros(3), 0.15)
    assert floor.grid is not before[1]
    assert floor.layer.state.shape[1] > before[0][1]
    # The third came while the second was made.
    for now_s in (0.2, 0.25, 0.3):
        floor.update(np.zeros(3), now_s)
    assert worker.asked == 3


def test_a_floor_beside_is_the_same_in_the_end() -> None:
    seen = Seen()
    at_once = GrowingFloor(seen, CALIBRATION, CHAIR)  # type: ignore[arg-type]
    with closing(WorkerBeside[SeenFloor]("floor")) as worker:
        beside = GrowingFloor(seen, CALIBRATION, CHAIR, worker=worker)  # type: ignore[arg-type]
        for pose in ((0.0, 0.0, 0.0), (-1.0, 0.0, 2.0)):
            seen.look(pose)
            at_once.update(np.array(pose), 0.0)
            waiting = threading.Event()
            for _ in range(1000):
                before = beside.revision
                beside.update(np.array(pose), 0.0)
                if beside.grid.occupancy.shape == at_once.grid.occupancy.shape and beside.revision == before:
                    break
                waiting.wait(0.01)
        np.testing.assert_array_equal(beside.layer.state, at_once.layer.state)


def test_a_plan_is_asked_for_with_the_goal_and_driven_in_the_period_in_which_it_comes() -> None:
    subject = ride(held := Held())
    subject.navigator.cancel_task()
    while not subject.navigator.senses.where.is_known:
        subject.navigator.step()
    asked = held.asked
    subject.navigator.go_to_pose(GOAL)
    assert held.asked == asked + 1  # the period that goes by before the next decision is not waited for
    subject.navigator.step()
    # What is commanded next moves the robot.
    assert subject.navigator.state is NavigationState.DRIVING
    assert not_none(subject.navigator.feedback.monitor).command.forward_m_s > 0
    assert held.asked == asked + 1


def test_what_work_raises_is_raised_once_and_the_next_is_done() -> None:
    def failing() -> int:
        raise ValueError("no plan")

    with closing(WorkerBeside[int]("planning")) as worker:
        worker.ask(failing, 0.0)
        while worker.is_busy:
            pass
        with pytest.raises(ValueError, match="no plan"):
            worker.answer(0.0)
        assert not worker.is_asked
        worker.ask(lambda: 7, 0.0)
        while (answer := worker.answer(0.0)) is None:
            assert worker.is_asked
        assert answer == 7
