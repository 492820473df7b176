"""Plays a recording in real time: what comes too late is dropped and counted. Holds the player, wheel readings
beside the recording, and AnswerTimes.
"""

from __future__ import annotations

import heapq
import math
import threading
import time
from array import array
from collections import deque
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from wheelsight.app.run.run_record import RealTimeRecord
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError, DeviceError
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelReading, WheelTicks
from wheelsight.core.settings import RealTimeSettings
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.devices import BAUDRATE, ClockMap, LinkStatus, TicksFile, WheelSource, is_recorded, open_wheels
from wheelsight.io.recordings import AssociationReport, ListedFrame, ListsFrames, Recording

# A recording played in real time: what comes too late for it is dropped, not queued, and counted.


class RealTimeRecording:
    """A `Recording` whose events come when their time comes, as from a robot that drives just now.

    Readings come all, of frames only the newest: one that is overtaken while nobody was free for it is dropped
    (`Playing` tells the rules). Hence frames that take too long cost frames, never a growing delay. How late an answer
    is shows when the next event is asked for. `frame_count` stays that of the recording.

    Args:
        recording: what is played.
        wheels: where wheel readings come from in place of the recording's own.
        clock: what it is played by.
        settings: of None, the defaults.

    Raises:
        ConfigError: there are wheels and no frames beside which they could be played, or they were recorded at another
            time than the frames.
    """

    def __init__(
        self,
        recording: Recording,
        wheels: LiveWheels | RecordedWheels | None = None,
        clock: Clock | None = None,
        settings: RealTimeSettings | None = None,
    ) -> None:
        if wheels is not None and not recording.frame_count:
            raise ConfigError(f"{recording.path}: the recording has no images to play beside the wheels")
        if isinstance(wheels, RecordedWheels):
            _check_times(recording, wheels)
        self.wheels = wheels
        self.settings = settings or RealTimeSettings()
        self._recording = recording
        self._clock = clock or MonotonicClock()
        self._playing: Playing | None = None
        self._times = AnswerTimes(self.settings.recent_frames)

    @property
    def played(self) -> Recording:
        """What is played."""
        return self._recording

    @property
    def name(self) -> str:
        """The recording's, as with most that follows."""
        return self._recording.name

    @property
    def path(self) -> Path:
        """The recording's."""
        return self._recording.path

    @property
    def format(self) -> str:
        """The recording's."""
        return self._recording.format

    @property
    def body(self) -> str:
        """The recording's."""
        return self._recording.body

    @property
    def calibration(self) -> Calibration:
        """The recording's, but that the counters of live wheels, which the link has unrolled, do not roll over."""
        calibration = self._recording.calibration
        if not isinstance(self.wheels, LiveWheels) or calibration.wheels is None:
            return calibration
        return replace(calibration, wheels=calibration.wheels.never_rolling_over)

    @property
    def frame_count(self) -> int:
        """The recording's: those that are dropped included."""
        return self._recording.frame_count

    @property
    def wheel_count(self) -> int:
        """Of live wheels, how many were heard while it was played."""
        return self._recording.wheel_count if self.wheels is None else self.wheels.count

    @property
    def association(self) -> AssociationReport:
        """The recording's."""
        return self._recording.association

    @property
    def ground_truth(self) -> Trajectory | None:
        """The recording's."""
        return self._recording.ground_truth

    @property
    def warnings(self) -> tuple[str, ...]:
        """The recording's and the wheels'."""
        of_wheels = () if self.wheels is None else self.wheels.warnings
        return (*self._recording.warnings, *of_wheels)

    def events(self, *, images: bool = True) -> Generator[Event]:
        """The events, each when its time comes, from the start at each call."""
        self._times = AnswerTimes(self.settings.recent_frames)
        playing = self._playing = Playing(self._items(images), self._clock, self.settings)
        if isinstance(self.wheels, LiveWheels):
            self.wheels.tell(self._hear)
        try:
            while (event := playing.take()) is not None:
                yield event
                self._times.add(event, playing.now_s)
        finally:
            if isinstance(self.wheels, LiveWheels):
                self.wheels.tell(None)
            playing.close()

    def rehearsals(self) -> tuple[RealTimeRecording]:
        """Its own first events."""
        return (self,)

    def rehearsal(self) -> Generator[Event]:
        """The first few events, at once: for kernels to be compiled by. Wheels from elsewhere stand still in it."""
        has_frames, seen = self._recording.frame_count > 0, 0
        events = self._recording.events(images=has_frames)
        try:
            for event in events:
                if isinstance(event, WheelReading) and self.wheels is not None:
                    continue
                if isinstance(event, RgbdFrame) and self.wheels is not None:
                    yield WheelTicks(event.stamp_s, 0, 0)
                yield event
                seen += isinstance(event, RgbdFrame) or not has_frames
                if seen == self.settings.rehearsed_frames:
                    return
        finally:
            if isinstance(events, Generator):
                events.close()

    def report(self) -> RealTimeRecord:
        """How it went so far."""
        played = self._playing
        counts = (0, 0, 0, 0) if played is None else (played.frames, played.dropped, played.unread, played.readings)
        where = None if self.wheels is None else self.wheels.where
        played_s, latencies = 0.0 if played is None else played.played_s, self._times.median_and_p95_s()
        return RealTimeRecord(played_s, *counts, *latencies, where)

    def lately(self) -> tuple[float, float] | None:
        """Frames answered a second, and their median latency in seconds, over the last of them; None before two."""
        return self._times.lately()

    @property
    def frames_so_far(self) -> tuple[int, int]:
        """Frames that came by, and how many of them were dropped."""
        return (0, 0) if self._playing is None else (self._playing.frames, self._playing.dropped)

    @property
    def is_missing_wheels(self) -> bool:
        """Whether live wheels have fallen silent."""
        return isinstance(self.wheels, LiveWheels) and self.wheels.is_silent

    def _hear(self, ticks: WheelTicks) -> bool:
        """A live reading, stamped by the clock; False before the playing clock runs."""
        assert self._playing is not None
        stamp_s = self._playing.shown_s(ticks.stamp_s)
        if stamp_s is not None:
            self._playing.hear(replace(ticks, stamp_s=stamp_s))
        return stamp_s is not None

    def _items(self, images: bool) -> Iterator[Event | ListedFrame]:
        items: Iterator[Event | ListedFrame]
        if images and isinstance(self._recording, ListsFrames):
            items = self._recording.listed()
        else:
            items = self._recording.events(images=images)
        if self.wheels is None:
            return items
        others = (item for item in items if not isinstance(item, WheelReading))
        if isinstance(self.wheels, LiveWheels):
            return others
        return heapq.merge(self.wheels.ticks, others, key=lambda item: item.stamp_s)


