"""The line that anybody's sketch prints: recognised, read, and never believed where it is torn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.messages import WheelTicks
from wheelsight.io.devices.tick_tracking import TickTracker
from wheelsight.io.devices.wire_formats import (
    Counts,
    Decoded,
    Format,
    LineDecoder,
    PlainReading,
    Version,
    encode_message,
    is_plain_line,
    parse_line,
)

PERIOD_S = 0.02
Positions = Callable[[float], tuple[int, int]]


def driving(time_s: float) -> tuple[int, int]:
    """A wheel that goes, one that goes to and fro."""
    return int(1500 * time_s), int(400 * np.sin(time_s))


@dataclass
class Host:
    """What a link makes of bytes: decoder and tracker."""

    decoder: LineDecoder = field(default_factory=LineDecoder)
    tracker: TickTracker = field(default_factory=TickTracker)
    ticks: list[WheelTicks] = field(default_factory=list)

    def hear(self, data: bytes, arrival_s: float) -> None:
        for reported in self.decoder.feed(data, arrival_s):
            if isinstance(reported, PlainReading):
                self.ticks += self.tracker.add_line(reported)
            elif isinstance(reported, Counts):
                self.ticks += self.tracker.add_counts(reported, arrival_s)

    def listen(self, lines: Sequence[bytes], start_s: float = 100.0) -> None:
        for n, line in enumerate(lines):
            self.hear(line, start_s + PERIOD_S * n)

    @property
    def format(self) -> Format | None:
        return self.decoder.format

    @property
    def last(self) -> tuple[int, int]:
        return self.ticks[-1].left, self.ticks[-1].right


def printed(
    count: int, separator: str = ",", unit_s: float | None = None, start_s: float = 3.0, positions: Positions = driving
) -> list[bytes]:
    lines = []
    for n in range(count):
        fields: tuple[int, ...] = positions(PERIOD_S * n)
        if unit_s is not None:
            fields = (int((start_s + PERIOD_S * n) / unit_s) % (1 << 32), *fields)
        lines.append(separator.join(map(str, fields)).encode() + b"\r\n")
    return lines


@pytest.mark.parametrize("separator", [",", ";", " ", "\t", ", ", " ; "])
@pytest.mark.parametrize("unit_s", [None, 1e-3, 1e-6])
def test_lines_are_recognised_in_half_a_second_and_tell_all_motion(separator: str, unit_s: float | None) -> None:
    host = Host()
    lines = printed(200, separator, unit_s)
    host.listen(lines[:25])
    assert host.ticks == []
    host.listen(lines[25:], 100.0 + 25 * PERIOD_S)
    assert host.format is Format.PLAIN
    assert host.last == driving(199 * PERIOD_S)
    assert len(host.ticks) == 199  # the first is what may have been torn
    assert (host.decoder.statistics.frames, host.decoder.statistics.malformed) == (199, 0)
    assert (host.tracker.restarts, host.tracker.refused) == (0, 0)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (b"12,-7", (None, 12, -7)),
        (b" +12 ; 7 ", (None, 12, 7)),
        (b"5000\t1 2", (5000, 1, 2)),
        (b"4294967295,4294967295,-2147483648", (4294967295, 4294967295, -2147483648)),
    ],
)
def test_a_line_of_counts(line: bytes, expected: tuple[int | None, int, int]) -> None:
    assert parse_line(line, 9.0) == PlainReading(9.0, *expected)


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"12",
        b"1,2,3,4",
        b"1.5,2",
        b"left,right",
        b"1,,2",
        b"1,2,",
        b"-5,1,2",
        b"4294967296,1",
        b"1,2\0",
        b"1e3,2",
        b"--1,2",
    ],
)
def test_no_line_of_counts(line: bytes) -> None:
    assert parse_line(line, 9.0) is None


@given(st.binary(max_size=80))
def test_whatever_comes_is_no_crash(data: bytes) -> None:
    host = Host()
    for n in range(4):
        host.hear(data, 1.0 + n)


@given(st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_lines_may_be_cut_anywhere(sizes: list[int]) -> None:
    host, data, at = Host(), b"".join(printed(60, unit_s=1e-3)), 0
    starts = np.cumsum([0, *(len(line) for line in printed(60, unit_s=1e-3))])
    while at < len(data):
        size = sizes[at % len(sizes)]
        line = int(np.searchsorted(starts, min(at + size, len(data)), side="right")) - 1
        host.hear(data[at : at + size], 100.0 + PERIOD_S * line)
        at += size
    assert host.format is Format.PLAIN
    assert host.last == driving(59 * PERIOD_S)


@pytest.mark.parametrize("ends", [b"\n", b"\r", b"\r\n"])
def test_any_end_of_a_line(ends: bytes) -> None:
    host = Host()
    host.listen([line.replace(b"\r\n", ends) for line in printed(100)])
    assert host.last == driving(99 * PERIOD_S)


def test_a_header_and_other_text_between_are_counted_and_reported() -> None:
    host = Host()
    lines = printed(100)
    for at in range(10, 100, 10):
        lines[at] = b"battery 12.3 V\n" + lines[at]
    host.listen([b"boot\n", b"left,right\r\n", *lines])
    assert host.last == driving(99 * PERIOD_S)
    assert host.decoder.statistics.malformed == 10  # the header, and nine of the battery
    assert host.decoder.other_line == "battery 12.3 V"


def test_text_without_counts_is_text_and_no_counts() -> None:
    host = Host()
    host.listen([f"x={n} y={n * n}\n".encode() for n in range(100)])
    assert host.format is None
    assert host.decoder.is_text
    assert host.ticks == []


def test_three_columns_of_which_the_first_is_no_time_are_no_counts() -> None:
    host = Host()
    host.listen([f"{n // 7},{n},{n}\n".encode() for n in range(200)])
    assert host.format is None
    assert host.decoder.is_text


def test_random_bytes_are_no_lines(rng: np.random.Generator) -> None:
    host = Host()
    for n in range(2000):
        host.hear(rng.bytes(18), 100 + PERIOD_S * n)
    assert host.format is None
    assert not host.decoder.is_text


def misprinted(line: bytes, rng: np.random.Generator) -> bytes:
    """A line of which bytes were lost, changed or doubled on the way."""
    at = int(rng.integers(len(line)))
    kind = rng.integers(4)
    if kind == 0:
        return line[:at] + line[at + 1 :]
    if kind == 1:
        return line[:at] + bytes([line[at] ^ (1 << int(rng.integers(7)))]) + line[at + 1 :]
    if kind == 2:
        return line[:at] + line[at + int(rng.integers(1, 12)) :]
    return line[:at] + line[at : at + 1] + line[at:]


def walk(rng: np.random.Generator, count: int) -> np.ndarray:
    """Counts of both wheels that gain speed, brake, stand and turn about: up to 60 a line, by 5 more or less each."""
    steps = np.zeros((count, 2))
    for wheel in range(2):
        wanted = np.repeat(rng.integers(-60, 61, count // 50 + 1), 50)[:count]
        for n in range(1, count):
            steps[n, wheel] = steps[n - 1, wheel] + np.clip(wanted[n] - steps[n - 1, wheel], -5, 5)
    return np.cumsum(steps, axis=0).astype(int) + rng.integers(0, 3000, 2)


@pytest.mark.parametrize("has_time", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_damaged_lines_become_no_jumps(seed: int, has_time: bool) -> None:
    """One line in ten is damaged. What is believed is where the wheels are, to what one line's motion hides."""
    rng = np.random.default_rng(seed)
    truth = walk(rng, 3000)
    host = Host()
    for n, (left, right) in enumerate(truth.tolist()):
        line = f"{20 * n + 3000},{left},{right}\n" if has_time else f"{left},{right}\n"
        data = line.encode()
        if n > 60 and rng.random() < 0.1:
            data = misprinted(data, rng)
        host.hear(data, 100 + PERIOD_S * n)
    for ticks in host.ticks:
        at = round((ticks.stamp_s - 100) / PERIOD_S)
        near = truth[max(0, at - 1) : at + 2]  # a digit of a time may be wrong
        for count, seen in ((ticks.left, near[:, 0]), (ticks.right, near[:, 1])):
            assert seen.min() - 40 <= count <= seen.max() + 40
    assert host.tracker.restarts == 0
    assert host.tracker.refused > 20
    assert len(host.ticks) > 0.8 * len(truth)
    assert max(abs(host.last[0] - truth[-1, 0]), abs(host.last[1] - truth[-1, 1])) <= 180


