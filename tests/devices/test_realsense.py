"""RealSenseDriver on the library's software device, and on a recording that its own recorder makes of one."""

from __future__ import annotations

import threading
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from devices.oni_files import MAY_BE_MISSING

from wheelsight.core.errors import DeviceError
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices.camera_driver import DeviceImages, GyroDriver
from wheelsight.io.devices.cameras import open_live_camera
from wheelsight.io.devices.live_camera import CameraStatus, LiveFrame, StreamingCamera
from wheelsight.io.devices.realsense import RealSenseDriver

if MAY_BE_MISSING:
    pytest.importorskip("pyrealsense2", reason="needs pyrealsense2 (the extra realsense)")
rs = import_module("pyrealsense2")

WIDTH, HEIGHT = 640, 480
SETTINGS = LiveCameraSettings(kept_frames=200)
COEFFICIENTS = [0.1, -0.2, 0.001, -0.002, 0.05]


class SoftCamera:
    """A software device with a depth camera and a colour camera 15 mm to its right."""

    def __init__(self, serial: str = "S1", model: Any = None) -> None:
        self.device = rs.software_device()
        self.device.register_info(rs.camera_info.serial_number, serial)
        self.device.register_info(rs.camera_info.name, "Soft D400")
        self.depth, self.color = (self.device.add_sensor(name) for name in ("Stereo Module", "RGB Camera"))
        self.depth.add_read_only_option(rs.option.depth_units, 0.001)
        self.depth.add_read_only_option(rs.option.stereo_baseline, 50.0)
        self.depth_profile = self.depth.add_video_stream(self._stream(rs.stream.depth, 2, rs.format.z16, 380.0, None))
        self.color_profile = self.color.add_video_stream(self._stream(rs.stream.color, 3, rs.format.rgb8, 600.0, model))
        extrinsics = rs.extrinsics()
        # A turn about x by 90°, column by column as the library has it: y goes to z.
        extrinsics.rotation = [1, 0, 0, 0, 0, 1, 0, -1, 0]
        extrinsics.translation = [0.015, 0, 0]
        self.depth_profile.register_extrinsics_to(self.color_profile, extrinsics)

    def add_gyro(self, rates_hz: tuple[int, ...] = (400, 200)) -> None:
        """Mounted with its x along the depth camera's y, by a turn about z."""
        self.motion = self.device.add_sensor("Motion Module")
        extrinsics = rs.extrinsics()
        extrinsics.rotation, extrinsics.translation = [0, 1, 0, -1, 0, 0, 0, 0, 1], [0, 0, 0]
        for place, rate_hz in enumerate(rates_hz):
            stream = rs.motion_stream()
            stream.type, stream.index, stream.uid = rs.stream.gyro, 0, 20 + place
            stream.fps, stream.fmt = rate_hz, rs.format.motion_xyz32f
            self.gyro_profile = self.motion.add_motion_stream(stream)
            self.gyro_profile.register_extrinsics_to(self.depth_profile, extrinsics)

    def turn(self, number: int, x: float, y: float, z: float) -> None:
        """A reading 1 / 200 s after the one before, on the clock of the images."""
        frame = rs.software_motion_frame()
        frame.data = motion(x, y, z)
        frame.timestamp, frame.domain = 5000 + number * 5.0, rs.timestamp_domain.hardware_clock
        frame.frame_number, frame.profile = number, self.gyro_profile.as_motion_stream_profile()
        self.motion.on_motion_frame(frame)

    def give(self, number: int, *, depth_late_ms: float = 2.0) -> None:
        """Both images of frame `number`, which tell their number, 1 / 30 s after the one before."""
        stamp_ms = 5000 + number * 1000 / 30
        shape = (HEIGHT, WIDTH)
        depth, color = np.full(shape, 1000 + number, np.uint16), np.full((*shape, 3), [number % 256, 7, 9], np.uint8)
        self._frame(self.depth, self.depth_profile, depth, number, stamp_ms + depth_late_ms)
        self._frame(self.color, self.color_profile, color, number, stamp_ms)

    def stream(self, numbers: range, every_s: float = 1 / 30) -> threading.Thread:
        """Give them on a thread, at their rate."""

        def run() -> None:
            begun_s = time.monotonic()
            for index, number in enumerate(numbers):
                time.sleep(max(0.0, begun_s + index * every_s - time.monotonic()))
                self.give(number)

        thread = threading.Thread(target=run)
        thread.start()
        return thread

    def _stream(self, kind: Any, bytes_a_pixel: int, form: Any, focal_px: float, model: Any) -> Any:
        stream = rs.video_stream()
        stream.type, stream.index, stream.uid, stream.fps = kind, 0, int(kind), 30
        stream.width, stream.height, stream.bpp, stream.fmt = WIDTH, HEIGHT, bytes_a_pixel, form
        reported = rs.intrinsics()
        reported.width, reported.height, reported.ppx, reported.ppy, reported.fx, reported.fy = (
            WIDTH,
            HEIGHT,
            321.0,
            239.0,
            focal_px,
            focal_px,
        )
        reported.model, reported.coeffs = (model, COEFFICIENTS) if model else (rs.distortion.brown_conrady, [0.0] * 5)
        stream.intrinsics = reported
        return stream

    def _frame(self, sensor: Any, profile: Any, pixels: np.ndarray, number: int, stamp_ms: float) -> None:
        frame = rs.software_video_frame()
        frame.pixels, frame.bpp = pixels, pixels.nbytes // (WIDTH * HEIGHT)
        frame.stride = WIDTH * frame.bpp
        frame.timestamp, frame.domain = stamp_ms, rs.timestamp_domain.hardware_clock
        frame.frame_number = number
        frame.profile = profile.as_video_stream_profile()
        if pixels.dtype == np.uint16:
            frame.depth_units = 0.001
        sensor.on_video_frame(frame)


