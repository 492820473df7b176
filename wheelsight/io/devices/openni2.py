"""Cameras and `.oni` files through OpenNI2, by ctypes: PrimeSense, Xtion, and Kinects whose drivers are installed. Its
cameras and the Kinect v1 get nominal calibrations, since the devices do not state any.
"""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Iterator
from contextlib import closing, suppress
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
from wheelsight.io.devices.camera_driver import DeviceImages, FramePairs, OpenedDevice, PlaybackEndedError, c_library
from wheelsight.io.recordings import load_camera

# The C library: Debian's libopenni2-0, or another one that the loader finds.

_NAMES = ("libOpenNI2.so.0", "libOpenNI2.so")
_API_VERSION = 2002  # 1000 × major + minor
_TIMED_OUT = 102
# Threads of a driver may run for two frames after its streams were stopped, in memory that is freed with the streams:
# those of the library's dummy camera do, and crash the program.
_STOPPING_S = 0.07


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
    """The initialized library. Raises DeviceError where it is missing or does not start."""
    found = c_library("OpenNI2", _NAMES, "libopenni2-0")
    found.oniGetExtendedError.restype = ctypes.c_char_p
    found.oniDeviceGetSensorInfo.restype = ctypes.POINTER(_SensorInfo)
    if found.oniInitialize(_API_VERSION) != 0:
        raise DeviceError(f"OpenNI2 does not start: {_last_error(found)}", fix="reinstall libopenni2-0")
    return found


def driver_folder() -> Path | None:
    """The folder of the library's drivers, beside the library; None where it is unknown. Raises DeviceError."""
    library()
    with suppress(OSError):
        for line in Path("/proc/self/maps").read_text().splitlines():
            path = Path(line.split(maxsplit=5)[-1])
            drivers = path.parent / "OpenNI2" / "Drivers"
            if path.name.startswith("libOpenNI2.so") and drivers.is_dir():
                return drivers
    return None


def _last_error(of: Any) -> str:
    lines = (of.oniGetExtendedError() or b"").decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "it does not say why")


def listed_devices() -> list[str]:
    """URIs of connected devices that have a driver, without files. Raises DeviceError."""
    found, count = ctypes.POINTER(_DeviceInfo)(), ctypes.c_int()
    lib = library()
    if lib.oniGetDeviceList(ctypes.byref(found), ctypes.byref(count)) != 0:
        raise DeviceError(f"OpenNI2 lists no devices: {_last_error(lib)}")
    try:
        return [found[i].uri.decode() for i in range(count.value)]
    finally:
        lib.oniReleaseDeviceList(found)


