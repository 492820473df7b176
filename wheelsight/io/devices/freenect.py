"""`FreenectDriver` of a Kinect v1, through Debian's libfreenect0.5 by ctypes; OpenNI2's own drivers do not support it.

Its calibration is nominal: the library has no lens parameters.
"""

from __future__ import annotations

import ctypes as c
import math
import time
from functools import cache, partial
from typing import Any

import numpy as np

from wheelsight.core.calibration_parts import least_step
from wheelsight.core.errors import DeviceError
from wheelsight.core.geometry.arrays import ByteArray, UInt16Array
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices.camera_driver import DeviceImages, FramePairs, OpenedDevice, Stamped, c_library, udev_rule
from wheelsight.io.devices.openni2 import structured_light

_NAMES = ("libfreenect.so.0.5", "libfreenect.so")
_SIZE = _WIDTH, _HEIGHT = 640, 480
_VGA, _RGB, _REGISTERED, _MM = 1, 0, 4, 5
_CAMERA, _FATAL = 0x02, 0
# The camera's clock has 32 bits and wraps around every 72 s (libfreenect, pull request 465).
_CLOCK_HZ, _CLOCK_SPAN = 60e6, 1 << 32
_VENDOR = 0x045E
# Error codes of libusb.
_DENIED, _BUSY = -3, -6


class _FrameMode(c.Structure):
    _fields_ = (
        ("reserved", c.c_uint32),
        ("resolution", c.c_int),
        ("format", c.c_int),
        ("bytes", c.c_int32),
        ("width", c.c_int16),
        ("height", c.c_int16),
        ("data_bits", c.c_int8),
        ("padding_bits", c.c_int8),
        ("rate_hz", c.c_int8),
        ("is_valid", c.c_int8),
    )


class _Attributes(c.Structure):
    """A device in a linked list."""


_Attributes._fields_ = (("next", c.POINTER(_Attributes)), ("serial", c.c_char_p))


class _Wait(c.Structure):
    _fields_ = (("seconds", c.c_long), ("microseconds", c.c_long))


_Callback = c.CFUNCTYPE(None, c.c_void_p, c.c_void_p, c.c_uint32)


@cache
def library() -> Any:
    """The library. Raises DeviceError where it is missing."""
    found = c_library("libfreenect", _NAMES, "libfreenect0.5")
    for finder in (found.freenect_find_video_mode, found.freenect_find_depth_mode):
        finder.restype = _FrameMode
    return found


