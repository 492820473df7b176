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
from typing import Protocol, Self, runtime_checkable

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError, DeviceError
from wheelsight.core.geometry.arrays import UInt16Array
from wheelsight.core.messages import AngularVelocity, RgbdFrame, SkippedFrame
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.core.threads import Closing
from wheelsight.io.devices import host_clock
from wheelsight.io.devices.camera_driver import CameraDriver, DeviceImages, GyroDriver, OpenedDevice, PlaybackEndedError
from wheelsight.io.devices.host_clock import CLOCK_LATE_S, CameraClock


@dataclass(frozen=True, slots=True, eq=False)
class LiveFrame:
    """One frame of a live camera, with the uncertainty of its stamp.

    All times but `device_s` are of the host clock (`host_clock.now_s`).

    Attributes:
        frame: the images. `stamp_s` is the time of colour; `index` counts all frames since the camera was opened, lost
            ones included.
        stamp_sigma_s: standard deviation of the mapping from the device's clock to the host's. It excludes the delay
            from exposure to arrival that all frames share, which arrivals cannot show.
        device_s: the stamp by the camera's clock, seconds; None where it has none.
        arrived_s: when the host received the frame.
        sequence: the frame number that the camera gives, or None. Not continuous over a reconnection.
        infrared: raw (H, W), registered to depth; None unless requested.
    """

    frame: RgbdFrame
    stamp_sigma_s: float
    device_s: float | None
    arrived_s: float
    sequence: int | None
    infrared: UInt16Array | None = None

    def age_s(self, now_s: float) -> float:
        """The age of the frame at `now_s`, seconds."""
        return now_s - self.frame.stamp_s


class CameraStatus(StrEnum):
    """The state of a camera."""

    STARTING = "starting: no frame has come yet"
    STREAMING = "streaming"
    STALLED = "stalled: no frame comes"
    UNPLUGGED = "unplugged: waiting for it"
    ENDED = "the recording it plays has ended"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class CameraReport:
    """The state of a camera at one moment. Counts begin when it was opened.

    Attributes:
        since_s: when the status began, host clock; a stall begins with the last frame.
        detail: the last error of the camera's library, or "".
        device_drops: frames lost by the camera or the bus, by gaps in the camera's frame numbers.
        host_drops: frames dropped because they were not fetched.
        stale: frames that were too old when they were fetched.
        refused: duplicates, frames out of order, and frames of a wrong size or type.
        clock_jumps: the number of jumps of the camera's clock; the mapping of stamps then restarts.
        rate_hz: of frames over the last seconds; 0 without frames.
        drift_ppm: of the camera's clock against the host's; positive where it runs faster.
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
    """A camera that streams in a thread of its own until it is closed. `open_live_camera` opens one.

    It keeps the newest few frames and returns each at most once, in order, unless it is too old. An unplugged camera
    yields no frames, and continues after it was plugged in again; `report` shows both.
    """

    @property
    def name(self) -> str:
        """Its model and serial number, or its file."""

    @property
    def calibration(self) -> Calibration:
        """The calibration of its cameras, by the device or its data sheet; `source` says which."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Limitations of its images, one sentence each."""

    def read(self, timeout_s: float) -> LiveFrame | None:
        """The next frame, or None if none comes within `timeout_s` seconds, or the camera ended or is closed."""

    def take(self) -> Sequence[RgbdFrame | SkippedFrame]:
        """Frames since the last call, in order, refused ones with the reason. Does not wait."""

    def report(self) -> CameraReport:
        """The state of the camera, with its counts."""

    def close(self) -> None:
        """Release the camera; may be called twice."""

    def __enter__(self) -> Self:
        """The camera, which the end of the block closes."""

    def __exit__(self, *_: object) -> None:
        """Close the camera."""


@runtime_checkable
class HasGyro(Protocol):
    """A `LiveCamera` that may have a gyroscope."""

    def take_angular_velocities(self) -> Sequence[AngularVelocity]:
        """Readings since the last call, at increasing stamps of the host's clock. Does not wait."""


def take_angular_velocities(camera: object) -> Sequence[AngularVelocity]:
    """The readings of a camera's gyroscope since the last call; empty where it has none."""
    return camera.take_angular_velocities() if isinstance(camera, HasGyro) else ()


_READ_S = 0.1
_RATE_OVER_S = 2.0
# Readings of a gyroscope that are kept: ten seconds of the fastest.
_MOST_READINGS = 4000
# Longest wait for the thread, since a library may hang in a call.
_CLOSING_S = 3.0
_RETRY_S = 0.25  # between two attempts to open a camera that was unplugged, of the 2 s it may take


