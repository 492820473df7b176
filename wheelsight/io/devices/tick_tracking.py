"""`TickTracker` turns raw counters and a raw clock into continuous ticks, across roll-over, lost frames,
reconnection and restarts of the controller.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from wheelsight.core.messages import WheelTicks
from wheelsight.io.devices.host_clock import ClockMap, slope_beneath
from wheelsight.io.devices.wire_formats import FULL_PULSES, Counts, PlainReading, Pulses

_FEWEST_PULSES = 10
_EARLIEST_S = 0.1
_LATEST_AFTER_REPLUG_S = 1.0
_DRIFT = 0.01
_WORD = 1 << 32


@dataclass(frozen=True, slots=True)
class _CountsReading:
    """A frame of counts, with its unwrapped clock in microseconds and its time of arrival."""

    counts: Counts
    clock_us: int
    arrival_s: float

    @property
    def clock_s(self) -> float:
        return 1e-6 * self.clock_us


class TickTracker:
    """Unwraps counts and stamps them in host time.

    A frame is inconsistent where its clock runs backwards, it arrives before it was sent, or a wheel turns impossibly
    fast. It is then held until the next frame. If that one is consistent with the held frame, the controller restarted
    (`restarts`); else the held frame was damaged (`refused`). After a restart the counters begin at zero, so their
    values are added.

    Attributes:
        clock: the mapping from the controller's clock to the host's.
        restarts: the number of restarts of the controller or its counters.
        refused: the number of damaged frames with a valid checksum, and of damaged lines of text, which have none.
    """

    def __init__(self) -> None:
        self.clock = ClockMap()
        self._pairs = PairClock()
        self._plain = PlainTracker()
        self.restarts = self.refused = 0
        self._left = self._right = 0
        self._has_begun = self._is_plain = False
        self._last: _CountsReading | None = None
        self._held: _CountsReading | None = None
        self._was_replugged = self._reset_is_due = False
        self._stamp_s = -float("inf")

    @property
    def drift_ppm(self) -> float:
        """The drift of the controller's clock in millionths, positive where it runs faster; 0 without a clock."""
        return (self._plain.clock if self._is_plain else self.clock).drift_ppm

    def add_counts(self, counts: Counts, arrival_s: float) -> list[WheelTicks]:
        """Add a frame that arrived at `arrival_s`. Returns the confirmed ticks: none, one, or two after a restart."""
        last, held = self._last, self._held
        self._pairs.restart()  # the number of pairs is unknown across frames
        self._plain.forget()
        self._is_plain = False
        if last is None:
            if not self._has_begun:  # else the counts of the paper's format continue
                self._has_begun, self._left, self._right = True, counts.left, counts.right
            return [self._accept(_CountsReading(counts, counts.clock_us, arrival_s), (0, 0))]
        steps = _steps(last.counts, counts)
        if self._reset_is_due and abs(counts.left) + abs(counts.right) < sum(map(abs, steps)):
            self._reset_is_due = False  # the counts are nearer to zero than to what they were
            last = self._last = _from_zero(last)
        reading = self._unwrap(last, counts, arrival_s)
        if self._follows(last, reading):
            self.refused += held is not None
            return [self._accept(reading, _steps(last.counts, counts))]
        self._held = _CountsReading(counts, counts.clock_us, arrival_s)
        if held is None:
            return []
        after = self._unwrap(held, counts, arrival_s)
        if not _is_possible(held, after):
            self.refused += 1
            return []
        began = self._restart(last, held)
        return [began, self._accept(after, _steps(held.counts, counts))]

    def add_pulses(self, pulses: Pulses) -> WheelTicks:
        """Add a pair of the paper's format. Returns its ticks, stamped by the number of pairs, as it has no clock."""
        self._has_begun = True
        self._plain.forget()
        if self._last is not None:  # later frames of counts include these pulses
            counts = self._last.counts
            counts = counts._replace(left=counts.left + pulses.left, right=counts.right + pulses.right)
            self._last = _CountsReading(counts, self._last.clock_us, self._last.arrival_s)
        self._left += pulses.left
        self._right += pulses.right
        is_early = max(abs(pulses.left), abs(pulses.right)) >= FULL_PULSES
        sent_s = self._pairs.stamp_s(pulses.arrival_s, pulses.following, is_early)
        self._stamp_s = max(sent_s, self._stamp_s + 1e-6)
        return WheelTicks(self._stamp_s, self._left, self._right)

    def add_line(self, reading: PlainReading) -> list[WheelTicks]:
        """Add a line of plain text. Returns the confirmed ticks: none, one, or two."""
        plain = self._plain
        if self._last is not None:  # later frames are of another program
            self._last = self._held = None
            self.clock.restart()
        self._pairs.restart()
        self._is_plain = True
        restarts, refused = plain.restarts, plain.refused
        steps = plain.add(reading)
        self.restarts += plain.restarts - restarts
        self.refused += plain.refused - refused
        if steps and not self._has_begun:
            self._has_begun, self._left, self._right = True, reading.left, reading.right
        ticks = []
        for step in steps:
            self._left += step.left
            self._right += step.right
            self._stamp_s = max(step.stamp_s, self._stamp_s + 1e-6)
            ticks.append(WheelTicks(self._stamp_s, self._left, self._right))
        return ticks

    def expect_reset(self, is_due: bool) -> None:
        """Set whether a reset of the controller's counters is due, which is not motion."""
        self._reset_is_due = is_due

    def reset_done(self) -> None:
        """Apply a confirmed reset of the counters, unless a frame showed it before."""
        if self._reset_is_due and self._last is not None:
            self._last = _from_zero(self._last)
        self._reset_is_due = False

    def replugged(self) -> None:
        """Note that the port was reopened. Frames are then recent, so a clock that lags shows a restart."""
        self._was_replugged = True
        self._plain.replugged()
        self._pairs.restart()

    def _unwrap(self, last: _CountsReading, counts: Counts, arrival_s: float) -> _CountsReading:
        """The reading with its clock unwrapped; host time gives the number of roll-overs since `last`."""
        step_us = (counts.clock_us - last.counts.clock_us) % _WORD
        passed_us = 1e6 * (arrival_s - last.arrival_s)
        step_us += _WORD * max(0, round((passed_us - step_us) / _WORD))
        return _CountsReading(counts, last.clock_us + step_us, arrival_s)

    def _follows(self, last: _CountsReading, reading: _CountsReading) -> bool:
        """Whether a controller without a restart may have sent both."""
        passed_s = reading.arrival_s - last.arrival_s
        delay_s = reading.arrival_s - self.clock.host_s(reading.clock_s)
        slack_s = _DRIFT * passed_s
        if self._was_replugged and delay_s > _LATEST_AFTER_REPLUG_S + slack_s:
            return False
        return delay_s >= -_EARLIEST_S - slack_s and _is_possible(last, reading)

    def _accept(self, reading: _CountsReading, steps: tuple[int, int]) -> WheelTicks:
        self._last, self._held, self._was_replugged = reading, None, False
        self._left += steps[0]
        self._right += steps[1]
        self.clock.update(reading.clock_s, reading.arrival_s)
        self._stamp_s = max(self.clock.stamp_s(reading.clock_s), self._stamp_s + 1e-6)
        return WheelTicks(self._stamp_s, self._left, self._right)

    def _restart(self, last: _CountsReading, first: _CountsReading) -> WheelTicks:
        """The ticks of a confirmed first frame of a controller that restarted, or whose clock or counters jumped.

        Motion across it are all counts since a boot, or the step of counters that continued.
        """
        self.restarts += 1
        self.clock.restart()
        passed_s = first.arrival_s - last.arrival_s
        if first.clock_s <= passed_s + _LATEST_AFTER_REPLUG_S:
            pulses, seconds = (first.counts.left, first.counts.right), first.clock_s
        else:
            pulses, seconds = _steps(last.counts, first.counts), passed_s
        return self._accept(first, pulses if _can_count(pulses, seconds) else (0, 0))


