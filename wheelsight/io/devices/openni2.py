"""Cameras and `.oni` files through OpenNI2, by ctypes. Its cameras and the Kinect v1 get nominal calibrations, since
the devices do not state any.
"""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.errors import DeviceError
from wheelsight.core.geometry import ByteArray, PinholeCamera
from wheelsight.core.geometry.arrays import UInt16Array
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices.camera_driver import (
    DeviceImages,
    FramePairs,
    OpenedDevice,
    PlaybackEndedError,
    Stamped,
    c_library,
)
from wheelsight.io.recordings import load_camera

# OpenNI2's C functions that a camera needs, through ctypes: Debian's libopenni2-0, or what else the loader finds.


_NAMES = ("libOpenNI2.so.0", "libOpenNI2.so")
_API_VERSION = 2002  # 1000 × major + minor
_TIMED_OUT = 102
_OPENNI2_LIBRARY_DRIVERS = Path("OpenNI2", "Drivers")
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


class VideoMode(ctypes.Structure):
    """Format, size and rate of a stream."""

    _fields_ = (("format", ctypes.c_int), ("width", ctypes.c_int), ("height", ctypes.c_int), ("fps", ctypes.c_int))


class _SensorInfo(ctypes.Structure):
    _fields_ = (("sensor", ctypes.c_int), ("count", ctypes.c_int), ("modes", ctypes.POINTER(VideoMode)))


class _DeviceInfo(ctypes.Structure):
    _fields_ = (
        ("uri", ctypes.c_char * 256),
        ("vendor", ctypes.c_char * 256),
        ("name", ctypes.c_char * 256),
        ("usb_vendor", ctypes.c_uint16),
        ("usb_product", ctypes.c_uint16),
    )


class OniFrame(ctypes.Structure):
    """A frame in the library's memory."""

    _fields_ = (
        ("size", ctypes.c_int),
        ("data", ctypes.c_void_p),
        ("sensor", ctypes.c_int),
        ("timestamp_us", ctypes.c_uint64),
        ("index", ctypes.c_int),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("mode", VideoMode),
        ("is_cropped", ctypes.c_int),
        ("crop_x", ctypes.c_int),
        ("crop_y", ctypes.c_int),
        ("stride", ctypes.c_int),
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
    found.oniGetExtendedError.restype = ctypes.c_char_p
    found.oniDeviceGetSensorInfo.restype = ctypes.POINTER(_SensorInfo)
    if found.oniInitialize(_API_VERSION) != 0:
        raise DeviceError(f"OpenNI2 does not start: {_last_error(found)}", fix="reinstall libopenni2-0")
    return found


def driver_folder() -> Path | None:
    """Where the library looks for drivers: beside itself; None where that cannot be told. Raises DeviceError."""
    library()
    with suppress(OSError):
        for line in Path("/proc/self/maps").read_text().splitlines():
            path = Path(line.split(maxsplit=5)[-1])
            if path.name.startswith("libOpenNI2.so") and (path.parent / _OPENNI2_LIBRARY_DRIVERS).is_dir():
                return path.parent / _OPENNI2_LIBRARY_DRIVERS
    return None


def _last_error(of: Any) -> str:
    said = (of.oniGetExtendedError() or b"").decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(said) if line.strip()), "it does not say why")


def listed_devices() -> list[ListedDevice]:
    """Devices that are plugged in and have a driver; files are not among them. Raises DeviceError."""
    found, count = ctypes.POINTER(_DeviceInfo)(), ctypes.c_int()
    lib = library()
    if lib.oniGetDeviceList(ctypes.byref(found), ctypes.byref(count)) != 0:
        raise DeviceError(f"OpenNI2 lists no devices: {_last_error(lib)}")
    try:
        return [ListedDevice(found[i].uri.decode(), found[i].name.decode()) for i in range(count.value)]
    finally:
        lib.oniReleaseDeviceList(found)


