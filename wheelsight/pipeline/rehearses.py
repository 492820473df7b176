"""What is answered for nothing but that kernels are compiled, or loaded, before time begins to run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Protocol, runtime_checkable

from wheelsight.errors import WheelsightError
from wheelsight.events import Event
from wheelsight.localizer import Localizer
from wheelsight.pipeline.realtime_record import RealTimeRecord
from wheelsight.sources import EventSource


class Rehearses(EventSource, Protocol):
    """A source with events to rehearse by; a run's own localizers must not hear them."""

    def rehearsal(self) -> Iterable[Event]:
        """The events, at once."""


@runtime_checkable
class InRealTime(EventSource, Protocol):
    """A source whose events come when their time comes: frames that come too fast for a run are dropped."""

    def rehearsals(self) -> Sequence[Rehearses]:
        """What is rehearsed before its first event, in this order."""

    def report(self) -> RealTimeRecord:
        """How it went so far."""

    def lately(self) -> tuple[float, float] | None:
        """Frames answered a second, and their median latency in seconds, over the last of them; None before two."""

    @property
    def frames_so_far(self) -> tuple[int, int]:
        """Frames that came by, and how many of them were dropped."""

    @property
    def is_missing_wheels(self) -> bool:
        """Whether wheels that are listened to have fallen silent."""


def rehearse(source: Rehearses, localizers: Sequence[Localizer]) -> None:
    """Answer the events of a rehearsal, and forget the answers."""
    events: Iterator[Event] = iter(source.rehearsal())
    with suppress(WheelsightError):  # what is wrong with a source is told at its place
        for event in events:
            for localizer in localizers:
                localizer.process(event)
    for localizer in localizers:
        localizer.close()
