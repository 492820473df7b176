"""`TopicClock` gives the stamps of a topic's messages. It validates header stamps against the topic's other headers,
then other topics, then receipt times. `clocks_of` makes the clocks of a bag from its first messages.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from wheelsight.core.geometry import FloatArray
from wheelsight.io.recordings.bags.storage import Message
from wheelsight.io.recordings.recording import LeftOut

# Largest step, in usual periods, that is accepted without a check against receipt: one message was lost.
_LARGEST_STEP = 2.5
# Longer than a burst of a driver; shorter than an error of a stamp that matters to wheels.
_SMALLEST_STEP_S = 0.1
# Largest difference between receipt and header, in seconds or periods: images are received up to some tenths late.
_AGREES_S = 0.25
# Fewest consecutive messages that show that a clock was set; fewer are single wrong stamps.
_RUN = 5
_MOST_PENDING = 12
# Fewest consecutive headers ahead that show that the recorder's clock was set back; fewer are single wrong stamps.
_FEWEST_AHEAD = 3
# Bounds on the messages of a topic that wait after the recorder's clock was set back.
_MOST_AHEAD_S, _MOST_AHEAD_BYTES = 60.0, 192 << 20
# Largest difference between headers of topics that are received together: more is not a driver's delay.
APART_S = 0.5
_RECENT = 50
# Largest offset between headers and receipt; beyond, a replay was recorded, or receipt is not used.
_MOST_APART_S = 10.0
# Largest ratio of two topics' rates, both in seconds, even where the first messages are received in a burst.
_RATES_ALIKE = 4.0
_RATE_SAMPLES, _RATE_SPAN_S = 8, 0.3
_SLOWEST, _FASTEST = 0.02, 50.0

Settled = tuple[float, Message]


class TopicClock:
    """Stamps of one topic's messages. Some are known only after later messages have come.

    Attributes:
        shift_s: added to each header.
        by_receipt: whether to ignore headers; `shift_s` is then added to the time of receipt.
        left_out: the number of messages left out because their headers fit neither their neighbours nor receipt.
        unstamped: the number of headers that are 0; receipt replaces them.
        settings: (stamp before it, seconds) of each setting of the clock; positive is forward.
        set_back: (stamp before it, seconds) of each time the recorder's clock was set back.
        newest_s: the newest stamp so far.
    """

    def __init__(self, shift_s: float = 0.0, by_receipt: bool = False) -> None:
        self.shift_s, self.by_receipt = shift_s, by_receipt
        self.left_out = self.unstamped = 0
        self.set_back: list[tuple[float, float]] = []
        self._ahead: list[tuple[float, Message]] = []
        self._ahead_bytes = 0
        self.settings: list[tuple[float, float]] = []
        self.newest_s = -np.inf
        self._begins_with = shift_s
        self._recent: deque[tuple[float, float]] = deque(maxlen=_RECENT)
        self._usual_s, self._usual_for = _SMALLEST_STEP_S, 0
        self._pending: list[tuple[float, Message]] = []

    def restarted(self) -> TopicClock:
        """The clock for another pass, with counts of zero."""
        return TopicClock(self._begins_with, self.by_receipt)

    def add(self, header_s: float, message: Message, others_s: Iterable[float] = ()) -> list[Settled]:
        """Add a message. Returns the messages whose stamps are now known, oldest first.

        Args:
            header_s: of the message; 0 for none.
            message: in order of receipt.
            others_s: the newest stamps of other topics.
        """
        if self.by_receipt:
            return [self._stamped(message.receipt_s, message)]
        if not header_s and self._recent:
            self.unstamped += 1
            return [self._stamped(self._expected(message.receipt_s), message)]
        if self._recent and self._goes_on(header_s, message.receipt_s):
            settled = self._late_ones()
            self._recent.append((header_s, message.receipt_s))
            return [*settled, self._stamped(header_s, message), *self._reached()]
        self._pending.append((header_s, message))
        return self._resolve(others_s)

    def end(self) -> list[Settled]:
        """The remaining messages, after the last one."""
        if self._recent:
            settled = [*self._late_ones(), *self._reached(_LARGEST_STEP)]
            self._leave_out_ahead()
            return settled
        chain = self._chain()
        return self._accept(chain) if len(chain) > len(self._pending) / 2 else self._late_ones()

    def _resolve(self, others_s: Iterable[float]) -> list[Settled]:
        """Pending messages that follow each other: the beginning of the topic, or the clock was set."""
        if len(self._pending) >= _RUN and (settled := self._reached(_LARGEST_STEP)):
            return [*settled, *self._late_ones()]
        chain = self._chain()
        least = _RUN if self._recent else max(_RUN - 1, len(self._pending) // 2 + 1)
        if len(self._pending) >= _RUN and len(chain) >= least:
            if self._recent:
                self._set(chain, others_s)
            return self._accept(chain)
        if len(self._pending) >= _MOST_PENDING:
            del self._pending[0]
            self.left_out += 1
        return []

    def _set(self, chain: Sequence[int], others_s: Iterable[float]) -> None:
        """Remove the step of a clock that was set, unless receipt or other topics show that this time passed."""
        run = [self._pending[place] for place in chain]
        change_s = float(np.median([self._expected(message.receipt_s) - header_s for header_s, message in run]))
        last_s, newest_s = run[-1][0] + self.shift_s, self._recent[-1][0]
        is_later, usual_s = run[0][0] > newest_s, max(1.0, self._rate())
        # The rate of receipt is known after some messages. Before, later headers are accepted.
        is_known = len(self._recent) >= _RATE_SAMPLES
        if abs(change_s) <= _AGREES_S * usual_s or (
            is_later
            and (
                not is_known
                or abs(change_s) <= APART_S * usual_s
                or any(abs(other_s - last_s) <= APART_S for other_s in others_s)
            )
        ):
            return
        # Stamps after it must follow those before it, however irregular receipt is.
        change_s = max(change_s, newest_s - run[0][0] + min(self._period_s(), _SMALLEST_STEP_S))
        self.settings.append((newest_s + self.shift_s, -change_s))
        self.shift_s += change_s
        self._recent.clear()

    def _accept(self, chain: Sequence[int]) -> list[Settled]:
        """Stamp the pending messages at the places `chain`, and those of the others that came out of order."""
        run = [self._pending[place] for place in chain]
        others = [item for place, item in enumerate(self._pending) if place not in set(chain)]
        self._recent.extend((header_s, message.receipt_s) for header_s, message in run)
        settled = [self._stamped(header_s, message) for header_s, message in run]
        self._pending = others
        return sorted([*settled, *self._late_ones()], key=lambda item: item[0])

    def _late_ones(self) -> list[Settled]:
        """Pending messages that were received out of order or have no stamp; others wait ahead or are left out."""
        settled = []
        for header_s, message in self._pending:
            expected_s = self._expected(message.receipt_s) if self._recent else header_s
            if not header_s and self._recent:
                self.unstamped += 1
                settled.append(self._stamped(expected_s, message))
            elif self._recent and abs(expected_s - header_s) <= max(
                min(3 * self._period_s(), _AGREES_S), _SMALLEST_STEP_S
            ):
                settled.append(self._stamped(header_s, message))
            else:
                self._put_ahead(header_s, message)
        self._pending = []
        return settled

    def _put_ahead(self, header_s: float, message: Message) -> None:
        """Keep a message whose header is ahead, as long as those ahead follow each other; leave out others.

        When a recorder's clock is set back, the bag interleaves the messages before and after it, since receipt times
        repeat. The headers of both parts continue, and those of the first part reach the beginning of the second.
        """
        if self._recent and header_s <= self._recent[-1][0]:
            self.left_out += 1
            return
        if self._ahead:
            last_s, first_s = self._ahead[-1][0], self._ahead[0][0]
            goes_on = 0 < header_s - last_s <= max(_LARGEST_STEP * self._period_s(), _SMALLEST_STEP_S)
            is_too_long = self._ahead_bytes > _MOST_AHEAD_BYTES or header_s - first_s > _MOST_AHEAD_S
            if not goes_on or is_too_long:
                self._leave_out_ahead()
        self._ahead.append((header_s, message))
        self._ahead_bytes += len(message.data)

    def _leave_out_ahead(self) -> None:
        self.left_out += len(self._ahead)
        self._ahead, self._ahead_bytes = [], 0

    def _reached(self, most_periods: float = 1.5) -> list[Settled]:
        """The messages ahead, once the headers before them have reached their beginning."""
        if len(self._ahead) < _FEWEST_AHEAD or not self._recent:
            return []
        last_s, first_s = self._recent[-1][0], self._ahead[0][0]
        if not 0 < first_s - last_s <= most_periods * self._period_s():
            return []
        self.set_back.append((last_s + self.shift_s, self._recent[-1][1] - self._ahead[0][1].receipt_s))
        run, self._ahead, self._ahead_bytes = self._ahead, [], 0
        self._recent.clear()  # receipt times start again too
        self._recent.extend((header_s, message.receipt_s) for header_s, message in run)
        return [self._stamped(header_s, message) for header_s, message in run]

    def _chain(self) -> list[int]:
        """The places of the longest run of pending messages that follow each other."""
        return _longest_run([(header_s, message.receipt_s) for header_s, message in self._pending])

    def _goes_on(self, header_s: float, receipt_s: float) -> bool:
        """Whether a header follows the last valid one."""
        before, period_s = self._recent[-1], self._period_s()
        near = 0 < header_s - before[0] <= max(_LARGEST_STEP * period_s, _SMALLEST_STEP_S)
        if not near and not _follows(before, (header_s, receipt_s), period_s, self._rate()):
            return False
        if not self._pending:
            return True
        # A clock that was set back by little soon passes its last valid header; its offset from receipt persists.
        off_s = self._expected(receipt_s) - header_s
        others_s = [self._expected(message.receipt_s) - other_s for other_s, message in self._pending]
        alike_s = max(_SMALLEST_STEP_S, 0.25 * abs(off_s))
        return abs(off_s) <= _AGREES_S or not any(abs(off_s - other_s) <= alike_s for other_s in others_s)

    def _stamped(self, header_s: float, message: Message) -> Settled:
        stamp_s = header_s + self.shift_s
        self.newest_s = max(self.newest_s, stamp_s)
        return stamp_s, message

    def _expected(self, receipt_s: float) -> float:
        """The header expected at a time of receipt."""
        header_s, receipts_s = np.array(self._recent).T
        rate = self._rate()
        return float(np.median(header_s - rate * (receipts_s - receipts_s[-1])) + rate * (receipt_s - receipts_s[-1]))

    def _period_s(self) -> float:
        """The median period of recent headers, updated now and then."""
        self._usual_for -= 1
        if self._usual_for < 0:
            self._usual_s = _usual_period_s([header_s for header_s, _ in self._recent])
            self._usual_for = len(self._recent) // 2
        return self._usual_s

    def _rate(self) -> float:
        """Header seconds per second of receipt; differs from 1 in simulators."""
        return _rate_of(np.array(self._recent)) if self._recent else 1.0


def _usual_period_s(headers_s: Sequence[float]) -> float:
    steps_s = [after - before for before, after in pairwise(headers_s) if after > before]
    return float(np.median(steps_s)) if steps_s else _SMALLEST_STEP_S


def _follows(before: tuple[float, float], after: tuple[float, float], period_s: float, rate: float) -> bool:
    """Whether (header, receipt) follows another one: within a few periods, or by the step of receipt."""
    step_s = after[0] - before[0]
    if not step_s > 0 or not after[0] or not before[0]:
        return False
    if step_s <= max(_LARGEST_STEP * period_s, _SMALLEST_STEP_S):
        return True
    return abs(step_s - rate * (after[1] - before[1])) <= max(_AGREES_S, period_s)


def _longest_run(stamps: Sequence[tuple[float, float]]) -> list[int]:
    """The places of the longest run of (header, receipt) that follow each other; others between are skipped."""
    period_s = _usual_period_s([header_s for header_s, _ in stamps])
    longest: list[list[int]] = []
    for place, stamp in enumerate(stamps):
        before = [run for run in longest if _follows(stamps[run[-1]], stamp, period_s, 1.0)]
        longest.append([*max(before, key=len, default=[]), place])
    return max(longest, key=len, default=[])


def _rate_of(stamps: FloatArray) -> float:
    """The rate of (N, 2) headers and receipts; 1 where there are too few."""
    if len(stamps) < _RATE_SAMPLES:
        return 1.0
    # Medians of both ends are robust against a single wrong one.
    thirds = len(stamps) // 3
    (h0, r0), (h1, r1) = np.median(stamps[:thirds], axis=0), np.median(stamps[-thirds:], axis=0)
    if r1 - r0 < _RATE_SPAN_S:
        return 1.0
    rate = float((h1 - h0) / (r1 - r0))
    return rate if _SLOWEST <= rate <= _FASTEST else 1.0


@dataclass(frozen=True, slots=True)
class _Head:
    """The first messages of one topic.

    Attributes:
        stamps: (N, 2) valid headers, and receipts.
        why_not: why the headers are rejected; empty where they are used.
    """

    stamps: FloatArray
    why_not: str

    @classmethod
    def of(cls, stamps: Sequence[tuple[float, float]]) -> _Head:
        """The valid ones of a topic's first (header, receipt), or why its headers are rejected."""
        unstamped = sum(not header_s for header_s, _ in stamps)
        if unstamped > len(stamps) / 2:
            return cls(np.zeros((0, 2)), "headers have no stamp")
        run = _longest_run(stamps)
        if len(stamps) > 2 and len(run) < len(stamps) / 2:
            shown = ", ".join(f"{header_s:.3f}" for header_s, _ in stamps[:4])
            return cls(np.zeros((0, 2)), f"headers ({shown}, …) do not grow as a clock does")
        return cls(np.array([stamps[place] for place in run], float).reshape(-1, 2), "")

    @property
    def rate(self) -> float:
        return _rate_of(self.stamps)

    @property
    def lag_s(self) -> float:
        return float(np.median(self.stamps[:, 1] - self.stamps[:, 0]))


