"""Falloff: by how much a lens darkens an image towards its rim, learned from plain surfaces seen at two places of it.

A wall that is seen ahead, and later aside, seems darker than it was; a keyframe then seems tilted against the frame.
What lenses do differs, but falls about as the fourth power of the cosine to the axis; bytes follow by an exponent that
the camera's gamma makes smaller. That exponent is what is learned, a pair of views at a time.
"""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import BoolArray, Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.odometry.dense._alignment_kernels import ALONG_U, ALONG_V, DEPTH, GREY
from wheelsight.odometry.dense.grid import Gridder, GridFrame, falloff_of
from wheelsight.odometry.dense.reference import Reference
from wheelsight.odometry.dense.settings import DenseSettings

# Before anything is seen: none, give or take; and never beyond what lenses do.
_SIGMA, _MOST = 0.3, 1.0
# Logarithms of grey: by so much what lights a place differs from view to view, wherever it is.
_UNEVEN = 0.01
# Neighbours err as one, so many of them.
_ALIKE = 20.0
_STRIDE_PX, _FEWEST = 2, 300
# Grey that is neither noise nor cut off.
_DARKEST, _BRIGHTEST = 20.0, 235.0
_HUBER, _ROUNDS = 1.5, 3
# A falloff that hardly differs tells no slope.
_FLAT = 1e-9


class Falloff:
    """Learns one camera's falloff, and has its frames evened by it.

    Args:
        gridder: makes the frames.
        settings: which places are plain.

    Attributes:
        exponent: of the cosine's fourth power, in grey values; 0 for an even image.
    """

    def __init__(self, gridder: Gridder, settings: DenseSettings) -> None:
        self._gridder, self._settings = gridder, settings
        self.exponent, self._variance = 0.0, _SIGMA**2

    def learn(self, frame: GridFrame, T_map_camera: FloatArray, reference: Reference) -> None:
        """Take how plain surfaces look in a frame at a pose (4, 4) and in a reference, a frame before."""
        here, there, known = self._pairs(frame, reference, se3.invert(reference.T_map_reference) @ T_map_camera)
        if np.count_nonzero(known) < _FEWEST:
            return
        (grey, fall), (grey_then, fall_then) = here[:, known], there[:, known]
        # As the sensor had it: both views were evened by what was known of the lens when they were made.
        brighter = np.log(grey / grey_then) + frame.falloff * fall - reference.falloff * fall_then
        information, pull = _told(fall - fall_then, brighter)
        total = 1 / self._variance + information
        self.exponent = float(np.clip((self.exponent / self._variance + pull) / total, 0.0, _MOST))
        self._variance = 1 / total
        self._gridder.even(self.exponent)

    def _pairs(self, frame: GridFrame, reference: Reference, T: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Grey and falloff (2, N) of points in a frame, and in a reference; and which (N,) are of one plain surface."""
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
        known = (z > 0) & is_inside & is_one & is_plain & _is_exposed(grey) & _is_exposed(met[:, GREY])
        fall, fall_then = (falloff_of((camera.normalise(seen) ** 2).sum(axis=-1)) for seen in (px, px_then))
        return np.stack([grey, fall]), np.stack([met[:, GREY], fall_then]), known


def _is_exposed(grey: Float32Array) -> BoolArray:
    return np.asarray((grey > _DARKEST) & (grey < _BRIGHTEST))


def _told(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """The information on the slope of y (N,) over x (N,), whatever its offset, by Huber's weights; and it by the slope.

    Where x is the same everywhere both are 0.
    """
    weight = np.ones(len(x))
    for _ in range(_ROUNDS):
        total = weight.sum()
        dx, dy = x - weight @ x / total, y - weight @ y / total
        spread, common = weight @ dx**2 / total, weight @ (dx * dy) / total
        off = np.abs(dy - common / max(spread, _FLAT) * dx)
        sigma = max(1.4826 * float(np.median(off)), 1e-6)
        weight = _HUBER / np.maximum(off / sigma, _HUBER)
    variance = sigma**2 * _ALIKE / len(x) + _UNEVEN**2
    return float(spread / variance), float(common / variance)
