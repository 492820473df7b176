"""`RecordingSession` records a camera and wheels together. `LiveRecorder` writes to the disk in a thread and counts
what the disk is too slow for.
"""

from __future__ import annotations

import shutil
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from wheelsight.core.errors import ArgumentError, OutputError, RecordingError
from wheelsight.core.files import StrPath, output_error
from wheelsight.core.messages import AngularVelocity, WheelReading, YawRate
from wheelsight.core.settings import RecorderSettings
from wheelsight.core.threads import Closing
from wheelsight.io.devices.live_camera import (
    CameraReport,
    CameraStatus,
    CameraWatch,
    LiveCamera,
    LiveFrame,
    take_angular_velocities,
)
from wheelsight.io.devices.wheel_link import LinkReport, WheelLink
from wheelsight.io.recordings.native import FrameClock, LiveWriter

RECORDER_THREAD = "wheelsight-recorder"


@dataclass(frozen=True, slots=True)
class RecorderReport:
    """The counts of a recorder so far. They exclude earlier parts of a resumed recording.

    Attributes:
        frames, readings, turns: that were written; `turns` are readings of the camera's gyroscope.
        waiting: frames that wait for the disk.
        dropped: frames that were dropped because the disk was too slow.
        refused: frames or readings that cannot be stored, such as those with decreasing stamps.
        refusal: the reason of the last one, or "".
        problem: the error that ended the writing, or None.
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
    """A frame that is being written, and when it came."""

    live: LiveFrame
    written: Future[Any]
    since_s: float


class LiveRecorder(Closing):
    """Writes frames and readings of live sensors without blocking them. Use it in a `with` block.

    Threads encode and write images; another lists them in order of arrival. Readings are small and written at once. A
    full disk does not raise: `report` shows it, since the sensors continue.

    Args:
        writer: to write to; closed with the recorder.
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
        self._pool = ThreadPoolExecutor(self.settings.writers, thread_name_prefix=RECORDER_THREAD)
        self._thread = threading.Thread(target=self._list, name=RECORDER_THREAD, daemon=True)
        self._thread.start()

    def add_frame(self, live: LiveFrame) -> None:
        """Queue a frame for writing, or drop it where the disk is too slow. Does not wait."""
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
            if not self._goes_on():  # the disk became full meanwhile
                return
            written = self._pool.submit(self._writer.write_frame, live.frame, live.infrared)
            self._waiting.append(_Waiting(live, written, now_s))
            self._changed.notify_all()

    def add_reading(self, reading: WheelReading | YawRate | AngularVelocity) -> None:
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
        """The counts so far."""
        with self._changed:
            counts = (self._frames, self._readings, self._size_bytes, len(self._waiting), self._dropped, self._refused)
            return RecorderReport(*counts, self._refusal, self._problem, self._turns)

    def close(self) -> None:
        """Write all waiting frames and stop; may be called twice."""
        with self._changed:
            self._is_over = True
            self._changed.notify_all()
        self._thread.join()
        self._pool.shutdown(cancel_futures=True)
        self._writer.close()

    def _list(self) -> None:
        """The thread: add frames to the lists, in order, once their images are written."""
        while True:
            with self._changed:
                while not self._waiting and not self._is_over:
                    self._changed.wait()
                if not self._waiting:
                    return
                first = self._waiting[0]
            live = first.live
            clock = FrameClock(live.frame.stamp_s, live.stamp_sigma_s, live.arrived_s, live.device_s, live.sequence)
            try:
                written = first.written.result()
                self._writer.list_frame(written, clock)
                with self._changed:
                    self._frames += 1
                    self._size_bytes += written.size_bytes
            except CancelledError:
                pass
            except Exception as error:  # an error of this thread would otherwise be lost
                unknown = OutputError(f"images cannot be written: {error}", fix="record without the camera")
                self._end(error if isinstance(error, OutputError) else unknown)
            with self._changed:
                if self._waiting:
                    self._waiting.popleft()

    def _goes_on(self) -> bool:
        return not self._is_over and self._problem is None

    def _refuse(self, error: ArgumentError | RecordingError) -> None:
        with self._changed:
            self._refused += 1
            self._refusal = error.problem

    def _end(self, error: OutputError) -> None:
        """Store the error that ends the recording, and drop waiting frames."""
        with self._changed:
            self._problem = self._problem or error
            for waiting in self._waiting:
                waiting.written.cancel()
            self._waiting.clear()


THREAD = "wheelsight-capture"
_LONGEST_WAIT_S = 0.1
_CHECK_S = 0.5  # between two checks of the camera, the disk and the rates
_RATE_SPAN_S = 3.0  # rates are averages over this time


@dataclass(frozen=True, slots=True)
class SessionStatus:
    """The state of a recording session at one moment.

    Attributes:
        seconds: since its start.
        recorder, camera, link: their reports; None without a camera or link.
        frames_per_s, readings_per_s, bytes_per_s: the rates of writing over the last seconds.
        free_bytes: on the disk.
        full_after_s: time until the disk is full at this rate; None where nothing is written.
    """

    seconds: float
    recorder: RecorderReport
    camera: CameraReport | None
    link: LinkReport | None
    frames_per_s: float
    readings_per_s: float
    bytes_per_s: float
    free_bytes: int
    full_after_s: float | None

    @property
    def drops(self) -> dict[str, int]:
        """The numbers of lost frames by cause, without zeros."""
        camera = self.camera
        counts = {"slow disk": self.recorder.dropped, "refused": self.recorder.refused}
        if camera is not None:
            counts |= {"camera": camera.device_drops, "busy computer": camera.host_drops, "too old": camera.stale}
            counts["refused"] += camera.refused
        return {cause: count for cause, count in counts.items() if count}