class OniDevice:
    """An open device or file. Raises DeviceError where it does not open; says what the library says."""

    def __init__(self, uri: str) -> None:
        self._lib, self._device = library(), ctypes.c_void_p()
        self._streams: dict[Sensor, ctypes.c_void_p] = {}
        if self._lib.oniDeviceOpen(uri.encode(), ctypes.byref(self._device)) != 0:
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
        self._lib.oniDeviceGetInfo(self._device, ctypes.byref(info))
        return str(info.name.decode(errors="replace"))

    @property
    def serial(self) -> str:
        """Its serial number, or ""."""
        text = ctypes.create_string_buffer(256)
        size = ctypes.c_int(len(text))
        done = self._lib.oniDeviceGetProperty(self._device, Property.SERIAL_NUMBER, text, ctypes.byref(size)) == 0
        return text.value.decode(errors="replace") if done else ""

    def modes(self, sensor: Sensor) -> list[VideoMode]:
        """What a stream of that kind can give; nothing where there is no such sensor."""
        info = self._lib.oniDeviceGetSensorInfo(self._device, sensor)
        return [_copied(info[0].modes[i]) for i in range(info[0].count)] if info else []

    def create(self, sensor: Sensor) -> None:
        """Make a stream, not started yet. Raises DeviceError."""
        stream = ctypes.c_void_p()
        if self._lib.oniDeviceCreateStream(self._device, sensor, ctypes.byref(stream)) != 0:
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
        mode = ctypes.c_int(wanted)
        size = ctypes.sizeof(mode)
        return bool(
            self._lib.oniDeviceSetProperty(self._device, Property.REGISTRATION, ctypes.byref(mode), size) == 0
            or not wanted
        )

    def synchronise(self) -> None:
        """Ask for depth and colour at the same moments; not every device can."""
        self._lib.oniDeviceEnableDepthColorSync(self._device)

    def play_once(self) -> bool:
        """Let a file end rather than begin anew; False for what is no file."""
        never = ctypes.c_int(0)
        return bool(
            self._lib.oniDeviceIsPropertySupported(self._device, Property.REPEAT)
            and self._lib.oniDeviceSetProperty(self._device, Property.REPEAT, ctypes.byref(never), ctypes.sizeof(never))
            == 0
        )

    def set_mode(self, sensor: Sensor, mode: VideoMode) -> bool:
        """Ask a stream for a mode; whether it took it."""
        return self._set(sensor, Property.VIDEO_MODE, mode)

    def unmirror(self, sensor: Sensor) -> None:
        """Ask for images as the camera sees them: drivers show a mirror image unless told otherwise."""
        self._set(sensor, Property.MIRRORING, ctypes.c_int(0))

    def number(self, sensor: Sensor, name: Property, kind: type[ctypes.c_int] | type[ctypes.c_float]) -> float | None:
        """A number that a stream tells, or None."""
        value = kind()
        size = ctypes.c_int(ctypes.sizeof(value))
        got = self._lib.oniStreamGetProperty(self._streams[sensor], name, ctypes.byref(value), ctypes.byref(size))
        return float(value.value) if got == 0 else None

    def mode(self, sensor: Sensor) -> VideoMode:
        """The mode of a stream. Raises DeviceError."""
        mode = VideoMode()
        size = ctypes.c_int(ctypes.sizeof(mode))
        if self._lib.oniStreamGetProperty(
            self._streams[sensor], Property.VIDEO_MODE, ctypes.byref(mode), ctypes.byref(size)
        ):
            raise DeviceError(f"the {sensor.name.lower()} stream tells no size: {_last_error(self._lib)}")
        return mode

    def frames(self, timeout_s: float) -> Iterator[StreamFrame]:
        """The next frame of whichever stream has one; nothing where none comes. Raises DeviceError."""
        sensors = tuple(self._streams)
        handles = (ctypes.c_void_p * len(sensors))(*(stream.value for stream in self._streams.values()))
        which = ctypes.c_int()
        got = self._lib.oniWaitForAnyStream(handles, len(sensors), ctypes.byref(which), int(1e3 * timeout_s))
        if got == _TIMED_OUT:
            return
        if got != 0:
            raise DeviceError(f"OpenNI2 waits in vain: {_last_error(self._lib)}")
        frame = ctypes.POINTER(OniFrame)()
        if self._lib.oniStreamReadFrame(self._streams[sensors[which.value]], ctypes.byref(frame)) != 0:
            raise DeviceError(f"OpenNI2 reads no frame: {_last_error(self._lib)}")
        try:
            yield copied_frame(frame[0])
        finally:
            self._lib.oniFrameRelease(frame)

    def _set(self, sensor: Sensor, name: Property, value: ctypes.Structure | ctypes.c_int) -> bool:
        stream = self._streams[sensor]
        return bool(self._lib.oniStreamSetProperty(stream, name, ctypes.byref(value), ctypes.sizeof(value)) == 0)


