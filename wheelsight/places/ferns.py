"""Ferns: a code of a view by random comparisons on a tiny image of grey and depth (Glocker et al. 2015)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from wheelsight.geometry import Float32Array, FloatArray, IntArray
from wheelsight.geometry.arrays import UInt64Array
from wheelsight.settings import FernSettings

_SHIFTS = np.arange(0, 64, 4, dtype=np.uint64)
# Of an image far larger than the tiny one, pixels so many times as fine are enough for its means.
_FINER = 2
_BITS = np.array([1, 2, 4, 8], np.uint64)


@dataclass(frozen=True, slots=True, eq=False)
class Ferns:
    """F ferns: each asks, at one pixel of the tiny image, twice how bright and twice how far it is.

    The paper takes red, green, blue and depth at fixed thresholds. Grey is all that a keyframe keeps, and it is
    compared with the mean and the spread of its own image, for light and exposure change from day to day.

    Attributes:
        size_px: width and height of the tiny image.
        blur_px: standard deviation of the blur over it.
        pixel: (F,) index into the tiny image.
        grey: (F, 2) thresholds, in standard deviations of the image's grey off its mean.
        depth_m: (F, 2) thresholds, metres.
    """

    size_px: tuple[int, int]
    blur_px: float
    pixel: IntArray
    grey: FloatArray
    depth_m: FloatArray

    @classmethod
    def drawn(cls, settings: FernSettings, seed: int) -> Ferns:
        """At random, by a seed."""
        rng = np.random.default_rng(seed)
        size, count = (settings.width_px, settings.height_px), settings.ferns
        pixel = rng.integers(0, size[0] * size[1], count)
        grey = rng.uniform(-settings.grey_sigmas, settings.grey_sigmas, (count, 2))
        depth_m = np.exp(rng.uniform(np.log(settings.nearest_m), np.log(settings.farthest_m), (count, 2)))
        return cls(size, settings.blur_px, pixel, grey, depth_m)

    def code(self, depth_m: Float32Array, grey: Float32Array) -> UInt64Array:
        """(F / 16,) of depth (h, w) in metres and grey (h, w), 0 and below where unknown; unknown answers no."""
        near, bright = self._tiny(depth_m).ravel(), self._tiny(grey).ravel()
        known = bright > 0
        if known.any():
            spread = max(float(bright[known].std()), 1.0)
            bright = np.where(known, (bright - bright[known].mean()) / spread, -np.inf)
        else:
            bright = np.full_like(bright, -np.inf)
        is_brighter = bright[self.pixel, None] > self.grey
        is_farther = near[self.pixel, None] > self.depth_m
        four = np.concatenate([is_brighter, is_farther], axis=1) @ _BITS
        shifted = four.reshape(-1, len(_SHIFTS)).astype(np.uint64) << _SHIFTS
        return np.asarray(np.bitwise_or.reduce(shifted, axis=1), np.uint64)

    def _tiny(self, image: Float32Array) -> Float32Array:
        """Means (h, w) of what is known of an image; 0 where nothing is."""
        stride = max(1, image.shape[1] // (_FINER * self.size_px[0]))
        some = image[::stride, ::stride]
        is_known = some > 0
        both = np.dstack([np.where(is_known, some, np.float32(0)), is_known.astype(np.float32)])
        both = cv2.resize(both, self.size_px, interpolation=cv2.INTER_AREA)
        total, share = cv2.split(cv2.GaussianBlur(both, (0, 0), self.blur_px))
        return np.where(share > 0.2, total / np.maximum(share, 0.2), np.float32(0))
