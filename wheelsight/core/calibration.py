"""`Calibration`: cameras, wheels, gyroscope and mounts of a robot, and the YAML file that holds them. `laid_over`
combines several files; `history_of` reads the record of past calibrations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from types import UnionType
from typing import Any

import numpy as np

from wheelsight.core.calibration_parts import (
    HOLONOMIC_FIELDS,
    HOLONOMIC_LAYOUTS,
    WHEEL_SIGMAS,
    DepthNoise,
    Gyro,
    HolonomicWheels,
    NearbyMounts,
    Range,
    Wheels,
    check_range,
    made,
    mapping,
    motion,
    need_numbers,
    number,
    whole,
)
from wheelsight.core.depth_errors import (
    DepthError,
    PointErrors,
    depth_error_fields,
    depth_error_from,
    point_errors_fields,
    point_errors_from,
)
from wheelsight.core.drive_model import DriveModel, drive_model_fields, drive_model_from
from wheelsight.core.errors import CalibrationError
from wheelsight.core.files import StrPath, write_text
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3

__all__ = [
    "FORMAT",
    "Calibration",
    "DepthError",
    "DepthNoise",
    "Gyro",
    "HolonomicWheels",
    "PointErrors",
    "Wheels",
    "calibration_fields",
    "load_calibration",
    "parse_calibration",
    "read_layer",
    "save_calibration",
    "save_layer",
]


FORMAT = "wheelsight-calibration-1"
# A file may also hold nominal values of these parts, which apply if no other file gives the part.
NOMINAL, NOMINAL_PARTS = "nominal", ("wheels", "gyro")
# Field of past calibrations, of the file rather than of the calibration.
HISTORY = "history"
# Largest distance of the camera from the base, and of the depth camera from the colour camera.
_MOST_APART_M = {"T_base_camera": 10.0, "T_color_depth": 1.0}
# Principal points lie within a tenth of the image's sides from its middle. Half the size is 0.25 or 1, two thirds 0.33
# or 0.75; an equal offset of both sides is unlikely for a crop.
_OFF_MIDDLE, _NEAR_MIDDLE, _ALIKE, _MOST_SCALE = 0.1, (0.36, 0.68), 0.1, 10.0
_RANGES = {
    "rolling_shutter_s": Range(0, 0.2, "s"),
    "depth_late_s": Range(-0.2, 0.2, "s"),
    "frame_sigma_m": Range(0, 1, "m"),
    "frame_sigma_rad": Range(0, 1, "rad"),
}
_NUMBERS = ("rolling_shutter_s", "color_sigma_px", "depth_late_s", "frame_sigma_m", "frame_sigma_rad")


@dataclass(frozen=True, eq=False)
class Calibration:
    """The sensors of one robot: a depth camera, wheels, or both.

    The frame `camera` is the optical frame of depth. If `T_color_depth` is None, depth is registered to colour: both
    images share one pixel grid, and `camera` is the colour camera's frame too. Else the depth pixel and the colour
    pixel of a point differ, and `T_color_depth` relates them.

    Attributes:
        color: the colour camera, or None without depth camera.
        depth: the depth camera; equal to `color` if registered.
        T_color_depth: (4, 4) that maps points of the depth camera into the colour camera, or None.
        depth_noise: of the depth camera.
        rolling_shutter_s: time from the exposure of the images' first row to that of the last; 0 for a global shutter.
            A frame's stamp is the time of its middle row.
        color_sigma_px: standard deviation in the image by errors of the colour camera's parameters; 0 if negligible,
            more for nominal values.
        T_base_camera: (4, 4), or None without base. A calibration that updates another may have it without a camera.
        wheels: of a differential drive, or None.
        holonomic: the wheels of a base that also moves sideways, or None; in a file they are `wheels` of `kind:
            holonomic`. A robot has only one of both.
        drive_model: how the wheels answer commands; None if it was not measured.
        nearby: mounts of bumpers and rangers; None without any.
        gyro: the noise of the yaw rate.
        source: origin of the numbers, for reports.
        depth_late_s: delay of depth behind colour beyond their stamps; negative if depth is earlier.
        frame_sigma_m, frame_sigma_rad: standard deviations of a frame's pose by errors common to all pixels: bent
            depth, registration, timing of the shutter. See docs/decisions/filter.md.
        depth_error: systematic error of depth images; recordings correct it.
        point_errors: errors of points after that correction, by a calibration with a board; None if unknown, as for
            nominal values.
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
    depth_late_s: float = 0.0
    frame_sigma_m: float = 0.0025
    frame_sigma_rad: float = 0.002
    depth_error: DepthError = field(default_factory=DepthError)
    point_errors: PointErrors | None = None
    holonomic: HolonomicWheels | None = None
    drive_model: DriveModel | None = None
    nearby: NearbyMounts | None = None

    def __post_init__(self) -> None:
        for name, kind in _KINDS.items():
            value = getattr(self, name)
            if not isinstance(value, kind):
                wanted = kind.__name__ if isinstance(kind, type) else str(kind).rpartition(".")[2]
                raise CalibrationError(f"{name} is a {type(value).__name__}", fix=f"give it as {wanted}")
        self._check_presence()
        for name in ("color", "depth"):
            if (camera := getattr(self, name)) is not None:
                _check_camera(name, camera)
        for name in _MOST_APART_M:
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _motion(name, getattr(self, name)))
        need_numbers(self, _NUMBERS)
        for name, allowed in _RANGES.items():
            check_range(name, getattr(self, name), allowed)
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
        if self.wheels is not None and self.holonomic is not None:
            raise CalibrationError("wheels and holonomic are both given", fix="a robot has one kind: leave one out")
        if self.color is None and self.T_color_depth is not None:
            raise CalibrationError("T_color_depth is given, but no camera", fix="give color, or leave it out")
        if self.drive_model is not None and self.holonomic is not None:
            raise CalibrationError(
                "drive_model is of two driven wheels, and wheels of a holonomic base", fix="leave it out"
            )
        if self.drive_model is not None and self.wheels is not None:
            self.drive_model.check_robot(self.wheels.track_width_m)

    @classmethod
    def registered_camera(cls, camera: PinholeCamera, **others: Any) -> Calibration:
        """Return the calibration of a sensor whose depth images are registered to its colour images."""
        return cls(color=camera, depth=camera, **others)

    @property
    def is_registered(self) -> bool:
        """Whether colour and depth share one pixel grid."""
        return self.T_color_depth is None

    @property
    def any_wheels(self) -> Wheels | HolonomicWheels | None:
        """Differential or holonomic wheels, or None."""
        return self.wheels if self.holonomic is None else self.holonomic

    @property
    def lacks_two_wheels(self) -> str:
        """Problem for what needs two driven wheels, as "has …"; empty if there are two."""
        if self.holonomic is not None:
            return "has the wheels of a holonomic base, and this needs two driven wheels"
        return "" if self.wheels is not None else "has no wheels"

    @property
    def T_color_camera(self) -> FloatArray:
        """(4, 4) that maps points of the camera frame into the colour camera's; the identity if registered."""
        return np.eye(4) if self.T_color_depth is None else self.T_color_depth

    @property
    def cameras(self) -> tuple[PinholeCamera, PinholeCamera]:
        """Colour and depth camera. Raises CalibrationError if there are none."""
        if self.color is None or self.depth is None:
            raise CalibrationError(
                f"the calibration ({self.source}) has no cameras", fix="give color, or estimate from wheels"
            )
        return self.color, self.depth

    def updated_by(self, other: Calibration) -> Calibration:
        """Return this calibration with the parts of `other` in place: cameras, T_base_camera, wheels with gyro.

        Parts that `other` lacks stay. `load_calibration` merges files field by field.
        """
        below = calibration_fields(self)
        if other.any_wheels is not None and (self.holonomic is None) is not (other.holonomic is None):
            below.pop("wheels", None)  # nothing of wheels of another kind stays
        return _from_document(laid_over(below, calibration_fields(other)))


