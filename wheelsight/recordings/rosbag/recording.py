"""A bag as a recording: a pass over its messages, images decoded only as they are asked for, little in memory."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.errors import RecordingError
from wheelsight.events import WHEEL_READINGS, Event, RgbdFrame, SkippedFrame, YawRate
from wheelsight.geometry import FloatArray
from wheelsight.matches import Match, SpeedVariances
from wheelsight.recordings._calibrated import corrected_depth
from wheelsight.recordings._read_ahead import read_ahead
from wheelsight.recordings.motion_clocks import MotionClock
from wheelsight.recordings.protocol import AssociationReport, LeftOut, ListedFrame, OpenOptions, RecordedTopic
from wheelsight.recordings.rosbag.definitions import are_measured
from wheelsight.recordings.rosbag.images import color_of, depth_of
from wheelsight.recordings.rosbag.order import EventQueue, MessageQueue, Pairing, RawFrame
from wheelsight.recordings.rosbag.stamps import TopicClock, clock_findings
from wheelsight.recordings.rosbag.storage import Message, OpenBag, open_bag
from wheelsight.recordings.rosbag.topics import Roles
from wheelsight.recordings.rosbag.wheels import CountsApart, SpeedReader
from wheelsight.trajectory import Trajectory

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
