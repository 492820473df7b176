"""LocalizerInStep: a localizer as navigation asks for it, in the caller's own thread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Protocol

from wheelsight.estimates import Estimate
from wheelsight.events import Event
from wheelsight.keyframes import KeyframeStore
from wheelsight.threads import OneCaller, ends, one_at_a_time


class Answering(Protocol):
    """What answers events one by one: a `Localizer`, or what writes a map beside it."""

    @property
    def keyframes(self) -> KeyframeStore | None:
        """What the camera remembers; None of wheels alone."""

    @property
    def recognised(self) -> int | None:
        """How often something of a map of before was recognised so far; None where nobody looks for that."""

    def process(self, event: Event) -> Estimate | None:
        """The estimate at an event that is answered, None at any other; raises as `Localizer.process`."""

    def close(self) -> None:
        """End the threads that work for it."""


Make = Callable[..., AbstractContextManager[Answering]]
"""Makes what answers, in a `with` block that closes it."""


class LocalizerInStep(OneCaller):
    """Answers all events that it is given before it returns: equal events, equal answers. For simulators.

    Args:
        localizer: that answers; closed with this.
    """

    def __init__(self, localizer: Answering) -> None:
        self.localizer = localizer

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Of the localizer."""
        return self.localizer.keyframes

    @property
    def recognised(self) -> int | None:
        """Of the localizer."""
        return self.localizer.recognised

    @one_at_a_time
    def hear(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        """Each event with its answer. Raises what `Localizer.process` raises."""
        return [(event, self.localizer.process(event)) for event in events]

    @ends
    def close(self) -> None:
        """End the localizer's threads; may be called twice."""
        self.localizer.close()
