"""OpenNI2's C functions that a camera needs, through ctypes: Debian's libopenni2-0, or what else the loader finds."""

from __future__ import annotations

import ctypes as c
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.devices._c_library import c_library
from wheelsight.errors import DeviceError
from wheelsight.geometry import ByteArray
from wheelsight.geometry.arrays import UInt16Array

_NAMES = ("libOpenNI2.so.0", "libOpenNI2.so")
_API_VERSION = 2002  # 1000 × major + minor
_TIMED_OUT = 102
_DRIVERS = Path("OpenNI2", "Drivers")
# Threads of a driver may run on for two frames after its streams were stopped, in memory that destroying them frees:
# those of the library's dummy camera do, and end the program.
_ENDING_S = 0.07


class Sensor(IntEnum):
    """Kinds of streams."""

    INFRARED = 1
    COLOR = 2
    DEPTH = 3


class Property(IntEnum):
    """Properties, of a device or of a stream."""

    SERIAL_NUMBER = 3
    REGISTRATION = 5
    REPEAT = 101
    HORIZONTAL_FOV = 1
    VIDEO_MODE = 3
    MIRRORING = 7
    NUMBER_OF_FRAMES = 8


DEPTH_1_MM, DEPTH_100_UM, RGB888, GRAY16 = 100, 101, 200, 203


class VideoMode(c.Structure):
    """Format, size and rate of a stream."""

    _fields_ = (("format", c.c_int), ("width", c.c_int), ("height", c.c_int), ("fps", c.c_int))


class _SensorInfo(c.Structure):
    _fields_ = (("sensor", c.c_int), ("count", c.c_int), ("modes", c.POINTER(VideoMode)))


class _DeviceInfo(c.Structure):
    _fields_ = (
        ("uri", c.c_char * 256),
        ("vendor", c.c_char * 256),
        ("name", c.c_char * 256),
        ("usb_vendor", c.c_uint16),
        ("usb_product", c.c_uint16),
    )


class RawFrame(c.Structure):
    """A frame in the library's memory."""

    _fields_ = (
        ("size", c.c_int),
        ("data", c.c_void_p),
        ("sensor", c.c_int),
        ("timestamp_us", c.c_uint64),
        ("index", c.c_int),
        ("width", c.c_int),
        ("height", c.c_int),
        ("mode", VideoMode),
        ("is_cropped", c.c_int),
        ("crop_x", c.c_int),
        ("crop_y", c.c_int),
        ("stride", c.c_int),
    )


@dataclass(frozen=True, slots=True)
class ListedDevice:
    """A device that OpenNI2 knows of."""

    uri: str
    name: str


@dataclass(frozen=True, slots=True, eq=False)
class StreamFrame:
    """A frame of one stream, copied out of the library's memory."""

    sensor: Sensor
    format: int
    pixels: ByteArray | UInt16Array
    stamp_s: float
    index: int


@cache
def library() -> Any:
    """The library, ready. Raises DeviceError where it is missing or does not start."""
    found = c_library("OpenNI2", _NAMES, "libopenni2-0")
    found.oniGetExtendedError.restype = c.c_char_p
    found.oniDeviceGetSensorInfo.restype = c.POINTER(_SensorInfo)
    if found.oniInitialize(_API_VERSION) != 0:
        raise DeviceError(f"OpenNI2 does not start: {_last_error(found)}", fix="reinstall libopenni2-0")
    return found


def driver_folder() -> Path | None:
    """Where the library looks for drivers: beside itself; None where that cannot be told. Raises DeviceError."""
    library()
    with suppress(OSError):
        for line in Path("/proc/self/maps").read_text().splitlines():
            path = Path(line.split(maxsplit=5)[-1])
            if path.name.startswith("libOpenNI2.so") and (path.parent / _DRIVERS).is_dir():
                return path.parent / _DRIVERS
    return None


