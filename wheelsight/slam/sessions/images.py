"""Images as they are kept on disk: in steps that the sensor's own noise hides, which makes them half as large."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wheelsight.calibration import DepthNoise
from wheelsight.errors import MapError
from wheelsight.geometry import Float32Array
from wheelsight.inputs import picture_size
from wheelsight.keyframes import Keyframe
from wheelsight.odometry.dense.grid import Level, coarser
from wheelsight.odometry.dense.settings import DenseSettings
from wheelsight.places.views import known_grey
from wheelsight.threads import Rows

_DAMAGED = "use another copy of the map"
# Finer than these a keyframe itself does not hold depth; and without curvature the steps below have no closed form.
_FINEST_M, _LEAST_QUADRATIC = 0.0004, 1e-9
_BRIGHTEST = 255
_HALVED, _ROWS = DenseSettings(levels=1), Rows(1)
_MOST_PIXELS = 4096 * 4096
# Smaller by 11 to 22 % than by run lengths alone, for 7 to 11 ms more a keyframe (docs/decisions/0093).
_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 6, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_FILTERED)


@dataclass(frozen=True, slots=True)
class DepthSteps:
    """Steps of depth that grow with its noise: from one to the next it is a share of σ(z) = constant + quadratic · z².

    Attributes:
        step_m: the step at depth 0, metres.
        growth: by which it grows with the square of depth, 1/m.
    """

    step_m: float
    growth: float

    @classmethod
    def of_noise(cls, noise: DepthNoise, sigmas: float) -> DepthSteps:
        """Steps of so many standard deviations."""
        step_m, growth = sigmas * noise.constant_m, sigmas * noise.quadratic_per_m
        return cls(max(step_m, _FINEST_M), max(growth, _LEAST_QUADRATIC))

    def numbers(self, depth_m: Float32Array) -> NDArray[np.uint16]:
        """Which step (h, w) each depth is nearest to, from 1 on; 0 where depth is unknown.

        The integral of dz / (a + b z²) is arctan(z √(b / a)) / √(a b).
        """
        a, b = self.step_m, self.growth
        numbers = np.rint(np.arctan(depth_m * np.sqrt(b / a)) / np.sqrt(a * b))
        return np.asarray(np.where(depth_m > 0, np.maximum(numbers, 1), 0), np.uint16)

    def depth_m(self, numbers: NDArray[np.uint16]) -> Float32Array:
        """(h, w) metres of such steps."""
        a, b = self.step_m, self.growth
        # A damaged number may be beyond what any depth has.
        angle = np.minimum(numbers * np.sqrt(a * b), np.pi / 2 - 1e-6)
        return np.asarray(np.tan(angle) * np.sqrt(a / b), np.float32)


def grey_numbers(grey: Float32Array, step: int) -> NDArray[np.uint8]:
    """Which step (h, w) each grey from 0 to 255 is nearest to, from 1 on; 0 where it is 0 or less: unknown."""
    return np.asarray(np.where(grey > 0, np.maximum(np.rint(grey / step), 1), 0), np.uint8)


def grey_of(numbers: NDArray[np.uint8], step: int) -> Float32Array:
    """(h, w) grey of such steps."""
    return np.asarray(np.minimum(numbers.astype(np.float32) * step, _BRIGHTEST), np.float32)


def halved(keyframe: Keyframe, width_px: int) -> Level:
    """Its images, halved as often as it takes until they are no wider."""
    level = Level(keyframe.intrinsics, keyframe.depth_m, known_grey(keyframe))
    while level.depth_m.shape[1] > width_px:
        level = coarser(level, _HALVED, _ROWS)[1]
    return level


def packed(numbers: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """An image of numbers, compressed."""
    written, code = cv2.imencode(".png", numbers, _PNG)
    assert written
    return code.tobytes()


def unpacked(code: bytes, dtype: type) -> NDArray[Any]:
    """The image of numbers (h, w). Raises MapError for what is none."""
    width, height = picture_size(code) or (0, 0)
    if not 0 < width * height <= _MOST_PIXELS:
        raise MapError("an image of it cannot be read", fix=_DAMAGED)
    image = cv2.imdecode(np.frombuffer(code, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2 or image.dtype != dtype:
        raise MapError("an image of it cannot be read", fix=_DAMAGED)
    return np.asarray(image)
