"""From counts printed as text to motion that never jumps: there is no checksum, so neighbours judge each reading."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from wheelsight.devices.clock import ClockMap
from wheelsight.devices.plain_text import PlainReading, PlainTextSettings

_WORD = 1 << 32
_SIGNED, _UNSIGNED = (-(1 << 15), (1 << 15) - 1), (0, (1 << 16) - 1)
_EARLIEST_S = 0.03
_LONGEST_DELAY_S = 1.0
_EARLY_WINDOW_S, _EARLY_LINES = 1.0, 3  # found on damaged lines alone
_DRIFT = 0.02
FASTEST_COUNTS_PER_S = 500_000  # an encoder of 5000 lines at 20 turns a second makes 400 000

Pair = tuple[int, int]


class PlainStep(NamedTuple):
    """Counts of both wheels since the step before, and the host time at which they were taken."""

    stamp_s: float
    left: int
    right: int


@dataclass(frozen=True, slots=True)
class _Reading:
    """A reading, its clock unwrapped in microseconds, or None where the line has no time."""

    counts: Pair
    shown_us: int | None
    clock_us: int | None
    arrival_s: float

    def since(self, before: _Reading) -> float:
        """Seconds since another, by the controller's clock where there is one."""
        if self.clock_us is None or before.clock_us is None:
            return self.arrival_s - before.arrival_s
        return 1e-6 * (self.clock_us - before.clock_us)

    def booted_since(self, before: _Reading) -> bool:
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
        self.clock = ClockMap(_DRIFT)
        self.restarts = self.refused = 0
        self._settings = settings or PlainTextSettings()
        self._last: _Reading | None = None
        self._waiting: list[_Reading] = []  # each follows from the one before
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

    def _decide(self, last: _Reading, now: _Reading) -> list[PlainStep]:
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

    def _confirm(self, last: _Reading) -> list[PlainStep]:
        """Take the readings that wait: as motion where that may be, else as of a board that began anew."""
        waiting, later = self._waiting, [reading for reading in self._waiting if self._is_later(last, reading)]
        if later and self._can_count(last, later[0]) and not self._is_reset(last, waiting[0]):
            self.refused += len(waiting) - len(later)
            return [self._accept(reading) for reading in later]
        return [self._begin_anew(last, waiting[0]), *(self._accept(reading) for reading in waiting[1:])]

    def _is_later(self, last: _Reading, now: _Reading) -> bool:
        """Whether its time is after another's, and not far ahead of the host's: a digit of it may have been lost."""
        passed_s = now.arrival_s - last.arrival_s
        return 0 < now.since(last) <= (1 + _DRIFT) * passed_s + _LONGEST_DELAY_S

    def _is_expected(self, last: _Reading, now: _Reading) -> bool:
        """Whether it may be believed at once."""
        if self._was_replugged or not self._is_in_time(last, now):
            return False
        return self._agrees(self._step(last, now), self._due(now.since(last)))

    def _is_gain(self, last: _Reading, held: _Reading) -> bool:
        """Whether both wheels may have gained so much speed, or lost it."""
        passed_s = held.since(last)
        if self._was_replugged or not self._is_in_time(last, held) or passed_s > self._settings.longest_gap_s:
            return False
        return self._may_gain(self._step(last, held), self._due(passed_s), passed_s)

    def _may_gain(self, steps: Pair, due: tuple[float, float], passed_s: float) -> bool:
        settings = self._settings
        gain = settings.gain_counts + settings.gain_counts_per_s2 * passed_s**2
        return all(abs(a - b) <= gain + settings.gain_share * abs(b) for a, b in zip(steps, due, strict=True))

    def _follows(self, last: _Reading, held: _Reading, now: _Reading) -> bool:
        """Whether both wheels moved on from the held reading as they had moved to it, or before it."""
        passed_s = now.since(held)
        if not 0 < passed_s <= (1 + _DRIFT) * (now.arrival_s - held.arrival_s) + _EARLIEST_S:
            return False
        before = self._waiting[-2] if len(self._waiting) > 1 else last
        steps, took_s = self._step(before, held), held.since(before)
        step = self._step(held, now)
        if took_s > 0 and self._agrees(step, (steps[0] * passed_s / took_s, steps[1] * passed_s / took_s)):
            return True
        return len(self._waiting) == 1 and (self._agrees(step, self._due(passed_s)) or self._agrees(step, (0, 0)))

    def _is_between(self, last: _Reading, held: _Reading, now: _Reading) -> bool:
        """Whether both wheels went on in one direction, as wheels that gain speed or brake do."""
        first, second, passed_s = self._step(last, held), self._step(held, now), now.since(held)
        if not 0 < passed_s <= self._settings.longest_gap_s or any(
            a * b < 0 for a, b in zip(first, second, strict=True)
        ):
            return False
        share = passed_s / held.since(last)
        return self._may_gain(second, (share * first[0], share * first[1]), passed_s)

    def _is_zero_again(self, last: _Reading, first: _Reading) -> bool:
        """Whether counters are nearer to zero than to where they were."""
        return sum(map(abs, first.counts)) < sum(map(abs, self._step(last, first)))

    def _is_reset(self, last: _Reading, first: _Reading) -> bool:
        """Whether the readings that wait are of a board that began anew, though no clock says so."""
        if not self._is_zero_again(last, first):
            return False
        if self._was_replugged:
            return first.clock_us is None or not self._is_in_time(last, first)
        steps, passed_s = self._step(first, self._waiting[-1]), first.since(last)
        share = passed_s / max(self._waiting[-1].since(first), 1e-6)  # what they have counted, if it was at this speed
        slack = self._settings.slack_counts
        return all(abs(count) <= slack + 2 * share * abs(step) for count, step in zip(first.counts, steps, strict=True))

    def _is_in_time(self, last: _Reading, now: _Reading) -> bool:
        """Whether one clock, running on, may have told both, and it arrived after it was sent."""
        if now.clock_us is None:
            return now.arrival_s > last.arrival_s
        early_s = self.clock.host_s(1e-6 * now.clock_us) - now.arrival_s
        return now.since(last) > 0 and early_s <= _EARLIEST_S + _DRIFT * (now.arrival_s - last.arrival_s)

    def _can_count(self, last: _Reading, now: _Reading) -> bool:
        most = self._settings.slack_counts + FASTEST_COUNTS_PER_S * now.since(last)
        return max(map(abs, self._step(last, now))) <= most

    def _agrees(self, steps: Pair, due: tuple[float, float]) -> bool:
        slack, share = self._settings.slack_counts, self._settings.slack_share
        return all(abs(a - b) <= slack + share * abs(b) for a, b in zip(steps, due, strict=True))

    def _due(self, passed_s: float) -> tuple[float, float]:
        """The step that both wheels make in so long, at the speed they had."""
        return self._speeds[0] * passed_s, self._speeds[1] * passed_s

    def _step(self, last: _Reading, now: _Reading) -> Pair:
        """Counts of both wheels from one reading to another, across a roll-over where that is what was expected."""
        due = self._due(max(now.since(last), 0.0))
        left, right = (_shortest(last.counts[i], now.counts[i], self._range[i], due[i]) for i in (0, 1))
        return left, right

    def _accept(self, now: _Reading, keeps: bool = False) -> PlainStep:
        """The step to a reading; those that wait are forgotten unless they are to be kept."""
        assert self._last is not None
        steps, passed_s = self._step(self._last, now), max(now.since(self._last), 1e-6)
        if not keeps:
            self._waiting.clear()
        self._speeds = (steps[0] / passed_s, steps[1] / passed_s)
        return self._take(now, steps)

    def _begin(self, first: _Reading) -> PlainStep:
        self._speeds, self._range = (0.0, 0.0), [(0, 0), (0, 0)]
        return self._take(first, (0, 0))

    def _begin_anew(self, last: _Reading, first: _Reading) -> PlainStep:
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

    def _take(self, now: _Reading, steps: Pair) -> PlainStep:
        self._last, self._was_replugged = now, False
        stamp_s = self._stamp_of(now)
        for i, (least, most) in enumerate(self._range):
            self._range[i] = min(least, now.counts[i]), max(most, now.counts[i])
        self._stamp_s = max(stamp_s, self._stamp_s + 1e-6)
        return PlainStep(self._stamp_s, *steps)

    def _stamp_of(self, now: _Reading) -> float:
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


