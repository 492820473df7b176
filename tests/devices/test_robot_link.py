"""A robot on a serial line, against a simulated controller whose motors answer late."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from patched import patched

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import ArgumentError, DeviceError
from wheelsight.core.messages import STOP, AngularVelocity, Event, RgbdFrame, VelocityCommand, WheelTicks, YawRate
from wheelsight.core.robots import Robot
from wheelsight.io.devices import Format, LinkRobot, LinkStatus, WheelLink
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.devices.wire_formats import LinkCommand, drive_body

WHEELS = Wheels(0.17, 0.17, 0.52, 3200)
CALIBRATION = Calibration(wheels=WHEELS)
LAG_S, FULL_M_S = 0.1, 2.6
AHEAD = VelocityCommand(0.5)
# A busy machine holds threads up for longer than a robot bears.
SILENT_S, HOLD_S = 1.0, 0.25
PATIENT = {"core.robots.TICKS_SILENT_S": SILENT_S, "core.robots.HOLD_S": HOLD_S, "core.robots._FAULT_S": 1.0}
PATIENT |= {"io.devices.robot_link.TICKS_SILENT_S": SILENT_S, "io.devices.robot_link.HOLD_S": HOLD_S}
patient = patched(PATIENT, "wheelsight")


class Motors:
    """Two motors behind a lag, weaker than the loop takes them to be; a wheel may be blocked, or cross-wired."""

    def __init__(self, strength: float = 0.85) -> None:
        self.strength = strength
        self.speeds_m_s = np.zeros(2)
        self.rest = np.zeros(2)
        self.is_blocked = [False, False]
        self.signs = np.ones(2)

    def __call__(self, duties: tuple[int, int], seconds: float) -> tuple[int, int]:
        goal = self.strength * FULL_M_S * np.array(duties) / 1000
        self.speeds_m_s += (1 - math.exp(-seconds / LAG_S)) * (goal - self.speeds_m_s)
        self.speeds_m_s[self.is_blocked] = 0.0
        pulses = self.signs * self.speeds_m_s * seconds / WHEELS.left_m_per_tick + self.rest
        whole = np.floor(pulses)
        self.rest = pulses - whole
        return int(whole[0]), int(whole[1])


@pytest.fixture
def motors() -> Motors:
    return Motors()


@pytest.fixture
def controller(tmp_path: Path, motors: Motors) -> Iterator[SimulatedController]:
    with SimulatedController(tmp_path) as simulated:
        simulated.motors = motors
        yield simulated


@pytest.fixture
def robot(controller: SimulatedController) -> Iterator[LinkRobot]:
    link = WheelLink(str(controller.port))
    with LinkRobot(link, CALIBRATION) as made:
        wait(made, lambda: link.status is LinkStatus.CONNECTED)
        yield made


def wait(robot: LinkRobot, is_so: Callable[[], bool], command: VelocityCommand = STOP, seconds: float = 60.0) -> None:
    """Step until it is so."""
    ends_s = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < ends_s, f"it did not come: {robot.stop_reason}"
        robot.step(command)


def run(robot: LinkRobot, command: VelocityCommand, seconds: float) -> list[Event]:
    ends_s = time.monotonic() + seconds
    events = []
    while time.monotonic() < ends_s:
        events += robot.step(command)
    return events


def test_it_is_a_robot_that_listens_until_reported_to_move(robot: LinkRobot, controller: SimulatedController) -> None:
    assert isinstance(robot, Robot)
    assert robot.calibration is CALIBRATION
    run(robot, STOP, 0.5)
    assert controller.commands == []


@pytest.mark.slow
def test_weak_motors_reach_the_speed_reported(robot: LinkRobot, motors: Motors) -> None:
    """By feed-forward alone they would stay at 85 % of it."""
    began_s = time.monotonic()
    events = run(robot, AHEAD, 4.0)
    assert time.monotonic() - began_s >= 4.0
    stamps_s = [event.stamp_s for event in events]
    assert stamps_s == sorted(stamps_s)
    assert len(stamps_s) == pytest.approx(200, abs=40)
    assert motors.speeds_m_s == pytest.approx(0.5, abs=0.05)
    run(robot, VelocityCommand(0.0, 0.8), 3.0)
    assert motors.speeds_m_s == pytest.approx(np.array([-0.208, 0.208]), abs=0.05)
    run(robot, STOP, 1.5)
    assert np.abs(motors.speeds_m_s).max() < 0.02


def test_motors_that_are_too_weak_are_reported(
    robot: LinkRobot, motors: Motors, controller: SimulatedController
) -> None:
    motors.strength = 0.3
    wait(robot, lambda: "is blocked" in robot.stop_reason, VelocityCommand(1.0))
    duties = [body for kind, body in controller.commands if kind == LinkCommand.DRIVE]
    reported = np.array([np.frombuffer(body, "<i2") for body in duties])
    assert 100 < reported.max() <= 585  # a metre a second takes 385; 200 more may be corrected
    assert reported.min() >= 0


def test_a_blocked_wheel_stops_both(robot: LinkRobot, motors: Motors, controller: SimulatedController) -> None:
    run(robot, AHEAD, 1.5)
    motors.is_blocked[0] = True
    wait(robot, lambda: bool(robot.stop_reason), AHEAD, 5.0)
    assert "the left wheel is blocked" in robot.stop_reason
    run(robot, AHEAD, 0.3)
    assert controller.duties == (0, 0)
    motors.is_blocked[0] = False
    run(robot, AHEAD, 0.5)  # it does not set off by itself
    assert controller.duties == (0, 0)
    run(robot, STOP, 0.3)
    wait(robot, lambda: controller.duties[0] > 0, AHEAD)
    assert robot.stop_reason == ""


def test_an_encoder_wired_the_wrong_way_stops(robot: LinkRobot, motors: Motors) -> None:
    motors.signs[1] = -1
    wait(robot, lambda: bool(robot.stop_reason), AHEAD, 10.0)
    assert "the right wheel" in robot.stop_reason


def test_silent_encoders_stop(robot: LinkRobot, controller: SimulatedController) -> None:
    run(robot, AHEAD, 1.0)
    controller.is_muted = True
    wait(robot, lambda: bool(robot.stop_reason), AHEAD, 5.0)
    assert robot.stop_reason == "no wheel readings come"
    run(robot, AHEAD, 0.2)
    assert controller.duties == (0, 0)
    controller.is_muted = False
    run(robot, AHEAD, 0.5)
    assert controller.duties == (0, 0)
    wait(robot, lambda: not robot.stop_reason)


def test_ticks_that_waited_are_no_sign_of_life(robot: LinkRobot, controller: SimulatedController) -> None:
    wait(robot, lambda: controller.duties[0] > 50, AHEAD)
    time.sleep(0.3)
    controller.is_muted = True
    time.sleep(1.2 * SILENT_S)
    before = len(controller.commands)
    events = run(robot, AHEAD, 0.3)
    assert len(events) > 5
    run(robot, STOP, 0.3)
    assert all(body == drive_body(0, 0) for kind, body in controller.commands[before:] if kind == LinkCommand.DRIVE)
    # STOP releases what has halted the robot only once readings come again.
    assert robot.stop_reason.startswith("the program stood still")
    controller.is_muted = False
    wait(robot, lambda: not robot.stop_reason)


def test_without_steps_the_link_stops_the_motors(robot: LinkRobot, controller: SimulatedController) -> None:
    wait(robot, lambda: controller.duties[0] > 50, AHEAD)
    before = len(controller.commands)
    ends_s = time.monotonic() + 30
    while controller.duties != (0, 0):
        assert time.monotonic() < ends_s
        time.sleep(0.01)
    assert (int(LinkCommand.STOP), b"") in controller.commands[before:]
    robot.step(AHEAD)  # and it begins from a stand
    assert controller.duties[0] < 50


def test_a_vanished_port_stops(robot: LinkRobot, controller: SimulatedController) -> None:
    run(robot, AHEAD, 0.5)
    controller.unplug()
    wait(robot, lambda: bool(robot.stop_reason), AHEAD)
    controller.plug()
    before = len(controller.commands)
    run(robot, AHEAD, 1.5)
    assert all(body == drive_body(0, 0) for kind, body in controller.commands[before:] if kind == LinkCommand.DRIVE)
    wait(robot, lambda: not robot.stop_reason)


def test_a_controller_that_begins_again_stops(robot: LinkRobot, controller: SimulatedController) -> None:
    run(robot, AHEAD, 1.0)
    controller.restart()
    wait(robot, lambda: bool(robot.stop_reason), AHEAD)
    assert robot.stop_reason == "the wheel controller restarted"


def test_closed_it_has_stopped_first(controller: SimulatedController) -> None:
    camera = Camera()
    link = WheelLink(str(controller.port))
    with LinkRobot(link, CALIBRATION, frames=camera) as robot:
        wait(robot, lambda: link.status is LinkStatus.CONNECTED)
        wait(robot, lambda: controller.duties[0] > 50, AHEAD)
    assert controller.commands[-1][0] == LinkCommand.STOP
    assert controller.duties == (0, 0)
    assert link.status is LinkStatus.CLOSED
    assert camera.is_closed
    robot.close()
    with pytest.raises(DeviceError, match="the robot is closed"):
        robot.step(STOP)


def test_stopped_by_another_thread_it_stands_until_somebody_lets_go(
    robot: LinkRobot, controller: SimulatedController
) -> None:
    wait(robot, lambda: controller.duties[0] > 50, AHEAD)
    stopping = threading.Timer(0.02, robot.stop)
    stopping.start()
    robot.step(AHEAD)
    stopping.join()
    run(robot, AHEAD, 0.3)
    assert controller.duties == (0, 0)
    assert robot.stop_reason == "it was stopped"
    run(robot, STOP, 0.2)
    wait(robot, lambda: controller.duties[0] > 50, AHEAD)


def test_two_cannot_drive_it_at_once(robot: LinkRobot, controller: SimulatedController) -> None:
    wait(robot, lambda: controller.duties[0] > 50, AHEAD)
    refused: list[DeviceError] = []

    def drive_too() -> None:
        try:
            robot.step(VelocityCommand(-0.2))
        except DeviceError as error:
            refused.append(error)

    other = threading.Timer(0.02, drive_too)
    other.start()
    robot.step(AHEAD)
    other.join()
    assert "another program drives the robot" in str(refused[0])
    assert robot.stop_reason == "two programs drive it at once"
    run(robot, AHEAD, 0.2)
    assert controller.duties == (0, 0)


class Camera:
    """Has a frame of just now."""

    def __init__(self) -> None:
        self.is_closed = False

    def take(self) -> list[RgbdFrame]:
        image = np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2), np.float32)
        return [RgbdFrame(time.time() - 0.02, *image)]

    def close(self) -> None:
        self.is_closed = True


def test_frames_are_sorted_in(controller: SimulatedController) -> None:
    link = WheelLink(str(controller.port))
    with LinkRobot(link, CALIBRATION, frames=Camera()) as robot:
        wait(robot, lambda: link.status is LinkStatus.CONNECTED)
        events = robot.step(STOP)
        while not any(isinstance(event, WheelTicks) for event in events):
            events = robot.step(STOP)
    assert sum(isinstance(event, RgbdFrame) for event in events) == 1
    assert any(isinstance(event, WheelTicks) for event in events)
    assert [event.stamp_s for event in events] == sorted(event.stamp_s for event in events)


class TurningCamera(Camera):
    """Has a gyroscope, which shows one turn about the camera's y, down."""

    def take_angular_velocities(self) -> list[AngularVelocity]:
        return [AngularVelocity(time.time() - 0.02, 0.0, -0.5, 0.0)]


