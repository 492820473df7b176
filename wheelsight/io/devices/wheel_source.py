"""`open_wheels` reads wheel ticks from a serial port, the telemetry pipe or a wheels.csv. `TelemetryPipe` writes lines
to a named pipe.
"""

from __future__ import annotations

import fcntl
import os
import select
import stat
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from wheelsight.core.errors import DeviceError, OutputError
from wheelsight.core.files import StrPath, output_error
from wheelsight.core.inputs import parse_json
from wheelsight.core.messages import WheelReading, WheelTicks, YawRate
from wheelsight.core.threads import Closing
from wheelsight.io.devices.wheel_link import BAUDRATE, LinkStatus, WheelLink

_LOOK_MS = 100
_READ_BYTES = 1 << 16


class ReadingLink(Protocol):
    """A link to wheels in a thread of its own: `WheelLink`, or topics of ROS 2.

    Attributes:
        port: its name in messages.
    """

    port: str

    def read(self, timeout_s: float) -> WheelReading | YawRate | None:
        """The next reading, or None if none comes within `timeout_s` seconds."""


class WheelSource(Protocol):
    """A source of ticks: `WheelLink`, `TelemetryReader` or `TicksFile`."""

    def ticks(self) -> Iterator[WheelTicks]:
        """Ticks at increasing stamps, until the source ends or is closed."""

    def close(self) -> None:
        """Close the source; a loop over `ticks` ends."""


def open_wheels(
    where: StrPath, baudrate: int = BAUDRATE, on_status: Callable[[LinkStatus], None] | None = None
) -> WheelSource:
    """The source of ticks at a path: a named pipe, a wheels.csv or the folder of one, or else a serial port.

    Args:
        baudrate, on_status: of the port, as `WheelLink` takes them.

    Raises:
        DeviceError: the port is missing, denied, in use, or not a serial port.
        RecordingError: wheels.csv cannot be read.
    """
    path = Path(where)
    if path.is_fifo():
        return TelemetryReader(path)
    if is_recorded(path):
        return TicksFile(path / "wheels.csv" if path.is_dir() else path)
    return WheelLink(str(where), baudrate, on_status)


def is_recorded(where: StrPath) -> bool:
    """Whether `open_wheels` reads a file, whose readings are all available at once."""
    path = Path(where)
    return path.is_dir() or path.is_file() or path.suffix == ".csv"


class TicksFile:
    """The readings of a wheels.csv, and `warnings` about lines left out. Raises RecordingError naming file and line."""

    def __init__(self, path: StrPath) -> None:
        from wheelsight.io.recordings.native import read_wheels  # loads OpenCV, which a port does not need

        self._ticks, self.warnings = read_wheels(Path(path))
        self._is_closed = False

    def ticks(self) -> Iterator[WheelTicks]:
        """All readings, without waiting."""
        for ticks in self._ticks:
            if self._is_closed:
                return
            yield ticks

    def close(self) -> None:
        """End a loop over `ticks`."""
        self._is_closed = True


