"""Checks of events and arguments, before OpenCV, a kernel or a filter sees them.

Types, shapes and numbers come first. `FrameGate` rejects frames that repeat an image.

`SessionClock` maps the stamps of all sensors to one continuous session time, even if their clocks leap.

Clocks are set during a drive (NTP, GPS), hosts sleep, and drivers restart their counters. Session time is the stamp of
a sensor minus an offset, which changes only when the clock of that sensor leaps:

- If all sensors leap together, or all have paused, session time continues `pause_s` later. If clocks were set back it
  continues at once. Differences between stamps of the sensors stay.
- If one sensor leaps alone, its events continue one period after its last one, or with the usual delay behind the
  others. A leap shorter than a stall is only visible once the others lag by the same time; then these are mapped.

A single outlier is no leap: the clock rejects it, and accepts a leap once further stamps follow. A sensor whose first
stamp is far from all others has another epoch; the clock rejects it by name until it comes near.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from statistics import median
from typing import Any, TypeVar, get_args

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError, PartError
from wheelsight.core.estimates import Reason
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.core.geometry.arrays import is_number
from wheelsight.core.messages import (
    Event,
    OdometryReading,
    RgbdFrame,
    SkippedFrame,
    WheelCounts,
    WheelReading,
    WheelSpeeds,
    WheelTicks,
    YawRate,
)
from wheelsight.core.settings import Settings, setting

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


_WAIT_S = 1.0  # at the start, for wheels: their first reading begins the filter
_HANGS_S = 1.0  # of one image; some cameras are logged at a multiple of their rate
# A robot that moves less from frame to frame stands: one that creeps at 2 cm/s moves more.
_MOVED_M, _MOVED_RAD = 0.0005, 0.0005


@dataclass(frozen=True, slots=True)
class FrameRefusal:
    """Why a frame is not aligned.

    Attributes:
        note: for a user.
        is_repeat: whether the image only repeats a previous one: neither a measurement nor a failure.
    """

    note: str
    is_repeat: bool = False


class FrameGate:
    """Rejects frames that repeat an image, and delays the first frames until wheel readings arrive.

    Attributes:
        has_wheels: whether any wheel reading has arrived.
    """

    def __init__(self) -> None:
        self.has_wheels = False
        self._first_s = math.inf
        self._repeats = Repeats()
        self._hangs = list[tuple[float, float]]()  # begin and end of each, or infinity

    def why_not(self, frame: RgbdFrame, T_last_frame: FloatArray | None = None) -> FrameRefusal | None:
        """Return why a frame is rejected, or None.

        Args:
            frame: to check.
            T_last_frame: (4, 4) motion of the camera since the last tracked frame, by the wheels.
        """
        self._first_s = min(self._first_s, frame.stamp_s)
        lasting_s = self._repeats.lasting_s(frame)
        if lasting_s == 0:
            if self._hangs and self._hangs[-1][1] == math.inf:
                self._hangs[-1] = self._hangs[-1][0], frame.stamp_s
            return None
        if T_last_frame is not None:
            way_m, turn_rad = np.linalg.norm(T_last_frame[:3, 3]), se3.angle(T_last_frame[:3, :3])
            if not (way_m > _MOVED_M or turn_rad > _MOVED_RAD):
                return None  # the robot stands: a camera without noise repeats its image
        if lasting_s <= _HANGS_S:
            return FrameRefusal("the same image as before", is_repeat=True)
        if not self._hangs or self._hangs[-1][1] < math.inf:
            self._hangs.append((frame.stamp_s - lasting_s, math.inf))
        return FrameRefusal(f"the camera hangs: the same image for over {_HANGS_S:g} s")

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for a camera that hung."""
        if not self._hangs:
            return ()
        begin_s, end_s = (stamp_s - self._first_s for stamp_s in self._hangs[-1])
        cause = "it repeats one image; check its cable and driver"
        return (left_out_warning("the camera was", len(self._hangs), begin_s, end_s, cause),)

    def waits_for_wheels(self, frame: RgbdFrame) -> bool:
        """Whether a frame is too early to go without wheel readings."""
        self._first_s = min(self._first_s, frame.stamp_s)
        return not self.has_wheels and frame.stamp_s - self._first_s < _WAIT_S