class OniDevice:
    """An open device or file. Raises DeviceError with the library's message where it does not open."""

    def __init__(self, uri: str) -> None:
        self._lib, self._device = library(), ctypes.c_void_p()
        self._streams: dict[Sensor, ctypes.c_void_p] = {}
        if self._lib.oniDeviceOpen(uri.encode(), ctypes.byref(self._device)) != 0:
            raise DeviceError(f"OpenNI2 cannot open it: {_last_error(self._lib)}", path=uri)

    def close(self) -> None:
        """Stop and destroy the streams, then the device."""
        for stream in self._streams.values():
            self._lib.oniStreamStop(stream)
        time.sleep(_STOPPING_S)
        for stream in self._streams.values():
            self._lib.oniStreamDestroy(stream)
        self._streams.clear()
        self._lib.oniDeviceClose(self._device)

    @property
    def name(self) -> str:
        """Its name, by the driver."""
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
        """The modes of a sensor; empty where the device has no such sensor."""
        info = self._lib.oniDeviceGetSensorInfo(self._device, sensor)
        modes = [info[0].modes[i] for i in range(info[0].count)] if info else []
        return [VideoMode(mode.format, mode.width, mode.height, mode.fps) for mode in modes]

    def create(self, sensor: Sensor) -> None:
        """Create a stream without starting it. Raises DeviceError."""
        stream = ctypes.c_void_p()
        if self._lib.oniDeviceCreateStream(self._device, sensor, ctypes.byref(stream)) != 0:
            raise DeviceError(f"no {sensor.name.lower()} stream: {_last_error(self._lib)}")
        self._streams[sensor] = stream

    def start(self) -> None:
        """Start all streams. Raises DeviceError naming the stream that fails."""
        for sensor, stream in self._streams.items():
            if self._lib.oniStreamStart(stream) != 0:
                raise DeviceError(f"the {sensor.name.lower()} stream does not start: {_last_error(self._lib)}")

    def register(self, wanted: bool) -> bool:
        """Turn registration of depth to colour on or off. Returns whether the device did so."""
        if not self._lib.oniDeviceIsImageRegistrationModeSupported(self._device, int(wanted)):
            return not wanted
        mode = ctypes.c_int(wanted)
        size = ctypes.sizeof(mode)
        return bool(
            self._lib.oniDeviceSetProperty(self._device, Property.REGISTRATION, ctypes.byref(mode), size) == 0
            or not wanted
        )

    def synchronise(self) -> None:
        """Synchronize depth and colour, where the device supports it."""
        self._lib.oniDeviceEnableDepthColorSync(self._device)

    def play_once(self) -> bool:
        """Turn repetition of a file off. Returns False for a device."""
        never = ctypes.c_int(0)
        return bool(
            self._lib.oniDeviceIsPropertySupported(self._device, Property.REPEAT)
            and self._lib.oniDeviceSetProperty(self._device, Property.REPEAT, ctypes.byref(never), ctypes.sizeof(never))
            == 0
        )

    def set(self, sensor: Sensor, name: Property, value: ctypes.Structure | ctypes.c_int) -> None:
        """Set a property of a stream, if the device supports it."""
        stream = self._streams[sensor]
        self._lib.oniStreamSetProperty(stream, name, ctypes.byref(value), ctypes.sizeof(value))

    def number(self, sensor: Sensor, name: Property, kind: type[ctypes.c_int] | type[ctypes.c_float]) -> float | None:
        """A number property of a stream, or None."""
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
            raise DeviceError(f"the {sensor.name.lower()} stream has no video mode: {_last_error(self._lib)}")
        return mode

    def frames(self, timeout_s: float) -> Iterator[StreamFrame]:
        """Yield the next frame of any stream, or nothing after the timeout. Raises DeviceError."""
        sensors = tuple(self._streams)
        handles = (ctypes.c_void_p * len(sensors))(*(stream.value for stream in self._streams.values()))
        which = ctypes.c_int()
        got = self._lib.oniWaitForAnyStream(handles, len(sensors), ctypes.byref(which), int(1e3 * timeout_s))
        if got == _TIMED_OUT:
            return
        if got != 0:
            raise DeviceError(f"OpenNI2 gets no frame: {_last_error(self._lib)}")
        frame = ctypes.POINTER(OniFrame)()
        if self._lib.oniStreamReadFrame(self._streams[sensors[which.value]], ctypes.byref(frame)) != 0:
            raise DeviceError(f"OpenNI2 cannot read a frame: {_last_error(self._lib)}")
        try:
            yield copied_frame(frame[0])
        finally:
            self._lib.oniFrameRelease(frame)


def copied_frame(frame: OniFrame) -> StreamFrame:
    """A copy of a frame; an image without pixels where its data are too short, which `FrameCheck` refuses."""
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


# The camera driver. OpenNI2 gives a field of view, but neither lens parameters nor extrinsics: these are nominal until
# they are calibrated.

# The player waits at most 2 s for a frame's time. A longer silence is the end of a file that lacks frames.
_LONGEST_PAUSE_S = 2.5
_DEPTH_FORMATS = {DEPTH_1_MM: 1e-3, DEPTH_100_UM: 1e-4}
# URI prefix of libfreenect2. Its stamps are frame numbers, and its fields of view those of a Kinect v1.
_KINECT_V2 = "freenect2"
_DRIVERS = {"freenect2": "build libfreenect2 with BUILD_OPENNI2_DRIVER=ON, and put its libfreenect2-openni2.so there"}


@dataclass(frozen=True, slots=True)
class _Source:
    """What to open. A listed device leaves the list when it is unplugged."""

    uri: str
    is_file: bool
    is_listed: bool


