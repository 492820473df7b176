"""Residuals of a model: what it predicts less what was measured, by σ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.camera_calibration.model import BEFORE_KNOTS, Model, Points, Sigmas
from wheelsight.camera_calibration.priors import prior_rows
from wheelsight.camera_calibration.splines import cubic_grid_weights, cubic_weights
from wheelsight.camera_calibration.views import RAW_DISPARITY
from wheelsight.geometry import FloatArray, PinholeCamera, se3


@dataclass(eq=False)
class Residuals:
    """Residuals of a model, block by block, over given σs.

    Attributes:
        model: what is sought.
        sigmas: of corners and depth.
        weighed_at: the parameters (n,) at which the σ of depth is taken. It depends on them, by how corrected depth
            follows the reading, and stays as it is there while others are sought (generalised least squares: Carroll &
            Ruppert, "Transformation and Weighting in Regression", 1988, ch. 2). Were it to follow them, what makes it
            larger would cost less: thousands of cells would pull depth's scale up, and focal lengths with it.
    """

    model: Model
    sigmas: Sigmas
    weighed_at: FloatArray

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
        self._depth_sigma_m = self._sigma_m()

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
        return self.depth_m(x, more) / self._depth_sigma_m

    def _sigma_m(self) -> FloatArray:
        """σ of corrected depth (N,), metres: the reading's, carried over by the correction's derivative."""
        if not len(self.model.cells.px):
            return np.empty(0)
        _, slope = self._true_m(self.weighed_at, self._rays_at(self.weighed_at), 0.0)
        return np.asarray(self.sigmas.depth * self._reading_sigma * slope)

    def _rays_at(self, x: FloatArray) -> FloatArray:
        camera = self.model.depth_camera(x)
        if self._rays[0] != camera:
            self._rays = camera, camera.normalise(self.model.cells.px)
        return self._rays[1]

    def depth_m(self, x: FloatArray, more: float = 0.0) -> FloatArray:
        """How far cells are off the boards' planes along the axis, metres (N,)."""
        m = self.model
        rays = self._rays_at(x)
        R, t = m.poses_of(x)
        T = m.T_color_depth_of(x)
        n = R[:, :, 2]
        # The plane n · p = h of the colour camera's frame, in the depth camera's.
        h = (n * t).sum(axis=1) - n @ T[:3, 3]
        n_depth = n @ T[:3, :3]
        view = m.cells.view
        z = h[view] / ((n_depth[view, :2] * rays).sum(axis=1) + n_depth[view, 2])
        return self._true_m(x, rays, more)[0] - z

    def _true_m(self, x: FloatArray, rays: FloatArray, more: float) -> tuple[FloatArray, FloatArray]:
        """`DepthError.of_readings` of all cells, with what does not change kept, and its derivative by the reading."""
        m, p = self.model, x[self.at["error"]]
        reading = m.cells.reading
        radius2 = (rays**2).sum(axis=1)
        knots = p[BEFORE_KNOTS:]
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
    """What each knot of pattern or curve counts at each cell (N, K).

    Splines, not lines: between knots 0.25 m apart lines have slopes that are up to 1 % off a swing of 7 mm in 1.9 m,
    which tilts every board that is seen there, and all of them alike.
    """
    if model.has_pattern:
        return cubic_grid_weights(model.cells.px, model.depth_start, model.grid)
    if model.sensor != "tof" or not len(model.knots_m):
        return np.zeros((len(model.cells.px), 0))
    return cubic_weights(model.cells.reading, model.knots_m)
