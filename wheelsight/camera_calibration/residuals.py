"""Residuals of a model: what it predicts less what was measured, by σ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.camera_calibration.model import BEFORE_KNOTS, Model, Points, Sigmas
from wheelsight.camera_calibration.priors import prior_rows
from wheelsight.camera_calibration.splines import cubic_grid_weights, cubic_weights
from wheelsight.camera_calibration.views import RAW_DISPARITY
from wheelsight.geometry import FloatArray, PinholeCamera, se3

_LEAST_SLOPE = 0.1  # of corrected depth by the reading, of parameters that are no sensor's


@dataclass(eq=False)
class Residuals:
    """Residuals of a model, block by block, over given σs."""

    model: Model
    sigmas: Sigmas

    def __post_init__(self) -> None:
        m = self.model
        self.at = m.slices()
        self.size = self.at["poses"].stop
        self.knot_weights, self.knot_slopes = _weights_of(m)
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
        return BEFORE_KNOTS

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

        Noise is of readings: off over derivative is how far the reading is from what is expected of it. The derivative
        must be whole. One that leaves the curve's slope out grows as a line is moved from the curve to the scale,
        which changes no depth: thousands of cells then pull the scale up (by 2 %), and it ends beside the curve's end.
        """
        m, p = self.model, x[self.at["error"]]
        reading, knots = m.cells.reading, p[BEFORE_KNOTS:]
        radius2 = (rays**2).sum(axis=1)
        if m.sensor == "tof":
            scale = float(np.exp(p[0]))
            true_m = scale * reading + p[1] + p[2] * radius2 + self.knot_weights @ knots + more
            return true_m, np.maximum(scale + self.knot_slopes @ knots, _LEAST_SLOPE)
        if m.sensor == "stereo":
            scale, inverse = float(np.exp(p[0])), 1 / reading + p[1]
            return scale / inverse + p[2] * radius2, scale / (inverse * reading) ** 2
        if m.sensor == RAW_DISPARITY:
            q, scale, of_reading = self._inverse_of_raw(p), 1.0, np.full(len(reading), np.exp(p[0]))
            inverse = q
        else:
            q, scale, of_reading = 1 / reading, float(np.exp(p[0])), 1 / reading**2
            inverse = q + p[1]
        fade, steeper = self._fading(p, q)
        inverse = inverse + (self.knot_weights @ knots.reshape(2, -1)[0]) * fade
        inverse = np.maximum(inverse + self.knot_weights @ knots.reshape(2, -1)[1] + more, 1e-3)
        return scale / inverse, scale * of_reading * steeper / inverse**2

    def _fading(self, p: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What is left (N,) of the fading pattern at inverse depths, and the derivative (N,) of 1/z by q with it."""
        fade_m = float(np.clip(p[2], 0, 10))
        fade = np.exp(fade_m * (q - 1))
        pattern = self.knot_weights @ p[BEFORE_KNOTS:].reshape(2, -1)[0]
        return fade, np.maximum(1 + fade_m * fade * pattern, _LEAST_SLOPE)

    def by_knots(self, x: FloatArray, of_sum: FloatArray, r: FloatArray) -> FloatArray:
        """Derivatives (N, K) of depth's residuals r (N,) by all knots.

        From `of_sum` (N,), the derivatives by what is added to all of them, and from what knots do to σ.
        """
        weights, p = self.knot_weights, x[self.at["error"]]
        if not self.model.has_pattern:
            slope = np.maximum(float(np.exp(p[0])) + self.knot_slopes @ p[BEFORE_KNOTS:], _LEAST_SLOPE)
            return of_sum[:, None] * weights - (r / slope)[:, None] * self.knot_slopes
        q = 1 / self.model.cells.reading
        if self.model.sensor == RAW_DISPARITY:
            q = self._inverse_of_raw(p)
        fade, steeper = self._fading(p, q)
        of_fading = of_sum * fade - r * float(np.clip(p[2], 0, 10)) * fade / steeper
        return np.concatenate([of_fading[:, None] * weights, of_sum[:, None] * weights], axis=1)

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


def _weights_of(model: Model) -> tuple[FloatArray, FloatArray]:
    """What each knot of pattern or curve counts at each cell (N, K), and of the curve the same of its slope.

    Splines, not lines: between knots 0.25 m apart lines have slopes that are up to 1 % off a swing of 7 mm in 1.9 m,
    which tilts every board that is seen there, and all of them alike.
    """
    none = np.zeros((len(model.cells.px), 0))
    if model.has_pattern:
        return cubic_grid_weights(model.cells.px, model.depth_start, model.grid), none
    if model.sensor != "tof" or not len(model.knots_m):
        return none, none
    reading, knots_m = model.cells.reading, model.knots_m
    return cubic_weights(reading, knots_m), cubic_weights(reading, knots_m, derivative=1)