class OpenNI2Driver:
    """A `CameraDriver`.

    Args:
        where: an `.oni` file, a serial number or a URI of OpenNI2; None for the first connected device.
        settings: with size, rate, registration and infrared, used as far as the device supports them.
    """

    def __init__(self, where: str | None, settings: LiveCameraSettings) -> None:
        self._asked, self._settings = where, settings
        self._source: _Source | None = None
        self._device: OniDevice | None = None
        self._pairs: FramePairs[StreamFrame] = FramePairs()
        self._infrared: UInt16Array | None = None
        self._last_index: dict[Sensor, int] = {}
        self._is_over, self._received_s = False, 0.0

    def open(self) -> OpenedDevice:
        """See `CameraDriver`."""
        self._source = self._find()
        self._device = OniDevice(self._source.uri)
        try:
            return self._start(self._device, self._source)
        except DeviceError:
            self.close()
            raise

    def read(self, timeout_s: float) -> DeviceImages | None:
        """See `CameraDriver`."""
        assert self._device is not None
        ends_s = time.monotonic() + timeout_s
        while (left_s := ends_s - time.monotonic()) > 0:
            for frame in self._device.frames(left_s):
                self._received_s = time.monotonic()
                if (found := self._add(frame)) is not None:
                    return found
        assert self._source is not None
        if self._source.is_file:
            if self._is_over or time.monotonic() - self._received_s > _LONGEST_PAUSE_S:
                raise PlaybackEndedError("the file is over", path=self._source.uri)
        elif self._source.is_listed and self._source.uri not in listed_devices():
            raise DeviceError("the camera was unplugged", fix="plug it in again")
        return None

    def close(self) -> None:
        """See `CameraDriver`."""
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def _find(self) -> _Source:
        asked = self._asked
        if asked is not None and is_file(asked):
            if not Path(asked).is_file():
                raise DeviceError("there is no such file", path=asked, fix="check the path")
            return _Source(asked, is_file=True, is_listed=False)
        devices = listed_devices()
        if asked is None:
            if not devices:
                raise DeviceError("OpenNI2 sees no camera", fix="plug it in, and see: wheelsight devices")
            return _Source(devices[0], is_file=False, is_listed=True)
        for uri in devices:
            if uri == asked:
                return _Source(asked, is_file=False, is_listed=True)
            with closing(OniDevice(uri)) as opened:
                if opened.serial == asked:
                    return _Source(uri, is_file=False, is_listed=True)
        return _Source(asked, is_file=False, is_listed=False)

    def _start(self, device: OniDevice, source: _Source) -> OpenedDevice:
        is_file = device.play_once()
        is_v2 = source.uri.startswith(_KINECT_V2)
        sensors = [Sensor.COLOR, Sensor.DEPTH, *([Sensor.INFRARED] if self._settings.infrared else [])]
        warnings: list[str] = []
        for sensor in sensors:
            if not device.modes(sensor):
                raise DeviceError(f"it has no {sensor.name.lower()} sensor", path=source.uri)
            device.create(sensor)
            if not is_file:
                warnings += self._set_mode(device, sensor, is_v2)
                device.set(sensor, Property.MIRRORING, ctypes.c_int(0))  # the default of drivers
        for sensor, known in ((Sensor.COLOR, (RGB888,)), (Sensor.DEPTH, tuple(_DEPTH_FORMATS))):
            if device.mode(sensor).format not in known:
                problem = f"its {sensor.name.lower()} has pixel format {device.mode(sensor).format}, which is not read"
                raise DeviceError(problem, path=source.uri, fix="record RGB888 and depth in millimetres")
        color, depth = device.mode(Sensor.COLOR), device.mode(Sensor.DEPTH)
        is_alike = (color.width, color.height) == (depth.width, depth.height)
        is_registered = self._settings.registered and is_alike and not is_v2
        if is_file:
            does = "does" if is_registered else "does not"
            problem = "The file does not state whether its depth is registered to colour."
            warnings.append(f"{problem} It is assumed that it {does}.")
        else:
            device.synchronise()
            is_registered = device.register(is_registered) and is_registered
            if self._settings.registered and not is_registered:
                warnings.append("The camera does not register depth to colour: the calibration has T_color_depth.")
        device.start()
        # A file states the number of frames of each stream.
        counts = {s: device.number(s, Property.NUMBER_OF_FRAMES, ctypes.c_int) for s in sensors if is_file}
        self._last_index = {sensor: int(count) for sensor, count in counts.items() if count}
        self._pairs, self._infrared = FramePairs(), None
        self._is_over, self._received_s = False, time.monotonic()
        name = f"{device.name} {Path(source.uri).name if is_file else device.serial}".strip()
        if is_v2:
            return OpenedDevice(name, kinect_v2(), tuple(warnings))
        views = [device.number(s, Property.HORIZONTAL_FOV, ctypes.c_float) for s in (Sensor.COLOR, Sensor.DEPTH)]
        if not all(view is not None and 0.1 < view < 3.0 for view in views):
            warnings.append(
                "It states no field of view. That of a Kinect v1 or Xtion is assumed until it is calibrated."
            )
            views = [None, None]
        sizes = (color.width, color.height), (depth.width, depth.height)
        return OpenedDevice(name, structured_light(*sizes, *views, is_registered=is_registered), tuple(warnings))

    def _set_mode(self, device: OniDevice, sensor: Sensor, is_v2: bool) -> list[str]:
        """Set the nearest size, rate and format. Returns a warning where the requested ones are not available."""
        wanted = {Sensor.COLOR: (RGB888,), Sensor.DEPTH: (DEPTH_1_MM, DEPTH_100_UM), Sensor.INFRARED: (GRAY16,)}
        modes = [mode for mode in device.modes(sensor) if mode.format in wanted[sensor]]
        if not modes:
            raise DeviceError(f"its {sensor.name.lower()} has no format that is read")
        size = (self._settings.width_px, self._settings.height_px)
        if is_v2:  # its driver also offers depth in a corner of 640×480
            size = (1920, 1080) if sensor is Sensor.COLOR else (512, 424)

        def misses(mode: VideoMode) -> tuple[int, int, int]:
            off = abs(mode.width - size[0]) + abs(mode.height - size[1])
            return off, abs(mode.fps - self._settings.rate_hz), wanted[sensor].index(mode.format)

        best = min(modes, key=misses)
        device.set(sensor, Property.VIDEO_MODE, best)
        if misses(best)[:2] == (0, 0):
            return []
        asked = f"{size[0]}×{size[1]} at {self._settings.rate_hz} Hz"
        given = f"{best.width}×{best.height} at {best.fps} Hz"
        return [f"The {sensor.name.lower()} stream has no {asked}; it gives {given}."]

    def _add(self, frame: StreamFrame) -> DeviceImages | None:
        """Add a frame of a stream. Returns the images that it completes, or None."""
        if frame.index >= self._last_index.get(frame.sensor, frame.index + 1):
            del self._last_index[frame.sensor]
            self._is_over = not self._last_index
        if frame.sensor is Sensor.INFRARED:
            self._infrared = np.asarray(frame.pixels, np.uint16)
            return None
        add = self._pairs.add_color if frame.sensor is Sensor.COLOR else self._pairs.add_depth
        pair = add(frame.stamp_s, frame)
        if pair is None:
            return None
        assert self._source is not None
        color, depth = pair
        infrared, self._infrared = self._infrared, None
        metres = _DEPTH_FORMATS.get(depth.what.format, math.nan)
        depth_m = np.multiply(depth.what.pixels, np.float32(metres), dtype=np.float32)
        has_clock = not self._source.uri.startswith(_KINECT_V2)
        color_s, depth_s = (color.stamp_s, depth.stamp_s) if has_clock else (None, None)
        pixels = np.asarray(color.what.pixels, np.uint8)
        return DeviceImages(pixels, depth_m, color_s, depth_s, color.what.index, infrared)


