"""The real link against the real program, in real time, over a pseudo-terminal."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise

import pytest

from firmware.simulation.simulated_chip import FASTEST_PULSES_PER_S, Chip
from wheelsight.core.messages import WheelTicks
from wheelsight.io.devices.wheel_link import LinkStatus, WheelLink
from wheelsight.io.devices.wire_formats import Format

pytestmark = pytest.mark.slow


@pytest.fixture
def port(chip: Chip) -> Iterator[str]:
    """The path of a line to the chip, whose time now keeps to the wall's clock."""
    (path,) = chip.ask("terminal")
    chip.ask("live")
    yield path
    chip.ask("still")


def wait(is_so: Callable[[], bool]) -> None:
    until = time.monotonic() + 60
    while not is_so():
        assert time.monotonic() < until, "it never came"
        time.sleep(0.01)


def live_duties(chip: Chip) -> tuple[float, float]:
    """Both outputs in permille of the command, over a tenth of a second from now."""
    chip.pwm_until_now()
    time.sleep(0.1)
    left, right = chip.pwm_until_now()
    return 2000 * left.duty - 1000, 2000 * right.duty - 1000


def last(link: WheelLink) -> tuple[int, int] | None:
    """The newest counts that the link gave out."""
    ticks = link.report().last
    return None if ticks is None else (ticks.left, ticks.right)


def has_format(link: WheelLink, wanted: Format) -> bool:
    return link.report().format is wanted


def turn_at_full_speed(chip: Chip) -> tuple[int, int]:
    chip.turn("left", 4 * FASTEST_PULSES_PER_S, FASTEST_PULSES_PER_S)
    chip.turn("right", -2 * FASTEST_PULSES_PER_S, 0.5 * FASTEST_PULSES_PER_S)
    return FASTEST_PULSES_PER_S, -FASTEST_PULSES_PER_S // 2 + 1


def test_ticks_are_the_pulses(chip: Chip, port: str) -> None:
    with WheelLink(port) as link:
        wait(lambda: link.status is LinkStatus.CONNECTED)
        assert link.report().format is Format.FRAMED
        expected = turn_at_full_speed(chip)
        wait(lambda: last(link) == expected)
        report = link.report()
        ticks: list[WheelTicks] = []
        while (tick := link.read(0)) is not None:
            ticks.append(tick)
    assert (report.line.lost, report.line.crc_errors, report.restarts, report.refused) == (0, 0, 0, 0)
    assert all(before.stamp_s < after.stamp_s for before, after in pairwise(ticks))


def test_commands_are_confirmed(chip: Chip, port: str) -> None:
    with WheelLink(port) as link:
        wait(lambda: link.status is LinkStatus.CONNECTED)
        assert (link.ask_version().protocol, link.ask_version().major) == (1, 1)
        link.drive(0.5, -0.25)
        wait(lambda: live_duties(chip) == pytest.approx((500, -250), abs=4))
        time.sleep(0.7)  # longer than the controller drives by one command
        wait(lambda: live_duties(chip) == pytest.approx((500, -250), abs=4))
        link.stop()
        assert live_duties(chip) == pytest.approx((0, 0), abs=4)
        expected = turn_at_full_speed(chip)
        wait(lambda: last(link) == expected)
        link.reset_counts()
        time.sleep(0.1)
        assert last(link) == expected  # a reset is no motion


def test_the_papers_format_is_recognised_and_exact(chip: Chip, port: str) -> None:
    with WheelLink(port) as link:
        wait(lambda: link.status is LinkStatus.CONNECTED)
        link.set_format(Format.PAPER)
    with WheelLink(port) as link:
        wait(lambda: link.report().format is Format.PAPER)
        expected = turn_at_full_speed(chip)
        wait(lambda: last(link) == expected)
        link.set_format(Format.FRAMED)
        wait(lambda: link.report().format is Format.FRAMED)
        time.sleep(0.1)
        assert last(link) == expected  # answers are no pulses


def test_no_pulse_is_lost_when_the_format_changes_at_full_speed(chip: Chip, port: str) -> None:
    with WheelLink(port) as link:
        wait(lambda: link.status is LinkStatus.CONNECTED)
        link.set_format(Format.PAPER)
    with WheelLink(port) as link:  # which knows nothing but what comes from here on
        wait(lambda: link.report().format is Format.PAPER)
        chip.turn("left", 4 * FASTEST_PULSES_PER_S, FASTEST_PULSES_PER_S)
        chip.turn("right", -4 * FASTEST_PULSES_PER_S, FASTEST_PULSES_PER_S)
        for wanted in (Format.FRAMED, Format.PAPER, Format.FRAMED, Format.PAPER):
            time.sleep(0.1)
            link.set_format(wanted)
            wait(partial(has_format, link, wanted))
        wait(lambda: last(link) == (FASTEST_PULSES_PER_S, -FASTEST_PULSES_PER_S))
        assert link.report().restarts == 0


def test_a_change_of_format_is_no_motion(chip: Chip, port: str) -> None:
    with WheelLink(port) as link:
        expected = turn_at_full_speed(chip)
        wait(lambda: last(link) == expected)
        for wanted in (Format.PAPER, Format.FRAMED, Format.PAPER, Format.FRAMED):
            link.set_format(wanted)
            wait(partial(has_format, link, wanted))
        time.sleep(0.1)
        assert last(link) == expected


def test_motors_rest_when_the_program_that_drives_is_killed(chip: Chip, port: str) -> None:
    program = (
        "import sys, time\n"
        "from wheelsight.io.devices.wheel_link import WheelLink\n"
        "link = WheelLink(sys.argv[1])\n"
        "link.drive(0.4, 0.4)\n"
        "print(flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program, port], stdout=subprocess.PIPE) as driver:
        assert driver.stdout is not None
        driver.stdout.readline()
        wait(lambda: live_duties(chip) == pytest.approx((400, 400), abs=4))
        driver.kill()
    wait(lambda: live_duties(chip) == pytest.approx((0, 0), abs=4))