def left_out_warning(sensor_was: str, times: int, begin_s: float, end_s: float, cause: str) -> str:
    """Return the warning of a sensor that was left out, the last time between two times after the first frame."""
    often = "left out" if times == 1 else f"left out {times} times, last"
    until = "on" if end_s == math.inf else f"until {end_s:.1f} s"
    return f"{sensor_was} {often} from {begin_s:.1f} s after the first frame {until}: {cause}"


# A gyroscope is optional, so no other sensor is left out because of it.
_GYROSCOPE = "gyroscope"

# Derived from rates and stalls of sensors, not tuned.
_BACK_S = 0.1  # a stamp this far behind the sensor's last one is of a clock that was set back; less is jitter
_PAUSE_S = 0.4  # session time of a leap of all: over the delay of coasting (0.3 s), below bridged gaps (0.5 s)
_ALIKE_S = 1.0  # leaps of two sensors that differ by less are one
_STALL_S = 0.25  # by stamps of others, no reading is lost within this; smaller leaps of one clock are not noticed
_APART_S = 2.0  # clocks whose first stamps are farther apart have different epochs
_REMEMBERED = 15  # events for the median period, and the median delay behind the others (chosen)
_MOST_WARNINGS = 10  # of leaps, in a run (chosen)
_DERIVED = "derived from rates and stalls of sensors, not tuned"


class ClockSettings(Settings):
    """Thresholds of leaps of clocks."""

    leap_s: float = setting(
        1.0,
        "a stamp this far ahead of all sensors is a leap, or all have paused, seconds; longer than stalls of a busy "
        "host or of USB (half a second)",
        _DERIVED,
        gt=0,
        le=3600,
    )
    followers: int = setting(
        3, "number of consecutive stamps that make a leap; fewer are noise on a line", _DERIVED, ge=1, le=1000
    )
    active_s: float = setting(
        1.1,
        "a sensor with an event within this time before a leap may leap too, and is waited for as long, seconds; "
        "covers a camera at 1 Hz",
        _DERIVED,
        ge=0,
        le=3600,
    )


@dataclass(frozen=True, slots=True)
class Untimed:
    """The reason why a stamp has no session time.

    Attributes:
        reason: of the estimate.
        note: for the user.
    """

    reason: Reason
    note: str


@dataclass
class _Sensor:
    """The state of a sensor's clock.

    Attributes:
        offset_s: stamp minus session time.
        last_s: its newest session time.
        steps_s, behind_s: times of its events since its previous one, and behind the newest of all sensors.
        held_s: stamps minus the offset that may be a leap.
        has_continued: whether it had an event, at the expected time, since stamps of another sensor were held.
    """

    offset_s: float
    last_s: float
    steps_s: deque[float]
    behind_s: deque[float]
    held_s: list[float] = field(default_factory=list)
    has_continued: bool = False

    @property
    def period_s(self) -> float:
        """The median time between its events; 0 if unknown."""
        return median(self.steps_s) if self.steps_s else 0.0

    @property
    def leap_s(self) -> float:
        """The difference of the first held stamp from the expected one."""
        return self.held_s[0] - self.last_s - self.period_s


