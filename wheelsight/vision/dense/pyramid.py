"""`Gridder` resamples frames onto the pixel grid of an ideal camera, as image pyramids. `ReferenceMaker` makes the
references that frames are aligned with. `Vignetting` estimates the vignetting of the lens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray, IntArray, PinholeCamera, se3
from wheelsight.core.keyframes import PredictedView
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.threads import Rows
from wheelsight.vision.dense.alignment_kernels import ALONG_U, ALONG_V, CHANNELS, DEPTH, GREY
from wheelsight.vision.dense.pyramid_kernels import (
    Exposure,
    halve_depth,
    halve_grey,
    normals,
    pack,
    sample_color,
    sample_grey,
    straighten,
    straighten_color,
)
from wheelsight.vision.dense.settings import DenseSettings

_NO_IMAGE = np.empty((0, 0), np.float32)
_BRIGHTEST = np.float32(255)
# An image is dark, and its grey is noise, if fewer than this share of its pixels, sampled with this stride, exceed this
# grey (real Kinects with covered lenses).
_DARK_SHARE, _DARK_STRIDE, _DARK_GREY = 0.01, 8, 12.0

# Number of pyramid levels for alignment, each half as wide as the one before, and the second of them; chosen.
LEVELS, SECOND = 3, 1
# Share of depth that separates two surfaces; chosen.
DEPTH_JUMP = 0.03
# Neighbours on one surface differ by at most this many standard deviations of depth more: √2 times three. A limit that
# noise reaches selects neighbours with similar errors (docs/decisions/dense-alignment.md).
_DEPTH_JUMP_SIGMAS = 4.2
# Largest deviation of a surface from its plane, in standard deviations of depth, to show a motion: a plane fitted to a
# crease is not in the scene. Chosen.
_CREASE_SIGMAS = 2.0
# A nearer surface within two pixels, by this share of depth and these standard deviations, makes an occlusion boundary:
# its grey moves with the nearer surface. Without it distances on a corridor were 0.09 % too long, with it 0.01 %
# (simulator: docs/decisions/dense-alignment.md).
_OCCLUSION_SHARE, _OCCLUSION_SIGMAS = 0.02, 3.0
_NORMAL_RADIUS_PX = 2  # half width of the window that a normal is fitted to


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One scale of a frame.

    Attributes:
        intrinsics: fx, fy, cx, cy of the ideal camera at this scale.
        depth_m: (h, w) float32, 0 where unknown.
        grey: (h, w) float32 from 0 to 255, -1 where unknown.
    """

    intrinsics: FloatArray
    depth_m: Float32Array
    grey: Float32Array

    def points(self) -> tuple[FloatArray, IntArray, IntArray]:
        """(N, 3) in the camera frame of all that has depth, and the rows and columns (N,) of its pixels."""
        fx, fy, cx, cy = self.intrinsics
        rows, columns = np.nonzero(self.depth_m)
        z = self.depth_m[rows, columns].astype(float)
        return np.column_stack([z * (columns - cx) / fx, z * (rows - cy) / fy, z]), rows, columns


@dataclass(frozen=True, slots=True, eq=False)
class GridFrame:
    """An image pyramid of a frame on the grid of an ideal camera, without rolling shutter.

    Attributes:
        stamp_s: time of the frame, seconds.
        levels: the pyramid from the finest to the coarsest level; the last serves rotation search only.
        twist: (6,) the velocity (v, ω) in the camera's frame, per second, of the rolling-shutter correction.
        vignetting: the exponent of the vignetting correction; see `Gridder.even`.
    """

    stamp_s: float
    levels: tuple[Level, ...]
    twist: FloatArray
    vignetting: float = 0.0

    @property
    def depth_share(self) -> float:
        """The share of the finest level's pixels that have depth."""
        depth_m = self.levels[0].depth_m
        return float(np.count_nonzero(depth_m) / depth_m.size)