@contextmanager
def in_real_time(
    recording: Recording,
    wheels_from: str | None = None,
    baudrate: int = BAUDRATE,
    clock: Clock | None = None,
    settings: RealTimeSettings | None = None,
) -> Iterator[RealTimeRecording]:
    """A recording to be played in real time, with the wheels at a port, pipe or file, if given, opened for the block.

    Raises:
        DeviceError: the port or pipe cannot be opened.
        RecordingError: the file of readings cannot be read.
        ConfigError: as `RealTimeRecording`.
    """
    clock = clock or MonotonicClock()
    if wheels_from is None:
        yield RealTimeRecording(recording, None, clock, settings)
    elif is_recorded(wheels_from):
        yield RealTimeRecording(recording, RecordedWheels(wheels_from), clock, settings)
    else:
        with LiveWheels(wheels_from, baudrate, clock) as wheels:
            yield RealTimeRecording(recording, wheels, clock, settings)


def _check_times(recording: Recording, wheels: RecordedWheels) -> None:
    """Refuse readings that no frame lies between. Raises ConfigError."""
    if not isinstance(recording, ListsFrames):
        return
    frames_s = [item.stamp_s for item in recording.listed() if isinstance(item, ListedFrame)]
    first_s, last_s = (wheels.ticks[index].stamp_s if wheels.ticks else np.nan for index in (0, -1))
    if not (first_s <= frames_s[-1] and last_s >= frames_s[0]):
        problem = f"{wheels.where}: its readings are of {first_s:.3f} s to {last_s:.3f} s"
        images = f"the images of {recording.path} of {frames_s[0]:.3f} s to {frames_s[-1]:.3f} s"
        raise ConfigError(f"{problem}, {images}", fix="both must be stamped by one clock")


# Events handed out when their time comes: readings all, frames only the newest.


_LONGEST_WAIT_S = 60.0  # of one wait, after which it goes on: no thread sleeps for ever
THREAD = "wheelsight-player"


