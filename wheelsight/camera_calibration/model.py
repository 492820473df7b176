"""The parameters of two cameras, their depth error and the boards' poses, and what they predict: residuals by σ.

The cost is that of Herrera, Kannala & Heikkilä, "Joint depth and color camera calibration with distortion correction",
TPAMI 34 (2012): corners in pixels and depth on the boards' planes, each over its standard deviation, with what is known
beforehand as further residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from wheelsight.camera_calibration.settings import CameraCalibrationSettings
from wheelsight.camera_calibration.task import nominal_step
from wheelsight.camera_calibration.views import RAW_DISPARITY
from wheelsight.depth_error import DepthError, knot_weights, pattern_weights
from wheelsight.geometry import FloatArray, IntArray, PinholeCamera, se3, so3

_LENS, _BARE_LENS, _POSE, _BEFORE_KNOTS = 9, 4, 6, 3
_HELD = 1e-6  # of what is not sought
_OF_FADE = 0.5  # of Herrera et al.'s: exp(-0.0018 d) is exp(0.6 m / z)


class Points(NamedTuple):
    """Corners of all views, one after the other: view (N,), point on the board in squares (N, 3), pixel (N, 2)."""

    view: IntArray
    square: FloatArray
    px: FloatArray


class Cells(NamedTuple):
    """Depth cells of all views: view (N,), pixel (N, 2), reading (N,), a pixel's scatter in it (N,)."""

    view: IntArray
    px: FloatArray
    reading: FloatArray
    scatter: FloatArray


class Sigmas(NamedTuple):
    """Of corners in colour and infrared, pixels, and of depth: a factor on what its noise model says."""

    color_px: float
    infrared_px: float
    depth: float


