"""Messages and events in order of time, of messages that come in order of receipt: a bounded wait, no list of all."""

from __future__ import annotations

import heapq
import math
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.association import associate
from wheelsight.events import Event
from wheelsight.recordings.rosbag.storage import Message

# Images that wait to be put in order, and again frames that wait for readings: 3.5 s of raw 640×480 at 30 Hz. Damaged
# stamps or a topic that stops would make them wait for ever.
_MOST_BYTES = 256 << 20
_MOST_MESSAGES = 100_000
# Images that wait for a partner; they come in order of stamps, so that few do.
_MOST_ALONE, _MOST_ALONE_BYTES = 200, 128 << 20
# After so many largest gaps no image that is to come changes what a pair is made of.
_SETTLED_GAPS = 3
# By the time of receipt, which counts on by this much at most from one message to the next: a topic that has stopped
# for longer holds nothing back.
_LONGEST_WAIT_S, _LONGEST_STEP_S = 10.0, 1.0


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


class MessageQueue:
    """Puts messages of several topics in order of their stamps, whenever they were received.

    A message waits until `wait_s` of receipt have gone by, and each other topic has come as far: only where that takes
    very long, or too much memory, is it given earlier.

    Args:
        counts: how many messages each topic has.
        wait_s: how long a message waits for older ones of its own topic.

    Attributes:
        late: how many messages of each topic came too late to be put in order.
        twice: how many have the stamp of another one of their topic.
    """

    def __init__(self, counts: Mapping[str, int], wait_s: float) -> None:
        self.late: Counter[str] = Counter()
        self.twice: Counter[str] = Counter()
        self._wait_s, self._to_come = wait_s, dict(counts)
        self._newest_s = {topic: -math.inf for topic, count in counts.items() if count}
        self._heap: list[tuple[float, int, float, Message]] = []
        self._waiting: Counter[str] = Counter()
        self._number = self._bytes = 0
        self._elapsed_s, self._receipt_s = 0.0, math.inf
        self._given_s = -math.inf
        self._given: dict[str, float] = {}

    def received(self, message: Message) -> bool:
        """Count a message whose stamp may not be known yet; whether it is the last of its topic."""
        self._elapsed_s += min(max(message.receipt_s - self._receipt_s, 0.0), _LONGEST_STEP_S)
        self._receipt_s = message.receipt_s
        self._to_come[message.topic] -= 1
        return self._to_come[message.topic] == 0

    def add(self, stamp_s: float, message: Message) -> None:
        """Let a message wait whose stamp is known."""
        topic = message.topic
        if topic in self._newest_s:
            self._newest_s[topic] = max(self._newest_s[topic], stamp_s)
        heapq.heappush(self._heap, (stamp_s, self._number, self._elapsed_s, message))
        self._number += 1
        self._bytes += len(message.data)
        self._waiting[topic] += 1

    def close(self, topic: str) -> None:
        """No message of a topic comes any more; it holds nothing back."""
        self._newest_s.pop(topic, None)

    def is_over(self, topic: str) -> bool:
        """Whether all messages of a topic were given."""
        return topic not in self._newest_s and not self._waiting[topic]

    def ready(self) -> Iterator[tuple[float, Message]]:
        """Stamps and messages that nothing older can follow any more."""
        reached_s = min(self._newest_s.values(), default=math.inf)
        while self._heap:
            stamp_s, _, since_s, _ = self._heap[0]
            waited_s = self._elapsed_s - since_s
            is_due = (stamp_s <= reached_s and waited_s >= self._wait_s) or waited_s >= _LONGEST_WAIT_S
            if not (is_due or self._bytes > _MOST_BYTES or len(self._heap) > _MOST_MESSAGES):
                return
            yield from self._next()

    def rest(self) -> Iterator[tuple[float, Message]]:
        """All that still waits, after the last message."""
        while self._heap:
            yield from self._next()

    def _next(self) -> Iterator[tuple[float, Message]]:
        stamp_s, _, _, message = heapq.heappop(self._heap)
        topic = message.topic
        self._bytes -= len(message.data)
        self._waiting[topic] -= 1
        if stamp_s == self._given.get(topic):
            self.twice[topic] += 1
        elif stamp_s < self._given_s:
            self.late[topic] += 1
        else:
            self._given_s = self._given[topic] = stamp_s
            yield stamp_s, message