def clocks_of(
    firsts: Mapping[str, Sequence[tuple[float, float]]], lasts: Mapping[str, tuple[float, float]], images: Sequence[str]
) -> tuple[dict[str, TopicClock], tuple[str, ...]]:
    """A clock for each topic, and warnings about offsets and rejected headers.

    A constant offset between the headers of topics that are received together is removed. Headers that do not count
    seconds are replaced by receipt. An offset that all headers share, as in the recording of a replay, remains.

    Args:
        firsts: header and receipt of each topic's first messages, from when all topics have begun.
        lasts: header and receipt of each topic's last message.
        images: topics of one camera, which share a clock.
    """
    heads = {topic: _Head.of(stamps) for topic, stamps in firsts.items()}
    accepted = _of_one_rate({topic: head for topic, head in heads.items() if not head.why_not}, heads)
    if any(image not in accepted for image in images if image in heads):
        why = next(heads[image].why_not for image in images if image not in accepted)
        for image in set(images) & set(accepted):
            heads[image] = _Head(heads[image].stamps, f"the other images of its camera: {why}")
            del accepted[image]
    # Header seconds per second of receipt over the bag, of the slowest topic: a clock that was set looks faster.
    rates = []
    for topic, head in accepted.items():
        (first_s, first_receipt_s), (last_s, last_receipt_s) = head.stamps[0].tolist(), lasts[topic]
        if last_receipt_s > first_receipt_s:
            rates.append((last_s - first_s) / (last_receipt_s - first_receipt_s))
    shifts_s, reference = _shifts(accepted, images, APART_S * max(1.0, min(rates, default=1.0)))
    lag_s = accepted[reference].lag_s if reference else 0.0
    end_lag_s = lasts[reference][1] - lasts[reference][0] if reference else 0.0
    warnings = []
    clocks: dict[str, TopicClock] = {}
    for topic, head in heads.items():
        if topic in shifts_s:
            clocks[topic] = TopicClock(shifts_s[topic])
            if shifts_s[topic]:
                side = "before" if shifts_s[topic] > 0 else "after"
                warnings.append(
                    f"{topic}: headers are {abs(shifts_s[topic]):.3f} s {side} those of {reference} that are received "
                    f"at the same time (median of {len(head.stamps)}): the clocks are apart. The difference is "
                    "removed, to within the delay of receipt."
                )
        else:
            clocks[topic] = TopicClock(-lag_s if abs(lag_s) > _MOST_APART_S else 0.0, by_receipt=True)
            warnings.append(f"{topic}: {head.why_not}; the time of receipt is used.")
    if abs(end_lag_s - lag_s) > _MOST_APART_S:
        warnings.append(
            f"{reference}: receipt is {lag_s:.3f} s after the headers at the beginning, {end_lag_s:.3f} s at the end; "
            "the headers increase like a clock, and are used."
        )
    elif abs(lag_s) > _MOST_APART_S:
        what = "All headers are" if len(accepted) == len(heads) and not any(shifts_s.values()) else "Headers are"
        apart = f"{abs(lag_s):.0f} s {'before' if lag_s > 0 else 'after'}"
        warnings.append(f"{what} stamped {apart} receipt: a replay was recorded. They are used.")
    return clocks, tuple(warnings)