def _copied(mode: VideoMode) -> VideoMode:
    return VideoMode(mode.format, mode.width, mode.height, mode.fps)


def copied_frame(frame: OniFrame) -> StreamFrame:
    """A copy of a frame; of a size that its bytes do not fill, an image of no pixels, which is then refused."""
    channels, dtype = (3, np.uint8) if frame.mode.format == RGB888 else (1, np.uint16)
    row = frame.width * channels * np.dtype(dtype).itemsize
    if frame.stride < row or frame.size < frame.stride * (frame.height - 1) + row or not frame.data:
        pixels = np.zeros((0, 0), dtype)
    else:
        data = np.frombuffer(ctypes.string_at(frame.data, frame.size), np.uint8)
        rows = np.lib.stride_tricks.as_strided(data, (frame.height, row), (frame.stride, 1), writeable=False)
        shape = (frame.height, frame.width, 3) if channels == 3 else (frame.height, frame.width)
        pixels = np.ascontiguousarray(rows).view(dtype).reshape(shape)
    return StreamFrame(Sensor(frame.sensor), frame.mode.format, pixels, 1e-6 * frame.timestamp_us, frame.index)


# Cameras and `.oni` files through OpenNI2: PrimeSense's and Asus' Xtion, and Kinects whose drivers are installed.
#
# OpenNI2 tells a field of view and nothing of lenses, nor of where its two cameras sit; both are nominal until they
# are calibrated.


# The player waits no longer than 2 s for a frame's time: longer silence is the end of a file that lacks frames.
_LONGEST_PAUSE_S = 2.5
_DEPTH_FORMATS = {DEPTH_1_MM: 1e-3, DEPTH_100_UM: 1e-4}
# Of libfreenect2: its stamps are the frames' numbers, and its fields of view those of a Kinect v1.
_KINECT_V2 = "freenect2"


_DRIVERS = {
    "freenect2": "build libfreenect2 with BUILD_OPENNI2_DRIVER=ON, and put its libfreenect2-openni2.so there",
}


@dataclass(frozen=True, slots=True)
class _Where:
    """What to open; one that `is_listed` leaves the list when it is unplugged."""

    uri: str
    is_file: bool
    is_listed: bool


