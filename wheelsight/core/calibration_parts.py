"""Parts of a calibration without cameras: depth noise, wheels, holonomic layouts and the gyroscope. Errors name the
field of the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.geometry.arrays import is_number
from wheelsight.core.messages import NearbyReading

Part = TypeVar("Part")


class Range(NamedTuple):
    """Allowed values of a number, ends included.

    Attributes:
        unit: for messages; for m and s an error suggests the value in mm and ms.
        fix: in the message.
    """

    least: float
    most: float
    unit: str
    fix: str | None = None


def check_range(name: str, value: float, allowed: Range) -> None:
    """Raise CalibrationError, with the range, for a number outside it."""
    least, most, unit, fix = allowed
    if least <= value <= most:
        return
    if fix is None and unit in _WHOLE_UNITS:
        fix = f"give {_WHOLE_UNITS[unit]}"
        fix += f": {value:g} m{unit} are {value / 1000:g}" if abs(value) > most else ""
    raise CalibrationError(f"{name} is {value:g}, not {least:g} to {most:g} {unit}".rstrip(), fix=fix)


def need_numbers(part: object, names: tuple[str, ...]) -> None:
    """Raise CalibrationError for a field of a part that is no number, such as text."""
    for name in names:
        value = getattr(part, name)
        if not is_number(value):
            raise CalibrationError(f"{name} of {type(part).__name__} is a {type(value).__name__}, not a number")


_WHOLE_UNITS = {"m": "metres", "s": "seconds"}


def made(kind: Callable[..., Part], name: str, numbers: dict[str, Any]) -> Part:
    """Return a part of these fields; its errors name the part."""
    try:
        return kind(**numbers)
    except CalibrationError as error:
        raise CalibrationError(f"field {name}: {error.problem}", fix=error.fix) from error


def mapping(value: Any, name: str, known: tuple[str, ...]) -> dict[str, Any]:
    """Return a mapping with known keys only. Raises CalibrationError."""
    if not isinstance(value, dict):
        raise CalibrationError(f"field {name} must hold names and values")
    for key in value:
        if key not in known:
            raise CalibrationError(f"field {name} has an unknown entry {key!r}", fix=f"known: {', '.join(known)}")
    return value


def motion(value: Any, name: str) -> FloatArray | None:
    """Return a (4, 4) of four rows of four numbers, or None. Raises CalibrationError."""
    if value is None:
        return None
    try:
        T = np.array(value, float)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"field {name} must be four rows of four numbers") from error
    if T.shape != (4, 4):
        raise CalibrationError(f"field {name} must be four rows of four numbers")
    return T


def whole(value: Any, name: str, of_what: str = " of pixels") -> int:
    """Return a number without a fraction. Raises CalibrationError."""
    found = number(value, name)
    if found != int(found):
        raise CalibrationError(f"field {name} is {value!r}, not a whole number{of_what}")
    return int(found)


def number(value: Any, name: str) -> float:
    """Return a finite number. Raises CalibrationError."""
    try:
        found = float(value)  # from text too: YAML 1.1 reads 1e-3, without a dot, as text
    except (TypeError, ValueError):
        found = np.nan
    if isinstance(value, bool) or not np.isfinite(found):
        raise CalibrationError(f"field {name} is {value!r}, not a number")
    return found


_WIDEST_COUNTER_BITS = 64
_COUNTER_FIELDS = ("counter_bits", "counter_modulus")
# From toys to tractors; counts a turn from 1, for speeds in place of ticks, to fine encoders behind a gear.
_OF_WHEELS = {
    "left_radius_m": Range(0.005, 2.0, "m"),
    "right_radius_m": Range(0.005, 2.0, "m"),
    "track_width_m": Range(0.02, 10.0, "m"),
    "ticks_per_turn": Range(1.0, 1e9, "", "counts a turn of the encoder × gear ratio"),
    "delay_s": Range(-10.0, 10.0, "s"),
    "slip_m_per_sqrt_m": Range(0.0, 1.0, "m/√m"),
    "max_speed_m_s": Range(0.01, 100.0, "m/s"),
    "max_gap_s": Range(0.001, 3600.0, "s"),
    "scale_sigma": Range(0.0, 1.0, "", "0.01 for radii that are known to 1 %"),
    "drift_sigma_rad_per_m": Range(0.0, 1.0, "rad/m"),
    "turn_sigma": Range(0.0, 1.0, "", "0.01 for a track width that is known to 1 %"),
}
# Error of each radius as a share, so that two wheels differ by 1 %: see `ErrorStateSettings.drift_sigma_rad_per_m`.
_NOMINAL_RADIUS_SIGMA = 0.01 / math.sqrt(2)
# Optional: 0 is unknown.
WHEEL_SIGMAS = ("scale_sigma", "drift_sigma_rad_per_m", "turn_sigma")
# No robot makes ten turns a second, and no working gyroscope has such a bias.
_OF_GYRO = {
    "noise_rad_per_sqrt_s": Range(0.0, 10.0, "rad/√s"),
    "bias_rad_s": Range(-10.0, 10.0, "rad/s"),
    "bias_sigma_rad_s": Range(0.0, 10.0, "rad/s"),
    "bias_walk_rad_s_per_sqrt_s": Range(0.0, 1.0, "rad/s/√s"),
}
# At 1 m/m², σ of a depth of one metre is a metre; no depth camera measures a kilometre.
_OF_DEPTH = {
    "constant_m": Range(0.0, 1.0, "m"),
    "quadratic_per_m": Range(0.0, 1.0, "1/m"),
    "near_m": Range(0.0, 100.0, "m"),
    "far_m": Range(0.0, 1000.0, "m"),
}


@dataclass(frozen=True, slots=True)
class DepthNoise:
    """Standard deviation of a depth reading, σ(z) = constant_m + quadratic_per_m · z², and the trusted range.

    The default is Kinect v1's: Khoshelham & Elberink, Sensors 12 (2012), fitted σ(z) = 1.425e-3 z²; depth images
    in millimetres add a constant of about one.
    """

    constant_m: float = 0.001
    quadratic_per_m: float = 1.425e-3
    near_m: float = 0.3
    far_m: float = 10.0

    def __post_init__(self) -> None:
        need_numbers(self, tuple(_OF_DEPTH))
        numbers = (self.constant_m, self.quadratic_per_m, self.near_m, self.far_m)
        if not np.isfinite(numbers).all() or min(numbers) < 0 or self.constant_m + self.quadratic_per_m == 0:
            raise CalibrationError("depth noise takes finite numbers, not negative, and not both zero")
        for name, allowed in _OF_DEPTH.items():
            check_range(name, getattr(self, name), allowed)
        if self.near_m >= self.far_m:
            raise CalibrationError(f"depth range {self.near_m} to {self.far_m} m is empty")

    def sigma_m(self, depth_m: ArrayLike) -> FloatArray:
        """Return standard deviations (...) in metres of depths (...) in metres."""
        return self.constant_m + self.quadratic_per_m * np.asarray(depth_m, float) ** 2


@dataclass(frozen=True, slots=True)
class Wheels:
    """Two driven wheels on one axle, or two sides of a skid-steered robot, and their encoders.

    Attributes:
        left_radius_m, right_radius_m: of the wheels under load.
        track_width_m: distance between the contact points of the wheels. That of a skid-steered robot is effective,
            wider than the robot.
        ticks_per_turn: counts of the encoder per turn of the wheel: counts per turn of the encoder × gear ratio.
        counter_bits: width of the counters, 1 to 64; 0 for ticks that never roll over.
        delay_s: a reading stamped t describes the wheels at t - delay_s. May be negative.
        slip_m_per_sqrt_m: standard deviation of a wheel's travel over one metre; its square grows with the distance.
        max_speed_m_s: largest speed of a wheel; a faster step is a fault.
        max_gap_s: longest time between readings that odometry bridges.
        scale_sigma, drift_sigma_rad_per_m, turn_sigma: standard deviations of these sizes: relative error of distances,
            turn per metre by unequal wheels, relative error of turns. 0 if unknown; then the filter has typical values
            for a data sheet.
        counter_modulus: number of values before a counter rolls over, if no power of two, such as 9000 for 0 … 8999;
            0 if `counter_bits` gives it.

    Raises:
        CalibrationError: an impossible value.
    """

    left_radius_m: float
    right_radius_m: float
    track_width_m: float
    ticks_per_turn: float
    counter_bits: int = 0
    delay_s: float = 0.0
    slip_m_per_sqrt_m: float = 0.01
    max_speed_m_s: float = 5.0
    max_gap_s: float = 0.5
    counter_modulus: int = 0
    scale_sigma: float = 0.0
    drift_sigma_rad_per_m: float = 0.0
    turn_sigma: float = 0.0

    def __post_init__(self) -> None:
        need_numbers(self, (*_OF_WHEELS, *_COUNTER_FIELDS))
        for name in (*_OF_WHEELS, *_COUNTER_FIELDS):
            value = getattr(self, name)
            if not np.isfinite(value):
                raise CalibrationError(f"{name} is {value}, not a number")
            if value <= 0 and name not in (*_COUNTER_FIELDS, *WHEEL_SIGMAS, "delay_s"):
                raise CalibrationError(f"{name} is {value}, not positive")
        if self.counter_bits != int(self.counter_bits) or not 0 <= self.counter_bits <= _WIDEST_COUNTER_BITS:
            raise CalibrationError(f"counter_bits is {self.counter_bits}", fix="1 to 64, or 0: never rolls over")
        if self.counter_modulus != int(self.counter_modulus) or not (
            self.counter_modulus == 0 or 2 <= self.counter_modulus <= 2**_WIDEST_COUNTER_BITS
        ):
            raise CalibrationError(f"counter_modulus is {self.counter_modulus}", fix="9000 for a counter of 0 … 8999")
        if self.counter_bits and self.counter_modulus:
            raise CalibrationError("counter_bits and counter_modulus are both given", fix="leave one out")
        for name, allowed in _OF_WHEELS.items():
            check_range(name, getattr(self, name), allowed)

    @property
    def counter_span(self) -> int:
        """Number of values before the counters roll over; 0 for never."""
        return int(self.counter_modulus) or (1 << int(self.counter_bits) if self.counter_bits else 0)

    @property
    def never_rolling_over(self) -> Wheels:
        """The wheels for ticks without roll-overs."""
        return replace(self, counter_bits=0, counter_modulus=0)

    @property
    def left_m_per_tick(self) -> float:
        """Travel of the left wheel per count."""
        return 2 * math.pi * self.left_radius_m / self.ticks_per_turn

    @property
    def right_m_per_tick(self) -> float:
        """Travel of the right wheel per count."""
        return 2 * math.pi * self.right_radius_m / self.ticks_per_turn


HolonomicLayout = Literal["mecanum", "omni", "increments"]
# Needed and optional fields of each layout, beside `HOLONOMIC_FIELDS`.
HOLONOMIC_LAYOUTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "mecanum": (("radius_m", "half_length_m", "half_width_m", "ticks_per_turn"), ("counter_bits",)),
    "omni": (("radius_m", "distance_m", "angles_rad", "ticks_per_turn"), ("counter_bits",)),
    "increments": ((), ("distance_m",)),
}
_OF_HOLONOMIC = {
    name: _OF_WHEELS[name] for name in _OF_WHEELS if not name.startswith(("left_", "right_", "track_"))
} | {
    "radius_m": _OF_WHEELS["left_radius_m"],
    "half_length_m": Range(0.01, 5.0, "m"),
    "half_width_m": Range(0.01, 5.0, "m"),
    "distance_m": Range(0.01, 5.0, "m"),
}
HOLONOMIC_FIELDS = ("delay_s", "slip_m_per_sqrt_m", "max_speed_m_s", "max_gap_s", *WHEEL_SIGMAS)
# Larger for nearly parallel axles, which leave a direction of motion unmeasured.
_MOST_CONDITION = 30.0


@dataclass(frozen=True)
class HolonomicWheels:
    """The wheels of a base that can move ahead, sideways and turn at once.

    Attributes:
        layout: "mecanum": four wheels at the corners of a rectangle, whose rollers form an X seen from above; "omni":
            three or four wheels around the middle, whose axles point to it; "increments": x, y and yaw by the base's
            own odometry.
        radius_m: of all wheels.
        ticks_per_turn: counts of an encoder per turn of its wheel.
        half_length_m, half_width_m: mecanum: from the middle to the axles, ahead and to the left.
        distance_m: omni: from the middle to a wheel's contact point. Increments: about the same, for the uncertainty of
            a turn.
        angles_rad: omni: direction of each wheel from the middle, counter-clockwise from straight ahead. A wheel turns
            forward when it drives the base counter-clockwise.
        counter_bits, delay_s, slip_m_per_sqrt_m, max_speed_m_s, max_gap_s, scale_sigma, turn_sigma,
            drift_sigma_rad_per_m: as of `Wheels`; the slip is that of each wheel's travel.

    Raises:
        CalibrationError: an impossible value, a missing field, or wheels that leave a direction of motion unmeasured.
    """

    layout: HolonomicLayout
    radius_m: float | None = None
    half_length_m: float | None = None
    half_width_m: float | None = None
    distance_m: float | None = None
    angles_rad: tuple[float, ...] = ()
    ticks_per_turn: float | None = None
    counter_bits: int = 0
    delay_s: float = 0.0
    slip_m_per_sqrt_m: float = 0.01
    max_speed_m_s: float = 5.0
    max_gap_s: float = 0.5
    scale_sigma: float = 0.0
    drift_sigma_rad_per_m: float = 0.0
    turn_sigma: float = 0.0

    def __post_init__(self) -> None:
        if self.layout not in HOLONOMIC_LAYOUTS:
            raise CalibrationError(f"layout is {self.layout!r}", fix=f"one of {', '.join(HOLONOMIC_LAYOUTS)}")
        self._check_layout()
        if self.layout == "increments" and self.distance_m is None:
            object.__setattr__(self, "distance_m", 0.25)  # of a base of half a metre
        numbers = tuple(name for name in (*_OF_HOLONOMIC, "counter_bits") if getattr(self, name) is not None)
        need_numbers(self, numbers)
        for name in numbers:
            if not np.isfinite(getattr(self, name)):
                raise CalibrationError(f"{name} is {getattr(self, name)}, not a number")
            if name in _OF_HOLONOMIC:
                check_range(name, getattr(self, name), _OF_HOLONOMIC[name])
        if self.slip_m_per_sqrt_m == 0:
            raise CalibrationError("slip_m_per_sqrt_m is 0", fix="no wheel is without slip: 0.01 on smooth floor")
        if self.counter_bits != int(self.counter_bits) or not 0 <= self.counter_bits <= _WIDEST_COUNTER_BITS:
            raise CalibrationError(f"counter_bits is {self.counter_bits}", fix="1 to 64, or 0: never rolls over")
        self._check_angles()

    def _check_layout(self) -> None:
        needed, optional = HOLONOMIC_LAYOUTS[self.layout]
        of_layouts = {name for names in HOLONOMIC_LAYOUTS.values() for name in (*names[0], *names[1])}
        values = {name: getattr(self, name) for name in of_layouts}
        given = {name for name, value in values.items() if value is not None and (np.size(value) and np.any(value))}
        for name in needed:
            if name not in given:
                raise CalibrationError(f"{name} is missing", fix=f"layout {self.layout} needs {', '.join(needed)}")
        for name in sorted(given - {*needed, *optional}):
            fix = f"layout {self.layout} has {', '.join((*needed, *optional)) or 'no sizes of wheels'}"
            raise CalibrationError(f"{name} is no field of layout {self.layout}", fix=fix)

    def _check_angles(self) -> None:
        if self.layout != "omni":
            return
        if len(self.angles_rad) not in (3, 4):
            raise CalibrationError(f"angles_rad has {len(self.angles_rad)} angles", fix="one a wheel, three or four")
        if not np.isfinite(self.angles_rad).all() or np.abs(self.angles_rad).max() > 2 * math.pi:
            raise CalibrationError(
                f"angles_rad is {list(self.angles_rad)}, not -2π to 2π", fix="radians: 60° are 1.0472"
            )
        way = np.column_stack([-np.sin(self.angles_rad), np.cos(self.angles_rad), np.ones(len(self.angles_rad))])
        if np.linalg.cond(way) > _MOST_CONDITION:
            raise CalibrationError(
                f"angles_rad is {list(self.angles_rad)}: these wheels do not measure every direction of motion",
                fix="spread them around the base: 1.0472, 3.1416, 5.236",
            )

    @property
    def wheel_names(self) -> tuple[str, ...]:
        """Names of the wheels in the order of their counts; none for increments."""
        if self.layout == "mecanum":
            return "front_left", "front_right", "rear_left", "rear_right"
        return tuple(f"wheel_{number}" for number in range(1, 1 + len(self.angles_rad)))

    @property
    def m_per_tick(self) -> float:
        """Travel of a wheel's rim per count."""
        assert self.radius_m is not None
        assert self.ticks_per_turn is not None
        return 2 * math.pi * self.radius_m / self.ticks_per_turn

    @cached_property
    def jacobian(self) -> FloatArray:
        """(N, 3) travel of each wheel's rim, metres, by the base's motion ahead, to the left, and its turn.

        Muir & Neuman, "Kinematic modeling of wheeled mobile robots", 1987. A mecanum wheel's rollers do not transmit
        motion along their axes.
        """
        if self.layout == "mecanum":
            assert self.half_length_m is not None
            assert self.half_width_m is not None
            lever_m = self.half_length_m + self.half_width_m
            return np.array([[1, -1, -lever_m], [1, 1, lever_m], [1, 1, -lever_m], [1, -1, lever_m]], float)
        assert self.distance_m is not None
        angles = np.array(self.angles_rad)
        return np.column_stack([-np.sin(angles), np.cos(angles), np.full(len(angles), self.distance_m)])

    @cached_property
    def to_base(self) -> FloatArray:
        """(3, N) the pseudo-inverse: the base's motion by least squares of the wheels' travel."""
        return np.asarray(np.linalg.pinv(self.jacobian), float)

    @cached_property
    def contradictions(self) -> FloatArray:
        """(N - 3, N) unit rows: travel of the wheels that fits no motion of the base; none for three wheels."""
        return np.ascontiguousarray(np.linalg.svd(self.jacobian)[0][:, 3:].T)

    @property
    def lever_m(self) -> float:
        """Distance of the wheels from the middle."""
        if self.layout == "mecanum":
            assert self.half_length_m is not None
            assert self.half_width_m is not None
            return math.hypot(self.half_length_m, self.half_width_m)
        assert self.distance_m is not None
        return self.distance_m

    @property
    def nominal_drift_sigma_rad_per_m(self) -> float:
        """Standard deviation of the turn per metre ahead of data-sheet wheels, two of them 1 % apart.

        For increments that of four wheels at `distance_m`: the base's own odometry has such wheels.
        """
        if self.layout == "increments":
            return _NOMINAL_RADIUS_SIGMA / (self.lever_m * math.sqrt(8))
        return _NOMINAL_RADIUS_SIGMA * float(np.linalg.norm(self.to_base[2] * self.jacobian[:, 0]))

    @property
    def turn_variance_per_m(self) -> float:
        """Variance of the base's turn, rad², after one metre of each wheel."""
        if self.layout == "increments":
            return self.slip_m_per_sqrt_m**2 / self.lever_m**2
        return self.slip_m_per_sqrt_m**2 * float(self.to_base[2] @ self.to_base[2])


