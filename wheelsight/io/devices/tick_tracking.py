"""`TickTracker` turns raw counters and a raw clock into continuous ticks, across roll-over, lost frames,
reconnection and restarts of the controller.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from wheelsight.core.messages import WheelTicks
from wheelsight.io.devices.host_clock import ClockMap, slope_beneath
from wheelsight.io.devices.wire_formats import FULL_PULSES, Counts, PlainReading, PlainTextSettings, Pulses

# From raw counters and a raw clock to ticks that never jump: across roll-over, lost frames, replugs and restarts.


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


# From counts printed as text to motion that never jumps: there is no checksum, so neighbours judge each reading.


_SIGNED, _UNSIGNED = (-(1 << 15), (1 << 15) - 1), (0, (1 << 16) - 1)
_PLAIN_CONTINUITY_EARLIEST_S = 0.03
_LONGEST_DELAY_S = 1.0
_EARLY_WINDOW_S, _EARLY_LINES = 1.0, 3  # found on damaged lines alone
_PLAIN_CONTINUITY_DRIFT = 0.02
FASTEST_COUNTS_PER_S = 500_000  # an encoder of 5000 lines at 20 turns a second makes 400 000

Pair = tuple[int, int]


class PlainStep(NamedTuple):
    """Counts of both wheels since the step before, and the host time at which they were taken."""

    stamp_s: float
    left: int
    right: int


@dataclass(frozen=True, slots=True)
class _PlainContinuityReading:
    """A reading, its clock unwrapped in microseconds, or None where the line has no time."""

    counts: Pair
    shown_us: int | None
    clock_us: int | None
    arrival_s: float

    def since(self, before: _PlainContinuityReading) -> float:
        """Seconds since another, by the controller's clock where there is one."""
        if self.clock_us is None or before.clock_us is None:
            return self.arrival_s - before.arrival_s
        return 1e-6 * (self.clock_us - before.clock_us)

    def booted_since(self, before: _PlainContinuityReading) -> bool:
        """Whether the clock shows so little that it may have begun at zero after another reading."""
        passed_s = self.arrival_s - before.arrival_s
        return self.shown_us is not None and 1e-6 * self.shown_us <= passed_s + _LONGEST_DELAY_S