def load_calibration(*paths: StrPath, under: Calibration | None = None) -> Calibration:
    """Read a calibration.yaml, or several, each merged over the previous ones and `under`.

    Each may have any part: cameras, T_base_camera, wheels, gyro, or some fields of the last two.

    Raises:
        CalibrationError: with file and field: invalid, or missing in all of them.
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
    """Return the fields of a calibration.yaml, which may have any part of a calibration. Raises CalibrationError."""
    from wheelsight.core.inputs import read_yaml

    path = Path(path)
    return _checked_layer(read_yaml(path, CalibrationError), path)


def parse_calibration(text: str, path: StrPath) -> Calibration:
    """Return the calibration of the text of a calibration.yaml at `path`. Raises CalibrationError."""
    from wheelsight.core.inputs import parse_yaml

    path = Path(path)
    layer = _checked_layer(parse_yaml(text, path, CalibrationError), path)
    try:
        return _from_document(layer)
    except CalibrationError as error:
        raise CalibrationError(error.problem, path=path, fix=error.fix) from error


def _checked_layer(document: Any, path: Path) -> dict[str, Any]:
    try:
        known = mapping(document, "calibration", _TOP_FIELDS)
        if known.get("format") != FORMAT:
            raise CalibrationError(f"field format is {known.get('format')!r}", fix=f"write format: {FORMAT}")
        mapping(known.get(NOMINAL, {}), NOMINAL, NOMINAL_PARTS)
        history_of(known)
    except CalibrationError as error:
        raise CalibrationError(error.problem, path=path, fix=error.fix) from error
    return known


def save_calibration(calibration: Calibration, path: StrPath) -> None:
    """Write a calibration.yaml atomically, with all digits. Raises OutputError."""
    save_layer(calibration_fields(calibration), path)


def save_layer(document: dict[str, Any], path: StrPath) -> None:
    """Write fields of a calibration for `read_layer`. Raises OutputError."""
    import yaml

    write_text(Path(path), yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=100))


# These fields are replaced together with `color`, so that lenses of two calibrations are not mixed.
_LENSES = ("color", "depth", "T_color_depth", "color_sigma_px", "depth_error", "point_errors")
_FIELD_BY_FIELD = ("wheels", "gyro", "depth_noise", "nominal")


def laid_over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of `below` updated by those of `above`.

    Wheels, gyro and depth noise are merged field by field, so that the delay may come from one calibration and the
    radii from another. `color` replaces all fields of lenses.
    """
    kept = {name: value for name, value in below.items() if "color" not in above or name not in _LENSES}
    merged = {**kept, **above}
    for name in _FIELD_BY_FIELD:
        old, new = below.get(name), above.get(name)
        if not (isinstance(old, Mapping) and isinstance(new, Mapping)):
            continue
        # Wheels of another kind or layout share no field.
        kinds = (("kind", "differential"), ("layout", None))
        if all(key not in new or new[key] == old.get(key, usual) for key, usual in kinds):
            merged[name] = {**old, **new}
    entries = [entry for part in (below, above) for entry in part.get(HISTORY) or ()]
    if entries:
        merged[HISTORY] = [entry for index, entry in enumerate(entries) if entry not in entries[:index]]
    sources = [source for source in (below.get("source"), above.get("source")) if source is not None]
    if len(sources) == 2 and sources[0] != sources[1]:
        updated, last = ", updated by: ", str(sources[1])
        sources = [updated.join([*(one for one in str(sources[0]).split(updated) if one != last), last])]
    return {**merged, "source": sources[0]} if sources else merged


