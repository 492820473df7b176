"""`LiveCamera`, the interface of every connected camera, and `StreamingCamera`, which runs any driver in a thread
and reconnects. `FrameCheck` stamps frames and counts those that are missing.
"""

from __future__ import annotations

import atexit
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError, DeviceError
from wheelsight.core.geometry.arrays import UInt16Array
from wheelsight.core.messages import AngularVelocity, RgbdFrame, SkippedFrame
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices import host_clock
from wheelsight.io.devices.camera_driver import CameraDriver, DeviceImages, GyroDriver, OpenedDevice, PlaybackEndedError
from wheelsight.io.devices.host_clock import CameraClock

# LiveCamera: what every camera that is plugged in offers, whatever its library; and what is known of each frame.


@dataclass(frozen=True, slots=True, eq=False)
class LiveFrame:
    """One frame of a live camera, and when and how surely it was taken.

    All times but `device_s` are of the one host clock (`host_clock.now_s`).

    Attributes:
        frame: the images; its `stamp_s` is when colour was taken, its `index` counts the frames the camera took since
            it was opened, lost ones included.
        stamp_sigma_s: standard deviation of the mapping from the device's clock to the host's. A delay that all frames
            share, from exposure to arrival, is not in it: no observer of arrivals can tell that one.
        device_s: the camera's own stamp, in seconds of its own clock; None where it has none.
        arrived_s: when the host was handed the frame.
        sequence: the camera's own number of the frame; None where it has none. Not continuous over a reconnection.
        infrared: (H, W) as the sensor gives it, on the depth image's pixels; None where it was not asked for.
    """

    frame: RgbdFrame
    stamp_sigma_s: float
    device_s: float | None
    arrived_s: float
    sequence: int | None
    infrared: UInt16Array | None = None

    def age_s(self, now_s: float) -> float:
        """How long before `now_s` it was taken."""
        return now_s - self.frame.stamp_s


class CameraStatus(StrEnum):
    """How a camera is doing."""

    STARTING = "starting: no frame has come yet"
    STREAMING = "streaming"
    STALLED = "stalled: no frame comes"
    UNPLUGGED = "unplugged: waiting for it"
    ENDED = "the recording it plays has ended"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class CameraReport:
    """How a camera is doing at one moment. Counts are since it was opened.

    Attributes:
        status: now.
        since_s: since when it has been so, host clock; a stall counts from the last frame.
        detail: what the camera's library said last of a failure, or "".
        frames: that were kept for whoever asks.
        device_drops: that the camera or the bus lost, by gaps in the camera's numbers.
        host_drops: that were dropped since nobody fetched them.
        stale: that were too old when they were fetched.
        refused: that were duplicates, out of order, or of a wrong size or kind.
        reconnects: how often the camera went away and came again.
        clock_jumps: how often the camera's clock leapt; stamps were mapped anew.
        rate_hz: of frames over the last seconds; 0 where none came.
        drift_ppm: how much faster than the host's the camera's clock runs.
        last_stamp_s: of the newest frame; None before the first.
    """

    status: CameraStatus
    since_s: float
    detail: str = ""
    frames: int = 0
    device_drops: int = 0
    host_drops: int = 0
    stale: int = 0
    refused: int = 0
    reconnects: int = 0
    clock_jumps: int = 0
    rate_hz: float = 0.0
    drift_ppm: float = 0.0
    last_stamp_s: float | None = None


