"""LocalizerInStep: a localizer as navigation asks for it, in the caller's own thread."""

from __future__ import annotations

from collections.abc import Sequence

from wheelsight.estimates import Estimate
from wheelsight.events import Event
from wheelsight.keyframes import KeyframeStore
from wheelsight.localizer.localizer import Localizer


class LocalizerInStep:
    """Answers all that it is told before it goes on: equal events, equal answers. For simulators.

    Args:
        localizer: that answers; closed with this.
    """

    def __init__(self, localizer: Localizer) -> None:
        self.localizer = localizer

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Of the localizer."""
        return self.localizer.keyframes

    def hear(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        """Each event with its answer. Raises what `Localizer.process` raises."""
        return [(event, self.localizer.process(event)) for event in events]

    def close(self) -> None:
        """End the localizer's threads."""
        self.localizer.close()