_ENTRY_FIELDS = ("date", "command", "what", "figures")
_MOST_ENTRIES = 10_000


@dataclass(frozen=True, slots=True)
class Measured:
    """One entry of the `history` of a calibration file.

    Attributes:
        what: the calibrated parts of the robot.
        command: the command without its options.
        figures: results by name, with units.
        date: in UTC, as 2026-11-26 13:05.
    """

    what: str
    command: str
    figures: Mapping[str, float] = field(default_factory=dict)
    date: str = ""

    def as_field(self) -> dict[str, Any]:
        """Return the entry for a file, by default with the current date."""
        date = self.date or datetime.now(UTC).strftime("%Y-%m-%d %H:%M")
        figures = {name: float(f"{value:.4g}") for name, value in self.figures.items()}
        return {"date": date, "command": self.command, "what": self.what, "figures": figures}


def history_of(document: Mapping[str, Any]) -> tuple[Measured, ...]:
    """Return the history in the fields of a file, oldest first. Raises CalibrationError if it is invalid."""
    entries = document.get(HISTORY, [])
    if not isinstance(entries, list) or len(entries) > _MOST_ENTRIES:
        raise CalibrationError(f"field {HISTORY} must be a list of what was measured")
    found = []
    for entry in entries:
        known = mapping(entry, HISTORY, _ENTRY_FIELDS)
        figures = known.get("figures", {})
        if not isinstance(figures, dict):
            raise CalibrationError(f"field {HISTORY}: figures must hold names and numbers")
        numbers = {str(name): number(value, f"{HISTORY}.{name}") for name, value in figures.items()}
        what, command, date = (str(known.get(name, "")) for name in ("what", "command", "date"))
        found.append(Measured(what, command, numbers, date))
    return tuple(found)


