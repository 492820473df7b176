"""The sketch that prints plain lines, on a simulated Arduino Uno: alone, and read as the link reads it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from firmware.simulation.simulated_chip import FIRMWARE, Chip
from wheelsight.core.messages import WheelTicks
from wheelsight.io.devices.tick_tracking import TickTracker
from wheelsight.io.devices.wire_formats import Format, LineDecoder, PlainReading

UNO_HZ = 16_000_000
BYTE_S = 10 / 115_200
COUNTS_A_PULSE = 2  # both edges of channel A
SKETCH = FIRMWARE / "arduino" / "plain_counts" / "plain_counts.ino"


@pytest.fixture
def uno(built_sketch: Path) -> Iterator[Chip]:
    with Chip(built_sketch / "chip", built_sketch / "plain_counts.elf") as chip:
        yield chip


def readings(uno: Chip) -> np.ndarray:
    """Microseconds and both counts of each line; all but the header must be such a line."""
    printed = bytes(byte for _, byte in uno.sent()).decode("ascii")
    lines = [line for line in printed.split("\r\n")[:-1] if line != "time_us,left,right"]
    return np.array([[int(field) for field in line.split(",")] for line in lines])


def test_the_sketch_is_short() -> None:
    assert len(SKETCH.read_text().splitlines()) <= 30


def test_the_size_leaves_room(built_sketch: Path) -> None:
    found = re.search(r"Program:\s+(\d+) bytes", (built_sketch / "size.txt").read_text())
    assert found is not None
    assert 1000 < int(found[1]) < 16384


@pytest.mark.parametrize(("wheel", "column"), [("left", 1), ("right", 2)])
def test_counts_grow_forward_and_shrink_backward(uno: Chip, wheel: str, column: int) -> None:
    uno.run(0.1)
    for quarters, expected in ((400, 200), (-800, -200), (6, -197)):
        uno.turn(wheel, quarters, 1000)
        uno.rest()
        assert readings(uno)[-1, column] == expected


def test_no_count_is_lost_at_6000_pulses_a_second(uno: Chip) -> None:
    """Of both wheels at once, as docs/firmware.md says; at 8000 the sketch loses some."""
    uno.run(0.1)
    uno.turn("left", 4 * 9000, 6000)
    uno.turn("right", -4 * 9000, 6004.7)
    uno.rest()
    assert readings(uno)[-1, 1:].tolist() == [COUNTS_A_PULSE * 9000, -COUNTS_A_PULSE * 9000]


def test_a_line_comes_every_20_ms_with_its_time(uno: Chip) -> None:
    uno.turn("left", 4 * 4000, 2000)
    uno.run(1.9)
    reported = readings(uno)
    assert len(reported) == pytest.approx(94, abs=2)
    assert np.abs(np.diff(reported[:, 0]) - 20_000).max() < 100
    steps = np.diff(reported[5:, 1])
    assert np.abs(steps - COUNTS_A_PULSE * 2000 * np.diff(reported[5:, 0]) * 1e-6).max() <= 2


class Host:
    """What a link makes of the Uno's bytes, at the times at which they came: its own, since a simulated Uno may lag."""

    def __init__(self) -> None:
        self.decoder, self.tracker = LineDecoder(), TickTracker()
        self.ticks: list[WheelTicks] = []

    def hear(self, uno: Chip) -> None:
        for cycle, byte in uno.sent():
            for reported in self.decoder.feed(bytes([byte]), cycle / UNO_HZ + BYTE_S):
                assert isinstance(reported, PlainReading)
                self.ticks += self.tracker.add_line(reported)


def test_the_link_reads_what_the_sketch_prints(uno: Chip) -> None:
    host = Host()
    uno.run(1.0)
    uno.turn("left", 4 * 9000, 6000)
    uno.turn("right", -4 * 6000, 4000)
    uno.rest()
    host.hear(uno)
    assert host.decoder.format is Format.PLAIN
    assert (host.ticks[-1].left, host.ticks[-1].right) == (COUNTS_A_PULSE * 9000, -COUNTS_A_PULSE * 6000)
    uno.ask("reset")  # as opening the port of a real one does
    uno.run(1.0)
    uno.turn("left", 400, 1000)
    uno.rest()
    host.hear(uno)
    assert (host.ticks[-1].left, host.ticks[-1].right) == (COUNTS_A_PULSE * 9100, -COUNTS_A_PULSE * 6000)
    assert (host.tracker.restarts, host.tracker.refused, host.decoder.statistics.malformed) == (
        1,
        0,
        1,
    )  # the second header; the first may be torn
    assert all(before.stamp_s < after.stamp_s for before, after in pairwise(host.ticks))
