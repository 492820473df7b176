"""RealSense cameras and their gyroscopes through pyrealsense2, live or from its recordings. The device supplies its
own calibration.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.errors import ConfigError, DeviceError
from wheelsight.core.geometry import FloatArray, PinholeCamera
from wheelsight.core.geometry.arrays import UInt16Array
from wheelsight.core.geometry.camera import fitted_lens
from wheelsight.core.runtime import needed
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices.camera_driver import (
    DeviceAngularVelocity,
    DeviceImages,
    FramePairs,
    OpenedDevice,
    PlaybackEndedError,
    udev_rule,
)

_VENDOR = 0x8086
RECORDINGS = (".bag", ".db3")
_GYRO_QUEUED = 200  # readings of the gyroscope (D435i, D455): half a second at the highest rate
_QUEUED = 20  # frames that the library keeps: a third of a second of two streams
# The error of disparities on textured walls, pixels: the maker's white paper on tuning D400 depth cameras.
_SUBPIXEL = 0.08
_NEAR_M, _FAR_M = 0.2, 10.0
_LENS_OFF_PX = 0.3  # error of the fitted lens model that gives a warning


class _Chosen(NamedTuple):
    """One stream's profile, and its sensor."""

    sensor: Any
    profile: Any


class RealSenseDriver:
    """A `CameraDriver`.

    Depth stays on its own pixels, as measured: registration by the library loses depth at outlines. The device's
    extrinsics connect both images.

    Args:
        where: a serial number, or the file of a recording; None for the first connected device.
        devices: lists the connected devices; None to use the library.
    """

    def __init__(
        self, where: str | None, settings: LiveCameraSettings, devices: Callable[[], Sequence[Any]] | None = None
    ) -> None:
        self._where, self._settings, self._devices = where, settings, devices
        self._rs: Any = None
        self._device: Any = None
        self._queue: Any = None
        self._running: list[Any] = []
        self._gyro: tuple[Any, FloatArray] | None = None  # its queue, so that images displace no reading; R_camera_gyro
        self._pairs: FramePairs[Any] = FramePairs()
        self._infrared: UInt16Array | None = None
        self._depth_scale_m = 0.001

    def open(self) -> OpenedDevice:
        """See `CameraDriver`."""
        try:
            self._rs = needed("pyrealsense2")
        except ConfigError as error:
            raise DeviceError(error.problem, fix=error.fix) from error
        try:
            self._device = self._found()
            return self._started()
        except (RuntimeError, DeviceError) as error:
            self.close()
            if isinstance(error, DeviceError):
                raise
            raise _device_error(error, self._where) from error

    def read(self, timeout_s: float) -> DeviceImages | None:
        """See `CameraDriver`."""
        ends_s = time.monotonic() + timeout_s
        try:
            while (left_s := ends_s - time.monotonic()) > 0:
                is_there, frame = self._queue.try_wait_for_frame(max(1, int(1e3 * left_s)))
                if not is_there:
                    continue
                kind = frame.get_profile().stream_type()
                if kind == self._rs.stream.infrared:
                    self._infrared = np.asanyarray(frame.as_video_frame().get_data()).astype(np.uint16)
                    continue
                add = self._pairs.add_color if kind == self._rs.stream.color else self._pairs.add_depth
                if (pair := add(1e-3 * frame.get_timestamp(), frame)) is None:
                    continue
                color, depth = pair
                infrared, self._infrared = self._infrared, None
                raw = np.asanyarray(depth.what.as_video_frame().get_data())
                depth_m = np.multiply(raw, np.float32(self._depth_scale_m), dtype=np.float32)
                pixels = np.array(color.what.as_video_frame().get_data(), np.uint8)
                number = int(color.what.get_frame_number())
                return DeviceImages(pixels, depth_m, color.stamp_s, depth.stamp_s, number, infrared)
            if self._is_file:
                if self._device.current_status() == self._rs.playback_status.stopped:
                    raise PlaybackEndedError("the file is over", path=self._where)
            elif self._serial(self._device) not in map(self._serial, self._plugged_in()):
                raise DeviceError("the camera was unplugged", fix="plug it in again")
        except RuntimeError as error:
            raise _device_error(error, self._where) from error
        return None

    def take_angular_velocities(self) -> list[DeviceAngularVelocity]:
        """See `GyroDriver`."""
        found: list[DeviceAngularVelocity] = []
        if self._gyro is None:
            return found
        queue, R_camera_gyro = self._gyro
        try:
            while frame := queue.poll_for_frame():
                data = frame.as_motion_frame().get_motion_data()
                x, y, z = (R_camera_gyro @ np.array([data.x, data.y, data.z])).tolist()
                found.append(DeviceAngularVelocity(1e-3 * frame.get_timestamp(), x, y, z))
        except RuntimeError as error:
            raise _device_error(error, self._where) from error
        return found

    def close(self) -> None:
        """See `CameraDriver`."""
        running, self._running, self._gyro = self._running, [], None
        for sensor in running:
            for end in (sensor.stop, sensor.close):
                try:
                    end()
                except RuntimeError:  # it was unplugged, or not started
                    continue
        self._device = None

    @property
    def _is_file(self) -> bool:
        return self._where is not None and Path(self._where).suffix in RECORDINGS

    def _found(self) -> Any:
        if self._is_file:
            assert self._where is not None
            if not Path(self._where).is_file():
                raise DeviceError("there is no such file", path=self._where, fix="check the path")
            playback = self._rs.context().load_device(self._where).as_playback()
            playback.set_real_time(True)
            playback.pause()  # until all its streams have started
            return playback
        devices = self._plugged_in()
        if not devices:
            raise DeviceError("no RealSense camera is there", fix="plug it in, and see: wheelsight devices")
        found = next((d for d in devices if self._where in (None, self._serial(d))), None)
        if found is None:
            serials = ", ".join(map(self._serial, devices))
            raise DeviceError(f"no RealSense camera has the serial number {self._where}", fix=f"there are: {serials}")
        return found

    def _plugged_in(self) -> Sequence[Any]:
        return self._devices() if self._devices is not None else list(self._rs.context().query_devices())

    def _serial(self, device: Any) -> str:
        return self._info(device, "serial_number")

    def _info(self, device: Any, name: str) -> str:
        info = getattr(self._rs.camera_info, name)
        return str(device.get_info(info)) if device.supports(info) else ""

    def _started(self) -> OpenedDevice:
        stream, form = self._rs.stream, self._rs.format
        wanted = {"color": (stream.color, form.rgb8), "depth": (stream.depth, form.z16)}
        if self._settings.infrared:
            wanted["infrared"] = (stream.infrared, form.y8)
        chosen = {name: self._choose(name, *kind) for name, kind in wanted.items()}
        calibration, warnings = self._calibration(chosen)
        self._depth_scale_m = chosen["depth"].sensor.as_depth_sensor().get_depth_scale()
        self._pairs, self._infrared = FramePairs(), None
        self._queue = self._rs.frame_queue(_QUEUED, True)
        gyros = [
            (profile.fps(), sensor, profile)
            for sensor in (self._device.query_sensors() if self._settings.gyro else ())
            for profile in sensor.get_stream_profiles()
            if profile.stream_type() == stream.gyro and profile.format() == form.motion_xyz32f
        ]
        if gyros:
            # The slowest rate is fast enough for a robot.
            _, sensor, profile = min(gyros, key=lambda one: one[0])
            rotation = profile.get_extrinsics_to(chosen["depth"].profile).rotation
            queue = self._rs.frame_queue(_GYRO_QUEUED, True)
            self._use_device_clock(sensor)
            self._running.append(sensor)
            sensor.open([profile])
            sensor.start(queue)
            self._gyro = queue, np.reshape(rotation, (3, 3)).T  # column-major
        name = self._rs.camera_info.name
        for sensor in {one.sensor.get_info(name): one.sensor for one in chosen.values()}.values():
            self._use_device_clock(sensor)
            sensor.open([one.profile for one in chosen.values() if one.sensor.get_info(name) == sensor.get_info(name)])
            self._running.append(sensor)
            sensor.start(self._queue)
        if self._is_file:
            self._device.resume()
        if self._info(self._device, "usb_type_descriptor").startswith("2"):
            warnings.append("The camera is on USB 2, which loses frames: use a USB 3 port and cable.")
        which = Path(str(self._where)).name if self._is_file else self._serial(self._device)
        return OpenedDevice(f"{self._info(self._device, 'name')} {which}".strip(), calibration, tuple(warnings))

    def _use_device_clock(self, sensor: Any) -> None:
        """Stamp frames by the device's clock: the uncertainty of the library's mapping to host time is unknown."""
        if sensor.supports(self._rs.option.global_time_enabled):
            sensor.set_option(self._rs.option.global_time_enabled, 0)

    def _choose(self, name: str, stream: Any, form: Any) -> _Chosen:
        """The requested profile, or that of a file. Raises DeviceError naming the available ones."""
        found = [
            _Chosen(sensor, profile.as_video_stream_profile())
            for sensor in self._device.query_sensors()
            for profile in sensor.get_stream_profiles()
            if profile.stream_type() == stream and profile.format() == form
        ]
        s = self._settings
        wanted = (s.width_px, s.height_px, s.rate_hz)
        exact = [one for one in found if self._is_file or _mode(one) == wanted]
        if exact:
            return exact[0]
        if not found:
            raise DeviceError(f"the camera gives no {name} images", path=self._where)
        there = ", ".join(f"{w}×{h} at {hz}" for w, h, hz in sorted({_mode(one) for one in found})[:12])
        slow = self._info(self._device, "usb_type_descriptor").startswith("2")
        fix = "use a USB 3 port and cable" if slow else f"camera.width_px, height_px and rate_hz of: {there}"
        on = " on USB 2" if slow else ""
        raise DeviceError(f"no {name} images of {wanted[0]}×{wanted[1]} at {wanted[2]} Hz{on}", fix=fix)

    def _calibration(self, chosen: dict[str, _Chosen]) -> tuple[Calibration, list[str]]:
        warnings: list[str] = []
        color, depth = (self._camera(chosen[name].profile, name, warnings) for name in ("color", "depth"))
        extrinsics = chosen["depth"].profile.get_extrinsics_to(chosen["color"].profile)
        T_color_depth: FloatArray = np.eye(4)
        T_color_depth[:3, :3] = np.reshape(extrinsics.rotation, (3, 3)).T  # column-major in the library
        T_color_depth[:3, 3] = extrinsics.translation
        serial = self._serial(self._device)
        noise = DepthNoise(near_m=_NEAR_M, far_m=_FAR_M)
        sensor, baseline = chosen["depth"].sensor, self._rs.option.stereo_baseline
        if sensor.supports(baseline):
            baseline_m = 1e-3 * abs(sensor.get_option(baseline))
            noise = DepthNoise(0.001, _SUBPIXEL / (depth.fx * baseline_m), _NEAR_M, _FAR_M)
        source = f"the calibration stored in the RealSense {serial}".strip()
        return Calibration(color, depth, T_color_depth, noise, source=source), warnings

    def _camera(self, profile: Any, name: str, warnings: list[str]) -> PinholeCamera:
        own = profile.intrinsics
        camera = PinholeCamera(own.width, own.height, own.fx, own.fy, own.ppx, own.ppy)
        models = self._rs.distortion
        if not any(own.coeffs) or own.model == models.none:
            return camera
        if own.model == models.brown_conrady:
            return _with_lens(camera, tuple(own.coeffs))
        px = np.stack(np.meshgrid(np.linspace(0, own.width - 1, 17), np.linspace(0, own.height - 1, 13)), -1)
        px = px.reshape(-1, 2)
        rays = [self._rs.rs2_deproject_pixel_to_point(own, [float(u), float(v)], 1.0)[:2] for u, v in px]
        fit = fitted_lens(rays, camera.normalise(px))
        if fit.worst * own.fx > _LENS_OFF_PX:
            off = f"{fit.median * own.fx:.2f} px in the median, and by {fit.worst * own.fx:.1f} px at worst"
            warnings.append(f"Five coefficients miss the {name} lens by {off}.")
        return _with_lens(camera, fit.distortion)


def _mode(chosen: _Chosen) -> tuple[int, int, int]:
    profile = chosen.profile
    return int(profile.width()), int(profile.height()), int(profile.fps())


def _with_lens(camera: PinholeCamera, distortion: tuple[float, ...]) -> PinholeCamera:
    k1, k2, p1, p2, k3 = distortion
    intrinsics = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    return PinholeCamera(*intrinsics, (k1, k2, p1, p2, k3) if all(map(math.isfinite, distortion)) else (0.0,) * 5)


def _device_error(error: RuntimeError, where: str | None) -> DeviceError:
    """The error of the library as DeviceError, with its fix."""
    message = str(error)
    low = message.lower()
    if "busy" in low:
        return DeviceError("the camera is in use by another program", path=where, fix="end that one first")
    if "access" in low or "permission" in low:
        return DeviceError("no permission to open the camera", path=where, fix=udev_rule(_VENDOR))
    return DeviceError(
        f"RealSense: {message}", path=where, fix="unplug it and plug it in again; see: wheelsight devices"
    )