@dataclass(frozen=True, slots=True)
class Gyro:
    """Noise of a gyroscope's yaw rate, counter-clockwise seen from above.

    Attributes:
        noise_rad_per_sqrt_s: standard deviation of the yaw integrated over one second; its square grows with time.
        bias_rad_s: rate at rest; refined when the wheels stand still.
        bias_sigma_rad_s: standard deviation of the bias; 0 for a fixed bias.
        bias_walk_rad_s_per_sqrt_s: random walk of the bias in one second; its square grows with time.

    Raises:
        CalibrationError: a value that is not finite, or a negative deviation.
    """

    noise_rad_per_sqrt_s: float = 1e-3
    bias_rad_s: float = 0.0
    bias_sigma_rad_s: float = 0.02
    bias_walk_rad_s_per_sqrt_s: float = 2e-5

    def __post_init__(self) -> None:
        need_numbers(self, tuple(_OF_GYRO))
        for name, allowed in _OF_GYRO.items():
            value = getattr(self, name)
            if not np.isfinite(value) or (value < 0 and name != "bias_rad_s"):
                raise CalibrationError(f"{name} is {value}, not a number{'' if name == 'bias_rad_s' else ' from 0 up'}")
            check_range(name, value, allowed)
        if self.noise_rad_per_sqrt_s == 0:
            raise CalibrationError("noise_rad_per_sqrt_s is 0", fix="no gyroscope is without noise")


