"""How the robot is built: its cameras, its wheels, their noise, and where the camera sits. YAML in and out."""

from __future__ import annotations

import math
from dataclasses import MISSING, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.calibration_fields import made, mapping, motion, number, whole
from wheelsight.calibration_layers import NOMINAL, NOMINAL_PARTS, laid_over
from wheelsight.errors import CalibrationError
from wheelsight.files import StrPath, write_text
from wheelsight.geometry import FloatArray, PinholeCamera, se3

FORMAT = "wheelsight-calibration-1"
_SLOWEST_SHUTTER_S = 0.2
_WIDEST_COUNTER_BITS = 64
# From a toy's to a tractor's; counts a turn from those of speeds in place of ticks to fine encoders behind a gear.
_SIZES = {"left_radius_m": (0.005, 2.0), "right_radius_m": (0.005, 2.0), "track_width_m": (0.02, 10.0)}
_TICKS_PER_TURN = (1.0, 1e9)


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
        numbers = (self.constant_m, self.quadratic_per_m, self.near_m, self.far_m)
        if not np.isfinite(numbers).all() or min(numbers) < 0 or self.constant_m + self.quadratic_per_m == 0:
            raise CalibrationError("depth noise takes finite numbers, not negative, and not both zero")
        if self.near_m >= self.far_m:
            raise CalibrationError(f"depth range {self.near_m} to {self.far_m} m is empty")

    def sigma_m(self, depth_m: FloatArray) -> FloatArray:
        """Standard deviations (...) in metres of depths (...) in metres."""
        return self.constant_m + self.quadratic_per_m * np.asarray(depth_m, float) ** 2


