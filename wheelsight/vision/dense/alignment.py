"""Image pyramids, references, and the alignment of one with the other.

`Gridder` resamples frames onto the pixel grid of an ideal camera. `ReferenceMaker` makes references of them. `Aligner`
aligns a frame with a reference by Gauss-Newton over point-to-plane and photometric residuals. `judge` tests the result
for degenerate directions, and `SurfaceWeight` weighs it against keypoints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.estimates import DEGENERATE_SCALE, Reason
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, IntArray, PinholeCamera, se3
from wheelsight.core.keyframes import PredictedView
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.dense import alignment_kernels as kernels
from wheelsight.vision.dense.alignment_kernels import (
    COLOR_SIGMA,
    COMPARED,
    GAIN,
    GREY_SIGMA,
    GREY_WEIGHT,
    HUBER,
    MEAN_ABS,
    PLANE_SCALE,
    POINTS,
    SHOWN,
    BothViews,
    advance,
    find_turn,
    place_rows,
    show_planes,
    show_slopes,
)
from wheelsight.vision.dense.settings import DenseSettings
from wheelsight.vision.image_kernels import (
    CHANNELS,
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

    def __init__(self, calibration: Calibration, settings: DenseSettings) -> None:
        self._color, self._depth = calibration.cameras
        self._calibration, self._is_registered = calibration, calibration.is_registered
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
            straighten(*images, self._source_px, exposure, np.float32(DEPTH_JUMP), (0, self.shape[0]), out)
            depth_m, grey = out[0], out[1] if self._is_registered else grey
        if not self._is_registered:
            grey = self._sampled(grey, depth_m, twist)
        return GridFrame(frame.stamp_s, self.pyramid(depth_m, grey), twist, self._vignetting)

    def pyramid(self, depth_m: Float32Array, grey: Float32Array) -> tuple[Level, ...]:
        """The pyramid of images (h, w) that are on the ideal grid already."""
        return coarser(Level(self.intrinsics, depth_m, grey))

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
        out = np.empty((*self.shape, 3), np.float32)
        straighten_color(image, depth_m, self._source_px, self._exposure(grid.twist), (0, len(out)), out)
        return out

    def _halved(self, camera: PinholeCamera) -> FloatArray:
        """fx, fy, cx, cy (4,) of the camera's halved images."""
        return _scaled(np.array([camera.fx, camera.fy, camera.cx, camera.cy]), self.halvings)

    def _small_depth(self, frame: RgbdFrame) -> Float32Array:
        """Depth (h, w) as measured, halved."""
        depth_m = frame.depth_m
        for _ in range(self.halvings):
            depth_m = halved_depth(depth_m, DEPTH_JUMP)
        return depth_m

    def _small(self, image: ByteArray) -> ByteArray:
        size = (image.shape[1] >> self.halvings, image.shape[0] >> self.halvings)
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8) if self.halvings else image

    def _sampled(self, image: Float32Array | ByteArray, depth_m: Float32Array, twist: FloatArray) -> Float32Array:
        """The image of a separate colour camera, grey (H, W) or colour (H, W, 3), at the 3D point of each pixel."""
        color = self._color
        lens = (*self._halved(color), *color.distortion)
        T_color_camera = _numbers(np.asarray(self._calibration.T_color_depth)[:3])
        out = np.empty((*self.shape, *image.shape[2:]), np.float32)
        sample = sample_grey if image.ndim == 2 else sample_color
        sample(image, depth_m, self._exposure(twist), T_color_camera, _numbers(lens), (0, len(out)), out)
        return out

    def _exposure(self, twist: FloatArray, depth_late_s: float = 0.0) -> Exposure:
        shutter_s = np.float32(self._calibration.rolling_shutter_s if twist.any() else 0.0)
        return Exposure(_numbers(self.intrinsics), _numbers(twist), shutter_s, np.float32(depth_late_s))

    def _is_dark(self, color: ByteArray) -> bool:
        """Whether a subsample of a colour image (H, W, 3) shows nothing but noise."""
        some = cv2.cvtColor(np.ascontiguousarray(color[::_DARK_STRIDE, ::_DARK_STRIDE]), cv2.COLOR_RGB2GRAY)
        return bool(np.count_nonzero(some > _DARK_GREY) < _DARK_SHARE * some.size)


