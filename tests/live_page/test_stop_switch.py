"""The switch stops a robot whatever hangs, holds it, and lets go only of who saw every press."""

from __future__ import annotations

import math
import threading
import time
from types import SimpleNamespace

import pytest
from live_page.room_session import ObedientRobot

from wheelsight.app.page import StopSwitch, stop_switch
from wheelsight.app.page.stop_switch import Watchdog
from wheelsight.core.errors import DeviceError
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.core.robots import WatchedRobot

AHEAD = VelocityCommand(0.4, 0.0)


def until(what, seconds: float = 5.0) -> None:
    ends_s = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < ends_s
        time.sleep(0.002)


def test_a_robot_is_stopped_while_its_step_hangs() -> None:
    robot = ObedientRobot()
    switch = StopSwitch(robot)
    robot.goes_on.clear()
    stepping = threading.Thread(target=robot.step, args=(AHEAD,))
    stepping.start()
    switch.press("somebody pressed STOP")
    until(lambda: robot.stops_s)
    assert stepping.is_alive(), "it still hangs"
    robot.goes_on.set()
    stepping.join()
    assert robot.commands == [STOP]
    switch.close()


def test_what_it_holds_stands_whatever_it_is_reported_until_it_is_released() -> None:
    robot = ObedientRobot()
    switch = StopSwitch(robot)
    stoppable = WatchedRobot(robot, lambda: switch.reason)
    stoppable.step(AHEAD)
    assert robot.commands[-1] == AHEAD
    switch.press("a reason")
    switch.press("another")
    until(lambda: robot.stops_s)
    for _ in range(3):
        stoppable.step(AHEAD)
        assert robot.commands[-1] == STOP
        assert stoppable.stop_reason == "a reason"
    assert not switch.release(1), "it was pressed again since"
    assert switch.reason
    assert switch.release(2)
    stoppable.step(AHEAD)
    assert robot.commands[-1] == AHEAD
    assert stoppable.frame is not None
    switch.close()


def test_a_robot_that_does_not_confirm_is_reported_of(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = ObedientRobot()
    switch = StopSwitch(robot)

    def refuse() -> None:
        raise DeviceError("the port is gone")

    with monkeypatch.context() as patched:
        patched.setattr(robot, "stop", refuse)
        switch.press("a reason")
        until(lambda: switch.problem)
    assert switch.problem == "the port is gone"
    switch.press("again")
    until(lambda: robot.stops_s)
    until(lambda: not switch.problem)
    switch.close()
    switch.close()


def test_a_switch_outlives_any_error_of_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = ObedientRobot()
    switch = StopSwitch(robot)

    def wrong() -> None:
        raise OSError("gone\nfor good")

    with monkeypatch.context() as patched:
        patched.setattr(robot, "stop", wrong)
        switch.press("a reason")
        until(lambda: switch.problem)
        assert switch.problem == "OSError: gone"
    until(lambda: robot.stops_s and not switch.problem)
    switch.close()


class Watched:
    """A watchdog with a clock that can leap, and what it says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.leap_s, self.limit_s = 0.0, 0.3
        clock = SimpleNamespace(monotonic=lambda: time.monotonic() + self.leap_s)
        monkeypatch.setattr(stop_switch, "time", clock)
        self.silent: list[str] = []
        self.again: list[str] = []
        self.dog = Watchdog(lambda: self.limit_s, self.silent.append, self.again.append)


def test_a_part_that_falls_silent_is_noticed_once_and_so_is_its_return(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = Watched(monkeypatch)
    beat = watched.dog.watch("the planner")
    until(lambda: watched.silent)
    time.sleep(0.5)
    assert watched.silent == ["the planner does not answer"]
    beat()
    until(lambda: watched.again)
    assert watched.again[0].startswith("the planner answers again after ")
    watched.dog.forget("the planner")
    watched.dog.close()
    watched.dog.close()


def test_a_part_may_be_silent_where_that_is_no_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = Watched(monkeypatch)
    watched.limit_s = math.inf
    watched.dog.watch("the planner")
    time.sleep(0.5)
    assert not watched.silent
    watched.dog.close()


def test_a_program_that_stood_still_blames_no_part_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = Watched(monkeypatch)
    watched.limit_s = 100.0
    watched.dog.watch("the planner")
    time.sleep(0.1)
    watched.leap_s = 500.0
    until(lambda: watched.silent)
    time.sleep(0.2)
    assert [line.partition(" for ")[0] for line in watched.silent] == ["the program stood still"]
    watched.dog.close()
