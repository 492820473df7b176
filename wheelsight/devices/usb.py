"""What is plugged into USB, as the Linux kernel tells, and whether this user may open it; no library is asked."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from wheelsight.files import StrPath

_SYSTEM, _NODES, _PROCESSES = Path("/sys/bus/usb/devices"), Path("/dev/bus/usb"), Path("/proc")
USB_3_MBIT = 5000.0


@dataclass(frozen=True, slots=True)
class UsbDevice:
    """One device.

    Attributes:
        vendor, product: its numbers.
        name: as it calls itself; may be "".
        serial: its serial number; may be "".
        speed_mbit: of the line it is on, megabits a second; 480 for USB 2, 5000 and more for USB 3.
        node: the file by which programs open it.
    """

    vendor: int
    product: int
    name: str
    serial: str
    speed_mbit: float
    node: Path

    @property
    def is_usable(self) -> bool:
        """Whether this user may open it."""
        return os.access(self.node, os.R_OK | os.W_OK)


def usb_devices(system: StrPath = _SYSTEM, nodes: StrPath = _NODES) -> list[UsbDevice]:
    """All that is plugged in, by bus and number; nothing where the kernel does not tell, as in a container."""
    found = []
    for folder in sorted(Path(system).glob("*")):
        with suppress(OSError, ValueError):
            vendor, product = (int(_text(folder, name), 16) for name in ("idVendor", "idProduct"))
            bus, number = (int(_text(folder, name)) for name in ("busnum", "devnum"))
            name, serial = (_text(folder, name, "") for name in ("product", "serial"))
            speed_mbit = float(_text(folder, "speed", "0"))
            node = Path(nodes) / f"{bus:03}" / f"{number:03}"
            found.append(UsbDevice(vendor, product, name, serial, speed_mbit, node))
    return sorted(found, key=lambda device: device.node)


def udev_rule(vendor: int) -> str:
    """The command that lets every user open a vendor's devices."""
    rule = f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vendor:04x}", MODE="0666"'
    file = f"/etc/udev/rules.d/60-wheelsight-{vendor:04x}.rules"
    return f"echo '{rule}' | sudo tee {file} && sudo udevadm control --reload, then plug it in again"


def users_of(node: StrPath, processes: StrPath = _PROCESSES) -> list[str]:
    """Programs that have a file open, as "name (pid 12)"; those of other users are not seen."""
    wanted, own = os.path.realpath(node), str(os.getpid())
    found = []
    for folder in sorted(Path(processes).glob("[0-9]*")):
        with suppress(OSError):
            is_open = any(os.path.realpath(handle) == wanted for handle in (folder / "fd").iterdir())
            if is_open and folder.name != own:
                found.append(f"{_text(folder, 'comm', 'a program')} (pid {folder.name})")
    return found


def _text(folder: Path, name: str, otherwise: str | None = None) -> str:
    """What a file of the kernel's says; `otherwise` where there is none. Raises OSError."""
    try:
        return (folder / name).read_text(errors="replace").strip()
    except OSError:
        if otherwise is None:
            raise
        return otherwise
