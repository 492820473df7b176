"""Ticks against the truth of a controller whose counters and clock roll over, restart, reset, and get damaged."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.messages import WheelTicks
from wheelsight.io.devices.tick_tracking import TickTracker
from wheelsight.io.devices.wire_formats import Counts, Pulses

PERIOD_US = 20_000
WORD = 1 << 32


def signed(count: int) -> int:
    return (count + WORD // 2) % WORD - WORD // 2


@dataclass
class Controller:
    """Counts that are sent to a tracker, and the ticks that come of them."""

    clock_us: int = 1_000_000
    left: int = 0
    right: int = 0
    now_s: float = 1e9
    tracker: TickTracker = field(default_factory=TickTracker)
    ticks: list[WheelTicks] = field(default_factory=list)

    def run(self, periods: int, left: int = 100, right: int = -50, heard: bool = True) -> None:
        for _ in range(periods):
            self.clock_us += PERIOD_US
            self.now_s += 1e-6 * PERIOD_US
            self.left += left
            self.right += right
            if heard:
                self.send(self.left, self.right, self.clock_us)

    def send(self, left: int, right: int, clock_us: int) -> None:
        counts = Counts(0, clock_us % WORD, signed(left), signed(right))
        self.ticks += self.tracker.add_counts(counts, self.now_s)

    def boot(self) -> None:
        self.clock_us = self.left = self.right = 0

    @property
    def way(self) -> tuple[int, int]:
        """Ticks from the first reading to the last."""
        return self.ticks[-1].left - self.ticks[0].left, self.ticks[-1].right - self.ticks[0].right

    def check_order(self) -> None:
        assert all(before.stamp_s < after.stamp_s for before, after in pairwise(self.ticks))


def test_ticks_begin_with_what_the_controller_says() -> None:
    controller = Controller(left=1000, right=-7)
    controller.run(1)
    assert (controller.ticks[0].left, controller.ticks[0].right) == (1100, -57)


@given(st.integers(0, WORD - 1), st.integers(0, WORD - 1), st.integers(-150, 150), st.integers(-150, 150))
def test_clock_and_counters_roll_over_anywhere(clock_us: int, count: int, left: int, right: int) -> None:
    controller = Controller(clock_us, signed(count), signed(count))
    controller.run(20, left, right)
    assert controller.way == (19 * left, 19 * right)
    assert controller.tracker.restarts == controller.tracker.refused == 0
    assert controller.ticks[-1].stamp_s - controller.ticks[0].stamp_s == pytest.approx(19 * 0.02, abs=1e-5)


def test_both_roll_over_in_the_middle() -> None:
    controller = Controller(WORD - 100_000, (1 << 31) - 500, -(1 << 31) + 200)
    controller.run(10)
    assert controller.way == (900, -450)
    assert controller.ticks[-1].left > 1 << 31


@pytest.mark.parametrize("minutes", [1, 70, 72, 150, 300])
def test_frames_lost_for_long_lose_no_ticks_although_the_clock_rolled_over(minutes: int) -> None:
    controller = Controller()
    controller.run(300)
    controller.run(minutes * 3000, heard=False)
    controller.run(10)
    assert controller.way == (100 * (309 + 3000 * minutes), -50 * (309 + 3000 * minutes))
    assert controller.tracker.restarts == 0
    assert controller.ticks[-1].stamp_s == pytest.approx(controller.now_s, abs=1e-3)


@pytest.mark.parametrize("uptime_periods", [3, 50, 5000])
@pytest.mark.parametrize("pause_s", [0.0, 0.065, 30.0])
def test_a_restart_adds_what_was_counted_since_and_nothing_else(uptime_periods: int, pause_s: float) -> None:
    controller = Controller(clock_us=0)
    controller.run(uptime_periods)
    controller.now_s += pause_s
    controller.boot()
    controller.tracker.replugged()
    controller.run(10)
    assert controller.way == (100 * (uptime_periods + 9), -50 * (uptime_periods + 9))
    assert controller.tracker.restarts == 1
    controller.check_order()
    assert controller.ticks[-1].stamp_s == pytest.approx(controller.now_s, abs=0.02)


def test_a_restart_without_a_replug_is_seen_too() -> None:
    controller = Controller()
    controller.run(500)
    controller.now_s += 0.065
    controller.boot()
    controller.run(10, left=-3, right=2)
    assert controller.way == (49_900 - 30, -24_950 + 20)
    assert controller.tracker.restarts == 1


def test_a_replug_without_a_restart_loses_no_ticks() -> None:
    controller = Controller()
    controller.run(500)
    controller.run(500, heard=False)
    controller.tracker.replugged()
    controller.run(5)
    assert controller.way == (100 * 1004, -50 * 1004)
    assert controller.tracker.restarts == 0


def test_counters_that_restart_elsewhere_than_at_zero_invent_no_jump() -> None:
    controller = Controller()
    controller.run(100)
    controller.boot()
    controller.left = 10_000_000
    controller.run(10)
    assert controller.way == (100 * 99 + 9 * 100, -50 * 99 - 9 * 50 - 50 + 50)


@pytest.mark.parametrize(
    ("left", "clock_us"),
    [(1 << 30, 0), (5000, 1 << 31), (5000, -3_000_000), (-(1 << 29), 40_000)],
)
def test_a_damaged_frame_with_a_right_checksum_is_refused(left: int, clock_us: int) -> None:
    controller = Controller()
    controller.run(200)
    controller.send(controller.left + left, controller.right, controller.clock_us + PERIOD_US // 2 + clock_us)
    controller.run(200)
    assert controller.way == (100 * 399, -50 * 399)
    assert (controller.tracker.refused, controller.tracker.restarts) == (1, 0)
    assert len(controller.ticks) == 400


@pytest.mark.parametrize("is_confirmed", [True, False])
@pytest.mark.parametrize("before", [200, 1_000_000])
def test_a_reset_that_was_asked_for_is_no_motion(before: int, is_confirmed: bool) -> None:
    controller = Controller(left=before, right=before)
    controller.run(5)
    controller.tracker.expect_reset(True)
    controller.left = controller.right = 0
    if is_confirmed:
        controller.tracker.reset_done()
    controller.run(5, left=30, right=-30)
    assert controller.way == (400 + 150, -200 - 150)
    assert controller.tracker.restarts == 0


def test_a_stalled_host_reads_old_frames_in_one_go() -> None:
    controller = Controller()
    controller.run(500)
    waiting = controller.now_s + 4.0
    for _ in range(200):
        controller.clock_us += PERIOD_US
        controller.left += 100
        now_s, controller.now_s = controller.now_s, waiting
        controller.send(controller.left, controller.right, controller.clock_us)
        controller.now_s = now_s
    controller.now_s = waiting
    controller.run(10)
    assert controller.way[0] == 100 * (499 + 200 + 10)
    assert controller.tracker.restarts == controller.tracker.refused == 0
    gaps_s = [after.stamp_s - before.stamp_s for before, after in pairwise(controller.ticks)]
    assert gaps_s == pytest.approx([0.02] * len(gaps_s), abs=1e-5)


def test_a_change_to_the_papers_format_and_back_loses_no_pulse() -> None:
    controller = Controller()
    controller.run(100)
    for _ in range(100):
        controller.run(1, heard=False)
        controller.ticks.append(controller.tracker.add_pulses(Pulses(controller.now_s, 100, -50, True)))
    controller.run(3, heard=False)  # of which the paper's frames did not tell
    controller.run(100)
    assert controller.way == (100 * 302, -50 * 302)
    assert controller.tracker.restarts == 0
    controller.check_order()


def test_pairs_read_in_heaps_are_stamped_by_their_number() -> None:
    """Three in a read, one read in 60 ms: before, two of three were stamped a microsecond apart."""
    tracker, ticks = TickTracker(), []
    for index in range(600):
        read_s = 1e9 + 0.06 * (index // 3) + 0.05
        ticks.append(tracker.add_pulses(Pulses(read_s, 7, 7, index % 3 == 0, 2 - index % 3)))
    steps_s = [after.stamp_s - before.stamp_s for before, after in pairwise(ticks[300:])]
    assert steps_s == pytest.approx([0.02] * len(steps_s), abs=1e-4)
    assert ticks[-1].stamp_s <= 1e9 + 0.06 * 199 + 0.05
    assert ticks[-1].left == 7 * 600
