"""`BagRecording`: a pass over the messages of a bag, which yields events in order of time. Queues of bounded size
reorder messages and pair colour with depth.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import RecordingError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import WHEEL_READINGS, Event, Match, RgbdFrame, SkippedFrame, SpeedVariances, YawRate
from wheelsight.core.stamps import associate
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings.bags.chunks import are_measured
from wheelsight.io.recordings.bags.images import color_of, depth_of
from wheelsight.io.recordings.bags.stamps import TopicClock, clock_findings
from wheelsight.io.recordings.bags.storage import Message, OpenBag, open_bag
from wheelsight.io.recordings.bags.topics import Roles
from wheelsight.io.recordings.bags.wheel_readings import CountsApart, SpeedReader
from wheelsight.io.recordings.clock_checks import MotionClock
from wheelsight.io.recordings.images import corrected_depth, read_ahead
from wheelsight.io.recordings.recording import AssociationReport, LeftOut, ListedFrame, OpenOptions, RecordedTopic

# Messages and events in order of time, of messages that come in order of receipt: a bounded wait, no list of all.


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


# A bag as a recording: a pass over its messages, images decoded only as they are asked for, little in memory.


_FRAMES_READ_AHEAD = 4
_WHEELS = ("wheels", "right wheel")
# A few images are lost by any driver.
_MOST_LOST = 0.02
# At a walk the view has moved on by centimetres: colour and depth that are further apart are no frame.
_LARGEST_SENSIBLE_GAP_S = 0.1
# The turns of camera and wheels are compared over so many seconds, or fewer where they turned so far: a second of work.
_MOST_COMPARED_S, _COMPARED_S, _ENOUGH_TURNED_RAD = 60.0, 20.0, 4.0
_WRONG_SIZE = "choose its CameraInfo by --topic, or give --camera"


@dataclass(frozen=True, slots=True)
class BagPlan:
    """What a pass over a bag needs to know.

    Attributes:
        roles: which topics are what.
        clocks: of each topic that is used.
        speed_reader: makes a new reader of the wheels' topic; None without wheels.
        up: (3,) the direction away from the ground, seen from the gyroscope.
        options: of the user.
    """

    roles: Roles
    clocks: Mapping[str, TopicClock]
    speed_reader: Callable[[], SpeedReader] | None
    up: FloatArray
    options: OpenOptions

    def topics(self, images: bool) -> list[str]:
        """Names of the topics to be read."""
        roles = self.roles
        cameras = [topic.name for topic in (roles.color, roles.depth) if topic is not None and images]
        others = [roles.used.get(role) for role in (*_WHEELS, "gyro")]
        return [*cameras, *(name for name in others if name is not None)]


@dataclass
class _Pass:
    """One pass over a bag's messages, and what it counts.

    Attributes:
        clocks: of each topic, which judge its headers.
        messages: put in order of their stamps.
        pairing: of colour with depth.
        events: put in order of theirs.
        unusable: messages that hold no numbers.
    """

    bag: OpenBag
    plan: BagPlan
    unusable: int = 0

    def __post_init__(self) -> None:
        self.bag.add_transforms(self.plan.roles.transforms)
        self.clocks = {topic: clock.restarted() for topic, clock in self.plan.clocks.items()}
        self.messages = MessageQueue({}, 0.0)
        self.pairing = Pairing(self.plan.options.max_gap_s)
        self.events = EventQueue()
        self.speeds = None if self.plan.speed_reader is None else self.plan.speed_reader()
        self._wheel_topics = [self.plan.roles.used[role] for role in _WHEELS if role in self.plan.roles.used]
        self._wheels_s: float | None = None

    def items(self, images: bool, stop_ns: int | None = None) -> Iterator[Event | RawFrame]:
        """Events, and frames that are not decoded, in order of time."""
        topics = self.plan.topics(images)
        counts = {topic.name: topic.count for topic in self.bag.topics if topic.name in topics}
        self.messages = MessageQueue(counts, self.plan.options.bag.order_s)
        for stamp_s, message in self._in_order(topics, stop_ns):
            event = self._event_of(stamp_s, message)
            self._put(event, self.pairing.settled(stamp_s))
            yield from self.events.until(self._reached_s(stamp_s))
        self._put(self._last_speeds(), self.pairing.settled(math.inf))
        yield from self.events.until(math.inf)

    def _in_order(self, topics: Sequence[str], stop_ns: int | None) -> Iterator[tuple[float, Message]]:
        """Stamps and messages, by growing stamps."""
        for message in self.bag.messages(topics, stop_ns=stop_ns):
            topic, clock = message.topic, self.clocks[message.topic]
            is_last = self.messages.received(message)
            try:
                others_s = (other.newest_s for name, other in self.clocks.items() if name != topic)
                settled = clock.add(self.bag.header(message).stamp_s, message, others_s)
            except RecordingError:  # one damaged message; the rest goes on
                settled, self.unusable = [], self.unusable + 1
            for stamp_s, known in (*settled, *(clock.end() if is_last else ())):
                self.messages.add(stamp_s, known)
            if is_last:
                self.messages.close(topic)
            yield from self.messages.ready()
        for topic in topics:
            for stamp_s, known in self.clocks[topic].end():
                self.messages.add(stamp_s, known)
            self.messages.close(topic)
        yield from self.messages.rest()

    def _put(self, event: Event | None, frames: Iterator[RawFrame]) -> None:
        for item in (*frames, *(() if event is None else (event,))):
            self.events.add(item)

    def _reached_s(self, now_s: float) -> float:
        """Before which nothing more comes: an increment is stamped by the reading before, a frame by its colour."""
        reached_s = min(now_s, self.pairing.oldest_color_s)
        if self._wheels_s is None:
            return reached_s
        if all(self.messages.is_over(topic) for topic in self._wheel_topics):
            self._put(self._last_speeds(), iter(()))
            return reached_s
        return min(reached_s, max(self._wheels_s, now_s - self.plan.options.bag.slowest_wheels_s))

    def _last_speeds(self) -> Event | None:
        """Of the last reading, once."""
        if self.speeds is None or self._wheels_s is None:
            return None
        self._wheels_s = None
        return self.speeds.end()

    def _event_of(self, stamp_s: float, message: Message) -> Event | None:
        """A reading; None where there is none yet, and for an image, which waits to be paired."""
        roles, topic = self.plan.roles, message.topic
        for kind, image in (("color", roles.color), ("depth", roles.depth)):
            if image is not None and topic == image.name:
                self.pairing.add(kind, stamp_s, message)
                return None
        if topic in self._wheel_topics:
            self._wheels_s = stamp_s
        try:
            return self._reading(topic, stamp_s, self.bag.decode(message))
        except RecordingError:
            self.unusable += 1
            return None

    def _reading(self, topic: str, stamp_s: float, decoded: Any) -> Event | None:
        if topic == self.plan.roles.gyro:
            rate = decoded.angular_velocity
            if are_measured((rate.x, rate.y, rate.z)):
                return YawRate(stamp_s, float(np.dot(self.plan.up, (rate.x, rate.y, rate.z))))
            self.unusable += 1
            return None
        if isinstance(self.speeds, CountsApart) and topic != self.plan.roles.used["wheels"]:
            return self.speeds.add_right(stamp_s, decoded)
        return None if self.speeds is None else self.speeds.add(stamp_s, decoded)


class BagRecording:
    """A `Recording` of a bag. Messages are read anew at each pass, and nothing is kept of them.

    How many frames and pairs there are is known once a pass went through to the end; until then counts are those of the
    bag's index, of which each frame takes one colour and one depth image at most.

    Attributes beside the protocol's:
        topics: all of the bag's, and what each is used as.
    """

    format = "rosbag"

    def __init__(
        self,
        path: Path,
        calibration: Calibration,
        plan: BagPlan,
        topics: tuple[RecordedTopic, ...],
        ends: Mapping[str, FloatArray],
        warnings: Sequence[str],
        speed_variances: SpeedVariances | None = None,
        ground_truth: Trajectory | None = None,
    ) -> None:
        self.path, self.calibration, self.topics = path, calibration, topics
        self._ground_truth = ground_truth
        self.speed_variances = speed_variances
        self._plan, self._ends, self._opened = plan, dict(ends), tuple(warnings)
        self._counts = {topic.used_as: topic.count for topic in topics if topic.used_as}
        self._found: AssociationReport | None = None
        self._told: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The file's or folder's."""
        return self.path.resolve().stem if self.path.is_file() else self.path.resolve().name

    @property
    def body(self) -> str:
        """The frame its trajectory describes: "base" where it is known where that is, else "camera"."""
        has_camera = self._plan.roles.color is not None
        return "camera" if has_camera and self.calibration.T_base_camera is None else "base"

    @property
    def ground_truth(self) -> Trajectory | None:
        """Of the topic that was named by `truth=`; else None: no topic is known to be true."""
        return self._ground_truth

    @property
    def matches(self) -> tuple[Match, ...]:
        """None: bags have no message for them."""
        return ()

    @property
    def association(self) -> AssociationReport:
        """How colour and depth were paired; before a pass went through, how many there can be at most."""
        if self._found is not None:
            return self._found
        color, depth = (self._counts.get(role, 0) for role in ("color", "depth"))
        return AssociationReport(color, depth, min(color, depth), self._plan.options.max_gap_s)

    @property
    def frame_count(self) -> int:
        """How many frames `events()` will yield; before a pass went through, how many at most."""
        return self.association.pairs

    @property
    def wheel_count(self) -> int:
        """How many messages there are of the wheels."""
        return self._counts.get("wheels", 0)

    @property
    def wheel_faults(self) -> tuple[str, ...]:
        """See `TellsWheelFaults`."""
        return self._plan.roles.faults

    @property
    def warnings(self) -> tuple[str, ...]:
        """What opening told, and what the last pass that went through told."""
        return (*self._opened, *self._told)

    def end_stamps(self) -> Mapping[str, FloatArray]:
        """See `TellsEnds`."""
        return self._ends

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """Frames (unless without `images`) and readings in order of time, from the start at each call.

        Images are decoded a few frames ahead.
        """
        if not images:
            return (item for item in self._pass(images=False) if not isinstance(item, ListedFrame))
        events = (item.read() if isinstance(item, ListedFrame) else item for item in self._pass())
        return read_ahead(events, _FRAMES_READ_AHEAD)

    def listed(self) -> Iterator[Event | ListedFrame]:
        """Frames that are still to be decoded, and readings, in order of time."""
        held: deque[Event | ListedFrame] = deque()
        for item in self._pass():
            if isinstance(item, ListedFrame):
                yield from _let_go(held, item.stamp_s)
            if held or isinstance(item, ListedFrame):
                held.append(item)
            else:
                yield item
        yield from _let_go(held, math.inf)

    def try_frames(self, bag: OpenBag, stop_ns: int) -> None:
        """Raise the error of the first frame received before `stop_ns`, unless one of them can be read."""
        first: RecordingError | None = None
        passing = _Pass(bag, self._plan)
        for item in passing.items(images=True, stop_ns=stop_ns):
            try:
                if isinstance(item, RawFrame):
                    self._read(bag, item)
                    return
            except RecordingError as error:
                first = first or error
        if first is not None:
            raise first
        gap_s = self._plan.options.max_gap_s
        problem = f"no depth image lies within {gap_s:g} s of a colour image where both begin"
        raise RecordingError(
            f"{problem}: {_why_alone(passing.pairing)}", path=self.path, fix=_pairs_fix(passing.pairing)
        )

    def turns(self, bag: OpenBag) -> MotionClock:
        """What camera, wheels and gyroscope show of the robot's turns at the beginning."""
        turns, passing, begin_s = MotionClock(self.calibration), _Pass(bag, self._plan), math.inf
        for item in passing.items(images=True):
            begin_s = min(begin_s, item.stamp_s)
            if isinstance(item, RawFrame):
                if turns.wants(item.stamp_s):
                    with suppress(RecordingError):  # of a damaged image the pass over all frames tells
                        turns.see(item.stamp_s, color_of(bag.decode(item.color), self.path))
            else:
                turns.add(item)
            compared_s = item.stamp_s - begin_s
            if compared_s > _MOST_COMPARED_S or (compared_s > _COMPARED_S and turns.turned_rad > _ENOUGH_TURNED_RAD):
                break
        return turns

    def _pass(self, images: bool = True) -> Iterator[Event | ListedFrame]:
        """One pass; frames do not know yet which one comes next. What it found is kept once it is through."""
        with open_bag(self.path) as bag:
            passing = _Pass(bag, self._plan)
            for item in passing.items(images):
                if isinstance(item, RawFrame):
                    yield ListedFrame(item.stamp_s, math.inf, partial(self._frame_or_reason, bag, item))
                else:
                    yield item
        self._told = _findings(passing)
        if images and self._plan.roles.color is not None:
            gap_s, pairing = self._plan.options.max_gap_s, passing.pairing
            color, depth = (self._counts.get(role, 0) for role in ("color", "depth"))
            pairs = pairing.pairs - passing.events.late[RawFrame.__name__]
            self._found = AssociationReport(color, depth, pairs, gap_s, pairing.largest_gap_s)

    def _frame_or_reason(self, bag: OpenBag, frame: RawFrame) -> RgbdFrame | SkippedFrame:
        try:
            return self._read(bag, frame)
        except RecordingError as error:
            return SkippedFrame(frame.stamp_s, error.problem, frame.index)

    def _read(self, bag: OpenBag, frame: RawFrame) -> RgbdFrame:
        """A frame decoded. Raises RecordingError naming the bag and what makes it unusable."""
        color = color_of(bag.decode(frame.color), self.path)
        depth_m = depth_of(bag.decode(frame.depth), self._plan.options.depth_factor, self.path)
        depth_m = corrected_depth(color, depth_m, self.calibration, (self.path, self.path), _WRONG_SIZE)
        return RgbdFrame(frame.stamp_s, color, depth_m, frame.index, frame.depth_late_s)