def _of_one_rate(accepted: dict[str, _Head], heads: dict[str, _Head]) -> dict[str, _Head]:
    """The topics whose headers have the rate nearest to receipt's. Rejects the others in `heads`."""
    if len(accepted) < 2:
        return accepted
    best = min(accepted, key=lambda topic: abs(np.log(accepted[topic].rate)))
    rate = accepted[best].rate
    for topic, head in list(accepted.items()):
        if len(head.stamps) >= _RATE_SAMPLES and not 1 / _RATES_ALIKE <= head.rate / rate <= _RATES_ALIKE:
            why = f"headers grow by {head.rate:.3g} a second of receipt, those of {best} by {rate:.3g}"
            heads[topic] = _Head(head.stamps, why)
            del accepted[topic]
    return accepted


def _shifts(accepted: Mapping[str, _Head], images: Sequence[str], most_s: float) -> tuple[dict[str, float], str]:
    """The shift of each topic's headers, and the topic of the reference clock: that of most sensors, or of receipt.

    Args:
        accepted: topics whose headers are used.
        images: topics of one camera.
        most_s: the largest offset of topics with one clock, in header seconds.
    """
    if not accepted:
        return {}, ""
    camera = [image for image in images if image in accepted]
    sensors = [topic for topic in accepted if topic not in camera[1:]]
    first = sensors[0]
    behind_s = {topic: _behind_s(accepted[topic], accepted[first]) for topic in sensors}
    groups: list[list[str]] = []
    for topic in sorted(sensors, key=lambda name: behind_s[name]):
        if groups and behind_s[topic] - behind_s[groups[-1][-1]] <= most_s:
            groups[-1].append(topic)
        else:
            groups.append([topic])
    group = min(groups, key=lambda names: (-len(names), abs(accepted[names[0]].lag_s)))
    reference = group[0]
    shifts_s = {}
    for names in groups:
        # Both clocks are compared by their topic with the least delay of receipt.
        shift_s = 0.0 if names is group else behind_s[names[0]] - behind_s[reference]
        shifts_s.update({topic: shift_s for name in names for topic in (camera if name in camera else [name])})
    return shifts_s, reference