class PlainTracker:
    """Tells motion from damage, roll-over and restarts.

    A reading is believed at once where both wheels moved on about as they did before. Else it waits. Where it is about
    what wheels can gain in speed, the next one tells: moving on from the one that waits confirms it. Where it is not,
    more that follow from each other must, and are motion, or a restart (`restarts`) if counters came back near zero or
    the clock began anew. What is disproved is `refused`; counts are cumulative, so that loses no motion.

    Attributes:
        clock: the controller's clock against the host's.
        restarts, refused: as `TickTracker` counts them.
    """

    def __init__(self, settings: PlainTextSettings | None = None) -> None:
        self.clock = ClockMap(_PLAIN_CONTINUITY_DRIFT)
        self.restarts = self.refused = 0
        self._settings = settings or PlainTextSettings()
        self._last: _PlainContinuityReading | None = None
        self._waiting: list[_PlainContinuityReading] = []  # each follows from the one before
        self._speeds = (0.0, 0.0)
        self._range: list[Pair] = [(0, 0), (0, 0)]  # the smallest and largest count of each wheel
        self._was_replugged = False
        self._early: deque[tuple[float, float]] = deque(
            maxlen=1024
        )  # arrivals, and by how much before the map they came
        self._has_map = False
        self._stamp_s = -float("inf")

    def follow(self, told: PlainReading) -> list[PlainStep]:
        """The motion that a reading makes certain: none or more steps. The first of all is a step of zero."""
        if told.clock is None and told.following:
            return []  # nobody knows when it came: of lines in one read, the last is the one that did not wait
        if self._last is None:
            return [self._begin(_first(told))]
        now = _after(self._last, told)
        if self._is_expected(self._last, now):
            self.refused += len(self._waiting)
            return [self._accept(now)]
        if not self._waiting:
            self._waiting = [now]
            return []
        return self._decide(self._last, _after(self._waiting[-1], told))

    def replugged(self) -> None:
        """The port was opened anew, which makes most boards begin anew."""
        self._was_replugged = True
        self._waiting.clear()

    def forget(self) -> None:
        """Other formats came between: what was counted meanwhile is in them."""
        if self._last is not None:
            self.clock.restart()
            self._has_map = False
            self._early.clear()
        self._last = None
        self._waiting.clear()

    def _decide(self, last: _PlainContinuityReading, now: _PlainContinuityReading) -> list[PlainStep]:
        """What becomes of the readings that wait, now that there is another."""
        held = self._waiting[-1]
        follows = self._follows(last, held, now)
        if len(self._waiting) == 1 and self._is_gain(last, held) and (follows or self._is_between(last, held, now)):
            self._waiting = [] if follows else [now]
            return [self._accept(held, keeps=True), *([self._accept(now)] if follows else [])]
        if not follows:
            self.refused += len(self._waiting)
            self._waiting.clear()
        self._waiting.append(now)
        return self._confirm(last) if len(self._waiting) >= self._settings.confirming_lines else []

    def _confirm(self, last: _PlainContinuityReading) -> list[PlainStep]:
        """Take the readings that wait: as motion where that may be, else as of a board that began anew."""
        waiting, later = self._waiting, [reading for reading in self._waiting if self._is_later(last, reading)]
        if later and self._can_count(last, later[0]) and not self._is_reset(last, waiting[0]):
            self.refused += len(waiting) - len(later)
            return [self._accept(reading) for reading in later]
        return [self._begin_anew(last, waiting[0]), *(self._accept(reading) for reading in waiting[1:])]

    def _is_later(self, last: _PlainContinuityReading, now: _PlainContinuityReading) -> bool:
        """Whether its time is after another's, and not far ahead of the host's: a digit of it may have been lost."""
        passed_s = now.arrival_s - last.arrival_s
        return 0 < now.since(last) <= (1 + _PLAIN_CONTINUITY_DRIFT) * passed_s + _LONGEST_DELAY_S

    def _is_expected(self, last: _PlainContinuityReading, now: _PlainContinuityReading) -> bool:
        """Whether it may be believed at once."""
        if self._was_replugged or not self._is_in_time(last, now):
            return False
        return self._agrees(self._step(last, now), self._due(now.since(last)))

    def _is_gain(self, last: _PlainContinuityReading, held: _PlainContinuityReading) -> bool:
        """Whether both wheels may have gained so much speed, or lost it."""
        passed_s = held.since(last)
        if self._was_replugged or not self._is_in_time(last, held) or passed_s > self._settings.longest_gap_s:
            return False
        return self._may_gain(self._step(last, held), self._due(passed_s), passed_s)

    def _may_gain(self, steps: Pair, due: tuple[float, float], passed_s: float) -> bool:
        settings = self._settings
        gain = settings.gain_counts + settings.gain_counts_per_s2 * passed_s**2
        return all(abs(a - b) <= gain + settings.gain_share * abs(b) for a, b in zip(steps, due, strict=True))

    def _follows(
        self, last: _PlainContinuityReading, held: _PlainContinuityReading, now: _PlainContinuityReading
    ) -> bool:
        """Whether both wheels moved on from the held reading as they had moved to it, or before it."""
        passed_s = now.since(held)
        if (
            not 0
            < passed_s
            <= (1 + _PLAIN_CONTINUITY_DRIFT) * (now.arrival_s - held.arrival_s) + _PLAIN_CONTINUITY_EARLIEST_S
        ):
            return False
        before = self._waiting[-2] if len(self._waiting) > 1 else last
        steps, took_s = self._step(before, held), held.since(before)
        step = self._step(held, now)
        if took_s > 0 and self._agrees(step, (steps[0] * passed_s / took_s, steps[1] * passed_s / took_s)):
            return True
        return len(self._waiting) == 1 and (self._agrees(step, self._due(passed_s)) or self._agrees(step, (0, 0)))

    def _is_between(
        self, last: _PlainContinuityReading, held: _PlainContinuityReading, now: _PlainContinuityReading
    ) -> bool:
        """Whether both wheels went on in one direction, as wheels that gain speed or brake do."""
        first, second, passed_s = self._step(last, held), self._step(held, now), now.since(held)
        if not 0 < passed_s <= self._settings.longest_gap_s or any(
            a * b < 0 for a, b in zip(first, second, strict=True)
        ):
            return False
        share = passed_s / held.since(last)
        return self._may_gain(second, (share * first[0], share * first[1]), passed_s)

    def _is_zero_again(self, last: _PlainContinuityReading, first: _PlainContinuityReading) -> bool:
        """Whether counters are nearer to zero than to where they were."""
        return sum(map(abs, first.counts)) < sum(map(abs, self._step(last, first)))

    def _is_reset(self, last: _PlainContinuityReading, first: _PlainContinuityReading) -> bool:
        """Whether the readings that wait are of a board that began anew, though no clock says so."""
        if not self._is_zero_again(last, first):
            return False
        if self._was_replugged:
            return first.clock_us is None or not self._is_in_time(last, first)
        steps, passed_s = self._step(first, self._waiting[-1]), first.since(last)
        share = passed_s / max(self._waiting[-1].since(first), 1e-6)  # what they have counted, if it was at this speed
        slack = self._settings.slack_counts
        return all(abs(count) <= slack + 2 * share * abs(step) for count, step in zip(first.counts, steps, strict=True))

    def _is_in_time(self, last: _PlainContinuityReading, now: _PlainContinuityReading) -> bool:
        """Whether one clock, running on, may have told both, and it arrived after it was sent."""
        if now.clock_us is None:
            return now.arrival_s > last.arrival_s
        early_s = self.clock.host_s(1e-6 * now.clock_us) - now.arrival_s
        return now.since(last) > 0 and early_s <= _PLAIN_CONTINUITY_EARLIEST_S + _PLAIN_CONTINUITY_DRIFT * (
            now.arrival_s - last.arrival_s
        )

    def _can_count(self, last: _PlainContinuityReading, now: _PlainContinuityReading) -> bool:
        most = self._settings.slack_counts + FASTEST_COUNTS_PER_S * now.since(last)
        return max(map(abs, self._step(last, now))) <= most

    def _agrees(self, steps: Pair, due: tuple[float, float]) -> bool:
        slack, share = self._settings.slack_counts, self._settings.slack_share
        return all(abs(a - b) <= slack + share * abs(b) for a, b in zip(steps, due, strict=True))

    def _due(self, passed_s: float) -> tuple[float, float]:
        """The step that both wheels make in so long, at the speed they had."""
        return self._speeds[0] * passed_s, self._speeds[1] * passed_s

    def _step(self, last: _PlainContinuityReading, now: _PlainContinuityReading) -> Pair:
        """Counts of both wheels from one reading to another, across a roll-over where that is what was expected."""
        due = self._due(max(now.since(last), 0.0))
        left, right = (_shortest(last.counts[i], now.counts[i], self._range[i], due[i]) for i in (0, 1))
        return left, right

    def _accept(self, now: _PlainContinuityReading, keeps: bool = False) -> PlainStep:
        """The step to a reading; those that wait are forgotten unless they are to be kept."""
        assert self._last is not None
        steps, passed_s = self._step(self._last, now), max(now.since(self._last), 1e-6)
        if not keeps:
            self._waiting.clear()
        self._speeds = (steps[0] / passed_s, steps[1] / passed_s)
        return self._take(now, steps)

    def _begin(self, first: _PlainContinuityReading) -> PlainStep:
        self._speeds, self._range = (0.0, 0.0), [(0, 0), (0, 0)]
        return self._take(first, (0, 0))

    def _begin_anew(self, last: _PlainContinuityReading, first: _PlainContinuityReading) -> PlainStep:
        """The step to the first reading after a restart: what was counted from zero, where that may be."""
        self._waiting.clear()
        self.restarts += 1
        self.clock.restart()
        self._has_map = False
        self._early.clear()
        passed_s = first.arrival_s - last.arrival_s
        counts = first.counts
        if first.shown_us is not None and first.booted_since(last):
            passed_s = 1e-6 * first.shown_us
        elif not self._is_zero_again(last, first):
            counts = self._step(last, first)  # the clock alone jumped
        most = self._settings.slack_counts + FASTEST_COUNTS_PER_S * passed_s
        step = self._begin(first)
        is_motion = max(map(abs, counts)) <= most
        return step._replace(left=counts[0], right=counts[1]) if is_motion else step

    def _take(self, now: _PlainContinuityReading, steps: Pair) -> PlainStep:
        self._last, self._was_replugged = now, False
        stamp_s = self._stamp_of(now)
        for i, (least, most) in enumerate(self._range):
            self._range[i] = min(least, now.counts[i]), max(most, now.counts[i])
        self._stamp_s = max(stamp_s, self._stamp_s + 1e-6)
        return PlainStep(self._stamp_s, *steps)

    def _stamp_of(self, now: _PlainContinuityReading) -> float:
        if now.clock_us is None:
            return now.arrival_s
        self.clock.update(1e-6 * now.clock_us, self._believed_arrival_s(now.clock_us, now.arrival_s))
        self._has_map = True
        return self.clock.stamp_s(1e-6 * now.clock_us)

    def _believed_arrival_s(self, clock_us: int, arrival_s: float) -> float:
        """The arrival, or later where too few lines of the last second came as early: a digit of the time may be wrong.

        The map goes by the earliest line of a minute, so that one wrong time would shift all stamps for as long.
        """
        early_s = self.clock.host_s(1e-6 * clock_us) - arrival_s
        self._early.append((arrival_s, early_s))
        while self._early[0][0] < arrival_s - _EARLY_WINDOW_S:
            self._early.popleft()
        earliest = sorted((early for _, early in self._early), reverse=True)[:_EARLY_LINES]
        allowed_s = max(earliest[-1], 0.0) if len(earliest) == _EARLY_LINES else 0.0
        return arrival_s + max(early_s - allowed_s, 0.0) if self._has_map else arrival_s