class Gridder:
    """Resamples frames of one camera onto the grid of an ideal camera.

    It removes lens distortion, rolling shutter, vignetting and the offset between colour and depth camera.
    """

    def __init__(self, calibration: Calibration, settings: DenseSettings, rows: Rows) -> None:
        self._color, self._depth = calibration.cameras
        self._calibration, self._rows, self._is_registered = calibration, rows, calibration.is_registered
        self._is_straight = not self._depth.has_distortion and not calibration.rolling_shutter_s
        self.halvings = 0
        while self._depth.width >> self.halvings > settings.finest_width_px:
            self.halvings += 1
        self.intrinsics = self._halved(self._depth)
        self.shape = (self._depth.height >> self.halvings, self._depth.width >> self.halvings)
        # (h, w, 2): the pixel of the halved depth image at each pixel of the ideal grid.
        ideal = PinholeCamera(self.shape[1], self.shape[0], *self.intrinsics.tolist())
        lens = replace(ideal, distortion=self._depth.distortion)
        self._source_px = lens.denormalise(ideal.rays()[..., :2]).astype(np.float32)
        height = self.shape[0]
        late_share = (np.arange(height) + 0.5) / height - 0.5
        self.late_s: FloatArray = late_share * calibration.rolling_shutter_s
        self.depth_late_s = calibration.depth_late_s
        color_width, color_height = self._color.width >> self.halvings, self._color.height >> self.halvings
        fx, fy, cx, cy = self._halved(self._color)
        small = replace(self._color, width=color_width, height=color_height, fx=fx, fy=fy, cx=cx, cy=cy)
        self._darker = vignetting_of((small.rays()[..., :2] ** 2).sum(axis=-1)).astype(np.float32)
        self.even(0.0)

    def even(self, exponent: float) -> None:
        """Correct the vignetting of later frames: (cos⁴ of the angle to the axis) to the power of `exponent`."""
        self._vignetting = exponent
        self._brighter: Float32Array = np.exp(-exponent * self._darker)

    def on_grid(self, frame: RgbdFrame, twist: FloatArray) -> GridFrame:
        """The frame's pyramid, with the rolling shutter corrected for a camera that moves at `twist` (6,).

        All grey of a dark image is unknown, because it is noise.
        """
        depth_m = self._small_depth(frame)
        bright = self._small(np.asarray(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), np.uint8))
        grey: Float32Array = np.minimum(bright * self._brighter, _BRIGHTEST)
        if self._is_dark(frame.color):
            grey = np.full_like(grey, -1)
        behind_s = frame.depth_late_s + self.depth_late_s
        if not (self._is_straight and behind_s == 0):
            out = np.empty((1 + self._is_registered, *self.shape), np.float32)
            images = (depth_m, grey if self._is_registered else _NO_IMAGE)
            exposure = self._exposure(twist, behind_s if twist.any() else 0.0)
            given = (*images, self._source_px, exposure, np.float32(DEPTH_JUMP))
            self._rows.share(self.shape[0], lambda begin, end: straighten(*given, (begin, end), out))
            depth_m, grey = out[0], out[1] if self._is_registered else grey
        if not self._is_registered:
            grey = self._sampled(grey, depth_m, twist)
        return GridFrame(frame.stamp_s, self.pyramid(depth_m, grey), twist, self._vignetting)

    def pyramid(self, depth_m: Float32Array, grey: Float32Array) -> tuple[Level, ...]:
        """The pyramid of images (h, w) that are on the ideal grid already."""
        return coarser(Level(self.intrinsics, depth_m, grey), self._rows)

    def color_on_grid(self, frame: RgbdFrame, grid: GridFrame) -> Float32Array:
        """Red, green and blue (h, w, 3) from 0 to 255 on the grid of `grid`, which was made from `frame`.

        Colour is known where grey is, and -1 elsewhere.
        """
        if self._is_dark(frame.color):
            return np.full((*self.shape, 3), -1, np.float32)
        image = self._small(frame.color)
        if not self._is_registered:
            return self._sampled(image, grid.levels[0].depth_m, grid.twist)
        if self._is_straight:
            return image.astype(np.float32)
        has_moved = self._calibration.rolling_shutter_s and grid.twist.any()
        depth_m = self._small_depth(frame) if has_moved else _NO_IMAGE
        given = (image, depth_m, self._source_px, self._exposure(grid.twist))
        out = np.empty((*self.shape, 3), np.float32)
        self._rows.share(len(out), lambda begin, end: straighten_color(*given, (begin, end), out))
        return out

    def _halved(self, camera: PinholeCamera) -> FloatArray:
        """fx, fy, cx, cy (4,) of the camera's halved images."""
        return _scaled(np.array([camera.fx, camera.fy, camera.cx, camera.cy]), self.halvings)

    def _small_depth(self, frame: RgbdFrame) -> Float32Array:
        """Depth (h, w) as measured, halved."""
        depth_m = frame.depth_m
        for _ in range(self.halvings):
            depth_m = halved_depth(depth_m, DEPTH_JUMP, self._rows)
        return depth_m

    def _small(self, image: ByteArray) -> ByteArray:
        size = (image.shape[1] >> self.halvings, image.shape[0] >> self.halvings)
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8) if self.halvings else image

    def _sampled(self, image: Float32Array | ByteArray, depth_m: Float32Array, twist: FloatArray) -> Float32Array:
        """The image of a separate colour camera, grey (H, W) or colour (H, W, 3), at the 3D point of each pixel."""
        color = self._color
        lens = (*self._halved(color), *color.distortion)
        T_color_camera = _numbers(np.asarray(self._calibration.T_color_depth)[:3])
        given = (image, depth_m, self._exposure(twist), T_color_camera, _numbers(lens))
        out = np.empty((*self.shape, *image.shape[2:]), np.float32)
        sample = sample_grey if image.ndim == 2 else sample_color
        self._rows.share(len(out), lambda begin, end: sample(*given, (begin, end), out))
        return out

    def _exposure(self, twist: FloatArray, depth_late_s: float = 0.0) -> Exposure:
        shutter_s = np.float32(self._calibration.rolling_shutter_s if twist.any() else 0.0)
        return Exposure(_numbers(self.intrinsics), _numbers(twist), shutter_s, np.float32(depth_late_s))

    def _is_dark(self, color: ByteArray) -> bool:
        """Whether a subsample of a colour image (H, W, 3) shows nothing but noise."""
        some = cv2.cvtColor(np.ascontiguousarray(color[::_DARK_STRIDE, ::_DARK_STRIDE]), cv2.COLOR_RGB2GRAY)
        return bool(np.count_nonzero(some > _DARK_GREY) < _DARK_SHARE * some.size)


