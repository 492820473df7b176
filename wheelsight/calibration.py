"""How the robot is built: its cameras, their noise, and where the camera sits. YAML in and out."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.errors import CalibrationError
from wheelsight.files import write_text
from wheelsight.geometry import FloatArray, PinholeCamera, se3

FORMAT = "wheelsight-calibration-1"
_SLOWEST_SHUTTER_S = 0.2


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


@dataclass(frozen=True, eq=False)
class Calibration:
    """The sensors of one robot.

    The frame `camera` is the optical frame in which depth is measured. Where `T_color_depth` is None,
    depth was registered to colour: both images share one pixel grid and `camera` is the colour camera's
    frame too. Else depth pixel and colour pixel of a point differ, and `T_color_depth` joins them.

    Attributes:
        color: the colour camera.
        depth: the depth camera; alike when registered.
        T_color_depth: (4, 4) that maps points of the depth camera into the colour camera, or None.
        depth_noise: of the depth camera.
        rolling_shutter_s: time from the exposure of the images' first row to that of the last; 0 for a global shutter.
            A frame's stamp is the time of its middle row.
        color_sigma_px: how far off the colour camera's numbers may be, as a standard deviation in the image; 0 for a
            camera calibrated well enough for it not to matter, more for nominal values.
        T_base_camera: (4, 4), or None where the recording has no base.
        source: where the numbers come from, for reports.
    """

    color: PinholeCamera
    depth: PinholeCamera
    T_color_depth: FloatArray | None = None
    depth_noise: DepthNoise = field(default_factory=DepthNoise)
    rolling_shutter_s: float = 0.0
    color_sigma_px: float = 0.0
    T_base_camera: FloatArray | None = None
    source: str = "unknown"

    def __post_init__(self) -> None:
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
        if not 0 <= self.color_sigma_px < self.color.width:
            raise CalibrationError(f"color_sigma_px is {self.color_sigma_px}, not 0 to an image's width")
        if self.T_color_depth is None and self.color != self.depth:
            raise CalibrationError(
                "colour and depth cameras differ, but no T_color_depth says how they are joined",
                fix="give T_color_depth, or register depth to colour",
            )

    @classmethod
    def registered_camera(cls, camera: PinholeCamera, **others: Any) -> Calibration:
        """The calibration of a sensor whose depth images are registered to its colour images."""
        return cls(color=camera, depth=camera, **others)

    @property
    def is_registered(self) -> bool:
        """Whether colour and depth share one pixel grid."""
        return self.T_color_depth is None


def load_calibration(path: Path) -> Calibration:
    """Read a calibration.yaml.

    Raises:
        CalibrationError: naming the file, the field and what is wrong with it.
    """
    import yaml

    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CalibrationError(f"cannot be read: {error.strerror}", path=path) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise CalibrationError(f"is not YAML: {error}", path=path) from error
    try:
        return _from_document(document)
    except CalibrationError as error:
        raise CalibrationError(error.problem, path=path, fix=error.fix) from error


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Write a calibration.yaml, atomically; numbers keep their full precision. Raises OutputError."""
    import yaml

    write_text(path, yaml.safe_dump(_to_document(calibration), sort_keys=False, default_flow_style=None, width=100))


_CAMERA_FIELDS = ("width", "height", "fx", "fy", "cx", "cy", "distortion")
_NOISE_FIELDS = ("constant_m", "quadratic_per_m", "near_m", "far_m")
_NUMBERS = ("rolling_shutter_s", "color_sigma_px")
_TOP_FIELDS = ("format", "source", "color", "depth", "T_color_depth", "depth_noise", *_NUMBERS, "T_base_camera")