def is_file(where: str) -> bool:
    """Whether this names a file, which may be missing; else it is a serial number or a URI of OpenNI2."""
    return Path(where).suffix == ".oni" or Path(where).is_file()


def why_unusable(driver: str) -> tuple[str, str] | None:
    """The problem and the fix where OpenNI2 or its driver of this name is missing; None where both are installed."""
    try:
        folder = driver_folder()
    except DeviceError as error:
        return error.problem, error.fix or ""
    if folder is None or any(driver.lower() in path.name.lower() for path in folder.glob("lib*")):
        return None
    return f"OpenNI2 has no driver for it in {folder}", _DRIVERS.get(driver, "install the maker's driver there")


# Nominal calibrations by model, for devices that state none

_NOMINAL_SIGMA_PX = 5.0  # of a lens that was not measured; that of the 7-Scenes Kinect, fitted, has 2
# Kinect v2: published values of one device, rounded. Those of other devices differ.
_V2_DEPTH = PinholeCamera(512, 424, 365.0, 365.0, 256.0, 206.0, (0.09, -0.27, 0.0, 0.0, 0.095))
_V2_COLOR = PinholeCamera(1920, 1080, 1081.0, 1081.0, 959.5, 539.5)
_V2_BASELINE_M = 0.052
# Axial noise at normal incidence (Fankhauser et al., ICAR 2015): 1.3 mm at 1 m, 4.3 mm at 4 m. The maker specifies 0.5
# to 4.5 m.
_V2_NOISE = DepthNoise(constant_m=0.0011, quadratic_per_m=0.0002, near_m=0.5, far_m=4.5)


def structured_light(
    color: tuple[int, int],
    depth: tuple[int, int],
    color_view: float | None,
    depth_view: float | None,
    *,
    is_registered: bool,
) -> Calibration:
    """The nominal calibration of a structured-light camera: Kinect v1, PrimeSense, Xtion.

    Args:
        color, depth: width and height of the images.
        color_view, depth_view: horizontal fields of view, radians; None for a Kinect v1's.
    """
    known = load_camera("seven_scenes")
    color_of, depth_of = known.cameras
    color_camera = _by_view(color, color_view) if color_view else _scaled(color_of, color)
    depth_camera = _by_view(depth, depth_view) if depth_view else _scaled(depth_of, depth)
    how = "the camera's field of view" if color_view else "a Kinect v1's nominal values"
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
    """The nominal calibration of a Kinect v2: depth 512×424 by time of flight, colour 1920×1080."""
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
    """The same lens on an image of another size, cropped at the top and bottom where its aspect ratio differs."""
    share = size[0] / camera.width
    focal_px = camera.fx * share
    return PinholeCamera(*size, focal_px, focal_px, (size[0] - 1) / 2, (size[1] - 1) / 2)
