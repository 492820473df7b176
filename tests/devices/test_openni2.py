"""OpenNI2 by its own dummy camera, live, and by `.oni` files that its own recorder makes of it."""

from __future__ import annotations

import ctypes
import json
import math
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from devices.oni_files import needs_openni2, record_dummy

from wheelsight.core.errors import DeviceError
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices import openni2 as openni2_library
from wheelsight.io.devices.cameras import open_live_camera
from wheelsight.io.devices.live_camera import CameraStatus, LiveFrame
from wheelsight.io.devices.openni2 import OpenNI2Driver, kinect_v2, structured_light

SMALL = LiveCameraSettings(width_px=320, height_px=240, kept_frames=100)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("oni") / "dummy.oni"
    record_dummy(path, 1.0)
    return path


def is_the_dummys(frame: LiveFrame) -> None:
    """As its source has it: its first row is 2 m away, its first pixel blue."""
    np.testing.assert_allclose(frame.frame.depth_m[0], 2.0, atol=1e-6)
    assert frame.frame.color[0, 0].tolist() == [0, 0, 255]
    assert frame.frame.color.shape == (240, 320, 3)
    assert np.count_nonzero(frame.frame.depth_m) < 1000


_LIVE = """
import json, os, sys
import numpy as np
from wheelsight.io.devices.cameras import open_live_camera
from wheelsight.core.settings import LiveCameraSettings
camera = open_live_camera("openni2:Dummy", LiveCameraSettings(kept_frames=100))
frames = [camera.read(2.0) for _ in range(40)]
report = camera.report()
print(json.dumps({
    "stamps_s": [f.frame.stamp_s for f in frames], "row_m": frames[-1].frame.depth_m[0].tolist(),
    "pixel": frames[-1].frame.color[0, 0].tolist(), "shape": frames[-1].frame.color.shape,
    "status": report.status.name, "refused": report.refused, "host_drops": report.host_drops,
    "warnings": camera.warnings, "is_registered": camera.calibration.is_registered,
}), flush=True)
os._exit(0)
"""


@needs_openni2
def test_a_live_device_streams_and_shows_what_it_lacks() -> None:
    """In a program of its own: the library's dummy camera survives no closing."""
    ran = subprocess.run([sys.executable, "-c", _LIVE], capture_output=True, text=True, check=True, timeout=60)
    reported = json.loads(ran.stdout)
    assert len(reported["stamps_s"]) == 40
    assert np.all(np.diff(reported["stamps_s"]) > 0)
    assert (reported["status"], reported["refused"], reported["host_drops"]) == ("STREAMING", 0, 0)
    np.testing.assert_allclose(reported["row_m"], 2.0, atol=1e-6)
    assert reported["pixel"] == [0, 0, 255]
    assert reported["shape"] == [240, 320, 3]
    assert not reported["is_registered"]
    for said in ("no 640×480 at 30 Hz; it gives 320×240 at 30 Hz", "does not register", "states no field of view"):
        assert any(said in warning for warning in reported["warnings"])


@needs_openni2
def test_a_file_plays_once_at_its_own_rate_as_it_was_recorded(recorded: Path) -> None:
    began_s = time.monotonic()
    with open_live_camera(f"openni2:{recorded}", SMALL) as camera:
        frames = []
        while (frame := camera.read(5.0)) is not None:
            frames.append(frame)
        assert camera.report().status is CameraStatus.ENDED
        assert len(frames) >= 10
        assert time.monotonic() - began_s > 0.3
        for frame in frames:
            is_the_dummys(frame)
        # A busy host misses frames, since the library keeps one alone; each is counted.
        numbers = np.array([frame.sequence for frame in frames if frame.sequence is not None])
        device_s = np.array([frame.device_s for frame in frames if frame.device_s is not None])
        np.testing.assert_allclose(device_s - device_s[0], 0.033 * (numbers - numbers[0]), atol=1e-9)
        assert camera.report().device_drops == numbers[-1] - numbers[0] + 1 - len(numbers)
        assert camera.name == "oni File dummy.oni"
        assert camera.calibration.is_registered
        assert any("does not state whether its depth is registered" in warning for warning in camera.warnings)


@needs_openni2
def test_what_cannot_be_opened_is_reported_with_the_fix(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"none\.oni: there is no such file"):
        open_live_camera(f"openni2:{tmp_path / 'none.oni'}")
    (tmp_path / "broken.oni").write_bytes(b"NI10" + bytes(200))
    with pytest.raises(DeviceError):
        open_live_camera(f"openni2:{tmp_path / 'broken.oni'}")
    with pytest.raises(DeviceError, match="cannot open it"):
        open_live_camera("openni2:A0001")


def test_a_missing_library_is_reported_with_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(openni2_library, "_NAMES", ("libOpenNI2-nowhere.so",))
    openni2_library.library.cache_clear()
    try:
        with pytest.raises(DeviceError, match=r"OpenNI2 is missing \(sudo apt-get install libopenni2-0\)"):
            OpenNI2Driver(None, LiveCameraSettings()).open()
    finally:
        openni2_library.library.cache_clear()


def test_a_frame_whose_bytes_do_not_fill_it_has_no_pixels() -> None:
    mode = openni2_library.VideoMode(openni2_library.RGB888, 4, 2, 30)
    data = ctypes.create_string_buffer(bytes(range(24)), 24)
    frame = openni2_library.OniFrame(24, ctypes.addressof(data), 2, 33_000, 7, 4, 2, mode, 0, 0, 0, 12)
    taken = openni2_library.copied_frame(frame)
    assert taken.pixels.tolist() == np.arange(24).reshape(2, 4, 3).tolist()
    assert taken.stamp_s == pytest.approx(0.033)
    assert taken.index == 7
    for wrong in ({"size": 23}, {"stride": 11}, {"data": None}):
        broken = openni2_library.OniFrame.from_buffer_copy(frame)
        for name, value in wrong.items():
            setattr(broken, name, value)
        assert openni2_library.copied_frame(broken).pixels.size == 0


def test_padded_rows_are_read_without_their_padding() -> None:
    mode = openni2_library.VideoMode(openni2_library.DEPTH_1_MM, 2, 2, 30)
    data = ctypes.create_string_buffer(np.array([1, 2, 99, 3, 4, 99], np.uint16).tobytes(), 12)
    frame = openni2_library.OniFrame(12, ctypes.addressof(data), 3, 0, 1, 2, 2, mode, 0, 0, 0, 6)
    assert openni2_library.copied_frame(frame).pixels.tolist() == [[1, 2], [3, 4]]


def test_nominal_cameras_follow_the_view_and_the_size() -> None:
    view = 2 * math.atan(320 / 570.0)
    reported = structured_light((640, 480), (640, 480), view, view, is_registered=True)
    assert reported.cameras[0].fx == pytest.approx(570.0)
    assert reported.is_registered
    halved = structured_light((320, 240), (320, 240), None, None, is_registered=False)
    assert halved.cameras[0].fx == pytest.approx(525.0 / 2)
    assert halved.cameras[1].fx == pytest.approx(585.0 / 2)
    assert halved.T_color_depth is not None
    color, depth = kinect_v2().cameras
    assert (color.width, color.height, depth.width, depth.height) == (1920, 1080, 512, 424)
