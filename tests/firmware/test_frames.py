from __future__ import annotations

import numpy as np
import pytest

from firmware.simulation.simulated_chip import CHIP_HZ, WATCHDOG_RESET, Chip
from wheelsight.io.devices.wire_formats import Ack, Counts, LinkCommand, drive_body

UBRRL, UCSRA, UCSRC = 0x29, 0x2B, 0x40
U2X, TWO_STOP_BITS, PARITY, EIGHT_BITS = 1 << 1, 1 << 3, 3 << 4, 3 << 1
DONE, UNKNOWN, BAD_LENGTH, OUT_OF_RANGE = range(4)
CYCLES_A_BYTE = CHIP_HZ * 10 // 115_200


def test_the_line_is_115200_baud_8n1(chip: Chip) -> None:
    divider, state, shape = (int(chip.ask(f"peek {address}")[0]) for address in (UBRRL, UCSRA, UCSRC))
    assert CHIP_HZ / (16 * (divider + 1)) == 115_200
    assert not state & U2X
    assert shape & EIGHT_BITS == EIGHT_BITS
    assert not shape & (TWO_STOP_BITS | PARITY)


def test_bytes_of_a_frame_follow_each_other_without_a_gap(chip: Chip) -> None:
    chip.run(1)
    cycles = np.array([cycle for cycle, _ in chip.sent()])
    steps = np.diff(cycles)
    inside = steps[steps < CHIP_HZ // 200]
    assert len(inside) > 800
    assert np.median(inside) == pytest.approx(CYCLES_A_BYTE, abs=60)
    assert inside.max() < CYCLES_A_BYTE + 200


def test_a_frame_comes_every_20_ms_and_none_is_lost(chip: Chip) -> None:
    chip.run(1)
    sent = chip.sent()
    # After a zero come COBS's first byte and the type: 1 is that of counts.
    starts = [sent[at][0] for at in range(1, len(sent) - 1) if sent[at - 1][1] == 0 and sent[at + 1][1] == 1]
    steps_ms = np.diff(starts) / CHIP_HZ * 1000
    assert len(starts) == pytest.approx(50, abs=1)
    assert np.abs(steps_ms - 20).max() < 0.1
    assert np.mean(steps_ms) == pytest.approx(20, abs=1e-3)


def test_the_clock_keeps_time(chip: Chip) -> None:
    chip.run(1)
    messages = chip.messages()
    steps_us = np.diff([message.clock_us for message in messages if isinstance(message, Counts)])
    assert np.abs(steps_us - 20_000).max() < 50
    assert np.mean(steps_us) == pytest.approx(20_000, abs=1)
    first = messages[0].sequence
    assert [message.sequence for message in messages] == [(first + i) & 0xFF for i in range(len(messages))]


def test_version(chip: Chip) -> None:
    version = chip.version()
    assert (version.protocol, version.major, version.minor) == (1, 1, 2)
    assert not version.flags & WATCHDOG_RESET


@pytest.mark.parametrize(
    ("command", "body", "status"),
    [
        (LinkCommand.DRIVE, drive_body(0.1, -0.1), DONE),
        (LinkCommand.DRIVE, drive_body(1, -1), DONE),
        (LinkCommand.DRIVE, b"\0\0\0", BAD_LENGTH),
        (LinkCommand.DRIVE, b"\0\0\0\0\0", BAD_LENGTH),
        (LinkCommand.DRIVE, (1001).to_bytes(2, "little", signed=True) + bytes(2), OUT_OF_RANGE),
        (LinkCommand.DRIVE, bytes(2) + (-1001).to_bytes(2, "little", signed=True), OUT_OF_RANGE),
        (LinkCommand.STOP, b"", DONE),
        (LinkCommand.STOP, b"\1", BAD_LENGTH),
        (LinkCommand.GET_VERSION, b"", DONE),
        (LinkCommand.RESET_COUNTS, b"", DONE),
        (LinkCommand.RESET_COUNTS, b"\0", BAD_LENGTH),
        (LinkCommand.SET_FORMAT, b"\0", DONE),
        (LinkCommand.SET_FORMAT, b"\2", OUT_OF_RANGE),
        (LinkCommand.SET_FORMAT, b"", BAD_LENGTH),
        (0x80, b"", UNKNOWN),
        (0x86, b"\1\2", UNKNOWN),
        (0xFF, b"", UNKNOWN),
        (0x01, b"", UNKNOWN),
    ],
)
def test_each_command_is_answered(chip: Chip, command: int, body: bytes, status: int) -> None:
    sequence = chip.command(command, body)
    chip.run(0.005)
    (ack,) = chip.acks()
    assert (ack.command, ack.command_sequence, ack.status) == (command, sequence, status)


def test_frames_count_on_through_answers(chip: Chip) -> None:
    for _ in range(300):
        chip.command(LinkCommand.STOP)
        chip.run(0.002)
    messages = chip.messages()
    assert sum(isinstance(message, Ack) for message in messages) == 300
    assert sum(isinstance(message, Counts) for message in messages) >= 29
    assert chip.lost_frames == 0


def test_a_line_that_is_behind_loses_whole_frames_and_says_so(chip: Chip) -> None:
    # 12 bytes of GET_VERSION make 19 of answers: faster than the line takes them.
    for _ in range(200):
        chip.command(LinkCommand.GET_VERSION)
    chip.run(0.3)
    messages = chip.messages()
    assert chip.lost_frames > 0
    assert messages, "those that fit must be whole"
    chip.run(0.1)
    chip.messages()
    before = chip.lost_frames
    chip.run(0.5)
    assert len(chip.counts()) == pytest.approx(25, abs=1)
    assert chip.lost_frames == before
