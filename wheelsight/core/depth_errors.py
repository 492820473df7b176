"""Errors of a depth camera. `DepthError` corrects the systematic part, by distance and over the image; `PointErrors`
holds the modes that remain after calibration.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wheelsight.core.calibration_parts import Range, check_range, mapping, need_numbers, number
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera

__all__ = [
    "LARGEST_GRID",
    "MOST_MODES",
    "NOMINAL_ERRORS",
    "NO_DISPARITY",
    "TERMS",
    "DepthError",
    "PointErrors",
    "depth_error_fields",
    "depth_error_from",
    "knot_weights",
    "mode_of",
    "pattern_weights",
    "point_errors_fields",
    "point_errors_from",
]


NO_DISPARITY = 2047  # raw value of Kinect v1
LARGEST_GRID = 64
# Larger errors are of another unit, such as millimetres read as metres.
_RANGES = {
    "scale": Range(0.5, 2.0, ""),
    "offset_m": Range(-1.0, 1.0, "m"),
    "radial_m": Range(-1.0, 1.0, "m"),
    "inverse_per_m": Range(-1.0, 1.0, "1/m"),
    "fade_m": Range(0.0, 10.0, "m"),
    "disparity_at_zero_per_m": Range(-100.0, 100.0, "1/m"),
    "disparity_step_per_m": Range(-1.0, 1.0, "1/m"),
}
_OF_PATTERN = Range(-1.0, 1.0, "1/m")
_OF_CURVE = Range(0.0, 1000.0, "m"), Range(-1.0, 1.0, "m")


@dataclass(frozen=True, slots=True)
class DepthError:
    """Correction of a depth camera's reading z to the true depth along its axis.

    The inverse depth by disparity is q = 1/z + inverse_per_m + lasting(u, v) + pattern(u, v) · exp(fade_m ·
    (1/z - 1/m)), and the true depth scale / q + offset_m + radial_m · r² + curve(1/q), where r is the tangent of the
    ray's angle from the axis. The default changes nothing.

    The pattern with its exponential is that of Herrera, Kannala & Heikkilä, "Joint depth and color camera calibration
    with distortion correction", TPAMI 34 (2012), eq. 6, whose disparities are inverse depths but for a constant; its
    part that does not fade has another shape. Scale, offset and the radial term are those of time of flight; the curve
    oscillates about them (Lindner & Kolb, "Lateral and depth calibration of PMD-distance sensors", ISVC 2006).

    Attributes:
        scale, offset_m, radial_m, inverse_per_m, fade_m: as above.
        pattern_per_m: rows of numbers spread evenly over the image, corner to corner, linear between them; or ().
        lasting_per_m: likewise, the part that does not fade with distance.
        curve_m: pairs (depth, correction), by growing depth, linear between them and constant beyond; or ().
        disparity_at_zero_per_m, disparity_step_per_m: 1/z = at_zero + step · disparity for raw disparities of Kinect
            v1; both 0 for depths.

    Raises:
        CalibrationError: a number out of its range, or an invalid pattern or curve.
    """

    scale: float = 1.0
    offset_m: float = 0.0
    radial_m: float = 0.0
    inverse_per_m: float = 0.0
    fade_m: float = 0.0
    pattern_per_m: tuple[tuple[float, ...], ...] = ()
    lasting_per_m: tuple[tuple[float, ...], ...] = ()
    curve_m: tuple[tuple[float, float], ...] = ()
    disparity_at_zero_per_m: float = 0.0
    disparity_step_per_m: float = 0.0

    def __post_init__(self) -> None:
        need_numbers(self, tuple(_RANGES))
        for name, allowed in _RANGES.items():
            if not np.isfinite(getattr(self, name)):
                raise CalibrationError(f"{name} is {getattr(self, name)}, not a number")
            check_range(name, getattr(self, name), allowed)
        for name in _LISTS:
            rows = tuple(tuple(float(x) for x in row) for row in getattr(self, name))
            object.__setattr__(self, name, rows)
            if not np.isfinite([x for row in rows for x in row]).all():
                raise CalibrationError(f"{name} holds what is no number")
        for name in _PATTERNS:
            self._check_pattern(name)
        self._check_curve()
        if (self.disparity_step_per_m == 0) != (self.disparity_at_zero_per_m == 0):
            raise CalibrationError("a disparity takes both disparity_at_zero_per_m and disparity_step_per_m")

    def _check_pattern(self, name: str) -> None:
        rows: tuple[tuple[float, ...], ...] = getattr(self, name)
        sizes = {len(row) for row in rows}
        if rows and (len(sizes) != 1 or min(len(rows), *sizes) < 2):
            raise CalibrationError(f"{name} is no grid", fix="give two or more rows of two or more numbers each")
        if max((len(rows), *sizes), default=0) > LARGEST_GRID:
            raise CalibrationError(f"{name} has more than {LARGEST_GRID} rows or columns")
        for row in rows:
            for value in row:
                check_range(name, value, _OF_PATTERN)

    def _check_curve(self) -> None:
        if any(len(pair) != 2 for pair in self.curve_m) or len(self.curve_m) > LARGEST_GRID:
            raise CalibrationError("curve_m is no list of pairs", fix="give pairs of depth and what to add to it")
        for pair in self.curve_m:
            for value, allowed in zip(pair, _OF_CURVE, strict=True):
                check_range("curve_m", value, allowed)
        if any(b[0] <= a[0] for a, b in zip(self.curve_m, self.curve_m[1:], strict=False)):
            raise CalibrationError("curve_m is not in order of depth")

    @property
    def changes_nothing(self) -> bool:
        """Whether readings are true depths."""
        return self == DepthError()

    @property
    def is_of_disparity(self) -> bool:
        """Whether depth images hold raw disparities."""
        return self.disparity_step_per_m != 0

    def of_disparity(self, raw: NDArray[np.integer]) -> Float32Array:
        """Return uncorrected readings (H, W) in metres of raw disparities (H, W), 0 without disparity."""
        inverse = np.float32(self.disparity_at_zero_per_m) + np.float32(self.disparity_step_per_m) * raw
        seen = (raw < NO_DISPARITY) & (inverse > 0)
        depth_m: Float32Array = np.divide(np.float32(1), inverse, out=np.zeros(raw.shape, np.float32), where=seen)
        return depth_m

    def corrected(self, depth_m: Float32Array, camera: PinholeCamera) -> Float32Array:
        """Return the corrected depth image (H, W) in metres of this camera; 0 stays 0."""
        if replace(self, disparity_at_zero_per_m=0.0, disparity_step_per_m=0.0).changes_nothing:
            return depth_m
        maps = _maps(self, camera)
        seen = depth_m > 0
        inverse: Any = np.divide(np.float32(1), depth_m, out=np.ones(depth_m.shape, np.float32), where=seen)
        found = self._of_inverse(inverse, maps)
        return np.where(seen & (found > 0), found, 0).astype(np.float32)

    def of_readings(self, depth_m: ArrayLike, px: ArrayLike, camera: PinholeCamera) -> FloatArray:
        """Return true depths (N,) of readings (N,) in metres at pixels (N, 2)."""
        px = np.asarray(px, float)

        def at_px(rows: tuple[tuple[float, ...], ...]) -> FloatArray | float:
            if not rows:
                return 0.0
            return np.asarray(pattern_weights(px, camera, (len(rows), len(rows[0]))) @ np.array(rows).ravel(), float)

        radius2 = (camera.normalise(px) ** 2).sum(axis=-1)
        maps = _Maps(at_px(self.pattern_per_m), at_px(self.lasting_per_m), radius2)
        return np.asarray(self._of_inverse(1 / np.asarray(depth_m, float), maps), float)

    def _of_inverse(self, inverse: Any, maps: _Maps) -> Any:
        if self.pattern_per_m:
            fade = np.exp(np.asarray(self.fade_m, inverse.dtype) * (inverse - 1)) if self.fade_m else 1
            inverse = inverse + maps.pattern * fade
        if self.lasting_per_m:
            inverse = inverse + maps.lasting
        if self.inverse_per_m:
            inverse = inverse + np.asarray(self.inverse_per_m, inverse.dtype)
        with np.errstate(divide="ignore"):
            seen_m = np.where(inverse > 0, 1 / inverse, 0)
        true_m = self.scale * seen_m + self.offset_m
        if self.radial_m:
            true_m = true_m + self.radial_m * maps.radius2
        if self.curve_m:
            depths_m, added_m = np.array(self.curve_m).T
            true_m = true_m + np.interp(seen_m, depths_m, added_m)
        return true_m


class _Maps(NamedTuple):
    """Both patterns and the squared tangent of the ray's angle, at each pixel; a zero for unused ones."""

    pattern: Any
    lasting: Any
    radius2: Any


