"""A live camera made by hand: a test gives it frames, takes it away, and sets what it reports."""

from __future__ import annotations

import queue
from dataclasses import replace
from typing import Self

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import AngularVelocity, RgbdFrame, SkippedFrame
from wheelsight.io.devices import host_clock
from wheelsight.io.devices.live_camera import CameraReport, CameraStatus, LiveFrame

CAMERA = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
CALIBRATION = Calibration.registered_camera(CAMERA, source="the camera itself")


def live_frame(number: int, stamp_s: float, infrared: bool = False, sigma_s: float = 0.001) -> LiveFrame:
    """Frame `number`, whose colour and depth tell its number."""
    color = np.full((48, 64, 3), number % 256, np.uint8)
    depth_m = np.full((48, 64), 1.0 + number / 100, np.float32)
    frame = RgbdFrame(stamp_s, color, depth_m, number, 0.004)
    given = np.full((48, 64), 300 + number, np.uint16) if infrared else None
    return LiveFrame(frame, sigma_s, 100 + number / 30, stamp_s + 0.02, number, given)


class HandFedCamera:
    """A `LiveCamera`; `put` a frame, and it is read once.

    Attributes:
        reported: what `report` says.
        is_closed: whether it was given back.
    """

    def __init__(self, calibration: Calibration = CALIBRATION) -> None:
        self.name, self.calibration = "fake 1", calibration
        self.warnings: tuple[str, ...] = ("It is made by hand.",)
        self.reported = CameraReport(CameraStatus.STREAMING, host_clock.now_s())
        self.is_closed = False
        self._coming: queue.Queue[LiveFrame] = queue.Queue()
        self._turns: queue.Queue[AngularVelocity] = queue.Queue()

    def put(self, live: LiveFrame) -> None:
        self._coming.put(live)

    def tell(self, status: CameraStatus | None = None, **changes: object) -> None:
        """Report something else from now on."""
        self.reported = replace(self.reported, status=status or self.reported.status, **changes)  # type: ignore[arg-type]

    def read(self, timeout_s: float) -> LiveFrame | None:
        try:
            return self._coming.get(timeout=timeout_s) if timeout_s > 0 else self._coming.get_nowait()
        except queue.Empty:
            return None

    def take(self) -> list[RgbdFrame | SkippedFrame]:
        found: list[RgbdFrame | SkippedFrame] = []
        while (live := self.read(0)) is not None:
            found.append(live.frame)
        return found

    def report(self) -> CameraReport:
        return self.reported

    def take_angular_velocities(self) -> list[AngularVelocity]:
        found = []
        while not self._turns.empty():
            found.append(self._turns.get_nowait())
        return found

    def turn(self, *turns: AngularVelocity) -> None:
        """Let its gyroscope tell that."""
        for one in turns:
            self._turns.put(one)

    def close(self) -> None:
        self.is_closed = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
