"""Going on with a recording that was broken off: whether that can be, and what is left over of its end."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from wheelsight.calibration import Calibration, load_calibration
from wheelsight.errors import CalibrationError, OutputError
from wheelsight.inputs import is_there
from wheelsight.recordings.native import wheels_header

_IMAGE_FOLDERS = "rgb", "depth", "infrared"
_LEFT_OVER = re.compile(r"\..+\.[0-9a-f]{8}")  # as files.atomic_write calls what is not whole yet


def resumed_calibration(folder: Path) -> Calibration | None:
    """Of the recording that is to go on; None where there is none yet, or it has no calibration.

    Raises CalibrationError.
    """
    path = folder / "calibration.yaml"
    return load_calibration(path) if is_there(path) else None


def check_resumable(folder: Path, calibration: Calibration | None) -> None:
    """Refuse a folder that holds something else, or a recording that frames of these cameras do not go on.

    Raises OutputError.
    """
    if not folder.is_dir() or not any(folder.iterdir()):
        return
    another = "record into another --out"
    if not is_there(folder / "wheels.csv"):
        raise OutputError("holds no recording that could go on", path=folder, fix=another)
    try:
        before = resumed_calibration(folder)
    except CalibrationError as error:
        raise OutputError(f"cannot go on: {error.problem}", path=error.path or folder, fix=another) from error
    if _sizes(before) != _sizes(calibration):
        problem = f"holds a recording of {_told(before)}, which {_told(calibration)} cannot go on"
        raise OutputError(problem, path=folder, fix=another)
    headers = [wheels_header(of) for of in (before, calibration)]
    if headers[0] != headers[1]:
        problem = f"its wheels.csv has {headers[0]}, which {headers[1]} cannot go on"
        raise OutputError(problem, path=folder, fix=another)


def remove_leftovers(folder: Path) -> None:
    """Remove what was written only in part when the recording was broken off."""
    for place in (folder, *(folder / name for name in _IMAGE_FOLDERS)):
        for path in place.glob(".*") if place.is_dir() else ():
            if _LEFT_OVER.fullmatch(path.name) and path.is_file():
                with suppress(OSError):
                    path.unlink()


def last_stamp_s(lines: Sequence[str]) -> float:
    """The stamp of the last line of a list or table. Raises OutputError where it is none."""
    word = re.split(r"[\s,]", lines[-1], maxsplit=1)[0]
    try:
        return float(word)
    except ValueError as error:
        raise OutputError(f"a last line of {lines[-1]!r} has no stamp", fix="remove the line, then --resume") from error


def _sizes(calibration: Calibration | None) -> tuple[tuple[int, int], ...]:
    """Of the images of both cameras; nothing where there are none."""
    if calibration is None or calibration.color is None:
        return ()
    return tuple((camera.width, camera.height) for camera in calibration.cameras)


def _told(calibration: Calibration | None) -> str:
    sizes = _sizes(calibration)
    return f"a camera of {' and '.join(f'{w}×{h}' for w, h in dict.fromkeys(sizes))}" if sizes else "wheels alone"
