"""Plays a recording in real time: late frames are dropped and counted. Holds the player, wheel readings beside the
recording, and AnswerTimes.
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
from typing import Protocol

import numpy as np

from wheelsight.app.run.run_record import RealTimeRecord
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError, DeviceError
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelReading, WheelTicks
from wheelsight.core.settings import RealTimeSettings
from wheelsight.core.threads import Closing, in_span, new_condition
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.devices import BAUDRATE, ClockMap, LinkStatus, TicksFile, WheelSource, is_recorded, open_wheels
from wheelsight.io.recordings import AssociationReport, ListedFrame, ListsFrames, Recording

_READINGS_AHEAD_S = 1.0  # readings of wheels and gyroscopes are read so far ahead
_RECENT_FRAMES = 30  # over which progress averages rate and latency: one second of most cameras
REHEARSED_FRAMES = 3  # answered before time begins to run, so that kernels are compiled or loaded


class RealTimeRecording:
    """A `Recording` whose events come at their stamps, like those of a live robot.

    All readings are played, but only the newest frame. A frame that is overtaken while the caller is busy is dropped
    (see `Playing`). Slow processing costs frames and never adds delay. The latency of an answer ends with the request
    for the next event. `frame_count` is that of the recording.

    Args:
        recording: to play.
        wheels: source of wheel readings in place of the recording's own.
        clock: time of the playback.
        settings: defaults if None.

    Raises:
        ConfigError: wheels without frames to play beside them, or recorded at another time than the frames.
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
        if isinstance(wheels, RecordedWheels) and isinstance(recording, ListsFrames):
            frames_s = [item.stamp_s for item in recording.listed() if isinstance(item, ListedFrame)]
            first_s, last_s = (wheels.ticks[index].stamp_s if wheels.ticks else np.nan for index in (0, -1))
            if not (first_s <= frames_s[-1] and last_s >= frames_s[0]):
                problem = f"{wheels.where}: its readings are of {first_s:.3f} s to {last_s:.3f} s"
                images = f"the images of {recording.path} of {frames_s[0]:.3f} s to {frames_s[-1]:.3f} s"
                raise ConfigError(f"{problem}, {images}", fix="both must be stamped by one clock")
        self.wheels = wheels
        self.settings = settings or RealTimeSettings()
        self._recording = recording
        self.name, self.path, self.format, self.body = recording.name, recording.path, recording.format, recording.body
        self._clock = clock or MonotonicClock()
        self._playing: Playing | None = None
        self._times = AnswerTimes()

    @property
    def played(self) -> Recording:
        """The recording."""
        return self._recording

    @property
    def calibration(self) -> Calibration:
        """The recording's calibration. The counters of live wheels do not wrap: the link has unrolled them."""
        calibration = self._recording.calibration
        if not isinstance(self.wheels, LiveWheels) or calibration.wheels is None:
            return calibration
        return replace(calibration, wheels=calibration.wheels.never_rolling_over)

    @property
    def frame_count(self) -> int:
        """The recording's number of frames, with dropped ones."""
        return self._recording.frame_count

    @property
    def wheel_count(self) -> int:
        """Number of readings of live wheels that came during the playback."""
        return self._recording.wheel_count if self.wheels is None else self.wheels.count

    @property
    def association(self) -> AssociationReport:
        """The recording's association."""
        return self._recording.association

    @property
    def ground_truth(self) -> Trajectory | None:
        """The recording's ground truth."""
        return self._recording.ground_truth

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the recording and of the wheels."""
        of_wheels = () if self.wheels is None else self.wheels.warnings
        return (*self._recording.warnings, *of_wheels)

    def events(self, *, images: bool = True) -> Generator[Event]:
        """The events at their times; each call starts at the beginning."""
        self._times = AnswerTimes()
        playing = self._playing = Playing(self._items(images), self._clock, self.settings)
        if isinstance(self.wheels, LiveWheels):
            self.wheels.set_listener(self._take_live)
        try:
            while (event := playing.take()) is not None:
                yield event
                self._times.add(event, playing.now_s)
        finally:
            if isinstance(self.wheels, LiveWheels):
                self.wheels.set_listener(None)
            playing.close()

    def rehearsals(self) -> tuple[RealTimeRecording]:
        """This recording: its first events are the rehearsal."""
        return (self,)

    def rehearsal(self) -> Generator[Event]:
        """The first few events without waiting, to compile kernels. External wheels stand still in it."""
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
                if seen == REHEARSED_FRAMES:
                    return
        finally:
            if isinstance(events, Generator):
                events.close()

    def report(self) -> RealTimeRecord:
        """Counts and latencies so far."""
        played = self._playing
        counts = (0, 0, 0, 0) if played is None else (played.frames, played.dropped, played.unread, played.readings)
        where = None if self.wheels is None else self.wheels.where
        played_s, latencies = 0.0 if played is None else played.played_s, self._times.median_and_p95_s()
        return RealTimeRecord(played_s, *counts, *latencies, where)

    def lately(self) -> tuple[float, float] | None:
        """Frames answered a second and their median latency, seconds, in the recent window; None before two frames."""
        return self._times.lately()

    @property
    def frames_so_far(self) -> tuple[int, int]:
        """Number of frames so far, and number of dropped ones."""
        return (0, 0) if self._playing is None else (self._playing.frames, self._playing.dropped)

    @property
    def is_missing_wheels(self) -> bool:
        """Whether live wheels are silent."""
        return isinstance(self.wheels, LiveWheels) and self.wheels.is_silent

    def _take_live(self, ticks: WheelTicks) -> bool:
        """Take a live reading, stamped by the clock; False before the playback starts."""
        assert self._playing is not None
        stamp_s = self._playing.shown_s(ticks.stamp_s)
        if stamp_s is not None:
            self._playing.add(replace(ticks, stamp_s=stamp_s))
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
    """A recording that plays in real time. Wheels at a port, pipe or file, if given, are open in the block.

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


