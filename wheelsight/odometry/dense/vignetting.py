"""Vignetting: by how much a lens darkens an image towards its rim, learned from plain surfaces at two places of it.

A wall that is seen ahead, and later aside, seems darker than it was; a keyframe then seems tilted against the frame.
What lenses do differs, but falls about as the fourth power of the cosine to the axis; bytes follow by an exponent that
the camera's gamma makes smaller. That exponent is what is learned, a pair of views at a time.
"""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import BoolArray, Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.odometry.dense._alignment_kernels import ALONG_U, ALONG_V, DEPTH, GREY
from wheelsight.odometry.dense.grid import Gridder, GridFrame, vignetting_of
from wheelsight.odometry.dense.reference import Reference
from wheelsight.odometry.dense.settings import DenseSettings

# Of both images every so many pixels are compared.
_STRIDE_PX = 2
# Reweighted least squares: Huber's limit in standard deviations, and how often it is solved.
_HUBER, _ROUNDS = 1.5, 3
# Where vignetting hardly differs, there is no slope.
_FLAT = 1e-9


class Vignetting:
    """Learns one camera's vignetting, and has its frames evened by it.

    Args:
        gridder: makes the frames.
        settings: which places are plain, and what lenses do.

    Attributes:
        exponent: of the cosine's fourth power, in grey values; 0 for an even image.
    """

    def __init__(self, gridder: Gridder, settings: DenseSettings) -> None:
        self._gridder, self._settings = gridder, settings
        self._lens = settings.vignetting
        self.exponent, self._variance = 0.0, self._lens.sigma**2

    def learn(self, frame: GridFrame, T_map_camera: FloatArray, reference: Reference) -> None:
        """Take how plain surfaces look in a frame at a pose (4, 4) and in a reference, a frame before."""
        here, there, known = self._pairs(frame, reference, se3.invert(reference.T_map_reference) @ T_map_camera)
        if np.count_nonzero(known) < self._lens.min_pixels:
            return
        (grey, dark), (grey_then, dark_then) = here[:, known], there[:, known]
        # As the sensor had it: both views were evened by what was known of the lens when they were made.
        brighter = np.log(grey / grey_then) + frame.vignetting * dark - reference.vignetting * dark_then
        information, pull = self._slope(dark - dark_then, brighter)
        total = 1 / self._variance + information
        self.exponent = float(np.clip((self.exponent / self._variance + pull) / total, 0.0, self._lens.max_exponent))
        self._variance = 1 / total
        self._gridder.even(self.exponent)

    def _pairs(self, frame: GridFrame, reference: Reference, T: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Grey and vignetting (2, N) of points in frame and reference, and which (N,) are of one plain surface."""
        number = min(1, self._settings.levels - 1)
        level, pixels = frame.levels[number], reference.levels[number].pixels
        (h, w), some = level.depth_m.shape, (slice(None, None, _STRIDE_PX),) * 2
        camera = PinholeCamera(w, h, *level.intrinsics.tolist())
        px = np.stack([index[some].ravel() for index in np.mgrid[:h, :w][::-1]], axis=-1)
        z, grey = level.depth_m[some].ravel(), level.grey[some].ravel()
        p_then = se3.apply(T, camera.back_project(px, z))
        px_then, is_inside = camera.project(p_then)
        column, row = np.where(is_inside[:, None], np.rint(px_then), 0).astype(int).T
        met = pixels[row, column]
        is_one = np.abs(met[:, DEPTH] - p_then[:, 2]) < self._settings.gate * (1 + p_then[:, 2])
        is_plain = met[:, ALONG_U] ** 2 + met[:, ALONG_V] ** 2 < self._settings.min_gradient**2
        known = (z > 0) & is_inside & is_one & is_plain & self._is_exposed(grey) & self._is_exposed(met[:, GREY])
        dark, dark_then = (vignetting_of((camera.normalise(seen) ** 2).sum(axis=-1)) for seen in (px, px_then))
        return np.stack([grey, dark]), np.stack([met[:, GREY], dark_then]), known

    def _is_exposed(self, grey: Float32Array) -> BoolArray:
        return np.asarray((grey > self._lens.darkest) & (grey < self._lens.brightest))

    def _slope(self, x: FloatArray, y: FloatArray) -> tuple[float, float]:
        """The information on the slope of y (N,) over x (N,), by Huber's weights, and it times the slope.

        Whatever the offset is. Where x is the same everywhere both are 0.
        """
        weight = np.ones(len(x))
        for _ in range(_ROUNDS):
            total = weight.sum()
            dx, dy = x - weight @ x / total, y - weight @ y / total
            spread, common = weight @ dx**2 / total, weight @ (dx * dy) / total
            off = np.abs(dy - common / max(spread, _FLAT) * dx)
            sigma = max(1.4826 * float(np.median(off)), 1e-6)
            weight = _HUBER / np.maximum(off / sigma, _HUBER)
        variance = sigma**2 * self._lens.correlation / len(x) + self._lens.uneven**2
        return float(spread / variance), float(common / variance)