def coarser(finest: Level, count: int = LEVELS) -> tuple[Level, ...]:
    """`count` pyramid levels that begin with `finest`, and one coarser level for rotation search."""
    levels = [finest]
    for number in range(count):
        last = levels[-1]
        # The same slope is twice the step from pixel to pixel.
        depth_m = halved_depth(last.depth_m, DEPTH_JUMP * (1 << number))
        grey = np.empty((last.grey.shape[0] // 2, last.grey.shape[1] // 2), np.float32)
        halve_grey(last.grey, 0, len(grey), grey)
        levels.append(Level(_scaled(last.intrinsics, 1), depth_m, grey))
    return tuple(levels)


def halved_depth(depth_m: Float32Array, jump: float) -> Float32Array:
    """Depth (h, w) at half the size: the mean of the nearest surface in each 2×2 block, never across an edge.

    Args:
        depth_m: (H, W), 0 where unknown; an odd last row or column is ignored.
        jump: the largest difference within one surface, as a share of the nearest depth.
    """
    half = np.empty((depth_m.shape[0] // 2, depth_m.shape[1] // 2), np.float32)
    halve_depth(depth_m, jump, 0, len(half), half)
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

    def __init__(self, noise: DepthNoise) -> None:
        self._noise = np.array([noise.constant_m, noise.quadratic_per_m], np.float32)
        # Coefficients of depth steps for kernels: a share of depth, and standard deviations of it.
        constant, quadratic = np.float32(_OCCLUSION_SIGMAS) * self._noise
        self._boundary = np.array([constant, _OCCLUSION_SHARE, quadratic], np.float32)
        self._jump = np.float32(_DEPTH_JUMP_SIGMAS) * self._noise

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
        levels = coarser(finest)
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
            np.array([self._jump[0], steepness * DEPTH_JUMP, self._jump[1]], np.float32),
            np.float32(bend) * self._noise,
        )
        intrinsics = level.intrinsics.astype(np.float32)
        normals(level.depth_m, intrinsics, _NORMAL_RADIUS_PX, *limits, 0, len(normal), normal)
        return normal

    def _steep(self, levels: tuple[Level, ...]) -> ReferenceLevel:
        # The same slope is a larger step from pixel to pixel where pixels are larger.
        coarsest = levels[LEVELS - 1]
        return self._level(coarsest, self.normals(coarsest, 1 << (LEVELS - 1), _CREASE_SIGMAS))

    def _level(self, level: Level, normal: Float32Array) -> ReferenceLevel:
        pixels = np.empty((*level.depth_m.shape, CHANNELS), np.float32)
        intrinsics = level.intrinsics.astype(np.float32)
        pack(level.depth_m, normal, level.grey, intrinsics, self._boundary, 0, len(pixels), pixels)
        return ReferenceLevel(normal, pixels)


# Components of a twist (v, ω) in the base's frame that wheels cannot roll: sideways, up, roll and pitch. They count for
# a holonomic base too: where a view hardly constrains sideways motion, the estimate else slides along a plain wall.
_NOT_ROLLED = [1, 2, 3, 4]
_FREE = (np.inf, np.inf)
_UPPER = np.triu_indices(6)
_DIVERGED_M = 1e3
# A change of the motion, in metres and radians, below which the finest level has converged: a tenth of a frame's error
# (real recordings: docs/decisions/dense-alignment.md). At each coarser level the limit is twice as large.
_SMALL_STEP = 3e-4
# Initial spread of grey residuals, in grey levels; the first iteration replaces it.
_GREY_SIGMA = 8.0

# Most iterations, from the finest level to the coarsest, and the stride of rows: of those aligned at the finest level,
# and of those whose slopes of grey give information; chosen.
_ITERATIONS = (4, 6, 8)
_ROW_STRIDE = 2
# Points farther apart are no pair, in metres and in metres per metre of depth; chosen.
GATE = 0.06
_HUBER_SIGMAS = 1.5  # beyond, a residual counts linearly
# Least grey gradient at the second level, grey levels per pixel; a flatter surface may show nothing but noise.
MIN_GRADIENT = 3.0
# Share of `color_sigma_px` left between two images of a colour camera with the same error in both; chosen.
_COLOR_ERROR_LEFT = 0.25
# Number of neighbouring residuals with the same error; variances are larger by this factor. Chosen.
CORRELATION = 20.0

# A rotation by grey is rejected if points then lie this many times as far from planes. Depth and colour of a frame are
# rarely simultaneous, so grey may be right where planes fit worse (real recordings).
_TURN_MISFIT = 3.0
_UNPAIRED_SIGMAS = 5.0  # distance of a point without a plane nearby, in standard deviations
# Another initial guess replaces the first if points lie this many times nearer to planes (simulator, as below).
_CLEARLY_NEARER = 1.5
# Another result replaces the first if it finds this share of the first one's planes, with a residual of at most this
# multiple, and grey residuals spread by less than this share (simulator: docs/decisions/dense-alignment.md).
_AS_MANY_PLANES, _AS_NEAR_PLANES, _CLEARER_GREY = 0.7, 1.1, 0.85

# Share of a frame's points that must find a partner, and the largest mean residual in standard deviations; chosen.
MIN_OVERLAP, MAX_RESIDUAL = 0.25, 5.0
# The prior replaces a direction less certain than this after one frame, metres; chosen.
_DEGENERATE_SIGMA_M = 0.01
# Share of a reference's information along a direction that the frame must show too. Where the views coincide, gradients
# of grey are similar; where an alignment has slipped along a wall, they are not (simulator).
_CONFIRMED_SHARE = 0.4
# Another prior than the first fills unseen directions if its difference from the rest is below this share (simulator).
_OTHER_PRIOR_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class DenseAlignment:
    """The result of an alignment; `judge` decides whether it is accepted.

    Attributes:
        T_reference_frame: (4, 4).
        information: (6, 6) of the left perturbation (v, ω) by what both views show, for independent residuals.
        pairs: number of points that project into the reference's image.
        planes: number of those pairs that have a plane nearby.
        points: number of points with depth at the frame's finest level.
        residual: mean absolute plane residual in standard deviations of the sensor, 1 for a perfect fit.
        grey_sigma: spread of the grey residuals, in grey levels.
        claimed: (6, 6) information of the left perturbation by the final residuals, for independent residuals.
        compared: (6, 6) `information` with the grey gradients of the reference in place of the frame's. Both are
            similar if the two views coincide.
        hinted: (6, 6) additional information if keypoints erred independently; it only decides which directions
            are constrained.
    """

    T_reference_frame: FloatArray
    information: FloatArray
    pairs: int
    planes: int
    points: int
    residual: float
    grey_sigma: float
    claimed: FloatArray
    compared: FloatArray
    hinted: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PreviousPose:
    """The camera's pose at the previous frame (4, 4), and the time since then in seconds."""

    T_reference_previous: FloatArray
    seconds: float

    def twist_to(self, T_reference_frame: FloatArray) -> FloatArray:
        """Mean velocity (6,) since then, (v, ω) per second in the camera's own frame."""
        return se3.twist_between(self.T_reference_previous, T_reference_frame, self.seconds)


class Aligner:
    """Aligns frames with references by Gauss-Newton from coarse to fine, on depth and grey values together."""

    def __init__(
        self, calibration: Calibration, settings: DenseSettings, gridder: Gridder, maker: ReferenceMaker
    ) -> None:
        noise = calibration.depth_noise
        self._noise = np.array([noise.constant_m, noise.quadratic_per_m, noise.near_m, noise.far_m], np.float32)
        self._color_weight, self._late_s, self._maker = settings.color_weight, gridder.late_s, maker
        T_base_camera = calibration.T_base_camera
        self._T_base_camera = None if T_base_camera is None else se3.nearest(T_base_camera)
        self._Ad_base_camera = np.eye(6) if self._T_base_camera is None else se3.adjoint(self._T_base_camera)
        self._color_sigma_px = calibration.color_sigma_px / (1 << gridder.halvings)

    def turn(self, frame: GridFrame, reference: Reference, T_reference_frame: FloatArray) -> FloatArray:
        """T_reference_frame with its rotation refined by grey values alone, at the two coarsest levels.

        It stays unchanged if planes fit worse after that, because grey of a plain wall is mostly noise.
        """
        start = np.array(T_reference_frame, float)
        T, exposure = start.copy(), np.array([1.0, 0.0])
        for level, seen in zip(frame.levels[:-3:-1], reference.scales.levels[:-3:-1], strict=True):
            find_turn(kernels.Images(level.depth_m, level.grey, seen.pixels, level.intrinsics), T, exposure)
        before, after = self._misfits(frame, reference, [start, T])
        return T if after <= _TURN_MISFIT * max(before, 1.0) else start

    def start(self, frame: GridFrame, reference: Reference, guesses: Sequence[FloatArray]) -> FloatArray:
        """The initial pose: the first guess (4, 4), its rotation refined, or another one that fits clearly better."""
        return self.nearest(frame, reference, [self.turn(frame, reference, guess) for guess in guesses])

    def nearest(self, frame: GridFrame, reference: Reference, guesses: Sequence[FloatArray]) -> FloatArray:
        """The first of some guesses (4, 4), or another one if planes fit clearly better there."""
        if len(guesses) == 1:
            return guesses[0]
        misfits = self._misfits(frame, reference, guesses)
        best = int(np.argmin(misfits))
        return guesses[best] if _CLEARLY_NEARER * misfits[best] < misfits[0] else guesses[0]

    def _misfits(self, frame: GridFrame, reference: Reference, guesses: Sequence[FloatArray]) -> FloatArray:
        """The mean distance (N,) of points from planes for each guess, in standard deviations.

        The number of points is that of the guess with the most pairs; a point without pair counts `_UNPAIRED_SIGMAS`.
        """
        how = np.array([GATE, 1, _GREY_SIGMA, 1, 0, _HUBER_SIGMAS, 0, 0, 0, 0], float)
        level = frame.levels[-1]
        pixels = reference.scales.levels[-1].pixels
        images = kernels.Images(level.depth_m, level.grey, pixels, level.intrinsics.astype(np.float32))
        sums, totals = np.empty((len(frame.levels[-1].depth_m), kernels.SUMS)), []
        for T in guesses:
            T_rows = np.ascontiguousarray(np.broadcast_to(T[:3].astype(np.float32), (len(sums), 3, 4)))
            kernels.accumulate(images, T_rows, self._noise, how.astype(np.float32), 1, 0, len(sums), sums)
            totals.append(sums.sum(axis=0)[kernels.PLANE_COUNT : kernels.PLANE_COUNT + 2])
        planes, off = np.transpose(totals)
        most = max(planes.max(), 1.0)
        return np.asarray((off + _UNPAIRED_SIGMAS * (most - planes)) / most)

    def align(
        self,
        frame: GridFrame,
        reference: Reference,
        T_reference_frame: FloatArray,
        previous: PreviousPose | None = None,
        held_m: tuple[float, float] = _FREE,
        keypoints: KeypointMotion | None = None,
        factor: float = 1.0,
    ) -> DenseAlignment:
        """The motion of a frame against a reference.

        Args:
            frame: the frame.
            reference: the reference.
            T_reference_frame: (4, 4) initial guess. It is a prior too, because else noise of a plain wall pulls weakly
                constrained directions along by decimetres.
            previous: the previous pose; with it each iteration updates the speed of the rolling-shutter correction.
            held_m: standard deviations of the guess, with rotations as distances at 2 m. The second one is for a base
                on wheels: its motion sideways, upwards and in tilt since the previous frame, whatever the guess.
            keypoints: the motion by keypoints, which counts like their residuals near the optimum.
            factor: weight of `keypoints`: the covariance of surfaces is larger than they claim by this factor.
        """
        rules = _HUBER_SIGMAS, self._color_weight, 0, MIN_GRADIENT, reference.own_noise
        how = np.array([0, 1, _GREY_SIGMA, 1, 0, *rules], float)
        T, total = np.array(T_reference_frame, float), np.zeros(kernels.SUMS)
        T_prior, information = self._prior_of(T, previous, held_m, keypoints, factor)
        scales, T_previous_reference, seconds = reference.scales.levels, np.eye(4), 1.0
        if previous is not None:
            T_previous_reference, seconds = se3.invert(previous.T_reference_previous), previous.seconds
        for number in reversed(range(LEVELS)):
            how[kernels.GATE] = GATE * (1 + 0.5 * number)
            how[COLOR_SIGMA] = _COLOR_ERROR_LEFT * self._color_sigma_px / (1 << number)
            level, pixels = frame.levels[number], scales[number].pixels
            images = kernels.Images(level.depth_m, level.grey, pixels, level.intrinsics.astype(np.float32))
            height = len(level.depth_m)
            late_s, T_rows = np.zeros(height), np.empty((height, 3, 4), np.float32)
            if previous is not None:
                late_s = self._late_s[: height << number].reshape(height, -1).mean(axis=1)
            stride = _ROW_STRIDE if number == 0 else 1
            sums = np.empty((height // stride, kernels.SUMS))
            for _ in range(_ITERATIONS[number]):
                place_rows(T, T_previous_reference, seconds, frame.twist, late_s, T_rows)
                kernels.accumulate(images, T_rows, self._noise, how.astype(np.float32), stride, 0, len(sums), sums)
                if advance(sums, T, how, total, T_prior, information) < _SMALL_STEP * (1 << number):
                    break
                if not np.abs(T).max() < _DIVERGED_M:
                    return self._answer(frame, reference, np.array(T_reference_frame), np.zeros(kernels.SUMS), how)
        return self._answer(frame, reference, T, total, how)

    def _prior_of(
        self,
        T: FloatArray,
        previous: PreviousPose | None,
        held_m: tuple[float, float],
        keypoints: KeypointMotion | None,
        factor: float,
    ) -> tuple[FloatArray, FloatArray]:
        """The prior (4, 4) of an alignment with its information (6, 6) in the left tangent: guess and keypoints.

        It weighs like residuals, with rotations as distances at 2 m.
        """
        T_prior, sigmas, T_base_camera = T.copy(), np.full(6, held_m[0]), self._T_base_camera
        if T_base_camera is not None:
            sigmas[_NOT_ROLLED] = held_m[1]
        if T_base_camera is not None and previous is not None:
            # A base on wheels can only roll and turn since the previous frame.
            twist = se3.log(se3.invert(previous.T_reference_previous) @ T).reshape(2, 3)
            way, turn = twist @ T_base_camera[:3, :3].T
            # The camera's own translation: that of the base includes what a tilt about the camera adds to it.
            ahead_m = way[0] + turn[2] * T_base_camera[1, 3]
            moved = se3.exp([ahead_m, 0.0, 0.0, 0.0, 0.0, turn[2]])
            T_prior = previous.T_reference_previous @ se3.invert(T_base_camera) @ moved @ T_base_camera
        A = (DEGENERATE_SCALE / sigmas)[:, None] * (self._Ad_base_camera @ se3.adjoint(se3.invert(T_prior)))
        information = np.asarray(CORRELATION * A.T @ A)
        if keypoints is None:
            return T_prior, information
        # The mean of guess and keypoints by their information.
        by_keypoints = factor * CORRELATION * keypoints.information
        off, total = se3.log(keypoints.T_reference_frame @ se3.invert(T_prior)), information + by_keypoints
        return se3.exp(np.linalg.solve(total, by_keypoints @ off)) @ T_prior, total

    def align_clearest(
        self,
        frame: GridFrame,
        reference: Reference,
        starts: Sequence[FloatArray],
        previous: PreviousPose | None = None,
        held_m: tuple[float, float] = _FREE,
        keypoints: KeypointMotion | None = None,
        factor: float = 1.0,
    ) -> DenseAlignment:
        """The alignment from the first guess (4, 4), or from another one if grey values fit clearly better there.

        Along a wall planes constrain nothing, and its few marks match each other, so the result depends on the guess.
        """
        given = (previous, held_m, keypoints, factor)
        best = self.align(frame, reference, starts[0], *given)
        for start in starts[1:]:
            other = self.align(frame, reference, start, *given)
            as_many = other.planes >= _AS_MANY_PLANES * best.planes
            is_as_near = as_many and other.residual < _AS_NEAR_PLANES * best.residual
            if is_as_near and other.grey_sigma < _CLEARER_GREY * best.grey_sigma:
                best = other
        return best

    def _answer(
        self, frame: GridFrame, reference: Reference, T: FloatArray, total: FloatArray, how: FloatArray
    ) -> DenseAlignment:
        counted, stride = total[kernels.PLANE_COUNT], _ROW_STRIDE
        planes, pairs = int(counted) * stride, int(total[kernels.PAIRS]) * stride
        mean_abs = total[kernels.PLANE_COUNT + 1] / counted if counted else np.inf
        points = int(np.count_nonzero(frame.levels[0].depth_m))
        information, compared = self._information(frame, reference, T, pairs, how)
        residual = float(how[PLANE_SCALE] * mean_abs / MEAN_ABS)
        T = se3.nearest(T)
        claimed = symmetric(total[:21] + total[kernels.GREY_SUMS : kernels.GREY_SUMS + 21])
        grey_sigma = float(how[GREY_SIGMA])
        return DenseAlignment(T, information, pairs, planes, points, residual, grey_sigma, claimed, compared)

    def _information(
        self, frame: GridFrame, reference: Reference, T: FloatArray, pairs: int, how: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Information (6, 6) of `pairs`, by normals of the coarsest level and grey gradients of the second.

        The second result is the same with the reference's gradients in place of the frame's (6, 6). Only structure that
        both views show counts: it excludes noise of a plain wall, and what one end of a corridor shows but its middle
        does not. Unconstrained directions may have negative eigenvalues.
        """
        own = self._maker.shown_by(frame)
        rules = how[[kernels.GATE, PLANE_SCALE, GREY_SIGMA, GAIN, HUBER, GREY_WEIGHT]]
        given = (T, self._noise.astype(float), np.append(rules, how[COLOR_SIGMA]))
        scales, information, compared = reference.scales, np.zeros((6, 6)), np.zeros((6, 6))
        planes = (frame.levels[LEVELS - 1], own.planes.pixels, scales.steep.pixels, 1)
        slopes = (frame.levels[SECOND], own.slopes.pixels, scales.levels[SECOND].pixels, _ROW_STRIDE)
        for show, (level, here, there, stride) in ((show_planes, planes), (show_slopes, slopes)):
            sums = np.empty((len(level.depth_m) // stride, COMPARED))
            both = BothViews(level.depth_m, here, there, level.intrinsics)
            show(both, *given, 0, len(sums), sums)
            total = sums.sum(axis=0)
            share = float(pairs / max(total[POINTS], 1.0))
            here_shown = share * symmetric(total)
            information += here_shown
            compared += here_shown if show is show_planes else share * symmetric(total[SHOWN:])
        return information, compared


def symmetric(sums: FloatArray) -> FloatArray:
    """The symmetric matrix (6, 6) of 21 sums, its upper triangle row by row."""
    H = np.zeros((6, 6))
    H[_UPPER] = sums[:21]
    return H + np.triu(H, 1).T


@dataclass(frozen=True, slots=True, eq=False)
class MotionPrior:
    """The predicted motion, before images are compared.

    Attributes:
        T_reference_frame: (4, 4).
        sigma_m: standard deviation in every direction, with rotations as distances at 2 m.
        others: alternatives, each (4, 4), in case the first one is wrong.
    """

    T_reference_frame: FloatArray
    sigma_m: float
    others: tuple[FloatArray, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """An accepted alignment, or the reason of its rejection.

    Attributes:
        T_reference_frame: (4, 4); the prior's along `degenerate` directions.
        covariance: (6, 6) of its left perturbation (v, ω); the prior's along `degenerate` directions.
        degenerate: (K, 6) unit vectors of (v, ω · 2 m) that the view does not constrain, 0 ≤ K ≤ 6.
        reason: None if the alignment is accepted.
    """

    T_reference_frame: FloatArray
    covariance: FloatArray
    degenerate: FloatArray
    reason: Reason | None = None


def judge(
    found: DenseAlignment, prior: MotionPrior, min_overlap: float = MIN_OVERLAP, max_residual: float = MAX_RESIDUAL
) -> Judgement:
    """The alignment with the prior's motion along directions less certain than `_DEGENERATE_SIGMA_M`, or a rejection.

    The directions are eigenvectors of the information (Zhang, Kaess & Singh, ICRA 2016: solution remapping).
    """
    scale = np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE) * CORRELATION
    information = found.information / scale
    shown = information if found.hinted is None else information + found.hinted / scale
    strength, directions = np.linalg.eigh(shown)
    weak = strength < _DEGENERATE_SIGMA_M**-2
    compared = found.compared / scale + (shown - information)
    weak |= strength < _CONFIRMED_SHARE * (directions * (compared @ directions)).sum(axis=0)
    strength = np.maximum((directions * (information @ directions)).sum(axis=0), 0.0)
    variances = np.where(weak, prior.sigma_m**2, 1 / np.maximum(strength, 1e-12))
    covariance = (directions * variances) @ directions.T / np.outer(DEGENERATE_SCALE, DEGENERATE_SCALE)
    T = found.T_reference_frame
    if weak.any():
        seen = directions[:, ~weak]
        priors = (prior.T_reference_frame, *prior.others)
        shifts = [seen.T @ (DEGENERATE_SCALE * se3.log(T @ se3.invert(T_prior))) for T_prior in priors]
        off_m = np.array([np.linalg.norm(shift) for shift in shifts])
        best = int(np.argmin(off_m))
        if off_m[0] < _DEGENERATE_SIGMA_M or off_m[best] > _OTHER_PRIOR_SHARE * off_m[0]:
            best = 0
        T_prior, shift = priors[best], shifts[best]
        T = se3.exp(seen @ shift / DEGENERATE_SCALE) @ T_prior
    reason = Reason.DEGENERATE if weak.all() else None
    if found.planes < min_overlap * found.points:
        reason = Reason.TOO_LITTLE_OVERLAP
    elif found.residual > max_residual:
        reason = Reason.POOR_FIT
    return Judgement(T, covariance, directions[:, weak].T, reason)


# The weight of surfaces relative to keypoints. An alignment of surfaces claims a covariance by sensor noise, which
# averages out over a hundred thousand pixels. Systematic errors of real cameras are far larger: depth is delayed,
# misregistered, or bent. Motions by keypoints and by surfaces differ by both covariances, where that of surfaces has an
# unknown factor. Variance components estimate it (Helmert; Förstner 1979).

# The factor before the first frame, the share of a frame's logarithm that updates it, and its largest value; chosen.
_FIRST_FACTOR, _LEARNED, _MOST_FACTOR = 1.0, 0.1, 1e4
# Beyond this difference of keypoints and surfaces the frame's own factor counts: χ² of 6, 99.9 %. In a quick turn
# colour and depth that are not simultaneous differ.
_ODD_CHI2 = 22.5
# Times the information of keypoints that surfaces must claim along a direction to be judged by it; chosen.
_LEAST_CLAIM = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class KeypointMotion:
    """The motion of a frame by its keypoints (4, 4), and the information (6, 6) of its left perturbation."""

    T_reference_frame: FloatArray
    information: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A motion by keypoints and surfaces together.

    Attributes:
        T_reference_frame: (4, 4).
        ahead: (6,) the left perturbation from the motion by surfaces alone to that by keypoints.
        factor: on the covariance that surfaces claim.
        seen_factor: the factor by this frame alone.
    """

    T_reference_frame: FloatArray
    ahead: FloatArray
    factor: float
    seen_factor: float


class SurfaceWeight:
    """Estimates the factor on the covariance that surfaces claim, for one camera.

    Attributes:
        factor: the present estimate, at least 1.
    """

    def __init__(self) -> None:
        self.factor = _FIRST_FACTOR

    def learn(self, joint: Joint) -> None:
        """Update the factor by a frame whose pose was accepted."""
        self.factor *= (joint.seen_factor / self.factor) ** _LEARNED

    def meet(self, T_reference_frame: FloatArray, surfaces: FloatArray, keypoints: KeypointMotion) -> Joint:
        """The motion by keypoints and surfaces, with the estimated factor or the frame's own if that is too small.

        Args:
            T_reference_frame: (4, 4) the optimum of keypoints and surfaces with the estimated factor.
            surfaces: (6, 6) information of the left perturbation that surfaces claim.
            keypoints: the motion by keypoints.
        """
        root = np.linalg.cholesky(keypoints.information)
        whitened = np.linalg.solve(root, np.linalg.solve(root, surfaces).T)
        claimed, directions = np.linalg.eigh(0.5 * (whitened + whitened.T))
        claimed = np.maximum(claimed, 1e-9)
        # From the joint optimum to the motion by keypoints, in standard deviations of the latter.
        off = directions.T @ root.T @ se3.log(keypoints.T_reference_frame @ se3.invert(T_reference_frame))
        apart = off * (1 + self.factor / claimed)
        seen, shown = self.factor, claimed > _LEAST_CLAIM
        if shown.any():  # differences relative to those that surfaces claim, along constrained directions
            excess = float((apart[shown] ** 2 - 1).sum() / (1 / claimed[shown]).sum())
            seen = float(np.clip(excess, 1.0, _MOST_FACTOR))
        is_odd = (apart**2 / (1 + self.factor / claimed)).sum() > _ODD_CHI2
        factor = max(self.factor, seen) if is_odd else self.factor
        share = claimed / factor / (1 + claimed / factor)
        back = np.linalg.solve(root.T, directions @ (share * apart))
        ahead = np.linalg.solve(root.T, directions @ apart)
        return Joint(se3.exp(-back) @ keypoints.T_reference_frame, ahead, factor, seen)
