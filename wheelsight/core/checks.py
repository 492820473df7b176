"""Checks of values that Python code passes in: types, shapes and numbers, before OpenCV or a kernel sees them.
`Repeats` detects that a camera delivers the same image again.
"""

from __future__ import annotations

import math
from typing import Any, TypeVar, get_args

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError, PartError
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.core.geometry.arrays import is_number
from wheelsight.core.messages import (
    Event,
    OdometryReading,
    RgbdFrame,
    SkippedFrame,
    WheelCounts,
    WheelSpeeds,
    WheelTicks,
    YawRate,
)

# A stamp or a count that is not finite is a fault of a sensor, so a `Localizer` returns a reason instead. An invalid
# frame, depth that is not in metres, or an invalid motion is an error of the caller, and raises with a fix.


Kind = TypeVar("Kind")

_NUMBERS = {
    RgbdFrame: ("stamp_s",),
    SkippedFrame: ("stamp_s",),
    WheelTicks: ("stamp_s", "left", "right"),
    WheelSpeeds: ("stamp_s", "left_rad_s", "right_rad_s"),
    WheelCounts: ("stamp_s",),
    OdometryReading: ("stamp_s", "x_m", "y_m", "yaw_rad"),
    YawRate: ("stamp_s", "yaw_rate_rad_s"),
}
_RIGID = 1e-4
# Half of what is measured lies nearer than this, in rooms and outdoors; in millimetres it would be a tenth of a metre.
_FARTHEST_MEDIAN_M = 100.0
# No depth camera measures so near; ten metres, divided by 1000 twice, are half of this.
_NEAREST_M = 0.02
_ZEROS = "0 where nothing was measured: np.nan_to_num(depth_m, nan=0, posinf=0, neginf=0)"


def check_event(event: Any, *, finite: bool = False) -> None:
    """Refuse no event, or fields that are no numbers; if `finite`, also those that are not finite.

    Raises ArgumentError.
    """
    names = _NUMBERS.get(type(event))
    if names is None:
        known = ", ".join(kind.__name__ for kind in get_args(Event))
        raise ArgumentError(f"{_kind_of(event)} is no event", fix=f"give one of {known}")
    for name in names:
        value = getattr(event, name)
        if type(value) not in (float, int):
            need_number(f"{name} of {type(event).__name__}", value)
        if finite and not math.isfinite(value):
            raise ArgumentError(f"{name} of {type(event).__name__} is {value}", fix="leave out what is not known")
    if type(event) is WheelTicks:
        if type(event.left) is not int:
            _check_whole("left", event.left)
        if type(event.right) is not int:
            _check_whole("right", event.right)
    elif type(event) is WheelCounts:
        _check_counts(event, finite)


def _check_counts(event: WheelCounts, finite: bool) -> None:
    if not isinstance(event.counts, tuple):
        raise ArgumentError(f"counts of WheelCounts are {_kind_of(event.counts)}, not a tuple", fix="one count a wheel")
    for number, count in enumerate(event.counts, 1):
        need_number(f"count {number} of WheelCounts", count)
        if finite and not math.isfinite(count):
            raise ArgumentError(f"count {number} of WheelCounts is {count}", fix="leave out what is not known")
        _check_whole(f"count {number}", count, "WheelCounts")


def check_frame(frame: Any, calibration: Calibration, covariance: Any = None, **motions: Any) -> None:
    """Refuse no frame of these cameras, motions that are neither None nor rigid, or a covariance that is not (6, 6).

    Raises ArgumentError.
    """
    check_images(frame, calibration)
    check_event(frame, finite=True)
    for name, T in motions.items():
        if T is not None:
            need_motion(name, T)
    if covariance is not None:
        _check_finite("covariance", array_of("covariance", covariance, (6, 6)))


def check_images(frame: Any, calibration: Calibration, *, of_any_size: bool = False) -> None:
    """Refuse no frame, or images that are not of these cameras. Raises ArgumentError.

    Args:
        of_any_size: check only the kind of images.
    """
    if not isinstance(frame, RgbdFrame):
        raise ArgumentError(f"{_kind_of(frame)} is no frame", fix="give an RgbdFrame")
    color, depth = (None, None) if of_any_size else (calibration.color, calibration.depth)
    if not of_any_size and (color is None or depth is None):
        color, depth = calibration.cameras  # raises
    _check_shape("color", frame.color, color, 3)
    if (dtype := frame.color.dtype) != np.uint8:
        is_share = dtype.kind == "f" and frame.color.size and float(np.nanmax(frame.color)) <= 1
        fix = "of 0 to 1, (255 * color).round().astype(np.uint8)" if is_share else "of 0 to 255, color.astype(np.uint8)"
        fix = "of 16 bits, (color >> 8).astype(np.uint8)" if dtype == np.uint16 else fix
        raise ArgumentError(f"color is of {dtype}, not uint8", fix=fix)
    _check_shape("depth_m", frame.depth_m, depth)
    if frame.depth_m.dtype != np.float32:
        raw = "divide raw depth by its units a metre: of millimetres, (depth / 1000).astype(np.float32)"
        fix = raw if frame.depth_m.dtype.kind in "ui" else "depth_m.astype(np.float32)"
        raise ArgumentError(f"depth_m is of {frame.depth_m.dtype}, not float32", fix=fix)
    if wrong := why_no_depth(frame.depth_m, calibration.depth_noise.far_m):
        raise ArgumentError(f"depth_m {wrong[0]}", fix=wrong[1])


