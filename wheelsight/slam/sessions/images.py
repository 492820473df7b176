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
from wheelsight.inputs import picture_within
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
# As `SessionSettings.width_px` allows.
LARGEST_PX = 4096, 4096
# Beyond 100 WebP is lossless: smaller by 22 to 27 % than PNG (docs/decisions/0102).
_LOSSLESS = (cv2.IMWRITE_WEBP_QUALITY, 101)
Size = tuple[int, int]
"""Width and height of an image, pixels."""


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


def packed_depth(numbers: NDArray[np.uint16]) -> bytes:
    """Numbers (h, w) of depth, 0 where it is unknown, compressed.

    In three planes of bytes are 0 where depth is unknown, and else from 1 on what it differs by from the known one
    before it, row by row: 0, -1, 1, -2, … are 1, 2, 3, 4, ….
    """
    is_known = numbers > 0
    step: NDArray[np.int32] = np.diff(numbers[is_known].astype(np.int32), prepend=0).astype(np.int32)
    told = np.zeros(numbers.shape, np.int32)
    told[is_known] = (step << 1 ^ step >> 31) + 1
    return _webp(np.dstack([told >> 16, told & 255, told >> 8 & 255]).astype(np.uint8))


def unpacked_depth(code: bytes, most_px: Size = LARGEST_PX) -> NDArray[np.uint16]:
    """What `packed_depth` made bytes of. Raises MapError for what is none, or wider or higher than `most_px`."""
    planes = _decoded(code, most_px, 3, np.uint8)
    told = planes[..., 0].astype(np.int32)
    for plane in (2, 1):  # in place: of a large image each copy is 67 MB
        told <<= 8
        told |= planes[..., plane]
    is_known = told > 0
    steps = told[is_known] - 1
    depth = np.cumsum(steps >> 1 ^ -(steps & 1), dtype=np.int64)
    if len(depth) and not 0 < depth.min() <= depth.max() <= np.iinfo(np.uint16).max:
        raise MapError("its depth is none", fix=_DAMAGED)
    numbers = np.zeros(told.shape, np.uint16)
    numbers[is_known] = depth
    return numbers


def packed_grey(numbers: NDArray[np.uint8]) -> bytes:
    """Numbers (h, w) of grey, compressed."""
    return _webp(numbers)


def unpacked_grey(code: bytes, most_px: Size = LARGEST_PX) -> NDArray[np.uint8]:
    """What `packed_grey` made bytes of. Raises as `unpacked_depth`."""
    return np.ascontiguousarray(_decoded(code, most_px, 3, np.uint8)[..., 0])


def unpacked_png(code: bytes, dtype: type, most_px: Size = LARGEST_PX) -> NDArray[Any]:
    """The image of numbers (h, w) of a PNG. Raises as `unpacked_depth`."""
    return _decoded(code, most_px, 2, dtype)


def _webp(image: NDArray[np.uint8]) -> bytes:
    written, code = cv2.imencode(".webp", image, _LOSSLESS)
    assert written
    return code.tobytes()


def _decoded(code: bytes, most_px: Size, dimensions: int, dtype: type) -> NDArray[Any]:
    """An image whose header states at most such a width and height. Raises MapError."""
    image = picture_within(code, (min(most_px[0], LARGEST_PX[0]), min(most_px[1], LARGEST_PX[1])))
    if image is None or image.ndim != dimensions or image.dtype != dtype:
        raise MapError("an image of it cannot be read, or is larger than its camera's", fix=_DAMAGED)
    return image
