"""Opening a serial port, for this program alone, or saying in one line why not."""

from __future__ import annotations

import errno
from contextlib import suppress
from pathlib import Path

from serial import Serial, SerialException
from serial.tools.list_ports import comports

from wheelsight.errors import DeviceError

_READ_TIMEOUT_S = 0.006  # beyond paper.SILENCE_S, which ends a pair of bytes
_WRITE_TIMEOUT_S = 0.2
_REASONS = {
    errno.EACCES: ("no permission to open the port", "join its group, e.g. sudo usermod -aG dialout $USER"),
    errno.EPERM: ("no permission to open the port", "join its group, e.g. sudo usermod -aG dialout $USER"),
    errno.EBUSY: ("the port is in use by another program", "end that one first"),
    errno.EAGAIN: ("the port is in use by another program", "end that one first"),
}


def open_port(path: str, baudrate: int) -> Serial:
    """The port, locked against other programs that lock too, with short timeouts.

    Raises:
        DeviceError: it is missing, denied, in use, no serial port, or does not know the rate.
    """
    try:
        port = Serial(path, baudrate, timeout=_READ_TIMEOUT_S, write_timeout=_WRITE_TIMEOUT_S, exclusive=True)
    except SerialException as error:
        raise _port_error(path, error) from error
    except (ValueError, OverflowError) as error:
        raise DeviceError(f"the port does not know {baudrate} baud", path=path, fix="115200 is usual") from error
    with suppress(
        ValueError, OSError, AttributeError, NotImplementedError
    ):  # not every driver holds bytes back, nor lets that be changed
        port.set_low_latency_mode(True)
    return port


def _port_error(path: str, error: SerialException) -> DeviceError:
    if error.errno == errno.ENOENT:
        return DeviceError("there is no such port", path=path, fix=_ports_there())
    if error.errno in _REASONS:
        problem, fix = _REASONS[error.errno]
        return DeviceError(problem, path=path, fix=fix)
    if Path(path).exists() and not Path(path).is_char_device():
        return DeviceError("is not a serial port", path=path, fix=_ports_there())
    return DeviceError(f"cannot be opened: {error}", path=path)


def _ports_there() -> str:
    there = sorted(port.device for port in comports())
    return f"there are: {', '.join(there)}" if there else "no serial port is there: plug the controller in"