def why_no_depth(depth_m: Float32Array, far_m: float) -> tuple[str, str] | None:
    """Return the problem and fix of an image (H, W) that is no depth in metres, 0 where not measured; else None.

    Args:
        far_m: largest depth that the camera measures.
    """
    if not depth_m.size:
        return None
    least, most = float(depth_m.min()), float(depth_m.max())  # each NaN where one is in it
    if not (math.isfinite(least) and math.isfinite(most)):
        return "has numbers that are not finite", _ZEROS
    if least < 0:
        return f"is {least:g} m somewhere", "depth grows forwards from the camera, and is 0 where nothing was measured"
    return why_not_metres(depth_m, far_m, most)


def why_not_metres(depth_m: Float32Array, far_m: float, most: float | None = None) -> tuple[str, str] | None:
    """Return problem and fix if depth (H, W) seems to be in other units, by its values above 0; else None.

    Args:
        far_m: largest depth that the camera measures.
        most: largest depth in the image, if known.
    """
    most = float(np.fmax.reduce(depth_m, axis=None, initial=0.0)) if most is None else most
    if 0 < most < _NEAREST_M:
        return f"is {most:g} m at most, nearer than any depth camera measures", "divide raw depth once, not twice"
    limit_m = max(_FARTHEST_MEDIAN_M, 2 * far_m)
    if most > limit_m and (median_m := float(np.median(depth_m[depth_m > 0]))) > limit_m:
        return (
            f"is {median_m:g} in the median: these are no metres",
            "divide raw depth by its units a metre: millimetres by 1000, TUM's files by 5000",
        )
    return None


def need_motion(name: str, T: Any) -> FloatArray:
    """Return a rigid motion (4, 4). Raises ArgumentError."""
    found = array_of(name, T, (4, 4))
    _check_finite(name, found)
    if wrong := se3.why_invalid(found, tolerance=_RIGID):
        raise ArgumentError(f"{name} is not a rigid motion: {wrong[0]}", fix=wrong[1])
    return found


def need_twist(twist: Any) -> FloatArray:
    """Return a finite velocity (6,), (v, ω). Raises ArgumentError."""
    found = array_of("twist", twist, (6,))
    _check_finite("twist", found)
    return found


def need_kind(name: str, value: Any, kind: type[Kind], fix: str) -> Kind:
    """Return a value of a type. Raises ArgumentError with the fix."""
    if not isinstance(value, kind):
        raise ArgumentError(f"{name} is {_kind_of(value)}, not a {kind.__name__}", fix=fix)
    return value


def need_calibration(calibration: Any) -> Calibration:
    """Return a robot's calibration. Raises ArgumentError, as for a path, a camera, or its K."""
    return need_kind(
        "calibration", calibration, Calibration, "load_calibration(PATH), or Calibration.registered_camera(CAMERA)"
    )


def answer_of(part: object, method: str, *arguments: Any) -> Any:
    """Return the answer of a method of a user's own part. Raises PartError for any exception of the part."""
    try:
        return getattr(part, method)(*arguments)
    except Exception as error:
        said = f"{type(part).__name__}.{method} raised {type(error).__name__}: {error}"
        raise PartError(said, fix="its traceback is the cause of this error") from error


def need_method(name: str, part: Any, method: str) -> None:
    """Refuse a user's own part without its method. Raises ArgumentError."""
    if isinstance(part, type) or not callable(getattr(part, method, None)):
        what = f"the class {part.__name__}" if isinstance(part, type) else _kind_of(part)
        raise ArgumentError(f"{name} is {what}, not an object with a method {method}", fix="docs/api/own-parts.md")


def need_number(name: str, value: Any) -> float:
    """Return a number, finite or not. Raises ArgumentError."""
    if not is_number(value):
        raise ArgumentError(f"{name} is {_kind_of(value)}, not a number")
    return float(value)


