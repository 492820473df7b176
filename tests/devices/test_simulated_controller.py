"""The controller to practise with: its legs end where they say, it obeys as firmware does, it prints plain lines."""

from __future__ import annotations

import os
import select
import threading
import time
from pathlib import Path

import pytest

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import DeviceError
from wheelsight.io.devices import Version, WheelLink
from wheelsight.io.devices.simulated_controller import Leg, Practice, SimulatedController, lap, turns
from wheelsight.io.devices.wire_formats import (
    Ack,
    Format,
    FrameDecoder,
    LinkCommand,
    Message,
    PlainReading,
    PlainText,
    drive_body,
    encode_command,
)

WHEELS = Wheels(0.17, 0.17, 0.58, 3200.0)
M_PER_TICK = WHEELS.left_m_per_tick


def driven(motion: Practice, seconds: float, duties: tuple[int, int] = (0, 0)) -> tuple[int, int]:
    """Pulses of both wheels in so many seconds of 20 ms each."""
    steps = [motion(duties, 0.02) for _ in range(round(seconds / 0.02))]
    return sum(step[0] for step in steps), sum(step[1] for step in steps)


def test_a_lap_goes_two_metres_turns_about_and_ends_where_it_began() -> None:
    motion, legs = Practice(WHEELS, lap(WHEELS)), lap(WHEELS)
    assert driven(motion, 3.0) == (0, 0)
    left, right = driven(motion, 5.0)
    assert left == right == pytest.approx(2.0 / M_PER_TICK, abs=1)
    left, right = driven(motion, 7.0)
    turned_rad = (right - left) * M_PER_TICK / WHEELS.track_width_m
    assert turned_rad == pytest.approx(3.1416, abs=0.01)
    assert sum(leg.left_m for leg in legs) == pytest.approx(4.0 - 3.1416 * WHEELS.track_width_m, abs=1e-3)
    both = Practice(WHEELS, legs)
    assert driven(both, 2 * sum(leg.seconds for leg in legs))[0] == pytest.approx(
        2 * sum(leg.left_m for leg in legs) / M_PER_TICK, abs=2
    )


def test_each_wheel_turns_by_its_ticks_and_back() -> None:
    motion = Practice(WHEELS, turns(WHEELS))
    assert [driven(motion, 6.0) for _ in range(4)] == [(3200, 0), (-3200, 0), (0, 3200), (0, -3200)]


def test_once_commanded_it_does_as_it_is_commanded() -> None:
    motion = Practice(WHEELS, (Leg(1.0, 1.0, 1.0),), full_speed_m_s=0.8)
    driven(motion, 1.0, (500, -500))
    left, right = driven(motion, 2.0, (500, -500))
    assert left == -right == pytest.approx(0.8 / M_PER_TICK, abs=3)
    driven(motion, 2.0)
    assert driven(motion, 2.0) == (0, 0)


def answer_to(port: int, sent: bytes, decoder: FrameDecoder) -> list[Message]:
    """What comes back but counts; waits for the acknowledgement."""
    os.write(port, sent)
    found: list[Message] = []
    while not any(isinstance(one, Ack) for one in found):
        assert select.select([port], [], [], 30.0)[0]
        found += [one for one in decoder.feed(os.read(port, 4096)) if isinstance(one, Ack | Version)]
    return found


def test_commands_are_answered_as_the_firmware_answers(tmp_path: Path) -> None:
    with SimulatedController(tmp_path) as controller:
        port, decoder = os.open(controller.port, os.O_RDWR | os.O_NOCTTY), FrameDecoder()
        try:
            for number, (command, body, status) in enumerate(
                (
                    (LinkCommand.DRIVE, drive_body(0.5, -0.5), 0),
                    (LinkCommand.DRIVE, drive_body(0.5, -0.5)[:3], 2),
                    (LinkCommand.DRIVE, b"\xff\x7f\x00\x00", 3),
                    (LinkCommand.STOP, b"x", 2),
                    (LinkCommand.SET_FORMAT, b"\x02", 3),
                    (0x99, b"", 1),
                    (LinkCommand.GET_VERSION, b"", 0),
                )
            ):
                answers = answer_to(port, encode_command(command, number, body), decoder)  # type: ignore[arg-type]
                assert answers[-1][1:] == (command, number, status)
            assert isinstance(answers[0], Version)
            os.write(port, b"\0noise\0" + 3000 * b"n")
            answer_to(port, encode_command(LinkCommand.STOP, 9), decoder)
            assert controller.duties == (0, 0)
        finally:
            os.close(port)


def test_plain_text_is_recognised_and_takes_no_commands(tmp_path: Path) -> None:
    with SimulatedController(tmp_path, "ttyARDUINO", is_plain=True) as controller:
        controller.speeds = (3, -2)
        port, reader = os.open(controller.port, os.O_RDWR | os.O_NOCTTY), PlainText()
        readings: list[PlainReading] = []
        try:
            os.write(port, encode_command(LinkCommand.DRIVE, 0, drive_body(1, 1)))
            while len(readings) < 40:
                assert select.select([port], [], [], 30.0)[0]
                readings += reader.feed(os.read(port, 4096), time.monotonic())
        finally:
            os.close(port)
        assert controller.commands == []
        assert controller.duties == (0, 0)
    first, last = readings[0], readings[-1]
    assert (last.left - first.left) * 2 == (first.right - last.right) * 3 != 0
    assert first.us_per_tick == 1


@pytest.mark.slow
def test_the_link_takes_plain_text_for_a_board(tmp_path: Path) -> None:
    with (
        SimulatedController(tmp_path, is_plain=True, motors=Practice(WHEELS, (Leg(1.0, 1.0, 0.0),))) as controller,
        WheelLink(str(controller.port)) as link,
    ):
        ended = threading.Event()
        for _ in range(600):
            report = link.report()
            if report.format is Format.PLAIN and report.last is not None and report.last.left > 0:
                break
            ended.wait(0.05)
        assert report.format is Format.PLAIN


def test_what_is_there_already_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("mine")
    with pytest.raises(DeviceError, match="exists, and is no link"):
        SimulatedController(tmp_path, "robot.yaml")
    assert (tmp_path / "robot.yaml").read_text() == "mine"
    with SimulatedController(tmp_path), pytest.raises(DeviceError, match="leads to another terminal"):
        SimulatedController(tmp_path)
    (tmp_path / "ttyWHEELS").symlink_to(tmp_path / "gone")  # of one that was killed
    with SimulatedController(tmp_path) as again:
        assert again.port.exists()
    with pytest.raises(DeviceError, match="cannot be made: No such file or directory"):
        SimulatedController(tmp_path / "no", "tty")