class OpenNI2Driver:
    """A `CameraDriver`.

    Args:
        where: an `.oni` file, a serial number or a URI of OpenNI2; None for the first device that is plugged in.
        settings: sizes, rate, registration and infrared are taken from it, as far as the device can.
    """

    def __init__(self, where: str | None, settings: LiveCameraSettings) -> None:
        self._asked, self._settings = where, settings
        self._where: _Where | None = None
        self._device: OniDevice | None = None
        self._pairs: FramePairs[StreamFrame] = FramePairs()
        self._infrared: UInt16Array | None = None
        self._last_index: dict[Sensor, int] = {}
        self._is_over, self._heard_s = False, 0.0

    def open(self) -> OpenedDevice:
        """As `CameraDriver` has it."""
        self._where = self._found()
        self._device = OniDevice(self._where.uri)
        try:
            return self._started(self._device, self._where)
        except DeviceError:
            self.close()
            raise

    def read(self, timeout_s: float) -> DeviceImages | None:
        """As `CameraDriver` has it."""
        assert self._device is not None
        ends_s = time.monotonic() + timeout_s
        while (left_s := ends_s - time.monotonic()) > 0:
            for frame in self._device.frames(left_s):
                self._heard_s = time.monotonic()
                if (found := self._paired(frame)) is not None:
                    return found
        self._check_presence()
        return None

    def close(self) -> None:
        """As `CameraDriver` has it."""
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def _found(self) -> _Where:
        asked = self._asked
        if asked is not None and is_file(asked):
            if not Path(asked).is_file():
                raise DeviceError("there is no such file", path=asked, fix="check the path")
            return _Where(asked, is_file=True, is_listed=False)
        devices = listed_devices()
        if asked is None:
            if not devices:
                raise DeviceError("OpenNI2 sees no camera", fix="plug it in, and see: wheelsight devices")
            return _Where(devices[0].uri, is_file=False, is_listed=True)
        listed = next((d.uri for d in devices if d.uri == asked or _has_serial(d, asked)), None)
        return _Where(listed or asked, is_file=False, is_listed=listed is not None)

    def _started(self, device: OniDevice, where: _Where) -> OpenedDevice:
        is_file = device.play_once()
        is_v2 = where.uri.startswith(_KINECT_V2)
        sensors = [Sensor.COLOR, Sensor.DEPTH]
        if self._settings.infrared:
            sensors.append(Sensor.INFRARED)
        warnings: list[str] = []
        for sensor in sensors:
            if not device.modes(sensor):
                raise DeviceError(f"it has no {sensor.name.lower()} sensor", path=where.uri)
            device.create(sensor)
            if not is_file:
                warnings += self._set_mode(device, sensor, is_v2)
                device.unmirror(sensor)
        _check_format(device, where.uri)
        is_registered = self._register(device, is_file, is_v2, warnings)
        device.start()
        self._last_index = _last_indices(device, sensors) if is_file else {}
        self._pairs, self._infrared = FramePairs(), None
        self._is_over, self._heard_s = False, time.monotonic()
        name = f"{device.name} {Path(where.uri).name if is_file else device.serial}".strip()
        calibration = _calibration(device, is_registered, is_v2, warnings)
        return OpenedDevice(name, calibration, tuple(warnings))

    def _set_mode(self, device: OniDevice, sensor: Sensor, is_v2: bool) -> list[str]:
        """Choose size, rate and format; a warning where the size that was asked for is not to be had."""
        wanted = {Sensor.COLOR: (RGB888,), Sensor.DEPTH: (DEPTH_1_MM, DEPTH_100_UM), Sensor.INFRARED: (GRAY16,)}
        modes = [mode for mode in device.modes(sensor) if mode.format in wanted[sensor]]
        if not modes:
            raise DeviceError(f"its {sensor.name.lower()} comes in no format that can be read")
        size = (self._settings.width_px, self._settings.height_px)
        if is_v2:  # its driver also shows depth in the corner of 640×480
            size = (1920, 1080) if sensor is Sensor.COLOR else (512, 424)

        def misses(mode: VideoMode) -> tuple[int, int, int]:
            off = abs(mode.width - size[0]) + abs(mode.height - size[1])
            return off, abs(mode.fps - self._settings.rate_hz), wanted[sensor].index(mode.format)

        best = min(modes, key=misses)
        device.set_mode(sensor, best)
        if misses(best)[:2] == (0, 0):
            return []
        asked = f"{size[0]}×{size[1]} at {self._settings.rate_hz} Hz"
        given = f"{best.width}×{best.height} at {best.fps} Hz"
        return [f"The {sensor.name.lower()} stream has no {asked}; it gives {given}."]

    def _register(self, device: OniDevice, is_file: bool, is_v2: bool, warnings: list[str]) -> bool:
        """Whether depth comes on colour's pixels."""
        color, depth = device.mode(Sensor.COLOR), device.mode(Sensor.DEPTH)
        is_alike = (color.width, color.height) == (depth.width, depth.height)
        wanted = self._settings.registered and is_alike and not is_v2
        if is_file:
            does = "does" if wanted else "does not"
            warnings.append(f"The file does not tell whether its depth is registered to colour; taken as if it {does}.")
            return wanted
        device.synchronise()
        is_registered = device.register(wanted) and wanted
        if self._settings.registered and not is_registered:
            warnings.append("The camera does not register depth to colour; T_color_depth joins them.")
        return is_registered

    def _paired(self, frame: StreamFrame) -> DeviceImages | None:
        if frame.index >= self._last_index.get(frame.sensor, frame.index + 1):
            del self._last_index[frame.sensor]
            self._is_over = not self._last_index
        if frame.sensor is Sensor.INFRARED:
            self._infrared = np.asarray(frame.pixels, np.uint16)
            return None
        add = self._pairs.add_color if frame.sensor is Sensor.COLOR else self._pairs.add_depth
        pair = add(frame.stamp_s, frame)
        return None if pair is None else self._images(*pair)

    def _images(self, color: Stamped[StreamFrame], depth: Stamped[StreamFrame]) -> DeviceImages:
        assert self._where is not None
        infrared, self._infrared = self._infrared, None
        metres = _DEPTH_FORMATS.get(depth.what.format, math.nan)
        depth_m = np.multiply(depth.what.pixels, np.float32(metres), dtype=np.float32)
        has_clock = not self._where.uri.startswith(_KINECT_V2)
        return DeviceImages(
            color=np.asarray(color.what.pixels, np.uint8),
            depth_m=depth_m,
            color_s=color.stamp_s if has_clock else None,
            depth_s=depth.stamp_s if has_clock else None,
            sequence=color.what.index,
            infrared=infrared,
        )

    def _check_presence(self) -> None:
        """Raises PlaybackEndedError for a file that is over, DeviceError for a device that is gone."""
        assert self._where is not None
        if self._where.is_file:
            if self._is_over or time.monotonic() - self._heard_s > _LONGEST_PAUSE_S:
                raise PlaybackEndedError("the file is over", path=self._where.uri)
        elif self._where.is_listed and self._where.uri not in {device.uri for device in listed_devices()}:
            raise DeviceError("the camera was unplugged", fix="plug it in again")


