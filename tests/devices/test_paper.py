"""The paper's two bytes, and how either format is recognised."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.io.devices.wire_formats import (
    Ack,
    Counts,
    Decoded,
    Format,
    LineDecoder,
    Message,
    PaperDecoder,
    Pulses,
    encode_message,
)

PERIOD_S = 0.02
Got = list[Decoded]


def pair(left: int, right: int) -> bytes:
    return bytes([right & 0xFF, left & 0xFF])


def paired(decoder: LineDecoder, counts: np.ndarray, start_s: float) -> Got:
    got: Got = []
    for n, (left, right) in enumerate(counts.tolist()):
        got += decoder.feed(pair(left, right), start_s + PERIOD_S * n)
    got += decoder.feed(b"", start_s + PERIOD_S * (len(counts) - 0.5))  # a pair is one after the silence behind it
    return got


def framed(decoder: LineDecoder, count: int, start_s: float, first: int = 0) -> Got:
    got: Got = []
    for n in range(first, first + count):
        got += decoder.feed(encode_message(Counts(n & 0xFF, 20_000 * n, n, n)), start_s + PERIOD_S * (n - first))
    return got


def pulses_of(got: Got) -> list[list[int]]:
    """Pulses of the left and the right wheel, of answers which are all pulses."""
    assert all(isinstance(reported, Pulses) for reported in got)
    return [[reported.left, reported.right] for reported in got if isinstance(reported, Pulses)]


def format_of(decoder: LineDecoder) -> Format | None:
    return decoder.format


@pytest.fixture
def counts(rng: np.random.Generator) -> np.ndarray:
    return rng.integers(-100, 101, (200, 2))


def test_right_comes_first_and_both_are_signed() -> None:
    assert PaperDecoder().feed(bytes([1, 0xFF]), 5.0) == [Pulses(5.0, -1, 1, True)]
    (extreme,) = PaperDecoder().feed(bytes([0x80, 0x7F]), 5.0)
    assert (extreme.left, extreme.right) == (127, -128)


def test_a_pair_may_come_in_two_reads() -> None:
    decoder = PaperDecoder()
    assert decoder.feed(b"\x01", 5.0) == []
    assert decoder.feed(b"\x02", 5.001) == [Pulses(5.001, 2, 1, True)]


def test_a_lost_byte_costs_its_pair_and_no_other() -> None:
    decoder = PaperDecoder()
    got = [*decoder.feed(pair(1, 2), 0.0), *decoder.feed(b"\x09", 0.02)]
    for n in range(2, 5):
        got += decoder.feed(pair(n, -n), PERIOD_S * n)
    assert [(pulses.left, pulses.right) for pulses in got] == [(1, 2), (2, -2), (3, -3), (4, -4)]
    assert (decoder.statistics.malformed, decoder.statistics.frames) == (1, 4)


def test_pairs_that_waited_are_taken_in_twos() -> None:
    got = PaperDecoder().feed(pair(1, 2) + pair(3, 4) + pair(5, 6), 9.0)
    assert [(pulses.left, pulses.right, pulses.follows_silence) for pulses in got] == [
        (1, 2, True),
        (3, 4, False),
        (5, 6, False),
    ]


def test_the_papers_format_is_recognised_in_half_a_second_and_no_pulse_is_lost(counts: np.ndarray) -> None:
    decoder = LineDecoder()
    assert paired(decoder, counts[:25], 0.0) == []
    assert format_of(decoder) is None
    got = paired(decoder, counts[25:], 25 * PERIOD_S)
    assert format_of(decoder) is Format.PAPER
    assert pulses_of(got) == counts.tolist()
    np.testing.assert_allclose(
        [reported.arrival_s for reported in got if isinstance(reported, Pulses)], PERIOD_S * np.arange(200)
    )
    assert (decoder.statistics.frames, decoder.statistics.malformed) == (200, 0)


def test_wheels_at_rest_are_recognised_too() -> None:
    decoder = LineDecoder()
    assert len(paired(decoder, np.zeros((60, 2), int), 0.0)) == 60
    assert format_of(decoder) is Format.PAPER


def test_one_frame_is_enough_for_framed() -> None:
    decoder = LineDecoder()
    got = framed(decoder, 1, 0.0)
    assert got == [Counts(0, 0, 0, 0)]
    assert format_of(decoder) is Format.FRAMED


def test_a_change_of_format_is_followed_both_ways(counts: np.ndarray) -> None:
    decoder = LineDecoder()
    framed(decoder, 100, 0.0)
    got = paired(decoder, counts, 100 * PERIOD_S)
    assert pulses_of(got) == counts.tolist()
    assert format_of(decoder) is Format.PAPER
    assert len(framed(decoder, 50, 300 * PERIOD_S, first=100)) >= 49
    assert format_of(decoder) is Format.FRAMED
    assert decoder.statistics.crc_errors == 0


def late(stamps_s: np.ndarray, rng: np.random.Generator) -> list[float]:
    """When a busy host reads what came at these stamps: delayed by some milliseconds, now and then by a second."""
    read, free_s = [], 0.0
    for stamp_s in stamps_s:
        free_s = max(free_s, stamp_s + rng.exponential(0.004))
        if rng.random() < 0.02:
            free_s += rng.uniform(0.1, 1.2)
        read.append(free_s)
    return read


def test_halves_of_a_pair_that_come_apart_are_joined() -> None:
    """As a USB adapter hands them over, or a host that was held up between them."""
    decoder = PaperDecoder()
    got = [*decoder.feed(pair(1, 2), 0.0), *decoder.feed(pair(3, 4)[:1], 0.02), *decoder.feed(pair(3, 4)[1:], 0.036)]
    got += decoder.feed(pair(5, 6), 0.04)
    assert [(pulses.left, pulses.right) for pulses in got] == [(1, 2), (3, 4), (5, 6)]
    assert (decoder.torn, decoder.statistics.malformed) == (1, 0)


def test_a_host_held_up_within_a_pair_still_takes_it_for_one(counts: np.ndarray) -> None:
    decoder = LineDecoder()
    got: Got = []
    for n, (left, right) in enumerate(counts.tolist()):
        first, second = pair(left, right)
        got += decoder.feed(bytes([first]), PERIOD_S * n)
        got += decoder.feed(bytes([second]), PERIOD_S * n + 0.009, was_waiting=True)
    got += decoder.feed(b"", PERIOD_S * len(counts))
    assert pulses_of(got) == counts.tolist()


@pytest.mark.parametrize("seed", range(8))
def test_a_busy_host_neither_loses_nor_doubles_a_pulse(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(-100, 101, (2000, 2))
    decoder, formats = LineDecoder(), set()
    got: Got = paired(decoder, counts[:50], 0.0)
    for (left, right), read_s in zip(
        counts[50:].tolist(), late(PERIOD_S * np.arange(50, len(counts)), rng), strict=True
    ):
        got += decoder.feed(pair(left, right), read_s)
        formats.add(decoder.format)
    got += decoder.feed(b"", 1e3)
    assert formats == {Format.PAPER}
    assert pulses_of(got) == counts.tolist()


def test_a_slow_controller_is_recognised_later(counts: np.ndarray) -> None:
    """As a simulated one on a busy machine, at a seventh of its speed."""
    decoder = LineDecoder()
    got: Got = []
    for n, row in enumerate(counts[:40].tolist()):
        got += decoder.feed(pair(*row), 0.15 * n)
    got += decoder.feed(b"", 100.0)
    assert format_of(decoder) is Format.PAPER
    assert pulses_of(got) == counts[:40].tolist()


def test_a_controller_held_up_for_seconds_is_still_known(counts: np.ndarray) -> None:
    """As a simulated one on a busy machine, which sends fewer pairs than the wall's clock asks for."""
    decoder = LineDecoder()
    got: Got = []
    start_s = 0.0
    for part in np.split(counts, 5):
        got += paired(decoder, part, start_s)
        start_s += 5.0
    assert format_of(decoder) is Format.PAPER
    assert pulses_of(got) == counts.tolist()