class EventQueue:
    """Puts events and frames in order of stamps, though some are known later than others; frames are numbered.

    Attributes:
        late: how many items of each kind came too late.
    """

    def __init__(self) -> None:
        self.late: Counter[str] = Counter()
        self._heap: list[tuple[float, int, Event | RawFrame]] = []
        self._last_s: dict[str, float] = {}
        self._number = self._bytes = self._frames = 0

    def add(self, item: Event | RawFrame) -> None:
        """Let an item wait."""
        heapq.heappush(self._heap, (item.stamp_s, self._number, item))
        self._number += 1
        self._bytes += _size_bytes(item)

    def until(self, stamp_s: float) -> Iterator[Event | RawFrame]:
        """The items before a stamp, before which nothing more comes; each kind's stamps grow strictly."""
        while self._heap and (self._heap[0][0] < stamp_s or self._bytes > _MOST_BYTES):
            _, _, item = heapq.heappop(self._heap)
            self._bytes -= _size_bytes(item)
            kind = type(item).__name__
            if item.stamp_s < max(self._last_s.values(), default=-np.inf) or item.stamp_s <= self._last_s.get(
                kind, -np.inf
            ):
                self.late[kind] += 1
                continue
            self._last_s[kind] = item.stamp_s
            if isinstance(item, RawFrame):
                item, self._frames = replace(item, index=self._frames), self._frames + 1
            yield item


def _size_bytes(item: Event | RawFrame) -> int:
    return item.size_bytes if isinstance(item, RawFrame) else 0


_Waiting = tuple[float, Message]


class Pairing:
    """Pairs colour with depth as they come in order of their stamps: of those that wait, as `associate` does of all.

    An image is given up as single only once its partner would have come before, by the stamps of what comes now.

    Attributes:
        max_gap_s: of a pair.
        pairs: how many were made.
        largest_gap_s: of them.
        alone: how many images of each kind, "color" and "depth", found no partner near enough.
        crowded: how many were left out because too many waited.
    """

    def __init__(self, max_gap_s: float) -> None:
        self.pairs, self.largest_gap_s = 0, 0.0
        self.alone: Counter[str] = Counter()
        self.crowded: Counter[str] = Counter()
        self.max_gap_s = max_gap_s
        self._waiting: dict[str, list[_Waiting]] = {"color": [], "depth": []}
        self._came_s = {"color": -math.inf, "depth": -math.inf}
        self._gaps_s: dict[str, deque[float]] = {kind: deque(maxlen=1000) for kind in self._waiting}

    @property
    def oldest_color_s(self) -> float:
        """The stamp of the oldest colour image that waits; infinite where none does."""
        return self._waiting["color"][0][0] if self._waiting["color"] else math.inf

    @property
    def usual_gap_s(self) -> float:
        """How far the nearest partner of a single image is in the median, of the kind where it is nearer."""
        medians_s = [float(np.median(gaps_s)) for gaps_s in self._gaps_s.values() if gaps_s]
        return min(medians_s, default=math.inf)

    def add(self, kind: str, stamp_s: float, message: Message) -> None:
        """Count in an image, "color" or "depth"; of very many that wait, the first is left out."""
        images = self._waiting[kind]
        images.append((stamp_s, message))
        self._came_s[kind] = stamp_s
        while len(images) > _MOST_ALONE or sum(len(other.data) for _, other in images[:-1]) > _MOST_ALONE_BYTES:
            del images[0]
            self.crowded[kind] += 1

    def settled(self, now_s: float) -> Iterator[RawFrame]:
        """Frames that are complete once all that is to come is stamped `now_s` or later, infinite for the end."""
        due_s = now_s - _SETTLED_GAPS * self.max_gap_s
        color, depth = self._waiting["color"], self._waiting["depth"]
        if not any(images and images[0][0] < due_s for images in (color, depth)):
            return
        pairs = associate([stamp_s for stamp_s, _ in color], [stamp_s for stamp_s, _ in depth], self.max_gap_s)
        gone: dict[str, set[int]] = {"color": set(), "depth": set()}
        frames = []
        for i, j in pairs.tolist():
            (color_s, color_message), (depth_s, depth_message) = color[i], depth[j]
            if max(color_s, depth_s) >= due_s:
                continue
            self.pairs += 1
            self.largest_gap_s = max(self.largest_gap_s, abs(depth_s - color_s))
            gone["color"].add(i)
            gone["depth"].add(j)
            frames.append(RawFrame(color_s, color_message, depth_message, depth_s - color_s))
        for kind, paired in zip(("color", "depth"), pairs.T.tolist(), strict=True):
            singles = {i for i, (stamp_s, _) in enumerate(self._waiting[kind]) if stamp_s < due_s} - set(paired)
            self._count_alone(kind, singles)
            gone[kind] |= singles
        for kind, places in gone.items():
            self._waiting[kind] = [image for i, image in enumerate(self._waiting[kind]) if i not in places]
        yield from frames

    def _count_alone(self, kind: str, places: set[int]) -> None:
        other = "depth" if kind == "color" else "color"
        others_s = [self._came_s[other], *(stamp_s for stamp_s, _ in self._waiting[other])]
        self.alone[kind] += len(places)
        for place in places:
            gap_s = min(abs(other_s - self._waiting[kind][place][0]) for other_s in others_s)
            self._gaps_s[kind].append(gap_s)
