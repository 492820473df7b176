"""CameraDriver: what a camera's own file does, its library's calls alone; `StreamingCamera` does all else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from wheelsight.calibration import Calibration
from wheelsight.errors import DeviceError
from wheelsight.geometry import ByteArray, Float32Array
from wheelsight.geometry.arrays import UInt16Array


@dataclass(frozen=True, slots=True)
class OpenedDevice:
    """What a device tells of itself when it was opened.

    Attributes:
        name: kind and serial number, or the file that is played.
        calibration: of the images it will give.
        warnings: what to know before trusting them.
    """

    name: str
    calibration: Calibration
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class DeviceImages:
    """One frame as a device gives it, in memory that the library will not write to again.

    Attributes:
        color: (H, W, 3) uint8, red green blue.
        depth_m: (H, W) float32, metres, 0 where nothing was measured.
        color_s, depth_s: stamps by the device's clock, seconds; None where it has none.
        sequence: the device's number of the frame, or None.
        infrared: (H, W), or None.
    """

    color: ByteArray
    depth_m: Float32Array
    color_s: float | None
    depth_s: float | None
    sequence: int | None
    infrared: UInt16Array | None = None


@dataclass(frozen=True, slots=True)
class DeviceAngularVelocity:
    """A reading of a camera's gyroscope: rad/s about the depth camera's axes at `device_s` by the device's clock."""

    device_s: float
    x_rad_s: float
    y_rad_s: float
    z_rad_s: float


class PlaybackEndedError(DeviceError):
    """The file that a driver plays has no more frames."""


class CameraDriver(Protocol):
    """A camera's library. It is used by one thread at a time, and may be opened again after it was closed."""

    def open(self) -> OpenedDevice:
        """Start streaming. Raises DeviceError where the device is missing, denied, in use or too slow."""

    def read(self, timeout_s: float) -> DeviceImages | None:
        """The next frame, or None if none comes within about `timeout_s` seconds.

        Raises:
            PlaybackEndedError: a file has come to its end.
            DeviceError: the device is gone.
        """

    def close(self) -> None:
        """Give the device back, if it is open; raises nothing."""


@runtime_checkable
class GyroDriver(Protocol):
    """A `CameraDriver` whose camera may have a gyroscope, by the clock that stamps its frames."""

    def take_angular_velocities(self) -> list[DeviceAngularVelocity]:
        """Readings since the last call, in order; none without a gyroscope. Raises DeviceError if it is gone."""
