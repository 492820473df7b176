from __future__ import annotations

import numpy as np
import pytest

from firmware.simulation.simulated_chip import CHIP_HZ, FASTEST_PULSES_PER_S, Chip
from wheelsight.io.devices.wire_formats import Ack, Counts, FrameDecoder, LinkCommand, Nearby, drive_body


@pytest.fixture
def paper_chip(chip: Chip) -> Chip:
    """A chip that was commanded to use the paper's format; its answer, the last frame, has been read."""
    chip.command(LinkCommand.SET_FORMAT, b"\1")
    chip.run(0.005)
    answer = chip.messages()[-1]
    assert isinstance(answer, Ack)
    assert (answer.command, answer.status) == (LinkCommand.SET_FORMAT, 0)
    return chip


def pairs(chip: Chip) -> tuple[np.ndarray, np.ndarray]:
    """Seconds at which pairs began, and their pulses as rows (left, right). Right comes first on the line."""
    sent = chip.sent()
    assert len(sent) % 2 == 0
    numbers = np.array([byte for _, byte in sent], np.uint8).astype(np.int8).astype(int).reshape(-1, 2)
    seconds = np.array([cycle for cycle, _ in sent])[::2] / CHIP_HZ
    return seconds, numbers[:, ::-1]


def test_two_bytes_every_20_ms(paper_chip: Chip) -> None:
    paper_chip.run(2)
    seconds, pulses = pairs(paper_chip)
    assert np.all(pulses == 0)
    assert len(seconds) == pytest.approx(100, abs=1)
    assert np.abs(np.diff(seconds) - 0.02).max() < 0.0002


def test_right_comes_before_left_and_pulses_are_signed(paper_chip: Chip) -> None:
    paper_chip.turn("left", 4 * 300, 3000)
    paper_chip.turn("right", -4 * 200, 2000)
    paper_chip.rest()
    _, pulses = pairs(paper_chip)
    assert pulses.sum(axis=0).tolist() == [300, -200]
    assert pulses[:, 0].min() >= 0 >= pulses[:, 1].max()
    assert pulses[:, 0].max() == pytest.approx(60, abs=1)


@pytest.mark.parametrize(("left", "right"), [(1, 1), (-1, -1), (1, -1), (1, 0)])
def test_a_full_frame_is_sent_early_and_no_pulse_is_lost(paper_chip: Chip, left: int, right: int) -> None:
    # At full speed 20 ms hold 157 pulses, and a byte 127.
    paper_chip.turn("left", left * 4 * FASTEST_PULSES_PER_S, FASTEST_PULSES_PER_S)
    paper_chip.turn("right", right * 4 * FASTEST_PULSES_PER_S, 0.9 * FASTEST_PULSES_PER_S)
    paper_chip.rest()
    seconds, pulses = pairs(paper_chip)
    assert tuple(pulses.sum(axis=0)) == paper_chip.pulses()
    assert np.abs(pulses).max() in (100, 101)
    assert np.abs(np.diff(seconds) * FASTEST_PULSES_PER_S - 100).min() < 2
    assert np.diff(seconds).min() > 0.01  # a silence, by which pairs are distinguished


def test_speeds_beyond_the_papers_lose_nothing_either(paper_chip: Chip) -> None:
    for direction in (1, -2):
        paper_chip.turn("left", direction * 4 * 9000, 18_000)
        paper_chip.turn("right", direction * 4 * 5000, 18_011)
    paper_chip.rest()
    _, pulses = pairs(paper_chip)
    assert tuple(pulses.sum(axis=0)) == paper_chip.pulses() == (-9000, -5000)


def test_commands_are_obeyed_and_not_answered(paper_chip: Chip) -> None:
    paper_chip.command(LinkCommand.DRIVE, drive_body(0.5, -0.5))
    paper_chip.command(LinkCommand.GET_VERSION)
    paper_chip.command(0x99)
    paper_chip.run(0.02)
    assert paper_chip.duties() == pytest.approx((500, -500), abs=1)
    _, pulses = pairs(paper_chip)
    assert np.all(pulses == 0)


def test_back_to_frames(paper_chip: Chip) -> None:
    paper_chip.turn("left", 400, 1000)
    paper_chip.rest()
    paper_chip.command(LinkCommand.SET_FORMAT, b"\0")
    paper_chip.run(0.1)
    messages = [message for message in paper_chip.messages() if not isinstance(message, Nearby)]
    first, answer, counts = messages[0], messages[1], messages[-1]
    assert first[2:] == counts[2:]
    assert isinstance(answer, Ack)
    assert (answer.command, answer.status) == (LinkCommand.SET_FORMAT, 0)
    assert counts[2:] == (100, 0)  # the whole count: pulses reported in pairs are not forgotten
    assert len(messages) == pytest.approx(7, abs=1)


def test_the_last_pair_and_the_first_frame_are_of_one_instant(paper_chip: Chip) -> None:
    paper_chip.turn("left", 4 * FASTEST_PULSES_PER_S, FASTEST_PULSES_PER_S)
    paper_chip.run(0.317)
    paper_chip.command(LinkCommand.SET_FORMAT, b"\0")
    paper_chip.run(0.004)
    sent = bytes(byte for _, byte in paper_chip.sent())
    decoder = FrameDecoder()
    counts, answer = decoder.feed(sent)
    pulses, zero = sent[: -decoder.begun - 1], sent[-decoder.begun - 1]
    assert isinstance(answer, Ack)
    assert isinstance(counts, Counts)
    assert zero == 0
    assert counts.left == np.frombuffer(pulses, np.int8)[1::2].sum() > 2000


def test_pulses_since_the_last_frame_are_in_the_first_pairs(chip: Chip) -> None:
    chip.turn("left", 4 * FASTEST_PULSES_PER_S, FASTEST_PULSES_PER_S)
    chip.run(0.113)
    chip.command(LinkCommand.SET_FORMAT, b"\1")
    chip.rest()
    sent = bytes(byte for _, byte in chip.sent())
    decoder = FrameDecoder()
    messages = decoder.feed(sent)
    reported = [message for message in messages if isinstance(message, Counts)][-1].left
    pulses = np.frombuffer(sent[-decoder.ended :], np.int8)[1::2]
    assert isinstance(messages[-1], Ack)
    assert reported > 0
    assert reported + pulses.sum() == FASTEST_PULSES_PER_S


def test_asked_for_again_it_goes_on(paper_chip: Chip) -> None:
    paper_chip.turn("left", 4000, 5000)
    for _ in range(15):
        paper_chip.command(LinkCommand.SET_FORMAT, b"\1")
        paper_chip.run(0.011)
    paper_chip.rest()
    seconds, pulses = pairs(paper_chip)
    assert pulses[:, 0].sum() == 1000
    assert np.diff(seconds).max() < 0.021


def test_what_was_counted_before_the_change_is_not_reported_again(chip: Chip) -> None:
    chip.turn("left", 4000, 5000)
    chip.rest()
    chip.command(LinkCommand.SET_FORMAT, b"\1")
    chip.run(0.005)
    chip.messages()
    chip.run(0.1)
    _, pulses = pairs(chip)
    assert np.all(pulses == 0)


def test_reset_loses_no_pair(paper_chip: Chip) -> None:
    paper_chip.turn("left", 400, 1000)
    paper_chip.rest()
    paper_chip.command(LinkCommand.RESET_COUNTS)
    paper_chip.turn("left", 400, 1000)
    paper_chip.rest()
    _, pulses = pairs(paper_chip)
    assert pulses[:, 0].sum() == 200
