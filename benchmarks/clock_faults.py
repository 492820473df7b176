"""What goes wrong with stamps: readings that come late or together, clocks that leap, hosts that sleep.

Each fault is a function from events to events: stamps change, counts and images never do. Readings keep their
order, as they do on a wire. The events that come out are in order of their new stamps, as a recording lists them,
but where clocks leap. One whose new stamp is not later than that of the reading before is left out, as readers of
recordings do. What is random follows from the fault's seed alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelReading

Sensors = Literal["wheels", "camera", "both"]
_STREAM = 0xC10C


class ClockFault(Protocol):
    """A fault of stamps."""

    def apply(self, events: Iterable[Event]) -> list[Event]:
        """The events as they come with this fault: in order of their new stamps, but where clocks leap."""
        ...


@dataclass(frozen=True, slots=True)
class ReadingsTogether:
    """Readings arrive in groups at the time of the last one, with stamps `apart_s` apart."""

    count: int = 2
    apart_s: float = 1e-4

    def apply(self, events: Iterable[Event]) -> list[Event]:
        """See the class."""
        wheels, others = _parted(events)
        stamps_s = _stamps(wheels)
        place = np.arange(len(stamps_s))
        last = np.minimum(place // self.count * self.count + self.count - 1, len(stamps_s) - 1)
        return _merged(_stamped(wheels, stamps_s[last] + place % self.count * self.apart_s), others)


@dataclass(frozen=True, slots=True)
class ReadingsStalled:
    """A share of the readings arrives `late_s` late, and those behind it catch up, `apart_s` after each other."""

    share: float = 0.05
    late_s: float = 0.06
    apart_s: float = 1e-6
    seed: int = 0

    def apply(self, events: Iterable[Event]) -> list[Event]:
        """See the class."""
        wheels, others = _parted(events)
        stamps_s = _stamps(wheels)
        rng = np.random.default_rng([_STREAM, self.seed])
        arrivals_s = stamps_s + self.late_s * (rng.random(len(stamps_s)) < self.share)
        for i in range(1, len(arrivals_s)):
            arrivals_s[i] = max(arrivals_s[i], arrivals_s[i - 1] + self.apart_s)
        return _merged(_stamped(wheels, arrivals_s), others)


@dataclass(frozen=True, slots=True)
class ReadingsJitter:
    """Each reading's stamp is off by Gaussian noise."""

    sigma_s: float = 0.01
    seed: int = 0

    def apply(self, events: Iterable[Event]) -> list[Event]:
        """See the class."""
        wheels, others = _parted(events)
        noise = np.random.default_rng([_STREAM, self.seed]).standard_normal(len(wheels))
        return _merged(_stamped(wheels, _stamps(wheels) + self.sigma_s * noise), others)


@dataclass(frozen=True, slots=True)
class ClockLeaps:
    """From `at_s` on, stamps are `by_s` more; the events of `missing_s` before are missing, as while a host sleeps.

    The events keep the order in which they come, as on a robot: no reader can list them by such stamps.
    """

    at_s: float
    by_s: float
    sensors: Sensors = "both"
    missing_s: float = 0.0

    def apply(self, events: Iterable[Event]) -> list[Event]:
        """See the class."""
        there = [event for event in events if not self.at_s - self.missing_s <= event.stamp_s < self.at_s]
        return [self._leapt(event) for event in there]

    def _leapt(self, event: Event) -> Event:
        is_of_camera = isinstance(event, RgbdFrame | SkippedFrame)
        leaps = event.stamp_s >= self.at_s and self.sensors in ("both", "camera" if is_of_camera else "wheels")
        return replace(event, stamp_s=event.stamp_s + self.by_s) if leaps else event


@dataclass(frozen=True, slots=True)
class ColorLate:
    """Each depth image comes with an earlier colour image, whose stamp is that of the frame."""

    frames: int = 1

    def apply(self, events: Iterable[Event]) -> list[Event]:
        """See the class."""
        wheels, others = _parted(events)
        frames = [event for event in others if isinstance(event, RgbdFrame)]
        pairs = zip(frames, frames[self.frames :], strict=False)
        late = [replace(now, color=before.color) for before, now in pairs]
        return _merged(wheels, [*(event for event in others if not isinstance(event, RgbdFrame)), *late])


def _parted(events: Iterable[Event]) -> tuple[list[Event], list[Event]]:
    wheels: list[Event] = []
    others: list[Event] = []
    for event in events:
        (wheels if isinstance(event, WheelReading) else others).append(event)
    return wheels, others


def _stamps(events: list[Event]) -> FloatArray:
    return np.array([event.stamp_s for event in events])


def _stamped(events: list[Event], stamps_s: FloatArray) -> list[Event]:
    growing: list[Event] = []
    for event, stamp_s in zip(events, stamps_s.tolist(), strict=True):
        if not growing or stamp_s > growing[-1].stamp_s:
            growing.append(replace(event, stamp_s=stamp_s))
    return growing


def _merged(wheels: list[Event], others: list[Event]) -> list[Event]:
    """In order of stamps; at one stamp, frames last."""
    return sorted([*wheels, *others], key=lambda e: (e.stamp_s, isinstance(e, RgbdFrame | SkippedFrame)))
