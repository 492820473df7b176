"""FreenectDriver on fakenect, libfreenect's own stand-in for a Kinect v1, which plays a folder of frames."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from devices.oni_files import MAY_BE_MISSING

from wheelsight.core.errors import DeviceError
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices import freenect
from wheelsight.io.devices.freenect import FreenectDriver

FAKENECT = next(iter(sorted(Path("/usr/lib").glob("*/fakenect/libfreenect.so.0.5"))), None)
needs_fakenect = pytest.mark.skipif(
    FAKENECT is None and MAY_BE_MISSING, reason="needs fakenect, of Debian's libfreenect0.5"
)
FRAMES, CLOCK_HZ = 24, 60e6
# The clock begins again amid the frames.
FIRST_TICKS = (1 << 32) - round(0.3 * CLOCK_HZ)
DEPTH_MM = 1234


def record(folder: Path) -> None:
    """A folder as fakenect-record writes it: colour shows the frame's number, depth is 1.234 m in its lower half."""
    folder.mkdir()
    names = []
    for number in range(FRAMES):
        taken_s = 100 + number / 30
        ticks = (FIRST_TICKS + round(number / 30 * CLOCK_HZ)) % (1 << 32)
        late = (ticks + 60_000) % (1 << 32)
        names += [f"r-{taken_s:.6f}-{ticks}.ppm", f"d-{taken_s + 0.001:.6f}-{late}.pgm"]
        color = np.full((480, 640, 3), [number, 7, 9], np.uint8)
        (folder / names[-2]).write_bytes(b"P6 640 480 255\n" + color.tobytes())
        depth = np.full((480, 640), DEPTH_MM, np.uint16)
        depth[:240] = 0
        (folder / names[-1]).write_bytes(b"P5 640 480 65535\n" + depth.tobytes())
    (folder / "INDEX.txt").write_text("\n".join(names) + "\n")


PLAYED = """
import json, os, sys, threading
import numpy as np
from wheelsight.io.devices import freenect
from wheelsight.io.devices.freenect import FreenectDriver
from wheelsight.io.devices.live_camera import StreamingCamera
from wheelsight.core.settings import LiveCameraSettings
freenect._NAMES = (sys.argv[1],)
library = freenect.library()
find = library.freenect_find_depth_mode
# fakenect 0.5.3 knows raw depth alone, and hands its 16 bits on as they are; a Kinect's are millimetres.
library.freenect_find_depth_mode = lambda size, form: find(size, 0)
settings = LiveCameraSettings(registered=False, kept_frames=100)
unplugged = threading.Event()
heard = lambda status: status.name == "UNPLUGGED" and unplugged.set()
camera = StreamingCamera(FreenectDriver(None, settings), settings, on_status=heard)
frames = [camera.read(3.0) for _ in range(int(sys.argv[2]))]
is_unplugged = unplugged.wait(20)
report = camera.report()
reported = {
    "numbers": [int(f.frame.color[0, 0, 0]) for f in frames], "pixel": frames[0].frame.color[9, 9].tolist(),
    "device_s": [f.device_s for f in frames], "late_s": [f.frame.depth_late_s for f in frames],
    "depth_m": np.unique(frames[0].frame.depth_m[240:]).tolist(), "above": float(frames[0].frame.depth_m[:240].max()),
    "is_unplugged": is_unplugged, "jumps": report.clock_jumps, "refused": report.refused,
    "name": camera.name, "is_registered": camera.calibration.is_registered,
}
print("TOLD" + json.dumps(reported), flush=True)
os._exit(0)
"""


@needs_fakenect
def test_frames_come_in_metres_and_its_clock_runs_on_where_it_begins_again(tmp_path: Path) -> None:
    """In a program of its own: fakenect ends the one it is in where a file is missing."""
    record(tmp_path / "kinect")
    environment = {**os.environ, "FAKENECT_PATH": str(tmp_path / "kinect"), "FAKENECT_LOOP": "0"}
    command = [sys.executable, "-c", PLAYED, str(FAKENECT), str(FRAMES)]
    ran = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60, env=environment)
    reported = json.loads(ran.stdout[ran.stdout.index("TOLD") + 4 :].splitlines()[0])
    assert reported["numbers"] == list(range(FRAMES))
    assert reported["pixel"] == [0, 7, 9]
    np.testing.assert_allclose(np.diff(reported["device_s"]), 1 / 30, atol=1e-6)
    np.testing.assert_allclose(reported["late_s"], 1e-3, atol=1e-6)
    assert reported["depth_m"] == pytest.approx([1e-3 * DEPTH_MM])
    assert reported["above"] == 0
    assert (reported["jumps"], reported["refused"]) == (0, 0)
    assert reported["name"] == "Kinect v1"
    assert not reported["is_registered"]
    assert reported["is_unplugged"]  # what fakenect says at the end of its files


def test_another_size_is_refused() -> None:
    with pytest.raises(DeviceError, match="gives 640×480 alone"):
        FreenectDriver(None, LiveCameraSettings(width_px=320, height_px=240)).open()


def test_a_missing_library_is_reported_with_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(freenect, "_NAMES", ("libfreenect-nowhere.so",))
    freenect.library.cache_clear()
    try:
        with pytest.raises(DeviceError, match=r"libfreenect is missing \(sudo apt-get install libfreenect0\.5\)"):
            FreenectDriver(None, LiveCameraSettings()).open()
    finally:
        freenect.library.cache_clear()


class Refusing:
    """A library that finds a Kinect and cannot open it."""

    def __init__(self, error: int) -> None:
        self.error, self.ended = error, 0

    def freenect_init(self, *_: object) -> int:
        return 0

    def freenect_num_devices(self, *_: object) -> int:
        return 1

    def freenect_open_device(self, *_: object) -> int:
        return self.error

    def freenect_set_log_level(self, *_: object) -> None: ...

    def freenect_select_subdevices(self, *_: object) -> None: ...


@pytest.mark.parametrize(
    ("error", "said"),
    [(-3, "no permission .*udevadm"), (-6, "in use by another program .*gspca_kinect"), (-4, r"libusb -4")],
)
def test_what_libusb_says_is_reported_with_the_fix(error: int, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(freenect, "library", lambda: Refusing(error))
    with pytest.raises(DeviceError, match=said):
        FreenectDriver(None, LiveCameraSettings()).open()