@lru_cache(maxsize=4)
def _maps(error: DepthError, camera: PinholeCamera) -> _Maps:
    radius2 = np.zeros((), np.float32)
    if error.radial_m:
        radius2 = (camera.rays()[..., :2] ** 2).sum(axis=-1).astype(np.float32)
    return _Maps(_map(error.pattern_per_m, camera), _map(error.lasting_per_m, camera), radius2)


def _map(rows: tuple[tuple[float, ...], ...], camera: PinholeCamera) -> Float32Array:
    if not rows:
        return np.zeros((), np.float32)
    knots = np.array(rows)
    down = knot_weights(np.arange(camera.height) / max(camera.height - 1, 1), knots.shape[0])
    across = knot_weights(np.arange(camera.width) / max(camera.width - 1, 1), knots.shape[1])
    return np.asarray(down @ knots @ across.T, np.float32)


def pattern_weights(px: FloatArray, camera: PinholeCamera, grid: tuple[int, int]) -> FloatArray:
    """Return the weights (N, rows · columns) of a pattern's knots at pixels (N, 2)."""
    down = knot_weights(px[:, 1] / max(camera.height - 1, 1), grid[0])
    across = knot_weights(px[:, 0] / max(camera.width - 1, 1), grid[1])
    return (down[:, :, None] * across[:, None, :]).reshape(len(px), -1)