def _first(told: PlainReading) -> _PlainContinuityReading:
    shown_us = None if told.clock is None else told.clock * told.us_per_tick
    return _PlainContinuityReading((told.left, told.right), shown_us, shown_us, told.arrival_s)


def _after(last: _PlainContinuityReading, told: PlainReading) -> _PlainContinuityReading:
    """The reading, its clock rolled over since `last` where host time is nearer to that."""
    now = _first(told)
    if now.shown_us is None or last.shown_us is None or last.clock_us is None:
        return now
    passed_us = 1e6 * (now.arrival_s - last.arrival_s)
    step_us = now.shown_us - last.shown_us
    rolled_us = step_us + _WORD * told.us_per_tick
    if abs(rolled_us - passed_us) < abs(step_us - passed_us):
        step_us = rolled_us
    return _PlainContinuityReading(now.counts, now.shown_us, last.clock_us + step_us, now.arrival_s)


def _shortest(before: int, now: int, range_seen: Pair, expected: float) -> int:
    """The step from one count to the next that is nearest to what was expected, of those that a roll-over can make."""
    step, rolls = now - before, [_WORD]
    seen = (min(*range_seen, before, now), max(*range_seen, before, now))
    if any(least <= seen[0] and seen[1] <= most for least, most in (_SIGNED, _UNSIGNED)):
        rolls.append(1 << 16)
    steps = [step, *(step + roll for roll in rolls), *(step - roll for roll in rolls)]
    return min(steps, key=lambda candidate: abs(candidate - expected))


