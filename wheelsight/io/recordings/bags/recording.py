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

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import RecordingError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import WHEEL_READINGS, Event, Match, RgbdFrame, SpeedVariances, YawRate
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
from wheelsight.io.recordings.recording import (
    AssociationReport,
    LeftOut,
    ListedFrame,
    OpenOptions,
    RecordedTopic,
    frame_or_reason,
)

_FRAMES_READ_AHEAD = 4
_WHEELS = ("wheels", "right wheel")
# The share of frames that may be lost without a warning: any driver loses a few.
_MOST_LOST = 0.02
# At walking pace the view moves by centimetres in this time; colour and depth further apart do not form a frame.
_LARGEST_SENSIBLE_GAP_S = 0.1
# How long a message waits for older ones of its own topic, by receipt. Later ones are left out and counted.
_ORDER_S = 0.5
# How long frames wait for the next wheel reading at most, by stamps: an increment is known only with it.
_SLOWEST_WHEELS_S = 5.0
# How long a message that comes now waits for other topics: a driving robot does not wait for a silent sensor.
_LIVE_S = 0.2
Come = Callable[[Sequence[str]], Iterator[Message]]
_WRONG_SIZE = "choose its CameraInfo by --topic, or give --camera"


@dataclass(frozen=True, slots=True)
class BagPlan:
    """How to read a bag.

    Attributes:
        roles: the topic of each sensor.
        clocks: of each topic that is used.
        speed_reader: makes a new reader of the wheels' topic; None without wheels.
        up: (3,) the upward direction in the gyroscope's frame.
    """

    roles: Roles
    clocks: Mapping[str, TopicClock]
    speed_reader: Callable[[], SpeedReader] | None
    up: FloatArray
    options: OpenOptions

    def topics(self, images: bool) -> list[str]:
        """Names of the topics to read."""
        roles = self.roles
        cameras = [topic.name for topic in (roles.color, roles.depth) if topic is not None and images]
        others = [roles.used.get(role) for role in (*_WHEELS, "gyro")]
        return [*cameras, *(name for name in others if name is not None)]


