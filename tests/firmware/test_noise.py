from __future__ import annotations

import numpy as np
import pytest

from firmware.simulation.simulated_chip import FASTEST_PULSES_PER_S, Chip
from wheelsight.io.devices.wire_formats import LinkCommand, drive_body, encode_frame


@pytest.mark.slow
def test_a_command_is_heard_after_any_garbage(chip: Chip, rng: np.random.Generator) -> None:
    for round_ in range(40):
        chip.send(rng.bytes(int(rng.integers(1, 300))))
        chip.run(0.03)
        chip.messages()
        sequence = chip.command(LinkCommand.STOP)
        chip.run(0.005)
        assert [(ack.command_sequence, ack.status) for ack in chip.acks()] == [(sequence, 0)], round_


def test_garbage_of_a_second_neither_moves_motors_nor_disturbs_counts(chip: Chip, rng: np.random.Generator) -> None:
    for wheel in ("left", "right"):
        chip.turn(wheel, 4 * FASTEST_PULSES_PER_S, FASTEST_PULSES_PER_S)
    chip.send(rng.bytes(11_520))
    chip.rest()
    counts = chip.counts()
    assert counts[-1][2:] == chip.pulses()
    assert len(counts) == pytest.approx(53, abs=2)
    assert chip.lost_frames == 0
    assert chip.duties() == pytest.approx((0, 0), abs=1)


def test_no_byte_is_lost_at_full_line_rate_and_full_speed(chip: Chip) -> None:
    for wheel in ("left", "right"):
        chip.turn(wheel, 4 * FASTEST_PULSES_PER_S, FASTEST_PULSES_PER_S)
    sent = [chip.command(LinkCommand.DRIVE, drive_body(0.1, 0.2)) for _ in range(400)]
    chip.rest()
    (unread,) = map(int, chip.ask("unread"))
    assert unread <= 2  # the chip's own buffer holds so many
    assert [ack.command_sequence for ack in chip.acks()] == sent


def test_a_damaged_command_is_not_obeyed(chip: Chip) -> None:
    whole = encode_frame(LinkCommand.DRIVE, 1, drive_body(0.9, 0.9))
    for bit in range(8 * (len(whole) - 1)):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        chip.send(b"\0" + bytes(damaged))
    chip.run(0.2)
    assert chip.acks() == []
    assert chip.duties() == pytest.approx((0, 0), abs=1)


@pytest.mark.parametrize("cut", range(1, 10))
def test_a_command_cut_short_is_not_obeyed_and_the_next_is(chip: Chip, cut: int) -> None:
    whole = encode_frame(LinkCommand.DRIVE, 1, drive_body(0.9, 0.9))
    chip.send(whole[:-1][:-cut] + b"\0" + encode_frame(LinkCommand.STOP, 2))
    chip.run(0.01)
    assert [(ack.command, ack.command_sequence) for ack in chip.acks()] == [(LinkCommand.STOP, 2)]


def test_a_frame_too_long_is_passed_over(chip: Chip) -> None:
    chip.send(encode_frame(LinkCommand.STOP, 1, bytes(range(1, 200))) + encode_frame(LinkCommand.STOP, 2))
    chip.run(0.1)
    assert [ack.command_sequence for ack in chip.acks()] == [2]


def test_empty_frames_are_silence(chip: Chip) -> None:
    chip.send(bytes(50) + encode_frame(LinkCommand.STOP, 7) + bytes(3))
    chip.run(0.05)
    assert [ack.command_sequence for ack in chip.acks()] == [7]
