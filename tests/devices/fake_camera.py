"""A camera made by hand: a driver to which a test hands frames, and which it unplugs."""

from __future__ import annotations

import queue
import threading
from dataclasses import dataclass, field

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import DeviceError
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices.camera_driver import DeviceImages, OpenedDevice, PlaybackEndedError

CAMERA = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
# Times short enough for a test, in the defaults' proportions.
QUICK = LiveCameraSettings(stall_s=0.1, reopen_s=0.4, rate_hz=30, kept_frames=100)


def images(
    number: int, device_s: float | None = None, *, period_s: float = 1 / 30, size: tuple[int, int] = (48, 64)
) -> DeviceImages:
    """Frame `number`, whose colour shows its number; by the device's clock at `device_s`, or at its number's time."""
    color = np.full((*size, 3), number % 256, np.uint8)
    depth_m = np.full(size, 1.0 + number / 100, np.float32)
    color_s = number * period_s if device_s is None else device_s
    return DeviceImages(color, depth_m, color_s, color_s + 0.004, number)


@dataclass
class FakeDriver:
    """What a test puts into `coming` is read: images, None for a wait without any, or an error to raise."""

    name: str = "fake 1"
    calibration: Calibration = field(default_factory=lambda: Calibration.registered_camera(CAMERA))
    coming: queue.Queue[DeviceImages | Exception] = field(default_factory=queue.Queue)
    opened: int = 0
    closed: int = 0
    is_there: threading.Event = field(default_factory=threading.Event)
    hangs: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        self.is_there.set()

    def open(self) -> OpenedDevice:
        if not self.is_there.is_set():
            raise DeviceError("no camera is plugged in", fix="plug it in")
        self.opened += 1
        return OpenedDevice(self.name, self.calibration, ("it is made by hand",))

    def read(self, timeout_s: float) -> DeviceImages | None:
        if self.hangs.is_set():
            threading.Event().wait(30)
        if not self.is_there.is_set():
            raise DeviceError("the camera was unplugged")
        try:
            found = self.coming.get(timeout=min(timeout_s, 0.02))
        except queue.Empty:
            return None
        if isinstance(found, Exception):
            raise found
        return found

    def close(self) -> None:
        self.closed += 1

    def give(self, *found: DeviceImages | Exception) -> None:
        for one in found:
            self.coming.put(one)

    def end(self) -> None:
        self.give(PlaybackEndedError("the file is over"))
