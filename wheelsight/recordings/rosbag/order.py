"""Events in order of time, of messages that come in order of receipt: a bounded wait, no list of all."""

from __future__ import annotations

import heapq
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.association import associate
from wheelsight.events import Event
from wheelsight.recordings.rosbag.storage import Message


@dataclass(frozen=True, slots=True)
class RawFrame:
    """Colour and depth that belong together, not decoded."""

    stamp_s: float
    color: Message
    depth: Message
    depth_late_s: float
    index: int = 0


@dataclass(frozen=True, slots=True)
class Arrival:
    """An event or frame, and the time of receipt at which it was known of."""

    receipt_s: float
    item: Event | RawFrame


def in_order(arrivals: Iterable[Arrival], wait_s: float, late: Counter[str]) -> Iterator[Event | RawFrame]:
    """The items by growing stamps, each kind's stamps growing strictly; frames are numbered.

    Args:
        arrivals: in order of receipt.
        wait_s: how long an item waits for older ones.
        late: counts items by kind that came later than that, or twice.
    """
    waiting: list[tuple[float, int, Arrival]] = []
    last_s: dict[str, float] = {}
    frames = 0

    def released(until_s: float) -> Iterator[Event | RawFrame]:
        nonlocal frames
        while waiting and waiting[0][2].receipt_s <= until_s:
            item = heapq.heappop(waiting)[2].item
            kind = type(item).__name__
            if item.stamp_s < max(last_s.values(), default=-np.inf) or item.stamp_s <= last_s.get(kind, -np.inf):
                late[kind] += 1
                continue
            last_s[kind] = item.stamp_s
            if isinstance(item, RawFrame):
                item, frames = replace(item, index=frames), frames + 1
            yield item

    for number, arrival in enumerate(arrivals):
        heapq.heappush(waiting, (arrival.item.stamp_s, number, arrival))
        yield from released(arrival.receipt_s - wait_s)
    yield from released(np.inf)


class Pairing:
    """Pairs colour with depth as they come: of the stamps within `wait_s`, as `associate` does of all.

    Attributes:
        pairs: how many were made.
        largest_gap_s: of them.
    """

    def __init__(self, max_gap_s: float, wait_s: float) -> None:
        self.pairs, self.largest_gap_s = 0, 0.0
        self._max_gap_s, self._wait_s = max_gap_s, wait_s
        self._waiting: dict[str, deque[tuple[float, Message]]] = {"color": deque(), "depth": deque()}

    def add(self, kind: str, stamp_s: float, message: Message) -> Iterator[RawFrame]:
        """Count in an image, "color" or "depth"; frames of which nothing that is still to come can be a part."""
        self._waiting[kind].append((stamp_s, message))
        color, depth = self._waiting.values()
        if color and depth:
            yield from self._settle(min(color[-1][0], depth[-1][0]) - self._max_gap_s)
        for images in (color, depth):
            while images and images[0][1].receipt_s < message.receipt_s - self._wait_s:
                images.popleft()

    def end(self) -> Iterator[RawFrame]:
        """Frames of what is left."""
        yield from self._settle(np.inf)

    def _settle(self, until_s: float) -> Iterator[RawFrame]:
        """Pair what is waiting, and let go of pairs up to a stamp: later ones may find nearer partners."""
        color, depth = (sorted(images, key=lambda image: image[0]) for images in self._waiting.values())
        if not color or not depth or min(color[0][0], depth[0][0]) > until_s:
            return
        color_stamps_s, depth_stamps_s = ([stamp_s for stamp_s, _ in images] for images in (color, depth))
        for i, j in associate(color_stamps_s, depth_stamps_s, self._max_gap_s).tolist():
            (color_s, color_message), (depth_s, depth_message) = color[i], depth[j]
            if max(color_s, depth_s) > until_s:
                break
            self.pairs += 1
            self.largest_gap_s = max(self.largest_gap_s, abs(depth_s - color_s))
            self._waiting["color"].remove(color[i])
            self._waiting["depth"].remove(depth[j])
            yield RawFrame(color_s, color_message, depth_message, depth_s - color_s)