class BagRecording:
    """A `Recording` of a bag. Each pass reads the messages from the file; none are kept in memory.

    The numbers of frames and pairs are exact after a complete pass. Before it they are upper bounds from the bag's
    index, since a frame takes one colour and one depth image.

    Attributes in addition to the protocol's:
        topics: all topics of the bag, with their use.
        stamped: the same without offsets of clocks that turns show, if any was removed; see `as_stamped`.
    """

    format = "rosbag"
    matches: tuple[Match, ...] = ()  # bags have no message type for them

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
        self.ground_truth, self.speed_variances = ground_truth, speed_variances
        self.wheel_faults = plan.roles.faults
        self.stamped: BagRecording | None = None
        self._plan, self._ends = plan, dict(ends)
        self._counts = {topic.used_as: topic.count for topic in topics if topic.used_as}
        self._found: AssociationReport | None = None
        self._open_warnings, self._pass_warnings = tuple(warnings), tuple[str, ...]()

    @property
    def name(self) -> str:
        """The name of the file without its suffix, or of the folder."""
        return self.path.resolve().stem if self.path.is_file() else self.path.resolve().name

    @property
    def body(self) -> str:
        """The frame its trajectory describes: "base" where the calibration has T_base_camera, else "camera"."""
        has_camera = self._plan.roles.color is not None
        return "camera" if has_camera and self.calibration.T_base_camera is None else "base"

    @property
    def association(self) -> AssociationReport:
        """How colour and depth were paired; before a complete pass, upper bounds."""
        if self._found is not None:
            return self._found
        color, depth = (self._counts.get(role, 0) for role in ("color", "depth"))
        return AssociationReport(color, depth, min(color, depth), self._plan.options.max_gap_s)

    @property
    def frame_count(self) -> int:
        """The number of frames that `events()` yields; before a complete pass, an upper bound."""
        return self.association.pairs

    @property
    def wheel_count(self) -> int:
        """The number of messages of the wheels."""
        return self._counts.get("wheels", 0)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of opening and of the last complete pass."""
        return (*self._open_warnings, *self._pass_warnings)

    def as_stamped(self) -> BagRecording:
        """See `HasClocksOfItsOwn`."""
        return self.stamped or self

    def end_stamps(self) -> Mapping[str, FloatArray]:
        """See `HasEndStamps`."""
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
        """Undecoded frames and readings, in order of time."""
        held: deque[Event | ListedFrame] = deque()
        for item in self._pass():
            if isinstance(item, ListedFrame):
                yield from _release(held, item.stamp_s)
            if held or isinstance(item, ListedFrame):
                held.append(item)
            else:
                yield item
        yield from _release(held, math.inf)

    def try_frames(self, bag: OpenBag, stop_ns: int) -> None:
        """Decode frames received before `stop_ns` until one is valid; if none is, raise the first one's error."""
        first: RecordingError | None = None
        passing = _Pass(bag, self._plan)
        for item in passing.items(images=True, stop_ns=stop_ns):
            try:
                if isinstance(item, ImagePair):
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
        """The robot's turns at the beginning, as camera, wheels and gyroscope measure them."""
        turns, passing, begin_s = MotionClock(self.calibration), _Pass(bag, self._plan), math.inf
        for item in passing.items(images=True):
            begin_s = min(begin_s, item.stamp_s)
            if isinstance(item, ImagePair):
                if turns.needs_image(item.stamp_s):
                    with suppress(RecordingError):  # the pass over all frames reports damaged images
                        turns.add_image(item.stamp_s, color_of(bag.decode(item.color), self.path))
            else:
                turns.add(item)
            if turns.is_enough(item.stamp_s - begin_s):
                break
        return turns

    def live(self, bag: OpenBag, come: Come, *, images: bool) -> Iterator[Event]:
        """Events of messages that come now, by the topics, clocks and calibration of this recording.

        Args:
            bag: this recording's, open; it decodes the messages.
            come: yields messages of some topics as they are received.
            images: frames alone, or else readings alone: neither waits for the other's stamps.
        """
        roles, plan = self._plan.roles, self._plan
        if images:
            plan = replace(plan, roles=replace(roles, wheels=None, source=None, gyro=None), speed_reader=None)
        for item in _Pass(bag, plan, come).items(images):
            if isinstance(item, ImagePair):
                yield frame_or_reason(partial(self._read, bag, item), item.stamp_s, item.index)
            else:
                yield item

    def _pass(self, images: bool = True) -> Iterator[Event | ListedFrame]:
        """Readings and undecoded frames in order of time; frames lack the stamp of the next one.

        A complete pass updates counts and warnings.
        """
        with open_bag(self.path) as bag:
            passing = _Pass(bag, self._plan)
            for item in passing.items(images):
                if isinstance(item, ImagePair):
                    yield ListedFrame(
                        item.stamp_s,
                        math.inf,
                        partial(frame_or_reason, partial(self._read, bag, item), item.stamp_s, item.index),
                    )
                else:
                    yield item
        self._pass_warnings = _warnings_of(passing)
        if images and self._plan.roles.color is not None:
            gap_s, pairing = self._plan.options.max_gap_s, passing.pairing
            color, depth = (self._counts.get(role, 0) for role in ("color", "depth"))
            pairs = pairing.pairs - passing.events.late[ImagePair.__name__]
            self._found = AssociationReport(color, depth, pairs, gap_s, pairing.largest_gap_s)

    def _read(self, bag: OpenBag, frame: ImagePair) -> RgbdFrame:
        """The decoded frame. Raises RecordingError naming the bag and what makes it unusable."""
        color = color_of(bag.decode(frame.color), self.path)
        depth_m = depth_of(bag.decode(frame.depth), self._plan.options.depth_factor, self.path)
        depth_m = corrected_depth(color, depth_m, self.calibration, (self.path, self.path), _WRONG_SIZE)
        return RgbdFrame(frame.stamp_s, color, depth_m, frame.index, frame.depth_late_s)


def _release(held: deque[Event | ListedFrame], next_stamp_s: float) -> Iterator[Event | ListedFrame]:
    """The held items; the frame among them gets the stamp of the next frame."""
    while held:
        item = held.popleft()
        yield ListedFrame(item.stamp_s, next_stamp_s, item.read) if isinstance(item, ListedFrame) else item


