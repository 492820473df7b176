"""Frames on the grid of an ideal camera: lens, rolling shutter and the gap between the cameras taken out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.calibration import Calibration
from wheelsight.events import RgbdFrame
from wheelsight.geometry import ByteArray, Float32Array, FloatArray, IntArray, PinholeCamera
from wheelsight.odometry.dense import _grid_kernels as kernels
from wheelsight.odometry.dense.settings import DenseSettings
from wheelsight.threads import Rows

_NO_IMAGE = np.empty((0, 0), np.float32)
_BRIGHTEST = np.float32(255)
# Every so many pixels are asked whether an image is dark.
_DARK_STRIDE = 8


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
    """A frame on the ideal grid, as if all rows were read at its stamp: `levels` from the finest to the coarsest.

    Attributes:
        stamp_s: of the frame.
        levels: the pyramid; the last is for turns only.
        twist: (6,) the velocity (v, ω) a second in the camera's own frame by which rows were straightened.
        vignetting: the exponent by which its grey was evened; see `Gridder.even`.
    """

    stamp_s: float
    levels: tuple[Level, ...]
    twist: FloatArray
    vignetting: float = 0.0

    @property
    def depth_share(self) -> float:
        """Of the finest level's pixels, those with depth."""
        depth_m = self.levels[0].depth_m
        return float(np.count_nonzero(depth_m) / depth_m.size)


class Gridder:
    """Brings frames of one camera onto the ideal grid."""

    def __init__(self, calibration: Calibration, settings: DenseSettings, rows: Rows) -> None:
        self._color, self._depth = calibration.cameras
        self._calibration, self._settings, self._rows = calibration, settings, rows
        self.halvings = 0
        while self._depth.width >> self.halvings > settings.finest_width_px:
            self.halvings += 1
        self.intrinsics = self._halved(self._depth)
        self.shape = (self._depth.height >> self.halvings, self._depth.width >> self.halvings)
        self._source_px = self._lens()
        height = self.shape[0]
        late_share = (np.arange(height) + 0.5) / height - 0.5
        self.late_s: FloatArray = late_share * calibration.rolling_shutter_s
        self.depth_late_s = calibration.depth_late_s
        self._darker = self._lens_vignetting()
        self.even(0.0)

    def even(self, exponent: float) -> None:
        """From now on, brighten grey by what the lens takes from it: cos⁴ to the axis, to the power of `exponent`."""
        self._vignetting = exponent
        self._brighter: Float32Array = np.exp(-exponent * self._darker)

    def on_grid(self, frame: RgbdFrame, twist: FloatArray) -> GridFrame:
        """The frame's pyramid, straightened for a camera moving at `twist` (6,).

        Where the lights are off or the lens is covered, grey is noise: of a frame with hardly a pixel brighter than
        `dark_grey`, no grey is known.
        """
        depth_m, grey = self._small_depth(frame), self._small_grey(frame)
        behind_s = frame.depth_late_s + self.depth_late_s
        if not (self._is_straight and behind_s == 0):
            depth_m, grey = self._straightened(depth_m, grey, twist, behind_s)
        if not self._calibration.is_registered:
            grey = self._looked_up(grey, depth_m, twist)
        return GridFrame(frame.stamp_s, self.pyramid(depth_m, grey), twist, self._vignetting)

    def pyramid(self, depth_m: Float32Array, grey: Float32Array) -> tuple[Level, ...]:
        """All scales of images (h, w) that are on the grid."""
        return coarser(Level(self.intrinsics, depth_m, grey), self._settings, self._rows)

    def color_on_grid(self, frame: RgbdFrame, grid: GridFrame) -> Float32Array:
        """Red, green and blue (h, w, 3) from 0 to 255 of the frame that `grid` was made of, known where its grey is.

        Unknown colours are -1.
        """
        if self._is_dark(frame.color):
            return np.full((*self.shape, 3), -1, np.float32)
        image = self._small(frame.color)
        if not self._calibration.is_registered:
            return self._looked_up(image, grid.levels[0].depth_m, grid.twist)
        return image.astype(np.float32) if self._is_straight else self._straightened_color(image, frame, grid.twist)

    @property
    def _is_straight(self) -> bool:
        return not self._depth.has_distortion and not self._calibration.rolling_shutter_s

    def _halved(self, camera: PinholeCamera) -> FloatArray:
        """fx, fy, cx, cy (4,) of its halved images."""
        return _scaled(np.array([camera.fx, camera.fy, camera.cx, camera.cy]), self.halvings)

    def _lens(self) -> Float32Array:
        """(h, w, 2) where each pixel of the ideal grid lies in the halved depth image."""
        ideal = PinholeCamera(self.shape[1], self.shape[0], *self.intrinsics.tolist())
        lens = replace(ideal, distortion=self._depth.distortion)
        return lens.denormalise(ideal.rays()[..., :2]).astype(np.float32)

    def _lens_vignetting(self) -> Float32Array:
        """(H, W) `vignetting_of` each pixel of the halved colour image."""
        width, height = self._color.width >> self.halvings, self._color.height >> self.halvings
        fx, fy, cx, cy = self._halved(self._color)
        small = replace(self._color, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)
        return vignetting_of((small.rays()[..., :2] ** 2).sum(axis=-1)).astype(np.float32)

    def _small_depth(self, frame: RgbdFrame) -> Float32Array:
        """Depth (h, w) as measured, halved."""
        depth_m = frame.depth_m
        for _ in range(self.halvings):
            depth_m = halved_depth(depth_m, self._settings.depth_jump, self._rows)
        return depth_m

    def _small_grey(self, frame: RgbdFrame) -> Float32Array:
        """Grey (H, W), halved and evened; -1 in the dark."""
        grey = np.minimum(self._small(_grey(frame.color)) * self._brighter, _BRIGHTEST)
        return np.full_like(grey, -1) if self._is_dark(frame.color) else grey

    def _small(self, image: ByteArray) -> ByteArray:
        size = (image.shape[1] >> self.halvings, image.shape[0] >> self.halvings)
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8) if self.halvings else image

    def _straightened(
        self, depth_m: Float32Array, grey: Float32Array, twist: FloatArray, behind_s: float
    ) -> tuple[Float32Array, Float32Array]:
        """Depth without lens and shutter, of colour's time, and grey too where it shares depth's grid."""
        registered = self._calibration.is_registered
        out = np.empty((1 + registered, *self.shape), np.float32)
        images = (depth_m, grey if registered else _NO_IMAGE)
        exposure = self._exposure(twist, behind_s if twist.any() else 0.0)
        given = (*images, self._source_px, exposure, np.float32(self._settings.depth_jump))
        self._rows.share(self.shape[0], lambda begin, end: kernels.straighten(*given, (begin, end), out))
        return out[0], out[1] if registered else grey

    def _straightened_color(self, image: ByteArray, frame: RgbdFrame, twist: FloatArray) -> Float32Array:
        """Colour (h, w, 3) on depth's grid, without lens and shutter."""
        depth_m = self._small_depth(frame) if self._shutter_s(twist) else _NO_IMAGE
        given = (image, depth_m, self._source_px, self._exposure(twist))
        out = np.empty((*self.shape, 3), np.float32)
        self._rows.share(len(out), lambda begin, end: kernels.straighten_color(*given, (begin, end), out))
        return out

    def _looked_up(self, image: Float32Array | ByteArray, depth_m: Float32Array, twist: FloatArray) -> Float32Array:
        """What a colour camera of its own saw, in grey (H, W) or colour (H, W, 3), at the 3D point of each pixel."""
        color = self._color
        lens = (*self._halved(color), *color.distortion)
        T_color_camera = _numbers(np.asarray(self._calibration.T_color_depth)[:3])
        given = (image, depth_m, self._exposure(twist), T_color_camera, _numbers(lens))
        out = np.empty((*self.shape, *image.shape[2:]), np.float32)
        sample = kernels.sample_grey if image.ndim == 2 else kernels.sample_color
        self._rows.share(len(out), lambda begin, end: sample(*given, (begin, end), out))
        return out

    def _exposure(self, twist: FloatArray, depth_late_s: float = 0.0) -> kernels.Exposure:
        shutter_s = np.float32(self._shutter_s(twist))
        return kernels.Exposure(_numbers(self.intrinsics), _numbers(twist), shutter_s, np.float32(depth_late_s))

    def _is_dark(self, color: ByteArray) -> bool:
        """Whether a colour image (H, W, 3) shows nothing but noise: judged by some of its pixels."""
        some = _grey(np.ascontiguousarray(color[::_DARK_STRIDE, ::_DARK_STRIDE]))
        bright = np.count_nonzero(some > self._settings.dark_grey)
        return bool(bright < self._settings.dark_share * some.size)

    def _shutter_s(self, twist: FloatArray) -> float:
        return self._calibration.rolling_shutter_s if twist.any() else 0.0