def knot_weights(shares: FloatArray, count: int) -> FloatArray:
    """Return the weights (N, count) of `count` knots, evenly from 0 to 1, at shares (N,); linear between them."""
    at = np.clip(shares, 0, 1) * (count - 1)
    return np.asarray(np.maximum(0.0, 1 - np.abs(at[:, None] - np.arange(count))), float)


_PATTERNS = ("pattern_per_m", "lasting_per_m")
_LISTS = (*_PATTERNS, "curve_m")
_FIELDS = tuple(f.name for f in fields(DepthError))


def depth_error_fields(error: DepthError) -> dict[str, Any]:
    """Return the fields of a depth error that are not the default, for a calibration file."""
    changed = {name: getattr(error, name) for name in _FIELDS if getattr(error, name) != getattr(DepthError(), name)}
    return {name: [list(row) for row in value] if name in _LISTS else float(value) for name, value in changed.items()}


def depth_error_from(value: Any) -> DepthError:
    """Return the depth error of a calibration file's field. Raises CalibrationError."""
    known = mapping(value, "depth_error", _FIELDS)
    numbers: dict[str, Any] = {}
    for name, given in known.items():
        if name not in _LISTS:
            numbers[name] = number(given, f"depth_error.{name}")
            continue
        if not isinstance(given, list) or not all(isinstance(row, list) for row in given):
            raise CalibrationError(f"field depth_error.{name} must be a list of lists of numbers")
        numbers[name] = tuple(tuple(number(x, f"depth_error.{name}") for x in row) for row in given)
    try:
        return DepthError(**numbers)
    except CalibrationError as error:
        raise CalibrationError(f"field depth_error: {error.problem}", fix=error.fix) from error


# Powers of x and y up to the third for lenses; inverse depth for a displaced camera. A pattern of disparity has the
# second power, times powers of inverse depth for scale, offset and fading.
_OF_RAYS = tuple((i, j) for i in range(4) for j in range(4 - i))
_OF_INVERSE = tuple((i, j) for i in range(3) for j in range(3 - i))
_POWERS = 3
_RAY_TERMS = len(_OF_RAYS) + 1
_NAMES = (
    *((axis, *powers) for axis in "xy" for powers in (*((i, j, 0) for i, j in _OF_RAYS), (0, 0, 1))),
    *(("q", i, j, k) for k in range(_POWERS) for i, j in _OF_INVERSE),
)
TERMS = 2 * _RAY_TERMS + _POWERS * len(_OF_INVERSE)
MOST_MODES = TERMS  # more are no more independent


@dataclass(frozen=True, slots=True)
class PointErrors:
    """Independent errors common to all points that remain after calibration, each of one standard deviation.

    A point (X, Y, Z) of the colour camera's frame has the ray x = X/Z, y = Y/Z and the inverse depth q = 1/Z. A mode is
    a polynomial of the error: in x and y by the powers of x and y up to the third and by q, in q by the powers of x and
    y up to the second times 1, q and q².

    Attributes:
        modes: (K, TERMS) coefficients, of x, then of y, then of q; empty for exact points.

    Raises:
        CalibrationError: modes of another length, too many, or not finite.
    """

    modes: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "modes", tuple(tuple(float(c) for c in mode) for mode in self.modes))
        if len(self.modes) > MOST_MODES:
            raise CalibrationError(f"point_errors has {len(self.modes)} modes, more than {MOST_MODES}")
        if any(len(mode) != TERMS for mode in self.modes):
            raise CalibrationError(f"point_errors has a mode that is not of {TERMS} numbers")
        if not np.isfinite([c for mode in self.modes for c in mode]).all():
            raise CalibrationError("point_errors holds what is no number")

    def moved_m(self, points_m: ArrayLike) -> FloatArray:
        """Return the displacement (K, N, 3) in metres of points (N, 3) of the colour camera by each mode."""
        rays, inverse = _split(np.asarray(points_m, float))
        coefficients = np.array(self.modes).reshape(-1, TERMS)
        x, y, q = np.split(coefficients, (_RAY_TERMS, 2 * _RAY_TERMS), axis=1)
        of_rays, of_inverse = _ray_terms(rays, inverse), _inverse_terms(rays, inverse)
        aside = np.stack([x @ of_rays.T, y @ of_rays.T, np.zeros((len(x), len(rays)))], axis=-1)
        ahead = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) / inverse[:, None]
        return np.asarray((aside - (q @ of_inverse.T)[..., None] * ahead) / inverse[:, None])


