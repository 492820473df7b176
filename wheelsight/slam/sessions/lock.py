"""MapLock: two runs never write one map."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path

from wheelsight.errors import MapError
from wheelsight.files import StrPath, output_error

LOCK_FILE = "lock"
_LONGEST = 32


class MapLock:
    """Holds a map folder for one writer, until `release`.

    The system lets go of it when its process ends, however it ends: what a dead process left locks nothing.

    Raises:
        MapError: another run writes the map.
        OutputError: nobody may write there.
    """

    def __init__(self, folder: StrPath) -> None:
        path = Path(folder) / LOCK_FILE
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        except OSError as error:
            raise output_error(error, path) from error
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.ftruncate(self._descriptor, 0)
            os.pwrite(self._descriptor, f"{os.getpid()}\n".encode(), 0)
        except BlockingIOError as error:
            holder = self._holder()
            os.close(self._descriptor)
            fix = "wait until it ends, or choose another map"
            raise MapError(f"another run, of process {holder}, writes this map", path=Path(folder), fix=fix) from error
        except OSError as error:
            os.close(self._descriptor)
            raise output_error(error, path) from error

    @staticmethod
    def is_held(folder: StrPath) -> bool:
        """Whether somebody writes a map at the moment."""
        try:
            descriptor = os.open(Path(folder) / LOCK_FILE, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
        except OSError:
            return False
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        finally:
            os.close(descriptor)
        return False

    def release(self) -> None:
        """Let others write; the file stays."""
        descriptor, self._descriptor = self._descriptor, -1
        with suppress(OSError):
            os.close(descriptor)

    def _holder(self) -> str:
        told = os.pread(self._descriptor, _LONGEST, 0).decode("ascii", "replace").strip()
        return told if told.isdecimal() else "unknown number"
