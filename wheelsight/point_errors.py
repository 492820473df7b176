"""How far off the points may be that a depth camera shows: what its calibration leaves open, as modes of one σ each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.calibration_fields import number
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray

__all__ = [
    "MOST_MODES",
    "NOMINAL_ERRORS",
    "TERMS",
    "PointErrors",
    "mode_of",
    "point_errors_fields",
    "point_errors_from",
]

# Powers of x and y: a lens bends by the third, a place that is off moves rays by inverse depth; a pattern of disparity,
# as wide as floors and walls are, by the second, and by powers of inverse depth as scale, offset and fading have it.
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
    """Independent ways in which all points may be off together, each by one standard deviation.

    A point (X, Y, Z) of the colour camera's frame has the ray x = X/Z, y = Y/Z and the inverse depth q = 1/Z. A mode is
    a polynomial for how far each is off: x and y by the powers of x and y up to the third and by q, q by the powers of
    x and y up to the second times 1, q and q².

    Attributes:
        modes: (K, TERMS) coefficients, of x, then of y, then of q; none where points are known exactly.

    Raises:
        CalibrationError: modes of another length, too many, or what is no number.
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
        """How far each mode moves points (N, 3) before the colour camera, metres of its frame: (K, N, 3)."""
        rays, inverse = _split(np.asarray(points_m, float))
        coefficients = np.array(self.modes).reshape(-1, TERMS)
        x, y, q = np.split(coefficients, (_RAY_TERMS, 2 * _RAY_TERMS), axis=1)
        of_rays, of_inverse = _ray_terms(rays, inverse), _inverse_terms(rays, inverse)
        aside = np.stack([x @ of_rays.T, y @ of_rays.T, np.zeros((len(x), len(rays)))], axis=-1)
        ahead = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) / inverse[:, None]
        return np.asarray((aside - (q @ of_inverse.T)[..., None] * ahead) / inverse[:, None])


def mode_of(points_m: FloatArray, moved_m: FloatArray) -> FloatArray:
    """The coefficients (..., TERMS) that come nearest to moving points (N, 3) by `moved_m` (..., N, 3), all metres.

    Points are of the colour camera's frame, before it, in many directions and at three distances or more.
    """
    rays, inverse = _split(points_m)
    of_q = -(inverse**2) * moved_m[..., 2]
    aside = (moved_m[..., :2] - rays * moved_m[..., 2:]) * inverse[:, None]
    # What an error of inverse depth moves a point by, over its distance, is that error over inverse depth.
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


def _nominal() -> PointErrors:
    """What cameras are off by that nobody has calibrated: one mode each, and chosen where no source is named.

    Focal length 1.5 %: the maker's 525 px is off freiburg1's 517 by as much. Centre 8 px of 586: published Kinects have
    313 to 340 px across and 229 to 247 down, and registration is off by 3 px beside. A bend k1 of 0.1: what Brown's
    numbers of TUM's Kinects make of rays up to 0.5. The cameras' places 2 mm. Depth 2 %: freiburg1's and freiburg2's
    had to be scaled by 1.035 and 1.031 (Sturm et al. 2012). Half a step of a Kinect v1's disparity, 0.0014 1/m, is what
    readings are off by alike all over the image, aslant, and as a bowl: planes before the one of Herrera et al. have 1
    to 1.5 steps RMS, of which most is rough or fades with distance. 1 cm of all depth (Lachat et al. 2015: time of
    flight).
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
    """As a calibration file has them; four digits tell a standard deviation."""
    return [[float(f"{c:.4g}") for c in mode] for mode in errors.modes]


def point_errors_from(value: Any) -> PointErrors:
    """Of a calibration file's field. Raises CalibrationError naming what is wrong."""
    if not isinstance(value, list) or not all(isinstance(mode, list) for mode in value):
        raise CalibrationError("field point_errors must be a list of lists of numbers")
    try:
        return PointErrors(tuple(tuple(number(c, "point_errors") for c in mode) for mode in value))
    except CalibrationError as error:
        raise CalibrationError(f"field {error.problem}".replace("field field", "field"), fix=error.fix) from error


NOMINAL_ERRORS = _nominal()
