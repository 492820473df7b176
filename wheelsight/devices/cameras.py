"""Live cameras that a robot can carry, by name; each is opened when it is asked for."""

from __future__ import annotations

from collections.abc import Callable

from wheelsight.devices.robot_link import Frames
from wheelsight.errors import DeviceError

LIVE_CAMERAS: dict[str, Callable[[], Frames]] = {}
"""How each is opened; a module of a camera puts itself in."""


def open_live_camera() -> Frames:
    """The first that is known. Raises DeviceError where none is."""
    if not LIVE_CAMERAS:
        raise DeviceError(
            "no live camera can be read yet, and without one a robot would drive blind",
            fix="drive in the simulator: --sim WORLD",
        )
    return next(iter(LIVE_CAMERAS.values()))()
