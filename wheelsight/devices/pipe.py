"""TelemetryPipe: a POSIX named pipe that a robot's other programs read, one line at a time."""

from __future__ import annotations

import fcntl
import os
import stat
from collections import deque
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from wheelsight.errors import DeviceError, OutputError
from wheelsight.files import StrPath, output_error

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
