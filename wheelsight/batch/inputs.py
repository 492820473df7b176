"""Which recordings are meant, and a digest that changes when one of their files does."""

from __future__ import annotations

import glob
import hashlib
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from wheelsight.batch.settings import BatchSettings
from wheelsight.errors import ConfigError
from wheelsight.files import StrPath
from wheelsight.recordings import find_recordings

_PACKAGE = Path(__file__).resolve().parent.parent


class Digest(NamedTuple):
    """Of files: text that stands for their content, and how many bytes they have."""

    text: str
    size: int


def named_recordings(names: Sequence[str]) -> tuple[Path, ...]:
    """Recordings by what a user names: paths, patterns such as "data/2026-*", folders that hold recordings.

    In the order in which they were named, each once. A path at which nothing is stays, so that it is told.

    Raises:
        ConfigError: a pattern that fits nothing.
    """
    found: dict[Path, Path] = {}
    for name in names:
        for path in _expanded(name):
            for recording in _at(path):
                found.setdefault(recording.resolve(), recording)
    return tuple(found.values())


def _expanded(name: str) -> list[Path]:
    path = Path(name)
    if path.exists() or not glob.has_magic(name):
        return [path]
    fitting = sorted(Path(one) for one in glob.glob(name, recursive=True))  # noqa: PTH207 - absolute patterns, too
    if not fitting:
        raise ConfigError(f"nothing fits {name}", fix="check the pattern")
    return fitting


def _at(path: Path) -> list[Path]:
    return (find_recordings(path) if path.is_dir() else []) or [path]


def digest_of(path: StrPath, settings: BatchSettings | None = None) -> Digest:
    """Of a file, or of all files below a folder: their names, sizes and content; not where they lie.

    Raises:
        OSError: something there cannot be read.
    """
    root, limits = Path(path), settings or BatchSettings()
    whole, size = hashlib.sha256(), 0
    for file in _files(root):
        about = file.stat()
        size += about.st_size
        name = file.relative_to(root).as_posix() if file != root else ""
        whole.update(f"{name}\0{about.st_size}\0".encode(errors="surrogateescape"))
        if about.st_size <= limits.whole_bytes:
            whole.update(hashlib.sha256(file.read_bytes()).digest())
        else:
            whole.update(f"{about.st_mtime_ns}\0".encode())
            for piece in _pieces(file, about.st_size, limits.piece_bytes):
                whole.update(piece)
    return Digest(whole.hexdigest(), size)


def _files(root: Path) -> Iterable[Path]:
    if not root.is_dir():
        return [root]
    return (path for path in sorted(root.rglob("*")) if path.is_file())


def _pieces(file: Path, size: int, length: int) -> Iterator[bytes]:
    with file.open("rb") as stream:
        for begin in (0, max(size // 2 - length // 2, 0), max(size - length, 0)):
            stream.seek(begin)
            yield stream.read(length)


@cache
def code_digest() -> str:
    """Of wheelsight's own modules: what one version found is not taken for what another would find."""
    whole = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        whole.update(f"{path.relative_to(_PACKAGE).as_posix()}\0".encode())
        whole.update(path.read_bytes())
    return whole.hexdigest()