@pytest.mark.parametrize("unit_s", [None, 1e-3])
@pytest.mark.parametrize("bits", [16, 32])
@pytest.mark.parametrize("is_signed", [True, False])
@pytest.mark.parametrize("direction", [1, -1])
def test_counters_roll_over(unit_s: float | None, bits: int, is_signed: bool, direction: int) -> None:
    start = ((1 << bits) >> is_signed) - 1000 if direction > 0 else 1000 - (1 << (bits - 1)) * is_signed

    def positions(time_s: float) -> tuple[int, int]:
        def rolled(count: int) -> int:
            count %= 1 << bits
            return count - (1 << bits) if is_signed and count >> (bits - 1) else count

        return rolled(start + direction * int(1500 * time_s)), rolled(start + direction * int(900 * time_s))

    host = Host()
    host.listen(printed(200, unit_s=unit_s, positions=positions))
    moved = host.ticks[-1].left - host.ticks[0].left, host.ticks[-1].right - host.ticks[0].right
    # From the second line on; the first may be torn.
    assert moved == (
        direction * (int(1500 * 199 * PERIOD_S) - int(1500 * PERIOD_S)),
        direction * (int(900 * 199 * PERIOD_S) - int(900 * PERIOD_S)),
    )
    assert (host.tracker.restarts, host.tracker.refused) == (0, 0)


