"""LiveRecorder: writes what live sensors say without ever holding them up; what the disk is too slow for is counted."""

from __future__ import annotations

import threading
import time
from collections import deque
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from wheelsight.devices.live_camera import LiveFrame
from wheelsight.errors import ArgumentError, OutputError, RecordingError
from wheelsight.events import AngularVelocity, WheelTicks, YawRate
from wheelsight.recordings.frame_clocks import FrameClock
from wheelsight.recordings.writer import LiveWriter
from wheelsight.settings import RecorderSettings

THREAD = "wheelsight-recorder"


@dataclass(frozen=True, slots=True)
class RecorderReport:
    """What was recorded by now. Counts are of this recorder, not of what a resumed recording held before.

    Attributes:
        frames, readings, turns: written; the last are of the camera's gyroscope.
        size_bytes: of the images.
        waiting: frames that wait for the disk.
        dropped: frames for which it was too slow.
        refused: frames or readings that cannot be read again, such as stamps that do not grow.
        refusal: why, of the last one, or "".
        problem: what ended the writing, or None.
    """

    frames: int = 0
    readings: int = 0
    size_bytes: int = 0
    waiting: int = 0
    dropped: int = 0
    refused: int = 0
    refusal: str = ""
    problem: OutputError | None = None
    turns: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class _Waiting:
    """A frame on its way to the disk, and since when."""

    live: LiveFrame
    written: Future[Any]
    since_s: float


class LiveRecorder:
    """Takes frames and readings of live sensors, and has them written; use it in a `with` block.

    Images are encoded and written by threads of their own, and listed in the order in which they came. Readings are
    written at once: they are small. A full disk is told by `report`, not raised, since sensors go on.

    Args:
        writer: where to; closed with the recorder.
        settings: of None, the defaults.
    """

    def __init__(self, writer: LiveWriter, settings: RecorderSettings | None = None) -> None:
        self.settings = settings or RecorderSettings()
        self._writer = writer
        self._waiting: deque[_Waiting] = deque()
        self._frames = self._readings = self._turns = self._size_bytes = self._dropped = self._refused = 0
        self._refusal = ""
        self._problem: OutputError | None = None
        self._is_over = False
        self._changed = threading.Condition()
        self._pool = ThreadPoolExecutor(self.settings.writers, thread_name_prefix=THREAD)
        self._thread = threading.Thread(target=self._list, name=THREAD, daemon=True)
        self._thread.start()

    def add_frame(self, live: LiveFrame) -> None:
        """Have a frame written, or drop it where the disk is too slow; never waits."""
        now_s = time.monotonic()
        with self._changed:
            if not self._goes_on():
                return
            is_late = self._waiting and now_s - self._waiting[0].since_s > self.settings.longest_wait_s
            if is_late or len(self._waiting) >= self.settings.most_waiting:
                self._dropped += 1
                return
        try:
            self._writer.check(live.frame)
        except (ArgumentError, RecordingError) as error:
            self._refuse(error)
            return
        with self._changed:
            if not self._goes_on():  # the disk was found full meanwhile
                return
            written = self._pool.submit(self._writer.write_frame, live.frame, live.infrared)
            self._waiting.append(_Waiting(live, written, now_s))
            self._changed.notify_all()

    def add_reading(self, reading: WheelTicks | YawRate | AngularVelocity) -> None:
        """Write a reading of wheels or gyroscope."""
        if self._is_over or self._problem is not None:
            return
        try:
            if isinstance(reading, AngularVelocity):
                self._writer.add_angular_velocity(reading)
                self._turns += 1
                return
            self._writer.add(reading)
            self._readings += 1
        except (ArgumentError, RecordingError) as error:
            self._refuse(error)
        except OutputError as error:
            self._end(error)

    def report(self) -> RecorderReport:
        """How far it is."""
        with self._changed:
            counts = (self._frames, self._readings, self._size_bytes, len(self._waiting), self._dropped, self._refused)
            return RecorderReport(*counts, self._refusal, self._problem, self._turns)

    def close(self) -> None:
        """Have what waits written, and end; may be called twice."""
        with self._changed:
            self._is_over = True
            self._changed.notify_all()
        self._thread.join()
        self._pool.shutdown(cancel_futures=True)
        self._writer.close()

    def __enter__(self) -> LiveRecorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _list(self) -> None:
        """The thread: name frames in the lists as their images are there."""
        while True:
            with self._changed:
                while not self._waiting and not self._is_over:
                    self._changed.wait()
                if not self._waiting:
                    return
                first = self._waiting[0]
            self._list_one(first)
            with self._changed:
                if self._waiting:
                    self._waiting.popleft()

    def _list_one(self, first: _Waiting) -> None:
        live = first.live
        clock = FrameClock(live.frame.stamp_s, live.stamp_sigma_s, live.arrived_s, live.device_s, live.sequence)
        try:
            written = first.written.result()
            self._writer.list_frame(written, clock)
        except CancelledError:
            return
        except Exception as error:  # whatever it is, nobody else would ever hear of it
            unknown = OutputError(f"images cannot be written: {error}", fix="record without the camera")
            self._end(error if isinstance(error, OutputError) else unknown)
            return
        with self._changed:
            self._frames += 1
            self._size_bytes += written.size_bytes

    def _goes_on(self) -> bool:
        return not self._is_over and self._problem is None

    def _refuse(self, error: ArgumentError | RecordingError) -> None:
        with self._changed:
            self._refused += 1
            self._refusal = error.problem

    def _end(self, error: OutputError) -> None:
        """Nothing more can be written."""
        with self._changed:
            self._problem = self._problem or error
            for waiting in self._waiting:
                waiting.written.cancel()
            self._waiting.clear()
