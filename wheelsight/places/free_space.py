"""Free space: whether surfaces of one view stand where the other one saw through.

Things that came or went between two views do so, and walls of another place. What stands free hides what is behind it,
so it has an outline; a wall that closes a corridor meets its side walls. And it is in one view only: surfaces that are
laid wrongly stand in each other's way in both.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from wheelsight.calibration import DepthNoise
from wheelsight.geometry import BoolArray, Float32Array, FloatArray, IntArray, se3
from wheelsight.odometry.dense.grid import Level
from wheelsight.settings import PlaceVerificationSettings

_NOTHING = np.float32(1e6)
# Pixels, and those right, left, below and above of them.
_FIRST, _LAST, _ALL = slice(None, -1), slice(1, None), slice(None)
_NEIGHBOURS = (
    ((_ALL, _FIRST), (_ALL, _LAST)),
    ((_ALL, _LAST), (_ALL, _FIRST)),
    ((_FIRST, _ALL), (_LAST, _ALL)),
    ((_LAST, _ALL), (_FIRST, _ALL)),
)


class Intrusion(NamedTuple):
    """Of `compared` points that could be seen from there, how many stand where it was seen through: `intruding`.

    `free` of these are of things that stand free, in one of both views.
    """

    intruding: int
    compared: int
    free: int = 0

    @property
    def share(self) -> float:
        """Of what is no free thing; 0 where nothing could be compared."""
        return (self.intruding - self.free) / max(self.compared - self.free, 1)

    @property
    def free_share(self) -> float:
        """How much of what was compared is of things that stand free."""
        return self.free / max(self.compared, 1)


def intrusion(
    first: Level, second: Level, T_first_second: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> Intrusion:
    """Of both views' points against what the other one saw, if the second lies at (4, 4) off the first."""
    there = _one_way(second, first, T_first_second, noise, settings)
    back = _one_way(first, second, se3.invert(T_first_second), noise, settings)
    intruding, compared = there.intruding + back.intruding, there.compared + back.compared
    less, more = sorted((there, back), key=lambda way: way.free)
    is_one_sided = less.intruding <= settings.max_intruding * less.compared
    return Intrusion(intruding, compared, more.free if is_one_sided else 0)


def shown_share(
    seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> float:
    """Share of what one view sees whose surfaces another one, from which it lies at (4, 4), shows too; 0 of nothing."""
    points, surface_m, within_m, _, count = _met(seen, by, T_by_seen, noise, settings)
    return int(np.count_nonzero(np.abs(points[:, 2] - surface_m) <= within_m)) / max(count, 1)


def shown_points(
    seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> FloatArray:
    """Points (N, 3) in the frame of one view whose surfaces another one, which lies at (4, 4) off it, shows too."""
    points, surface_m, within_m, _, _ = _met(seen, by, T_by_seen, noise, settings)
    return np.asarray(points[np.abs(points[:, 2] - surface_m) <= within_m])


def _one_way(
    seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> Intrusion:
    """Points that lie behind what was seen are hidden, and tell nothing."""
    points, surface_m, within_m, pixels, _ = _met(seen, by, T_by_seen, noise, settings)
    z_m = points[:, 2]
    is_compared, intrudes = z_m < surface_m + within_m, z_m < surface_m - within_m
    compared, intruding = (np.zeros(seen.depth_m.size, bool) for _ in range(2))
    compared[pixels[is_compared]], intruding[pixels[intrudes]] = True, True
    shape = seen.depth_m.shape
    free = _free_pixels(seen.depth_m, intruding.reshape(shape), compared.reshape(shape), noise, settings)
    return Intrusion(int(np.count_nonzero(intrudes)), int(np.count_nonzero(is_compared)), free)


def _free_pixels(
    depth_m: Float32Array,
    intruding: BoolArray,
    compared: BoolArray,
    noise: DepthNoise,
    settings: PlaceVerificationSettings,
) -> int:
    """How many intruding pixels are of patches most of whose border is an outline, behind which there is more.

    A neighbour that was not compared and is no farther may be of the same thing, so it tells nothing.
    """
    count, label = cv2.connectedComponents(intruding.astype(np.uint8), connectivity=4)
    outline, attached = np.zeros(count, np.int64), np.zeros(count, np.int64)
    within_m = settings.free_m + settings.free_share * depth_m + settings.free_sigmas * noise.sigma_m(depth_m)
    for here, beside in _NEIGHBOURS:
        borders = (label[here] > 0) & (label[beside] == 0) & (depth_m[beside] > 0)
        is_behind = depth_m[beside] > (depth_m + within_m)[here]
        outline += np.bincount(label[here][borders & is_behind], minlength=count)
        attached += np.bincount(label[here][borders & ~is_behind & compared[beside]], minlength=count)
    return int(np.bincount(label.ravel(), minlength=count)[outline > attached].sum())


def _met(
    seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, int]:
    """Points (P, 3) in the other view's frame that fall where it saw a surface; its depths (P,), within how many metres
    both are one, and the points' pixels, counted row by row; and how many points there are in all.
    """
    points, rows, columns = seen.points()
    points, pixels = points @ T_by_seen[:3, :3].T + T_by_seen[:3, 3], rows * seen.depth_m.shape[1] + columns
    count, is_before = len(points), points[:, 2] > noise.near_m
    points, pixels = points[is_before], pixels[is_before]
    fx, fy, cx, cy = by.intrinsics
    u, v = np.rint(points[:, :2] / points[:, 2:] * (fx, fy) + (cx, cy)).astype(np.int64).T
    height, width = by.depth_m.shape
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    u, v, points, pixels = u[inside], v[inside], points[inside], pixels[inside]
    nearest_m, is_known = _nearest(by.depth_m, settings.free_px)[v, u], by.depth_m[v, u] > 0
    surface_m, points, pixels = nearest_m[is_known].astype(float), points[is_known], pixels[is_known]
    sigma_m = np.hypot(noise.sigma_m(surface_m), noise.sigma_m(points[:, 2]))
    within_m = settings.free_m + settings.free_share * surface_m + settings.free_sigmas * sigma_m
    return points, surface_m, within_m, pixels, count


def _nearest(depth_m: Float32Array, radius_px: int) -> Float32Array:
    """The nearest depth (h, w) within so many pixels: at an outline a point may belong to either side."""
    far = np.where(depth_m > 0, depth_m, _NOTHING)
    return np.asarray(cv2.erode(far, np.ones((2 * radius_px + 1,) * 2, np.uint8)), np.float32)