class Clock(Protocol):
    """The time that a recording is played by, and waiting for it."""

    def now_s(self) -> float:
        """Seconds since some moment; never backwards."""

    def wait(self, condition: threading.Condition, until_s: float) -> None:
        """Wait until woken, or until that time, which may be infinite; sometimes for less. `condition` is held."""

    def wake(self, condition: threading.Condition) -> None:
        """Wake all who wait; `condition` is held."""


class MonotonicClock:
    """The host's time, as it passes."""

    def now_s(self) -> float:
        """As `time.monotonic`."""
        return time.monotonic()

    def wait(self, condition: threading.Condition, until_s: float) -> None:
        """Up to a minute."""
        condition.wait(min(max(until_s - self.now_s(), 0.0), _LONGEST_WAIT_S))

    def wake(self, condition: threading.Condition) -> None:
        """All of them."""
        condition.notify_all()


class Playing:
    """One passage through a recording in real time; a thread reads ahead some frames and readings.

    Its clock, the playing clock, shows the recording's time: the first event's stamp when what is read ahead is ready,
    and then seconds as they pass. An event is due when the clock shows its stamp. Due events are taken in the order of
    their stamps; a frame is dropped as soon as the one after it is due too. Where the recording lists its frames, one
    that is overtaken before it was decoded never is.

    Attributes:
        frames, dropped, unread: frames taken or dropped so far; dropped; and of these never decoded.
        readings: taken so far, of all sensors but the camera.
    """

    def __init__(
        self, items: Iterator[Event | ListedFrame], clock: Clock, settings: RealTimeSettings | None = None
    ) -> None:
        self.settings = settings or RealTimeSettings()
        self.frames = self.dropped = self.unread = self.readings = 0
        self._items, self._clock = items, clock
        self._frames: deque[RgbdFrame | SkippedFrame] = deque()
        self._readings: deque[Event] = deque()
        self._heard: deque[Event] = deque()
        self._behind_s: float | None = None  # from the recording's time to the clock's
        self._began_s = self._ended_s = math.nan
        self._is_ready = self._is_read = self._is_over = False
        self._error: BaseException | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._read, name=THREAD, daemon=True)
        self._thread.start()

    @property
    def now_s(self) -> float:
        """What the playing clock shows; -∞ before it began."""
        return -math.inf if self._behind_s is None else self._clock.now_s() - self._behind_s

    @property
    def played_s(self) -> float:
        """How long it has run, or ran."""
        end_s = self._ended_s if self._is_over else self._clock.now_s()
        return 0.0 if self._behind_s is None else end_s - self._began_s

    def take(self) -> Event | None:
        """The next event, once it is due; None at the end. Raises what stopped the recording, at its place."""
        with self._changed:
            while True:
                self._begin()
                self._drop_overtaken()
                event = self._next()
                if event is not None and self._is_due(event.stamp_s):
                    return self._taken(event)
                if event is None and self._is_read:
                    if self._error is not None:
                        raise self._error
                    return None
                self._clock.wait(self._changed, self._due_s(math.inf if event is None else event.stamp_s))

    def hear(self, event: Event) -> None:
        """An event from elsewhere, stamped by the recording's clock; it is due by now."""
        with self._changed:
            self._heard.append(event)
            self._clock.wake(self._changed)

    def shown_s(self, clock_s: float) -> float | None:
        """What the playing clock shows when `clock` shows `clock_s`; None if it had not begun by now."""
        return None if self._behind_s is None else clock_s - self._behind_s

    def close(self) -> None:
        """End it; the thread ends after the frame that it decodes."""
        with self._changed:
            self._is_over = True
            self._ended_s = self._clock.now_s()
            self._clock.wake(self._changed)
        self._thread.join()

    def _begin(self) -> None:
        """Let the playing clock run, as soon as what is read ahead is ready."""
        first = self._next()
        if self._behind_s is None and self._is_ready and first is not None:
            self._began_s = self._clock.now_s()
            self._behind_s = self._began_s - first.stamp_s
            self._clock.wake(self._changed)

    def _next(self) -> Event | None:
        """The oldest that is at hand; of several at one stamp, readings before the frame."""
        at_hand = [queue[0] for queue in (self._heard, self._readings, self._frames) if queue]
        return min(at_hand, key=_stamp_s, default=None)

    def _taken(self, event: Event) -> Event:
        queues = (self._heard, self._readings, self._frames)
        next(queue for queue in queues if queue and queue[0] is event).popleft()
        if isinstance(event, RgbdFrame | SkippedFrame):
            self.frames += 1
            self._clock.wake(self._changed)  # there is room for another
        else:
            self.readings += 1
        return event

    def _drop_overtaken(self) -> None:
        while len(self._frames) > 1 and self._is_due(self._frames[1].stamp_s):
            self._frames.popleft()
            self.frames += 1
            self.dropped += 1

    def _due_s(self, stamp_s: float) -> float:
        """The clock's time at which the playing clock shows a stamp; infinite before it began."""
        return math.inf if self._behind_s is None else stamp_s + self._behind_s

    def _is_due(self, stamp_s: float) -> bool:
        """Whether it shows it by now; it always does one that is no number."""
        return not self._due_s(stamp_s) > self._clock.now_s()

    def _read(self) -> None:
        """The thread: decode ahead, as far as there is room, until the recording ends or nobody plays it any more."""
        try:
            for item in self._items:
                if not self._is_wanted(item):
                    if self._is_over:
                        break
                    continue
                event = item.read() if isinstance(item, ListedFrame) else item
                with self._changed:
                    is_frame = isinstance(event, RgbdFrame | SkippedFrame)
                    (self._frames if is_frame else self._readings).append(event)  # type: ignore[arg-type]
                    if self._next() is event:  # else it is something before it that is waited for
                        self._clock.wake(self._changed)
        except BaseException as error:
            self._error = error
        finally:
            if isinstance(self._items, Generator):
                self._items.close()
            with self._changed:
                self._is_read = self._is_ready = True
                self._clock.wake(self._changed)

    def _is_wanted(self, item: Event | ListedFrame) -> bool:
        """Wait for room; False for a frame that was overtaken meanwhile, and for all once it is over."""
        with self._changed:
            while not self._is_over and (look_again_s := self._has_room_at(item)) is not None:
                if not self._is_ready:
                    self._is_ready = True
                    self._clock.wake(self._changed)
                self._clock.wait(self._changed, self._due_s(look_again_s))
            is_overtaken = isinstance(item, ListedFrame) and self._is_due(item.next_stamp_s)
            if is_overtaken and not self._is_over:
                self.frames += 1
                self.dropped += 1
                self.unread += 1
            return not (self._is_over or is_overtaken)

    def _has_room_at(self, item: Event | ListedFrame) -> float | None:
        """None where there is room, else the stamp at which to look again."""
        self._drop_overtaken()
        if isinstance(item, ListedFrame | RgbdFrame | SkippedFrame):
            return self._frames[1].stamp_s if len(self._frames) >= self.settings.frames_ahead else None
        ahead_s = self.settings.readings_ahead_s
        there_s = item.stamp_s - ahead_s
        first = self._next()
        has_room = first is None or self._is_due(there_s) or (self._behind_s is None and there_s <= first.stamp_s)
        return None if has_room else there_s + ahead_s / 2  # rather many at once than each by itself