def test_noise_after_pairs_is_not_taken_for_pulses_for_long(counts: np.ndarray, rng: np.random.Generator) -> None:
    decoder = LineDecoder()
    paired(decoder, counts, 0.0)
    got: Got = []
    for n in range(400):
        got += decoder.feed(rng.bytes(18), 200 * PERIOD_S + PERIOD_S * n)
    assert format_of(decoder) is None
    assert len(got) < 100


@pytest.mark.parametrize("size", [1, 2, 5, 100])
@pytest.mark.parametrize("is_reported", [True, False])
def test_frames_after_pairs_are_not_misread_as_pulses(counts: np.ndarray, size: int, is_reported: bool) -> None:
    """As the firmware changes over: a last pair, a zero, and frames, without a silence, read in pieces of any size."""
    decoder = LineDecoder()
    got = paired(decoder, counts, 0.0)
    decoder.expect_frames(is_reported)
    messages: list[Message] = [Counts(0, 4_000_000, 7833, -3916), Ack(1, 0x85, 9, 0), Counts(2, 4_020_000, 7900, -3900)]
    change = pair(0, 99) + b"\0" + b"".join(encode_message(message) for message in messages)
    start_s = PERIOD_S * len(counts)
    for at in range(0, len(change), size):
        got += decoder.feed(change[at : at + size], start_s + 1e-4 * at)
    assert got[-3:] == messages
    assert pulses_of(got[:-3]) == [*counts.tolist(), [0, 99]]
    assert format_of(decoder) is Format.FRAMED
    assert decoder.feed(b"", start_s + 1) == ()


