"""Live cameras that a robot can carry, by name; each is opened when it is asked for."""

from __future__ import annotations

from collections.abc import Callable

from wheelsight.calibration import Calibration
from wheelsight.devices.live_camera import LiveCamera
from wheelsight.devices.plugged_in import why_not
from wheelsight.devices.streaming import StreamingCamera
from wheelsight.errors import DeviceError
from wheelsight.settings import LiveCameraSettings

Opener = Callable[[str | None, LiveCameraSettings, Calibration | None], LiveCamera]
"""Of a serial number or file (None for the first that is plugged in), settings, and the calibration to go by."""


def _openni2(where: str | None, settings: LiveCameraSettings, calibration: Calibration | None) -> LiveCamera:
    from wheelsight.devices.openni2 import OpenNI2Driver, is_file

    if where is not None and is_file(where):
        from wheelsight.devices.oni_player import OniPlayer

        return StreamingCamera(OniPlayer(where, settings), settings, calibration)
    return StreamingCamera(OpenNI2Driver(where, settings), settings, calibration)


def _realsense(where: str | None, settings: LiveCameraSettings, calibration: Calibration | None) -> LiveCamera:
    from wheelsight.devices.realsense import RealSenseDriver

    return StreamingCamera(RealSenseDriver(where, settings), settings, calibration)


def _freenect(where: str | None, settings: LiveCameraSettings, calibration: Calibration | None) -> LiveCamera:
    from wheelsight.devices.freenect import FreenectDriver

    return StreamingCamera(FreenectDriver(where, settings), settings, calibration)


def _recording(where: str | None, settings: LiveCameraSettings, calibration: Calibration | None) -> LiveCamera:
    from wheelsight.devices.played_camera import PlayedCamera

    return PlayedCamera.opened(where, settings, calibration)


LIVE_CAMERAS: dict[str, Opener] = {
    "realsense": _realsense,
    "freenect": _freenect,
    "openni2": _openni2,
    "recording": _recording,
}
"""How each kind is opened."""


def open_live_camera(
    which: str | None = None, settings: LiveCameraSettings | None = None, calibration: Calibration | None = None
) -> LiveCamera:
    """A live camera, streaming.

    Args:
        which: its kind, such as "realsense", or kind and serial number or file, such as "openni2:drive.oni"; None for
            the first that is plugged in.
        settings: what is asked of it; None for the defaults.
        calibration: to go by, of the images that are asked for; None for what the camera tells of itself.

    Raises:
        DeviceError: none is there, it is denied or in use, or its library is missing; says what to do.
    """
    asked = settings or LiveCameraSettings()
    kind, _, where = (which or "").partition(":")
    if kind and kind not in LIVE_CAMERAS:
        raise DeviceError(f"no camera is called {kind!r}", fix=f"one of {', '.join(LIVE_CAMERAS)}")
    reasons = []
    for name, opener in LIVE_CAMERAS.items():
        if kind in ("", name):
            try:
                return opener(where or None, asked, calibration)
            except DeviceError as error:
                reasons.append(error)
    # What is plugged in and lacks something tells more than that a library sees nothing.
    told = why_not(kind or None) if not where else None
    raise told or reasons[0]