def mode_of(points_m: FloatArray, moved_m: FloatArray) -> FloatArray:
    """Fit the coefficients (..., TERMS) of displacements `moved_m` (..., N, 3) of points (N, 3), in metres.

    Points are in front of the colour camera, in its frame, in many directions and at three distances or more.
    """
    rays, inverse = _split(points_m)
    of_q = -(inverse**2) * moved_m[..., 2]
    aside = (moved_m[..., :2] - rays * moved_m[..., 2:]) * inverse[:, None]
    # The displacement by an error of inverse depth, over the distance, is that error over inverse depth.
    to_rays = np.linalg.pinv(_ray_terms(rays, inverse))
    to_inverse = np.linalg.pinv(_inverse_terms(rays, inverse) / inverse[:, None])
    parts = (aside[..., 0] @ to_rays.T, aside[..., 1] @ to_rays.T, (of_q / inverse) @ to_inverse.T)
    return np.concatenate(parts, axis=-1)


def _split(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    return points_m[:, :2] / points_m[:, 2:], 1 / points_m[:, 2]


def _ray_terms(rays: FloatArray, inverse: FloatArray) -> FloatArray:
    return np.stack([*(rays[:, 0] ** i * rays[:, 1] ** j for i, j in _OF_RAYS), inverse], axis=-1)


def _inverse_terms(rays: FloatArray, inverse: FloatArray) -> FloatArray:
    plain = [rays[:, 0] ** i * rays[:, 1] ** j for i, j in _OF_INVERSE]
    return np.stack([term * inverse**k for k in range(_POWERS) for term in plain], axis=-1)


def nominal_errors() -> PointErrors:
    """Return errors of uncalibrated cameras: one mode each, chosen if no source is named.

    Focal length 1.5 %: as the maker's 525 px against freiburg1's 517. Centre 8 px of 586: published Kinects have 313 to
    340 px across and 229 to 247 down, and registration errs by 3 px too. Distortion k1 of 0.1: as Brown's coefficients
    of TUM's Kinects for rays up to 0.5. Position of the cameras 2 mm. Depth 2 %: freiburg1's and freiburg2's had to be
    scaled by 1.035 and 1.031 (Sturm et al. 2012). Half a step of a Kinect v1's disparity, 0.0014 1/m, over the whole
    image, as a slope, and as a bowl: planes of Herrera et al. have 1 to 1.5 steps RMS, but most of it is rough or fades
    with distance. 1 cm of all depth (Lachat et al. 2015: time of flight).
    """
    half_step = 0.0014
    parts: tuple[dict[tuple[str, int, int, int], float], ...] = (
        {("x", 1, 0, 0): 0.015, ("y", 0, 1, 0): 0.015},
        {("x", 0, 0, 0): 8 / 586},
        {("y", 0, 0, 0): 8 / 586},
        {("x", 3, 0, 0): 0.1, ("x", 1, 2, 0): 0.1, ("y", 2, 1, 0): 0.1, ("y", 0, 3, 0): 0.1},
        {("x", 0, 0, 1): 0.002},
        {("y", 0, 0, 1): 0.002},
        {("q", 0, 0, 1): 0.02},
        {("q", 0, 0, 0): half_step},
        {("q", 1, 0, 0): half_step / 0.3},
        {("q", 0, 1, 0): half_step / 0.25},
        {("q", 2, 0, 0): half_step / 0.11, ("q", 0, 2, 0): half_step / 0.11},
        {("q", 0, 0, 2): 0.01},
    )
    return PointErrors(tuple(tuple(part.get(name, 0.0) for name in _NAMES) for part in parts))


def point_errors_fields(errors: PointErrors) -> list[list[float]]:
    """Return the field of a calibration file; four digits suffice for a standard deviation."""
    return [[float(f"{c:.4g}") for c in mode] for mode in errors.modes]


def point_errors_from(value: Any) -> PointErrors:
    """Return the point errors of a calibration file's field. Raises CalibrationError."""
    if not isinstance(value, list) or not all(isinstance(mode, list) for mode in value):
        raise CalibrationError("field point_errors must be a list of lists of numbers")
    try:
        return PointErrors(tuple(tuple(number(c, "point_errors") for c in mode) for mode in value))
    except CalibrationError as error:
        raise CalibrationError(f"field {error.problem}".replace("field field", "field"), fix=error.fix) from error


NOMINAL_ERRORS = nominal_errors()