_CAMERA_FIELDS = ("width", "height", "fx", "fy", "cx", "cy", "distortion")
_NOISE_FIELDS = ("constant_m", "quadratic_per_m", "near_m", "far_m")
_KINDS: dict[str, type | UnionType] = {
    "color": PinholeCamera | None,
    "depth": PinholeCamera | None,
    "depth_noise": DepthNoise,
    "depth_error": DepthError,
    "point_errors": PointErrors | None,
    "wheels": Wheels | None,
    "holonomic": HolonomicWheels | None,
    "gyro": Gyro,
    "source": str,
    "drive_model": DriveModel | None,
    "nearby": NearbyMounts | None,
}
_CAMERA_PART = ("color", "depth", "T_color_depth", "depth_noise", "depth_error", "point_errors", *_NUMBERS)
_OTHER_PARTS = ("T_base_camera", "wheels", "gyro", "drive_model", "nearby")
_TOP_FIELDS = ("format", "source", *_CAMERA_PART, *_OTHER_PARTS, NOMINAL, HISTORY)
_WHEEL_FIELDS = tuple(f.name for f in fields(Wheels))
_KIND, _DIFFERENTIAL, _HOLONOMIC = "kind", "differential", "holonomic"
_COUNTER_FIELDS = ("counter_bits", "counter_modulus")
_GYRO_FIELDS = tuple(f.name for f in fields(Gyro))


class _MissingError(CalibrationError):
    """A part is valid as far as it goes, but incomplete."""

    def __init__(self, part: str, field: str, fix: str) -> None:
        super().__init__(f"field {field} is missing", fix=fix)
        self.part = part


def calibration_fields(calibration: Calibration) -> dict[str, Any]:
    """Return the fields of a calibration for its file."""

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
        if not calibration.depth_error.changes_nothing:
            document["depth_error"] = depth_error_fields(calibration.depth_error)
        if calibration.point_errors is not None:
            document["point_errors"] = point_errors_fields(calibration.point_errors)
        document |= {name: float(getattr(calibration, name)) for name in _NUMBERS}
    if calibration.T_base_camera is not None:
        document["T_base_camera"] = rows(calibration.T_base_camera)
    return document | _fields_of_motion(calibration)


def _fields_of_motion(calibration: Calibration) -> dict[str, Any]:
    document: dict[str, Any] = {}
    if calibration.any_wheels is not None:
        document["wheels"] = _wheel_fields(calibration.any_wheels)
    if calibration.any_wheels is not None or calibration.gyro != Gyro():
        document["gyro"] = _plain(calibration.gyro)
    if calibration.drive_model is not None:
        document["drive_model"] = drive_model_fields(calibration.drive_model)
    if calibration.nearby is not None:
        rangers = [[float(number) for number in mount] for mount in calibration.nearby.rangers]
        document["nearby"] = {"bumpers": list(calibration.nearby.bumpers), "rangers": rangers}
    return document