_LONGEST_WAIT_S = 60.0  # of one wait, after which it goes on: no thread sleeps for ever
THREAD = "wheelsight-player"


class Clock(Protocol):
    """The time of a playback, and waiting for it."""

    def now_s(self) -> float:
        """Seconds since an arbitrary moment; never decreases."""

    def wait(self, condition: threading.Condition, until_s: float) -> None:
        """Wait until woken or until the given time, which may be infinite; may return early. `condition` is held."""

    def wake(self, condition: threading.Condition) -> None:
        """Wake all waiting threads; `condition` is held."""


class MonotonicClock:
    """The host's monotonic clock."""

    def now_s(self) -> float:
        """As `time.monotonic`."""
        return time.monotonic()

    def wait(self, condition: threading.Condition, until_s: float) -> None:
        """Wait at most a minute."""
        condition.wait(min(max(until_s - self.now_s(), 0.0), _LONGEST_WAIT_S))

    def wake(self, condition: threading.Condition) -> None:
        """Wake all waiting threads."""
        condition.notify_all()


class Playing:
    """One playback of a recording. A thread reads some frames and readings ahead.

    The playing clock shows the recording's time. It starts at the first event's stamp when the events ahead are read.
    An event is due when the clock shows its stamp. Due events are taken in the order of their stamps. A frame is
    dropped as soon as the next frame is due. If the recording lists its frames, an overtaken frame is not decoded.

    Attributes:
        frames, dropped, unread: number of frames taken or dropped; of dropped ones; of dropped ones that were not
            decoded.
        readings: number of readings taken, of all sensors but the camera.
    """

    def __init__(
        self, items: Iterator[Event | ListedFrame], clock: Clock, settings: RealTimeSettings | None = None
    ) -> None:
        self.settings = settings or RealTimeSettings()
        self.frames = self.dropped = self.unread = self.readings = 0
        self._items, self._clock = items, clock
        self._frames: deque[RgbdFrame | SkippedFrame] = deque()
        self._readings: deque[Event] = deque()
        self._external: deque[Event] = deque()
        self._behind_s: float | None = None  # from the recording's time to the clock's
        self._began_s = self._ended_s = math.nan
        self._is_ready = self._is_read = self._is_over = False
        self._error: BaseException | None = None
        self._changed = new_condition("playback")
        self._thread = threading.Thread(target=self._read, name=THREAD, daemon=True)
        self._thread.start()

    @property
    def now_s(self) -> float:
        """The time of the playing clock; -∞ before it starts."""
        return -math.inf if self._behind_s is None else self._clock.now_s() - self._behind_s

    @property
    def played_s(self) -> float:
        """Duration of the playback so far."""
        end_s = self._ended_s if self._is_over else self._clock.now_s()
        return 0.0 if self._behind_s is None else end_s - self._began_s

    def take(self) -> Event | None:
        """Wait for the next due event; None at the end. Raises the recording's error at its place."""
        with self._changed:
            while True:
                # Start the playing clock once the events ahead are read
                first = self._next()
                if self._behind_s is None and self._is_ready and first is not None:
                    self._began_s = self._clock.now_s()
                    self._behind_s = self._began_s - first.stamp_s
                    self._clock.wake(self._changed)
                self._drop_overtaken()
                event = self._next()
                if event is not None and self._is_due(event.stamp_s):
                    queues = (self._external, self._readings, self._frames)
                    next(queue for queue in queues if queue and queue[0] is event).popleft()
                    if isinstance(event, RgbdFrame | SkippedFrame):
                        self.frames += 1
                        self._clock.wake(self._changed)  # there is room for another
                    else:
                        self.readings += 1
                    return event
                if event is None and self._is_read:
                    if self._error is not None:
                        raise self._error
                    return None
                self._clock.wait(self._changed, self._due_s(math.inf if event is None else event.stamp_s))

    def add(self, event: Event) -> None:
        """Add an external event, stamped by the recording's clock; it is due now."""
        with self._changed:
            self._external.append(event)
            self._clock.wake(self._changed)

    def shown_s(self, clock_s: float) -> float | None:
        """The time of the playing clock at `clock_s` of `clock`; None before it starts."""
        return None if self._behind_s is None else clock_s - self._behind_s

    def close(self) -> None:
        """End the playback; the thread ends after its current frame."""
        with self._changed:
            self._is_over = True
            self._ended_s = self._clock.now_s()
            self._clock.wake(self._changed)
        self._thread.join()

    def _next(self) -> Event | None:
        """The oldest waiting event; at equal stamps readings come before the frame."""
        at_hand = [queue[0] for queue in (self._external, self._readings, self._frames) if queue]
        return min(at_hand, key=_stamp_s, default=None)

    def _drop_overtaken(self) -> None:
        while len(self._frames) > 1 and self._is_due(self._frames[1].stamp_s):
            self._frames.popleft()
            self.frames += 1
            self.dropped += 1

    def _due_s(self, stamp_s: float) -> float:
        """The time of `clock` at which a stamp is due; infinite before the start."""
        return math.inf if self._behind_s is None else stamp_s + self._behind_s

    def _is_due(self, stamp_s: float) -> bool:
        """Whether a stamp is due; a NaN stamp always is."""
        return not self._due_s(stamp_s) > self._clock.now_s()

    def _read(self) -> None:
        """Decode ahead in a thread, as far as there is room, until the recording or the playback ends."""
        try:
            for item in self._items:
                if not self._is_wanted(item):
                    if self._is_over:
                        break
                    continue
                event = in_span("decode", item.read) if isinstance(item, ListedFrame) else item
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
        """Wait for room; False if the frame is overtaken meanwhile, or the playback is over."""
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
        """None if there is room, else the stamp at which to look again."""
        self._drop_overtaken()
        if isinstance(item, ListedFrame | RgbdFrame | SkippedFrame):
            return self._frames[1].stamp_s if len(self._frames) >= self.settings.frames_ahead else None
        there_s = item.stamp_s - _READINGS_AHEAD_S
        first = self._next()
        has_room = first is None or self._is_due(there_s) or (self._behind_s is None and there_s <= first.stamp_s)
        return None if has_room else there_s + _READINGS_AHEAD_S / 2  # rather many at once than each by itself


