"""What a frame is aligned with: an earlier frame, or the view that a map predicts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import DepthNoise
from wheelsight.geometry import Float32Array, FloatArray
from wheelsight.odometry.dense import _reference_kernels as kernels
from wheelsight.odometry.dense._alignment_kernels import CHANNELS
from wheelsight.odometry.dense.grid import GridFrame, Level, coarser
from wheelsight.odometry.dense.settings import DenseSettings
from wheelsight.threads import Rows
from wheelsight.views import PredictedView

# No limit to how far a surface may be off its plane.
_ANY_BEND = 1e6
# How much of a residual is the frame's own noise: against another frame, which has as much, half; against a map all.
_AS_NOISY, _MAPPED = 0.5, 1.0


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceLevel:
    """One scale of a reference.

    Attributes:
        normal: (h, w, 3) float32 in the camera frame, towards the camera; 0 where unknown.
        pixels: (h, w, 8) float32: the plane n·q = d through each pixel's point q as n and d, depth, grey, and grey's
            gradient along u and v a pixel; NaN where unknown. Side by side, since a look-up needs them together.
    """

    normal: Float32Array
    pixels: Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """By what it is judged which motions a view shows, where noise is averaged out.

    Attributes:
        planes: of the coarsest level for alignment.
        slopes: of grey, of the second level.
    """

    planes: ReferenceLevel
    slopes: ReferenceLevel


@dataclass(frozen=True, slots=True, eq=False)
class Scales:
    """A reference at all scales.

    Attributes:
        levels: from the finest to the coarsest, as a `GridFrame` has them.
        steep: the coarsest level for alignment once more, with normals of steep surfaces but none at creases: what
            a view shows is told by all of its planes, and by nothing that is none.
    """

    levels: tuple[ReferenceLevel, ...]
    steep: ReferenceLevel


class Reference:
    """What frames are aligned with, and where it was seen from.

    Its scales are made when they are asked for, and may be forgotten: the frame they are made of takes a sixth of them.

    Attributes:
        T_map_reference: (4, 4).
        own_noise: how much of what a frame is off this is the frame's own noise.
        vignetting: the exponent by which its grey was evened.
    """

    __slots__ = ("T_map_reference", "_made", "_make", "own_noise", "vignetting")

    def __init__(
        self, T_map_reference: FloatArray, make: Callable[[], Scales], own_noise: float, vignetting: float = 0.0
    ) -> None:
        self.T_map_reference, self.own_noise, self.vignetting = T_map_reference, own_noise, vignetting
        self._make = make
        self._made: Scales | None = None

    @property
    def is_at_hand(self) -> bool:
        """Whether its scales are made and not forgotten."""
        return self._made is not None

    @property
    def scales(self) -> Scales:
        """At all scales."""
        if self._made is None:
            self._made = self._make()
        return self._made

    @property
    def levels(self) -> tuple[ReferenceLevel, ...]:
        """From the finest to the coarsest."""
        return self.scales.levels

    @property
    def steep(self) -> ReferenceLevel:
        """See `Scales`."""
        return self.scales.steep

    def forget(self) -> None:
        """Give the room of its scales back; asked for again, they are made again, alike to the bit."""
        self._made = None


class ReferenceMaker:
    """Makes references of frames and of predicted views."""

    def __init__(self, noise: DepthNoise, settings: DenseSettings, rows: Rows) -> None:
        self._noise = np.array([noise.constant_m, noise.quadratic_per_m], np.float32)
        self._settings, self._rows = settings, rows
        self._boundary = self._step(settings.occlusion_share, settings.occlusion_sigmas)

    def of_frame(self, frame: GridFrame, T_map_camera: FloatArray) -> Reference:
        """A frame with its pose as reference."""

        def make() -> Scales:
            levels = tuple(self._level(level, self.normals(level)) for level in frame.levels)
            return Scales(levels, self._steep(frame.levels))

        return Reference(T_map_camera, make, _AS_NOISY, frame.vignetting)

    def of_view(self, view: PredictedView, T_map_camera: FloatArray, intrinsics: FloatArray) -> Reference:
        """A predicted view, with the pose (4, 4) it was predicted for, as reference."""
        finest = Level(intrinsics, view.depth_m, view.grey)
        levels = coarser(finest, self._settings, self._rows)
        fitted = (self._level(level, self.normals(level)) for level in levels[1:])
        pyramid = (self._level(finest, view.normal), *fitted)
        scales = Scales(pyramid, self._steep(levels))
        return Reference(T_map_camera, lambda: scales, _MAPPED)

    def shown_by(self, frame: GridFrame) -> Shown:
        """What a frame itself shows."""
        number = min(1, self._settings.levels - 1)
        no_planes = np.zeros((*frame.levels[number].depth_m.shape, 3), np.float32)
        return Shown(self._steep(frame.levels), self._level(frame.levels[number], no_planes))

    def normals(self, level: Level, steepness: int = 1, bend: float = _ANY_BEND) -> Float32Array:
        """Unit normals (h, w, 3) float32 of a level's surfaces, towards the camera; 0 where unknown.

        Neighbours on one surface differ by `depth_jump` times `steepness`, and by noise; `bend` is by how many standard
        deviations of depth a surface may be off its plane.
        """
        normal = np.empty((*level.depth_m.shape, 3), np.float32)
        limits = (
            self._step(steepness * self._settings.depth_jump, self._settings.depth_jump_sigmas),
            np.float32(bend) * self._noise,
        )
        given = (level.depth_m, level.intrinsics.astype(np.float32), self._settings.normal_radius_px, *limits)
        self._rows.share(len(normal), lambda begin, end: kernels.normals(*given, begin, end, normal))
        return normal

    def _steep(self, levels: tuple[Level, ...]) -> ReferenceLevel:
        number = self._settings.levels - 1
        # The same slope is a larger step from pixel to pixel where pixels are larger.
        return self._level(levels[number], self.normals(levels[number], 1 << number, self._settings.crease_sigmas))

    def _level(self, level: Level, normal: Float32Array) -> ReferenceLevel:
        pixels = np.empty((*level.depth_m.shape, CHANNELS), np.float32)
        given = (level.depth_m, normal, level.grey, level.intrinsics.astype(np.float32), self._boundary)
        self._rows.share(len(pixels), lambda begin, end: kernels.pack(*given, begin, end, pixels))
        return ReferenceLevel(normal, pixels)

    def _step(self, share: float, sigmas: float) -> Float32Array:
        """A step in depth (3,), as kernels take it: a share of the depth and so many standard deviations of it."""
        constant, quadratic = np.float32(sigmas) * self._noise
        return np.array([constant, share, quadratic], np.float32)
