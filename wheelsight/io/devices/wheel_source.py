"""`open_wheels` reads wheel ticks from a serial port, the telemetry pipe or wheels.csv. `TelemetryPipe` writes lines
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
from types import TracebackType
from typing import Protocol

from wheelsight.core.errors import DeviceError, OutputError
from wheelsight.core.files import StrPath, output_error
from wheelsight.core.inputs import parse_json
from wheelsight.core.messages import WheelTicks
from wheelsight.io.devices.wheel_link import BAUDRATE, LinkStatus, WheelLink

# Wheel ticks from wherever they are: a serial port, the telemetry pipe, or a recording's wheels.csv.


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
        from wheelsight.io.recordings.native import read_wheels  # loads OpenCV, which a port needs not wait for

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


# TelemetryPipe: a POSIX named pipe that a robot's other programs read, one line at a time.


LONGEST_LINE = 4096  # PIPE_BUF of Linux: so many bytes go into a pipe whole or not at all
_MOST_WAITING = 256

_Identity = tuple[int, int, int]


class TelemetryPipe:
    """Writes lines into a named pipe and never waits; use it in a `with` block, at the end of which the pipe is gone.

    Readers come and go, one at a time (two would share the lines out between them). What nobody reads is not kept:
    a reader begins with what is sent after it came. A reader that is too slow gets whole lines with gaps: beyond the
    system's own buffer (64 KB) and 256 lines more, the oldest waiting are dropped. A pipe left over from a program
    that died is used again; of one that lives it is told by a lock on an empty file beside it, `.NAME.lock`.

    Attributes:
        path: of the pipe.
        sent, dropped: lines that went into the pipe, and lines dropped since a reader was slow.

    Raises:
        DeviceError: another program writes into this pipe.
        OutputError: something that is no pipe lies at the path (it is left alone), or a pipe cannot be made there.
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
            self._identity = _make(self.path)
        except OutputError:
            self._unlock()
            raise

    @property
    def has_reader(self) -> bool:
        """Whether someone read when the last line was sent."""
        return self._writer is not None

    def send(self, line: str) -> None:
        """Write one line, after those that wait, as far as the pipe takes them; returns at once.

        Raises:
            ValueError: more than one line, or one longer than a pipe takes whole (4095 bytes).
        """
        data = line.encode() + b"\n"
        if len(data) > LONGEST_LINE or data.count(b"\n") != 1:
            raise ValueError(f"not one line of at most {LONGEST_LINE - 1} bytes: {line[:40]!r}…")
        if self._writer is None and not self._find_reader():
            return
        self._waiting.append(data)
        if len(self._waiting) > _MOST_WAITING:
            self._waiting.popleft()
            self.dropped += 1
        self._flush()

    def close(self) -> None:
        """Remove the pipe, unless something else lies in its place by now; may be called twice."""
        self._let_go()
        with suppress(OSError):
            if self._lock is not None and _identity(self.path.stat()) == self._identity:
                self.path.unlink()
        self._unlock()

    def __enter__(self) -> TelemetryPipe:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _find_reader(self) -> bool:
        try:
            writer = os.open(self.path, os.O_WRONLY | os.O_NONBLOCK)
        except OSError:  # ENXIO: nobody reads; ENOENT: someone took the pipe away
            return False
        if _identity(os.fstat(writer)) != self._identity:
            os.close(writer)
            return False
        self._writer = writer
        return True

    def _flush(self) -> None:
        assert self._writer is not None
        try:
            while self._waiting:
                os.write(self._writer, self._waiting[0])
                self._waiting.popleft()
                self.sent += 1
        except BlockingIOError:
            return  # the reader is slow: what waits, waits
        except BrokenPipeError:
            self._let_go()  # the reader went away: no error

    def _let_go(self) -> None:
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
    """The open file that says that this program writes into the pipe at `path`."""
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
        os.close(lock)  # its owner removed it just then: there is a new one, or none


def _make(path: Path) -> _Identity:
    """Make the pipe, or take one that is left over; its identity."""
    try:
        with suppress(FileExistsError):
            os.mkfifo(path)
        status = path.stat()
    except OSError as error:
        raise output_error(error, path) from error
    if not stat.S_ISFIFO(status.st_mode):
        raise OutputError("is there already and is no pipe", path=path, fix="choose another path for the pipe")
    return _identity(status)


def _identity(status: os.stat_result) -> _Identity:
    """Device, number and kind: a file that is made where a pipe was often gets its number."""
    return status.st_dev, status.st_ino, stat.S_IFMT(status.st_mode)