class RecordingSession:
    """Records a camera and wheels together, and reports changes of their state.

    A camera that goes away does not end it: the wheels continue, and the camera does once it is back. It ends on
    request, when nothing more can come, or before the disk is full.

    Args:
        folder: of the recording, to check the free space of its disk.
        camera, link: the sensors, either of which may be None.
        note: called with a sentence for each change, from the thread that calls `run`.
    """

    def __init__(
        self,
        recorder: LiveRecorder,
        folder: StrPath,
        camera: LiveCamera | None,
        link: WheelLink | None,
        note: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._recorder, self._folder, self._note = recorder, folder, note
        self._camera, self._link = camera, link
        self._settings = recorder.settings
        self._watch = None if camera is None else CameraWatch(camera)
        self._refused = 0
        self._history: deque[tuple[float, RecorderReport]] = deque()
        self._is_over = threading.Event()
        self._began_s = time.monotonic()

    def run(
        self,
        is_over: Callable[[], bool],
        on_status: Callable[[SessionStatus], None] = lambda status: None,
        seconds: float | None = None,
    ) -> None:
        """Record until `is_over`, or for a duration.

        Args:
            is_over: polled about ten times per second.
            on_status: called regularly with the state of the session.
            seconds: the duration; None for no limit.

        Raises:
            OutputError: the disk is full, or nearly. The recording is kept.
        """
        capture = threading.Thread(target=self._capture, name=THREAD, daemon=True)
        self._began_s = time.monotonic()
        self._history.append((self._began_s, self._recorder.report()))
        next_check_s = self._began_s
        capture.start()
        try:
            while not (is_over() or self._has_ended()):
                if seconds is not None and time.monotonic() - self._began_s >= seconds:
                    break
                if self._link is None:
                    time.sleep(_LONGEST_WAIT_S)
                elif (ticks := self._link.read(_LONGEST_WAIT_S)) is not None:
                    self._recorder.add_reading(ticks)
                if time.monotonic() >= next_check_s:
                    next_check_s += _CHECK_S
                    on_status(self.status())
                    free_mb = self._free_bytes() / 1e6
                    if free_mb < self._settings.least_free_mb:
                        full = f"only {free_mb:.0f} MB are left on the disk: recording stopped, and is complete"
                        raise OutputError(full, path=self._folder, fix="free some space, then continue with --resume")
        finally:
            self._is_over.set()
            capture.join()
            self._notice()
        if (problem := self._recorder.report().problem) is not None:
            raise problem

    def status(self) -> SessionStatus:
        """The state of the session. Calls `note` for changes since the last call."""
        now_s, recorder = time.monotonic(), self._recorder.report()
        self._history.append((now_s, recorder))
        while len(self._history) > 2 and self._history[1][0] <= now_s - _RATE_SPAN_S:
            self._history.popleft()
        then_s, then = self._history[0]
        span_s = max(now_s - then_s, 1e-3)
        bytes_per_s = (recorder.size_bytes - then.size_bytes) / span_s
        free_bytes = self._free_bytes()
        left_bytes = max(free_bytes - 1e6 * self._settings.least_free_mb, 0.0)
        self._notice()
        return SessionStatus(
            now_s - self._began_s,
            recorder,
            None if self._camera is None else self._camera.report(),
            None if self._link is None else self._link.report(),
            (recorder.frames - then.frames) / span_s,
            (recorder.readings - then.readings) / span_s,
            bytes_per_s,
            free_bytes,
            left_bytes / bytes_per_s if bytes_per_s > 0 else None,
        )

    def _capture(self) -> None:
        """The thread: record frames and readings of the camera's gyroscope."""
        while self._camera is not None and not self._is_over.is_set():
            live = self._camera.read(_LONGEST_WAIT_S)
            for turn in take_angular_velocities(self._camera):
                self._recorder.add_reading(turn)
            if live is not None:
                self._recorder.add_frame(live)
            elif self._camera.report().status is CameraStatus.ENDED:
                return

    def _has_ended(self) -> bool:
        """Whether writing failed, or no further frame will come."""
        if self._recorder.report().problem is not None:
            return True
        camera = self._camera
        return camera is not None and camera.report().status in (CameraStatus.ENDED, CameraStatus.CLOSED)

    def _notice(self) -> None:
        """Call `note` for changes of the camera, and for the first refused frame or reading."""
        for text in () if self._watch is None else self._watch.changes():
            self._note(text)
        recorder = self._recorder.report()
        if recorder.refused and not self._refused:
            self._note(f"left out a frame or reading that cannot be stored: {recorder.refusal}")
        self._refused = recorder.refused

    def _free_bytes(self) -> int:
        """The free space of the disk. Raises OutputError where the folder was removed."""
        try:
            return shutil.disk_usage(self._folder).free
        except OSError as error:
            raise output_error(error, self._folder) from error