@dataclass
class _Pass:
    """One pass over a bag's messages, with its counts.

    Attributes:
        come: yields messages as they are received; None for those of the bag.
        clocks: of each topic, to validate header stamps.
        messages: sorts messages by stamp.
        pairing: of colour with depth.
        events: sorts events and frames by stamp.
        unusable: the number of messages that cannot be decoded or have no finite numbers.
    """

    bag: OpenBag
    plan: BagPlan
    come: Come | None = None
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

    def items(self, images: bool, stop_ns: int | None = None) -> Iterator[Event | ImagePair]:
        """Events and undecoded frames, in order of time."""
        topics = self.plan.topics(images)
        counts: dict[str, float] = {topic.name: topic.count for topic in self.bag.topics if topic.name in topics}
        self.messages = MessageQueue(counts, _ORDER_S)
        if self.come is not None:  # no topic ends, and each comes in order
            self.messages = MessageQueue(dict.fromkeys(counts, math.inf), 0.0, _LIVE_S)
        for stamp_s, message in self._in_order(topics, stop_ns):
            event = self._event_of(stamp_s, message)
            self._enqueue(event, self.pairing.settled(stamp_s))
            # All events before this stamp are known. An increment has the stamp of the reading before it, a frame that
            # of its colour image.
            complete_s = min(stamp_s, self.pairing.oldest_color_s)
            if self._wheels_s is not None and all(self.messages.is_over(topic) for topic in self._wheel_topics):
                self._enqueue(self._last_speeds(), iter(()))
            elif self._wheels_s is not None:
                complete_s = min(complete_s, max(self._wheels_s, stamp_s - _SLOWEST_WHEELS_S))
            yield from self.events.until(complete_s)
        self._enqueue(self._last_speeds(), self.pairing.settled(math.inf))
        yield from self.events.until(math.inf)

    def _in_order(self, topics: Sequence[str], stop_ns: int | None) -> Iterator[tuple[float, Message]]:
        """Stamps and messages, in order of stamps."""
        come = self.bag.messages(topics, stop_ns=stop_ns) if self.come is None else self.come(topics)
        for message in come:
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

    def _event_of(self, stamp_s: float, message: Message) -> Event | None:
        """The reading that a message completes, or None. An image goes to the pairing."""
        roles, topic = self.plan.roles, message.topic
        for kind, image in (("color", roles.color), ("depth", roles.depth)):
            if image is not None and topic == image.name:
                self.pairing.add(kind, stamp_s, message)
                return None
        if topic in self._wheel_topics:
            self._wheels_s = stamp_s
        try:
            decoded = self.bag.decode(message)
            if topic == roles.gyro:
                rate = decoded.angular_velocity
                if are_measured((rate.x, rate.y, rate.z)):
                    return YawRate(stamp_s, float(np.dot(self.plan.up, (rate.x, rate.y, rate.z))))
                self.unusable += 1
                return None
            if isinstance(self.speeds, CountsApart) and topic != roles.used["wheels"]:
                return self.speeds.add_right(stamp_s, decoded)
            return None if self.speeds is None else self.speeds.add(stamp_s, decoded)
        except RecordingError:
            self.unusable += 1
            return None

    def _enqueue(self, event: Event | None, frames: Iterator[ImagePair]) -> None:
        for item in (*frames, *(() if event is None else (event,))):
            self.events.add(item)

    def _last_speeds(self) -> Event | None:
        """The event of the last wheel reading, at the first call after it; else None."""
        if self.speeds is None or self._wheels_s is None:
            return None
        self._wheels_s = None
        return self.speeds.end()


def _warnings_of(passing: _Pass) -> tuple[str, ...]:
    """One sentence for each reason why a complete pass left messages out, with their number."""
    warnings = _lost_pairs(passing)
    counts = {topic.name: topic.count for topic in passing.bag.topics if topic.name in passing.clocks}
    for topic, clock in passing.clocks.items():
        of = counts.get(topic, 0)
        warnings += clock_findings(topic, clock, of)
        for count, why in (
            (passing.messages.twice[topic], "came twice, or with the stamp of another"),
            (passing.messages.late[topic], "came too late to be put in order"),
        ):
            if count:
                sentence = f"{topic}: {count:,} messages {why}, and were left out."
                warnings.append(LeftOut(sentence, count, of, f"{topic}: messages {why}"))
    kinds = {ImagePair: "frames", **dict.fromkeys(WHEEL_READINGS, "wheel readings"), YawRate: "gyroscope readings"}
    for kind, words in kinds.items():
        if count := passing.events.late[kind.__name__]:
            why = f"{words} were known of too late to be put in order"
            warnings.append(LeftOut(f"{count:,} {why}, and were left out.", count, sum(counts.values()), why))
    unusable = passing.unusable + (0 if passing.speeds is None else passing.speeds.unusable)
    if unusable:
        why = "messages hold no numbers of wheels or gyroscope"
        warnings.append(LeftOut(f"{unusable:,} {why} and were left out.", unusable, sum(counts.values()), why))
    return tuple(warnings)


