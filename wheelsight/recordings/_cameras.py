"""Calibrations that come with the package, by name; none is ever chosen silently."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from wheelsight.calibration import Calibration, load_calibration
from wheelsight.errors import CalibrationError
from wheelsight.files import StrPath
from wheelsight.inputs import is_there
from wheelsight.recordings.protocol import OpenOptions

_FOLDER = Path(__file__).parent / "cameras"


def camera_names() -> list[str]:
    """Names of the calibrations that come with the package, sorted."""
    return sorted(path.stem for path in _FOLDER.glob("*.yaml"))


def load_camera(name: StrPath) -> Calibration:
    """A calibration that comes with the package, by its name, or any calibration.yaml, by its path.

    Raises:
        CalibrationError: neither a known name nor a file, or a file that is no calibration.
    """
    if name in camera_names():
        return load_calibration(_FOLDER / f"{name}.yaml")
    if is_there(Path(name)):
        return load_calibration(Path(name))
    raise CalibrationError(f"no camera is called {str(name)!r} and no such file exists", fix=camera_choices())


def camera_choices() -> str:
    """What a user may answer when asked for the camera."""
    return f"say which with --camera: {', '.join(camera_names())}, or a calibration.yaml"


def choose_calibration(folder: Path, options: OpenOptions, otherwise: Callable[[], Calibration]) -> Calibration:
    """The calibration the user names, else the folder's calibration.yaml, else what its format knows.

    Over it goes what `options.calibrations` tell of any part of the robot; where nothing else is known, they serve.
    """
    over, own = options.calibrations, folder / "calibration.yaml"
    if options.camera is not None:
        return load_calibration(*over, under=load_camera(options.camera))
    if is_there(own):
        return load_calibration(own, *over)
    try:
        known = otherwise()
    except CalibrationError:
        if not over:
            raise
        return load_calibration(*over)
    return load_calibration(*over, under=known)