def coarser(finest: Level, settings: DenseSettings, rows: Rows) -> tuple[Level, ...]:
    """A level and those made of it by halving: `settings.levels`, and a coarser one for turns."""
    levels = [finest]
    for number in range(settings.levels):
        last = levels[-1]
        # The same slope is twice the step from pixel to pixel.
        depth_m = halved_depth(last.depth_m, settings.depth_jump * (1 << number), rows)
        levels.append(Level(_scaled(last.intrinsics, 1), depth_m, _halved_grey(last.grey, rows)))
    return tuple(levels)


def halved_depth(depth_m: Float32Array, jump: float, rows: Rows) -> Float32Array:
    """Depth (h, w) at half the size: of each 2×2 block the mean of its nearest surface, never over an edge.

    Args:
        depth_m: (H, W), 0 where unknown; a row or column left over is not looked at.
        jump: share of the nearest depth by which others on its surface lie behind it at most.
        rows: that share the work.
    """
    half = np.empty((depth_m.shape[0] // 2, depth_m.shape[1] // 2), np.float32)
    rows.share(len(half), lambda begin, end: kernels.halve_depth(depth_m, jump, begin, end, half))
    return half


def vignetting_of(squared_tangent: FloatArray) -> FloatArray:
    """Logarithm of the fourth power of the cosine to the axis, by the squared tangent."""
    return np.asarray(-2 * np.log1p(squared_tangent))


def _grey(color: ByteArray) -> ByteArray:
    return np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8)


def _halved_grey(grey: Float32Array, rows: Rows) -> Float32Array:
    half = np.empty((grey.shape[0] // 2, grey.shape[1] // 2), np.float32)
    rows.share(len(half), lambda begin, end: kernels.halve_grey(grey, begin, end, half))
    return half


def _scaled(intrinsics: FloatArray, halvings: int) -> FloatArray:
    """fx, fy, cx, cy of images halved so often, pixel centres at integers."""
    factor = 2.0**halvings
    fx, fy, cx, cy = intrinsics
    return np.array([fx / factor, fy / factor, (cx + 0.5) / factor - 0.5, (cy + 0.5) / factor - 0.5])


def _numbers(values: ArrayLike) -> tuple[np.float32, ...]:
    """As kernels read them fastest."""
    return tuple(np.asarray(values, np.float32).ravel())
