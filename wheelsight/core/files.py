"""Atomic output files: each is complete or absent, even if power fails during a write.

A file is written beside its place under a temporary name, flushed to the disk, and renamed.
"""

from __future__ import annotations

import errno
import os
import secrets
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Literal, overload

from wheelsight.core.errors import OutputError

# A path in public functions.
StrPath = str | os.PathLike[str]

_REASONS = {
    errno.ENOSPC: ("no space left on the disk", "free some space, or choose another folder"),
    errno.EDQUOT: ("the disk quota is used up", "free some space, or choose another folder"),
    errno.EACCES: ("no permission to write here", "choose a folder you own"),
    errno.EPERM: ("no permission to write here", "choose a folder you own"),
    errno.EROFS: ("the file system is read-only", "choose another folder"),
    errno.EEXIST: ("is a file, not a folder", "choose another name"),
    errno.EISDIR: ("is a folder, not a file", "choose another name"),
    errno.ENOTDIR: ("a part of the path is a file, not a folder", "choose another name"),
    errno.ENOENT: ("the folder does not exist and cannot be made here", "make it first, or choose another one"),
}


@overload
def atomic_write(path: StrPath, mode: Literal["w"] = "w") -> AbstractContextManager[IO[str]]: ...
@overload
def atomic_write(path: StrPath, mode: Literal["wb"]) -> AbstractContextManager[IO[bytes]]: ...
@contextmanager
def atomic_write(path: StrPath, mode: Literal["w", "wb"] = "w") -> Iterator[IO[Any]]:
    """Open `path` for writing ("w" as UTF-8, or "wb"); the file appears when the block ends without an error.

    Raises:
        OutputError: the folder is missing, not writable, or the disk is full.
    """
    path = Path(path)
    check_name(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    # A folder's name may hold bytes that are no text.
    encoding, errors, newline = ("utf-8", "backslashreplace", "\n") if mode == "w" else (None, None, None)
    try:
        with temporary.open(mode.replace("w", "x"), encoding=encoding, errors=errors, newline=newline) as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
    except OSError as error:
        raise output_error(error, path) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_text(path: StrPath, text: str) -> None:
    """Write `text` to `path` atomically, as UTF-8. Raises OutputError."""
    path = Path(path)
    with atomic_write(path) as stream:
        stream.write(text)


def write_lines(path: StrPath, lines: Iterable[str]) -> None:
    """Write texts one after another to `path`, as `write_text`; an hour's poses take 70 MB."""
    with atomic_write(path) as stream:
        stream.writelines(lines)


def settings_text(settings: Any) -> str:
    """Return nested plain values as YAML in their order."""
    import yaml

    # libyaml, if PyYAML was built with it, takes a quarter of the time.
    text: str = yaml.dump(
        settings, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper), sort_keys=False, allow_unicode=True
    )
    return text


def write_bytes(path: StrPath, data: bytes) -> None:
    """Write `data` to `path` atomically. Raises OutputError."""
    path = Path(path)
    with atomic_write(path, "wb") as stream:
        stream.write(data)


def remove_file(path: StrPath) -> None:
    """Remove a file, if it is there. Raises OutputError."""
    path = Path(path)
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise output_error(error, path) from error


def make_output_folder(folder: StrPath, force: bool = False) -> Path:
    """Make `folder` (and its parents) for new results.

    Raises:
        OutputError: it holds something and `force` is off, is a file, or cannot be made or written to.
    """
    folder = Path(folder)
    try:
        if not force:
            refuse_full(folder)
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass  # only an attempt shows whether the folder can be written to
    except OSError as error:
        raise output_error(error, folder) from error
    return folder


@contextmanager
def new_output_folder(folder: StrPath, force: bool = False) -> Iterator[Path]:
    """Make `folder` as `make_output_folder` does; if the block fails, remove empty folders that it made."""
    folder = Path(folder)
    made = [place for place in (folder, *folder.parents) if not os.path.lexists(place)]
    try:
        yield make_output_folder(folder, force)
    except BaseException:
        for place in made:
            with suppress(OSError):
                place.rmdir()
        raise


def refuse_full(folder: StrPath, fix: str = "choose another --out, or add --force to overwrite") -> None:
    """Raise OutputError, with the fix, for a folder that is not empty; make none."""
    folder = Path(folder)
    try:
        if folder.is_dir() and any(folder.iterdir()):
            raise OutputError("is not empty", path=folder, fix=fix)
    except OSError as error:
        raise output_error(error, folder) from error


def check_name(path: StrPath) -> None:
    """Raise OutputError for a folder, or a device or pipe that a file would replace."""
    path = Path(path)
    if path.name in ("", ".."):
        raise output_error(IsADirectoryError(errno.EISDIR, ""), path)
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            raise OutputError("is a device or a pipe, not a file", path=path, fix="choose another name")
    except OSError as error:
        raise output_error(error, path) from error


def output_error(error: OSError, path: StrPath) -> OutputError:
    """Return the OutputError of a system's error for `path`."""
    path = Path(path)
    problem, fix = _REASONS.get(error.errno or 0, (error.strerror or str(error), None))
    return OutputError(problem, path=path, fix=fix)
