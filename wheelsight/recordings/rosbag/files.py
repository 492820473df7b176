"""Which files are one bag: a file, a folder with metadata.yaml, or the parts that a recorder split it into."""

from __future__ import annotations

import re
from pathlib import Path

METADATA = "metadata.yaml"
SUFFIXES = (".bag", ".mcap", ".db3")
_ROS2 = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
_PART = re.compile(r"(?P<stem>.+)_(?P<number>\d+)")


def parts_of(path: Path) -> tuple[Path, ...]:
    """What is to be opened for the bag at `path`, in order of time; empty where there is none, by names alone.

    A folder with metadata.yaml is opened as such. Without one, its files are parts of one bag where they are called
    alike but for a last number; two bags in one folder are no bag.
    """
    if path.is_file():
        return (path,) if path.suffix in SUFFIXES else ()
    names = [file for file in _files_in(path) if file.name.endswith((*SUFFIXES, *_ROS2))]
    if (path / METADATA).is_file() and any(file.name.endswith(_ROS2) for file in names):
        return (path,)
    plain = [file for file in names if file.suffix in SUFFIXES]
    if len(plain) == 1:
        return (plain[0],)
    parts = {file: _PART.fullmatch(file.stem) for file in plain}
    kinds = {(match["stem"], file.suffix) if match else None for file, match in parts.items()}
    if len(kinds) != 1 or None in kinds:
        return ()
    numbers = {file: int(match["number"]) for file, match in parts.items() if match is not None}
    return tuple(sorted(numbers, key=lambda file: numbers[file]))


def _files_in(folder: Path) -> list[Path]:
    try:
        return [file for file in folder.iterdir() if file.is_file()]
    except OSError:
        return []