class FreenectDriver:
    """A `CameraDriver` of a Kinect v1, which has 640×480 at 30 Hz only.

    Args:
        where: a serial number; None for the first connected device.
        settings: with registration, which the library computes by the device's factory calibration.
    """

    def __init__(self, where: str | None, settings: LiveCameraSettings) -> None:
        self._where, self._settings = where, settings
        self._context, self._device = c.c_void_p(), c.c_void_p()
        self._callbacks: list[Any] = []
        self._pairs: FramePairs[ByteArray | UInt16Array] = FramePairs()
        self._found: list[DeviceImages] = []
        self._ticks: int | None = None

    def open(self) -> OpenedDevice:
        """See `CameraDriver`."""
        if (self._settings.width_px, self._settings.height_px) != _SIZE:
            raise DeviceError("a Kinect v1 gives 640×480 alone", fix="camera.width_px: 640, camera.height_px: 480")
        lib = library()
        if lib.freenect_init(c.byref(self._context), None) < 0:
            raise DeviceError("libfreenect does not start: no USB?")
        try:
            lib.freenect_set_log_level(self._context, _FATAL)
            # Leave motor and microphones to other programs.
            lib.freenect_select_subdevices(self._context, _CAMERA)
            if lib.freenect_num_devices(self._context) < 1:
                raise DeviceError(
                    "no Kinect v1 is there", fix="plug it in, its power supply too; see: wheelsight devices"
                )
            if self._where is not None:
                opened = lib.freenect_open_device_by_camera_serial(
                    self._context, c.byref(self._device), self._where.encode()
                )
            else:
                opened = lib.freenect_open_device(self._context, c.byref(self._device), 0)
            if opened < 0:
                self._device = c.c_void_p()
                if opened == _DENIED:
                    raise DeviceError("no permission to open the Kinect", fix=udev_rule(_VENDOR))
                if opened == _BUSY:
                    fix = "end that one first; of the kernel's driver: sudo modprobe -r gspca_kinect"
                    raise DeviceError("the Kinect is in use by another program", fix=fix)
                named = "the Kinect" if self._where is None else f"a Kinect with the serial number {self._where}"
                fix = "plug it in again; see: wheelsight devices"
                raise DeviceError(f"{named} cannot be opened (libusb {opened})", fix=fix)
            serial = self._where or _first_serial(lib, self._context)
            self._start_streams(lib)
        except DeviceError:
            self.close()
            raise
        is_registered = self._settings.registered
        calibration = structured_light(_SIZE, _SIZE, None, None, is_registered=is_registered)
        warnings = ["Its cameras are nominal until they are calibrated."]
        if self._settings.infrared:
            warnings.append("A Kinect v1 gives no infrared beside colour.")
        return OpenedDevice(f"Kinect v1 {serial}".strip(), calibration, tuple(warnings))

    def read(self, timeout_s: float) -> DeviceImages | None:
        """See `CameraDriver`."""
        lib, ends_s = library(), time.monotonic() + timeout_s
        while not self._found:
            left_s = ends_s - time.monotonic()
            if left_s <= 0:
                if lib.freenect_num_devices(self._context) < 1:
                    raise DeviceError("the camera was unplugged", fix="plug it in again")
                return None
            wait = _Wait(int(left_s), int(1e6 * (left_s % 1)))
            if lib.freenect_process_events_timeout(self._context, c.byref(wait)) < 0:
                raise DeviceError("the camera was unplugged", fix="plug it in again")
        return self._found.pop(0)

    def close(self) -> None:
        """See `CameraDriver`."""
        context, self._context = self._context, c.c_void_p()
        device, self._device = self._device, c.c_void_p()
        if device:
            library().freenect_stop_depth(device)
            library().freenect_stop_video(device)
            library().freenect_close_device(device)
        if context:
            library().freenect_shutdown(context)

    def _start_streams(self, lib: Any) -> None:
        unit = _REGISTERED if self._settings.registered else _MM
        lib.freenect_set_video_mode(self._device, lib.freenect_find_video_mode(_VGA, _RGB))
        lib.freenect_set_depth_mode(self._device, lib.freenect_find_depth_mode(_VGA, unit))
        self._pairs, self._found, self._ticks = FramePairs(), [], None
        # Keep references while the library may call them.
        color = partial(self._take, self._pairs.add_color, (_HEIGHT, _WIDTH, 3), np.uint8)
        depth = partial(self._take, self._pairs.add_depth, (_HEIGHT, _WIDTH), np.uint16)
        self._callbacks = [_Callback(color), _Callback(depth)]
        lib.freenect_set_video_callback(self._device, self._callbacks[0])
        lib.freenect_set_depth_callback(self._device, self._callbacks[1])
        for name, start in (("depth", lib.freenect_start_depth), ("colour", lib.freenect_start_video)):
            if start(self._device) < 0:
                raise DeviceError(f"the {name} stream does not start", fix="use a USB port of its own for the Kinect")

    def _take(self, add: Any, shape: tuple[int, ...], dtype: Any, _: Any, data: int, ticks: int) -> None:
        """Called by the library with an image in its memory."""
        image = np.frombuffer(c.string_at(data, math.prod(shape) * np.dtype(dtype).itemsize), dtype).reshape(shape)
        # The clock wraps around; both streams share it.
        self._ticks = ticks if self._ticks is None else self._ticks + least_step(ticks - self._ticks, _CLOCK_SPAN)
        pair: tuple[Stamped[Any], Stamped[Any]] | None = add(self._ticks / _CLOCK_HZ, image)
        if pair is None:
            return
        color, depth = pair
        depth_m = np.multiply(depth.what, np.float32(1e-3), dtype=np.float32)
        self._found.append(DeviceImages(color.what, depth_m, color.stamp_s, depth.stamp_s, None))


def _first_serial(lib: Any, context: c.c_void_p) -> str:
    """The serial number of the first device, or "" where it is unknown."""
    if not hasattr(lib, "freenect_list_device_attributes"):
        return ""
    first = c.POINTER(_Attributes)()
    if lib.freenect_list_device_attributes(context, c.byref(first)) < 1 or not first:
        return ""
    try:
        return (first[0].serial or b"").decode(errors="replace")
    finally:
        lib.freenect_free_device_attributes(first)