class StreamingCamera(Closing):
    """A `LiveCamera` of any driver. Use it in a `with` block.

    Args:
        driver: of the camera's library; opened here, and closed with the camera.
        calibration: replaces that of the device; None to use the device's.
        on_status: called with each new status, from the camera's thread.

    Raises:
        DeviceError: the device is missing, denied, in use or too slow.
        CalibrationError: the calibration has another image size or registration than the device.
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
        self.name, self.warnings = self._device.name, self._device.warnings
        try:
            self.calibration = _checked_calibration(calibration, self._device)
        except CalibrationError:
            driver.close()
            raise
        self._check = FrameCheck(self._settings, self.calibration)
        self._ready = threading.Condition()
        self._kept: deque[LiveFrame | SkippedFrame] = deque()
        self._arrivals: deque[float] = deque()
        self._turns: deque[AngularVelocity] = deque(maxlen=_MOST_READINGS)
        self._turned_s = -float("inf")
        self._frames = self._host_drops = self._stale = self._reconnects = 0
        self._last_stamp_s: float | None = None
        self._received_s = self._since_s = host_clock.now_s()
        self._status, self._detail = CameraStatus.STARTING, ""
        self._failure: Exception | None = None
        self._is_closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"camera {self.name}", daemon=True)
        atexit.register(self.close)
        self._thread.start()

    def read(self, timeout_s: float) -> LiveFrame | None:
        """See `LiveCamera`. Raises DeviceError after an unexpected error of the driver."""
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
        """See `LiveCamera`. Raises DeviceError after an unexpected error of the driver."""
        with self._ready:
            found = tuple(self._kept)
            self._kept.clear()
            self._has_ended()
            fresh = (f for f in found if isinstance(f, SkippedFrame) or not self._is_stale(f))
            return [f if isinstance(f, SkippedFrame) else f.frame for f in fresh]

    def take_angular_velocities(self) -> list[AngularVelocity]:
        """See `HasGyro`; empty for a camera without a gyroscope."""
        with self._ready:
            found = list(self._turns)
            self._turns.clear()
        return found

    def report(self) -> CameraReport:
        """See `LiveCamera`; a library that hangs counts as stalled."""
        with self._ready:
            now_s = host_clock.now_s()
            status, since_s = self._status, self._since_s
            is_silent = now_s - self._received_s > self._settings.stall_s
            if is_silent and status in (CameraStatus.STARTING, CameraStatus.STREAMING):
                status, since_s = CameraStatus.STALLED, self._received_s
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
        """See `LiveCamera`."""
        self._is_closing.set()
        with self._ready:
            self._kept.clear()
            self._ready.notify_all()
        if self._thread is not threading.current_thread():
            self._thread.join(_CLOSING_S)
        atexit.unregister(self.close)

    def _run(self) -> None:
        """The thread: read until the camera is closed, or a played file ends."""
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
        except Exception as error:  # `read` and `take` raise it
            self._failure = error
        finally:
            self._driver.close()
            self._set_status(ended)

    def _step(self) -> None:
        """Read a frame and the gyroscope. Raises DeviceError where no frame came for long."""
        images = self._driver.read(_READ_S)
        arrived_s = host_clock.now_s()
        if images is not None:
            self._receive(images, arrived_s)
        turns = self._driver.take_angular_velocities() if isinstance(self._driver, GyroDriver) else ()
        for turn in turns:
            # Its stamps are mapped as those of frames. Stamps that decrease are left out.
            stamp_s = self._check.clock.host_s(turn.device_s)
            if stamp_s is not None and stamp_s > self._turned_s:
                self._turned_s = stamp_s
                with self._ready:
                    self._turns.append(AngularVelocity(stamp_s, turn.x_rad_s, turn.y_rad_s, turn.z_rad_s))
        if images is not None:
            return
        if arrived_s - self._received_s > self._settings.reopen_s:
            raise DeviceError(f"no frame came for {arrived_s - self._received_s:.1f} s")
        if arrived_s - self._received_s > self._settings.stall_s:
            self._set_status(CameraStatus.STALLED, since_s=self._received_s)

    def _receive(self, images: DeviceImages, arrived_s: float) -> None:
        """Keep a frame if it is new, and drop the oldest ones where too many are kept."""
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
            self._received_s = arrived_s
            self._ready.notify_all()
        self._set_status(CameraStatus.STREAMING)

    def _wait_for_device(self, reason: DeviceError) -> None:
        """Close a device that failed, and open it as soon as it is back."""
        self._driver.close()
        self._detail = str(reason)
        self._set_status(CameraStatus.UNPLUGGED)
        while not self._is_closing.wait(_RETRY_S):
            try:
                device = self._driver.open()
            except DeviceError as error:
                self._detail = str(error)
                continue
            if device.name != self._device.name:
                self._detail = f"another camera is there: {device.name}, not {self._device.name}"
            elif device.calibration.cameras != self._device.calibration.cameras:
                self._detail = "the camera came back with images of another calibration"
            else:
                break
            self._driver.close()
        else:
            return
        with self._ready:
            self._reconnects += 1
            self._detail = ""
            self._check.replugged()
            self._received_s = host_clock.now_s()
        self._set_status(CameraStatus.STARTING)

    def _is_stale(self, frame: LiveFrame) -> bool:
        """Whether a frame is too old, which is counted."""
        is_stale = frame.age_s(host_clock.now_s()) > self._settings.oldest_s
        self._stale += is_stale
        return is_stale

    def _has_ended(self) -> bool:
        """Whether no further frame will come. Raises DeviceError after an unexpected error of the driver."""
        if self._failure is not None:
            raise DeviceError(f"the camera's driver failed: {self._failure}") from self._failure
        return self._is_closing.is_set() or self._status in (CameraStatus.ENDED, CameraStatus.CLOSED)

    def _set_status(self, status: CameraStatus, since_s: float | None = None) -> None:
        """Change the status and call `on_status`, unless the status is the same."""
        with self._ready:
            if status is self._status:
                return
            self._status, self._since_s = status, host_clock.now_s() if since_s is None else since_s
            self._ready.notify_all()
        if self._on_status is not None:
            self._on_status(status)


def _checked_calibration(calibration: Calibration | None, device: OpenedDevice) -> Calibration:
    """The given calibration, or the device's. Raises CalibrationError where image size or registration differ."""
    known = device.calibration
    if calibration is None:
        return known
    for name, given, own in zip(("colour", "depth"), calibration.cameras, known.cameras, strict=True):
        if (given.width, given.height) != (own.width, own.height):
            problem = f"the calibration's {name} image is {given.width}×{given.height}, the camera's"
            fix = "request that size, or calibrate at this one"
            raise CalibrationError(f"{problem} {own.width}×{own.height}", fix=fix)
    if calibration.is_registered != known.is_registered:
        has, gives = ("has no", "does not register") if calibration.is_registered else ("has a", "registers")
        problem = f"the calibration {has} T_color_depth, but the camera {gives} depth to colour"
        raise CalibrationError(
            problem, fix=f"camera.registered: {str(calibration.is_registered).lower()}, or calibrate"
        )
    return calibration