class TelemetryReader:
    """Reads ticks from the pipe of `wheelsight wheels serve`. Waits for the daemon, and ends with it.

    The first line is skipped where it is incomplete: its beginning may have gone to an earlier reader.

    Raises:
        DeviceError: the pipe cannot be opened; or, from `ticks`, a line is not telemetry.
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
        for number, line in enumerate(self._lines(), start=1):
            try:
                fields = parse_json(line)
                stamp_s, left, right = fields["ticks_stamp_s"], fields["left_ticks"], fields["right_ticks"]
                ticks = WheelTicks(float(stamp_s), int(left), int(right))
            except (ValueError, TypeError, KeyError, OverflowError) as error:
                if number > 1:
                    raise DeviceError("a line is no telemetry", path=self._path, line=number) from error
                continue
            yield ticks

    def close(self) -> None:
        """Close the pipe; may be called twice."""
        if not self._is_closed:
            self._is_closed = True
            os.close(self._pipe)

    def _lines(self) -> Iterator[bytes]:
        """Lines as they come, until the writer closes the pipe. Raises DeviceError for a line that is too long."""
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


LONGEST_LINE = 4096  # PIPE_BUF of Linux: the size of an atomic write
_MOST_WAITING = 256

_Identity = tuple[int, int, int]


class TelemetryPipe(Closing):
    """Writes lines to a POSIX named pipe without waiting. Use it in a `with` block, whose end removes the pipe.

    One reader at a time may connect; two would each get some of the lines. Lines are not kept without a reader. A slow
    reader gets whole lines with gaps: beyond the system's buffer (64 KB) and 256 lines, the oldest are dropped. A pipe
    of a program that died is used again. A lock on the file `.NAME.lock` beside the pipe shows that its writer lives.

    Attributes:
        sent, dropped: lines that were written, and lines dropped because a reader was slow.

    Raises:
        DeviceError: another program writes to this pipe.
        OutputError: the path exists and is not a pipe, or the pipe cannot be created.
    """

    def __init__(self, path: StrPath) -> None:
        self.path = Path(path)
        self.sent = self.dropped = 0
        self._waiting: deque[bytes] = deque()
        self._writer: int | None = None
        if self.path.name in ("", ".."):
            raise OutputError("is a folder, not a pipe", path=self.path, fix="choose another path for the pipe")
        self._lock_path = self.path.with_name(f".{self.path.name}.lock")
        self._lock: int | None = _locked(self._lock_path, self.path)
        try:
            try:
                with suppress(FileExistsError):
                    os.mkfifo(self.path)
                status = self.path.stat()
            except OSError as error:
                raise output_error(error, self.path) from error
            if not stat.S_ISFIFO(status.st_mode):
                raise OutputError("exists and is not a pipe", path=self.path, fix="choose another path for the pipe")
        except OutputError:
            self._unlock()
            raise
        self._identity = _identity(status)

    @property
    def has_reader(self) -> bool:
        """Whether there was a reader when the last line was sent."""
        return self._writer is not None

    def send(self, line: str) -> None:
        """Write waiting lines and this one, as far as the pipe has space. Does not wait.

        Raises ValueError where it is not one line, or is longer than 4095 bytes.
        """
        data = line.encode() + b"\n"
        if len(data) > LONGEST_LINE or data.count(b"\n") != 1:
            raise ValueError(f"not one line of at most {LONGEST_LINE - 1} bytes: {line[:40]!r}…")
        if self._writer is None:
            try:
                writer = os.open(self.path, os.O_WRONLY | os.O_NONBLOCK)
            except OSError:  # ENXIO: no reader; ENOENT: the pipe was removed
                return
            if _identity(os.fstat(writer)) != self._identity:
                os.close(writer)
                return
            self._writer = writer
        self._waiting.append(data)
        if len(self._waiting) > _MOST_WAITING:
            self._waiting.popleft()
            self.dropped += 1
        try:
            while self._waiting:
                os.write(self._writer, self._waiting[0])
                self._waiting.popleft()
                self.sent += 1
        except BlockingIOError:
            return  # the reader is slow
        except BrokenPipeError:
            self._disconnect()  # the reader closed the pipe

    def close(self) -> None:
        """Remove the pipe, unless another file replaced it; may be called twice."""
        self._disconnect()
        with suppress(OSError):
            if self._lock is not None and _identity(self.path.stat()) == self._identity:
                self.path.unlink()
        self._unlock()

    def _disconnect(self) -> None:
        """Drop waiting lines and close the pipe for writing."""
        self._waiting.clear()
        if self._writer is not None:
            os.close(self._writer)
            self._writer = None

    def _unlock(self) -> None:
        if self._lock is not None:
            with suppress(OSError):
                self._lock_path.unlink()
            os.close(self._lock)
            self._lock = None


def _locked(lock_path: Path, path: Path) -> int:
    """The descriptor of the locked file of the pipe at `path`. Raises DeviceError, OutputError."""
    while True:
        try:
            lock = os.open(lock_path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise output_error(error, path) from error
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if lock_path.stat().st_ino == os.fstat(lock).st_ino:
                return lock
        except BlockingIOError as error:
            os.close(lock)
            raise DeviceError("another program writes into this pipe", path=path, fix="end that one first") from error
        except FileNotFoundError:
            pass
        os.close(lock)  # its owner removed it meanwhile


def _identity(status: os.stat_result) -> _Identity:
    """Device, inode and file type. A file that replaces a pipe often gets its inode."""
    return status.st_dev, status.st_ino, stat.S_IFMT(status.st_mode)