def _is_possible(last: _CountsReading, reading: _CountsReading) -> bool:
    step_s = reading.clock_s - last.clock_s
    return step_s > 0 and _can_count(_steps(last.counts, reading.counts), step_s)


def _can_count(pulses: tuple[int, int], seconds: float) -> bool:
    return max(map(abs, pulses)) <= _FEWEST_PULSES + FASTEST_COUNTS_PER_S * seconds


def _steps(last: Counts, counts: Counts) -> tuple[int, int]:
    """Pulses from one frame to the next, the shorter way around the 32-bit counters."""
    return _signed(counts.left - last.left), _signed(counts.right - last.right)


def _signed(difference: int) -> int:
    return (difference + _WORD // 2) % _WORD - _WORD // 2


def _from_zero(reading: _CountsReading) -> _CountsReading:
    """The reading with counters of zero."""
    return _CountsReading(reading.counts._replace(left=0, right=0), reading.clock_us, reading.arrival_s)


# Plain text. It has no checksum, so each reading is checked against its neighbours.

_SIGNED, _UNSIGNED = (-(1 << 15), (1 << 15) - 1), (0, (1 << 16) - 1)
_PLAIN_EARLIEST_S = 0.03
_LONGEST_DELAY_S = 1.0
_EARLY_WINDOW_S, _EARLY_LINES = 1.0, 3  # found on damaged lines alone
_PLAIN_DRIFT = 0.02
# Largest difference of an accepted count from the expected one: a lost digit changes a number of two or more digits by
# at least 9. The share is of the motion from line to line.
_SLACK_COUNTS, _SLACK_SHARE = 8, 0.5
# Largest difference that the next line can confirm, plus its growth with the time between lines squared, for 1 m/s² at
# 16 000 counts a metre (5000 lines, wheel radius 0.2 m) and some more. The share is of the motion from line to line.
_GAIN_COUNTS, _GAIN_COUNTS_PER_S2, _GAIN_SHARE = 64, 20_000, 2.0
_LONGEST_GAP_S = 0.5  # between lines over which wheels may gain speed; a board boots for longer
_CONFIRMING_LINES = 4  # consistent lines that make a jump a restart or motion; found on damaged lines alone
FASTEST_COUNTS_PER_S = 500_000  # an encoder of 5000 lines at 20 turns a second makes 400 000

Pair = tuple[int, int]


class PlainStep(NamedTuple):
    """Counts of both wheels since the last step, and their host time."""

    stamp_s: float
    left: int
    right: int


@dataclass(frozen=True, slots=True)
class _PlainReading:
    """A reading with its unwrapped clock in microseconds, or None where the line has no time."""

    counts: Pair
    shown_us: int | None
    clock_us: int | None
    arrival_s: float

    def since(self, before: _PlainReading) -> float:
        """Seconds since another reading, by the controller's clock if there is one."""
        if self.clock_us is None or before.clock_us is None:
            return self.arrival_s - before.arrival_s
        return 1e-6 * (self.clock_us - before.clock_us)

    def booted_since(self, before: _PlainReading) -> bool:
        """Whether the clock may have started at zero after another reading."""
        passed_s = self.arrival_s - before.arrival_s
        return self.shown_us is not None and 1e-6 * self.shown_us <= passed_s + _LONGEST_DELAY_S


class PlainTracker:
    """Separates motion from damaged lines, roll-over and restarts.

    A reading is accepted at once where both wheels moved about as before. Else it waits. Where wheels can gain the
    speed that it shows, the next reading confirms it by continuing the motion. Otherwise several consistent readings
    are needed. They are motion, or a restart (`restarts`) if the counters returned to near zero or the clock restarted.
    Other waiting readings are `refused`. Counts are cumulative, so that this loses no motion.

    Attributes:
        clock: the mapping from the controller's clock to the host's.
        restarts, refused: as `TickTracker` counts them.
    """

    def __init__(self) -> None:
        self.clock = ClockMap(_PLAIN_DRIFT)
        self.restarts = self.refused = 0
        self._last: _PlainReading | None = None
        self._waiting: list[_PlainReading] = []  # each follows from the one before
        self._speeds = (0.0, 0.0)
        self._range: list[Pair] = [(0, 0), (0, 0)]  # the smallest and largest count of each wheel
        self._was_replugged = False
        self._early: deque[tuple[float, float]] = deque(
            maxlen=1024
        )  # arrivals, and by how much before the map they came
        self._has_map = False
        self._stamp_s = -float("inf")

    def add(self, line: PlainReading) -> list[PlainStep]:
        """Add a reading. Returns the confirmed steps; the first one is zero."""
        if line.clock is None and line.following:
            return []  # its arrival is unknown: of lines in one read, only the last one did not wait
        if self._last is None:
            return [self._begin(_first(line))]
        last, now = self._last, _after(self._last, line)
        if (
            not self._was_replugged
            and self._is_in_time(last, now)
            and self._agrees(self._step(last, now), self._due(now.since(last)))
        ):
            self.refused += len(self._waiting)
            return [self._accept(now)]
        if not self._waiting:
            self._waiting = [now]
            return []
        return self._decide(last, _after(self._waiting[-1], line))

    def replugged(self) -> None:
        """Note that the port was reopened, which restarts most boards."""
        self._was_replugged = True
        self._waiting.clear()

    def forget(self) -> None:
        """Reset after messages of another format, which include the counts meanwhile."""
        if self._last is not None:
            self.clock.restart()
            self._has_map = False
            self._early.clear()
        self._last = None
        self._waiting.clear()

    def _decide(self, last: _PlainReading, now: _PlainReading) -> list[PlainStep]:
        """Accept, refuse or keep the waiting readings, given another one."""
        held = self._waiting[-1]
        follows = self._follows(last, held, now)
        if len(self._waiting) == 1 and self._is_gain(last, held) and (follows or self._is_between(last, held, now)):
            self._waiting = [] if follows else [now]
            return [self._accept(held, keeps=True), *([self._accept(now)] if follows else [])]
        if not follows:
            self.refused += len(self._waiting)
            self._waiting.clear()
        self._waiting.append(now)
        if len(self._waiting) < _CONFIRMING_LINES:
            return []
        # Accept the waiting readings, as motion where possible, else as those of a board that restarted.
        waiting = self._waiting
        # Later than the last, and not far ahead of the host's clock: a digit of the time may have been lost.
        later = [
            reading
            for reading in waiting
            if 0 < reading.since(last) <= (1 + _PLAIN_DRIFT) * (reading.arrival_s - last.arrival_s) + _LONGEST_DELAY_S
        ]
        if later and self._can_count(last, later[0]) and not self._is_reset(last, waiting[0]):
            self.refused += len(waiting) - len(later)
            return [self._accept(reading) for reading in later]
        return [self._restart(last, waiting[0]), *(self._accept(reading) for reading in waiting[1:])]

    def _is_gain(self, last: _PlainReading, held: _PlainReading) -> bool:
        """Whether both wheels may have changed their speed by this much."""
        passed_s = held.since(last)
        if self._was_replugged or not self._is_in_time(last, held) or passed_s > _LONGEST_GAP_S:
            return False
        return self._may_gain(self._step(last, held), self._due(passed_s), passed_s)

    def _may_gain(self, steps: Pair, due: tuple[float, float], passed_s: float) -> bool:
        gain = _GAIN_COUNTS + _GAIN_COUNTS_PER_S2 * passed_s**2
        return all(abs(a - b) <= gain + _GAIN_SHARE * abs(b) for a, b in zip(steps, due, strict=True))

    def _follows(self, last: _PlainReading, held: _PlainReading, now: _PlainReading) -> bool:
        """Whether both wheels continued after the held reading as they moved to it, or before it."""
        passed_s = now.since(held)
        if not 0 < passed_s <= (1 + _PLAIN_DRIFT) * (now.arrival_s - held.arrival_s) + _PLAIN_EARLIEST_S:
            return False
        before = self._waiting[-2] if len(self._waiting) > 1 else last
        steps, took_s = self._step(before, held), held.since(before)
        step = self._step(held, now)
        if took_s > 0 and self._agrees(step, (steps[0] * passed_s / took_s, steps[1] * passed_s / took_s)):
            return True
        return len(self._waiting) == 1 and (self._agrees(step, self._due(passed_s)) or self._agrees(step, (0, 0)))

    def _is_between(self, last: _PlainReading, held: _PlainReading, now: _PlainReading) -> bool:
        """Whether both wheels continued in one direction, as when they accelerate or brake."""
        first, second, passed_s = self._step(last, held), self._step(held, now), now.since(held)
        if not 0 < passed_s <= _LONGEST_GAP_S or any(a * b < 0 for a, b in zip(first, second, strict=True)):
            return False
        share = passed_s / held.since(last)
        return self._may_gain(second, (share * first[0], share * first[1]), passed_s)

    def _is_zero_again(self, last: _PlainReading, first: _PlainReading) -> bool:
        """Whether counters are nearer to zero than to their last values."""
        return sum(map(abs, first.counts)) < sum(map(abs, self._step(last, first)))

    def _is_reset(self, last: _PlainReading, first: _PlainReading) -> bool:
        """Whether the waiting readings are of a board that restarted, judged without its clock."""
        if not self._is_zero_again(last, first):
            return False
        if self._was_replugged:
            return first.clock_us is None or not self._is_in_time(last, first)
        steps, passed_s = self._step(first, self._waiting[-1]), first.since(last)
        share = passed_s / max(self._waiting[-1].since(first), 1e-6)  # what they have counted, if it was at this speed
        return all(
            abs(count) <= _SLACK_COUNTS + 2 * share * abs(step) for count, step in zip(first.counts, steps, strict=True)
        )

    def _is_in_time(self, last: _PlainReading, now: _PlainReading) -> bool:
        """Whether one clock without a restart gives both, and the reading arrived after it was sent."""
        if now.clock_us is None:
            return now.arrival_s > last.arrival_s
        early_s = self.clock.host_s(1e-6 * now.clock_us) - now.arrival_s
        return now.since(last) > 0 and early_s <= _PLAIN_EARLIEST_S + _PLAIN_DRIFT * (now.arrival_s - last.arrival_s)

    def _can_count(self, last: _PlainReading, now: _PlainReading) -> bool:
        most = _SLACK_COUNTS + FASTEST_COUNTS_PER_S * now.since(last)
        return max(map(abs, self._step(last, now))) <= most

    def _agrees(self, steps: Pair, due: tuple[float, float]) -> bool:
        return all(abs(a - b) <= _SLACK_COUNTS + _SLACK_SHARE * abs(b) for a, b in zip(steps, due, strict=True))

    def _due(self, passed_s: float) -> tuple[float, float]:
        """The step of both wheels in a time at their last speed."""
        return self._speeds[0] * passed_s, self._speeds[1] * passed_s

    def _step(self, last: _PlainReading, now: _PlainReading) -> Pair:
        """Counts of both wheels between two readings, across a roll-over where that agrees with the expected step."""
        due = self._due(max(now.since(last), 0.0))
        left, right = (_shortest(last.counts[i], now.counts[i], self._range[i], due[i]) for i in (0, 1))
        return left, right

    def _accept(self, now: _PlainReading, keeps: bool = False) -> PlainStep:
        """The step to an accepted reading. Drops waiting readings unless `keeps`."""
        assert self._last is not None
        steps, passed_s = self._step(self._last, now), max(now.since(self._last), 1e-6)
        if not keeps:
            self._waiting.clear()
        self._speeds = (steps[0] / passed_s, steps[1] / passed_s)
        return self._take(now, steps)

    def _begin(self, first: _PlainReading) -> PlainStep:
        self._speeds, self._range = (0.0, 0.0), [(0, 0), (0, 0)]
        return self._take(first, (0, 0))

    def _restart(self, last: _PlainReading, first: _PlainReading) -> PlainStep:
        """The step to the first reading after a restart: its counts from zero, where they are plausible."""
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
        most = _SLACK_COUNTS + FASTEST_COUNTS_PER_S * passed_s
        step = self._begin(first)
        is_motion = max(map(abs, counts)) <= most
        return step._replace(left=counts[0], right=counts[1]) if is_motion else step

    def _take(self, now: _PlainReading, steps: Pair) -> PlainStep:
        self._last, self._was_replugged = now, False
        stamp_s = now.arrival_s
        if now.clock_us is not None:
            # The map uses the earliest line of a minute, and one damaged digit of a time would shift all its stamps.
            # Where too few lines of the last second came as early, a later arrival is used.
            clock_s, arrival_s = 1e-6 * now.clock_us, now.arrival_s
            early_s = self.clock.host_s(clock_s) - arrival_s
            self._early.append((arrival_s, early_s))
            while self._early[0][0] < arrival_s - _EARLY_WINDOW_S:
                self._early.popleft()
            earliest = sorted((early for _, early in self._early), reverse=True)[:_EARLY_LINES]
            allowed_s = max(earliest[-1], 0.0) if len(earliest) == _EARLY_LINES else 0.0
            self.clock.update(clock_s, arrival_s + max(early_s - allowed_s, 0.0) if self._has_map else arrival_s)
            self._has_map = True
            stamp_s = self.clock.stamp_s(1e-6 * now.clock_us)
        for i, (least, most) in enumerate(self._range):
            self._range[i] = min(least, now.counts[i]), max(most, now.counts[i])
        self._stamp_s = max(stamp_s, self._stamp_s + 1e-6)
        return PlainStep(self._stamp_s, *steps)


def _first(line: PlainReading) -> _PlainReading:
    shown_us = None if line.clock is None else line.clock * line.us_per_tick
    return _PlainReading((line.left, line.right), shown_us, shown_us, line.arrival_s)


def _after(last: _PlainReading, line: PlainReading) -> _PlainReading:
    """The reading, with a roll-over of its clock since `last` where that is nearer to host time."""
    now = _first(line)
    if now.shown_us is None or last.shown_us is None or last.clock_us is None:
        return now
    passed_us = 1e6 * (now.arrival_s - last.arrival_s)
    step_us = now.shown_us - last.shown_us
    rolled_us = step_us + _WORD * line.us_per_tick
    if abs(rolled_us - passed_us) < abs(step_us - passed_us):
        step_us = rolled_us
    return _PlainReading(now.counts, now.shown_us, last.clock_us + step_us, now.arrival_s)


def _shortest(before: int, now: int, range_seen: Pair, expected: float) -> int:
    """The step between two counts that is nearest to the expected one, with or without a roll-over."""
    step, rolls = now - before, [_WORD]
    seen = (min(*range_seen, before, now), max(*range_seen, before, now))
    if any(least <= seen[0] and seen[1] <= most for least, most in (_SIGNED, _UNSIGNED)):
        rolls.append(1 << 16)
    steps = [step, *(step + roll for roll in rolls), *(step - roll for roll in rolls)]
    return min(steps, key=lambda candidate: abs(candidate - expected))


# The paper's format

# Long enough that a jitter of milliseconds changes the period by at most a part in a thousand.
_LEARN_S = 4.0
# Crystals differ by far less, but the line over four seconds may be wrong by some parts in a thousand.
_LARGEST_DRIFT = 0.02
# Longest delay of a transport; a longer one means that the controller sent nothing.
_LONGEST_PAIR_DELAY_S = 0.5
# Arrivals that stay late for this long show that the number of pairs is wrong.
_STAYS_S = 1.0
_TICK_S = 1e-6
_LONGEST_PERIOD_S, _SHORTEST_PERIOD_S = 0.2, 0.003


class PairClock:
    """Stamps of pairs in host time, from their number and arrivals.

    Pairs are sent at a fixed period, so that their number is a clock. Arrivals over it lie on or above a line with the
    period as slope (`ClockMap`). After a lost pair all arrivals stay a period above the line. Pairs are stamped with
    their arrival until the period is known, and where they are sent early because a count was full. Stamps increase
    strictly, and are later than arrivals only where those run backwards.

    Attributes:
        period_s: the estimated period, or None.
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
            following: the number of pairs after it in the same read; each was sent a period later.
            is_early: whether a count was full, so that the pair may have been sent early.
        """
        if is_early:
            self.restart()
            return self._growing(arrival_s, arrival_s)
        self._number += 1
        if self.period_s is None:
            if not following:  # of pairs in one read, the last one waited least
                self._arrivals.append((float(self._number), arrival_s))
            if len(self._arrivals) >= 3 and self._arrivals[-1][1] - self._arrivals[0][1] >= _LEARN_S:
                period_s = slope_beneath(self._arrivals)
                if _SHORTEST_PERIOD_S <= period_s <= _LONGEST_PERIOD_S:
                    self.period_s = period_s
                    for number, arrived_s in self._arrivals:
                        self._map.update(number * period_s, arrived_s)
                    self._begun = True
                self._arrivals.clear()
            return self._growing(arrival_s, arrival_s)
        latest_s = arrival_s - following * self.period_s
        if self._begun:
            self._count_lost(arrival_s, latest_s, following)
        clock_s = self._number * self.period_s
        self._map.update(clock_s, latest_s)
        self._begun = True
        return self._growing(self._map.host_s(clock_s), arrival_s)

    def restart(self) -> None:
        """Reset the count after the port vanished or pairs were sent early. The period is kept."""
        self._map.restart()
        self._arrivals.clear()
        self._late.clear()
        self._begun = False

    def _count_lost(self, arrival_s: float, latest_s: float, following: int) -> None:
        """Correct the number after pairs were lost or not sent."""
        assert self.period_s is not None
        late_s = latest_s - self._map.host_s(self._number * self.period_s)
        missing_s = late_s if late_s > _LONGEST_PAIR_DELAY_S else 0.0
        if not missing_s and not following:  # pairs of one read are late together, once
            self._late.append((arrival_s, late_s))
            while arrival_s - self._late[0][0] > _STAYS_S:
                self._late.popleft()
            is_known = arrival_s - self._late[0][0] > _STAYS_S - 3 * self.period_s
            missing_s = min(late for _, late in self._late) if is_known else 0.0
        missing = round(missing_s / self.period_s)
        if missing > 0:
            self._number += missing
            self.lost += missing
            self._late.clear()

    def _growing(self, stamp_s: float, arrival_s: float) -> float:
        self._stamp_s = max(min(stamp_s, arrival_s), self._stamp_s + _TICK_S)
        return self._stamp_s
