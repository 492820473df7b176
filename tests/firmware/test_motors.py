from __future__ import annotations

import pytest

from firmware.simulation.simulated_chip import FASTEST_PULSES_PER_S, WATCHDOG_RESET, Chip, Reading
from wheelsight.io.devices.wire_formats import LinkCommand, drive_body

DUTIES = (0, 1, -1, 2, 250, -250, 500, -500, 730, -999, 999, 1000, -1000)
NEUTRAL = pytest.approx((0, 0), abs=1)


def is_neutral(readings: tuple[Reading, Reading]) -> bool:
    return all(reading.periods and abs(reading.duty - 0.5) < 0.002 for reading in readings)


def test_motors_rest_when_power_comes_on(chip: Chip) -> None:
    left, right = chip.pwm()
    assert left.is_driven
    assert right.is_driven
    assert chip.duties() == NEUTRAL
    assert left.hz == pytest.approx(7372.8, rel=0.001)


@pytest.mark.parametrize("left", DUTIES)
def test_duty_on_the_pins_is_what_was_commanded(chip: Chip, left: int) -> None:
    right = -left // 3
    chip.command(LinkCommand.DRIVE, drive_body(left / 1000, right / 1000))
    chip.run(0.01)
    # The simulated pins move between instructions, so an edge is up to three cycles late, of 2000 a period.
    assert chip.duties() == pytest.approx((left, right), abs=1)


def test_the_lowest_and_the_highest_duty_are_still(chip: Chip) -> None:
    chip.command(LinkCommand.DRIVE, drive_body(-1, -1))
    chip.run(0.01)
    assert [reading.duty for reading in chip.pwm()] == [0, 0]
    chip.command(LinkCommand.DRIVE, drive_body(0.2, 0.2))
    chip.run(0.01)
    assert chip.duties() == pytest.approx((200, 200), abs=1)


def test_stop(chip: Chip) -> None:
    chip.command(LinkCommand.DRIVE, drive_body(0.8, -0.8))
    chip.run(0.01)
    assert chip.duties() != NEUTRAL
    chip.command(LinkCommand.STOP)
    chip.run(0.003)
    assert chip.duties() == NEUTRAL


@pytest.mark.parametrize("body", [b"\0\0", bytes([0xE9, 3, 0, 0]), bytes([0, 0, 0, 0x80])])
def test_a_refused_command_changes_nothing(chip: Chip, body: bytes) -> None:
    chip.command(LinkCommand.DRIVE, drive_body(0.3, -0.3))
    chip.run(0.01)
    chip.command(LinkCommand.DRIVE, body)
    chip.run(0.01)
    assert chip.duties() == pytest.approx((300, -300), abs=1)


def silent_until_neutral(chip: Chip) -> float:
    """Seconds from now until both outputs are neutral, in steps of 5 ms; at most two."""
    chip.pwm_until_now()
    for step in range(1, 400):
        chip.run(0.005)
        if is_neutral(chip.pwm_until_now()):
            return 0.005 * step
    return 2.0


def test_motors_rest_a_quarter_of_a_second_after_the_last_command(chip: Chip) -> None:
    chip.command(LinkCommand.DRIVE, drive_body(0.6, 0.6))
    chip.run(0.002)
    assert silent_until_neutral(chip) == pytest.approx(0.25, abs=0.02)


@pytest.mark.slow
def test_one_command_in_four_of_those_sent_keeps_them_turning(chip: Chip) -> None:
    """Twenty are sent a second: three may be lost on the line, one after another."""
    for _ in range(10):
        chip.command(LinkCommand.DRIVE, drive_body(0.6, 0.6))
        chip.run(0.2)
        assert chip.duties() == pytest.approx((600, 600), abs=1)


@pytest.mark.parametrize("command", [LinkCommand.GET_VERSION, LinkCommand.RESET_COUNTS, 0x99])
def test_other_commands_do_not_keep_them_turning(chip: Chip, command: int) -> None:
    chip.command(LinkCommand.DRIVE, drive_body(0.6, 0.6))
    for _ in range(7):
        chip.run(0.1)
        chip.command(command)
    assert chip.duties() == NEUTRAL


def test_the_watch_is_kept_at_full_speed_and_in_the_papers_format(chip: Chip) -> None:
    chip.command(LinkCommand.SET_FORMAT, b"\1")
    for wheel in ("left", "right"):
        chip.turn(wheel, 8 * FASTEST_PULSES_PER_S, FASTEST_PULSES_PER_S)
    chip.command(LinkCommand.DRIVE, drive_body(0.6, 0.6))
    chip.run(0.003)
    assert silent_until_neutral(chip) == pytest.approx(0.25, abs=0.02)


def test_a_program_that_hangs_is_started_again_with_motors_at_rest(chip: Chip) -> None:
    chip.command(LinkCommand.DRIVE, drive_body(0.9, 0.9))
    chip.run(0.01)
    chip.ask("hang")
    assert silent_until_neutral(chip) < 0.1
    chip.run(0.1)
    assert chip.version().flags & WATCHDOG_RESET
