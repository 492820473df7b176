"""`open_recording` opens a folder or file by the first reader that recognises it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from wheelsight.core.errors import ConfigError, RecordingError
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
from wheelsight.io.recordings.scannet import ScanNetReader, ScanNetRecording
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
# The recording that comes with the package, made by benchmarks/sample.py, and its name in place of a path.
SAMPLE_NAME = "sample"
SAMPLE = Path(__file__).parent / "sample"
_LEAST = f"the least is tum's: {TumReader.needs}"
_MOST_SUGGESTED = 3
_SEARCH_DEPTH = 3
_MOST_SEARCHED = 10_000  # folders, which take a second or two


def reader_names() -> list[str]:
    """Names of all formats, sorted."""
    return sorted(reader.name for reader in _READERS)


def open_recording(path: StrPath, options: OpenOptions | None = None) -> Recording:
    """The recording at a path, opened by the first reader that recognises it.

    Args:
        path: a folder, or the file of a bag, an .mkv or a .sens, of a format in `reader_names()`. "sample" is the
            recording that comes with the package, unless the current folder has an entry of that name.
        options: information that the files do not contain; None for the defaults.

    Raises:
        InputError: the folder does not exist, has no known format, or cannot be read, or topics are given and it is no
            bag; one line with file and fix.
    """
    folder = Path(path)
    if is_sample(folder):
        folder = SAMPLE
    try:
        if not folder.exists():
            raise RecordingError("there is no such folder", path=folder, fix="check the path")
        reader = _reader_of(folder)
        if reader is None:
            raise _unknown(folder)
        given = options or OpenOptions()
        if given.topics and not isinstance(reader, BagReader):
            raise ConfigError(f"--topic {given.topics[0]} is of a bag, which {folder} is not", fix="leave out --topic")
        recording = reader.open(folder, given)
    except OSError as error:  # no permission, or a name that is too long
        raise RecordingError(f"cannot be read: {error.strerror}", path=folder, fix="check the path") from error
    except ValueError as error:
        if "null byte" not in str(error):
            raise
        raise RecordingError("is not a valid path", path=str(folder), fix="check the path") from error
    if not isinstance(recording, ImageRecording | WheelRecording) or isinstance(recording, ScanNetRecording):
        return recording
    of_stamps = stamp_warnings(listed_stamps(recording))
    of_counters = counter_warnings(recording.calibration.wheels, recording.wheels)
    return replace(recording, warnings=(*recording.warnings, *of_stamps, *of_counters))


def is_sample(path: Path) -> bool:
    """Whether a path names the recording that comes with the package: `sample`, where no such entry exists."""
    return path == Path(SAMPLE_NAME) and not is_there(path)


def _reader_of(folder: Path) -> Reader | None:
    return next((reader for reader in _READERS if reader.recognises(folder)), None)


def _unknown(folder: Path) -> RecordingError:
    """The error for a path that no reader recognises, with the nearest formats or recordings as fix."""
    if not folder.is_dir():
        fix = "give the folder, a bag, an .mkv or a .sens"
        return RecordingError("is a file, but no recording in one", path=folder, fix=fix)
    inside = find_recordings(folder)
    if inside:
        return RecordingError("is no recording itself", path=folder, fix=f"did you mean {inside[0]}?")
    named = {kind: sorted(reader.name for reader in _READERS if reader.layout is kind) for kind in Layout}
    known = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in named.items())
    near = []
    for reader in _READERS:
        files = [name for word in reader.needs.split() if "." in (name := word.strip(",;")) or name.endswith("/")]
        if any((folder / name).exists() for name in files):
            near.append(f"{reader.name} needs {reader.needs}")
    fix = "; ".join(near[:_MOST_SUGGESTED]) or f"docs/recordings.md says which files each needs; {_LEAST}"
    return RecordingError(f"no reader recognises this folder; known are {known}", path=folder, fix=fix)


def find_recordings(folder: StrPath) -> list[Path]:
    """Recordings at or up to three levels below `folder`, sorted, without hidden ones.

    Visits at most ten thousand folders and files.
    """

    def below(folder: Path) -> list[Path]:
        """The folders in a folder, and the files that are recordings; empty without permission to read it."""
        try:
            shown = [path for path in folder.iterdir() if not path.name.startswith(".")]
            # A link to itself is neither a folder nor a file.
            return [path for path in shown if path.is_dir() or (path.is_file() and _reader_of(path) is not None)]
        except OSError:
            return []

    found, level, left = [], [Path(folder)], _MOST_SEARCHED
    for _ in range(_SEARCH_DEPTH + 1):
        paths, left = level[:left], left - len(level)
        known = {path: path.exists() and _reader_of(path) is not None for path in paths}
        found += [path for path in paths if known[path]]
        level = [inner for path in paths if not known[path] for inner in below(path)] if left > 0 else []
    return sorted(found)
