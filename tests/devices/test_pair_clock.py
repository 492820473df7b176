"""Stamps of pairs against when they were sent: jitter, stalls, heaps, lost and early pairs, restarts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from wheelsight.io.devices.tick_tracking import PairClock

PERIOD_S = 0.02003
SETTLED = 250  # pairs after which the period is known


@dataclass
class Sent:
    """When pairs were sent and read, and how many came behind each in the same read."""

    sent_s: np.ndarray
    arrival_s: np.ndarray
    following: np.ndarray


def sent(
    rng: np.random.Generator, count: int, jitter_s: float = 0.002, stalls_s: Sequence[tuple[float, float]] = ()
) -> Sent:
    """Pairs a period apart, each held up at random; what arrives within a stall (begin, end) is read at its end."""
    sent_s = 100.0 + PERIOD_S * np.arange(count)
    arrival_s = np.maximum.accumulate(sent_s + rng.exponential(jitter_s, count))
    for begin_s, end_s in stalls_s:
        held = (arrival_s >= 100 + begin_s) & (arrival_s < 100 + end_s)
        arrival_s[held] = 100 + end_s
    following = np.array([np.count_nonzero(arrival_s[i + 1 : i + 600] == a) for i, a in enumerate(arrival_s)])
    return Sent(sent_s, arrival_s, following)


def without(pairs: Sent, lost: Sequence[int]) -> Sent:
    return Sent(*(np.delete(each, lost) for each in (pairs.sent_s, pairs.arrival_s, pairs.following)))


def stamps_of(clock: PairClock, pairs: Sent, early: Sequence[int] = ()) -> np.ndarray:
    reported = zip(pairs.arrival_s, pairs.following, strict=True)
    stamps_s = np.array([clock.stamp_s(a, int(f), i in early) for i, (a, f) in enumerate(reported)])
    assert (np.diff(stamps_s) > 0).all()
    assert (stamps_s <= pairs.arrival_s + 1e-6 * (1 + pairs.following.max())).all()
    return stamps_s


def test_the_period_is_learned_and_jitter_vanishes(rng: np.random.Generator) -> None:
    clock, pairs = PairClock(), sent(rng, 1500)
    errors_s = stamps_of(clock, pairs) - pairs.sent_s
    assert clock.period_s == pytest.approx(PERIOD_S, rel=2e-3)
    assert np.abs(errors_s[SETTLED:]).max() < 5e-4
    assert np.abs(pairs.arrival_s - pairs.sent_s)[SETTLED:].max() > 0.01
    assert clock.lost == 0


def test_pairs_that_arrive_in_heaps_are_spread_over_their_time(rng: np.random.Generator) -> None:
    stalls_s = [(t, t + 0.043) for t in np.arange(0.0, 40.0, 0.05)]  # two or three at a time
    clock, pairs = PairClock(), sent(rng, 1500, stalls_s=stalls_s)
    stamps_s = stamps_of(clock, pairs)
    assert np.diff(stamps_s[SETTLED:]) == pytest.approx(PERIOD_S, abs=2e-3)


@pytest.mark.parametrize("stall_s", [0.2, 0.45, 3.0, 8.0])
def test_a_stall_changes_nothing(rng: np.random.Generator, stall_s: float) -> None:
    clock, pairs = PairClock(), sent(rng, 1500, stalls_s=[(12.0, 12.0 + stall_s)])
    errors_s = stamps_of(clock, pairs) - pairs.sent_s
    assert np.abs(errors_s[SETTLED:]).max() < 1e-3
    assert clock.lost == 0


@pytest.mark.parametrize("count", [1, 2, 7])
def test_lost_pairs_are_noticed_within_a_second(rng: np.random.Generator, count: int) -> None:
    clock, pairs = PairClock(), without(sent(rng, 1500), range(600, 600 + count))
    errors_s = stamps_of(clock, pairs) - pairs.sent_s
    assert clock.lost == count
    assert np.abs(errors_s[660:]).max() < 1e-3
    assert np.abs(errors_s[SETTLED:]).max() < (count + 0.1) * PERIOD_S


def test_a_controller_that_was_silent_is_not_taken_for_a_stall(rng: np.random.Generator) -> None:
    clock, pairs = PairClock(), without(sent(rng, 1500), range(600, 1100))
    errors_s = stamps_of(clock, pairs) - pairs.sent_s
    assert np.abs(errors_s[SETTLED:]).max() < 0.012
    assert clock.lost == pytest.approx(500, abs=1)


def test_pairs_sent_early_are_stamped_with_their_arrival(rng: np.random.Generator) -> None:
    """At full speed the pairs come at no period; after it the count begins again."""
    clock, pairs = PairClock(), sent(rng, 1500)
    fast = slice(600, 800)
    pairs.sent_s[fast] -= 0.006 * np.arange(200)
    pairs.sent_s[800:] -= 1.2
    pairs.arrival_s = pairs.sent_s + np.where(np.arange(1500) % 7, 0.001, 0.0)
    errors_s = stamps_of(clock, pairs, range(600, 800)) - pairs.sent_s
    assert np.abs(errors_s[SETTLED:]).max() < 2e-3
    assert clock.lost == 0


def test_a_replugged_port_begins_again_with_the_period_known(rng: np.random.Generator) -> None:
    clock, before = PairClock(), sent(rng, 600)
    stamps_of(clock, before)
    clock.restart()
    after = sent(rng, 400)
    after.sent_s += 30.0
    after.arrival_s += 30.0
    errors_s = stamps_of(clock, after) - after.sent_s
    assert np.abs(errors_s[50:]).max() < 2e-3