def motion(x: float, y: float, z: float) -> Any:
    found = rs.vector()
    found.x, found.y, found.z = x, y, z
    return found


def test_a_gyroscope_is_read_about_the_depth_cameras_axes_by_the_clock_of_frames() -> None:
    soft = SoftCamera()
    soft.add_gyro()
    driver = RealSenseDriver(None, SETTINGS, lambda: [soft.device])
    assert isinstance(driver, GyroDriver)
    driver.open()
    soft.give(0)
    for number in range(20):
        soft.turn(number, 0.1, 0.2, 0.3 + number / 100)
    images, turns = driver.read(5.0), driver.take_angular_velocities()
    ends_s = time.monotonic() + 10
    while len(turns) < 20:
        assert time.monotonic() < ends_s
        turns += driver.take_angular_velocities()
    driver.close()
    assert images is not None
    assert images.color_s == 5.0
    assert [turn.device_s for turn in turns] == pytest.approx([5 + number / 200 for number in range(20)])
    for number, turn in enumerate(turns):
        assert (turn.x_rad_s, turn.y_rad_s, turn.z_rad_s) == pytest.approx((-0.2, 0.1, 0.3 + number / 100), abs=1e-6)
    assert driver.take_angular_velocities() == []


def test_frames_and_readings_of_a_gyroscope_push_each_other_out_of_no_queue() -> None:
    soft = SoftCamera()
    soft.add_gyro()
    with opened(soft) as camera:
        feeding = soft.stream(range(10))
        for number in range(100):
            soft.turn(number, 0.0, 0.0, 1.0)
        assert [read(camera).sequence for _ in range(10)] == list(range(10))
        feeding.join()
        assert camera.take_angular_velocities()