def _lost_pairs(passing: _Pass) -> list[str]:
    """A warning with count and reasons where more than a few frames were lost; empty without colour and depth."""
    pairing, roles = passing.pairing, passing.plan.roles
    if roles.color is None or roles.depth is None:
        return []
    images = {"color": roles.color.name, "depth": roles.depth.name}
    came = {kind: pairing.pairs + pairing.alone[kind] + pairing.crowded[kind] for kind in images}
    if not all(came.values()):
        return []
    wrong = sum(passing.clocks[topic].left_out for topic in images.values())
    late = sum(passing.messages.late[topic] for topic in images.values()) + passing.events.late[ImagePair.__name__]
    for kind, topic in images.items():
        came[kind] += passing.clocks[topic].left_out + passing.messages.late[topic]
    fewest = min(came.values())
    lost = fewest - pairing.pairs + passing.events.late[ImagePair.__name__]
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


# Queues of bounded size. Messages come in order of receipt and leave in order of stamps.

# Memory for images that wait to be sorted, and likewise for frames that wait for readings: 3.5 s of raw 640×480 at
# 30 Hz. Without a bound, damaged stamps or a topic that stops would block the queue.
_MOST_BYTES = 256 << 20
_MOST_MESSAGES = 100_000
# Bounds on images that wait for a partner. They come in order of stamps, so few do.
_MOST_ALONE, _MOST_ALONE_BYTES = 200, 128 << 20
# After this multiple of the largest gap, later images cannot change a pair.
_SETTLED_GAPS = 3
# Longest wait of a message, by receipt time. One message advances this time by at most one step, so that a pause of the
# recorder releases nothing.
_LONGEST_WAIT_S, _LONGEST_STEP_S = 10.0, 1.0


@dataclass(frozen=True, slots=True)
class ImagePair:
    """A pair of colour and depth, not decoded."""

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
    """Sorts messages of several topics by stamp.

    A message waits until `wait_s` of receipt time have passed and each other topic has reached its stamp. It leaves
    earlier where that takes very long or too much memory.

    Args:
        counts: the number of messages of each topic.
        wait_s: how long a message waits for older ones of its own topic.
        longest_s: how long it waits for other topics, by receipt.

    Attributes:
        late: the number of messages of each topic that came too late to be sorted.
        twice: the number that repeat a stamp of their topic.
    """

    def __init__(self, counts: Mapping[str, float], wait_s: float, longest_s: float = _LONGEST_WAIT_S) -> None:
        self._longest_s = longest_s
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
        """Count a message whose stamp may not be known yet. Returns whether it is the last of its topic."""
        self._elapsed_s += min(max(message.receipt_s - self._receipt_s, 0.0), _LONGEST_STEP_S)
        self._receipt_s = message.receipt_s
        self._to_come[message.topic] -= 1
        return self._to_come[message.topic] == 0

    def add(self, stamp_s: float, message: Message) -> None:
        """Add a message whose stamp is known."""
        topic = message.topic
        if topic in self._newest_s:
            self._newest_s[topic] = max(self._newest_s[topic], stamp_s)
        heapq.heappush(self._heap, (stamp_s, self._number, self._elapsed_s, message))
        self._number += 1
        self._bytes += len(message.data)
        self._waiting[topic] += 1

    def close(self, topic: str) -> None:
        """Stop waiting for a topic that has no further messages."""
        self._newest_s.pop(topic, None)

    def is_over(self, topic: str) -> bool:
        """Whether all messages of a topic have left."""
        return topic not in self._newest_s and not self._waiting[topic]

    def ready(self) -> Iterator[tuple[float, Message]]:
        """Stamps and messages that no older message can precede any more."""
        reached_s = min(self._newest_s.values(), default=math.inf)
        while self._heap:
            stamp_s, _, since_s, _ = self._heap[0]
            waited_s = self._elapsed_s - since_s
            is_due = (stamp_s <= reached_s and waited_s >= self._wait_s) or waited_s >= self._longest_s
            if not (is_due or self._bytes > _MOST_BYTES or len(self._heap) > _MOST_MESSAGES):
                return
            yield from self._pop()

    def rest(self) -> Iterator[tuple[float, Message]]:
        """All waiting messages, after the last one came."""
        while self._heap:
            yield from self._pop()

    def _pop(self) -> Iterator[tuple[float, Message]]:
        """The oldest message, unless it repeats a stamp or is late."""
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
    """Sorts events and frames by stamp and numbers the frames.

    Attributes:
        late: the number of items of each kind that came too late.
    """

    def __init__(self) -> None:
        self.late: Counter[str] = Counter()
        self._heap: list[tuple[float, int, Event | ImagePair]] = []
        self._last_s: dict[str, float] = {}
        self._number = self._bytes = self._frames = 0

    def add(self, item: Event | ImagePair) -> None:
        """Add an item."""
        heapq.heappush(self._heap, (item.stamp_s, self._number, item))
        self._number += 1
        self._bytes += _size_bytes(item)

    def until(self, stamp_s: float) -> Iterator[Event | ImagePair]:
        """The items before a stamp; the stamps of each kind increase strictly. All items before it must be added."""
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
            if isinstance(item, ImagePair):
                item, self._frames = replace(item, index=self._frames), self._frames + 1
            yield item