def _plain(numbers: DepthNoise | Wheels | Gyro) -> dict[str, float]:
    return {f.name: float(getattr(numbers, f.name)) for f in fields(numbers)}


def _wheel_fields(wheels: Wheels | HolonomicWheels) -> dict[str, Any]:
    if isinstance(wheels, Wheels):
        counter = {name: int(getattr(wheels, name)) for name in _COUNTER_FIELDS}
        plain = _plain(wheels)
        return {name: value for name, value in plain.items() if value or name not in WHEEL_SIGMAS} | counter
    needed, optional = HOLONOMIC_LAYOUTS[wheels.layout]
    numbers = [name for name in (*needed, *optional, *HOLONOMIC_FIELDS) if name not in ("angles_rad", "counter_bits")]
    stated = {name: float(getattr(wheels, name)) for name in numbers}
    fields: dict[str, Any] = {_KIND: _HOLONOMIC, "layout": wheels.layout}
    fields |= {name: value for name, value in stated.items() if value or name not in WHEEL_SIGMAS}
    fields |= {"angles_rad": [float(angle) for angle in wheels.angles_rad]} if wheels.angles_rad else {}
    return fields | ({"counter_bits": int(wheels.counter_bits)} if wheels.counter_bits else {})


def _from_document(document: Any) -> Calibration:
    known = mapping(document, "calibration", _TOP_FIELDS)
    parts: dict[str, Any] = {"T_base_camera": motion(known.get("T_base_camera"), "T_base_camera")}
    if "gyro" in known:
        gyro = mapping(known["gyro"], "gyro", _GYRO_FIELDS)
        parts["gyro"] = made(Gyro, "gyro", _numbers(gyro, "gyro"))
    of_camera = [name for name in _CAMERA_PART if name in known]
    if "color" in known:
        color = _camera(known["color"], "color")
        noise = mapping(known.get("depth_noise", {}), "depth_noise", _NOISE_FIELDS)
        parts |= {
            "color": color,
            "depth": _camera(known["depth"], "depth") if "depth" in known else color,
            "depth_noise": made(DepthNoise, "depth_noise", _numbers(noise, "depth_noise")),
            "depth_error": depth_error_from(known.get("depth_error", {})),
            "point_errors": point_errors_from(known["point_errors"]) if "point_errors" in known else None,
            "T_color_depth": motion(known.get("T_color_depth"), "T_color_depth"),
            **{name: number(known[name], name) for name in _NUMBERS if name in known},
        }
    if "drive_model" in known:
        parts["drive_model"] = drive_model_from(known["drive_model"])
    if "nearby" in known:
        parts["nearby"] = NearbyMounts.of(known["nearby"])
    if "wheels" in known:
        wheels = _wheels(known["wheels"])
        parts["wheels" if isinstance(wheels, Wheels) else "holonomic"] = wheels
    if "color" not in known and (of_camera or not any(name in known for name in _OTHER_PARTS)):
        fix = "give the colour camera: width, height, fx, fy, cx, cy"
        raise _MissingError((of_camera or ["color"])[0], "color", fix)
    return Calibration(**parts, source=str(known.get("source", "unknown")))


def _motion(name: str, value: Any) -> FloatArray:
    """Return a mount (4, 4), read-only. Raises CalibrationError."""
    try:
        T = np.array(value, float)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{name} is a {type(value).__name__}, not (4, 4) of numbers") from error
    if wrong := se3.why_invalid(T, tolerance=1e-4):
        raise CalibrationError(f"{name} is not a rigid motion: {wrong[0]}", fix=wrong[1])
    check_range(f"the way of {name}", float(np.linalg.norm(T[:3, 3])), Range(0, _MOST_APART_M[name], "m"))
    T.setflags(write=False)
    return T


_lens_fault = lru_cache(maxsize=64)(PinholeCamera.lens_fault)  # a change of any part makes a new calibration