def test_a_gyroscope_that_is_not_wanted_or_not_there_shows_nothing() -> None:
    soft = SoftCamera()
    with opened(soft) as camera:
        assert camera.take_angular_velocities() == []
    soft.add_gyro()
    settings = SETTINGS.model_copy(update={"gyro": False})
    driver = RealSenseDriver(None, settings, lambda: [soft.device])
    driver.open()
    soft.turn(0, 1.0, 2.0, 3.0)
    assert driver.take_angular_velocities() == []
    driver.close()


def opened(*cameras: SoftCamera, where: str | None = None) -> StreamingCamera:
    devices = [camera.device for camera in cameras]
    return StreamingCamera(RealSenseDriver(where, SETTINGS, lambda: devices), SETTINGS)


def read(camera: StreamingCamera) -> LiveFrame:
    frame = camera.read(5.0)
    assert frame is not None
    return frame


def test_frames_are_paired_and_reported_in_metres() -> None:
    soft = SoftCamera()
    with opened(soft) as camera:
        feeding = soft.stream(range(30))
        frames = [read(camera) for _ in range(30)]
        feeding.join()
        for number, frame in enumerate(frames):
            assert frame.frame.color[5, 6].tolist() == [number, 7, 9]
            assert frame.frame.depth_m[0, 0] == pytest.approx((1000 + number) / 1000, abs=1e-6)
            assert frame.frame.depth_late_s == pytest.approx(0.002, abs=1e-6)
        stamps_s = np.array([frame.frame.stamp_s for frame in frames])
        assert np.median(np.diff(stamps_s)) == pytest.approx(1 / 30, abs=2e-3)
        report = camera.report()
        assert (report.device_drops, report.host_drops, report.refused) == (0, 0, 0)
        assert camera.name == "Soft D400 S1"