def coarser(finest: Level, rows: Rows, count: int = LEVELS) -> tuple[Level, ...]:
    """`count` pyramid levels that begin with `finest`, and one coarser level for rotation search."""
    levels = [finest]
    for number in range(count):
        last = levels[-1]
        # The same slope is twice the step from pixel to pixel.
        depth_m = halved_depth(last.depth_m, DEPTH_JUMP * (1 << number), rows)
        grey = np.empty((last.grey.shape[0] // 2, last.grey.shape[1] // 2), np.float32)
        rows.share(len(grey), halve_grey, last.grey, after=(grey,))
        levels.append(Level(_scaled(last.intrinsics, 1), depth_m, grey))
    return tuple(levels)


def halved_depth(depth_m: Float32Array, jump: float, rows: Rows) -> Float32Array:
    """Depth (h, w) at half the size: the mean of the nearest surface in each 2×2 block, never across an edge.

    Args:
        depth_m: (H, W), 0 where unknown; an odd last row or column is ignored.
        jump: the largest difference within one surface, as a share of the nearest depth.
        rows: the threads that share the work.
    """
    half = np.empty((depth_m.shape[0] // 2, depth_m.shape[1] // 2), np.float32)
    rows.share(len(half), halve_depth, depth_m, jump, after=(half,))
    return half


def vignetting_of(squared_tangent: FloatArray) -> FloatArray:
    """Log cos⁴ of the angle to the optical axis, from its squared tangent."""
    return np.asarray(-2 * np.log1p(squared_tangent))


def _scaled(intrinsics: FloatArray, halvings: int) -> FloatArray:
    """fx, fy, cx, cy after `halvings` halvings, with pixel centres at integers."""
    factor = 2.0**halvings
    fx, fy, cx, cy = intrinsics
    return np.array([fx / factor, fy / factor, (cx + 0.5) / factor - 0.5, (cy + 0.5) / factor - 0.5])


def _numbers(values: ArrayLike) -> tuple[np.float32, ...]:
    """A flat tuple of float32, the form that kernels read fastest."""
    return tuple(np.asarray(values, np.float32).ravel())


# No limit on the deviation of a surface from its plane.
_ANY_BEND = 1e6
# The frame's share of a residual's variance: half against another frame, which is as noisy, and all against a map.
_AS_NOISY, _MAPPED = 0.5, 1.0


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceLevel:
    """One scale of a reference.

    Attributes:
        normal: (h, w, 3) float32 in the camera frame, towards the camera; 0 where unknown.
        pixels: (h, w, 8) float32: the plane n·q = d through each pixel's point q as n and d, depth, grey, and grey's
            gradient along u and v per pixel; NaN where unknown. They are interleaved because a look-up needs all.
    """

    normal: Float32Array
    pixels: Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class FrameStructure:
    """The planes and grey gradients that decide which directions of motion a view constrains.

    Both come from coarse levels, where noise is averaged out.

    Attributes:
        planes: planes of the coarsest level for alignment.
        slopes: grey gradients of the second level.
    """

    planes: ReferenceLevel
    slopes: ReferenceLevel


@dataclass(frozen=True, slots=True, eq=False)
class Scales:
    """A reference at all scales.

    Attributes:
        levels: from the finest to the coarsest, as a `GridFrame` has them.
        steep: the coarsest level for alignment again, with normals of steep surfaces but none at creases. It decides
            which directions a view constrains, so it holds every plane and only planes.
    """

    levels: tuple[ReferenceLevel, ...]
    steep: ReferenceLevel


class Reference:
    """A view that frames are aligned with, and its pose: an earlier frame, or the prediction of a map.

    Its scales are computed on first use and can be dropped: the frame that they derive from has a sixth of their size.

    Attributes:
        T_map_reference: (4, 4).
        known_scales: the scales in memory; set None to free it. Computed again, they are identical to the bit.
        own_noise: the share of a residual's variance that is the noise of the frame aligned with it.
        vignetting: the exponent of the vignetting correction of its grey.
    """

    __slots__ = ("T_map_reference", "_make", "known_scales", "own_noise", "vignetting")

    def __init__(
        self, T_map_reference: FloatArray, make: Callable[[], Scales], own_noise: float, vignetting: float = 0.0
    ) -> None:
        self.T_map_reference, self.own_noise, self.vignetting = T_map_reference, own_noise, vignetting
        self._make = make
        self.known_scales: Scales | None = None

    @property
    def scales(self) -> Scales:
        """The reference at all scales, computed if it is not in memory."""
        if self.known_scales is None:
            self.known_scales = self._make()
        return self.known_scales


class ReferenceMaker:
    """Makes references of frames and of predicted views."""

    def __init__(self, noise: DepthNoise, rows: Rows) -> None:
        self._noise = np.array([noise.constant_m, noise.quadratic_per_m], np.float32)
        self._rows, self._boundary = rows, self._step(_OCCLUSION_SHARE, _OCCLUSION_SIGMAS)

    def of_frame(self, frame: GridFrame, T_map_camera: FloatArray) -> Reference:
        """A frame with its pose as reference."""

        def make() -> Scales:
            levels = []
            for level in frame.levels:
                levels.append(self._level(level, self.normals(level)))
            return Scales(tuple(levels), self._steep(frame.levels))

        return Reference(T_map_camera, make, _AS_NOISY, frame.vignetting)

    def of_view(self, view: PredictedView, T_map_camera: FloatArray, intrinsics: FloatArray) -> Reference:
        """A predicted view as reference, with the pose (4, 4) of its prediction."""
        finest = Level(intrinsics, view.depth_m, view.grey)
        levels = coarser(finest, self._rows)
        fitted = (self._level(level, self.normals(level)) for level in levels[1:])
        pyramid = (self._level(finest, view.normal), *fitted)
        scales = Scales(pyramid, self._steep(levels))
        return Reference(T_map_camera, lambda: scales, _MAPPED)

    def shown_by(self, frame: GridFrame) -> FrameStructure:
        """The planes and grey gradients of a frame itself."""
        no_planes = np.zeros((*frame.levels[SECOND].depth_m.shape, 3), np.float32)
        return FrameStructure(self._steep(frame.levels), self._level(frame.levels[SECOND], no_planes))

    def normals(self, level: Level, steepness: int = 1, bend: float = _ANY_BEND) -> Float32Array:
        """Unit normals (h, w, 3) float32 of a level's surfaces, towards the camera; 0 where unknown.

        Neighbours on one surface differ by at most `DEPTH_JUMP` times `steepness`, and by noise. `bend` is the largest
        deviation of a surface from its plane, in standard deviations of depth.
        """
        normal = np.empty((*level.depth_m.shape, 3), np.float32)
        limits = (
            self._step(steepness * DEPTH_JUMP, _DEPTH_JUMP_SIGMAS),
            np.float32(bend) * self._noise,
        )
        given = (level.depth_m, level.intrinsics.astype(np.float32), _NORMAL_RADIUS_PX, *limits)
        self._rows.share(len(normal), normals, *given, after=(normal,))
        return normal

    def _steep(self, levels: tuple[Level, ...]) -> ReferenceLevel:
        # The same slope is a larger step from pixel to pixel where pixels are larger.
        coarsest = levels[LEVELS - 1]
        return self._level(coarsest, self.normals(coarsest, 1 << (LEVELS - 1), _CREASE_SIGMAS))

    def _level(self, level: Level, normal: Float32Array) -> ReferenceLevel:
        pixels = np.empty((*level.depth_m.shape, CHANNELS), np.float32)
        given = (level.depth_m, normal, level.grey, level.intrinsics.astype(np.float32), self._boundary)
        self._rows.share(len(pixels), pack, *given, after=(pixels,))
        return ReferenceLevel(normal, pixels)

    def _step(self, share: float, sigmas: float) -> Float32Array:
        """Coefficients (3,) of a depth step for kernels: a share of depth, and `sigmas` standard deviations of it."""
        constant, quadratic = np.float32(sigmas) * self._noise
        return np.array([constant, share, quadratic], np.float32)


# Stride, in pixels, of the points compared for vignetting.
_STRIDE_PX = 2
# Iteratively reweighted least squares: Huber's limit in standard deviations, and the number of iterations.
_HUBER, _ROUNDS = 1.5, 3
# Least variance of vignetting over the compared points, so that the slope stays finite.
_FLAT = 1e-9
# Standard deviation of the exponent before the first pair of views: it is 0.22 for the simulated camera, 0.10 and 0.06
# for two real ones (docs/decisions/dense-alignment.md). No lens exceeds cos⁴.
_EXPONENT_SIGMA, _MOST_EXPONENT = 0.3, 1.0
# Standard deviation of a point's log grey between views, number of neighbouring pixels with the same error, and fewest
# pixels for an update; chosen.
_UNEVEN, _ALIKE_PIXELS, _MIN_PIXELS = 0.01, 20.0, 300
_DARKEST_GREY, _BRIGHTEST_GREY = 20.0, 235.0  # beyond, grey is noise or saturated
# Points of one surface are nearer than this, in metres and per metre of depth, and plain below this grey gradient;
# chosen.
_SAME_SURFACE, _PLAIN_GRADIENT = 0.06, 3.0


class Vignetting:
    """Estimates the vignetting of one camera from plain surfaces at two image positions, and corrects later frames.

    A wall seen ahead, and later at the image border, looks darker there, and the keyframe then seems tilted. Lenses
    darken about as cos⁴ of the angle to the axis; gamma reduces its exponent in grey values. The estimate is this
    exponent, updated by pairs of views.

    Args:
        gridder: makes the frames.

    Attributes:
        exponent: of cos⁴, in grey values; 0 for an even image.
    """

    def __init__(self, gridder: Gridder) -> None:
        self._gridder, self.exponent, self._variance = gridder, 0.0, _EXPONENT_SIGMA**2

    def learn(self, frame: GridFrame, T_map_camera: FloatArray, reference: Reference) -> None:
        """Update the estimate by plain surfaces that a frame at a pose (4, 4) and an earlier reference both show."""
        here, there, known = self._pairs(frame, reference, se3.invert(reference.T_map_reference) @ T_map_camera)
        if np.count_nonzero(known) < _MIN_PIXELS:
            return
        (grey, dark), (grey_then, dark_then) = here[:, known], there[:, known]
        # Undo the correction of each view, which used the estimate at its time.
        brighter = np.log(grey / grey_then) + frame.vignetting * dark - reference.vignetting * dark_then
        information, pull = self._slope(dark - dark_then, brighter)
        total = 1 / self._variance + information
        self.exponent = float(np.clip((self.exponent / self._variance + pull) / total, 0.0, _MOST_EXPONENT))
        self._variance = 1 / total
        self._gridder.even(self.exponent)

    def _pairs(self, frame: GridFrame, reference: Reference, T: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Grey and vignetting (2, N) of points in frame and in reference, and a mask (N,) of plain surfaces."""
        level, pixels = frame.levels[SECOND], reference.scales.levels[SECOND].pixels
        (h, w), some = level.depth_m.shape, (slice(None, None, _STRIDE_PX),) * 2
        camera = PinholeCamera(w, h, *level.intrinsics.tolist())
        px = np.stack([index[some].ravel() for index in np.mgrid[:h, :w][::-1]], axis=-1)
        z, grey = level.depth_m[some].ravel(), level.grey[some].ravel()
        p_then = se3.apply(T, camera.back_project(px, z))
        px_then, is_inside = camera.project(p_then)
        column, row = np.where(is_inside[:, None], np.rint(px_then), 0).astype(int).T
        met = pixels[row, column]
        is_one = np.abs(met[:, DEPTH] - p_then[:, 2]) < _SAME_SURFACE * (1 + p_then[:, 2])
        is_plain = met[:, ALONG_U] ** 2 + met[:, ALONG_V] ** 2 < _PLAIN_GRADIENT**2
        known = (z > 0) & is_inside & is_one & is_plain
        for seen in (grey, met[:, GREY]):
            known &= (seen > _DARKEST_GREY) & (seen < _BRIGHTEST_GREY)
        dark, dark_then = (vignetting_of((camera.normalise(seen) ** 2).sum(axis=-1)) for seen in (px, px_then))
        return np.stack([grey, dark]), np.stack([met[:, GREY], dark_then]), known

    def _slope(self, x: FloatArray, y: FloatArray) -> tuple[float, float]:
        """The information on the slope of y (N,) over x (N,) by Huber's weights, and that information times the slope.

        The offset is free. Both are 0 if x is constant.
        """
        weight = np.ones(len(x))
        for _ in range(_ROUNDS):
            total = weight.sum()
            dx, dy = x - weight @ x / total, y - weight @ y / total
            spread, common = weight @ dx**2 / total, weight @ (dx * dy) / total
            off = np.abs(dy - common / max(spread, _FLAT) * dx)
            sigma = max(1.4826 * float(np.median(off)), 1e-6)
            weight = _HUBER / np.maximum(off / sigma, _HUBER)
        variance = sigma**2 * _ALIKE_PIXELS / len(x) + _UNEVEN**2
        return float(spread / variance), float(common / variance)