class SessionClock:
    """Maps stamps of all sensors to session time; see the module.

    Attributes:
        shift_s: stamp of the sensors minus session time.
    """

    def __init__(self, settings: ClockSettings | None = None) -> None:
        self.settings = settings or ClockSettings()
        self.shift_s = 0.0
        self._leaps: list[str] = []
        self._apart: dict[str, str] = {}
        self._sensors: dict[str, _Sensor] = {}
        self._newest_s = self._held_from_s = -math.inf
        # The sensor that was last ahead of all by more than usual, and by how many seconds.
        self._jump: tuple[str, float] | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each of the first accepted leaps, and for each sensor with another epoch."""
        if not self._apart:
            return tuple(self._leaps)
        left_out = (
            f"The {name} {'are' if name == 'wheels' else 'is'} left out: {note}; stamp all sensors by one clock."
            for name, note in self._apart.items()
        )
        return (*left_out, *self._leaps)

    def time_of(self, event: Event) -> float | Untimed:
        """The session time of an event in seconds, or the reason why it has none. Events come in order of arrival."""
        is_camera = isinstance(event, RgbdFrame | SkippedFrame)
        name = "camera" if is_camera else "wheels" if isinstance(event, WheelReading) else _GYROSCOPE
        if not math.isfinite(event.stamp_s):
            return Untimed(Reason.INVALID, f"its stamp is {event.stamp_s}")
        sensor = self._sensors.get(name)
        if sensor is None:
            return self._first(name, event.stamp_s)
        time_s = event.stamp_s - sensor.offset_s
        # A single sensor may pause for any time.
        ahead = len(self._sensors) > 1 and time_s > self._newest_s + self.settings.leap_s
        if ahead or time_s < sensor.last_s - _BACK_S:
            if not self._has_leapt(sensor, time_s):
                by = _seconds(time_s - sensor.last_s)
                return Untimed(Reason.CLOCKS_APART, f"the clock of the {name} leaps by {by}")
            self._accept_leap(name, sensor)
            time_s = event.stamp_s - sensor.offset_s
        elif self._jump is not None and self._lags(name, sensor, time_s):
            sensor.held_s.append(time_s)
            if len(sensor.held_s) < self.settings.followers:
                return Untimed(Reason.CLOCKS_APART, "the clock of another sensor leaps")
            # Map this sensor, and all others that have not leapt, to the time of the one that has.
            assert self._jump is not None
            (leapt, by_s), self._jump = self._jump, None
            self._warn_of_leap([leapt], by_s)
            for other in (one for other, one in self._sensors.items() if other != leapt):
                other.offset_s -= by_s
                other.last_s += by_s
            time_s = event.stamp_s - sensor.offset_s
        sensor.held_s.clear()
        if time_s <= sensor.last_s:
            last = f"{sensor.last_s + self.shift_s:.6f} s"
            return Untimed(Reason.CLOCK_BACKWARDS, f"its stamp does not come after {last}")
        self._accept(name, sensor, time_s)
        return time_s

    def _first(self, name: str, stamp_s: float) -> float | Untimed:
        time_s = stamp_s - self.shift_s
        apart_s = time_s - self._newest_s
        if self._sensors and abs(apart_s) > _APART_S:
            if [*self._sensors] != [_GYROSCOPE]:
                return self._left_out(name, apart_s, " and the ".join(self._sensors))
            self._left_out(_GYROSCOPE, -apart_s, name)
            self._sensors.clear()
            self._newest_s = time_s
        steps_s, behind_s = (deque[float](maxlen=_REMEMBERED) for _ in range(2))
        self._sensors[name] = _Sensor(self.shift_s, time_s, steps_s, behind_s)
        self._newest_s = max(self._newest_s, time_s)
        return time_s

    def _left_out(self, name: str, apart_s: float, others: str) -> Untimed:
        where = "ahead of" if apart_s > 0 else "behind"
        note = f"the clock of the {name} is {_seconds(abs(apart_s))} {where} that of the {others}"
        self._apart.setdefault(name, note)
        return Untimed(Reason.CLOCKS_APART, note)

    def _accept(self, name: str, sensor: _Sensor, time_s: float) -> None:
        ahead_s = time_s - max(self._newest_s, sensor.last_s + sensor.period_s)
        if ahead_s > _STALL_S and len(self._sensors) > 1:
            self._jump = name, ahead_s
        elif self._jump is not None and name != self._jump[0]:
            self._jump = None  # it paused, as the others did
        sensor.steps_s.append(time_s - sensor.last_s)
        sensor.behind_s.append(self._newest_s - time_s)
        sensor.last_s, sensor.has_continued = time_s, sensor.has_continued or time_s > self._held_from_s
        self._newest_s = max(self._newest_s, time_s)

    def _lags(self, name: str, sensor: _Sensor, time_s: float) -> bool:
        """Whether an event lags by the same time as another sensor's clock seems to have leapt."""
        if self._jump is None or self._jump[0] == name or not sensor.behind_s:
            return False
        later_s = self._newest_s - time_s - median(sensor.behind_s)
        # The newest event is older the longer the period of the sensor that leapt.
        within_s = max(_STALL_S / 2, min(1.5 * self._sensors[self._jump[0]].period_s, _STALL_S))
        return later_s > 0 and abs(later_s - self._jump[1]) < within_s

    def _has_leapt(self, sensor: _Sensor, time_s: float) -> bool:
        """Whether the held stamps are a leap, and the behaviour of the other sensors is known."""
        longest_s = max(self.settings.leap_s, 2 * sensor.period_s)
        if sensor.held_s and not 0 < time_s - sensor.held_s[-1] < longest_s:
            sensor.held_s.clear()  # noise, not one clock
        if not sensor.held_s:
            for other in self._sensors.values():
                other.has_continued = False
            self._held_from_s = self._newest_s  # events that were on their way then do not show a leap
        sensor.held_s.append(time_s)
        if len(sensor.held_s) < self.settings.followers:
            return False
        waited = time_s - sensor.held_s[0] > self.settings.active_s
        return waited or all(
            other.has_continued or (other.held_s and abs(sensor.leap_s - other.leap_s) < _ALIKE_S)
            for other in self._others(sensor)
        )

    def _others(self, sensor: _Sensor) -> list[_Sensor]:
        """The other sensors with an event just before the leap, or since."""
        since_s = sensor.last_s - self.settings.active_s
        return [other for other in self._sensors.values() if other is not sensor and other.last_s >= since_s]

    def _accept_leap(self, name: str, sensor: _Sensor) -> None:
        """Shift the offset of this sensor if others continued meanwhile, else those of all sensors."""
        if any(other.has_continued for other in self._others(sensor)):
            among_others_s = self._newest_s - (median(sensor.behind_s) if sensor.behind_s else 0.0)
            next_s = sensor.last_s + sensor.period_s
            without_loss_s = next_s + sensor.held_s[-1] - sensor.held_s[0]
            is_whole = abs(without_loss_s - among_others_s) <= _STALL_S
            # Session time of the last held stamp, by the events of the other sensors.
            continued_s = without_loss_s if is_whole else max(among_others_s, next_s)
            by_s, leapt = sensor.held_s[-1] - continued_s, {name: sensor}
        else:
            # A clock that is set back shows no pause: the held stamps are one period apart.
            without_s = sensor.period_s + sensor.held_s[-1] - sensor.held_s[0]
            pause_s = _PAUSE_S if sensor.held_s[-1] > self._newest_s else without_s
            by_s = sensor.held_s[-1] - self._newest_s - pause_s
            leapt = dict(self._sensors)
            self.shift_s += by_s
            self._newest_s += pause_s
        for each in leapt.values():
            each.offset_s += by_s
            each.held_s.clear()
        self._warn_of_leap(list(leapt), by_s)

    def _warn_of_leap(self, names: list[str], by_s: float) -> None:
        if len(self._leaps) < _MOST_WARNINGS:
            clocks = f"clock{'s' if len(names) > 1 else ''} of the {' and the '.join(names)}"
            continuation = "events after it continue without a break"
            silent = ", or all sensors paused that long" if by_s > 0 and len(names) == len(self._sensors) else ""
            self._leaps.append(f"The {clocks} leapt by {_seconds(by_s)}{silent}: {continuation}.")


def _seconds(seconds: float) -> str:
    return f"{seconds:.3g} s" if abs(seconds) < 1e4 else f"{seconds:.3e} s"