def _let_go(held: deque[Event | ListedFrame], next_stamp_s: float) -> Iterator[Event | ListedFrame]:
    """What waited for the next frame to be known, its first the frame before."""
    while held:
        item = held.popleft()
        yield ListedFrame(item.stamp_s, next_stamp_s, item.read) if isinstance(item, ListedFrame) else item


_KINDS = {
    RawFrame: "frames",
    **dict.fromkeys(WHEEL_READINGS, "wheel readings"),
    YawRate: "gyroscope readings",
}


def _findings(passing: _Pass) -> tuple[str, ...]:
    """What a pass that went through has to say, one sentence each: nothing is left out without being counted."""
    told = _lost_pairs(passing)
    counts = {topic.name: topic.count for topic in passing.bag.topics if topic.name in passing.clocks}
    for topic, clock in passing.clocks.items():
        of = counts.get(topic, 0)
        told += clock_findings(topic, clock, of)
        for count, why in (
            (passing.messages.twice[topic], "came twice, or with the stamp of another"),
            (passing.messages.late[topic], "came too late to be put in order"),
        ):
            if count:
                sentence = f"{topic}: {count:,} messages {why}, and were left out."
                told.append(LeftOut(sentence, count, of, f"{topic}: messages {why}"))
    for kind, words in _KINDS.items():
        if count := passing.events.late[kind.__name__]:
            why = f"{words} were known of too late to be put in order"
            told.append(LeftOut(f"{count:,} {why}, and were left out.", count, sum(counts.values()), why))
    unusable = passing.unusable + (0 if passing.speeds is None else passing.speeds.unusable)
    if unusable:
        why = "messages hold no numbers of wheels or gyroscope"
        told.append(LeftOut(f"{unusable:,} {why} and were left out.", unusable, sum(counts.values()), why))
    return tuple(told)


