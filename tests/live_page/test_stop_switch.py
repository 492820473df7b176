"""The switch stops a robot whatever hangs, holds it, and lets go only of who saw every press."""

from __future__ import annotations

import threading
import time

import pytest
from live_page.room_session import ObedientRobot

from wheelsight.commands import STOP, VelocityCommand
from wheelsight.errors import DeviceError
from wheelsight.live_page import StoppableRobot, StopSwitch

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


def test_what_it_holds_stands_whatever_it_is_told_until_it_is_released() -> None:
    robot = ObedientRobot()
    switch = StopSwitch(robot)
    stoppable = StoppableRobot(robot, switch)
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


def test_a_robot_that_does_not_confirm_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
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