def _check_camera(name: str, camera: PinholeCamera) -> None:
    """Raise CalibrationError for an impossible distortion, or a principal point of an image of another size."""
    cx, cy = camera.cx + 0.5, camera.cy + 0.5  # from the corner, not from the first pixel's middle
    x, y = cx / camera.width, cy / camera.height
    across, down = cx / camera.height, cy / camera.width
    where = f"the principal point ({camera.cx:g}, {camera.cy:g}) of {name}"
    size = f"{camera.width}×{camera.height}"
    if max(abs(x - 0.5), abs(y - 0.5)) > _OFF_MIDDLE > max(abs(across - 0.5), abs(down - 0.5)):
        raise CalibrationError(
            f"{where} is that of a {camera.height}×{camera.width} image", fix="swap width and height"
        )
    if abs(x - y) < _ALIKE and not _NEAR_MIDDLE[0] < (x + y) / 2 < _NEAR_MIDDLE[1]:
        problem, scale = f"{where} is far from the middle of a {size} image", 1 / max(x + y, 1e-9)
        fix = f"of another resolution? multiply fx, fy, cx, cy by about {scale:.2g}, or give the size they are for"
        raise CalibrationError(
            problem, fix=fix if scale < _MOST_SCALE else "cx, cy are pixels from the top left corner"
        )
    if (fault := _lens_fault(camera)) is not None:
        numbers = ", ".join(f"{k:.5g}" for k in camera.distortion)
        fix = "calibrate it: wheelsight calibrate camera; of images that are rectified leave the distortion out"
        raise CalibrationError(f"the distortion ({numbers}) of {name} {fault}", fix=fix)


def _numbers(fields_of_part: dict[str, Any], part: str) -> dict[str, float]:
    return {name: number(value, f"{part}.{name}") for name, value in fields_of_part.items()}


def _wheels(value: Any) -> Wheels | HolonomicWheels:
    kind = value.get(_KIND, _DIFFERENTIAL) if isinstance(value, dict) else _DIFFERENTIAL
    if kind not in (_DIFFERENTIAL, _HOLONOMIC):
        raise CalibrationError(f"field wheels.kind is {kind!r}", fix=f"{_DIFFERENTIAL} or {_HOLONOMIC}")
    if kind == _HOLONOMIC:
        return _holonomic(value)
    known = {name: one for name, one in mapping(value, "wheels", (*_WHEEL_FIELDS, _KIND)).items() if name != _KIND}
    missing = [f.name for f in fields(Wheels) if f.default is MISSING and f.name not in known]
    if missing:
        raise _MissingError("wheels", f"wheels.{missing[0]}", "give it too, here or in another --calibration")
    numbers: dict[str, Any] = _numbers(known, "wheels")
    numbers |= {name: whole(known[name], f"wheels.{name}", "") for name in _COUNTER_FIELDS if name in known}
    return made(Wheels, "wheels", numbers)


def _holonomic(value: dict[str, Any]) -> HolonomicWheels:
    layout = value.get("layout")
    if layout not in HOLONOMIC_LAYOUTS:
        raise CalibrationError(f"field wheels.layout is {layout!r}", fix=f"one of {', '.join(HOLONOMIC_LAYOUTS)}")
    needed, optional = HOLONOMIC_LAYOUTS[layout]
    known = mapping(value, "wheels", (_KIND, "layout", *needed, *optional, *HOLONOMIC_FIELDS))
    for name in needed:
        if name not in known:
            fix = f"layout {layout} needs {', '.join(needed)}, here or in another --calibration"
            raise _MissingError("wheels", f"wheels.{name}", fix)
    angles = known.get("angles_rad", [])
    if not isinstance(angles, list):
        raise CalibrationError("field wheels.angles_rad is no list", fix="one angle a wheel: [1.0472, 3.1416, 5.236]")
    plain = {name: one for name, one in known.items() if name not in (_KIND, "layout", "angles_rad", "counter_bits")}
    numbers: dict[str, Any] = _numbers(plain, "wheels")
    numbers["angles_rad"] = tuple(number(angle, "wheels.angles_rad") for angle in angles)
    if "counter_bits" in known:
        numbers["counter_bits"] = whole(known["counter_bits"], "wheels.counter_bits", "")
    return made(HolonomicWheels, "wheels", {"layout": layout, **numbers})


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
