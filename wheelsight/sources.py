"""EventSource: what a run needs of where events come from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

from wheelsight.calibration import Calibration
from wheelsight.events import Event


@runtime_checkable
class EventSource(Protocol):
    """Events in order of time, and the calibration of the sensors that they are from.

    A live one has no end, and nobody knows how many frames it will give. A recording (`recordings.Recording`) is one
    that knows both, and more.
    """

    @property
    def name(self) -> str:
        """For titles and file names."""

    @property
    def calibration(self) -> Calibration:
        """Of the sensors."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know before trusting results, one sentence each; more may come with the events."""

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """The events in order of time. Without `images` frames are left out, and none is decoded.

        `run` asks for `images=False` where it follows wheels alone: an implementation takes the argument by this name.
        docs/api/own-parts.md has an example.
        """
