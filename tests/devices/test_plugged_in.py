"""What is plugged in, by a tree of files as the kernel makes it; what each lacks is said with the fix."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from devices.oni_files import needs_openni2

from wheelsight.core.errors import DeviceError
from wheelsight.io.devices import freenect, plugged_in
from wheelsight.io.devices.camera_driver import UsbDevice, udev_rule, usb_devices, users_of
from wheelsight.io.devices.cameras import LIVE_CAMERAS, open_live_camera
from wheelsight.io.devices.plugged_in import PluggedIn, cameras_plugged_in


def plug(system: Path, number: int, ids: tuple[int, int], *, speed: str = "5000", **texts: str) -> None:
    folder = system / f"1-{number}"
    folder.mkdir(parents=True)
    numbers = {"idVendor": f"{ids[0]:04x}", "idProduct": f"{ids[1]:04x}", "busnum": "1", "devnum": str(number)}
    for name, text in {**numbers, "speed": speed, **texts}.items():
        (folder / name).write_text(f"{text}\n")


@pytest.fixture
def node(tmp_path: Path) -> Path:
    node = tmp_path / "nodes" / "001" / "004"
    node.parent.mkdir(parents=True)
    node.touch()
    return node


def realsense(node: Path, **others: float) -> UsbDevice:
    speed_mbit = others.get("speed_mbit", 5000.0)
    return UsbDevice(0x8086, 0x0B07, "Intel RealSense D435", "123", speed_mbit, node)


def only(devices: list[UsbDevice]) -> PluggedIn:
    (found,) = cameras_plugged_in(devices)
    return found


def test_the_kernels_files_are_read(tmp_path: Path) -> None:
    system, nodes = tmp_path / "sys", tmp_path / "nodes"
    plug(system, 7, (0x8086, 0x0B07), product="Intel RealSense D435", serial="123")
    plug(system, 2, (0x1D6B, 0x0003), speed="480")
    (system / "1-0:1.0").mkdir()  # an interface, which has no numbers
    hub, camera = usb_devices(system, nodes)
    assert (hub.vendor, hub.speed_mbit, hub.name) == (0x1D6B, 480.0, "")
    assert camera == UsbDevice(0x8086, 0x0B07, "Intel RealSense D435", "123", 5000.0, nodes / "001" / "007")
    assert not camera.is_usable
    assert usb_devices(tmp_path / "none") == []


def test_a_camera_that_lacks_nothing_is_reported_with_how_it_is_used(
    node: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plugged_in, "find_spec", lambda _: object())
    found = only([realsense(node)])
    assert found.is_ready
    assert found.use == "--camera realsense:123"
    assert found.name == "RealSense D400 (Intel RealSense D435) 123"


def test_what_a_realsense_lacks(node: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugged_in, "find_spec", lambda _: None)
    found = only([realsense(node)])
    assert (found.problem, found.fix) == ("its library is missing", "pip install pyrealsense2")
    monkeypatch.setattr(plugged_in, "find_spec", lambda _: object())
    found = only([realsense(node, speed_mbit=480.0)])
    assert found.problem == "on USB 2 (480 Mbit/s), which loses frames"
    found = only([realsense(node.with_name("005"))])
    assert (found.problem, found.fix) == ("no permission to open it", udev_rule(0x8086))
    assert udev_rule(0x8086).startswith(
        """echo 'SUBSYSTEM=="usb", ATTR{idVendor}=="8086", MODE="0666"' | sudo tee /etc/udev/rules.d/60-wheelsight"""
    )


def test_another_program_that_has_it_is_named(node: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugged_in, "find_spec", lambda _: object())
    script = "import sys; f = open(sys.argv[1]); print('open', flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", script, str(node)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        assert any(f"(pid {other.pid})" in user for user in users_of(node))
        assert f"(pid {other.pid})" in only([realsense(node)]).problem
        assert other.stdin is not None
        other.stdin.close()
    assert users_of(node) == []
    with node.open():  # by ourselves
        assert users_of(node) == []


@needs_openni2
def test_a_kinect_v2_needs_a_driver_that_debian_does_not_have(node: Path) -> None:
    found = only([UsbDevice(0x045E, 0x02C4, "Kinect V2", "A00", 5000.0, node)])
    assert found.problem.startswith("OpenNI2 has no driver for it in ")
    assert "BUILD_OPENNI2_DRIVER=ON" in found.fix
    assert only([UsbDevice(0x1D27, 0x0601, "PrimeSense", "", 480.0, node)]).is_ready


def test_a_kinect_v1_needs_libfreenect(node: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kinect = UsbDevice(0x045E, 0x02AE, "Xbox NUI Camera", "A00", 480.0, node)
    monkeypatch.setattr(freenect, "library", lambda: object())
    assert only([kinect]).use == "--camera freenect"

    def missing() -> None:
        raise DeviceError("libfreenect is missing", fix="sudo apt-get install libfreenect0.5")

    monkeypatch.setattr(freenect, "library", missing)
    assert (only([kinect]).problem, only([kinect]).fix) == (
        "libfreenect is missing",
        "sudo apt-get install libfreenect0.5",
    )


def test_a_kinect_without_its_power_supply(node: Path) -> None:
    found = only([UsbDevice(0x045E, 0x02B0, "Xbox NUI Motor", "", 12.0, node)])
    assert (found.problem, found.fix) == (
        "its motor is seen, but not its camera",
        "plug its power supply in, too",
    )


def test_an_azure_kinect_is_named_with_the_way_round(node: Path) -> None:
    found = only([UsbDevice(0x045E, 0x097C, "Azure Kinect Depth Camera", "1", 5000.0, node)])
    assert (found.problem, found.use) == ("cannot be read live", "")


def test_mice_are_no_cameras(node: Path) -> None:
    assert cameras_plugged_in([UsbDevice(0x046D, 0xC077, "USB Optical Mouse", "", 1.5, node)]) == []


def unplugged(*_: object) -> Any:
    raise DeviceError("there is none")


@pytest.fixture
def without_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    """None sees a camera: OpenNI2 keeps the dummy of another test for as long as the process lives."""
    for kind in tuple(LIVE_CAMERAS):
        monkeypatch.setitem(LIVE_CAMERAS, kind, unplugged)


@pytest.mark.usefixtures("without_libraries")
def test_opening_shows_what_the_camera_that_is_there_lacks(node: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugged_in, "find_spec", lambda _: None)
    monkeypatch.setattr(plugged_in, "usb_devices", lambda: [realsense(node)])
    for which in (None, "realsense"):
        with pytest.raises(DeviceError, match=r"D435\) 123: its library is missing \(pip install pyrealsense2\)"):
            open_live_camera(which)
    with pytest.raises(DeviceError, match=r"no camera is called 'kinect' \(one of realsense, freenect, openni2"):
        open_live_camera("kinect")


@pytest.mark.usefixtures("without_libraries")
def test_nothing_plugged_in_is_reported_plainly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugged_in, "usb_devices", list)
    with pytest.raises(DeviceError, match="no depth camera is plugged in"):
        open_live_camera()


class FakePort:
    def __init__(self, device: Path, description: str, hwid: str) -> None:
        self.device, self.description, self.hwid = str(device), description, hwid

    def __lt__(self, other: FakePort) -> bool:
        return self.device < other.device


def test_ports_that_may_be_opened_are_ready(node: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    missing = node.with_name("tty9")
    ports = [
        FakePort(node, "Arduino Uno", "USB VID:PID=2341:0043"),
        FakePort(missing, "n/a", "USB"),
        FakePort(node, "n/a", "n/a"),
    ]
    monkeypatch.setattr(plugged_in, "comports", lambda: ports)
    ready, denied = (device for device in plugged_in.plugged_in([]) if device.kind == "port")
    assert (ready.name, ready.use, ready.is_ready) == (f"{node} (Arduino Uno)", f"--wheels {node}", True)
    assert (denied.name, denied.problem) == (str(missing), "no permission to open it")
    assert "dialout" in denied.fix
    assert os.access(node, os.R_OK)
