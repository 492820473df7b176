"""Which reader opens which folder."""

from __future__ import annotations

from pathlib import Path

from wheelsight.errors import RecordingError
from wheelsight.recordings.measurement_lines import MeasurementLineReader
from wheelsight.recordings.native import NativeReader
from wheelsight.recordings.openloris import OpenLorisReader
from wheelsight.recordings.protocol import OpenOptions, Reader, Recording
from wheelsight.recordings.seven_scenes import SevenScenesReader
from wheelsight.recordings.skid_steer import SkidSteerReader
from wheelsight.recordings.tum import TumReader
from wheelsight.recordings.velocities import VelocityReader

_READERS: tuple[Reader, ...] = (
    NativeReader(),
    OpenLorisReader(),
    SevenScenesReader(),
    TumReader(),
    SkidSteerReader(),
    VelocityReader(),
    MeasurementLineReader(),
)
_SEARCH_DEPTH = 3


def reader_names() -> list[str]:
    """Names of the formats that can be opened, sorted."""
    return sorted(reader.name for reader in _READERS)


def open_recording(path: Path | str, options: OpenOptions | None = None) -> Recording:
    """The recording in a folder, by the first reader that recognises it.

    Args:
        path: a folder of one of the formats in `reader_names()`.
        options: what the files do not say; None for the defaults.

    Raises:
        InputError: the folder is missing, is of no known format, or cannot be read; one line with file and fix.
    """
    folder = Path(path)
    try:
        return _open(folder, options or OpenOptions())
    except OSError as error:  # a folder that may not be looked into, a name that is too long
        raise RecordingError(f"cannot be read: {error.strerror}", path=folder, fix="check the path") from error
    except ValueError as error:
        if "null byte" not in str(error):
            raise
        raise RecordingError("is no name of a folder", path=str(folder), fix="check the path") from error


def _open(folder: Path, options: OpenOptions) -> Recording:
    if not folder.exists():
        raise RecordingError("there is no such folder", path=folder, fix="check the path")
    if not folder.is_dir():
        raise RecordingError("is a file, but a recording is a folder", path=folder, fix="give the folder")
    reader = _reader_of(folder)
    if reader is None:
        raise _unknown(folder)
    return reader.open(folder, options)


def find_recordings(folder: Path | str) -> list[Path]:
    """Folders at or up to three levels below `folder` that some reader recognises, sorted; hidden ones are left out."""
    return sorted(_find(Path(folder), _SEARCH_DEPTH))


def _find(folder: Path, levels: int) -> list[Path]:
    if not folder.is_dir():
        return []
    if _reader_of(folder) is not None:
        return [folder]
    if levels == 0:
        return []
    try:
        below = [path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")]
    except OSError:  # a folder that may not be looked into holds nothing that can be opened
        return []
    return [found for path in below for found in _find(path, levels - 1)]


def _reader_of(folder: Path) -> Reader | None:
    return next((reader for reader in _READERS if reader.recognises(folder)), None)


def _unknown(folder: Path) -> RecordingError:
    inside = find_recordings(folder)
    if inside:
        return RecordingError("is no recording itself", path=folder, fix=f"did you mean {inside[0]}?")
    needs = "; ".join(f"{reader.name} needs {reader.needs}" for reader in _READERS)
    return RecordingError("no reader recognises this folder", path=folder, fix=needs)