def test_the_cameras_gyroscope_shows_turns_of_the_base(controller: SimulatedController) -> None:
    ahead = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]])
    for mount, reported in ((ahead, [0.5]), (None, [])):
        link = WheelLink(str(controller.port))
        known = Calibration(wheels=WHEELS, T_base_camera=mount)
        with LinkRobot(link, known, frames=TurningCamera()) as robot:
            events = robot.step(STOP)
        assert [event.yaw_rate_rad_s for event in events if isinstance(event, YawRate)] == reported
        assert [event.stamp_s for event in events] == sorted(event.stamp_s for event in events)


def test_a_firmware_that_stops_too_late_is_not_driven(robot: LinkRobot, controller: SimulatedController) -> None:
    controller.version = (1, 1, 0, 0)
    with pytest.raises(DeviceError, match=r"firmware is 1\.0, older than 1\.1.*\(write the new one: make -C firmware"):
        robot.check_firmware()
    wait(robot, lambda: bool(robot.stop_reason), AHEAD)
    assert robot.stop_reason.startswith("the controller's firmware is 1.0, older than 1.1")
    assert "make -C firmware/atmega8 flash" in robot.stop_reason
    run(robot, STOP, 0.2)
    run(robot, AHEAD, 0.3)
    assert {kind for kind, _ in controller.commands} == {LinkCommand.GET_VERSION}
    controller.version = (1, 1, 1, 0)
    run(robot, STOP, 0.2)
    wait(robot, lambda: controller.duties[0] > 50, AHEAD)


def test_a_controller_that_answers_nothing_is_not_driven(robot: LinkRobot, controller: SimulatedController) -> None:
    controller.answers = False
    wait(robot, lambda: bool(robot.stop_reason), AHEAD)
    assert robot.stop_reason == "the controller does not answer GET_VERSION (check the wire to it)"
    assert LinkCommand.DRIVE not in {kind for kind, _ in controller.commands}


def test_in_the_papers_format_no_one_is_asked(controller: SimulatedController) -> None:
    controller.is_paper, controller.version = True, (1, 1, 0, 0)
    link = WheelLink(str(controller.port))
    with LinkRobot(link, CALIBRATION) as robot:
        wait(robot, lambda: link.report().format is Format.PAPER)
        wait(robot, lambda: controller.duties[0] > 50, AHEAD)
    assert LinkCommand.GET_VERSION not in {kind for kind, _ in controller.commands}


def test_a_calibration_without_wheels_is_refused(controller: SimulatedController) -> None:
    with WheelLink(str(controller.port)) as link, pytest.raises(ArgumentError, match="no wheels"):
        LinkRobot(link, Calibration())
