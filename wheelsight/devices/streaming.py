"""StreamingCamera: a `LiveCamera` of any driver: its thread, queue, counts and clock, and how it reconnects."""

from __future__ import annotations

import atexit
import threading
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Self

from wheelsight.calibration import Calibration
from wheelsight.devices import host_clock
from wheelsight.devices.camera_driver import CameraDriver, DeviceImages, GyroDriver, OpenedDevice, PlaybackEndedError
from wheelsight.devices.frame_check import FrameCheck
from wheelsight.devices.live_camera import CameraReport, CameraStatus, LiveFrame
from wheelsight.errors import CalibrationError, DeviceError
from wheelsight.events import AngularVelocity, RgbdFrame, SkippedFrame
from wheelsight.settings import LiveCameraSettings

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