def _stamp_s(event: Event) -> float:
    """Sort key. A NaN stamp comes first: the localizer rejects it."""
    return -math.inf if math.isnan(event.stamp_s) else event.stamp_s


WHEELS_THREAD = "wheelsight-wheels"
_SILENT = (LinkStatus.VANISHED, LinkStatus.NO_DATA, LinkStatus.NOISE, LinkStatus.TEXT)


class RecordedWheels:
    """The readings of a wheels.csv, or of a recording's folder with one.

    Attributes:
        where: the path.
        ticks: in order of time, by the clock of the recording beside which they are played.
        count: number of readings.
        warnings: about lines left out.

    Raises:
        RecordingError: it cannot be read.
    """

    def __init__(self, where: str) -> None:
        source = open_wheels(where)
        self.where, self.ticks = where, tuple(source.ticks())
        self.count = len(self.ticks)
        self.warnings = tuple(source.warnings) if isinstance(source, TicksFile) else ()


class LiveWheels(Closing):
    """A live source of ticks, read by a thread. Use it in a `with` block.

    The source has its own clock: the link stamps in host time mapped from the controller's clock, the pipe as its
    writer did. `ClockMap` maps these stamps to arrival times here, less the jitter of the transport. A silent source
    does not end the playback.

    Args:
        where: a serial port, or a named pipe.
        baudrate: of the port.
        clock: stamps the arrival of readings.
        source: used in place of `where`.

    Attributes:
        where: as given.
        count: number of used readings.
        is_silent: whether it is silent.

    Raises:
        DeviceError: the port or pipe cannot be opened.
    """

    def __init__(
        self, where: str, baudrate: int = BAUDRATE, clock: Clock | None = None, source: WheelSource | None = None
    ) -> None:
        self.where = where
        self.count = 0
        self.is_silent = False
        self._silences: list[str] = []
        self._clock = clock or MonotonicClock()
        self._listener: Callable[[WheelTicks], bool] | None = None
        self._map, self._last_s = ClockMap(), -math.inf
        self._is_over = False
        self._source = source or open_wheels(where, baudrate, self._on_status)
        self._thread = threading.Thread(target=self._listen, name=WHEELS_THREAD, daemon=True)
        self._thread.start()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about silence: when it began, or that no reading came at all."""
        if not self.count and not self._silences:
            return (f"No wheel reading came from {self.where}.",)
        return tuple(f"The wheels ({self.where}) fell silent after {why}." for why in self._silences)

    def set_listener(self, listener: Callable[[WheelTicks], bool] | None) -> None:
        """Set the listener of all further readings, which are stamped by `clock`. It returns whether it used one."""
        self._listener = listener

    def close(self) -> None:
        """Close port or pipe; may be called twice."""
        self._is_over, self._listener = True, None
        self._source.close()
        self._thread.join()

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
        """The stamp by `clock`. NaN stays NaN: the localizer rejects it."""
        if not math.isfinite(source_s):
            return math.nan
        if source_s <= self._last_s:
            self._map = ClockMap()  # the source's clock restarted
        self._last_s = source_s
        self._map.update(source_s, self._clock.now_s())
        return self._map.stamp_s(source_s)

    def _on_status(self, status: LinkStatus) -> None:
        """Handle a new status of the link."""
        if status in _SILENT:
            self._fall_silent(str(status).split(":")[0])
        elif status is LinkStatus.CONNECTED:
            self.is_silent = False

    def _fall_silent(self, why: str) -> None:
        """Note the silence, once until readings come again."""
        if not (self._is_over or self.is_silent):
            self.is_silent = True
            self._silences.append(f"{self.count} readings: {why}")


class AnswerTimes:
    """Latencies, from an event's stamp until the request for the next event."""

    def __init__(self) -> None:
        self._frames_s, self._readings_s = array("d"), array("d")
        self._lately: deque[tuple[float, float]] = deque(maxlen=_RECENT_FRAMES)

    def add(self, event: Event, now_s: float) -> None:
        """Add one answered event."""
        if not isinstance(event, RgbdFrame | SkippedFrame):
            self._readings_s.append(now_s - event.stamp_s)
            return
        self._frames_s.append(now_s - event.stamp_s)
        self._lately.append((now_s, now_s - event.stamp_s))

    def lately(self) -> tuple[float, float] | None:
        """Frames a second and their median latency, seconds, in the recent window; None before two frames."""
        if len(self._lately) < 2 or self._lately[-1][0] <= self._lately[0][0]:
            return None
        rate = (len(self._lately) - 1) / (self._lately[-1][0] - self._lately[0][0])
        return rate, float(np.median([latency_s for _, latency_s in self._lately]))

    def median_and_p95_s(self) -> tuple[float | None, float | None]:
        """Median and 95th percentile, seconds, of frames, else of readings; None without any."""
        latencies_s = self._frames_s or self._readings_s
        if not latencies_s:
            return None, None
        median_s, p95_s = np.percentile(latencies_s, [50, 95])
        return float(median_s), float(p95_s)
