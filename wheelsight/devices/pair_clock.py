"""When pairs of the paper's format were sent: they come at a fixed period, so that their number is a clock.

Arrivals over the number of a pair lie on or above a line, as those of frames do over the controller's clock: its slope
is the period, and the line beneath them tells the stamps (`ClockMap`). What breaks the count is found by the line, too:
after a lost pair all arrivals stay a period above it. A pair sent early, since a count was full, tells no time.
"""

from __future__ import annotations

from collections import deque

from wheelsight.devices.clock import ClockMap, slope_beneath

# Long enough that a jitter of milliseconds leaves a period's slope right to a part in a thousand.
_LEARN_S = 4.0
# Crystals differ by far less; the line over four seconds may be off by some parts in a thousand.
_LARGEST_DRIFT = 0.02
# A transport holds pairs back for shorter; beyond, the controller was silent.
_LONGEST_DELAY_S = 0.5
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
        missing_s = late_s if late_s > _LONGEST_DELAY_S else self._stays_s(late_s, arrival_s, following)
        missing = round(missing_s / self.period_s)
        if missing > 0:
            self._number += missing
            self.lost += missing
            self._late.clear()

    def _growing(self, stamp_s: float, arrival_s: float) -> float:
        self._stamp_s = max(min(stamp_s, arrival_s), self._stamp_s + _TICK_S)
        return self._stamp_s
