"""The STM32F4's program on a simulated chip: what it counts, says, and keeps at rest."""

from __future__ import annotations

import re
import subprocess
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from firmware.simulation.simulated_chip import WATCHDOG_RESET
from firmware.simulation.simulated_stm32 import DATA_SIZE, RAM_SIZE, Stm32
from wheelsight.core.messages import WheelTicks
from wheelsight.io.devices.tick_tracking import TickTracker
from wheelsight.io.devices.wheel_link import LinkStatus, WheelLink
from wheelsight.io.devices.wire_formats import Format, LinkCommand, drive_body, encode_frame

FASTEST_COUNTS_PER_S = 400_000  # 5000 lines, four counts a line, twenty turns a second
DONE, UNKNOWN, BAD_LENGTH, OUT_OF_RANGE = range(4)
NEUTRAL = pytest.approx((0, 0), abs=0.1)


def last(board: Stm32) -> tuple[int, int]:
    """The counts of the last frame."""
    counts = board.counts()[-1]
    return counts.left, counts.right


def address_of(folder: Path, symbol: str) -> int:
    """Where the program keeps a variable."""
    reported = subprocess.run(
        ["arm-none-eabi-nm", folder / "controller.elf"], capture_output=True, text=True, check=True
    )
    (line,) = (line for line in reported.stdout.splitlines() if line.split()[-1].split(".")[0] == symbol)
    return int(line.split()[0], 16)


def test_the_build_prints_a_size_that_leaves_room(built_stm32: Path, board: Stm32) -> None:
    reported = re.findall(r"^ *(\d+)\t *(\d+)\t *(\d+)\t", (built_stm32 / "size.txt").read_text(), re.MULTILINE)
    text, data, bss = map(int, reported[-1])
    assert 0 < text < 32 << 10
    assert 0 < data + bss < DATA_SIZE
    board.command(LinkCommand.DRIVE, drive_body(0.1, 0.1))
    board.run(0.1)
    assert 0 < board.stack_used() < RAM_SIZE // 64


@pytest.mark.parametrize("wheel", ["left", "right"])
def test_four_counts_a_line_forward_and_back(board: Stm32, wheel: str) -> None:
    position = 0
    for counts in (20_000, 1, -1, -8, 3, -40_000, 7):
        position += counts
        board.turn(wheel, counts, 300_000)
        board.rest()
        assert last(board) == ((position, 0) if wheel == "left" else (0, position))


def test_no_count_is_lost_at_twice_400_khz(board: Stm32, rng: np.random.Generator) -> None:
    """Both wheels at once, in opposite directions, turning about anywhere; the host commands all the while."""
    for wheel, rate, sign in (("left", FASTEST_COUNTS_PER_S, 1), ("right", 0.9973 * FASTEST_COUNTS_PER_S, -1)):
        back_and_forth = (rng.integers(1, 9000, 30) * np.where(np.arange(30) % 2, -1, 1)).tolist()
        for counts in [300_000, *back_and_forth, -500_000]:
            board.turn(wheel, sign * counts, rate)
    for _ in range(60):
        board.command(LinkCommand.DRIVE, drive_body(1, -1))
        board.run(0.02)
    board.rest()
    assert last(board) == board.positions()
    assert min(map(abs, board.positions())) > 100_000
    assert (board.lost_frames, board.peripherals.garbled, board.resets) == (0, 0, 0)


def test_sixteen_bits_are_looked_at_long_before_they_are_full(board: Stm32, rng: np.random.Generator) -> None:
    """On a processor that does 2.5 million instructions a second, of the real one's 168; noise and commands besides."""
    board.turn("right", 200_000, FASTEST_COUNTS_PER_S)
    for _ in range(20):
        board.command(LinkCommand.GET_VERSION)
        board.send(rng.bytes(30))
        board.run(0.02)
    longest_s = board.peripherals.longest_unread_s
    assert 0 < longest_s * FASTEST_COUNTS_PER_S < (1 << 15) / 8


@pytest.mark.parametrize("direction", [1, -1])
def test_the_timers_roll_over(built_stm32: Path, direction: int) -> None:
    with Stm32(built_stm32 / "controller.bin") as board:
        for encoder in board.peripherals.encoders.values():
            encoder.count = (-direction * 1000) % (1 << encoder.bits)
        board.run(0.1)
        for wheel in ("left", "right"):
            board.turn(wheel, direction * 100_000, FASTEST_COUNTS_PER_S)
        board.rest()
        assert last(board) == (direction * 100_000, direction * 100_000)


