"""Which files are one bag: a file, a folder with metadata.yaml, or the parts that a recorder split it into."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from typing import Any

from wheelsight.errors import RecordingError
from wheelsight.inputs import Kind, parse_yaml, read_text

METADATA = "metadata.yaml"
SUFFIXES = (".bag", ".mcap", ".db3")
_PACKED = ".zstd"
_ROS2 = (".mcap", ".db3", f".mcap{_PACKED}", f".db3{_PACKED}")
_PART = re.compile(r"(?P<stem>.+)_(?P<number>\d+)")
_FIX = "remove metadata.yaml: the files beside it are read without it"
# A bag split into a thousand files has 200 kB.
_METADATA = Kind("metadata.yaml of a bag", 0.25, fix=_FIX)
_INFORMATION = "rosbag2_bagfile_information"
_LATEST_VERSION = 9
_STORAGES = ("mcap", "sqlite3")


def parts_of(path: Path) -> tuple[Path, ...]:
    """The paths to open for the bag at `path`, in order of time; empty where there is none, by names alone.

    A folder with metadata.yaml is opened as such. Without one, its files are parts of one bag where they are called
    alike but for a last number; two bags in one folder are no bag.
    """
    if path.is_file():
        return (path,) if path.suffix in SUFFIXES else ()
    entries = _entries(path)
    if (path / METADATA).is_file() and any(entry.name.endswith(_ROS2) for entry in entries):
        return (path,)
    plain = [entry for entry in entries if entry.suffix in SUFFIXES and entry.is_file()]
    if len(plain) == 1:
        return (plain[0],)
    parts = {file: _PART.fullmatch(file.stem) for file in plain}
    kinds = {(match["stem"], file.suffix) if match else None for file, match in parts.items()}
    if len(kinds) != 1 or None in kinds:
        return ()
    numbers = {file: int(match["number"]) for file, match in parts.items() if match is not None}
    return tuple(sorted(numbers, key=lambda file: numbers[file]))


def named_parts(folder: Path) -> tuple[Path, ...]:
    """The files in a folder that its metadata.yaml names, in the order of time.

    Raises RecordingError where it is no such file, names no files or missing ones, or another way of compression.
    """
    path = folder / METADATA
    document = parse_yaml(read_text(path, _METADATA, RecordingError), path, RecordingError)
    about = document.get(_INFORMATION) if isinstance(document, dict) else None
    names = about.get("relative_file_paths") if isinstance(about, dict) else None
    if not isinstance(about, dict) or not isinstance(names, list) or not names:
        raise RecordingError("does not name the files of a bag", path=path, fix=_FIX)
    _check(about, path)
    # Old recorders name the folder, too; a name that leads elsewhere does not.
    parts = [folder / PurePosixPath(str(name)).name for name in names]
    missing = [part.name for part in parts if not part.exists()]
    if missing:
        problem = f"files that metadata.yaml names are missing: {', '.join(missing)}"
        raise RecordingError(problem, path=folder, fix="remove metadata.yaml to read those there are")
    for part in parts:
        if not part.name.endswith(_ROS2):
            raise RecordingError(f"names {part.name}, which is no file of a bag", path=path, fix=_FIX)
    return tuple(dict.fromkeys(parts))


def is_packed(part: Path) -> bool:
    """Whether a file is compressed as a whole."""
    return part.suffix == _PACKED


def _check(about: dict[str, Any], path: Path) -> None:
    version, storage = about.get("version"), about.get("storage_identifier")
    if not isinstance(version, int) or not 0 < version <= _LATEST_VERSION:
        raise RecordingError(f"is of version {version}; 1 to {_LATEST_VERSION} are read", path=path, fix=_FIX)
    if storage not in _STORAGES:
        raise RecordingError(f"its storage is {storage!r}; {' and '.join(_STORAGES)} are read", path=path, fix=_FIX)
    form, mode = about.get("compression_format"), str(about.get("compression_mode") or "none").lower()
    if mode != "none" and form != "zstd":
        raise RecordingError(
            f"its files are compressed as {form!r}; zstd is read", path=path, fix="decompress it first"
        )


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []
