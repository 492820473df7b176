"""From raw counters and a raw clock to ticks that never jump: across roll-over, lost frames, replugs and restarts."""

from __future__ import annotations

from dataclasses import dataclass

from wheelsight.devices.clock import ClockMap
from wheelsight.devices.pair_clock import PairClock
from wheelsight.devices.paper import FULL_PULSES, Pulses
from wheelsight.devices.plain_continuity import FASTEST_COUNTS_PER_S, PlainStep, PlainTracker
from wheelsight.devices.plain_text import PlainReading
from wheelsight.devices.protocol import Counts
from wheelsight.events import WheelTicks

_FEWEST_PULSES = 10
_EARLIEST_S = 0.1
_LATEST_AFTER_REPLUG_S = 1.0
_DRIFT = 0.01
_WORD = 1 << 32


@dataclass(frozen=True, slots=True)
class _Reading:
    """A frame of counts, its clock unwrapped in microseconds, and when it arrived."""

    counts: Counts
    clock_us: int
    arrival_s: float

    @property
    def clock_s(self) -> float:
        return 1e-6 * self.clock_us


class TickTracker:
    """Unwraps counts and stamps them in host time.

    A frame that does not follow from the one before it, because its clock runs backwards, it arrives before it was
    sent, or a wheel turns impossibly fast, is held back until the next frame tells: if that follows from the frame
    held back, the controller has begun anew (`restarts`), else the frame was damaged (`refused`). When a controller
    restarts, its counters begin at zero: what they show then is added, and nothing else.

    Attributes:
        clock: the controller's clock against the host's, as frames tell it.
        restarts: how often the controller, or its counters, began anew.
        refused: frames taken for damaged although their checksum was right, and lines of text that have none.
    """

    def __init__(self) -> None:
        self.clock = ClockMap()
        self._pairs = PairClock()
        self._plain = PlainTracker()
        self.restarts = self.refused = 0
        self._left = self._right = 0
        self._has_begun = self._is_plain = False
        self._last: _Reading | None = None
        self._held: _Reading | None = None
        self._was_replugged = self._reset_is_due = False
        self._stamp_s = -float("inf")

    @property
    def drift_ppm(self) -> float:
        """How much faster than the host's the controller's clock runs; 0 where its lines have no time."""
        return (self._plain.clock if self._is_plain else self.clock).drift_ppm

    def follow(self, counts: Counts, arrival_s: float) -> list[WheelTicks]:
        """The ticks that a frame, arrived at `arrival_s` seconds, makes certain: none, one, or two after a restart."""
        last, held = self._last, self._held
        self._pairs.restart()  # pairs between which there are frames were not counted
        self._plain.forget()
        self._is_plain = False
        if last is None:
            return [self._begin(_Reading(counts, counts.clock_us, arrival_s))]
        last = self._last = self._as_if_reset(last, counts)
        reading = self._unwrap(last, counts, arrival_s)
        if self._follows(last, reading):
            self.refused += held is not None
            return [self._accept(reading, _steps(last.counts, counts))]
        self._held = _Reading(counts, counts.clock_us, arrival_s)
        if held is None:
            return []
        after = self._unwrap(held, counts, arrival_s)
        if not _is_possible(held, after):
            self.refused += 1
            return []
        began = self._begin_anew(last, held)
        return [began, self._accept(after, _steps(held.counts, counts))]

    def add(self, pulses: Pulses) -> WheelTicks:
        """The ticks after a pair of the paper's format, stamped by the number of pairs: the format has no clock."""
        self._has_begun = True
        self._plain.forget()
        if self._last is not None:  # the controller's counters, should they come again, hold these pulses too
            self._last = _advanced(self._last, pulses)
        self._left += pulses.left
        self._right += pulses.right
        is_early = max(abs(pulses.left), abs(pulses.right)) >= FULL_PULSES
        sent_s = self._pairs.stamp_s(pulses.arrival_s, pulses.following, is_early)
        self._stamp_s = max(sent_s, self._stamp_s + 1e-6)
        return WheelTicks(self._stamp_s, self._left, self._right)

    def read(self, reading: PlainReading) -> list[WheelTicks]:
        """The ticks that a line of plain text makes certain: none, one, or two."""
        plain = self._plain
        if self._last is not None:  # what comes in frames later is of another program
            self._last = self._held = None
            self.clock.restart()
        self._pairs.restart()
        self._is_plain = True
        restarts, refused = plain.restarts, plain.refused
        steps = plain.follow(reading)
        self.restarts += plain.restarts - restarts
        self.refused += plain.refused - refused
        if steps and not self._has_begun:
            self._has_begun, self._left, self._right = True, reading.left, reading.right
        return [self._moved(step) for step in steps]

    def expect_reset(self, is_due: bool) -> None:
        """Whether the controller was told to set its counters to zero, which is no motion."""
        self._reset_is_due = is_due

    def reset_done(self) -> None:
        """The controller says that its counters are zero now, if no frame has told it before."""
        if self._reset_is_due and self._last is not None:
            self._last = _from_zero(self._last)
        self._reset_is_due = False

    def replugged(self) -> None:
        """The port was opened anew: what comes is fresh, so a clock that lags shows a restart."""
        self._was_replugged = True
        self._plain.replugged()
        self._pairs.restart()

    def _moved(self, step: PlainStep) -> WheelTicks:
        self._left += step.left
        self._right += step.right
        self._stamp_s = max(step.stamp_s, self._stamp_s + 1e-6)
        return WheelTicks(self._stamp_s, self._left, self._right)

    def _as_if_reset(self, last: _Reading, counts: Counts) -> _Reading:
        """`last`, with zero counts if a reset is due and `counts` are nearer to zero than to what they were."""
        if self._reset_is_due and abs(counts.left) + abs(counts.right) < sum(map(abs, _steps(last.counts, counts))):
            self._reset_is_due = False
            return _from_zero(last)
        return last

    def _unwrap(self, last: _Reading, counts: Counts, arrival_s: float) -> _Reading:
        """The reading with as many roll-overs of its clock since `last` as host time says."""
        step_us = (counts.clock_us - last.counts.clock_us) % _WORD
        passed_us = 1e6 * (arrival_s - last.arrival_s)
        step_us += _WORD * max(0, round((passed_us - step_us) / _WORD))
        return _Reading(counts, last.clock_us + step_us, arrival_s)

    def _follows(self, last: _Reading, reading: _Reading) -> bool:
        """Whether one controller, running on, may have sent both."""
        passed_s = reading.arrival_s - last.arrival_s
        delay_s = reading.arrival_s - self.clock.host_s(reading.clock_s)
        slack_s = _DRIFT * passed_s
        if self._was_replugged and delay_s > _LATEST_AFTER_REPLUG_S + slack_s:
            return False
        return delay_s >= -_EARLIEST_S - slack_s and _is_possible(last, reading)

    def _accept(self, reading: _Reading, steps: tuple[int, int]) -> WheelTicks:
        self._last, self._held, self._was_replugged = reading, None, False
        self._left += steps[0]
        self._right += steps[1]
        self.clock.update(reading.clock_s, reading.arrival_s)
        self._stamp_s = max(self.clock.stamp_s(reading.clock_s), self._stamp_s + 1e-6)
        return WheelTicks(self._stamp_s, self._left, self._right)

    def _begin(self, first: _Reading) -> WheelTicks:
        """The first ticks of all are what the controller says; after the paper's format they change nothing."""
        if not self._has_begun:
            self._has_begun, self._left, self._right = True, first.counts.left, first.counts.right
        return self._accept(first, (0, 0))

    def _begin_anew(self, last: _Reading, first: _Reading) -> WheelTicks:
        """The ticks of a confirmed first frame of a controller that restarted, or whose clock or counters jumped."""
        self.restarts += 1
        self.clock.restart()
        return self._accept(first, _pulses_since(last, first))