@pytest.mark.parametrize("unit_s", [1e-3, 1e-6])
def test_the_clock_rolls_over(unit_s: float) -> None:
    host = Host()
    host.listen(printed(200, unit_s=unit_s, start_s=(1 << 32) * unit_s - 1.99))
    assert host.last == driving(199 * PERIOD_S)
    assert (host.tracker.restarts, host.tracker.refused) == (0, 0)
    assert host.ticks[-1].stamp_s - host.ticks[0].stamp_s == pytest.approx(198 * PERIOD_S, abs=2e-3)


@pytest.mark.parametrize("unit_s", [None, 1e-3])
@pytest.mark.parametrize("is_moving", [True, False])
def test_a_restart_is_reported_and_is_no_motion(unit_s: float | None, is_moving: bool) -> None:
    host = Host()
    host.listen(printed(200, unit_s=unit_s), 100.0)
    far = host.last

    def after(time_s: float) -> tuple[int, int]:
        return (int(300 * time_s), int(-200 * time_s)) if is_moving else (0, 0)

    host.listen(
        [b"wheels 1.0\n", *printed(100, unit_s=unit_s, start_s=0.0, positions=after)], 100.0 + 200 * PERIOD_S + 1
    )
    assert host.tracker.restarts == 1
    moved = after(99 * PERIOD_S)
    assert host.last == (far[0] + moved[0], far[1] + moved[1])


@pytest.mark.parametrize("has_time", [True, False])
@pytest.mark.parametrize("begins_again", [True, False])
def test_a_board_that_was_unplugged(has_time: bool, begins_again: bool) -> None:
    """Most boards begin again when their port is opened; one that is fed by the robot may count on."""

    def line(n: int, left: int, begun_s: float) -> bytes:
        time = f"{int(1e3 * (PERIOD_S * n + begun_s))}," if has_time else ""
        return f"{time}{left},{-left}\n".encode()

    host = Host()
    host.listen([line(n, 50 * n, 3.0) for n in range(100)])
    assert host.last == (4950, -4950)
    host.decoder.restart()
    host.tracker.replugged()
    away_s = 5.0
    begun_s, left = (1.0, 300) if begins_again else (3.0 + 100 * PERIOD_S + away_s, 5500)
    host.listen([line(n, left + 2 * n, begun_s) for n in range(100)], 100.0 + 100 * PERIOD_S + away_s)
    assert host.tracker.restarts == begins_again
    expected = 4950 + 300 + 198 if begins_again else 5500 + 198
    assert host.last == (expected, -expected)