def test_frames_that_come_in_pieces_seconds_apart_are_no_pulses_once_they_are_expected(counts: np.ndarray) -> None:
    decoder = LineDecoder()
    got = paired(decoder, counts, 0.0)
    decoder.expect_frames(True)
    frame = encode_message(Ack(1, 0x85, 9, 0))
    for n, piece in enumerate((b"\0" + frame[:3], frame[3:6], b"", frame[6:])):
        got += decoder.feed(piece, PERIOD_S * len(counts) + n)
    assert len(got) == len(counts) + 1
    assert isinstance(got[-1], Ack)


def test_pairs_behind_a_frame_in_one_read_are_not_lost(counts: np.ndarray) -> None:
    decoder = LineDecoder()
    framed(decoder, 100, 0.0)
    start_s = 100 * PERIOD_S
    first = b"".join(pair(*row) for row in counts[:3].tolist())
    got = [*decoder.feed(encode_message(Ack(100, 0x85, 9, 0)) + first, start_s)]
    got += paired(decoder, counts[3:], start_s + 3 * PERIOD_S)
    assert pulses_of(got[1:]) == counts.tolist()


@pytest.mark.parametrize("piece", [1, 3, 7, 18])
def test_random_bytes_are_neither(piece: int, rng: np.random.Generator) -> None:
    decoder = LineDecoder()
    got: Got = []
    for n in range(300):
        got += decoder.feed(rng.bytes(piece), PERIOD_S * n)
    assert format_of(decoder) is None
    assert got == []


@pytest.mark.parametrize("factor", [2, 3, 4, 6, 8, 12])
@pytest.mark.parametrize("is_slower", [True, False])
def test_framed_counts_at_a_wrong_baud_rate_are_neither(factor: int, is_slower: bool) -> None:
    decoder = LineDecoder()
    for n in range(300):
        frame = encode_message(Counts(n & 0xFF, 20_000 * n + n % 7, 3 * n, -5 * n))
        decoder.feed(misread(frame, factor, is_slower), PERIOD_S * n)
    assert format_of(decoder) is None


def misread(data: bytes, factor: int, is_slower: bool) -> bytes:
    """What a receiver makes of 8N1 bytes that are sent `factor` times as fast, or as slowly, as it expects."""
    levels = [level for byte in data for level in (0, *((byte >> bit) & 1 for bit in range(8)), 1)]
    steps_a_bit, stretch = (factor, 1) if is_slower else (1, factor)
    line = [level for level in levels for _ in range(stretch)] + [1] * 12 * steps_a_bit
    read, at = [], 0
    while at < len(line) - 10 * steps_a_bit:
        if line[at]:
            at += 1
            continue
        middle = at + steps_a_bit // 2
        read.append(sum(line[middle + steps_a_bit * (1 + bit)] << bit for bit in range(8)))
        at = middle + 9 * steps_a_bit
        while at < len(line) and not line[at]:
            at += 1  # no stop bit: wait for the line to rest
    return bytes(read)