def _lost_pairs(passing: _Pass) -> list[str]:
    """That more frames than a few were lost, why, and how many, where images of both kinds were read."""
    pairing, roles = passing.pairing, passing.plan.roles
    if roles.color is None or roles.depth is None:
        return []
    images = {"color": roles.color.name, "depth": roles.depth.name}
    came = {kind: pairing.pairs + pairing.alone[kind] + pairing.crowded[kind] for kind in images}
    if not all(came.values()):
        return []
    wrong = sum(passing.clocks[topic].left_out for topic in images.values())
    late = sum(passing.messages.late[topic] for topic in images.values()) + passing.events.late[RawFrame.__name__]
    for kind, topic in images.items():
        came[kind] += passing.clocks[topic].left_out + passing.messages.late[topic]
    fewest = min(came.values())
    lost = fewest - pairing.pairs + passing.events.late[RawFrame.__name__]
    if lost <= _MOST_LOST * fewest:
        return []
    reasons = []
    if any(pairing.alone.values()):
        singles = f"{pairing.alone['color']:,} colour and {pairing.alone['depth']:,} depth images stayed single"
        reasons.append(f"{singles}: {_why_alone(pairing)} ({_pairs_fix(pairing)})")
    others = {
        "had wrong headers": wrong,
        "came too late": late,
        "were in too large a crowd": sum(pairing.crowded.values()),
    }
    reasons += [f"{count:,} images {why}" for why, count in others.items() if count]
    return [f"{lost:,} of {fewest:,} frames were lost: {'; '.join(reasons)}."]


def _why_alone(pairing: Pairing) -> str:
    """Why images found no partner."""
    if not pairing.alone["color"] or not pairing.alone["depth"]:
        return f"no {'depth' if pairing.alone['color'] else 'colour'} image was taken near them"
    if pairing.usual_gap_s <= pairing.max_gap_s:
        return "their partners went to others"
    return f"by their stamps the nearest is {pairing.usual_gap_s:.3f} s away in the median"


def _pairs_fix(pairing: Pairing) -> str:
    if pairing.max_gap_s < pairing.usual_gap_s <= _LARGEST_SENSIBLE_GAP_S:
        return "raise --max-gap, where they show the same"
    return "check what stamps the images, and whether messages were dropped"
