"""A recording played in real time: what comes too late for it is dropped, not queued, and counted."""

from __future__ import annotations

import heapq
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.devices import BAUDRATE, is_recorded
from wheelsight.errors import ConfigError
from wheelsight.events import Event, RgbdFrame, WheelReading, WheelTicks
from wheelsight.pipeline.answer_times import AnswerTimes
from wheelsight.pipeline.live_wheels import LiveWheels, RecordedWheels
from wheelsight.pipeline.playing import Clock, MonotonicClock, Playing
from wheelsight.pipeline.realtime_record import RealTimeRecord
from wheelsight.recordings import AssociationReport, ListedFrame, ListsFrames, Recording
from wheelsight.settings import RealTimeSettings
from wheelsight.trajectory import Trajectory


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
