"""Where colour images show what depth images show, as their edges tell: near shared pixels, or far from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.geometry import ByteArray, Float32Array, FloatArray, IntArray, se3

# How far colour and depth are searched for each other, in pixels of images of about this width.
_SEARCH_WIDTH = 320
_SEARCH_PX = (20, 8)
_SEARCH_SCALES = np.round(np.arange(0.84, 1.161, 0.02), 2)
_WIDEST_SHADOW_PX = 30
_DEPTH_STEP = 0.08
# Farther off, of another lens or mirrored, they are searched for coarsely, in images of about this width, over half to
# twice the size and a seventh of the width, in some of the frames.
_FAR_WIDTH = 160
_FAR_PX = (24, 16)
_FAR_SCALES = np.exp(0.04 * np.arange(-18, 19))
_FAR_FRAMES = 8
_AS_IS = len(_FAR_SCALES) // 2
# A fit stands out where it is so many standard deviations of all shifts, and so much above those at the same size. Real
# recordings and simulated ones have 9 to 24 where they fit, and up to 8 by chance of what repeats.
_FAR_STANDS_OUT, _FAR_FACTOR = 8.5, 1.5
_FLIPS = ((False, False), (True, False), (False, True), (True, True))
_FLIP_WORDS = {(True, False): "mirrored left to right", (False, True): "upside down", (True, True): "turned by 180°"}
# Where images lie by a calibration and where they do, as a share of the width, median over the image.
FAR_FROM_CALIBRATED = 0.02


@dataclass(frozen=True, slots=True)
class RegistrationOffset:
    """Where the colour image shows what the depth image shows, as their edges tell.

    Attributes:
        shift_px: (right, down) that the colour image's things lie from the depth image's in the image's middle.
        scale: how many times as large they are.
        strength: mean contrast of colour edges at depth edges moved by shift and scale (all contrast: 1, by chance: 0).
        strength_as_is: the same where depth edges lie.
        flips: whether colour shows things mirrored left to right, and upside down.
    """

    shift_px: tuple[float, float]
    scale: float
    strength: float
    strength_as_is: float
    flips: tuple[bool, bool] = (False, False)

    @property
    def is_clear(self) -> bool:
        """Whether the images fit clearly better when moved."""
        return self.strength > 1.5 * max(self.strength_as_is, 0.0)

    def __str__(self) -> str:
        """In words, for a user."""
        right, down = self.shift_px
        across = f"{abs(right):.0f} px {'left' if right < 0 else 'right'}"
        along = f"{abs(down):.0f} px {'up' if down < 0 else 'down'}"
        size = f"shows things {self.scale:.2f} times as large"
        if any(self.flips):
            size += f" and {_FLIP_WORDS[self.flips]}"
        return f"in the middle of the image colour lies {across} and {along} of depth, and {size}"


class OffsetMeter:
    """Sums, over frames, how well depth edges fall on colour edges for each scale and shift (cross-correlation)."""

    def __init__(self) -> None:
        self._fit: FloatArray = np.zeros((len(_SEARCH_SCALES), 2 * _SEARCH_PX[1] + 1, 2 * _SEARCH_PX[0] + 1))
        self._edges = 0.0
        self._reduction = 1
        self._far = _FarSearch()

    def add(self, color: ByteArray, depth_m: Float32Array) -> None:
        """Count in one frame; both images (H, W)."""
        height, width = depth_m.shape
        self._reduction = max(1, round(width / _SEARCH_WIDTH))
        size = (width // self._reduction, height // self._reduction)
        right, down = _SEARCH_PX
        contrasts, borders = _color_contrast(color), _depth_borders(depth_m)
        self._far.keep(contrasts, borders)
        if size[0] <= 2 * right or size[1] <= 2 * down:
            return  # smaller than the shifts that are tried
        spectra = [cv2.dft(cv2.resize(contrast, size, interpolation=cv2.INTER_AREA)) for contrast in contrasts]
        for index, scale in enumerate(_SEARCH_SCALES):
            about = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0.0, float(scale))
            product = np.zeros_like(spectra[0])
            for spectrum, border in zip(spectra, borders, strict=True):
                moved = cv2.resize(cv2.warpAffine(border, about, (width, height)), size, interpolation=cv2.INTER_AREA)
                product += _correlation(spectrum, moved)
            fit = cv2.idft(product, flags=cv2.DFT_SCALE)
            self._fit[index] += np.roll(fit, (down, right), (0, 1))[: 2 * down + 1, : 2 * right + 1]
        self._edges += sum(float(border.sum()) for border in borders) / self._reduction**2

    def offset(self) -> RegistrationOffset | None:
        """The best fit, or None where none stands out; first among those far off, which seem near by chance at best."""
        return self._far.offset() or self._near()

    def _near(self) -> RegistrationOffset | None:
        if not self._edges or self._fit.max() < 5 * self._fit.std():
            return None
        scale, down, right = np.unravel_index(self._fit.argmax(), self._fit.shape)
        as_is = self._fit[len(_SEARCH_SCALES) // 2, _SEARCH_PX[1], _SEARCH_PX[0]]
        shift = self._reduction * (np.array([right, down]) - _SEARCH_PX)
        strength, strength_as_is = float(self._fit.max()) / self._edges, float(as_is) / self._edges
        at = (float(shift[0]), float(shift[1]))
        return RegistrationOffset(at, float(_SEARCH_SCALES[scale]), strength, strength_as_is)


class _FarSearch:
    """The same over sizes and shifts that are far apart, and over mirror images, on the edges of a few frames.

    Only what is found far off counts: a size that the near search does not reach, or a mirror image.
    """

    def __init__(self) -> None:
        self._kept: list[list[tuple[Any, IntArray]]] = []
        self._shape = (0, 0)

    def keep(self, contrasts: list[Float32Array], borders: list[Float32Array]) -> None:
        """Keep a frame's colour contrast, made small, and the pixels of its depth edges."""
        height, width = self._shape = (int(borders[0].shape[0]), int(borders[0].shape[1]))
        small = (cv2.resize(c, _far_size(width, height), interpolation=cv2.INTER_AREA) for c in contrasts)
        self._kept.append([(c, np.argwhere(b > 0)[:, ::-1]) for c, b in zip(small, borders, strict=True)])

    def offset(self) -> RegistrationOffset | None:
        """What is found far off, or None."""
        every = -(-len(self._kept) // _FAR_FRAMES) if self._kept else 1
        edges = [(cv2.dft(contrast), px) for kept in self._kept[::every] for contrast, px in kept]
        if not any(len(px) for _, px in edges):
            return None
        fits = {
            (flips, scale): self._fit(edges, flips, float(_FAR_SCALES[scale]))
            for flips in _FLIPS
            for scale in range(len(_FAR_SCALES))
        }
        (flips, scale), best = max(fits.items(), key=lambda item: item[1].deviations)
        as_is = fits[_FLIPS[0], _AS_IS]
        reach = float(_SEARCH_SCALES[-1])
        is_far = any(flips) or not 1 / reach < _FAR_SCALES[scale] < reach
        if not is_far or best.deviations < max(_FAR_STANDS_OUT, _FAR_FACTOR * as_is.deviations):
            return None
        return replace(best.offset, flips=flips, strength_as_is=as_is.offset.strength_as_is)

    def _fit(self, edges: list[tuple[Any, IntArray]], flips: tuple[bool, bool], scale: float) -> _FarFit:
        """How well edges that are flipped and scaled about the middle fall on contrast, best over all shifts."""
        (height, width), (right, down) = self._shape, _FAR_PX
        columns, rows = _far_size(width, height)
        middle, step = np.array([(width - 1) / 2, (height - 1) / 2]), np.array([width / columns, height / rows])
        signs, count = np.where(flips, -scale, scale), 0
        # The transform is linear: it is inverted once, of the sum.
        product = np.zeros_like(edges[0][0])
        for spectrum, px in edges:
            x, y = np.floor((signs * (px - middle) + middle + 0.5) / step).astype(np.int64).T
            inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
            count += int(np.count_nonzero(inside))
            moved = np.bincount(y[inside] * columns + x[inside], minlength=rows * columns).reshape(rows, columns)
            product += _correlation(spectrum, moved.astype(np.float32))
        fit = cv2.idft(product, flags=cv2.DFT_SCALE)
        near = np.roll(fit, (down, right), (0, 1))[: 2 * down + 1, : 2 * right + 1]
        y_best, x_best = np.unravel_index(near.argmax(), near.shape)
        shift_px = step * (np.array([x_best, y_best]) - _FAR_PX)
        strength, as_is = float(near.max()) / max(count, 1), float(fit[0, 0]) / max(count, 1)
        offset = RegistrationOffset((float(shift_px[0]), float(shift_px[1])), round(scale, 2), strength, as_is)
        return _FarFit(float(near.max() / max(fit.std(), 1e-12)), offset)


@dataclass(frozen=True, slots=True)
class _FarFit:
    """The best shift of one size and flip; `deviations` of all shifts, standard ones, by which it stands out."""

    deviations: float
    offset: RegistrationOffset


def _correlation(spectrum: Any, moved: Any) -> Any:
    """The spectrum of how well an image falls on one of that spectrum, over all shifts; as OpenCV packs it."""
    return cv2.mulSpectrums(spectrum, cv2.dft(moved), 0, conjB=True)


def _far_size(width: int, height: int) -> tuple[int, int]:
    reduction = max(1, round(width / _FAR_WIDTH))
    return width // reduction, height // reduction


def off_calibrated(offset: RegistrationOffset, calibration: Calibration, depth_m: float) -> float:
    """How far colour lies from where a calibration with T_color_depth has it, as a share of the width.

    The median over the image of what is `depth_m` away; NaN where little of it is in both images.
    """
    color, depth = calibration.cameras
    assert calibration.T_color_depth is not None
    size = np.array([depth.width, depth.height], float)
    px = (np.stack(np.meshgrid(np.linspace(0.1, 0.9, 9), np.linspace(0.1, 0.9, 7)), axis=-1).reshape(-1, 2)) * size
    expected, is_seen = color.project(
        se3.apply(calibration.T_color_depth, depth.back_project(px, np.full(len(px), depth_m)))
    )
    signs, shift = np.where(offset.flips, -offset.scale, offset.scale), np.array(offset.shift_px)
    if not offset.is_clear:
        signs, shift = np.ones(2), np.zeros(2)
    seen = signs * (px - size / 2) + size / 2 + shift
    off_px = np.linalg.norm(seen - expected, axis=1)[is_seen]
    return float(np.median(off_px) / depth.width) if len(off_px) >= len(px) / 4 else float("nan")


def _color_contrast(color: ByteArray) -> list[Float32Array]:
    """Brightness steps along x and along y (H, W): 1 on average, then less their neighbourhood's mean."""
    grey = cv2.GaussianBlur(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1.5)
    images = []
    for along_x in (1, 0):
        step = np.abs(cv2.Sobel(grey, cv2.CV_32F, along_x, 1 - along_x))
        step = np.minimum(step, np.percentile(step, 95))
        step /= max(float(step.mean()), 1e-6)
        images.append(step - cv2.blur(step, (81, 81)))
    return images


def _depth_borders(depth_m: Float32Array) -> list[Float32Array]:
    """1 at the near side of depth steps along x and along y (H, W), else 0; the shadow beside it is crossed."""
    return [_borders_along_rows(depth_m), np.ascontiguousarray(_borders_along_rows(depth_m.T).T)]


def _borders_along_rows(depth_m: Float32Array) -> Float32Array:
    columns = np.arange(depth_m.shape[1])
    newest = np.maximum.accumulate(np.where(depth_m > 0, columns, -1), axis=1)
    before = np.pad(newest, ((0, 0), (1, 0)), constant_values=-1)[:, :-1]
    rows, here = np.nonzero((depth_m > 0) & (before >= 0) & (columns - before <= _WIDEST_SHADOW_PX))
    there = before[rows, here]
    step = np.log(depth_m[rows, here] / depth_m[rows, there])
    borders = np.zeros(depth_m.shape, np.float32)
    for is_step, column in ((step > _DEPTH_STEP, there), (step < -_DEPTH_STEP, here)):
        borders[rows[is_step], column[is_step]] = 1
    return borders
