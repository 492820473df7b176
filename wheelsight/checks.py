"""What is handed in by Python code, looked at before it reaches OpenCV or a kernel: types, shapes, numbers.

A stamp or a count that is not finite is a fault of a sensor, hence a value: it is answered with a reason, and not here.
"""

from __future__ import annotations

from numbers import Real
from typing import Any, get_args

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.errors import ArgumentError
from wheelsight.events import Event, RgbdFrame, SkippedFrame, WheelSpeeds, WheelTicks, YawRate
from wheelsight.geometry import FloatArray, se3

_NUMBERS = {
    RgbdFrame: ("stamp_s",),
    SkippedFrame: ("stamp_s",),
    WheelTicks: ("stamp_s", "left", "right"),
    WheelSpeeds: ("stamp_s", "left_rad_s", "right_rad_s"),
    YawRate: ("stamp_s", "yaw_rate_rad_s"),
}
_RIGID = 1e-4


def check_event(event: Any) -> None:
    """Refuse what is no event, or one whose numbers are none. Raises ArgumentError."""
    names = _NUMBERS.get(type(event))
    if names is None:
        known = ", ".join(kind.__name__ for kind in get_args(Event))
        raise ArgumentError(f"{_told(event)} is no event", fix=f"give one of {known}")
    for name in names:
        value = getattr(event, name)
        if type(value) is not float:
            need_number(f"{name} of {type(event).__name__}", value)


def check_frame(frame: Any, calibration: Calibration, covariance: Any = None, **motions: Any) -> None:
    """Refuse what is no frame of these cameras, or a motion beside it that is neither None nor rigid; or no (6, 6).

    Raises ArgumentError saying what was expected and what came.
    """
    if not isinstance(frame, RgbdFrame):
        raise ArgumentError(f"{_told(frame)} is no frame", fix="give an RgbdFrame")
    check_event(frame)
    color, depth = calibration.cameras
    _check_image("color", frame.color, (color.height, color.width, 3), np.dtype(np.uint8))
    _check_image("depth_m", frame.depth_m, (depth.height, depth.width), np.dtype(np.float32))
    for name, T in motions.items():
        if T is not None:
            need_motion(name, T)
    if covariance is not None:
        _check_finite("covariance", array_of("covariance", covariance, (6, 6)))


def need_motion(name: str, T: Any) -> FloatArray:
    """A rigid motion (4, 4). Raises ArgumentError."""
    found = array_of(name, T, (4, 4))
    _check_finite(name, found)
    if not se3.is_valid(found, tolerance=_RIGID):
        raise ArgumentError(f"{name} is not a rigid motion: orthonormal rotation, last row 0 0 0 1")
    return found


def need_number(name: str, value: Any) -> float:
    """A number, finite or not. Raises ArgumentError."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ArgumentError(f"{name} is {_told(value)}, not a number")
    return float(value)


def array_of(name: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    """Numbers of a shape, finite or not. Raises ArgumentError saying what was expected and what came."""
    try:
        found = np.asarray(value, float)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{name} is {_told(value)}, not {shape} of numbers") from error
    if found.shape != shape:
        raise ArgumentError(f"{name} is of shape {found.shape}, not {shape}")
    return found


def _check_finite(name: str, found: FloatArray) -> None:
    if not np.isfinite(found).all():
        raise ArgumentError(f"{name} has numbers that are not finite")


def _check_image(name: str, image: Any, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    if not isinstance(image, np.ndarray):
        raise ArgumentError(f"{name} is {_told(image)}, not an array {shape} of {dtype}")
    if image.shape != shape:
        fix = "the calibration's images are of this size; H, W, and three colours"
        raise ArgumentError(f"{name} is of shape {image.shape}, not {shape}", fix=fix if len(shape) == 3 else None)
    if image.dtype != dtype:
        raise ArgumentError(f"{name} is of {image.dtype}, not {dtype}", fix=f"{name}.astype(np.{dtype})")


def _told(value: Any) -> str:
    """A value in a word or two, however large it is."""
    return "None" if value is None else f"a {type(value).__name__}"
