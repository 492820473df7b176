"""What is no event, said before anything is made of it."""

from __future__ import annotations

from typing import get_args

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.errors import InputError
from wheelsight.events import Event, RgbdFrame, SkippedFrame, WheelSpeeds, WheelTicks, YawRate

_EVENTS = get_args(Event)
_NUMBERS = {
    RgbdFrame: ("stamp_s",),
    SkippedFrame: ("stamp_s",),
    WheelTicks: ("stamp_s", "left", "right"),
    WheelSpeeds: ("stamp_s", "left_rad_s", "right_rad_s"),
    YawRate: ("stamp_s", "yaw_rate_rad_s"),
}


def check_event(event: Event) -> None:
    """Raise InputError for what is no event, or one whose fields hold no numbers. NaN is one, and is judged later."""
    if not isinstance(event, _EVENTS):
        names = ", ".join(kind.__name__ for kind in _EVENTS)
        raise InputError(f"{type(event).__name__} is no event", fix=f"events are {names}")
    for name in _NUMBERS[type(event)]:
        value = getattr(event, name)
        if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
            raise InputError(f"{type(event).__name__}.{name} is {type(value).__name__}, not a number")


def check_images(frame: RgbdFrame) -> None:
    """Raise InputError for arrays that are no images."""
    color, depth_m = np.asarray(frame.color), np.asarray(frame.depth_m)
    if color.dtype != np.uint8 or color.ndim != 3 or color.shape[2] != 3:
        raise InputError(f"RgbdFrame.color is {_kind(color)}", fix="(H, W, 3) of uint8, red green blue")
    if not np.issubdtype(depth_m.dtype, np.floating) or depth_m.ndim != 2:
        raise InputError(f"RgbdFrame.depth_m is {_kind(depth_m)}", fix="(H, W) of float32, metres; 0: nothing measured")


def check_sizes(frame: RgbdFrame, calibration: Calibration) -> None:
    """Raise InputError for images that are not as large as the calibration says."""
    for name, image, camera in (
        ("color", frame.color, calibration.color),
        ("depth_m", frame.depth_m, calibration.depth),
    ):
        if camera is not None and image.shape[:2] != (camera.height, camera.width):
            size, right = f"{image.shape[1]}×{image.shape[0]}", f"{camera.width}×{camera.height}"
            raise InputError(f"RgbdFrame.{name} is {size}, the calibration's {right}", fix="give the camera's own")


def _kind(image: np.ndarray) -> str:
    return f"{image.shape} of {image.dtype}"