def test_counts_and_clock_roll_over_and_the_host_goes_on(built_stm32: Path, board: Stm32) -> None:
    sample, us = address_of(built_stm32, "sample"), address_of(built_stm32, "us")
    board.poke(sample + 4, (1 << 31) - 500)
    board.poke(sample + 8, -(1 << 31) + 700)
    board.poke(us, (1 << 32) - 100_000)
    tracker, ticks = TickTracker(), list[WheelTicks]()
    board.turn("left", 40_000, 200_000)
    board.turn("right", -40_000, 200_000)
    for _ in range(20):
        board.run(0.02)
        for counts in board.counts():
            ticks += tracker.add_counts(counts, board.peripherals.now_s)
    moved = ticks[-1].left - (1 << 31) + 500, ticks[-1].right + (1 << 31) - 700
    assert moved == (40_000, -40_000)
    assert (tracker.restarts, tracker.refused) == (0, 0)
    assert all(before.stamp_s < after.stamp_s for before, after in pairwise(ticks))


def test_a_reset_is_reported_and_is_no_motion(board: Stm32) -> None:
    tracker, ticks = TickTracker(), list[WheelTicks]()

    def hear() -> None:
        for counts in board.counts():
            ticks.extend(tracker.add_counts(counts, board.peripherals.now_s))

    board.turn("left", 50_000, 200_000)
    for _ in range(20):
        board.run(0.02)
        hear()
    board.reset()
    for _ in range(10):
        board.run(0.02)
        hear()
    board.turn("left", 300, 10_000)
    for _ in range(10):
        board.run(0.02)
        hear()
    assert tracker.restarts == 1
    assert (ticks[-1].left, ticks[-1].right) == (50_300, 0)
    assert not board.version().flags & WATCHDOG_RESET


def test_counts_belong_to_the_clock_they_come_with(board: Stm32) -> None:
    board.turn("left", 100_000, 200_000)
    board.turn("right", -100_000, 200_000)
    board.rest()
    moving = [counts for counts in board.counts() if 0 < counts.left < 100_000]
    seconds = 1e-6 * (np.array([counts.clock_us for counts in moving]) - moving[0].clock_us)
    for sign, seen in ((1, [counts.left for counts in moving]), (-1, [counts.right for counts in moving])):
        # The simulation's time goes on in steps of 40 µs, which are 8 counts.
        assert np.abs(np.array(seen) - seen[0] - sign * 200_000 * seconds).max() <= 9


def test_a_frame_comes_every_20_ms(board: Stm32) -> None:
    board.run(1.0)
    frames = board.counts()
    steps_us = np.diff([frame.clock_us for frame in frames])
    assert len(frames) == pytest.approx(50, abs=1)
    assert np.mean(steps_us) == pytest.approx(20_000, abs=20)
    assert np.abs(steps_us - 20_000).max() < 200
    assert board.lost_frames == 0


def test_the_encoders_filter_takes_spikes_and_leaves_edges(board: Stm32) -> None:
    for wheel in ("left", "right"):
        assert 0.5e-6 < board.peripherals.filter_s(wheel) < 0.25 / (FASTEST_COUNTS_PER_S / 4)
    board.turn("left", 10_000, 4e6)  # beyond what the filter lets pass: the simulation has one
    board.rest()
    assert last(board) == (0, 0)


def test_version(board: Stm32) -> None:
    version = board.version()
    assert (version.protocol, version.major, version.minor) == (1, 2, 1)
    assert version.flags & 1  # power came on
    assert not version.flags & WATCHDOG_RESET


@pytest.mark.parametrize(
    ("command", "body", "status"),
    [
        (LinkCommand.DRIVE, drive_body(1, -1), DONE),
        (LinkCommand.DRIVE, b"\0\0\0", BAD_LENGTH),
        (LinkCommand.DRIVE, (1001).to_bytes(2, "little", signed=True) + bytes(2), OUT_OF_RANGE),
        (LinkCommand.STOP, b"", DONE),
        (LinkCommand.STOP, b"\1", BAD_LENGTH),
        (LinkCommand.RESET_COUNTS, b"", DONE),
        (LinkCommand.SET_FORMAT, b"\0", DONE),
        (LinkCommand.SET_FORMAT, b"\1", OUT_OF_RANGE),  # the paper's bytes are too small for these encoders
        (0x86, b"\1\2", UNKNOWN),
    ],
)
def test_each_command_is_answered(board: Stm32, command: int, body: bytes, status: int) -> None:
    sequence = board.command(command, body)
    board.run(0.01)
    (ack,) = board.acks()
    assert (ack.command, ack.command_sequence, ack.status) == (command, sequence, status)


def test_reset_counts_begins_at_zero(board: Stm32) -> None:
    board.turn("right", 5000, 100_000)
    board.rest()
    board.command(LinkCommand.RESET_COUNTS)
    board.run(0.05)
    assert last(board) == (0, 0)
    board.turn("right", -70_000, 300_000)
    board.rest()
    assert last(board) == (0, -70_000)