# Consecutive older frames that the bus may deliver out of order; more mean that a clock or a counter was set back.
_MOST_OUT_OF_ORDER = 3


class FrameCheck:
    """Validates and stamps frames in order of arrival, counts missing ones, and corrects depth by the calibration.

    Attributes:
        lost: frames missing in the device's frame numbers.
        refused: duplicates, frames out of order, and frames of a wrong size or type.
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
        """The stamped frame, or why it is invalid; None where it is not new."""
        if self._is_old(images):
            self.refused += 1
            return None
        missing = 0
        if images.sequence is not None and self._sequence is not None:
            missing = images.sequence - self._sequence - 1
            most = 2 * self._settings.rate_hz * (arrived_s - self._arrived_s) + self._settings.rate_hz
            missing = missing if 0 < missing <= most else 0  # else the numbers were reset
        self.lost += missing
        index = self._index + missing
        self._index = index + 1
        stamp_s, sigma_s = self.clock.stamp(images.color_s, arrived_s)
        self._device_s, self._sequence, self._arrived_s = images.color_s, images.sequence, arrived_s
        if wrong := self._why_wrong(images):
            self.refused += 1
            return SkippedFrame(stamp_s, wrong, index)
        late_s = 0.0 if images.color_s is None or images.depth_s is None else images.depth_s - images.color_s
        depth_m = self._depth_error.corrected(images.depth_m, self._depth)
        frame = RgbdFrame(stamp_s, images.color, depth_m, index, late_s)
        return LiveFrame(frame, sigma_s, images.color_s, arrived_s, images.sequence, images.infrared)

    def replugged(self) -> None:
        """Reset after a reconnection: the device's clock and frame numbers start again."""
        self.clock.restart()
        self._device_s = self._sequence = None
        self._older = 0

    def _is_old(self, images: DeviceImages) -> bool:
        """Whether a frame is a duplicate, or older than the last one. A clock that was set back resets the check."""
        if images.color_s is not None and self._device_s is not None:
            behind = self._device_s - images.color_s
            is_set_back = behind > CLOCK_LATE_S
        elif images.sequence is not None and self._sequence is not None:
            behind = float(self._sequence - images.sequence)
            is_set_back = behind > self._settings.rate_hz * CLOCK_LATE_S
        else:
            return False
        self._older = self._older + 1 if behind > 0 else 0
        if is_set_back or self._older > _MOST_OUT_OF_ORDER:
            self.clock.jumps += images.color_s is not None
            self.replugged()
            return False
        return behind >= 0

    def _why_wrong(self, images: DeviceImages) -> str:
        """The error of an image's size or type; "" without one."""
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


GONE = (CameraStatus.STALLED, CameraStatus.UNPLUGGED, CameraStatus.ENDED)


class CameraWatch:
    """Reports changes of a camera's state in sentences. Starting and streaming are not reported."""

    def __init__(self, camera: LiveCamera) -> None:
        self._camera = camera
        self._before: CameraReport | None = None

    def changes(self) -> list[str]:
        """Changes since the last call, each a sentence that begins with the camera's name."""
        before, now = self._before, self._camera.report()
        self._before = now
        changes = []
        if now.status in GONE and (before is None or now.status is not before.status):
            changes.append(f"{now.status}{f' ({now.detail})' if now.detail else ''}")
        elif before is not None and before.status in GONE and now.status is CameraStatus.STREAMING:
            changes.append("is back")
        if before is not None and now.clock_jumps > before.clock_jumps:
            changes.append("its clock jumped; the mapping of its stamps restarts")
        return [f"{self._camera.name}: {text}" for text in changes]
