"""FrameCheck: which of a device's frames are new and whole, when they were taken, and how many are missing."""

from __future__ import annotations

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.devices.camera_clock import CameraClock
from wheelsight.devices.camera_driver import DeviceImages
from wheelsight.devices.live_camera import LiveFrame
from wheelsight.events import RgbdFrame, SkippedFrame
from wheelsight.settings import LiveCameraSettings

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
