"""A live camera of a robot, with its own calibration laid under that of the robot."""

from __future__ import annotations

from collections.abc import Sequence

from wheelsight.calibration import Calibration, load_calibration
from wheelsight.devices.cameras import open_live_camera
from wheelsight.devices.live_camera import LiveCamera
from wheelsight.errors import CalibrationError
from wheelsight.files import StrPath
from wheelsight.settings import LiveCameraSettings

ANY = "any"


def open_robot_camera(
    which: str, settings: LiveCameraSettings, files: Sequence[StrPath] = (), known: Calibration | None = None
) -> tuple[LiveCamera, Calibration]:
    """A live camera, and the calibration of the robot that carries it.

    Args:
        which: as `open_live_camera`; "any" for the first that is plugged in.
        settings: what is asked of it.
        files: calibrations of the robot, laid over each other in this order, and all over the camera's own.
        known: the calibration to go by in place of all these.

    Raises:
        DeviceError: as `open_live_camera`.
        CalibrationError: a file is no calibration, or lacks something.
    """
    asked = known if known is not None or not files else _of_camera(files)
    camera = open_live_camera(None if which == ANY else which, settings, asked)
    try:
        if known is not None:
            return camera, known
        return camera, load_calibration(*files, under=camera.calibration) if files else camera.calibration
    except BaseException:
        camera.close()
        raise


def _of_camera(files: Sequence[StrPath]) -> Calibration | None:
    """What the files tell of a camera; None where they tell of none, or only together with what the camera tells."""
    try:
        found = load_calibration(*files)
    except CalibrationError:
        return None  # told once the camera's own is laid under, unless that mends it
    return None if found.color is None else found
