"""Cameras and `.oni` files through OpenNI2: PrimeSense's and Asus' Xtion, and Kinects whose drivers are installed.

OpenNI2 tells a field of view and nothing of lenses, nor of where its two cameras sit; both are nominal until they are
calibrated.
"""

from __future__ import annotations

import ctypes
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.devices._openni2_library import (
    DEPTH_1_MM,
    DEPTH_100_UM,
    GRAY16,
    RGB888,
    ListedDevice,
    OniDevice,
    Property,
    Sensor,
    StreamFrame,
    VideoMode,
    driver_folder,
    listed_devices,
)
from wheelsight.devices.camera_driver import DeviceImages, OpenedDevice, PlaybackEndedError
from wheelsight.devices.frame_pairs import FramePairs, Stamped
from wheelsight.devices.nominal_cameras import kinect_v2, structured_light
from wheelsight.errors import DeviceError
from wheelsight.geometry.arrays import UInt16Array
from wheelsight.settings import LiveCameraSettings

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
        self._pairs: FramePairs[StreamFrame] = FramePairs(settings.pair_gap_s)
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
        self._pairs, self._infrared = FramePairs(self._settings.pair_gap_s), None
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