def _to_document(calibration: Calibration) -> dict[str, Any]:
    def motion(T: FloatArray | None) -> list[list[float]] | None:
        return None if T is None else [[float(x) for x in row] for row in T]

    def camera(c: PinholeCamera) -> dict[str, Any]:
        size = {"width": int(c.width), "height": int(c.height)}
        lens = {name: float(getattr(c, name)) for name in ("fx", "fy", "cx", "cy")}
        return size | lens | {"distortion": list(c.distortion)}

    document: dict[str, Any] = {"format": FORMAT, "source": calibration.source, "color": camera(calibration.color)}
    if not calibration.is_registered:
        document |= {"depth": camera(calibration.depth), "T_color_depth": motion(calibration.T_color_depth)}
    document["depth_noise"] = {name: float(getattr(calibration.depth_noise, name)) for name in _NOISE_FIELDS}
    document |= {name: float(getattr(calibration, name)) for name in _NUMBERS}
    if calibration.T_base_camera is not None:
        document["T_base_camera"] = motion(calibration.T_base_camera)
    return document


def _from_document(document: Any) -> Calibration:
    fields = _mapping(document, "calibration", _TOP_FIELDS)
    if fields.get("format") != FORMAT:
        raise CalibrationError(f"field format is {fields.get('format')!r}", fix=f"write format: {FORMAT}")
    if "color" not in fields:
        raise CalibrationError("field color is missing", fix="give the colour camera: width, height, fx, fy, cx, cy")
    color = _camera(fields["color"], "color")
    noise = _mapping(fields.get("depth_noise", {}), "depth_noise", _NOISE_FIELDS)
    return Calibration(
        color=color,
        depth=_camera(fields["depth"], "depth") if "depth" in fields else color,
        T_color_depth=_motion(fields.get("T_color_depth"), "T_color_depth"),
        depth_noise=DepthNoise(**{name: _number(value, f"depth_noise.{name}") for name, value in noise.items()}),
        **{name: _number(fields[name], name) for name in _NUMBERS if name in fields},
        T_base_camera=_motion(fields.get("T_base_camera"), "T_base_camera"),
        source=str(fields.get("source", "unknown")),
    )


def _mapping(value: Any, name: str, known: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise CalibrationError(f"field {name} must hold names and values")
    for key in value:
        if key not in known:
            raise CalibrationError(f"field {name} has an unknown entry {key!r}", fix=f"known: {', '.join(known)}")
    return value


def _camera(value: Any, name: str) -> PinholeCamera:
    fields = _mapping(value, name, _CAMERA_FIELDS)
    missing = [key for key in _CAMERA_FIELDS[:-1] if key not in fields]
    if missing:
        raise CalibrationError(f"field {name}.{missing[0]} is missing")
    distortion = fields.get("distortion", [0.0] * 5)
    if not isinstance(distortion, list) or len(distortion) != 5:
        raise CalibrationError(f"field {name}.distortion takes five numbers: k1, k2, p1, p2, k3")
    k1, k2, p1, p2, k3 = (_number(x, f"{name}.distortion") for x in distortion)
    fx, fy, cx, cy = (_number(fields[key], f"{name}.{key}") for key in ("fx", "fy", "cx", "cy"))
    width, height = (_whole(fields[key], f"{name}.{key}") for key in ("width", "height"))
    try:
        return PinholeCamera(width, height, fx, fy, cx, cy, (k1, k2, p1, p2, k3))
    except CalibrationError as error:
        raise CalibrationError(f"field {name}: {error.problem}", fix=error.fix) from error


def _motion(value: Any, name: str) -> FloatArray | None:
    if value is None:
        return None
    try:
        T = np.array(value, float)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"field {name} must be four rows of four numbers") from error
    if T.shape != (4, 4):
        raise CalibrationError(f"field {name} must be four rows of four numbers")
    return T


def _whole(value: Any, name: str) -> int:
    number = _number(value, name)
    if number != int(number):
        raise CalibrationError(f"field {name} is {value!r}, not a whole number of pixels")
    return int(number)


def _number(value: Any, name: str) -> float:
    try:
        number = float(value)  # from text too: YAML 1.1 reads 1e-3, without a dot, as text
    except (TypeError, ValueError):
        number = np.nan
    if isinstance(value, bool) or not np.isfinite(number):
        raise CalibrationError(f"field {name} is {value!r}, not a number")
    return number
