"""Text files that grow while a recording goes on, by whole lines only."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from wheelsight.files import check_name, output_error


class GrowingText:
    """A text file that is appended to, on its way to the disk at once; what cannot be written whole is taken back.

    A disk that fills up in the middle of a line, or Ctrl-C, would else leave half a line, which no reader takes.

    Raises:
        OutputError: the file cannot be made.
    """

    def __init__(self, path: Path, header: str) -> None:
        self._path = path
        self._length = 0
        check_name(path)
        try:
            self._stream = path.open("wb", buffering=0)
        except OSError as error:
            raise output_error(error, path) from error
        self.append(header)

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