def _stamp_s(event: Event) -> float:
    """A stamp that is no number comes first: whoever takes it refuses it."""
    return -math.inf if math.isnan(event.stamp_s) else event.stamp_s


# Wheel readings beside the recording that is played: from a serial port, the telemetry pipe, or a file.


WHEELS_THREAD = "wheelsight-wheels"
_SILENT = (LinkStatus.VANISHED, LinkStatus.NO_DATA, LinkStatus.NOISE, LinkStatus.TEXT)


class RecordedWheels:
    """The readings of a wheels.csv, or of a recording's folder that holds one.

    Attributes:
        where: the path.
        ticks: in order of time, by the clock of the recording beside which they are played.
        count: how many.
        warnings: about lines left out.

    Raises:
        RecordingError: it cannot be read.
    """

    def __init__(self, where: str) -> None:
        source = open_wheels(where)
        self.where, self.ticks = where, tuple(source.ticks())
        self.count = len(self.ticks)
        self.warnings = tuple(source.warnings) if isinstance(source, TicksFile) else ()


class LiveWheels:
    """A source of ticks, listened to by a thread; use it in a `with` block.

    The source stamps by a clock of its own: the link in host time as mapped from the controller's clock, the pipe as
    its writer did. `ClockMap` maps it to the time at which readings arrive here, later by the smallest delay of the
    way, so that stamps do not tremble with the transport. A source that falls silent ends nothing.

    Args:
        where: a serial port, or a named pipe.
        baudrate: of the port.
        clock: tells when readings arrive.
        source: in place of what would be opened at `where`.

    Attributes:
        where: as given.
        count: readings that were of use.
        is_silent: whether it has fallen silent.

    Raises:
        DeviceError: the port or pipe cannot be opened.
    """

    def __init__(
        self,
        where: str,
        baudrate: int = BAUDRATE,
        clock: Clock | None = None,
        source: WheelSource | None = None,
    ) -> None:
        self.where = where
        self.count = 0
        self.is_silent = False
        self._silences: list[str] = []
        self._clock = clock or MonotonicClock()
        self._listener: Callable[[WheelTicks], bool] | None = None
        self._map, self._last_s = ClockMap(), -math.inf
        self._is_over = False
        self._source = source or open_wheels(where, baudrate, self._told)
        self._thread = threading.Thread(target=self._listen, name=WHEELS_THREAD, daemon=True)
        self._thread.start()

    @property
    def warnings(self) -> tuple[str, ...]:
        """When it fell silent, and that it never spoke."""
        if not self.count and not self._silences:
            return (f"No wheel reading came from {self.where}.",)
        return tuple(f"The wheels ({self.where}) fell silent after {why}." for why in self._silences)

    def tell(self, listener: Callable[[WheelTicks], bool] | None) -> None:
        """Who hears each reading from now on, in the thread and stamped by `clock`, and says whether it is of use."""
        self._listener = listener

    def close(self) -> None:
        """Give port or pipe back; may be called twice."""
        self._is_over, self._listener = True, None
        self._source.close()
        self._thread.join()

    def __enter__(self) -> LiveWheels:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _listen(self) -> None:
        try:
            for ticks in self._source.ticks():
                stamped = replace(ticks, stamp_s=self._stamp_s(ticks.stamp_s))
                listener = self._listener
                self.count += listener is not None and listener(stamped)
            self._fall_silent("its other end was closed")
        except DeviceError as error:
            self._fall_silent(error.problem)
        except OSError as error:
            self._fall_silent(error.strerror or str(error))

    def _stamp_s(self, source_s: float) -> float:
        """By `clock`; what is no number stays so, for whoever answers it to refuse."""
        if not math.isfinite(source_s):
            return math.nan
        if source_s <= self._last_s:
            self._map = ClockMap()  # the source's clock began anew
        self._last_s = source_s
        self._map.update(source_s, self._clock.now_s())
        return self._map.stamp_s(source_s)

    def _told(self, status: LinkStatus) -> None:
        """The link has a new status."""
        if status in _SILENT:
            self._fall_silent(str(status).split(":")[0])
        elif status is LinkStatus.CONNECTED:
            self.is_silent = False

    def _fall_silent(self, why: str) -> None:
        """Note it, once until readings come again."""
        if not (self._is_over or self.is_silent):
            self.is_silent = True
            self._silences.append(f"{self.count} readings: {why}")