def is_file(where: str) -> bool:
    """Whether a file is meant, be it there or not; else a serial number or a URI of OpenNI2."""
    return Path(where).suffix == ".oni" or Path(where).is_file()


def why_unusable(driver: str) -> tuple[str, str] | None:
    """What is missing, and the fix, where OpenNI2 or its driver of that name is not installed; None where both are."""
    try:
        folder = driver_folder()
    except DeviceError as error:
        return error.problem, error.fix or ""
    if folder is None or any(driver.lower() in path.name.lower() for path in folder.glob("lib*")):
        return None
    return f"OpenNI2 has no driver for it in {folder}", _DRIVERS.get(driver, "install the maker's driver there")


def _has_serial(device: ListedDevice, serial: str) -> bool:
    opened = OniDevice(device.uri)
    try:
        return opened.serial == serial
    finally:
        opened.close()


def _last_indices(device: OniDevice, sensors: list[Sensor]) -> dict[Sensor, int]:
    """The number of each stream's last frame, as far as a file tells."""
    counts = {sensor: device.number(sensor, Property.NUMBER_OF_FRAMES, ctypes.c_int) for sensor in sensors}
    return {sensor: int(count) for sensor, count in counts.items() if count}


def _check_format(device: OniDevice, uri: str) -> None:
    for sensor, known in ((Sensor.COLOR, (RGB888,)), (Sensor.DEPTH, tuple(_DEPTH_FORMATS))):
        if device.mode(sensor).format not in known:
            problem = f"its {sensor.name.lower()} is of pixel format {device.mode(sensor).format}"
            raise DeviceError(f"{problem}, which is not read", path=uri, fix="record RGB888 and depth in millimetres")