@runtime_checkable
class LiveCamera(Protocol):
    """A camera that streams on a thread of its own, from when it was opened until it is closed.

    The newest few frames are kept; nothing is handed out twice, nor out of order, nor when it is older than asked for.
    A camera that is unplugged yields nothing, and goes on by itself when it is there again; `report` tells both.
    It is opened by `open_live_camera`.
    """

    @property
    def name(self) -> str:
        """Its kind and serial number or file, for people."""

    @property
    def calibration(self) -> Calibration:
        """Of its cameras, as the device or its data sheet tells; the source says which."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know before trusting its images, one sentence each."""

    def read(self, timeout_s: float) -> LiveFrame | None:
        """The next frame, or None if none comes within `timeout_s` seconds, or the camera has ended or is closed."""

    def take(self) -> Sequence[RgbdFrame | SkippedFrame]:
        """What came since the last call, in order, refused frames with the reason; waits for none."""

    def report(self) -> CameraReport:
        """Everything a person may want to see."""

    def close(self) -> None:
        """Give the camera back; may be called twice."""

    def __enter__(self) -> Self:
        """Itself, to be closed at the block's end."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""


@runtime_checkable
class HasGyro(Protocol):
    """A `LiveCamera` that may carry a gyroscope."""

    def take_angular_velocities(self) -> Sequence[AngularVelocity]:
        """Readings since the last call, at growing stamps of the host's clock; waits for none."""


def take_angular_velocities(camera: object) -> Sequence[AngularVelocity]:
    """Of a camera that may be none with a gyroscope; nothing then."""
    return camera.take_angular_velocities() if isinstance(camera, HasGyro) else ()


# StreamingCamera: a `LiveCamera` of any driver: its thread, queue, counts and clock, and how it reconnects.


_READ_S = 0.1
_RATE_OVER_S = 2.0
# Readings of a gyroscope for whoever asks late: ten seconds of the fastest.
_MOST_READINGS = 4000
# A library that hangs in a call is left behind rather than waited for.
_CLOSING_S = 3.0


