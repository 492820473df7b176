"""History: any order of events within the window ends in the states of the events in order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from wheelsight.estimation.filter import History


@dataclass(frozen=True)
class Note:
    stamp_s: float
    since_s: float
    rank: int = 0


def heard(state, note, notes):
    """What was known when: each note, with how many others reach into the time before it."""
    return (*state, (note.stamp_s, note.rank, sum(other.since_s < note.stamp_s <= other.stamp_s for other in notes)))


@given(st.permutations(range(12)))
def test_any_order_ends_alike(order):
    notes = [Note(0.1 * i, 0.1 * i - (0.15 if i % 3 == 0 else 0.0), i % 2) for i in range(12)]
    in_order, shuffled = (History((), 10.0, heard) for _ in range(2))
    for note in notes:
        in_order.take(note)
    for i in order:
        shuffled.take(notes[i])
    assert in_order.newest == shuffled.newest


def test_events_at_one_stamp_are_taken_by_rank():
    history: History[Note, Any] = History((), 1.0, heard)
    for rank in (2, 0, 1):
        history.take(Note(0.0, 0.0, rank))
    assert [rank for _, rank, _ in history.newest] == [0, 1, 2]


def test_what_is_older_than_the_window_is_forgotten_and_refused():
    history: History[Note, int] = History(0, 0.5, lambda state, note, notes: state + 1)
    for i in range(100):
        history.take(Note(0.1 * i, 0.1 * i))
    assert len(history) <= 6
    assert history.newest == 100
    assert history.take(Note(9.3, 9.3)) is None
    assert history.take(Note(9.9, 9.3)) is None
    assert history.take(Note(9.5, 9.5)) is not None


@given(st.integers(20, 60), st.floats(0.0, 6.0))
def test_repeating_the_past_equals_having_known_it(count, since_s):
    """A change of all events since a stamp ends in the states of the changed events, also of those yet to come."""

    def added(state, note, notes):
        return (*state, note.stamp_s * note.rank)

    def doubled(note):
        return Note(note.stamp_s, note.since_s, 2) if note.stamp_s > since_s else note

    known, corrected = (History((), 0.5, added) for _ in range(2))
    notes = [Note(0.1 * i, 0.1 * i, 1) for i in range(count)]
    for note in notes[:-5]:
        corrected.take(note)
    assert corrected.repeat(since_s, doubled)
    for note in notes[-5:]:
        corrected.take(doubled(note))
    for note in notes:
        known.take(doubled(note))
    assert corrected.newest == known.newest


def test_a_past_that_is_no_longer_kept_is_not_repeated():
    history: History[Note, int] = History(0, 0.5, lambda state, note, notes: state + 1)
    for i in range(1000):
        history.take(Note(0.1 * i, 0.1 * i))
    assert not history.repeat(50.0, lambda note: note)
    assert history.repeat(85.0, lambda note: note)
    assert history.newest == 1000
