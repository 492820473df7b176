"""A disk on which one file finds no more room."""

from __future__ import annotations

import errno
import io
import os
from pathlib import Path
from typing import Any

import pytest


class FullDisk:
    """Files of one name get so many bytes in all; what they ask for beyond fails as on a full disk."""

    def __init__(self, name: str, room: int) -> None:
        self.name, self.room = name, room

    def take_over(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """From now on, for files that are opened to be written without a buffer."""
        opened = Path.open

        def open_here(path: Path, mode: str = "r", buffering: int = -1, **others: Any) -> Any:
            if path.name == self.name and mode in ("wb", "xb") and buffering == 0:
                return _File(path, self, mode)
            return opened(path, mode, buffering, **others)

        monkeypatch.setattr(Path, "open", open_here)


class _File(io.FileIO):
    def __init__(self, path: Path, disk: FullDisk, mode: str) -> None:
        super().__init__(path, mode)
        self.disk = disk

    def write(self, data: Any) -> int:
        if not self.disk.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = super().write(bytes(data)[: self.disk.room])
        self.disk.room -= written
        return written