# AnswerTimes: how late the answers of a run in real time are.


class AnswerTimes:
    """Latencies, from an event's stamp until the next event is asked for.

    Args:
        recent: frames over which `lately` tells.
    """

    def __init__(self, recent: int) -> None:
        self._frames_s, self._readings_s = array("d"), array("d")
        self._lately: deque[tuple[float, float]] = deque(maxlen=recent)

    def add(self, event: Event, now_s: float) -> None:
        """One more event was answered."""
        if not isinstance(event, RgbdFrame | SkippedFrame):
            self._readings_s.append(now_s - event.stamp_s)
            return
        self._frames_s.append(now_s - event.stamp_s)
        self._lately.append((now_s, now_s - event.stamp_s))

    def lately(self) -> tuple[float, float] | None:
        """Frames a second and their median latency over the last of them; None before two."""
        if len(self._lately) < 2 or self._lately[-1][0] <= self._lately[0][0]:
            return None
        rate = (len(self._lately) - 1) / (self._lately[-1][0] - self._lately[0][0])
        return rate, float(np.median([latency_s for _, latency_s in self._lately]))

    def median_and_p95_s(self) -> tuple[float | None, float | None]:
        """Of frames, else of readings; None of none."""
        latencies_s = self._frames_s or self._readings_s
        if not latencies_s:
            return None, None
        median_s, p95_s = np.percentile(latencies_s, [50, 95])
        return float(median_s), float(p95_s)
