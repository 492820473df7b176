"""Which reader opens which folder, or file."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

from wheelsight.core.errors import RecordingError
from wheelsight.core.files import StrPath
from wheelsight.core.inputs import is_there
from wheelsight.io.recordings.azure_kinect import AzureKinectReader
from wheelsight.io.recordings.bags.reader import BagReader
from wheelsight.io.recordings.clock_checks import counter_warnings, listed_stamps, stamp_warnings
from wheelsight.io.recordings.image_recording import ImageRecording
from wheelsight.io.recordings.native import NativeReader
from wheelsight.io.recordings.numbered_datasets import (
    IclNuimReader,
    RedwoodReader,
    ReplicaReader,
    SevenScenesReader,
    ThreeDMatchReader,
)
from wheelsight.io.recordings.recording import Layout, OpenOptions, Reader, Recording
from wheelsight.io.recordings.scannet import ScanNetReader
from wheelsight.io.recordings.tum_datasets import BonnReader, Eth3dReader, OpenLorisReader, TumReader
from wheelsight.io.recordings.wheel_recording import (
    MeasurementLineReader,
    SkidSteerReader,
    VelocityReader,
    WheelRecording,
)

_READERS: tuple[Reader, ...] = (
    NativeReader(),
    OpenLorisReader(),
    ThreeDMatchReader(),
    SevenScenesReader(),
    RedwoodReader(),
    Eth3dReader(),
    IclNuimReader(),
    ReplicaReader(),
    BonnReader(),
    TumReader(),
    SkidSteerReader(),
    VelocityReader(),
    MeasurementLineReader(),
    BagReader(),
    AzureKinectReader(),
    ScanNetReader(),
)
# The recording that comes along, made by benchmarks/sample.py, and its name in place of a path.
SAMPLE_NAME = "sample"
SAMPLE = Path(__file__).parent / "sample"
_LEAST = f"the least is tum's: {TumReader.needs}"
_MOST_NEAR = 3
_SEARCH_DEPTH = 3
_MOST_SEARCHED = 10_000  # folders, which take a second or two


def reader_names() -> list[str]:
    """Names of the formats that can be opened, sorted."""
    return sorted(reader.name for reader in _READERS)


def open_recording(path: StrPath, options: OpenOptions | None = None) -> Recording:
    """The recording at a path, by the first reader that recognises it.

    Args:
        path: a folder, or for bags, an .mkv and a .sens a file, of one of the formats in `reader_names()`; "sample" is
            the recording that comes with the package, unless the current folder has something of that name.
        options: what the files do not say; None for the defaults.

    Raises:
        InputError: the folder is missing, is of no known format, or cannot be read; one line with file and fix.
    """
    folder = Path(path)
    if is_sample(folder):
        folder = SAMPLE
    try:
        return _open(folder, options or OpenOptions())
    except OSError as error:  # a folder that may not be looked into, a name that is too long
        raise RecordingError(f"cannot be read: {error.strerror}", path=folder, fix="check the path") from error
    except ValueError as error:
        if "null byte" not in str(error):
            raise
        raise RecordingError("is no name of a folder", path=str(folder), fix="check the path") from error


def is_sample(path: Path) -> bool:
    """Whether a path names the recording that comes with the package: `sample`, where there is nothing of that name."""
    return path == Path(SAMPLE_NAME) and not is_there(path)


def _open(folder: Path, options: OpenOptions) -> Recording:
    if not folder.exists():
        raise RecordingError("there is no such folder", path=folder, fix="check the path")
    reader = _reader_of(folder)
    if reader is None and not folder.is_dir():
        raise RecordingError(
            "is a file, but no recording in one", path=folder, fix="give the folder, a bag, an .mkv or a .sens"
        )
    if reader is None:
        raise _unknown(folder)
    return _with_doubts(reader.open(folder, options))


def find_recordings(folder: StrPath) -> list[Path]:
    """What some reader recognises at or up to three levels below `folder`, sorted; hidden ones are left out.

    Of very many folders and files, only the first ten thousand are looked at.
    """
    found, level, left = [], [Path(folder)], _MOST_SEARCHED
    for _ in range(_SEARCH_DEPTH + 1):
        paths, left = level[:left], left - len(level)
        known = {path: path.exists() and _reader_of(path) is not None for path in paths}
        found += [path for path in paths if known[path]]
        level = [below for path in paths if not known[path] for below in _below(path)] if left > 0 else []
    return sorted(found)


def _below(folder: Path) -> list[Path]:
    """The folders in a folder, and the files that are recordings; none in one that may not be looked into."""
    try:
        return [path for path in folder.iterdir() if not path.name.startswith(".") and _may_be(path)]
    except OSError:
        return []


def _may_be(path: Path) -> bool:
    # A link that leads to itself is neither.
    return path.is_dir() or (path.is_file() and _reader_of(path) is not None)


def _with_doubts(recording: Recording) -> Recording:
    """The recording, its warnings with what its stamps and counters are unlikely to be."""
    if not isinstance(recording, ImageRecording | WheelRecording):
        return recording
    of_stamps = stamp_warnings(listed_stamps(recording))
    of_counters = counter_warnings(recording.calibration.wheels, recording.wheels)
    return replace(recording, warnings=(*recording.warnings, *of_stamps, *of_counters))


def _reader_of(folder: Path) -> Reader | None:
    return next((reader for reader in _READERS if reader.recognises(folder)), None)


def _unknown(folder: Path) -> RecordingError:
    inside = find_recordings(folder)
    if inside:
        return RecordingError("is no recording itself", path=folder, fix=f"did you mean {inside[0]}?")
    named = {kind: sorted(reader.name for reader in _READERS if reader.layout is kind) for kind in Layout}
    known = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in named.items())
    return RecordingError(f"no reader recognises this folder; known are {known}", path=folder, fix=_fix_of(folder))


def _fix_of(folder: Path) -> str:
    """What else the formats need that need some of what is there; of none, where to read about all of them."""
    near = (f"{reader.name} needs {reader.needs}" for reader in _READERS if _has_some(folder, reader.needs))
    return "; ".join(islice(near, _MOST_NEAR)) or f"docs/recordings.md says which files each needs; {_LEAST}"


def _has_some(folder: Path, needs: str) -> bool:
    names = (word.strip(",;") for word in needs.split())
    return any((folder / name).exists() for name in names if name.endswith("/") or "." in name)
