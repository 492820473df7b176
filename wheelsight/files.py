"""Files that are either whole or not there: every output goes through here.

A robot's battery may die in the middle of a write. A file is therefore written beside its place
under a temporary name, flushed to the disk, and moved there in one step.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from wheelsight.errors import OutputError


@contextmanager
def atomic_write(path: Path, mode: str = "w") -> Iterator[IO[str] | IO[bytes]]:
    """Open `path` for writing ("w" or "wb"); it appears whole when the block ends well, else not at all.

    Raises:
        OutputError: the folder is missing, not writable, or the disk is full.
    """
    encoding = None if "b" in mode else "utf-8"
    temporary = None
    try:
        descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        with os.fdopen(descriptor, mode, encoding=encoding) as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except OSError as error:
        raise output_error(error, path) from error
    finally:
        if temporary is not None and os.path.exists(temporary):
            os.unlink(temporary)


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` atomically, as UTF-8. Raises OutputError."""
    with atomic_write(path) as stream:
        stream.write(text)  # type: ignore[arg-type]


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` to `path` atomically. Raises OutputError."""
    with atomic_write(path, "wb") as stream:
        stream.write(data)  # type: ignore[arg-type]


def make_output_folder(folder: Path, force: bool = False) -> Path:
    """Make `folder` (and its parents) for new results.

    Raises:
        OutputError: it holds something and `force` is off, is a file, or cannot be made or written to.
    """
    try:
        if folder.is_dir() and any(folder.iterdir()) and not force:
            raise OutputError("is not empty", path=folder, fix="choose another --out, or add --force to overwrite")
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(error, folder) from error
    return folder


def output_error(error: OSError, path: Path) -> OutputError:
    """The OutputError that tells a person what `error` means for `path`."""
    reasons = {
        "ENOSPC": ("no space left on the disk", "free some space, or choose another folder"),
        "EDQUOT": ("the disk quota is used up", "free some space, or choose another folder"),
        "EACCES": ("no permission to write here", "choose a folder you own"),
        "EPERM": ("no permission to write here", "choose a folder you own"),
        "EROFS": ("the file system is read-only", "choose another folder"),
        "EEXIST": ("is a file, not a folder", "choose another name"),
        "ENOTDIR": ("a part of the path is a file, not a folder", "choose another name"),
        "ENOENT": ("the folder does not exist", "make it first"),
    }
    import errno

    code = errno.errorcode.get(error.errno or 0, "")
    problem, fix = reasons.get(code, (error.strerror or str(error), None))
    return OutputError(problem, path=path, fix=fix)


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