def _last_error(of: Any) -> str:
    said = (of.oniGetExtendedError() or b"").decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(said) if line.strip()), "it does not say why")


def listed_devices() -> list[ListedDevice]:
    """Devices that are plugged in and have a driver; files are not among them. Raises DeviceError."""
    found, count = c.POINTER(_DeviceInfo)(), c.c_int()
    lib = library()
    if lib.oniGetDeviceList(c.byref(found), c.byref(count)) != 0:
        raise DeviceError(f"OpenNI2 lists no devices: {_last_error(lib)}")
    try:
        return [ListedDevice(found[i].uri.decode(), found[i].name.decode()) for i in range(count.value)]
    finally:
        lib.oniReleaseDeviceList(found)


class OniDevice:
    """An open device or file. Raises DeviceError where it does not open; says what the library says."""

    def __init__(self, uri: str) -> None:
        self._lib, self._device = library(), c.c_void_p()
        self._streams: dict[Sensor, c.c_void_p] = {}
        if self._lib.oniDeviceOpen(uri.encode(), c.byref(self._device)) != 0:
            raise DeviceError(f"OpenNI2 cannot open it: {_last_error(self._lib)}", path=uri)

    def close(self) -> None:
        """Stop and destroy the streams, then the device."""
        for stream in self._streams.values():
            self._lib.oniStreamStop(stream)
        time.sleep(_ENDING_S)
        for stream in self._streams.values():
            self._lib.oniStreamDestroy(stream)
        self._streams.clear()
        self._lib.oniDeviceClose(self._device)

    @property
    def name(self) -> str:
        """What the driver calls it."""
        info = _DeviceInfo()
        self._lib.oniDeviceGetInfo(self._device, c.byref(info))
        return str(info.name.decode(errors="replace"))

    @property
    def serial(self) -> str:
        """Its serial number, or ""."""
        text = c.create_string_buffer(256)
        size = c.c_int(len(text))
        done = self._lib.oniDeviceGetProperty(self._device, Property.SERIAL_NUMBER, text, c.byref(size)) == 0
        return text.value.decode(errors="replace") if done else ""

    def modes(self, sensor: Sensor) -> list[VideoMode]:
        """What a stream of that kind can give; nothing where there is no such sensor."""
        info = self._lib.oniDeviceGetSensorInfo(self._device, sensor)
        return [_copied(info[0].modes[i]) for i in range(info[0].count)] if info else []

    def create(self, sensor: Sensor) -> None:
        """Make a stream, not started yet. Raises DeviceError."""
        stream = c.c_void_p()
        if self._lib.oniDeviceCreateStream(self._device, sensor, c.byref(stream)) != 0:
            raise DeviceError(f"no {sensor.name.lower()} stream: {_last_error(self._lib)}")
        self._streams[sensor] = stream

    def start(self) -> None:
        """Start all streams. Raises DeviceError naming the one that does not."""
        for sensor, stream in self._streams.items():
            if self._lib.oniStreamStart(stream) != 0:
                raise DeviceError(f"the {sensor.name.lower()} stream does not start: {_last_error(self._lib)}")

    def register(self, wanted: bool) -> bool:
        """Ask the device to register depth to colour, or not to; whether it does as asked."""
        if not self._lib.oniDeviceIsImageRegistrationModeSupported(self._device, int(wanted)):
            return not wanted
        mode = c.c_int(wanted)
        size = c.sizeof(mode)
        return bool(
            self._lib.oniDeviceSetProperty(self._device, Property.REGISTRATION, c.byref(mode), size) == 0 or not wanted
        )

    def synchronise(self) -> None:
        """Ask for depth and colour at the same moments; not every device can."""
        self._lib.oniDeviceEnableDepthColorSync(self._device)

    def play_once(self) -> bool:
        """Let a file end rather than begin anew; False for what is no file."""
        never = c.c_int(0)
        return bool(
            self._lib.oniDeviceIsPropertySupported(self._device, Property.REPEAT)
            and self._lib.oniDeviceSetProperty(self._device, Property.REPEAT, c.byref(never), c.sizeof(never)) == 0
        )

    def set_mode(self, sensor: Sensor, mode: VideoMode) -> bool:
        """Ask a stream for a mode; whether it took it."""
        return self._set(sensor, Property.VIDEO_MODE, mode)

    def unmirror(self, sensor: Sensor) -> None:
        """Ask for images as the camera sees them: drivers show a mirror image unless told otherwise."""
        self._set(sensor, Property.MIRRORING, c.c_int(0))

    def number(self, sensor: Sensor, name: Property, kind: type[c.c_int] | type[c.c_float]) -> float | None:
        """A number that a stream tells, or None."""
        value = kind()
        size = c.c_int(c.sizeof(value))
        got = self._lib.oniStreamGetProperty(self._streams[sensor], name, c.byref(value), c.byref(size))
        return float(value.value) if got == 0 else None

    def mode(self, sensor: Sensor) -> VideoMode:
        """The mode of a stream. Raises DeviceError."""
        mode = VideoMode()
        size = c.c_int(c.sizeof(mode))
        if self._lib.oniStreamGetProperty(self._streams[sensor], Property.VIDEO_MODE, c.byref(mode), c.byref(size)):
            raise DeviceError(f"the {sensor.name.lower()} stream tells no size: {_last_error(self._lib)}")
        return mode

    def frames(self, timeout_s: float) -> Iterator[StreamFrame]:
        """The next frame of whichever stream has one; nothing where none comes. Raises DeviceError."""
        sensors = tuple(self._streams)
        handles = (c.c_void_p * len(sensors))(*(stream.value for stream in self._streams.values()))
        which = c.c_int()
        got = self._lib.oniWaitForAnyStream(handles, len(sensors), c.byref(which), int(1e3 * timeout_s))
        if got == _TIMED_OUT:
            return
        if got != 0:
            raise DeviceError(f"OpenNI2 waits in vain: {_last_error(self._lib)}")
        frame = c.POINTER(RawFrame)()
        if self._lib.oniStreamReadFrame(self._streams[sensors[which.value]], c.byref(frame)) != 0:
            raise DeviceError(f"OpenNI2 reads no frame: {_last_error(self._lib)}")
        try:
            yield copied_frame(frame[0])
        finally:
            self._lib.oniFrameRelease(frame)

    def _set(self, sensor: Sensor, name: Property, value: c.Structure | c.c_int) -> bool:
        stream = self._streams[sensor]
        return bool(self._lib.oniStreamSetProperty(stream, name, c.byref(value), c.sizeof(value)) == 0)


def _copied(mode: VideoMode) -> VideoMode:
    return VideoMode(mode.format, mode.width, mode.height, mode.fps)


def copied_frame(frame: RawFrame) -> StreamFrame:
    """A copy of a frame; of a size that its bytes do not fill, an image of no pixels, which is then refused."""
    channels, dtype = (3, np.uint8) if frame.mode.format == RGB888 else (1, np.uint16)
    row = frame.width * channels * np.dtype(dtype).itemsize
    if frame.stride < row or frame.size < frame.stride * (frame.height - 1) + row or not frame.data:
        pixels = np.zeros((0, 0), dtype)
    else:
        data = np.frombuffer(c.string_at(frame.data, frame.size), np.uint8)
        rows = np.lib.stride_tricks.as_strided(data, (frame.height, row), (frame.stride, 1), writeable=False)
        shape = (frame.height, frame.width, 3) if channels == 3 else (frame.height, frame.width)
        pixels = np.ascontiguousarray(rows).view(dtype).reshape(shape)
    return StreamFrame(Sensor(frame.sensor), frame.mode.format, pixels, 1e-6 * frame.timestamp_us, frame.index)
