"""Wheel ticks from wherever they are: a serial port, the telemetry pipe, or a recording's wheels.csv."""

from __future__ import annotations

import os
import select
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

from wheelsight.devices.link import BAUDRATE, LinkStatus, WheelLink
from wheelsight.devices.pipe import LONGEST_LINE
from wheelsight.errors import DeviceError
from wheelsight.events import WheelTicks
from wheelsight.files import StrPath
from wheelsight.inputs import parse_json

_LOOK_MS = 100
_READ_BYTES = 1 << 16


class WheelSource(Protocol):
    """Where ticks come from; `WheelLink`, `TelemetryReader` and `TicksFile` are such."""

    def ticks(self) -> Iterator[WheelTicks]:
        """Ticks at growing stamps, until the source ends or is closed."""

    def close(self) -> None:
        """End it; a loop over `ticks` ends too."""


def open_wheels(
    where: StrPath, baudrate: int = BAUDRATE, on_status: Callable[[LinkStatus], None] | None = None
) -> WheelSource:
    """The ticks of a named pipe, a wheels.csv (or a recording's folder that holds one), or else a serial port.

    Args:
        where: the path of any of them.
        baudrate, on_status: of the port, as `WheelLink` takes them.

    Raises:
        DeviceError: the port is missing, denied, in use, or none.
        RecordingError: wheels.csv cannot be read.
    """
    path = Path(where)
    if path.is_fifo():
        return TelemetryReader(path)
    if is_recorded(path):
        return TicksFile(path / "wheels.csv" if path.is_dir() else path)
    return WheelLink(str(where), baudrate, on_status)


def is_recorded(where: StrPath) -> bool:
    """Whether `open_wheels` takes it for a file, whose readings are all there already."""
    path = Path(where)
    return path.is_dir() or path.is_file() or path.suffix == ".csv"


class TicksFile:
    """The readings of a wheels.csv, and warnings about lines left out. Raises RecordingError naming file and line."""

    def __init__(self, path: StrPath) -> None:
        from wheelsight.recordings.native import read_wheels  # loads OpenCV, which a port needs not wait for

        self._ticks, self.warnings = read_wheels(Path(path))
        self._is_closed = False

    def ticks(self) -> Iterator[WheelTicks]:
        """All readings, as fast as they are asked for."""
        for ticks in self._ticks:
            if self._is_closed:
                return
            yield ticks

    def close(self) -> None:
        """End a loop over `ticks`."""
        self._is_closed = True


class TelemetryReader:
    """Reads ticks from the pipe that `wheelsight wheels serve` writes; waits for the daemon, and ends when it does.

    A line whose beginning went to an earlier reader is passed over.

    Raises:
        DeviceError: the pipe cannot be opened; from `ticks`, a line that is no telemetry.
    """

    def __init__(self, path: StrPath) -> None:
        self._path = path
        self._is_closed = False
        try:
            self._pipe = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise DeviceError(f"cannot be opened: {error.strerror}", path=path) from error

    def ticks(self) -> Iterator[WheelTicks]:
        """Ticks as they come."""
        number = 0
        for number, line in enumerate(self._lines(), start=1):
            ticks = _ticks_of(line)
            if ticks is not None:
                yield ticks
            elif number > 1:
                raise DeviceError("a line is no telemetry", path=self._path, line=number)

    def close(self) -> None:
        """Leave the pipe; may be called twice."""
        if not self._is_closed:
            self._is_closed = True
            os.close(self._pipe)

    def _lines(self) -> Iterator[bytes]:
        poll, rest = select.poll(), b""
        poll.register(self._pipe, select.POLLIN)
        while not self._is_closed:
            if not poll.poll(_LOOK_MS) or self._is_closed:
                continue
            data = os.read(self._pipe, _READ_BYTES)
            if not data:
                return
            *lines, rest = (rest + data).split(b"\n")
            yield from lines
            if len(rest) > LONGEST_LINE:
                problem = f"a line is longer than {LONGEST_LINE} bytes"
                raise DeviceError(problem, path=self._path, fix="read the pipe of wheelsight wheels serve")


def _ticks_of(line: bytes) -> WheelTicks | None:
    try:
        fields = parse_json(line)
        return WheelTicks(float(fields["ticks_stamp_s"]), int(fields["left_ticks"]), int(fields["right_ticks"]))
    except (ValueError, TypeError, KeyError, OverflowError):
        return None