def test_the_device_shows_its_calibration() -> None:
    with opened(SoftCamera(model=rs.distortion.brown_conrady)) as camera:
        reported = camera.calibration
    color, depth = reported.cameras
    assert (color.fx, color.cx, color.cy, depth.fx) == (600.0, 321.0, 239.0, 380.0)
    np.testing.assert_allclose(color.distortion, COEFFICIENTS, atol=1e-7)
    assert not depth.has_distortion
    expected = np.array([[1, 0, 0, 0.015], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(reported.T_color_camera, expected, atol=1e-7)
    assert reported.depth_noise.quadratic_per_m == pytest.approx(0.08 / (380 * 0.05))


def test_an_inverse_lens_model_is_reported_by_ours() -> None:
    """By the library's own projection: it undistorts pixels by the polynomial that Brown's distorts them with."""
    with opened(SoftCamera(model=rs.distortion.inverse_brown_conrady)) as camera:
        color = camera.calibration.cameras[0]
    reported = rs.intrinsics()
    reported.width, reported.height, reported.ppx, reported.ppy, reported.fx, reported.fy = (
        WIDTH,
        HEIGHT,
        321.0,
        239.0,
        600.0,
        600.0,
    )
    reported.model, reported.coeffs = rs.distortion.inverse_brown_conrady, COEFFICIENTS
    for pixel in ([5.0, 5.0], [320.0, 10.0], [600.0, 450.0]):
        point = rs.rs2_deproject_pixel_to_point(reported, pixel, 2.0)
        np.testing.assert_allclose(color.project(point)[0], pixel, atol=0.05)


def test_a_camera_is_chosen_by_its_serial_number() -> None:
    with opened(SoftCamera("S1"), SoftCamera("S2"), where="S2") as camera:
        assert camera.name == "Soft D400 S2"
    with pytest.raises(DeviceError, match=r"no RealSense camera has the serial number S9 \(there are: S1, S2\)"):
        opened(SoftCamera("S1"), SoftCamera("S2"), where="S9")
    with pytest.raises(DeviceError, match="no RealSense camera is there"):
        opened()


def test_a_size_that_is_not_there_is_reported_with_those_that_are() -> None:
    driver = RealSenseDriver(None, SETTINGS.model_copy(update={"width_px": 848}), lambda: [SoftCamera().device])
    with pytest.raises(DeviceError, match=r"no color images of 848×480 at 30 Hz .* of: 640×480 at 30"):
        driver.open()


def test_it_reconnects_within_two_seconds_of_its_return() -> None:
    soft, plugged_in = SoftCamera(), threading.Event()
    plugged_in.set()
    driver = RealSenseDriver(None, SETTINGS, lambda: [soft.device] if plugged_in.is_set() else [])
    with StreamingCamera(driver, SETTINGS) as camera:
        feeding = soft.stream(range(10))
        for _ in range(10):
            read(camera)
        feeding.join()
        plugged_in.clear()
        while camera.report().status is not CameraStatus.UNPLUGGED:
            time.sleep(0.01)
        plugged_in.set()
        back_s = time.monotonic()
        while camera.report().reconnects == 0:
            assert time.monotonic() - back_s < 2.0
            time.sleep(0.01)
        feeding = soft.stream(range(100, 110))
        assert read(camera).frame.color[0, 0, 0] == 100
        feeding.join()
        assert camera.report().clock_jumps == 0


def test_a_recording_plays_as_a_camera(tmp_path: Path) -> None:
    path = tmp_path / "soft.db3"
    record(SoftCamera(), path, 25)
    with open_live_camera(f"realsense:{path}", SETTINGS) as camera:
        frames = []
        while (frame := camera.read(5.0)) is not None:
            frames.append(frame)
        assert camera.report().status is CameraStatus.ENDED
    np.testing.assert_allclose(camera.calibration.T_color_camera[0], [1, 0, 0, 0.015], atol=1e-7)
    # A busy host loses some, in recording or in playing; what is lost is counted, and what comes is right.
    numbers = np.array([int(frame.frame.color[0, 0, 0]) for frame in frames])
    assert len(numbers) >= 12
    assert camera.report().device_drops == numbers[-1] - numbers[0] + 1 - len(numbers)
    device_s = [frame.device_s for frame in frames if frame.device_s is not None]
    np.testing.assert_allclose(device_s, 5 + numbers / 30, atol=1e-6)
    for number, frame in zip(numbers, frames, strict=True):
        assert frame.frame.depth_m[0, 0] == pytest.approx(1 + number / 1000, abs=1e-6)


def record(soft: SoftCamera, path: Path, count: int) -> None:
    """By the library's recorder."""
    recorder, queue = rs.recorder(str(path), soft.device), rs.frame_queue(100, True)
    sensors = recorder.query_sensors()
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles())
        sensor.start(queue)
    soft.stream(range(count)).join()
    time.sleep(0.3)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    recorder.pause()


def test_what_the_library_says_is_reported_with_the_fix(tmp_path: Path) -> None:
    for said, problem in (
        ("xioctl(VIDIOC_S_FMT) failed, errno=16 Last Error: Device or resource busy", "in use by another program"),
        ("failed to open usb interface: 0, error: RS2_USB_STATUS_ACCESS", "no permission .*udevadm"),
        ("something else", "RealSense: something else"),
    ):

        def devices(said: str = said) -> list[Any]:
            raise RuntimeError(said)

        with pytest.raises(DeviceError, match=problem):
            RealSenseDriver(None, SETTINGS, devices).open()
    with pytest.raises(DeviceError, match="there is no such file"):
        RealSenseDriver(str(tmp_path / "none.bag"), SETTINGS).open()
    (tmp_path / "broken.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(64))
    with pytest.raises(DeviceError):
        RealSenseDriver(str(tmp_path / "broken.bag"), SETTINGS).open()


def test_images_are_its_own_and_not_the_librarys() -> None:
    soft = SoftCamera()
    driver = RealSenseDriver(None, SETTINGS, lambda: [soft.device])
    driver.open()
    found: list[DeviceImages] = []
    for number in range(40):
        soft.give(number)
        if (images := driver.read(1.0)) is not None:
            found.append(images)
    driver.close()
    assert [int(images.color[0, 0, 0]) for images in found] == list(range(40))