def _calibration(device: OniDevice, is_registered: bool, is_v2: bool, warnings: list[str]) -> Calibration:
    if is_v2:
        return kinect_v2()
    color, depth = device.mode(Sensor.COLOR), device.mode(Sensor.DEPTH)
    views = [device.number(sensor, Property.HORIZONTAL_FOV, ctypes.c_float) for sensor in (Sensor.COLOR, Sensor.DEPTH)]
    if not all(view is not None and 0.1 < view < 3.0 for view in views):
        warnings.append("It tells no field of view; that of a Kinect v1 or Xtion is assumed until it is calibrated.")
        views = [None, None]
    sizes = (color.width, color.height), (depth.width, depth.height)
    return structured_light(*sizes, *views, is_registered=is_registered)


# Calibrations that a camera's kind tells, where the device tells none: good until it is calibrated.


# Chosen, no measurement: of a lens that nobody measured, where that of the 7-Scenes' Kinect, fitted, has 2.
_NOMINAL_SIGMA_PX = 5.0
# Kinect v2: what one device tells of itself, as its owners publish it, rounded; another's differs.
_V2_DEPTH = PinholeCamera(512, 424, 365.0, 365.0, 256.0, 206.0, (0.09, -0.27, 0.0, 0.0, 0.095))
_V2_COLOR = PinholeCamera(1920, 1080, 1081.0, 1081.0, 959.5, 539.5)
_V2_BASELINE_M = 0.052
# The axial noise of Fankhauser et al., ICAR 2015, at normal incidence, 1.3 mm at 1 m and 4.3 mm at 4 m, by these two
# terms; the maker names 0.5 to 4.5 m reliable.
_V2_NOISE = DepthNoise(constant_m=0.0011, quadratic_per_m=0.0002, near_m=0.5, far_m=4.5)


def structured_light(
    color: tuple[int, int],
    depth: tuple[int, int],
    color_view: float | None,
    depth_view: float | None,
    *,
    is_registered: bool,
) -> Calibration:
    """Of a camera of PrimeSense's kind: Kinect v1, Xtion.

    Args:
        color, depth: width and height of the images.
        color_view, depth_view: horizontal fields of view, radians; None for a Kinect v1's.
        is_registered: whether depth comes on colour's pixels.
    """
    known = load_camera("seven_scenes")
    color_of, depth_of = known.cameras
    color_camera = _by_view(color, color_view) if color_view else _scaled(color_of, color)
    depth_camera = _by_view(depth, depth_view) if depth_view else _scaled(depth_of, depth)
    how = "the field of view it tells" if color_view else "a Kinect v1's nominal values"
    common: dict[str, Any] = {
        "source": f"{how}; nothing was calibrated",
        "color_sigma_px": _NOMINAL_SIGMA_PX * color[0] / 640,
        "rolling_shutter_s": known.rolling_shutter_s,
        "depth_noise": known.depth_noise,
    }
    if is_registered:
        return Calibration.registered_camera(color_camera, **common)
    return Calibration(color_camera, depth_camera, known.T_color_depth, **common)


def kinect_v2() -> Calibration:
    """Of a Kinect v2: depth 512×424 by time of flight, colour 1920×1080 beside it."""
    T_color_depth = np.eye(4)
    T_color_depth[0, 3] = -_V2_BASELINE_M
    return Calibration(
        _V2_COLOR,
        _V2_DEPTH,
        T_color_depth,
        source="nominal values of a Kinect v2; nothing was calibrated",
        color_sigma_px=3 * _NOMINAL_SIGMA_PX,
        depth_noise=_V2_NOISE,
    )


def _by_view(size: tuple[int, int], view: float) -> PinholeCamera:
    width, height = size
    focal_px = width / 2 / math.tan(view / 2)
    return PinholeCamera(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)


def _scaled(camera: PinholeCamera, size: tuple[int, int]) -> PinholeCamera:
    """The same lens on an image of another size, cut off below or above where its shape differs."""
    share = size[0] / camera.width
    focal_px = camera.fx * share
    return PinholeCamera(*size, focal_px, focal_px, (size[0] - 1) / 2, (size[1] - 1) / 2)