@dataclass(frozen=True, slots=True)
class Wheels:
    """Two driven wheels on one axle, or two sides of a skid-steered robot, and their encoders.

    Attributes:
        left_radius_m, right_radius_m: of the wheels, as they roll under load.
        track_width_m: distance between the points where the wheels touch the ground. A skid-steered robot's
            effective one is wider than the robot.
        ticks_per_turn: counts of the encoder a turn of the wheel: counts a turn of the encoder × gear ratio.
        counter_bits: width of the counters the ticks come from, 1 to 64; 0 for ticks that never roll over.
        delay_s: how late stamps are: a reading stamped t tells of the wheels at t - delay_s. May be negative.
        slip_m_per_sqrt_m: standard deviation of a wheel's travel over one metre; its square grows with the way.
        max_speed_m_s: fastest a wheel can roll; a step that needs more is a fault, no motion.
        max_gap_s: longest time between readings that can be bridged.
        counter_modulus: how many values the counters count through before they roll over, where that is no power of
            two, such as 9000 for 0 … 8999; 0 where `counter_bits` tells.

    Raises:
        CalibrationError: a value that no robot can have.
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

    def __post_init__(self) -> None:
        for name in _WHEEL_FIELDS:
            value = getattr(self, name)
            if not np.isfinite(value):
                raise CalibrationError(f"{name} is {value}, not a number")
            if value <= 0 and name not in (*_COUNTER_FIELDS, "delay_s"):
                raise CalibrationError(f"{name} is {value}, not positive")
        self._check_counter()
        for name, (least_m, most_m) in _SIZES.items():
            value = getattr(self, name)
            if not least_m <= value <= most_m:
                fix = f"give metres: {value:g} mm are {value / 1000:g}" if value > most_m else "give metres"
                raise CalibrationError(f"{name} is {value:g}, not {least_m:g} to {most_m:g} m", fix=fix)
        if not _TICKS_PER_TURN[0] <= self.ticks_per_turn <= _TICKS_PER_TURN[1]:
            problem = f"ticks_per_turn is {self.ticks_per_turn:g}, not 1 to 1e9"
            raise CalibrationError(problem, fix="counts a turn of the encoder × gear ratio")

    def _check_counter(self) -> None:
        if self.counter_bits != int(self.counter_bits) or not 0 <= self.counter_bits <= _WIDEST_COUNTER_BITS:
            raise CalibrationError(f"counter_bits is {self.counter_bits}", fix="1 to 64, or 0: never rolls over")
        if self.counter_modulus != int(self.counter_modulus) or not (
            self.counter_modulus == 0 or 2 <= self.counter_modulus <= 2**_WIDEST_COUNTER_BITS
        ):
            raise CalibrationError(f"counter_modulus is {self.counter_modulus}", fix="9000 for a counter of 0 … 8999")
        if self.counter_bits and self.counter_modulus:
            raise CalibrationError("counter_bits and counter_modulus are both given", fix="leave one out")

    @property
    def counter_span(self) -> int:
        """How many values the counters count through before they roll over; 0 for ticks that never do."""
        return int(self.counter_modulus) or (1 << int(self.counter_bits) if self.counter_bits else 0)

    @property
    def never_rolling_over(self) -> Wheels:
        """The same, for ticks in which roll-overs have been undone."""
        return replace(self, counter_bits=0, counter_modulus=0)

    @property
    def left_m_per_tick(self) -> float:
        """How far the left wheel rolls while its encoder counts one."""
        return 2 * math.pi * self.left_radius_m / self.ticks_per_turn

    @property
    def right_m_per_tick(self) -> float:
        """How far the right wheel rolls while its encoder counts one."""
        return 2 * math.pi * self.right_radius_m / self.ticks_per_turn


@dataclass(frozen=True, slots=True)
class Gyro:
    """What a gyroscope's yaw rate, counter-clockwise seen from above, is worth.

    Attributes:
        noise_rad_per_sqrt_s: standard deviation of the yaw integrated over one second; its square grows with time.
        bias_rad_s: what it shows at rest; refined whenever the wheels stand still.
        bias_sigma_rad_s: how far off that may be, as a standard deviation; 0 for a bias that is to be kept.
        bias_walk_rad_s_per_sqrt_s: how far the bias wanders in one second; its square grows with time.

    Raises:
        CalibrationError: a value that is not finite, or a negative deviation.
    """

    noise_rad_per_sqrt_s: float = 1e-3
    bias_rad_s: float = 0.0
    bias_sigma_rad_s: float = 0.02
    bias_walk_rad_s_per_sqrt_s: float = 2e-5

    def __post_init__(self) -> None:
        for name in _GYRO_FIELDS:
            value = getattr(self, name)
            if not np.isfinite(value) or (value < 0 and name != "bias_rad_s"):
                raise CalibrationError(f"{name} is {value}, not a number{'' if name == 'bias_rad_s' else ' from 0 up'}")
        if self.noise_rad_per_sqrt_s == 0:
            raise CalibrationError("noise_rad_per_sqrt_s is 0", fix="no gyroscope is without noise")


@dataclass(frozen=True, eq=False)
class Calibration:
    """The sensors of one robot: a depth camera, wheels, or both.

    The frame `camera` is the optical frame in which depth is measured. Where `T_color_depth` is None,
    depth was registered to colour: both images share one pixel grid and `camera` is the colour camera's
    frame too. Else depth pixel and colour pixel of a point differ, and `T_color_depth` joins them.

    Attributes:
        color: the colour camera, or None where there is no depth camera.
        depth: the depth camera; alike when registered.
        T_color_depth: (4, 4) that maps points of the depth camera into the colour camera, or None.
        depth_noise: of the depth camera.
        rolling_shutter_s: time from the exposure of the images' first row to that of the last; 0 for a global shutter.
            A frame's stamp is the time of its middle row.
        color_sigma_px: how far off the colour camera's numbers may be, as a standard deviation in the image; 0 for a
            camera calibrated well enough for it not to matter, more for nominal values.
        T_base_camera: (4, 4), or None where the recording has no base. May stand without a camera, in a calibration
            that is to update another.
        wheels: or None where no wheel is read.
        gyro: what a yaw rate is worth, where there is one.
        source: where the numbers come from, for reports.
    """

    color: PinholeCamera | None = None
    depth: PinholeCamera | None = None
    T_color_depth: FloatArray | None = None
    depth_noise: DepthNoise = field(default_factory=DepthNoise)
    rolling_shutter_s: float = 0.0
    color_sigma_px: float = 0.0
    T_base_camera: FloatArray | None = None
    wheels: Wheels | None = None
    gyro: Gyro = field(default_factory=Gyro)
    source: str = "unknown"

    def __post_init__(self) -> None:
        self._check_presence()
        for name in ("T_color_depth", "T_base_camera"):
            if getattr(self, name) is None:
                continue
            T = np.array(getattr(self, name), float)
            T.setflags(write=False)
            object.__setattr__(self, name, T)
            if T.shape != (4, 4) or not se3.is_valid(T, tolerance=1e-4):
                raise CalibrationError(f"{name} is not a rigid motion: orthonormal rotation, last row 0 0 0 1")
        if not 0 <= self.rolling_shutter_s <= _SLOWEST_SHUTTER_S:
            raise CalibrationError(f"rolling_shutter_s is {self.rolling_shutter_s}, not 0 to {_SLOWEST_SHUTTER_S} s")
        if self.color is not None and not 0 <= self.color_sigma_px < self.color.width:
            raise CalibrationError(f"color_sigma_px is {self.color_sigma_px}, not 0 to an image's width")
        if self.T_color_depth is None and self.color != self.depth:
            raise CalibrationError(
                "colour and depth cameras differ, but no T_color_depth says how they are joined",
                fix="give T_color_depth, or register depth to colour",
            )

    def _check_presence(self) -> None:
        if (self.color is None) != (self.depth is None):
            raise CalibrationError("one camera of two is missing", fix="give color and depth, or neither")
        if self.color is None and self.T_color_depth is not None:
            raise CalibrationError("T_color_depth is given, but no camera", fix="give color, or leave it out")

    @classmethod
    def registered_camera(cls, camera: PinholeCamera, **others: Any) -> Calibration:
        """The calibration of a sensor whose depth images are registered to its colour images."""
        return cls(color=camera, depth=camera, **others)

    @property
    def is_registered(self) -> bool:
        """Whether colour and depth share one pixel grid."""
        return self.T_color_depth is None

    @property
    def cameras(self) -> tuple[PinholeCamera, PinholeCamera]:
        """Colour and depth camera. Raises CalibrationError where there are none."""
        if self.color is None or self.depth is None:
            raise CalibrationError(
                f"the calibration ({self.source}) has no cameras", fix="give color, or estimate from wheels"
            )
        return self.color, self.depth

    def updated_by(self, other: Calibration) -> Calibration:
        """This robot with what `other` knows in place of its own: cameras, T_base_camera, wheels with gyro.

        A calibration of the wheels alone leaves the cameras as they are, and the other way round; one of the wheels
        and the mount leaves the cameras' lenses. Files are laid over each other field by field: `load_calibration`.
        """
        return _from_document(laid_over(calibration_fields(self), calibration_fields(other)))


def load_calibration(*paths: StrPath, under: Calibration | None = None) -> Calibration:
    """Read a calibration.yaml, or several laid over each other, and over `under`: what a later one tells stands.

    Each may tell any part: cameras, T_base_camera, wheels, gyro, or some fields of the last two.

    Raises:
        CalibrationError: naming the file, the field and what is wrong with it, or what is missing in all of them.
    """
    layers = [(Path(path), read_layer(Path(path))) for path in paths]
    document: dict[str, Any] = {}
    for _, layer in layers:
        document = laid_over(document, layer.get(NOMINAL, {}))
    if under is not None:
        document = laid_over(document, calibration_fields(under))
    found, lacks = under, None
    for path, layer in layers:
        document = laid_over(document, layer)
        try:
            found, lacks = _from_document(document), None
        except _MissingError as error:
            lacks = error
        except CalibrationError as error:
            raise CalibrationError(error.problem, path=path, fix=error.fix) from error
    if lacks is not None:
        holder = next((path for path, layer in reversed(layers) if lacks.part in layer), layers[-1][0])
        raise CalibrationError(lacks.problem, path=holder, fix=lacks.fix) from lacks
    if found is None:
        raise CalibrationError("no calibration is given")
    return found


def read_layer(path: StrPath) -> dict[str, Any]:
    """The fields of a calibration.yaml, which may tell any part of a calibration. Raises CalibrationError."""
    from wheelsight.inputs import read_yaml

    path = Path(path)

    document = read_yaml(path, CalibrationError)
    try:
        known = mapping(document, "calibration", _TOP_FIELDS)
        if known.get("format") != FORMAT:
            raise CalibrationError(f"field format is {known.get('format')!r}", fix=f"write format: {FORMAT}")
        mapping(known.get(NOMINAL, {}), NOMINAL, NOMINAL_PARTS)
    except CalibrationError as error:
        raise CalibrationError(error.problem, path=path, fix=error.fix) from error
    return known


def save_calibration(calibration: Calibration, path: StrPath) -> None:
    """Write a calibration.yaml, atomically; numbers keep their full precision. Raises OutputError."""
    save_layer(calibration_fields(calibration), path)


def save_layer(document: dict[str, Any], path: StrPath) -> None:
    """Write fields of a calibration as `read_layer` takes them. Raises OutputError."""
    import yaml

    write_text(Path(path), yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=100))


class _MissingError(CalibrationError):
    """What is there is right, but not all of a part is there."""

    def __init__(self, part: str, field: str, fix: str) -> None:
        super().__init__(f"field {field} is missing", fix=fix)
        self.part = part


_CAMERA_FIELDS = ("width", "height", "fx", "fy", "cx", "cy", "distortion")
_NOISE_FIELDS = ("constant_m", "quadratic_per_m", "near_m", "far_m")
_NUMBERS = ("rolling_shutter_s", "color_sigma_px")
_CAMERA_PART = ("color", "depth", "T_color_depth", "depth_noise", *_NUMBERS)
_OTHER_PARTS = ("T_base_camera", "wheels", "gyro")
_TOP_FIELDS = ("format", "source", *_CAMERA_PART, *_OTHER_PARTS, NOMINAL)
_WHEEL_FIELDS = tuple(f.name for f in fields(Wheels))
_COUNTER_FIELDS = ("counter_bits", "counter_modulus")
_GYRO_FIELDS = tuple(f.name for f in fields(Gyro))


def calibration_fields(calibration: Calibration) -> dict[str, Any]:
    """The fields of a calibration as its file has them."""

    def rows(T: FloatArray | None) -> list[list[float]] | None:
        return None if T is None else [[float(x) for x in row] for row in T]

    def camera(c: PinholeCamera) -> dict[str, Any]:
        size = {"width": int(c.width), "height": int(c.height)}
        lens = {name: float(getattr(c, name)) for name in ("fx", "fy", "cx", "cy")}
        return size | lens | {"distortion": list(c.distortion)}

    document: dict[str, Any] = {"format": FORMAT, "source": calibration.source}
    if calibration.color is not None and calibration.depth is not None:
        document["color"] = camera(calibration.color)
        if not calibration.is_registered:
            document |= {"depth": camera(calibration.depth), "T_color_depth": rows(calibration.T_color_depth)}
        document["depth_noise"] = _plain(calibration.depth_noise)
        document |= {name: float(getattr(calibration, name)) for name in _NUMBERS}
    if calibration.T_base_camera is not None:
        document["T_base_camera"] = rows(calibration.T_base_camera)
    if calibration.wheels is not None:
        counter = {name: int(getattr(calibration.wheels, name)) for name in _COUNTER_FIELDS}
        document["wheels"] = _plain(calibration.wheels) | counter
    if calibration.wheels is not None or calibration.gyro != Gyro():
        document["gyro"] = _plain(calibration.gyro)
    return document


def _plain(numbers: DepthNoise | Wheels | Gyro) -> dict[str, float]:
    return {f.name: float(getattr(numbers, f.name)) for f in fields(numbers)}


def _from_document(document: Any) -> Calibration:
    known = mapping(document, "calibration", _TOP_FIELDS)
    parts: dict[str, Any] = {"T_base_camera": motion(known.get("T_base_camera"), "T_base_camera")}
    if "gyro" in known:
        gyro = mapping(known["gyro"], "gyro", _GYRO_FIELDS)
        parts["gyro"] = made(Gyro, "gyro", {key: number(value, f"gyro.{key}") for key, value in gyro.items()})
    of_camera = [name for name in _CAMERA_PART if name in known]
    if "color" in known:
        parts |= _camera_part(known)
    if "wheels" in known:
        parts["wheels"] = _wheels(known["wheels"])
    if "color" not in known and (of_camera or not any(name in known for name in _OTHER_PARTS)):
        fix = "give the colour camera: width, height, fx, fy, cx, cy"
        raise _MissingError((of_camera or ["color"])[0], "color", fix)
    return Calibration(**parts, source=str(known.get("source", "unknown")))


def _camera_part(known: dict[str, Any]) -> dict[str, Any]:
    color = _camera(known["color"], "color")
    noise = mapping(known.get("depth_noise", {}), "depth_noise", _NOISE_FIELDS)
    return {
        "color": color,
        "depth": _camera(known["depth"], "depth") if "depth" in known else color,
        "depth_noise": DepthNoise(**{name: number(value, f"depth_noise.{name}") for name, value in noise.items()}),
        "T_color_depth": motion(known.get("T_color_depth"), "T_color_depth"),
        **{name: number(known[name], name) for name in _NUMBERS if name in known},
    }


def _wheels(value: Any) -> Wheels:
    known = mapping(value, "wheels", _WHEEL_FIELDS)
    missing = [f.name for f in fields(Wheels) if f.default is MISSING and f.name not in known]
    if missing:
        raise _MissingError("wheels", f"wheels.{missing[0]}", "give it too, here or in another --calibration")
    numbers: dict[str, Any] = {key: number(value, f"wheels.{key}") for key, value in known.items()}
    numbers |= {name: whole(known[name], f"wheels.{name}", "") for name in _COUNTER_FIELDS if name in known}
    return made(Wheels, "wheels", numbers)


def _camera(value: Any, name: str) -> PinholeCamera:
    known = mapping(value, name, _CAMERA_FIELDS)
    missing = [key for key in _CAMERA_FIELDS[:-1] if key not in known]
    if missing:
        raise CalibrationError(f"field {name}.{missing[0]} is missing")
    distortion = known.get("distortion", [0.0] * 5)
    if not isinstance(distortion, list) or len(distortion) != 5:
        raise CalibrationError(f"field {name}.distortion takes five numbers: k1, k2, p1, p2, k3")
    k1, k2, p1, p2, k3 = (number(x, f"{name}.distortion") for x in distortion)
    fx, fy, cx, cy = (number(known[key], f"{name}.{key}") for key in ("fx", "fy", "cx", "cy"))
    width, height = (whole(known[key], f"{name}.{key}") for key in ("width", "height"))
    numbers = {"width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    return made(PinholeCamera, name, numbers | {"distortion": (k1, k2, p1, p2, k3)})
