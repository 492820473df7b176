"""RecordingSession: a camera and wheels recorded side by side, until told to stop or the disk is full."""

from __future__ import annotations

import shutil
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from wheelsight.devices.camera_watch import CameraWatch
from wheelsight.devices.link import LinkReport, WheelLink
from wheelsight.devices.live_camera import CameraReport, CameraStatus, LiveCamera, take_angular_velocities
from wheelsight.devices.recorder import LiveRecorder, RecorderReport
from wheelsight.errors import OutputError
from wheelsight.files import StrPath, output_error

THREAD = "wheelsight-capture"
_LONGEST_WAIT_S = 0.1


@dataclass(frozen=True, slots=True)
class SessionLook:
    """How a recording is going at one moment.

    Attributes:
        seconds: since it began.
        recorder, camera, link: as they report; the latter two None where there is none.
        frames_per_s, readings_per_s, bytes_per_s: written over the last seconds.
        free_bytes: on the disk.
        full_after_s: when that is used up at this rate; None where nothing is written.
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
        """Frames that are lost, by cause; causes of none are left out."""
        camera = self.camera
        counts = {"slow disk": self.recorder.dropped, "refused": self.recorder.refused}
        if camera is not None:
            counts |= {"camera": camera.device_drops, "busy computer": camera.host_drops, "too old": camera.stale}
            counts["refused"] += camera.refused
        return {cause: count for cause, count in counts.items() if count}


class RecordingSession:
    """Fetches what the sensors say and gives it to a recorder; what changes with a sensor is noted.

    A camera that goes away does not end it: the wheels go on, and so does the camera once it is back. It ends when it
    is told to, when nothing more can come, or before the disk is full.

    Args:
        recorder: what writes.
        folder: where to, for the room on its disk.
        camera, link: the sensors, either of which may be None.
        note: told a sentence about each change, from the thread that calls `run`.
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
        on_look: Callable[[SessionLook], None] = lambda look: None,
        seconds: float | None = None,
    ) -> None:
        """Record until `is_over`, or for so many seconds, if given.

        Raises:
            OutputError: the disk is full, or nearly; what was recorded stays.
        """
        capture = threading.Thread(target=self._capture, name=THREAD, daemon=True)
        self._began_s = time.monotonic()
        self._history.append((self._began_s, self._recorder.report()))
        next_look_s = self._began_s
        capture.start()
        try:
            while not (is_over() or self._has_ended() or self._is_late(seconds)):
                self._listen()
                if time.monotonic() >= next_look_s:
                    next_look_s += self._settings.watch_s
                    on_look(self.look())
                    self._stop_where_full()
        finally:
            self._is_over.set()
            capture.join()
            self._notice()
        if (problem := self._recorder.report().problem) is not None:
            raise problem

    def look(self) -> SessionLook:
        """How it is going; sentences are noted about what changed since the last time."""
        now_s, recorder = time.monotonic(), self._recorder.report()
        self._history.append((now_s, recorder))
        while len(self._history) > 2 and self._history[1][0] <= now_s - self._settings.rate_span_s:
            self._history.popleft()
        then_s, then = self._history[0]
        span_s = max(now_s - then_s, 1e-3)
        bytes_per_s = (recorder.size_bytes - then.size_bytes) / span_s
        free_bytes = self._free_bytes()
        left_bytes = max(free_bytes - 1e6 * self._settings.least_free_mb, 0.0)
        self._notice()
        return SessionLook(
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

    def _listen(self) -> None:
        """To the wheels for a moment; where there are none, the moment passes."""
        if self._link is None:
            time.sleep(_LONGEST_WAIT_S)
        elif (ticks := self._link.read(_LONGEST_WAIT_S)) is not None:
            self._recorder.add_reading(ticks)

    def _capture(self) -> None:
        """The thread: frames as they come."""
        while self._camera is not None and not self._is_over.is_set():
            live = self._camera.read(_LONGEST_WAIT_S)
            for turn in take_angular_velocities(self._camera):
                self._recorder.add_reading(turn)
            if live is not None:
                self._recorder.add_frame(live)
            elif self._camera.report().status is CameraStatus.ENDED:
                return

    def _is_late(self, seconds: float | None) -> bool:
        return seconds is not None and time.monotonic() - self._began_s >= seconds

    def _has_ended(self) -> bool:
        """Whether nothing more can come or be written."""
        if self._recorder.report().problem is not None:
            return True
        camera = self._camera
        return camera is not None and camera.report().status in (CameraStatus.ENDED, CameraStatus.CLOSED)

    def _notice(self) -> None:
        """Tell what has changed with the camera, and what is refused for the first time."""
        for text in () if self._watch is None else self._watch.changes():
            self._note(text)
        recorder = self._recorder.report()
        if recorder.refused and not self._refused:
            self._note(f"left out what could not be read again: {recorder.refusal}")
        self._refused = recorder.refused

    def _free_bytes(self) -> int:
        """Raises OutputError where the folder has gone."""
        try:
            return shutil.disk_usage(self._folder).free
        except OSError as error:
            raise output_error(error, self._folder) from error

    def _stop_where_full(self) -> None:
        """Raises OutputError."""
        free_mb = self._free_bytes() / 1e6
        if free_mb < self._settings.least_free_mb:
            problem = f"only {free_mb:.0f} MB are left on the disk: recording stopped; what was recorded is whole"
            raise OutputError(problem, path=self._folder, fix="free some space, then go on with --resume")
