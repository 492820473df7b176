"""History: events in the order of their stamps, whatever order they came in, and the state after each."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar


class Dated(Protocol):
    """Something that happened: at `stamp_s`, changing states from `since_s` on; at one stamp, lower `rank` first."""

    @property
    def stamp_s(self) -> float:
        """When it is taken."""

    @property
    def since_s(self) -> float:
        """From when on it matters."""

    @property
    def rank(self) -> int:
        """Its place among events at the same stamp."""


Event = TypeVar("Event", bound=Dated)
State = TypeVar("State")
_LAST_RANK = 1 << 30


class History(Generic[Event, State]):
    """States that do not change, one an event, within a window; after an event that comes late others are taken again.

    Args:
        begin: the state before all events.
        window_s: how far behind the newest event one may begin to matter.
        apply: the state after an event, of the state before it and all events that are known.
    """

    def __init__(self, begin: State, window_s: float, apply: Callable[[State, Event, Sequence[Event]], State]) -> None:
        self._begin, self._window_s, self._apply = begin, window_s, apply
        self._events: list[Event] = []
        self._keys: list[tuple[float, int]] = []
        self._states: list[State] = []

    def __len__(self) -> int:
        return len(self._events)

    @property
    def newest(self) -> State:
        """The state after the last event."""
        return self._states[-1] if self._states else self._begin

    def known_at(self, stamp_s: float) -> State:
        """The state after the last event up to a stamp; of one before the window, the oldest."""
        place = bisect_right(self._keys, (stamp_s, _LAST_RANK))
        return self._states[place - 1] if place else self._begin

    @property
    def newest_s(self) -> float | None:
        """The stamp of the last event."""
        return self._keys[-1][0] if self._keys else None

    @property
    def events(self) -> Sequence[Event]:
        """All that are known, in order."""
        return self._events

    def is_too_late(self, event: Event) -> bool:
        """Whether the event would matter from before the window on."""
        return bool(self._keys) and event.since_s < self._keys[-1][0] - self._window_s

    def take(self, event: Event) -> State:
        """The state right after an event that is not too late; all that follow it are taken again."""
        key = (event.stamp_s, event.rank)
        place = bisect_right(self._keys, key)
        first = min(place, bisect_right(self._keys, (event.since_s, _LAST_RANK)))
        self._keys.insert(place, key)
        self._events.insert(place, event)
        del self._states[first:]
        for again in self._events[first:]:
            self._states.append(self._apply(self.newest, again, self._events))
        state = self._states[place]
        self._forget()
        return state

    def _forget(self) -> None:
        passed = bisect_left(self._keys, (self._keys[-1][0] - self._window_s, -1))
        if passed:
            self._begin = self._states[passed - 1]
            del self._keys[:passed], self._events[:passed], self._states[:passed]