def _behind_s(head: _Head, other: _Head) -> float:
    """By how much another topic's headers are ahead of this one's that are received at the same time."""
    receipts_s, others_s = head.stamps[:, 1], other.stamps[:, 1]
    inside = (receipts_s >= others_s[0]) & (receipts_s <= others_s[-1])
    if len(other.stamps) < 2 or inside.sum() < min(3, len(head.stamps)) or others_s[-1] <= others_s[0]:
        return head.lag_s - other.lag_s
    # Messages that are received at once, as before a clock starts, count as one with their mean header.
    distinct_s, place = np.unique(others_s, return_inverse=True)
    headers_s = np.bincount(place, other.stamps[:, 0]) / np.bincount(place)
    at_once_s, which = np.unique(receipts_s[inside], return_inverse=True)
    own_s = np.bincount(which, head.stamps[inside, 0]) / np.bincount(which)
    low_s, usual_s, high_s = np.quantile(np.interp(at_once_s, distinct_s, headers_s) - own_s, [0.1, 0.5, 0.9]).tolist()
    if high_s - low_s <= max(0.1 * abs(usual_s), _AGREES_S):
        return float(usual_s)
    # Variation is delay of receipt; the least delay is nearest to the clocks' offset.
    return float(max(low_s, min(high_s, 0.0)))


def clock_findings(topic: str, clock: TopicClock, count: int) -> list[str]:
    """Warnings of a pass about the headers of a topic, given the number of its messages."""
    found: list[str] = []
    if clock.left_out:
        why = "headers fit neither their neighbours nor receipt"
        warning = f"{topic}: {clock.left_out:,} messages were left out: their {why}."
        found.append(LeftOut(warning, clock.left_out, count, f"{topic}: {why}"))
    if clock.unstamped:
        found.append(f"{topic}: {clock.unstamped:,} headers are 0; receipt is used.")
    for after_s, by_s in clock.set_back[:3]:
        found.append(
            f"{topic}: the clock of the recorder was set back by about {by_s:.1f} s after {after_s:.3f} s: its times "
            "of receipt come twice. Headers continue, and are used."
        )
    for after_s, by_s in clock.settings[:3]:
        way = "forward" if by_s > 0 else "back"
        found.append(
            f"{topic}: the clock was set {way} by {abs(by_s):.3f} s after {after_s:.3f} s, as receipt shows; "
            "that is removed."
        )
    if len(clock.settings) > 3:
        found.append(f"{topic}: the clock was set {len(clock.settings):,} times.")
    return found
