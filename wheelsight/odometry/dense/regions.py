"""Regions of a view that move by themselves, told by how far all of a region lies from what is known.

Robust weights of pixels are outvoted where a person fills a fifth of the view: each pixel counts, and a person's have
much texture. Here each region has one vote, however much it shows: a region is left out of an alignment where its
points lie clearly farther from the surfaces known than those of the median region (cf. Scona et al., StaticFusion,
ICRA 2018, who weigh clusters).
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from wheelsight.calibration import DepthNoise
from wheelsight.geometry import BoolArray, FloatArray
from wheelsight.odometry.dense import _alignment_kernels as kernels
from wheelsight.odometry.dense.grid import GridFrame, Level
from wheelsight.odometry.dense.reference import ReferenceLevel
from wheelsight.odometry.dense.settings_parts import RegionSettings


def moving_regions(
    level: Level, seen: ReferenceLevel, T_reference_frame: FloatArray, noise: DepthNoise, settings: RegionSettings
) -> BoolArray:
    """(rows, columns) which regions of a frame move by themselves, if the frame is at T_reference_frame (4, 4).

    None do where many would: then it is the pose that is wrong, or nobody knows who moves.
    """
    misfit, count = _misfits(level, seen, T_reference_frame, noise, settings)
    is_told = count >= settings.min_points
    if np.count_nonzero(is_told) < settings.min_regions:
        return np.zeros(misfit.shape, bool)
    usual = float(np.median(misfit[is_told]))
    moves = is_told & (misfit > max(settings.odd_factor * usual, settings.odd_sigmas))
    return moves if np.count_nonzero(moves) <= settings.most_share * np.count_nonzero(is_told) else np.zeros_like(moves)


def without(frame: GridFrame, regions: BoolArray) -> GridFrame:
    """A frame of which some regions (rows, columns) have no depth, so that nothing is aligned there."""
    return replace(frame, levels=tuple(_without(level, regions) for level in frame.levels))


def _without(level: Level, regions: BoolArray) -> Level:
    height, width = level.depth_m.shape
    is_out = cv2.resize(regions.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    return replace(level, depth_m=np.where(is_out, np.float32(0), level.depth_m))


def _misfits(
    level: Level, seen: ReferenceLevel, T_reference_frame: FloatArray, noise: DepthNoise, settings: RegionSettings
) -> tuple[FloatArray, FloatArray]:
    """How far points lie from known planes in the mean, in σ of depth, and how many do, of each region.

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
    total = np.bincount(region[is_known], off[is_known], minlength=size)
    shape = settings.rows, settings.columns
    return (total / np.maximum(count, 1)).reshape(shape), count.reshape(shape).astype(float)