def _pulses_since(last: _Reading, first: _Reading) -> tuple[int, int]:
    """Pulses that surely are motion although `first` does not follow from `last`: counted from zero after a boot."""
    passed_s = first.arrival_s - last.arrival_s
    if first.clock_s <= passed_s + _LATEST_AFTER_REPLUG_S:
        pulses, seconds = (first.counts.left, first.counts.right), first.clock_s
    else:
        pulses, seconds = _steps(last.counts, first.counts), passed_s
    return pulses if _can_count(pulses, seconds) else (0, 0)


def _is_possible(last: _Reading, reading: _Reading) -> bool:
    step_s = reading.clock_s - last.clock_s
    return step_s > 0 and _can_count(_steps(last.counts, reading.counts), step_s)


def _can_count(pulses: tuple[int, int], seconds: float) -> bool:
    return max(map(abs, pulses)) <= _FEWEST_PULSES + FASTEST_COUNTS_PER_S * seconds


def _steps(last: Counts, counts: Counts) -> tuple[int, int]:
    """Pulses from one frame to the next, the shorter way around the 32-bit counters."""
    return _signed(counts.left - last.left), _signed(counts.right - last.right)


def _signed(difference: int) -> int:
    return (difference + _WORD // 2) % _WORD - _WORD // 2


def _advanced(reading: _Reading, pulses: Pulses) -> _Reading:
    """The same moment, had the counters been as far as after `pulses`."""
    counts = reading.counts
    counts = counts._replace(left=counts.left + pulses.left, right=counts.right + pulses.right)
    return _Reading(counts, reading.clock_us, reading.arrival_s)


def _from_zero(reading: _Reading) -> _Reading:
    """The same moment, had the counters been zero."""
    return _Reading(reading.counts._replace(left=0, right=0), reading.clock_us, reading.arrival_s)