def _first(told: PlainReading) -> _Reading:
    shown_us = None if told.clock is None else told.clock * told.us_per_tick
    return _Reading((told.left, told.right), shown_us, shown_us, told.arrival_s)


def _after(last: _Reading, told: PlainReading) -> _Reading:
    """The reading, its clock rolled over since `last` where host time is nearer to that."""
    now = _first(told)
    if now.shown_us is None or last.shown_us is None or last.clock_us is None:
        return now
    passed_us = 1e6 * (now.arrival_s - last.arrival_s)
    step_us = now.shown_us - last.shown_us
    rolled_us = step_us + _WORD * told.us_per_tick
    if abs(rolled_us - passed_us) < abs(step_us - passed_us):
        step_us = rolled_us
    return _Reading(now.counts, now.shown_us, last.clock_us + step_us, now.arrival_s)


def _shortest(before: int, now: int, range_seen: Pair, expected: float) -> int:
    """The step from one count to the next that is nearest to what was expected, of those that a roll-over can make."""
    step, rolls = now - before, [_WORD]
    seen = (min(*range_seen, before, now), max(*range_seen, before, now))
    if any(least <= seen[0] and seen[1] <= most for least, most in (_SIGNED, _UNSIGNED)):
        rolls.append(1 << 16)
    steps = [step, *(step + roll for roll in rolls), *(step - roll for roll in rolls)]
    return min(steps, key=lambda candidate: abs(candidate - expected))
