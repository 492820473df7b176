"""The one gate that every input file passes: a regular file, no larger than its kind ever is, looked at before opened.

Opening a pipe waits for a writer, a device may do something when opened, and files of /proc have no size: what is no
regular file is therefore told by its directory entry, and never opened.
"""

from __future__ import annotations

import codecs
import os
import stat
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import BinaryIO

from wheelsight.errors import InputError
from wheelsight.files import StrPath

_MEGABYTE = 1 << 20
_ODD = (
    (stat.S_ISDIR, "is a folder, not a file"),
    (stat.S_ISFIFO, "is a pipe, not a file"),
    (stat.S_ISSOCK, "is a socket, not a file"),
    (stat.S_ISCHR, "is a device, not a file"),
    (stat.S_ISBLK, "is a device, not a file"),
)
_COPY = "give an ordinary file"
_KERNEL_FOLDERS = ("/proc", "/sys", "/dev")


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of file, and what a file of it may hold at most.

    Attributes:
        name: for messages, such as "a list".
        most_mb: megabytes (2^20 bytes).
        most_lines: of text.
        longest_line: in characters.
        missing: what is said where there is no such file.
        fix: what is said to be done about a file that is missing or cannot be read.
    """

    name: str
    most_mb: float
    most_lines: int = 1_500_000
    longest_line: int = 1 << 16
    missing: str = "cannot be read: No such file or directory"
    fix: str | None = None


def read_bytes(path: StrPath, kind: Kind, error: type[InputError]) -> bytes:
    """What a file holds.

    Raises:
        InputError: of the type `error`, naming the file: it is missing, no regular file, or larger than its kind.
    """
    with open_binary(path, kind, error) as stream:
        try:
            return stream.read(min(os.fstat(stream.fileno()).st_size, int(kind.most_mb * _MEGABYTE)))
        except OSError as problem:
            raise error(f"cannot be read: {problem.strerror}", path=path, fix=kind.fix) from problem


def open_binary(path: StrPath, kind: Kind, error: type[InputError]) -> BinaryIO:
    """An open stream of a file's bytes, for what is too large to be read at once. Raises as `read_bytes`."""
    path = Path(path)
    try:
        _check(path.stat(), path, kind, error)
        # The entry may have been replaced since it was looked at; a pipe then opens without waiting.
        stream = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY), "rb")
        try:
            _check(os.fstat(stream.fileno()), path, kind, error)
        except BaseException:
            stream.close()
            raise
        return stream
    except FileNotFoundError as missing:
        raise error(kind.missing, path=path, fix=kind.fix) from missing
    except OSError as problem:
        raise error(f"cannot be read: {problem.strerror}", path=path, fix=kind.fix) from problem
    except ValueError as problem:  # NUL, or half a character, in the path
        raise error("is no name of a file", path=str(path), fix=kind.fix) from problem


def read_text(path: StrPath, kind: Kind, error: type[InputError]) -> str:
    """The text of a file in UTF-8, or in UTF-16 with its byte order mark; a mark is left out.

    Raises:
        InputError: as `read_bytes`, and for what is no text, holds NUL, or has too many lines.
    """
    path = Path(path)
    data = read_bytes(path, kind, error)
    is_utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if is_utf16 else "utf-8-sig")
    except UnicodeDecodeError as problem:
        raise error("is not a text file", path=path, fix="save it as text in UTF-8") from problem
    nul = text.find("\0")
    if nul >= 0:
        line = len(lines_of(text[:nul]))
        raise error("holds a NUL character", path=path, line=line, fix="save it as text in UTF-8")
    if max(text.count("\n"), text.count("\r")) > kind.most_lines:
        raise error(f"has more lines than {kind.name} may have: {kind.most_lines}", path=path, fix="split it")
    begin = _long_line(text, kind.longest_line)
    if begin is not None:
        line = len(lines_of(text[:begin]))
        raise error(f"is longer than {kind.longest_line} characters", path=path, line=line, fix="is it text?")
    return text


def _long_line(text: str, longest: int) -> int | None:
    """Where the first line begins that has more characters than `longest`; None where there is none."""
    begin = 0
    while len(text) - begin > longest:
        after = max(text.rfind(end, begin, begin + longest + 1) for end in "\n\r")
        if after < 0:
            return begin
        begin = after + 1
    return None


def lines_of(text: str) -> list[str]:
    """Lines as editors count them: they end in line feed, carriage return, or both; the last may be empty."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def is_there(path: StrPath) -> bool:
    """Whether there is anything at `path`, be it no file at all or a link to nothing, so that reading it says so."""
    return os.path.lexists(path)


def _check(status: os.stat_result, path: Path, kind: Kind, error: type[InputError]) -> None:
    """Raise `error` for what is no ordinary file, or larger than its kind."""
    for is_odd, problem in _ODD:
        if is_odd(status.st_mode):
            raise error(problem, path=path, fix=_COPY)
    if status.st_dev in _kernel_devices():
        raise error("is no file on a disk, but made by the system", path=path, fix=_COPY)
    if status.st_size > kind.most_mb * _MEGABYTE:
        holds, may = _size(status.st_size), _size(kind.most_mb * _MEGABYTE)
        problem = f"holds {holds}, more than {kind.name} may: {may}"
        raise error(problem, path=path, fix="is it the right file?")


def _size(size_bytes: float) -> str:
    return f"{size_bytes / _MEGABYTE:.0f} MB" if size_bytes >= _MEGABYTE else f"{size_bytes / 1024:.0f} kB"


@cache
def _kernel_devices() -> frozenset[int]:
    """Numbers of the file systems whose files the kernel makes up as they are read."""
    return frozenset(Path(folder).stat().st_dev for folder in _KERNEL_FOLDERS if os.path.ismount(folder))
