"""Regions of a view that move by themselves, told by how far all of a region lies from what is known.

Robust weights of pixels are outvoted where a person fills a fifth of the view: each pixel counts, and a person's have
much texture. Here each region has one vote, however much it shows: a region is left out of an alignment where its
points lie clearly farther from the surfaces known than those of the median region (cf. Scona et al., StaticFusion,
ICRA 2018, who weigh clusters).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from wheelsight.calibration import DepthNoise
from wheelsight.geometry import BoolArray, FloatArray
from wheelsight.odometry.dense import _alignment_kernels as kernels
from wheelsight.odometry.dense.grid import GridFrame, Level
from wheelsight.odometry.dense.reference import ReferenceLevel
from wheelsight.odometry.dense.settings_parts import RegionSettings


@dataclass(frozen=True, slots=True, eq=False)
class Misfits:
    """How far each region (rows, columns) of a frame lies from the surfaces known, at one pose.

    Attributes:
        sigmas: in the mean of its points, in standard deviations of depth.
        metres: likewise, along the surfaces' normals.
        is_told: whether enough of its points lie where something is known.
        settings: which of them count as off.
    """

    sigmas: FloatArray
    metres: FloatArray
    is_told: BoolArray
    settings: RegionSettings

    @property
    def moving(self) -> BoolArray:
        """(rows, columns) which move by themselves; none where many would: then it is the pose that is wrong."""
        if not self._is_judged:
            return np.zeros(self.sigmas.shape, bool)
        usual = float(np.median(self.sigmas[self.is_told]))
        moves = self.is_told & (self.sigmas > max(self.settings.odd_factor * usual, self.settings.odd_sigmas))
        return np.zeros_like(moves) if self._are_many(moves) else moves

    @property
    def doubt_m(self) -> float:
        """How far off the pose itself may be, in metres: the median region's misfit where many regions contradict it.

        Else 0. All that follow a pose do not make it right: somebody close by has most pixels and most keypoints.
        """
        return float(np.median(self.metres[self.is_told])) if self._is_judged and self._are_many(self._is_off) else 0.0

    @property
    def fitting(self) -> float | None:
        """Share of the regions that have a say which do not lie off; None where they are too few."""
        return 1 - np.count_nonzero(self._is_off) / np.count_nonzero(self.is_told) if self._is_judged else None

    @property
    def _is_off(self) -> BoolArray:
        return np.asarray(self.is_told & (self.sigmas > self.settings.odd_sigmas))

    @property
    def _is_judged(self) -> bool:
        return int(np.count_nonzero(self.is_told)) >= self.settings.min_regions

    def _are_many(self, regions: BoolArray) -> bool:
        return int(np.count_nonzero(regions)) > self.settings.most_share * int(np.count_nonzero(self.is_told))


def without(frame: GridFrame, regions: BoolArray) -> GridFrame:
    """A frame of which some regions (rows, columns) have no depth, so that nothing is aligned there."""
    return replace(frame, levels=tuple(_without(level, regions) for level in frame.levels))


def _without(level: Level, regions: BoolArray) -> Level:
    height, width = level.depth_m.shape
    is_out = cv2.resize(regions.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    return replace(level, depth_m=np.where(is_out, np.float32(0), level.depth_m))


def misfits(
    level: Level, seen: ReferenceLevel, T_reference_frame: FloatArray, noise: DepthNoise, settings: RegionSettings
) -> Misfits:
    """How far regions lie from known planes, if the frame is at T_reference_frame (4, 4).

    A point that has another depth than the surface known there counts as `most_sigmas` off; one where nothing is
    known does not count.
    """
    fx, fy, cx, cy = level.intrinsics
    points, rows, columns = level.points()
    there = points @ T_reference_frame[:3, :3].T + T_reference_frame[:3, 3]
    is_ahead = there[:, 2] > noise.near_m
    depth = np.where(is_ahead, there[:, 2], 1.0)
    u, v = np.rint(fx * there[:, 0] / depth + cx), np.rint(fy * there[:, 1] / depth + cy)
    height, width = level.depth_m.shape
    is_inside = is_ahead & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    at = np.where(is_inside, v * width + u, 0).astype(np.int64)
    planes = seen.pixels.reshape(-1, kernels.CHANNELS)[at]
    sigmas = np.hypot(noise.sigma_m(points[:, 2]), noise.sigma_m(depth))
    along = (planes[:, kernels.NX : kernels.NZ + 1] * there).sum(axis=1)
    off = np.abs(along - planes[:, kernels.OFFSET]) / sigmas
    elsewhere = np.abs(planes[:, kernels.DEPTH] - depth) > settings.most_sigmas * sigmas + settings.gate * depth
    off = np.minimum(np.where(elsewhere, settings.most_sigmas, off), settings.most_sigmas)
    is_known = is_inside & np.isfinite(off)
    region = (rows * settings.rows // height) * settings.columns + columns * settings.columns // width
    size = settings.rows * settings.columns
    count = np.bincount(region[is_known], minlength=size)
    shape = settings.rows, settings.columns
    means = [
        (np.bincount(region[is_known], of[is_known], minlength=size) / np.maximum(count, 1)).reshape(shape)
        for of in (off, off * sigmas)
    ]
    return Misfits(means[0], means[1], count.reshape(shape) >= settings.min_points, settings)