def test_noise_on_the_line_does_nothing_and_the_next_command_is_obeyed(board: Stm32, rng: np.random.Generator) -> None:
    for _ in range(20):
        board.send(rng.bytes(100))
        board.run(0.01)
    assert board.duties() == NEUTRAL
    board.run(0.05)
    board.messages()
    sequence = board.command(LinkCommand.DRIVE, drive_body(0.25, -0.5))
    board.run(0.01)
    assert [ack.command_sequence for ack in board.acks()] == [sequence]
    assert board.duties() == pytest.approx((250, -500), abs=0.1)
    assert (board.peripherals.garbled, board.resets) == (0, 0)


def test_a_damaged_command_is_not_obeyed(board: Stm32) -> None:
    whole = encode_frame(LinkCommand.DRIVE, 1, drive_body(0.9, 0.9))
    for bit in range(8 * (len(whole) - 1)):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        board.send(b"\0" + bytes(damaged))
        board.run(0.0012)
    board.run(0.02)
    assert board.acks() == []
    assert board.duties() == NEUTRAL


def test_motors_rest_when_power_comes_on(built_stm32: Path) -> None:
    with Stm32(built_stm32 / "controller.bin") as board:
        assert board.duties() is None
        seen = set()
        for _ in range(500):
            board.run(40e-6)
            seen.add(board.duties())
    assert seen == {None, (0.0, 0.0)}
    assert board.peripherals.pwm_hz() == pytest.approx(21_000)


@pytest.mark.parametrize("left", [0, 1, -1, 250, -500, 999, 1000, -1000])
def test_duty_on_the_pins_is_what_was_commanded(board: Stm32, left: int) -> None:
    board.command(LinkCommand.DRIVE, drive_body(left / 1000, -left // 3 / 1000))
    board.run(0.01)
    assert board.duties() == pytest.approx((left, -left // 3), abs=0.1)


def seconds_until_neutral(board: Stm32) -> float:
    for step in range(1, 400):
        board.run(0.005)
        if board.duties() in (None, (0.0, 0.0)):
            return 0.005 * step
    return 2.0


def test_motors_rest_a_quarter_second_after_the_last_command(board: Stm32) -> None:
    board.command(LinkCommand.DRIVE, drive_body(0.6, 0.6))
    board.run(0.004)
    assert board.duties() != NEUTRAL
    assert seconds_until_neutral(board) == pytest.approx(0.25, abs=0.01)


def test_ten_commands_a_second_keep_them_turning_and_others_do_not(board: Stm32) -> None:
    for _ in range(5):
        board.command(LinkCommand.DRIVE, drive_body(0.6, 0.6))
        board.run(0.1)
        assert board.duties() == pytest.approx((600, 600), abs=0.1)
    for _ in range(4):
        board.command(LinkCommand.GET_VERSION)
        board.run(0.1)
    assert board.duties() == NEUTRAL


def test_a_program_that_hangs_is_started_again_with_motors_at_rest(board: Stm32) -> None:
    board.command(LinkCommand.DRIVE, drive_body(0.9, 0.9))
    board.run(0.01)
    assert board.duties() != NEUTRAL
    board.hang()
    assert seconds_until_neutral(board) < 0.1
    board.run(0.1)
    assert board.resets == 1
    assert board.version().flags & WATCHDOG_RESET


def test_without_a_crystal_the_motors_are_never_driven(built_stm32: Path) -> None:
    with Stm32(built_stm32 / "controller.bin", has_crystal=False) as board:
        for _ in range(200):
            board.run(0.001)
            assert board.duties() is None
        assert board.resets > 1
        assert board.sent() == []


def wait(is_so: Callable[[], bool]) -> None:
    until = time.monotonic() + 60
    while not is_so():
        assert time.monotonic() < until, "it never came"
        time.sleep(0.01)


@pytest.mark.slow
def test_the_link_over_a_pseudo_terminal(board: Stm32) -> None:
    """In real time where the machine keeps up; where not, the board's clock lags, and nothing is lost."""
    path, is_over = board.terminal(), threading.Event()

    def live() -> None:
        while not is_over.is_set():
            begun_s = time.monotonic()
            board.serve(0.005)
            time.sleep(max(0.0, begun_s + 0.005 - time.monotonic()))

    thread = threading.Thread(target=live)
    thread.start()
    try:
        with WheelLink(path) as link:
            wait(lambda: link.status is LinkStatus.CONNECTED)
            assert link.report().format is Format.FRAMED
            board.turn("left", 150_000, FASTEST_COUNTS_PER_S)
            board.turn("right", -90_000, 0.7 * FASTEST_COUNTS_PER_S)
            wait(lambda: (tick := link.report().last) is not None and (tick.left, tick.right) == (150_000, -90_000))
            assert link.ask_version().major == 2
            link.drive(0.5, -0.25)
            wait(lambda: board.duties() == pytest.approx((500, -250), abs=0.1))
            link.stop()
            assert board.duties() == NEUTRAL
            report = link.report()
            assert (report.line.lost, report.line.crc_errors, report.restarts) == (0, 0, 0)
    finally:
        is_over.set()
        thread.join()
