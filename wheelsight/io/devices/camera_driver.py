"""`CameraDriver`, the interface to the library of a camera, and what drivers share: pairing of colour and depth, USB
devices, and loading of C libraries.
"""

from __future__ import annotations

import ctypes
import os
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import DeviceError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import ByteArray, Float32Array
from wheelsight.core.geometry.arrays import UInt16Array


class CameraDriver(Protocol):
    """The interface to a camera's library; `StreamingCamera` does the rest.

    One thread at a time uses it. It may be opened again after it was closed.
    """

    def open(self) -> OpenedDevice:
        """Start streaming. Raises DeviceError where the device is missing, denied, in use or too slow."""

    def read(self, timeout_s: float) -> DeviceImages | None:
        """The next frame, or None if none comes within about `timeout_s` seconds.

        Raises:
            PlaybackEndedError: the end of a played file.
            DeviceError: the device is gone.
        """

    def close(self) -> None:
        """Release the device, if it is open. Does not raise."""


@runtime_checkable
class GyroDriver(Protocol):
    """A `CameraDriver` of a camera that may have a gyroscope, with the clock of its frames."""

    def take_angular_velocities(self) -> list[DeviceAngularVelocity]:
        """Readings since the last call, in order; empty without a gyroscope. Raises DeviceError."""


@dataclass(frozen=True, slots=True)
class OpenedDevice:
    """A device that was opened.

    Attributes:
        name: model and serial number, or the file that is played.
    """

    name: str
    calibration: Calibration
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class DeviceImages:
    """One frame of a device, in memory that the library does not overwrite.

    Attributes:
        color: (H, W, 3) uint8, RGB.
        depth_m: (H, W) float32, metres, 0 where there is no measurement.
        color_s, depth_s: stamps by the device's clock, seconds; None where it has none.
        sequence: the frame number of the device, or None.
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


# Pairing of colour and depth

T = TypeVar("T")

# Images that wait for a partner, at most: the other stream may have stopped.
_MOST_WAITING = 8
_PAIR_GAP_S = 0.02  # over half of a period at 30 Hz, under one


class Stamped(NamedTuple, Generic[T]):
    """An item with its time."""

    stamp_s: float
    what: T


class FramePairs(Generic[T]):
    """Pairs the images of two streams, each in order of time. Drops images without a partner within `gap_s` seconds."""

    def __init__(self, gap_s: float = _PAIR_GAP_S) -> None:
        self._gap_s = gap_s
        self._color: deque[Stamped[T]] = deque()
        self._depth: deque[Stamped[T]] = deque()

    def add_color(self, stamp_s: float, image: T) -> tuple[Stamped[T], Stamped[T]] | None:
        """Add a colour image. Returns the next pair, if there is one."""
        _append(self._color, Stamped(stamp_s, image))
        return self._pair()

    def add_depth(self, stamp_s: float, image: T) -> tuple[Stamped[T], Stamped[T]] | None:
        """Add a depth image. Returns the next pair, if there is one."""
        _append(self._depth, Stamped(stamp_s, image))
        return self._pair()

    def _pair(self) -> tuple[Stamped[T], Stamped[T]] | None:
        while self._color and self._depth:
            late_s = self._depth[0].stamp_s - self._color[0].stamp_s
            if abs(late_s) <= self._gap_s:
                return self._color.popleft(), self._depth.popleft()
            (self._color if late_s > 0 else self._depth).popleft()
        return None


def _append(images: deque[Stamped[T]], image: Stamped[T]) -> None:
    """Append an image. Drops earlier images where the clock was set back."""
    if images and image.stamp_s < images[-1].stamp_s:
        images.clear()
    images.append(image)
    while len(images) > _MOST_WAITING:
        images.popleft()


# USB devices, from the files of the Linux kernel

_SYSTEM, _NODES, _PROCESSES = Path("/sys/bus/usb/devices"), Path("/dev/bus/usb"), Path("/proc")
USB_3_MBIT = 5000.0


@dataclass(frozen=True, slots=True)
class UsbDevice:
    """A USB device.

    Attributes:
        name: its product name; may be "".
        serial: its serial number; may be "".
        speed_mbit: of its connection, megabits per second; 480 for USB 2, 5000 and more for USB 3.
    """

    vendor: int
    product: int
    name: str
    serial: str
    speed_mbit: float
    node: Path

    @property
    def is_usable(self) -> bool:
        """Whether this user has permission to open it."""
        return os.access(self.node, os.R_OK | os.W_OK)


def usb_devices(system: StrPath = _SYSTEM, nodes: StrPath = _NODES) -> list[UsbDevice]:
    """All USB devices, in order of bus and number; empty without the kernel's files, as in a container."""
    found = []
    for folder in sorted(Path(system).glob("*")):
        with suppress(OSError, ValueError):
            vendor, product = (int(_text(folder, name), 16) for name in ("idVendor", "idProduct"))
            bus, number = (int(_text(folder, name)) for name in ("busnum", "devnum"))
            name, serial = (_text(folder, name, "") for name in ("product", "serial"))
            speed_mbit = float(_text(folder, "speed", "0"))
            node = Path(nodes) / f"{bus:03}" / f"{number:03}"
            found.append(UsbDevice(vendor, product, name, serial, speed_mbit, node))
    return sorted(found, key=lambda device: device.node)


def udev_rule(vendor: int) -> str:
    """The command that lets every user open a vendor's devices."""
    rule = f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vendor:04x}", MODE="0666"'
    file = f"/etc/udev/rules.d/60-wheelsight-{vendor:04x}.rules"
    return f"echo '{rule}' | sudo tee {file} && sudo udevadm control --reload, then plug it in again"


def users_of(node: StrPath, processes: StrPath = _PROCESSES) -> list[str]:
    """Programs of this user that have a file open, as "name (pid 12)"."""
    wanted, own = os.path.realpath(node), str(os.getpid())
    found = []
    for folder in sorted(Path(processes).glob("[0-9]*")):
        with suppress(OSError):
            is_open = any(os.path.realpath(handle) == wanted for handle in (folder / "fd").iterdir())
            if is_open and folder.name != own:
                found.append(f"{_text(folder, 'comm', 'a program')} (pid {folder.name})")
    return found


def _text(folder: Path, name: str, otherwise: str | None = None) -> str:
    """The text of a kernel's file; `otherwise` where it does not exist. Raises OSError."""
    try:
        return (folder / name).read_text(errors="replace").strip()
    except OSError:
        if otherwise is None:
            raise
        return otherwise


def c_library(called: str, files: Sequence[str], package: str) -> ctypes.CDLL:
    """Load the first of several C libraries that exists.

    Args:
        called: name of the library, for the message.
        files: such as "libfreenect.so.0.5", the best first.
        package: of Debian, that contains it.

    Raises:
        DeviceError: none exists; says how to install it.
    """
    for name in files:
        with suppress(OSError):
            return ctypes.CDLL(name)
    raise DeviceError(f"{called} is missing", fix=f"sudo apt-get install {package}")
