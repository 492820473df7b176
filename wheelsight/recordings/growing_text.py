"""Text files that grow while a recording goes on, by whole lines only."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import numpy as np

from wheelsight.errors import RecordingError
from wheelsight.files import check_name, output_error
from wheelsight.inputs import Kind, is_there, read_bytes

_LIST = Kind("a list that a recording goes on with", 1 << 10)  # ten hours of readings at 300 Hz have 300 MB


class GrowingText:
    """A text file that is appended to, on its way to the disk at once; what cannot be written whole is taken back.

    A disk that fills up in the middle of a line, or Ctrl-C, would else leave half a line, which no reader takes.

    Args:
        path: of the file.
        header: its first lines.
        resume: whether to go on behind the whole lines that it has; else it begins anew.

    Attributes:
        earlier: the lines that it went on behind, without comments and the header; empty where it began anew.

    Raises:
        OutputError: the file cannot be made.
        RecordingError: what is to be resumed is no ordinary file.
    """

    def __init__(self, path: Path, header: str, resume: bool = False) -> None:
        self._path = path
        self._length = 0
        self.earlier: tuple[str, ...] = ()
        check_name(path)
        try:
            kept = _whole_lines(path) if resume else b""
            self._stream = path.open("r+b" if kept else "wb", buffering=0)
            if kept:
                self._length = len(kept)
                self._stream.truncate(self._length)
                self._stream.seek(self._length)
        except OSError as error:
            raise output_error(error, path) from error
        if not kept:
            self.append(header)
            return
        lines, first = kept.decode("utf-8", "replace").splitlines(), header.splitlines()
        self.earlier = tuple(line for line in lines if line.strip() and line[0] != "#" and line not in first)

    def append(self, text: str) -> None:
        """Write whole lines. Raises OutputError, and adds nothing, where the disk is full or the folder has gone."""
        data = memoryview(text.encode("utf-8", "backslashreplace"))
        try:
            self._write(data)
        except BaseException as error:
            with suppress(OSError):
                os.ftruncate(self._stream.fileno(), self._length)
                self._stream.seek(self._length)
            if isinstance(error, OSError):
                raise output_error(error, self._path) from error
            raise
        self._length += len(data)

    def _write(self, data: memoryview) -> None:
        while data:
            data = data[self._stream.write(data) :]

    def close(self) -> None:
        """Nothing is lost without it but what the system had not yet written."""
        self._stream.close()


def seconds(stamp_s: float) -> str:
    """A stamp with all its decimals, never in powers of ten, so that it reads back exactly."""
    return np.format_float_positional(stamp_s, min_digits=6)


def _whole_lines(path: Path) -> bytes:
    """What a file has up to its last line end, and up to the first zero: a power cut leaves such where lines were."""
    if not is_there(path):
        return b""
    data = read_bytes(path, _LIST, RecordingError)
    data = data[: data.find(b"\0")] if b"\0" in data else data
    return data[: data.rfind(b"\n") + 1]