# When pairs of the paper's format were sent: they come at a fixed period, so that their number is a clock.
#
# Arrivals over the number of a pair lie on or above a line, as those of frames do over the controller's clock: its
# slope is the period, and the line beneath them tells the stamps (`ClockMap`). What breaks the count is found by the
# line, too: after a lost pair all arrivals stay a period above it. A pair sent early, since a count was full, tells
# no time.


# Long enough that a jitter of milliseconds leaves a period's slope right to a part in a thousand.
_LEARN_S = 4.0
# Crystals differ by far less; the line over four seconds may be off by some parts in a thousand.
_LARGEST_DRIFT = 0.02
# A transport holds pairs back for shorter; beyond, the controller was silent.
_PAIR_CLOCK_LONGEST_DELAY_S = 0.5
# Arrivals that stay late for so long are those of pairs whose number is wrong.
_STAYS_S = 1.0
_TICK_S = 1e-6
_LONGEST_PERIOD_S, _SHORTEST_PERIOD_S = 0.2, 0.003


class PairClock:
    """Stamps of pairs in host time, from their number and arrivals.

    Stamps grow strictly, and lie behind arrivals only where those run backwards. Until the period is known, and
    while pairs are sent early, a pair is stamped with its arrival.

    Attributes:
        period_s: as learned, or None.
        lost: pairs found to be missing.
    """

    def __init__(self) -> None:
        self.period_s: float | None = None
        self.lost = 0
        self._map = ClockMap(_LARGEST_DRIFT)
        self._number, self._begun = 0, False
        self._arrivals: list[tuple[float, float]] = []
        self._late: deque[tuple[float, float]] = deque()
        self._stamp_s = -float("inf")

    def stamp_s(self, arrival_s: float, following: int, is_early: bool) -> float:
        """The stamp of the next pair.

        Args:
            arrival_s: when it was read.
            following: how many pairs came behind it in the same read; each was sent a period later.
            is_early: whether a count was full, so that it may have been sent before its time.
        """
        if is_early:
            self.restart()
            return self._growing(arrival_s, arrival_s)
        self._number += 1
        if self.period_s is None:
            self._learn(arrival_s, following)
            return self._growing(arrival_s, arrival_s)
        latest_s = arrival_s - following * self.period_s
        self._count_lost(arrival_s, following)
        clock_s = self._number * self.period_s
        self._map.update(clock_s, latest_s)
        self._begun = True
        return self._growing(self._map.host_s(clock_s), arrival_s)

    def restart(self) -> None:
        """The count of pairs broke off: the port vanished, or pairs were sent early. The period stays."""
        self._map.restart()
        self._arrivals.clear()
        self._late.clear()
        self._begun = False

    def _learn(self, arrival_s: float, following: int) -> None:
        """The period, once pairs have come for long enough."""
        if not following:  # of pairs in one read, the last is the one that waited least
            self._arrivals.append((float(self._number), arrival_s))
        if len(self._arrivals) < 3 or self._arrivals[-1][1] - self._arrivals[0][1] < _LEARN_S:
            return
        period_s = slope_beneath(self._arrivals)
        if _SHORTEST_PERIOD_S <= period_s <= _LONGEST_PERIOD_S:
            self.period_s = period_s
            for number, arrived_s in self._arrivals:
                self._map.update(number * period_s, arrived_s)
            self._begun = True
        self._arrivals.clear()

    def _stays_s(self, late_s: float, arrival_s: float, following: int) -> float:
        """How late pairs have been at least for a second by now; 0 where that is not known."""
        assert self.period_s is not None
        if following:  # what comes in one read is late together, and once
            return 0.0
        self._late.append((arrival_s, late_s))
        while arrival_s - self._late[0][0] > _STAYS_S:
            self._late.popleft()
        is_known = arrival_s - self._late[0][0] > _STAYS_S - 3 * self.period_s
        return min(late for _, late in self._late) if is_known else 0.0

    def _count_lost(self, arrival_s: float, following: int) -> None:
        """Put the number right after pairs were lost, or not sent."""
        assert self.period_s is not None
        if not self._begun:
            return
        latest_s = arrival_s - following * self.period_s
        late_s = latest_s - self._map.host_s(self._number * self.period_s)
        missing_s = late_s if late_s > _PAIR_CLOCK_LONGEST_DELAY_S else self._stays_s(late_s, arrival_s, following)
        missing = round(missing_s / self.period_s)
        if missing > 0:
            self._number += missing
            self.lost += missing
            self._late.clear()

    def _growing(self, stamp_s: float, arrival_s: float) -> float:
        self._stamp_s = max(min(stamp_s, arrival_s), self._stamp_s + _TICK_S)
        return self._stamp_s