def array_of(name: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    """Return numbers of a shape, finite or not. Raises ArgumentError."""
    try:
        found = np.asarray(value, float)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{name} is {_kind_of(value)}, not {shape} of numbers") from error
    if found.shape != shape:
        raise ArgumentError(f"{name} is of shape {found.shape}, not {shape}")
    return found


def _check_finite(name: str, found: FloatArray) -> None:
    if not np.isfinite(found).all():
        raise ArgumentError(f"{name} has numbers that are not finite")


def _check_whole(name: str, count: Any, kind: str = "WheelTicks") -> None:
    """Refuse a count with a fraction, which is no count. One that is not finite is a sensor's fault."""
    if type(count) is not int and math.isfinite(count) and count != int(count):
        fix = "give the encoder's count since its start; of rad/s make WheelSpeeds"
        raise ArgumentError(f"{name} of {kind} is {count:g}, not a whole number of counts", fix=fix)


def _check_shape(name: str, image: Any, camera: PinholeCamera | None, channels: int | None = None) -> None:
    """Refuse no array (H, W) or (H, W, channels), or one that is not of the camera's size."""
    last = () if channels is None else (channels,)
    expected = "(H, W)" if channels is None else f"(H, W, {channels})"
    if camera is not None:
        expected = str((camera.height, camera.width, *last))
    if not isinstance(image, np.ndarray):
        raise ArgumentError(f"{name} is {_kind_of(image)}, not an array {expected}", fix="np.asarray(image)")
    size = image.shape[:2] if camera is None else (camera.height, camera.width)
    if image.ndim < 2 or image.shape != (*size, *last):
        fix = _fix_of_shape(name, image.shape, size)
        raise ArgumentError(f"{name} is of shape {image.shape}, not {expected}", fix=fix)


def _fix_of_shape(name: str, shape: tuple[int, ...], size: tuple[int, ...]) -> str:
    """What to do about an image of another layout or size."""
    is_color = name == "color"
    grey = "of a grey image, cv2.cvtColor(color, cv2.COLOR_GRAY2RGB)"
    four = "color[..., :3] leaves the fourth channel out; of BGRA, cv2.cvtColor(color, cv2.COLOR_BGRA2RGB)"
    squeeze, picture = "depth_m.squeeze()", "give depth itself, not a picture of it"
    of_color = {size: grey, (*size, 1): grey, (*size, 4): four}
    of_depth = {(*size, 1): squeeze, (1, *size): squeeze, (*size, 3): picture}
    fix = (of_color if is_color else of_depth).get(shape)
    if fix is not None:
        return fix
    if is_color and len(shape) == 3 and shape[0] == 3:
        return "color.transpose(1, 2, 0)"
    if len(shape) not in (2, 3) or 0 in shape:
        return "rows, columns" + (", and red, green, blue" if is_color else "")
    if shape[:2] == size[::-1]:
        return "rows come first: transpose the image, or swap width and height of the calibration's camera"
    given, known = f"{shape[1]}×{shape[0]}", f"{size[1]}×{size[0]}"
    fix = f"the calibration is of {known} images: give those, or a calibration of {given} ones"
    if shape[0] * size[1] == shape[1] * size[0]:
        fix += f", with fx, fy, cx, cy times {shape[1] / size[1]:g}"
    return fix if is_color else f"{fix}; depth of its own size has its own camera and T_color_depth"


def _kind_of(value: Any) -> str:
    """The type of a value, in words."""
    return "None" if value is None else f"a {type(value).__name__}"


# Noise never repeats, so some rows decide; the first one nearly always.
_SOME = slice(None, None, 4)


class Repeats:
    """Time since the first of several equal images, as of a camera of 15 Hz that is logged at 30 Hz, or that hangs.

    It copies the rows that it compares, since a driver may reuse its buffers. Images without contrast, as of a covered
    camera, do not count as repeated.
    """

    def __init__(self) -> None:
        self._first_s = np.nan
        self._color, self._depth_m = np.empty((0, 0, 3), np.uint8), np.empty((0, 0), np.float32)

    def lasting_s(self, frame: RgbdFrame) -> float:
        """Return the age of the frame's image; 0 for a new one. Call it once a frame."""
        color, depth_m = frame.color[_SOME], frame.depth_m[_SOME]
        if (
            _are_the_same(color, self._color)
            and _are_the_same(depth_m, self._depth_m)
            and depth_m.any()
            and (np.ptp(color) > 0 or np.ptp(depth_m) > 0)
        ):
            return frame.stamp_s - self._first_s
        self._first_s, self._color, self._depth_m = frame.stamp_s, color.copy(), depth_m.copy()
        return 0.0


def _are_the_same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and len(a) > 0 and np.array_equal(a[0], b[0]) and np.array_equal(a, b)