@pytest.mark.parametrize("has_time", [True, False])
def test_two_lines_a_second_are_enough(has_time: bool) -> None:
    host = Host()
    for n in range(40):
        left = 10 * max(0, n - 10) ** 2  # it sets off after five seconds, and gains speed
        line = f"{500 * n + 3000},{left},{left}\n" if has_time else f"{left},{left}\n"
        host.hear(line.encode(), 100 + 0.5 * n)
    assert host.format is Format.PLAIN
    assert len(host.ticks) > 30
    assert host.last == (10 * 29**2, 10 * 29**2)
    assert host.tracker.restarts == 0


def test_stamps_are_the_printed_times_beneath_the_delays(rng: np.random.Generator) -> None:
    host = Host()
    lines = printed(3000, unit_s=1e-6, start_s=2.0)
    arrival_s = 0.0
    for n, line in enumerate(lines):
        arrival_s = max(arrival_s, 100 + 1.0002 * PERIOD_S * n + rng.exponential(0.004))
        host.hear(line, arrival_s)
    sent_s = 100 + 1.0002 * PERIOD_S * np.arange(1, 3000)
    stamps_s = np.array([ticks.stamp_s for ticks in host.ticks])
    assert len(stamps_s) == len(sent_s)
    assert np.abs(stamps_s - sent_s)[1000:].max() < 1e-3
    assert host.tracker.drift_ppm == pytest.approx(-200, abs=30)


def test_lines_without_time_that_were_read_together_are_stamped_once() -> None:
    host, lines = Host(), printed(200)
    host.listen(lines[:100])
    known = len(host.ticks)
    host.hear(b"".join(lines[100:150]), 100 + 149 * PERIOD_S)
    assert len(host.ticks) - known <= 1
    host.listen(lines[150:], 100 + 150 * PERIOD_S)
    assert host.last == driving(199 * PERIOD_S)
    stamps_s = [ticks.stamp_s for ticks in host.ticks]
    assert np.all(np.diff(stamps_s) > 0.5 * PERIOD_S)


def test_frames_after_lines_are_frames_and_no_motion() -> None:
    host = Host()
    host.listen(printed(100))
    far = host.last
    frames = [encode_message(Counts(n, 20_000 * (n + 1), 7 + n, -n)) for n in range(50)]
    host.listen([b"\0", *frames], 103.0)
    assert host.format is Format.FRAMED
    assert host.last == (far[0] + 49, far[1] - 49)


def test_lines_after_frames_are_recognised() -> None:
    """Another program was written to the board while the adapter stayed plugged in."""
    host = Host()
    host.listen([encode_message(Counts(n, 20_000 * (n + 1), 5, 5)) for n in range(100)])
    host.listen([b"\0", *printed(100)], 103.0)
    assert host.format is Format.PLAIN
    begun = driving(0)
    assert host.last[0] - 5 == pytest.approx(driving(99 * PERIOD_S)[0] - begun[0], abs=31)


def test_lines_that_come_no_more_are_given_up() -> None:
    host = Host()
    host.listen(printed(100))
    host.listen([b"error 7\n"] * 400, 103.0)
    assert host.format is None
    assert host.decoder.is_text
    host.listen(printed(100), 120.0)
    assert host.format is Format.PLAIN


def test_lines_are_no_pairs_of_the_papers_format() -> None:
    decoder, reported = LineDecoder(), list[Decoded]()
    for n in range(100):
        reported += decoder.feed(bytes([5, 6]), PERIOD_S * n)
    assert decoder.format is Format.PAPER
    known = len(reported)
    for n in range(20):
        reported += decoder.feed(b"10,11\n", 2.0 + PERIOD_S * n)
    assert len(reported) - known <= 1  # the last pair of before
    assert is_plain_line(b"10,11\n3,4\r\n")
    assert not is_plain_line(b"\x05\x06")


def test_version_and_paper_still_pass() -> None:
    host = Host()
    host.listen(printed(100))
    assert host.decoder.feed(b"\0" + encode_message(Version(0, 1, 1, 0, 0)), 103.0) == [Version(0, 1, 1, 0, 0)]


def test_slow_bytes_are_no_pairs() -> None:
    """At 1200 baud there is a silence between bytes, as there is between pairs."""
    decoder = LineDecoder()
    for n, byte in enumerate(b"".join(printed(40))):
        decoder.feed(bytes([byte]), 0.0083 * n)
    assert decoder.format is Format.PLAIN