@dataclass(frozen=True, slots=True)
class NearbyMounts:
    """Bumpers and ultrasonic rangers of a robot, in the order of the controller's inputs; later inputs are not wired.

    Attributes:
        bumpers: of each one `front` or `back`.
        rangers: of each x and y in `base`, metres, and the direction of its axis, radians counter-clockwise.

    Raises:
        CalibrationError: another side, numbers that are not finite, mounts beyond 3 m, or more than there are inputs.
    """

    bumpers: tuple[str, ...] = ()
    rangers: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        sides, mounts = list(self.bumpers), [list(mount) for mount in self.rangers]
        if len(sides) > 2 or not set(sides) <= {"front", "back"}:
            raise CalibrationError(f"bumpers are {sides}", fix="two at most, each front or back")
        if len(mounts) > 4 or any(len(mount) != 3 or not all(map(is_number, mount)) for mount in mounts):
            raise CalibrationError(f"rangers are {mounts}", fix="four at most: [[0.8, 0.2, 0.0]], x, y, radians")
        if not np.all(np.abs(np.array(mounts, float).reshape(-1, 3)) <= [3.0, 3.0, 2 * math.pi]):
            raise CalibrationError(f"rangers are {mounts}", fix="metres from the axle's middle, and radians")

    def have_answered(self, reading: NearbyReading, since_s: float) -> bool:
        """Return whether all that is mounted has given a reading since a time."""
        ranges_m = reading.ranges_m[: len(self.rangers)]
        is_whole = len(ranges_m) == len(self.rangers) and len(reading.is_pressed) >= len(self.bumpers)
        is_new = reading.stamp_s >= since_s and is_whole and not any(map(math.isnan, ranges_m))
        return is_new or not (self.bumpers or self.rangers)

    def are_bumped(self, reading: NearbyReading, forward_m_s: float) -> bool:
        """Return whether a bumper is pressed at a side that a motion does not leave."""
        signs = {"front": 1, "back": -1}
        sides = zip(self.bumpers, reading.is_pressed, strict=False)
        return any(is_pressed and forward_m_s * signs[side] >= 0 for side, is_pressed in sides)

    @classmethod
    def of(cls, value: Any) -> NearbyMounts:
        """Return the mounts of the field `nearby` of a file. Raises CalibrationError."""
        known = mapping(value, "nearby", ("bumpers", "rangers"))
        for name, listed in known.items():
            if not isinstance(listed, list) or (name == "rangers" and not all(isinstance(one, list) for one in listed)):
                raise CalibrationError(f"field nearby.{name} is no list", fix="one entry for each input")
        rangers = tuple(tuple(mount) for mount in known.get("rangers", []))
        return made(cls, "nearby", {"bumpers": tuple(map(str, known.get("bumpers", []))), "rangers": rangers})


def least_step(ticks: int, span: int) -> int:
    """Return the smallest step for a difference of counters that roll over after `span` values (0: never)."""
    return (ticks + span // 2) % span - span // 2 if span else ticks
