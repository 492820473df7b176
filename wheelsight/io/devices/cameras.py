"""`open_live_camera` opens a camera by name; `open_robot_camera` also combines calibrations. `PlayedCamera` plays a
recording as a live camera.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from wheelsight.core.calibration import Calibration, load_calibration
from wheelsight.core.errors import CalibrationError, DeviceError, RecordingError
from wheelsight.core.files import StrPath
from wheelsight.core.messages import AngularVelocity, RgbdFrame, SkippedFrame
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.core.threads import Closing
from wheelsight.io.devices import host_clock
from wheelsight.io.devices.camera_driver import CameraDriver
from wheelsight.io.devices.live_camera import CameraReport, CameraStatus, LiveCamera, LiveFrame, StreamingCamera
from wheelsight.io.devices.plugged_in import why_not

Opener = Callable[[str | None, LiveCameraSettings, Calibration | None], LiveCamera]
"""Opens a camera, given its serial number or file (None for the first one), settings, and a calibration or None."""


def _open(kind: str, where: str | None, settings: LiveCameraSettings, calibration: Calibration | None) -> LiveCamera:
    """A camera of a kind. Loads its driver at the first use."""
    if kind == "recording":
        return PlayedCamera.opened(where, settings, calibration)
    driver: CameraDriver
    if kind == "realsense":
        from wheelsight.io.devices.realsense import RealSenseDriver

        driver = RealSenseDriver(where, settings)
    elif kind == "freenect":
        from wheelsight.io.devices.freenect import FreenectDriver

        driver = FreenectDriver(where, settings)
    else:
        from wheelsight.io.devices.oni_player import OniPlayer
        from wheelsight.io.devices.openni2 import OpenNI2Driver, is_file

        driver = OpenNI2Driver(where, settings)
        if where is not None and is_file(where):
            driver = OniPlayer(where, settings)
    return StreamingCamera(driver, settings, calibration)


LIVE_CAMERAS: dict[str, Opener] = {
    kind: partial(_open, kind) for kind in ("realsense", "freenect", "openni2", "recording")
}
"""The openers of each kind of camera."""


def open_live_camera(
    which: str | None = None, settings: LiveCameraSettings | None = None, calibration: Calibration | None = None
) -> LiveCamera:
    """A live camera, streaming.

    Args:
        which: its kind, such as "realsense", or kind and serial number or file, such as "openni2:drive.oni"; None for
            the first one that is connected.
        calibration: of the requested images; None for that of the camera.

    Raises:
        DeviceError: no camera is connected, it is denied or in use, or its library is missing; says what to do.
    """
    asked = settings or LiveCameraSettings()
    kind, _, where = (which or "").partition(":")
    if kind and kind not in LIVE_CAMERAS:
        raise DeviceError(f"no camera is called {kind!r}", fix=f"one of {', '.join(LIVE_CAMERAS)}")
    reasons = []
    for name, opener in LIVE_CAMERAS.items():
        if kind in ("", name):
            try:
                return opener(where or None, asked, calibration)
            except DeviceError as error:
                reasons.append(error)
    # An error about a connected device is more useful than that a library found none.
    of_device = why_not(kind or None) if not where else None
    raise of_device or reasons[0]


ANY = "any"


def open_robot_camera(
    which: str, settings: LiveCameraSettings, files: Sequence[StrPath] = (), known: Calibration | None = None
) -> tuple[LiveCamera, Calibration]:
    """A live camera, and the calibration of the robot that carries it.

    Args:
        which: as for `open_live_camera`; "any" for the first one that is connected.
        files: calibrations of the robot. Each replaces parts of the camera's own and of those before it.
        known: the calibration to use instead of all these.

    Raises:
        DeviceError: as `open_live_camera`.
        CalibrationError: a file is not a calibration, or is incomplete.
    """
    asked = known
    if known is None and files:
        with suppress(
            CalibrationError
        ):  # the camera's own calibration may complete the files; else loading both raises
            found = load_calibration(*files)
            asked = None if found.color is None else found
    camera = open_live_camera(None if which == ANY else which, settings, asked)
    try:
        if known is not None:
            return camera, known
        return camera, load_calibration(*files, under=camera.calibration) if files else camera.calibration
    except BaseException:
        camera.close()
        raise


THREAD = "wheelsight-played-camera"
_RATE_OVER = 30
_WAIT_S = 0.05
_UNASKED_S = 2.0
_LATEST_S = 0.1
# Readings of a gyroscope that are kept: ten seconds of the fastest.
_MOST_READINGS = 4000


class PlayedCamera(Closing):
    """A `LiveCamera` that plays recorded frames in real time, to show and test live work without a camera.

    Its stamps are those of the host clock, without error. It pauses while no frames are fetched, as before a run is
    ready, and plays slower where decoding takes too long.

    Args:
        frames: at increasing stamps; skipped ones are left out.
        settings: the number of frames that are kept, and their largest age.
        turns: readings of the camera's gyroscope by the frames' clock, at increasing stamps. They come with the frames,
            from the first one on.
        notes: further warnings.
    """

    def __init__(
        self,
        name: str,
        calibration: Calibration,
        frames: Iterable[RgbdFrame | SkippedFrame],
        settings: LiveCameraSettings | None = None,
        *,
        turns: Sequence[AngularVelocity] = (),
        notes: Sequence[str] = (),
    ) -> None:
        self.name, self.calibration = name, calibration
        self.warnings = (f"{name[0].upper()}{name[1:]} is played as if it were a camera.", *notes)
        self._settings = settings or LiveCameraSettings()
        self._kept: deque[LiveFrame] = deque()
        self._coming = deque(turns)
        self._turns: deque[AngularVelocity] = deque(maxlen=_MOST_READINGS)
        self._arrivals: deque[float] = deque(maxlen=_RATE_OVER)
        self._report = CameraReport(CameraStatus.STARTING, host_clock.now_s())
        self._changed = threading.Condition()
        self._is_over = threading.Event()
        self._asked_s = -math.inf
        self._thread = threading.Thread(target=self._play, args=(frames,), name=THREAD, daemon=True)
        self._thread.start()

    @classmethod
    def opened(cls, where: str | None, settings: LiveCameraSettings, calibration: Calibration | None) -> PlayedCamera:
        """A player of a recording. Raises DeviceError where it has no frames of this calibration."""
        # Loads OpenCV, which other cameras do not need.
        from wheelsight.io.recordings import OpenOptions, camera_angular_velocities, open_recording

        if where is None:
            raise DeviceError("no recording is named", fix="--camera recording:DIR")
        recording = open_recording(Path(where), OpenOptions(topics=settings.topics))
        if not recording.frame_count:
            raise DeviceError("the recording has no images", path=where)
        own = recording.calibration
        if calibration is not None and _sizes(calibration) != _sizes(own):
            problem = f"its images are of {_sizes(own)}, the calibration's of {_sizes(calibration)}"
            raise DeviceError(problem, path=where, fix="leave out --calibration, or give that of this camera")
        turns, notes = camera_angular_velocities(Path(where)) if settings.gyro else ([], [])
        frames = (event for event in recording.events() if isinstance(event, RgbdFrame | SkippedFrame))
        name = f"the recording {recording.name}"
        return cls(name, calibration or own, frames, settings, turns=turns, notes=notes)

    def read(self, timeout_s: float) -> LiveFrame | None:
        """See `LiveCamera`."""
        ends_s = time.monotonic() + timeout_s
        self._asked_s = host_clock.now_s()
        with self._changed:
            while True:
                now_s = host_clock.now_s()
                while self._kept:
                    live = self._kept.popleft()
                    if live.age_s(now_s) <= self._settings.oldest_s:
                        return live
                    self._report = replace(self._report, stale=self._report.stale + 1)
                left_s = ends_s - time.monotonic()
                if left_s <= 0 or self._report.status in (CameraStatus.ENDED, CameraStatus.CLOSED):
                    return None
                self._changed.wait(left_s)

    def take(self) -> list[RgbdFrame | SkippedFrame]:
        """See `LiveCamera`."""
        found: list[RgbdFrame | SkippedFrame] = []
        while (live := self.read(0)) is not None:
            found.append(live.frame)
        return found

    def take_angular_velocities(self) -> list[AngularVelocity]:
        """See `HasGyro`."""
        with self._changed:
            found = list(self._turns)
            self._turns.clear()
        return found

    def report(self) -> CameraReport:
        """See `LiveCamera`."""
        with self._changed:
            span_s = self._arrivals[-1] - self._arrivals[0] if len(self._arrivals) > 1 else 0.0
            return replace(self._report, rate_hz=(len(self._arrivals) - 1) / span_s if span_s > 0 else 0.0)

    def close(self) -> None:
        """See `LiveCamera`."""
        self._is_over.set()
        self._thread.join()
        self._set_status(CameraStatus.CLOSED)

    def _play(self, frames: Iterable[RgbdFrame | SkippedFrame]) -> None:
        """The thread: give each frame at its time."""
        behind_s: float | None = None
        first_s = math.inf
        try:
            for index, frame in enumerate(frames):
                if isinstance(frame, SkippedFrame):
                    continue
                # Wait while no frames are fetched.
                began_s = host_clock.now_s()
                while host_clock.now_s() - self._asked_s > _UNASKED_S and not self._is_over.is_set():
                    self._is_over.wait(_WAIT_S)
                paused_s = host_clock.now_s() - began_s
                behind_s = host_clock.now_s() - frame.stamp_s if behind_s is None else behind_s + paused_s
                behind_s = max(behind_s, host_clock.now_s() - frame.stamp_s - _LATEST_S)
                due_s = frame.stamp_s + behind_s
                if self._is_over.wait(max(due_s - host_clock.now_s(), 0.0)):
                    return
                first_s = min(first_s, frame.stamp_s)
                while self._coming and self._coming[0].stamp_s <= frame.stamp_s:
                    turn = self._coming.popleft()
                    if turn.stamp_s >= first_s:
                        with self._changed:
                            self._turns.append(replace(turn, stamp_s=turn.stamp_s + behind_s))
                self._give(replace(frame, stamp_s=due_s, index=index), frame.stamp_s)
        except RecordingError as error:
            self._report = replace(self._report, detail=error.problem)
        self._set_status(CameraStatus.ENDED)

    def _give(self, frame: RgbdFrame, device_s: float) -> None:
        """Keep a frame for `read`, and drop the oldest where too many are kept."""
        arrived_s = host_clock.now_s()
        with self._changed:
            report = self._report
            if report.status is not CameraStatus.STREAMING:
                report = replace(report, status=CameraStatus.STREAMING, since_s=arrived_s)
            lost = len(self._kept) >= self._settings.kept_frames
            if lost:
                self._kept.popleft()
            self._kept.append(LiveFrame(frame, 0.0, device_s, arrived_s, frame.index))
            self._arrivals.append(arrived_s)
            report = replace(report, frames=report.frames + 1, host_drops=report.host_drops + lost)
            self._report = replace(report, last_stamp_s=frame.stamp_s)
            self._changed.notify_all()

    def _set_status(self, status: CameraStatus) -> None:
        with self._changed:
            self._report = replace(self._report, status=status, since_s=host_clock.now_s())
            self._changed.notify_all()


def _sizes(calibration: Calibration) -> str:
    """The sizes of its images, such as "640×480"."""
    if calibration.color is None:
        return "no camera"
    return " and ".join(dict.fromkeys(f"{camera.width}×{camera.height}" for camera in calibration.cameras))