class StreamingCamera:
    """A `LiveCamera`; use it in a `with` block.

    Args:
        driver: of the camera's library; opened here, and closed with the camera.
        settings: see `LiveCameraSettings`.
        calibration: to go by in place of what the device tells; None for that.
        on_status: called with each new status, from the camera's thread.

    Raises:
        DeviceError: the device is missing, denied, in use or too slow.
        CalibrationError: the calibration is of images of another size, or otherwise registered.
    """

    def __init__(
        self,
        driver: CameraDriver,
        settings: LiveCameraSettings | None = None,
        calibration: Calibration | None = None,
        on_status: Callable[[CameraStatus], None] | None = None,
    ) -> None:
        self._driver, self._settings, self._on_status = driver, settings or LiveCameraSettings(), on_status
        self._device = driver.open()
        try:
            self._calibration = _to_go_by(calibration, self._device)
        except CalibrationError:
            driver.close()
            raise
        self._check = FrameCheck(self._settings, self._calibration)
        self._ready = threading.Condition()
        self._kept: deque[LiveFrame | SkippedFrame] = deque()
        self._arrivals: deque[float] = deque()
        self._turns: deque[AngularVelocity] = deque(maxlen=_MOST_READINGS)
        self._turned_s = -float("inf")
        self._frames = self._host_drops = self._stale = self._reconnects = 0
        self._last_stamp_s: float | None = None
        self._heard_s = self._since_s = host_clock.now_s()
        self._status, self._detail = CameraStatus.STARTING, ""
        self._failure: Exception | None = None
        self._is_closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"camera {self.name}", daemon=True)
        atexit.register(self.close)
        self._thread.start()

    @property
    def name(self) -> str:
        """As `LiveCamera` has it."""
        return self._device.name

    @property
    def calibration(self) -> Calibration:
        """As it was given, or as the device tells."""
        return self._calibration

    @property
    def warnings(self) -> tuple[str, ...]:
        """As the device tells."""
        return self._device.warnings

    def read(self, timeout_s: float) -> LiveFrame | None:
        """As `LiveCamera` has it. Raises DeviceError where the driver failed as no driver may."""
        ends_s = time.monotonic() + timeout_s
        with self._ready:
            while True:
                while self._kept:
                    found = self._kept.popleft()
                    if isinstance(found, LiveFrame) and not self._is_stale(found):
                        return found
                left_s = ends_s - time.monotonic()
                if left_s <= 0 or self._has_ended():
                    return None
                self._ready.wait(left_s)

    def take(self) -> list[RgbdFrame | SkippedFrame]:
        """As `LiveCamera` has it. Raises DeviceError where the driver failed as no driver may."""
        with self._ready:
            found = tuple(self._kept)
            self._kept.clear()
            self._has_ended()
            fresh = (f for f in found if isinstance(f, SkippedFrame) or not self._is_stale(f))
            return [f if isinstance(f, SkippedFrame) else f.frame for f in fresh]

    def take_angular_velocities(self) -> list[AngularVelocity]:
        """As `HasGyro` has it; none of a camera without a gyroscope."""
        with self._ready:
            found = list(self._turns)
            self._turns.clear()
        return found

    def report(self) -> CameraReport:
        """As `LiveCamera` has it; a library that hangs is told as stalled."""
        with self._ready:
            now_s = host_clock.now_s()
            status, since_s = self._judged(now_s)
            recent = [arrival_s for arrival_s in self._arrivals if now_s - arrival_s < _RATE_OVER_S]
            return CameraReport(
                status=status,
                since_s=since_s,
                detail=self._detail,
                frames=self._frames,
                device_drops=self._check.lost,
                host_drops=self._host_drops,
                stale=self._stale,
                refused=self._check.refused,
                reconnects=self._reconnects,
                clock_jumps=self._check.clock.jumps,
                rate_hz=(len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 else 0.0,
                drift_ppm=self._check.clock.drift_ppm,
                last_stamp_s=self._last_stamp_s,
            )

    def close(self) -> None:
        """Give the camera back; may be called twice."""
        self._is_closing.set()
        with self._ready:
            self._kept.clear()
            self._ready.notify_all()
        if self._thread is not threading.current_thread():
            self._thread.join(_CLOSING_S)
        atexit.unregister(self.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        """The thread: read until closed, or until a played file ends."""
        ended = CameraStatus.CLOSED
        try:
            while not self._is_closing.is_set():
                try:
                    self._step()
                except PlaybackEndedError:
                    ended = CameraStatus.ENDED
                    break
                except DeviceError as error:
                    self._wait_for_device(error)
        except Exception as error:  # of a driver: told to whoever asks for frames, not lost with the thread
            self._failure = error
        finally:
            self._driver.close()
            self._tell(ended)

    def _step(self) -> None:
        images = self._driver.read(_READ_S)
        arrived_s = host_clock.now_s()
        if images is not None:
            self._receive(images, arrived_s)
        self._hear_gyro()
        if images is not None:
            return
        if arrived_s - self._heard_s > self._settings.reopen_s:
            raise DeviceError(f"no frame came for {arrived_s - self._heard_s:.1f} s")
        if arrived_s - self._heard_s > self._settings.stall_s:
            self._tell(CameraStatus.STALLED, since_s=self._heard_s)

    def _receive(self, images: DeviceImages, arrived_s: float) -> None:
        found = self._check.checked(images, arrived_s)
        if found is None:
            return
        with self._ready:
            self._kept.append(found)
            while len(self._kept) > self._settings.kept_frames:
                self._host_drops += isinstance(self._kept.popleft(), LiveFrame)
            if isinstance(found, LiveFrame):
                self._frames += 1
                self._last_stamp_s = found.frame.stamp_s
                self._arrivals.append(arrived_s)
                while arrived_s - self._arrivals[0] > _RATE_OVER_S:
                    self._arrivals.popleft()
            self._heard_s = arrived_s
            self._ready.notify_all()
        self._tell(CameraStatus.STREAMING)

    def _hear_gyro(self) -> None:
        """Its readings by the clock that frames have told of; what a corrected mapping sets back is left out."""
        if not isinstance(self._driver, GyroDriver):
            return
        for told in self._driver.take_angular_velocities():
            stamp_s = self._check.clock.host_s(told.device_s)
            if stamp_s is not None and stamp_s > self._turned_s:
                self._turned_s = stamp_s
                with self._ready:
                    self._turns.append(AngularVelocity(stamp_s, told.x_rad_s, told.y_rad_s, told.z_rad_s))

    def _wait_for_device(self, reason: DeviceError) -> None:
        """After the device went away: open it again as soon as it is there."""
        self._driver.close()
        self._detail = str(reason)
        self._tell(CameraStatus.UNPLUGGED)
        while not self._is_closing.wait(self._settings.retry_s):
            try:
                device = self._driver.open()
            except DeviceError as error:
                self._detail = str(error)
                continue
            wrong = _why_another(device, self._device)
            if wrong is None:
                break
            self._driver.close()
            self._detail = wrong
        else:
            return
        with self._ready:
            self._reconnects += 1
            self._detail = ""
            self._check.replugged()
            self._heard_s = host_clock.now_s()
        self._tell(CameraStatus.STARTING)

    def _judged(self, now_s: float) -> tuple[CameraStatus, float]:
        is_silent = now_s - self._heard_s > self._settings.stall_s
        if is_silent and self._status in (CameraStatus.STARTING, CameraStatus.STREAMING):
            return CameraStatus.STALLED, self._heard_s
        return self._status, self._since_s

    def _is_stale(self, frame: LiveFrame) -> bool:
        is_stale = frame.age_s(host_clock.now_s()) > self._settings.oldest_s
        self._stale += is_stale
        return is_stale

    def _has_ended(self) -> bool:
        """Whether no frame will come any more. Raises DeviceError where that is for a fault of the driver's."""
        if self._failure is not None:
            raise DeviceError(f"the camera's driver failed: {self._failure}") from self._failure
        return self._is_closing.is_set() or self._status in (CameraStatus.ENDED, CameraStatus.CLOSED)

    def _tell(self, status: CameraStatus, since_s: float | None = None) -> None:
        with self._ready:
            if status is self._status:
                return
            self._status, self._since_s = status, host_clock.now_s() if since_s is None else since_s
            self._ready.notify_all()
        if self._on_status is not None:
            self._on_status(status)


def _to_go_by(calibration: Calibration | None, device: OpenedDevice) -> Calibration:
    """The calibration given, if it can be that of the device's images. Raises CalibrationError."""
    told = device.calibration
    if calibration is None:
        return told
    for name, given, own in zip(("colour", "depth"), calibration.cameras, told.cameras, strict=True):
        if (given.width, given.height) != (own.width, own.height):
            problem = f"the calibration's {name} image is {given.width}×{given.height}, the camera's"
            fix = "ask for that size, or calibrate at this one"
            raise CalibrationError(f"{problem} {own.width}×{own.height}", fix=fix)
    if calibration.is_registered != told.is_registered:
        has, gives = ("has no", "does not register") if calibration.is_registered else ("has a", "registers")
        problem = f"the calibration {has} T_color_depth, but the camera {gives} depth to colour"
        raise CalibrationError(
            problem, fix=f"camera.registered: {str(calibration.is_registered).lower()}, or calibrate"
        )
    return calibration


def _why_another(found: OpenedDevice, first: OpenedDevice) -> str | None:
    """What tells that a device is not the one that was opened first; None where nothing does."""
    if found.name != first.name:
        return f"another camera is there: {found.name}, not {first.name}"
    if any(a != b for a, b in zip(found.calibration.cameras, first.calibration.cameras, strict=True)):
        return "the camera came back with images of another calibration"
    return None


# FrameCheck: which of a device's frames are new and whole, when they were taken, and how many are missing.


# So many older frames in a row are no mix-up of a bus, but a clock or a count that was set back.
_MOST_OUT_OF_ORDER = 3


class FrameCheck:
    """Takes frames in the order in which they come, and frees depth of the errors that the calibration states.

    Attributes:
        clock: of the device.
        lost: frames that the device numbered and never gave.
        refused: duplicates, frames out of order, and those of a wrong size or kind.
    """

    def __init__(self, settings: LiveCameraSettings, calibration: Calibration) -> None:
        self.clock = CameraClock(settings)
        self.lost = self.refused = 0
        self._settings = settings
        self._color, self._depth = calibration.cameras
        self._depth_error = calibration.depth_error
        self._index = self._older = 0
        self._device_s: float | None = None
        self._sequence: int | None = None
        self._arrived_s = 0.0

    def checked(self, images: DeviceImages, arrived_s: float) -> LiveFrame | SkippedFrame | None:
        """The frame with its stamp, or why it cannot be used; None where it is none that is new."""
        if self._is_old(images):
            self.refused += 1
            return None
        missing = self._missing(images.sequence, arrived_s)
        self.lost += missing
        index = self._index + missing
        self._index = index + 1
        stamp = self.clock.stamp(images.color_s, arrived_s)
        self._device_s, self._sequence, self._arrived_s = images.color_s, images.sequence, arrived_s
        if wrong := self._why_wrong(images):
            self.refused += 1
            return SkippedFrame(stamp.stamp_s, wrong, index)
        late_s = 0.0 if images.color_s is None or images.depth_s is None else images.depth_s - images.color_s
        depth_m = self._depth_error.corrected(images.depth_m, self._depth)
        frame = RgbdFrame(stamp.stamp_s, images.color, depth_m, index, late_s)
        return LiveFrame(frame, stamp.sigma_s, images.color_s, arrived_s, images.sequence, images.infrared)

    def replugged(self) -> None:
        """The device went away and came again: its clock and its numbers begin anew."""
        self.clock.restart()
        self._device_s = self._sequence = None
        self._older = 0

    def _is_old(self, images: DeviceImages) -> bool:
        """Whether it is a duplicate, or older than the last; where the device's clock was set back, it is not."""
        if images.color_s is not None and self._device_s is not None:
            behind = self._device_s - images.color_s
            is_set_back = behind > self._settings.clock_late_s
        elif images.sequence is not None and self._sequence is not None:
            behind = float(self._sequence - images.sequence)
            is_set_back = behind > self._settings.rate_hz * self._settings.clock_late_s
        else:
            return False
        self._older = self._older + 1 if behind > 0 else 0
        if is_set_back or self._older > _MOST_OUT_OF_ORDER:
            self.clock.jumps += images.color_s is not None
            self.replugged()
            return False
        return behind >= 0

    def _missing(self, sequence: int | None, arrived_s: float) -> int:
        """Frames between the last and this one; none where there cannot be so many, since numbers began anew."""
        if sequence is None or self._sequence is None:
            return 0
        missing = sequence - self._sequence - 1
        most = 2 * self._settings.rate_hz * (arrived_s - self._arrived_s) + self._settings.rate_hz
        return missing if 0 < missing <= most else 0

    def _why_wrong(self, images: DeviceImages) -> str:
        """What is wrong with sizes and types; "" where nothing is."""
        for name, image, camera, kind in (
            ("colour", images.color, self._color, np.uint8),
            ("depth", images.depth_m, self._depth, np.float32),
        ):
            expected = (camera.height, camera.width, *((3,) if kind is np.uint8 else ()))
            if image.shape != expected:
                is_size = "×".join(map(str, image.shape))
                return f"{name} image is {is_size}, not {'×'.join(map(str, expected))} (rows first)"
            if image.dtype != kind:
                return f"{name} image is of {image.dtype}, not {np.dtype(kind)}"
        return ""


# CameraWatch: what has changed with a live camera since the last look, in sentences for a person.


GONE = (CameraStatus.STALLED, CameraStatus.UNPLUGGED, CameraStatus.ENDED)


class CameraWatch:
    """Looks at a camera again and again; one that starts and streams goes without saying."""

    def __init__(self, camera: LiveCamera) -> None:
        self._camera = camera
        self._before: CameraReport | None = None

    def changes(self) -> list[str]:
        """Since the last call, each with the camera's name before it."""
        before, now = self._before, self._camera.report()
        self._before = now
        return [f"{self._camera.name}: {text}" for text in _changes(before, now)]


def _changes(before: CameraReport | None, now: CameraReport) -> list[str]:
    if before is None:
        return [_told(now)] if now.status in GONE else []
    told = []
    if now.status is not before.status and now.status in GONE:
        told.append(_told(now))
    elif before.status in GONE and now.status is CameraStatus.STREAMING:
        told.append("is back")
    if now.clock_jumps > before.clock_jumps:
        told.append("its clock leapt; its stamps are mapped anew")
    return told


def _told(report: CameraReport) -> str:
    return f"{report.status}{f' ({report.detail})' if report.detail else ''}"