def _size_bytes(item: Event | ImagePair) -> int:
    return item.size_bytes if isinstance(item, ImagePair) else 0


class Pairing:
    """Pairs colour with depth as they come in order of stamps, by the rule of `associate`.

    An image counts as single once later images are stamped too late to be its partner.

    Attributes:
        alone: the number of images of each kind, "color" and "depth", without a partner near enough.
        crowded: the number that were dropped because too many waited.
    """

    def __init__(self, max_gap_s: float) -> None:
        self.pairs, self.largest_gap_s = 0, 0.0
        self.alone: Counter[str] = Counter()
        self.crowded: Counter[str] = Counter()
        self.max_gap_s = max_gap_s
        self._waiting: dict[str, list[tuple[float, Message]]] = {"color": [], "depth": []}
        self._came_s = {"color": -math.inf, "depth": -math.inf}
        self._gaps_s: dict[str, deque[float]] = {kind: deque(maxlen=1000) for kind in self._waiting}

    @property
    def oldest_color_s(self) -> float:
        """The stamp of the oldest waiting colour image; infinite where none waits."""
        return self._waiting["color"][0][0] if self._waiting["color"] else math.inf

    @property
    def usual_gap_s(self) -> float:
        """The median gap between a single image and the nearest of the other kind; the smaller one of both kinds."""
        medians_s = [float(np.median(gaps_s)) for gaps_s in self._gaps_s.values() if gaps_s]
        return min(medians_s, default=math.inf)

    def add(self, kind: str, stamp_s: float, message: Message) -> None:
        """Add an image, "color" or "depth". Drops the oldest ones where too many wait."""
        images = self._waiting[kind]
        images.append((stamp_s, message))
        self._came_s[kind] = stamp_s
        while len(images) > _MOST_ALONE or sum(len(other.data) for _, other in images[:-1]) > _MOST_ALONE_BYTES:
            del images[0]
            self.crowded[kind] += 1

    def settled(self, now_s: float) -> Iterator[ImagePair]:
        """Frames whose pair is final, given that all later images are stamped `now_s` or later; infinite at the end."""
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
            frames.append(ImagePair(color_s, color_message, depth_message, depth_s - color_s))
        for kind, paired in zip(("color", "depth"), pairs.T.tolist(), strict=True):
            singles = {i for i, (stamp_s, _) in enumerate(self._waiting[kind]) if stamp_s < due_s} - set(paired)
            # Count single images and their gaps to the nearest image of the other kind.
            other = "depth" if kind == "color" else "color"
            others_s = [self._came_s[other], *(stamp_s for stamp_s, _ in self._waiting[other])]
            self.alone[kind] += len(singles)
            for place in singles:
                gap_s = min(abs(other_s - self._waiting[kind][place][0]) for other_s in others_s)
                self._gaps_s[kind].append(gap_s)
            gone[kind] |= singles
        for kind, places in gone.items():
            self._waiting[kind] = [image for i, image in enumerate(self._waiting[kind]) if i not in places]
        yield from frames
