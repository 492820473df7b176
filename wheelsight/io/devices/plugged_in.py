"""`plugged_in` lists connected depth cameras and serial ports, how to use each, and what prevents its use."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

from serial.tools.list_ports import comports

from wheelsight.core.errors import DeviceError
from wheelsight.io.devices.camera_driver import USB_3_MBIT, UsbDevice, udev_rule, usb_devices, users_of

_MICROSOFT = 0x045E
_KINECT_V1_MOTOR = (_MICROSOFT, 0x02B0)


@dataclass(frozen=True, slots=True)
class PluggedIn:
    """A connected device.

    Attributes:
        kind: "camera" or "port".
        name: for display.
        use: the option of a command, such as "--camera realsense:123" or "--wheels /dev/ttyUSB0"; "" where it cannot be
            used at all.
        problem: what prevents its use; "" without a problem.
        fix: of the problem.
        opener: its name in `cameras.LIVE_CAMERAS`; "" without one.
    """

    kind: str
    name: str
    use: str
    problem: str = ""
    fix: str = ""
    opener: str = ""

    @property
    def is_ready(self) -> bool:
        """Whether it can be used now."""
        return not self.problem


@dataclass(frozen=True, slots=True)
class _Model:
    """A camera model, by its USB ids.

    Attributes:
        products: ids of the vendor's products; empty for all products.
        driver: its driver in OpenNI2; "" without one.
    """

    vendor: int
    products: tuple[int, ...]
    name: str
    opener: str
    needs_usb_3: bool
    driver: str = ""


def plugged_in(devices: Sequence[UsbDevice] | None = None) -> list[PluggedIn]:
    """Depth cameras, then serial ports. Nothing is opened.

    Args:
        devices: on USB; None for those that the kernel lists.
    """
    # A PC always lists eight ports that are not there, without a name.
    ports = []
    for port in sorted(comports()):
        if port.hwid not in ("", "n/a"):
            path, description, problem, fix = port.device, port.description or "", "", ""
            if not os.access(path, os.R_OK | os.W_OK):
                problem = "no permission to open it"
                fix = "sudo usermod -aG dialout $USER, then log in again"
            elif users := users_of(path):
                problem, fix = f"in use by {', '.join(users)}", "end that one first"
            name = f"{path} ({description})" if description and description != "n/a" else path
            ports.append(PluggedIn("port", name, f"--wheels {path}", problem, fix))
    return [*cameras_plugged_in(devices), *ports]


def cameras_plugged_in(devices: Sequence[UsbDevice] | None = None) -> list[PluggedIn]:
    """Depth cameras, as `plugged_in` has them."""
    listed = usb_devices() if devices is None else devices
    known = [
        (device, model)
        for device in listed
        for model in _MODELS
        if model.vendor == device.vendor and (not model.products or device.product in model.products)
    ]
    found = [_camera(device, model) for device, model in known]
    has_motor = any((device.vendor, device.product) == _KINECT_V1_MOTOR for device in listed)
    if has_motor and not any(model.name == _KINECT_V1 for _, model in known):
        problem, fix = "its motor is seen, but not its camera", "plug its power supply in, too"
        found.append(PluggedIn("camera", _KINECT_V1, "", problem, fix))
    return found


def _camera(device: UsbDevice, model: _Model) -> PluggedIn:
    name = " ".join(word for word in (model.name, f"({device.name})" if device.name else "", device.serial) if word)
    use = f"--camera {model.opener}" + (f":{device.serial}" if model.opener in _BY_SERIAL and device.serial else "")
    problem, fix = "", ""
    if (missing := _missing(model)) is not None:
        problem, fix = missing
    elif not device.is_usable:
        problem, fix = "no permission to open it", udev_rule(device.vendor)
    elif users := users_of(device.node):
        problem, fix = f"in use by {', '.join(users)}", "end that one first"
    elif model.needs_usb_3 and 0 < device.speed_mbit < USB_3_MBIT:
        problem = f"on USB 2 ({device.speed_mbit:g} Mbit/s), which loses frames"
        fix = "use a USB 3 port and a USB 3 cable"
    return PluggedIn("camera", name, use if model.opener else "", problem, fix, model.opener)


def _missing(model: _Model) -> tuple[str, str] | None:
    """What a model lacks to be read, and the fix; None where nothing is missing."""
    if model.opener == "realsense":
        has_library = find_spec("pyrealsense2") is not None
        return None if has_library else ("its library is missing", "pip install pyrealsense2")
    if model.opener == "openni2":
        from wheelsight.io.devices.openni2 import why_unusable

        return why_unusable(model.driver)
    if model.opener == "freenect":
        from wheelsight.io.devices.freenect import library

        try:
            library()
        except DeviceError as error:
            return error.problem, error.fix or ""
        return None
    return "cannot be read live", "record with k4arecorder, and give its .mkv as the recording"


_KINECT_V1 = "Kinect v1"
_BY_SERIAL = ("realsense",)
_REALSENSE = (0x0AD3, 0x0AD4, 0x0AD5, 0x0AF6, 0x0B07, 0x0B3A, 0x0B5B, 0x0B5C, 0x0ABF, 0xABCD, 0x1155)
_MODELS = (
    _Model(0x8086, _REALSENSE, "RealSense D400", "realsense", True),
    _Model(0x1D27, (0x0500, 0x0600, 0x0601, 0x0609), "PrimeSense or Xtion", "openni2", False, "PS1080"),
    _Model(_MICROSOFT, (0x02AE, 0x02BF), _KINECT_V1, "freenect", False),
    _Model(_MICROSOFT, (0x02C4, 0x02D8), "Kinect v2", "openni2", True, "freenect2"),
    _Model(_MICROSOFT, (0x097C,), "Azure Kinect", "", True),
    _Model(0x2BC5, (), "Orbbec", "openni2", False, "rbbec"),
)


def why_not(opener: str | None) -> DeviceError | None:
    """The reason why no camera of a kind, or none at all, can be opened, by the connected devices; None if unknown."""
    found = [camera for camera in cameras_plugged_in() if opener in (None, camera.opener)]
    lacking = [camera for camera in found if not camera.is_ready]
    if lacking:
        return DeviceError(f"{lacking[0].name}: {lacking[0].problem}", fix=lacking[0].fix)
    if not found and opener is None:
        return DeviceError(
            "no depth camera is plugged in", fix="plug one in; wheelsight devices lists what is connected"
        )
    return None