@dataclass(frozen=True, eq=False)
class Model:
    """What is sought and what it is sought from.

    Attributes:
        color, infrared, cells: what was measured.
        color_start, depth_start: lenses to begin with; their sizes, and of the depth lens without infrared images the
            prior.
        sensor: one of `SENSORS`, or `RAW_DISPARITY`.
        is_registered: whether depth has colour's pixels.
        square_m: side of a square, or None where it is sought.
        noise: (constant_m, quadratic_per_m) of a cell, before `Sigmas.depth`.
        knots_m: distances (K,) of the curve's knots, where there is one.
        T_color_depth: (4, 4) to begin with.
        count: of views.
        settings: priors and grids.
        keeps_color: whether the colour lens is known and stays.
    """

    color: Points
    infrared: Points
    cells: Cells
    color_start: PinholeCamera
    depth_start: PinholeCamera
    sensor: str
    is_registered: bool
    square_m: float | None
    noise: tuple[float, float]
    knots_m: FloatArray
    T_color_depth: FloatArray
    count: int
    settings: CameraCalibrationSettings
    keeps_color: bool = False

    def slices(self) -> dict[str, slice]:
        """Where in the vector of parameters each block stands; poses last."""
        sizes = {
            "color": _LENS,
            "depth": 0 if self.is_registered else _LENS if len(self.infrared.px) else _BARE_LENS,
            "apart": 0 if self.is_registered else _POSE,
            "square": int(self.square_m is None),
            "error": self._error_size() if len(self.cells.px) else 0,
            "poses": _POSE * self.count,
        }
        if not self.is_registered and not len(self.cells.px) and not len(self.infrared.px):
            sizes["depth"] = sizes["apart"] = 0
        ends = np.cumsum(list(sizes.values()))
        return {name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    def _error_size(self) -> int:
        if self.sensor == "tof":
            return 3 + len(self.knots_m)
        if self.sensor == "stereo":
            return 3
        return _BEFORE_KNOTS + 2 * self.grid[0] * self.grid[1]

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of the pattern's knots."""
        return self.settings.model.pattern_rows, self.settings.model.pattern_columns

    @property
    def has_pattern(self) -> bool:
        """Whether depth is off over the image as disparities are."""
        return self.sensor in ("structured-light", RAW_DISPARITY)

    def color_camera(self, x: FloatArray) -> PinholeCamera:
        """The colour camera of parameters."""
        return _lens(x[self.slices()["color"]], self.color_start)

    def depth_camera(self, x: FloatArray) -> PinholeCamera:
        """The depth camera of parameters."""
        if self.is_registered:
            return self.color_camera(x)
        p = x[self.slices()["depth"]]
        return _lens(p, self.depth_start) if len(p) else self.depth_start

    def T_color_depth_of(self, x: FloatArray) -> FloatArray:
        """(4, 4) of parameters."""
        p = x[self.slices()["apart"]]
        return se3.exp(p) @ self.T_color_depth if len(p) else self.T_color_depth

    def square_of(self, x: FloatArray) -> float:
        """Side of a square, metres."""
        p = x[self.slices()["square"]]
        return float(np.exp(p[0])) if self.square_m is None else self.square_m

    def poses_of(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations (count, 3, 3) and translations (count, 3), metres, from boards into the colour camera."""
        p = x[self.slices()["poses"]].reshape(-1, _POSE)
        return so3.exp(p[:, 3:]), p[:, :3] * self.square_of(x)

    def error_of(self, x: FloatArray) -> DepthError:
        """The depth error of parameters."""
        p = x[self.slices()["error"]]
        if not len(p):
            return DepthError()
        if self.sensor == "tof":
            curve = tuple(zip(self.knots_m.tolist(), p[3:].tolist(), strict=True))
            return DepthError(float(np.exp(p[0])), float(p[1]), float(p[2]), curve_m=curve if len(curve) > 1 else ())
        if self.sensor == "stereo":
            return DepthError(float(np.exp(p[0])), radial_m=float(p[2]), inverse_per_m=float(p[1]))
        patterns = p[_BEFORE_KNOTS:].reshape(2, *self.grid).tolist()
        pattern, lasting = (tuple(tuple(row) for row in rows) for rows in patterns)
        fade_m = float(np.clip(p[2], 0, 10))
        if self.sensor == RAW_DISPARITY:
            step = self.nominal_step * float(np.exp(p[0]))
            at_zero = -self.nominal_step * self.settings.model.disparity_of_infinity + float(p[1])
            numbers: dict[str, Any] = {"disparity_at_zero_per_m": at_zero, "disparity_step_per_m": step}
        else:
            numbers = {"scale": float(np.exp(p[0])), "inverse_per_m": float(p[1])}
        return replace(DepthError(**numbers), fade_m=fade_m, pattern_per_m=pattern, lasting_per_m=lasting)

    @property
    def nominal_step(self) -> float:
        """Inverse depth, 1/m, of one raw disparity, as Kinect v1's maker has it: an eighth of a pixel."""
        return nominal_step(self.settings)

    @property
    def is_scale_free(self) -> bool:
        """Whether depth's scale is sought: boards of unknown size take theirs from depth."""
        return self.square_m is not None


def _lens(p: FloatArray, start: PinholeCamera) -> PinholeCamera:
    """A lens of ln(fx / start's), ln(fy / fx), centre off the image's middle by start's fx, and Brown's numbers."""
    fx = start.fx * float(np.exp(p[0]))
    cx, cy = (start.width - 1) / 2 + start.fx * p[2], (start.height - 1) / 2 + start.fx * p[3]
    k1, k2, p1, p2, k3 = p[4:] if len(p) > _BARE_LENS else start.distortion
    centre = float(np.clip(cx, 0, start.width)), float(np.clip(cy, 0, start.height))
    return PinholeCamera(start.width, start.height, fx, fx * float(np.exp(p[1])), *centre, (k1, k2, p1, p2, k3))


def lens_parameters(camera: PinholeCamera, start: PinholeCamera, is_bare: bool = False) -> FloatArray:
    """The parameters of a lens, seen from `start`."""
    centre = (camera.cx - (start.width - 1) / 2) / start.fx, (camera.cy - (start.height - 1) / 2) / start.fx
    bare = [np.log(camera.fx / start.fx), np.log(camera.fy / camera.fx), *centre]
    return np.array(bare if is_bare else [*bare, *camera.distortion], float)


@dataclass(eq=False)
class Residuals:
    """Residuals of a model, block by block, over given σs."""

    model: Model
    sigmas: Sigmas

    def __post_init__(self) -> None:
        m = self.model
        self.at = m.slices()
        self.size = self.at["poses"].stop
        self.knot_weights = _weights_of(m)
        constant, quadratic = m.noise
        # Of raw disparities in nominal inverse depth, 1/m, as a step has it; else in metres.
        is_raw = m.sensor == RAW_DISPARITY
        self._reading_sigma = quadratic if is_raw else constant + quadratic * m.cells.reading**2
        self._rays: tuple[PinholeCamera | None, FloatArray] = (None, np.empty((0, 2)))
        self._priors = prior_rows(m)

    def color(self, x: FloatArray) -> FloatArray:
        """Of colour corners (N, 2), in σ."""
        p = self._points(x, self.model.color)
        px = self.model.color_camera(x).denormalise(p[:, :2] / p[:, 2:])
        return (px - self.model.color.px) / self.sigmas.color_px

    def infrared(self, x: FloatArray) -> FloatArray:
        """Of infrared corners (N, 2), in σ."""
        if not len(self.model.infrared.px):
            return np.empty((0, 2))
        p = se3.apply(se3.invert(self.model.T_color_depth_of(x)), self._points(x, self.model.infrared))
        px = self.model.depth_camera(x).denormalise(p[:, :2] / p[:, 2:])
        return (px - self.model.infrared.px) / self.sigmas.infrared_px

    @property
    def knots_from(self) -> int:
        """How many numbers of the depth error stand before its knots."""
        return _BEFORE_KNOTS

    def depth(self, x: FloatArray, more: float = 0.0) -> FloatArray:
        """Of depth cells (N,), in σ; `more` is added to what the knots make of each."""
        if not len(self.model.cells.px):
            return np.empty(0)
        off_m, sigma_m = self.depth_m(x, more)
        return off_m / sigma_m

    def depth_m(self, x: FloatArray, more: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """How far cells are off the boards' planes along the axis, and their σ, metres (N,)."""
        m = self.model
        camera = m.depth_camera(x)
        if self._rays[0] != camera:
            self._rays = camera, camera.normalise(m.cells.px)
        rays = self._rays[1]
        R, t = m.poses_of(x)
        T = m.T_color_depth_of(x)
        n = R[:, :, 2]
        # The plane n · p = h of the colour camera's frame, in the depth camera's.
        h = (n * t).sum(axis=1) - n @ T[:3, 3]
        n_depth = n @ T[:3, :3]
        view = m.cells.view
        z = h[view] / ((n_depth[view, :2] * rays).sum(axis=1) + n_depth[view, 2])
        true_m, slope = self._true_m(x, rays, more)
        return true_m - z, self.sigmas.depth * self._reading_sigma * slope

    def _true_m(self, x: FloatArray, rays: FloatArray, more: float) -> tuple[FloatArray, FloatArray]:
        """`DepthError.of_readings` of all cells, with what does not change kept, and its derivative by the reading.

        Noise is of readings. Were its σ taken at the depth that is fitted, larger depths would cost less, and the
        focal length, which is known little better than depth's scale, came out 0.2 % too long.
        """
        m, p = self.model, x[self.at["error"]]
        reading = m.cells.reading
        radius2 = (rays**2).sum(axis=1)
        knots = p[_BEFORE_KNOTS:]
        if m.sensor == "tof":
            scale = float(np.exp(p[0]))
            true_m = scale * reading + p[1] + p[2] * radius2 + self.knot_weights @ knots + more
            return true_m, np.full(len(reading), scale)
        if m.sensor == "stereo":
            scale, inverse = float(np.exp(p[0])), 1 / reading + p[1]
            return scale / inverse + p[2] * radius2, scale / (inverse * reading) ** 2
        if m.sensor == RAW_DISPARITY:
            q, scale, of_reading = self._inverse_of_raw(p), 1.0, np.full(len(reading), np.exp(p[0]))
            inverse = q
        else:
            q, scale, of_reading = 1 / reading, float(np.exp(p[0])), 1 / reading**2
            inverse = q + p[1]
        fading, lasting = knots.reshape(2, -1)
        fade = np.exp(np.clip(p[2], 0, 10) * (q - 1))
        inverse = inverse + (self.knot_weights @ fading) * fade + self.knot_weights @ lasting + more
        inverse = np.maximum(inverse, 1e-3)
        return scale / inverse, scale * of_reading / inverse**2

    def by_knots(self, x: FloatArray, of_sum: FloatArray) -> FloatArray:
        """Derivatives (N, K) of depth by all knots, from those (N,) by what is added to all of them."""
        weights = self.knot_weights
        if not self.model.has_pattern:
            return of_sum[:, None] * weights
        p = x[self.at["error"]]
        q = 1 / self.model.cells.reading
        if self.model.sensor == RAW_DISPARITY:
            q = self._inverse_of_raw(p)
        fade = np.exp(np.clip(p[2], 0, 10) * (q - 1))
        return np.concatenate([(of_sum * fade)[:, None] * weights, of_sum[:, None] * weights], axis=1)

    def _inverse_of_raw(self, p: FloatArray) -> FloatArray:
        m = self.model
        at_zero = -m.nominal_step * m.settings.model.disparity_of_infinity + p[1]
        return np.asarray(at_zero + m.nominal_step * np.exp(p[0]) * m.cells.reading)

    def _points(self, x: FloatArray, points: Points) -> FloatArray:
        R, t = self.model.poses_of(x)
        square_m = self.model.square_of(x)
        return np.asarray(np.einsum("nij,nj->ni", R[points.view], square_m * points.square) + t[points.view])

    @property
    def prior_rows(self) -> FloatArray:
        """The derivatives (P, n) of `priors`."""
        return self._priors[0]

    def priors(self, x: FloatArray) -> FloatArray:
        """Of what is known beforehand, in σ."""
        rows, expected = self._priors
        return np.asarray(rows @ x - expected)


def _weights_of(model: Model) -> FloatArray:
    """What each knot of pattern or curve counts at each cell (N, K)."""
    if model.has_pattern:
        return pattern_weights(model.cells.px, model.depth_start, model.grid)
    if model.sensor != "tof" or len(model.knots_m) < 2:
        return np.zeros((len(model.cells.px), 0))
    low, high = model.knots_m[[0, -1]]
    return knot_weights((model.cells.reading - low) / (high - low), len(model.knots_m))


def prior_rows(model: Model) -> tuple[FloatArray, FloatArray]:
    """What is known beforehand, as rows (P, n) and values (P,) in σ: rows @ x is about the values."""
    priors = _Priors(model.slices()["poses"].stop)
    at = model.slices()
    _of_lens(priors, model, at["color"], model.color_start, is_held=model.keeps_color)
    _of_lens(priors, model, at["depth"], model.depth_start, is_held=False)
    for k in range(at["apart"].start, min(at["apart"].start + 3, at["apart"].stop)):
        priors.add([k], [1], 0.0, model.settings.prior.apart_m)
    if at["error"].stop > at["error"].start:
        _of_error(priors, model, at["error"].start)
    return np.array(priors.rows).reshape(-1, priors.size), np.array(priors.values)


class _Priors:
    """Rows and values, one by one."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.rows: list[FloatArray] = []
        self.values: list[float] = []

    def add(self, columns: list[int], weights: list[float], value: float, sigma: float) -> None:
        """A weighted sum of parameters that is about a value, to a σ."""
        row = np.zeros(self.size)
        row[columns] = np.array(weights) / sigma
        self.rows.append(row)
        self.values.append(value / sigma)


def _of_lens(priors: _Priors, model: Model, place: slice, start: PinholeCamera, *, is_held: bool) -> None:
    first, length, prior = place.start, place.stop - place.start, model.settings.prior
    if not length:
        return
    known = lens_parameters(start, start)
    if is_held:
        for k in range(length):
            priors.add([first + k], [1], float(known[k]), _HELD)
        return
    is_nominal = length == _BARE_LENS
    if is_nominal:
        priors.add([first], [1], 0.0, prior.depth_focal)
    priors.add([first + 1], [1], float(np.log(start.fy / start.fx)), prior.aspect)
    centre = (1.0 if is_nominal else 2.0) * prior.depth_centre_px * start.width / 640 / start.fx
    for k in (2, 3):
        priors.add([first + k], [1], float(known[k]), centre)
    bent = [*prior.radial[:2], prior.tangential, prior.tangential, prior.radial[2]]
    for k in range(_BARE_LENS, length):
        priors.add([first + k], [1], 0.0, bent[k - _BARE_LENS])


def _of_error(priors: _Priors, model: Model, first: int) -> None:
    prior, knots = model.settings.prior, first + _BEFORE_KNOTS
    if not model.is_scale_free:
        priors.add([first], [1], 0.0, _HELD)
    if model.sensor == "tof":
        for k in range(len(model.knots_m)):
            priors.add([knots + k], [1], 0.0, prior.curve_m)
        for k in range(len(model.knots_m) - 2):
            priors.add([knots + k, knots + k + 1, knots + k + 2], [1, -2, 1], 0.0, prior.curve_bend_m)
    if not model.has_pattern:
        return
    priors.add([first + 2], [1], _OF_FADE, prior.fade_m)
    rows, columns = model.grid
    for number in knots + np.arange(2 * rows * columns).reshape(2, rows, columns):
        for knot in number.ravel().tolist():
            priors.add([knot], [1], 0.0, prior.pattern_per_m)
        for line in [*number.tolist(), *number.T.tolist()]:
            for three in zip(line, line[1:], line[2:], strict=False):
                priors.add(list(three), [1, -2, 1], 0.0, prior.pattern_bend_per_m)
