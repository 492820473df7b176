"""ColumnFiles: columns of surfels on their way into a map's file, on the disk: in memory all are as half a map."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import IO, Protocol, Self

import numpy as np

from wheelsight.mapping.columns import COLUMNS, Columns, steps_of

_ROWS_AT_ONCE = 1 << 16


class Compressor(Protocol):
    """Such as `lzma.LZMACompressor`."""

    def compress(self, data: bytes, /) -> bytes:
        """What is known of the result by now."""
        ...


class ColumnFiles:
    """Takes columns part by part, and gives them back one column after the other; a context, which removes the files.

    The files have no name, so that none is left behind by a process that is killed.

    Args:
        folder: where they are. Raises OSError, as all methods do.
    """

    def __init__(self, folder: Path) -> None:
        self._open = ExitStack()
        self._streams = {name: self._temporary(folder) for name, _ in COLUMNS}
        self._last = {name: np.zeros(1, dtype) for name, dtype in COLUMNS}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def add(self, columns: Columns) -> None:
        """Put these behind the others."""
        for name, column in columns.items():
            self._streams[name].write(steps_of(column, self._last[name][0]).tobytes())
            self._last[name] = column[-1:] if len(column) else self._last[name]

    def compressed(self, compressor: Compressor) -> bytes:
        """All of them as `columns.packed` has them."""
        return b"".join(
            compressor.compress(piece)
            for name, dtype in COLUMNS
            for piece in _planes(self._streams[name], np.dtype(dtype).itemsize)
        )

    def _temporary(self, folder: Path) -> IO[bytes]:
        return self._open.enter_context(tempfile.TemporaryFile(dir=folder))


def _planes(stream: IO[bytes], width: int) -> Iterator[bytes]:
    """All first bytes of the numbers of a file, then all second ones, and so on."""
    for byte in range(width):
        stream.seek(0)
        while rows := stream.read(width * _ROWS_AT_ONCE):
            yield rows[byte::width]
