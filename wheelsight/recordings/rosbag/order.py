"""Events in order of time, of messages that come in order of receipt: a bounded wait, no list of all."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.association import associate
from wheelsight.events import Event
from wheelsight.recordings.rosbag.storage import Message

# Frames that wait: 5 s of raw 640×480 have 230 MB. Damaged times of receipt would make them wait for ever.
_MOST_BYTES = 384 << 20
# Images that wait for a partner: a quarter of a second of them.
_MOST_ALONE, _MOST_ALONE_BYTES = 200, 128 << 20


@dataclass(frozen=True, slots=True)
class RawFrame:
    """Colour and depth that belong together, not decoded."""

    stamp_s: float
    color: Message
    depth: Message
    depth_late_s: float
    index: int = 0

    @property
    def size_bytes(self) -> int:
        """Of both messages."""
        return len(self.color.data) + len(self.depth.data)


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
    frames = waiting_bytes = 0

    def released(until_s: float) -> Iterator[Event | RawFrame]:
        nonlocal frames, waiting_bytes
        while waiting and (waiting[0][2].receipt_s <= until_s or waiting_bytes > _MOST_BYTES):
            item = heapq.heappop(waiting)[2].item
            waiting_bytes -= _size_bytes(item)
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
        waiting_bytes += _size_bytes(arrival.item)
        yield from released(arrival.receipt_s - wait_s)
    yield from released(np.inf)


def _size_bytes(item: Event | RawFrame) -> int:
    return item.size_bytes if isinstance(item, RawFrame) else 0


class Pairing:
    """Pairs colour with depth as they come: of those that wait, as `associate` does of all.

    A pair is let go of once nothing nearer can come: younger images of both kinds are there, or `wait_s` has gone by.

    Attributes:
        pairs: how many were made.
        largest_gap_s: of them.
    """

    def __init__(self, max_gap_s: float, wait_s: float) -> None:
        self.pairs, self.largest_gap_s = 0, 0.0
        self._max_gap_s, self._wait_s = max_gap_s, wait_s
        self._color: list[_Waiting] = []
        self._depth: list[_Waiting] = []

    def add(self, kind: str, stamp_s: float, message: Message) -> None:
        """Count in an image, "color" or "depth"; of very many that wait, the first is left out."""
        images = self._color if kind == "color" else self._depth
        images.append((stamp_s, message))
        while len(images) > _MOST_ALONE or sum(len(other.data) for _, other in images[:-1]) > _MOST_ALONE_BYTES:
            del images[0]

    def settled(self, now_s: float) -> Iterator[RawFrame]:
        """Frames that are complete at a time of receipt, infinite for the end; what stayed alone is let go of."""
        due_s = now_s - self._wait_s
        if self._color and self._depth:
            until_s = min(max(stamp_s for stamp_s, _ in images) for images in (self._color, self._depth))
            yield from self._pairs(until_s - self._max_gap_s, due_s)
        for images in (self._color, self._depth):
            images[:] = [image for image in images if image[1].receipt_s >= due_s]

    def _pairs(self, until_s: float, due_s: float) -> Iterator[RawFrame]:
        color, depth = (sorted(images, key=lambda image: image[0]) for images in (self._color, self._depth))
        color_stamps_s, depth_stamps_s = ([stamp_s for stamp_s, _ in images] for images in (color, depth))
        for i, j in associate(color_stamps_s, depth_stamps_s, self._max_gap_s).tolist():
            (color_s, color_message), (depth_s, depth_message) = color[i], depth[j]
            received_s = max(color_message.receipt_s, depth_message.receipt_s)
            if max(color_s, depth_s) > until_s and received_s > due_s:
                continue
            self.pairs += 1
            self.largest_gap_s = max(self.largest_gap_s, abs(depth_s - color_s))
            self._color = [image for image in self._color if image[1] is not color_message]
            self._depth = [image for image in self._depth if image[1] is not depth_message]
            yield RawFrame(color_s, color_message, depth_message, depth_s - color_s)


_Waiting = tuple[float, Message]
