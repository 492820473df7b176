"""Free space: whether surfaces of one view stand where the other one saw through."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from wheelsight.calibration import DepthNoise
from wheelsight.geometry import Float32Array, FloatArray, se3
from wheelsight.odometry.dense.grid import Level
from wheelsight.settings import PlaceVerificationSettings

_NOTHING = np.float32(1e6)


class Intrusion(NamedTuple):
    """Of `compared` points that could be seen from there, how many stand where it was seen through: `intruding`."""

    intruding: int
    compared: int

    @property
    def share(self) -> float:
        """0 where nothing could be compared."""
        return self.intruding / max(self.compared, 1)


def intrusion(
    first: Level, second: Level, T_first_second: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> Intrusion:
    """Of both views' points against what the other one saw, if the second lies at (4, 4) off the first."""
    there = _one_way(second, first, T_first_second, noise, settings)
    back = _one_way(first, second, se3.invert(T_first_second), noise, settings)
    return Intrusion(*(sum(both) for both in zip(there, back, strict=True)))


def shown_share(
    seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> float:
    """Share of what one view sees whose surfaces another one, from which it lies at (4, 4), shows too; 0 of nothing."""
    z_m, surface_m, within_m, count = _met(seen, by, T_by_seen, noise, settings)
    return int(np.count_nonzero(np.abs(z_m - surface_m) <= within_m)) / max(count, 1)


def _one_way(
    seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> Intrusion:
    """Points that lie behind what was seen are hidden, and tell nothing."""
    z_m, surface_m, within_m, _ = _met(seen, by, T_by_seen, noise, settings)
    intruding = int(np.count_nonzero(z_m < surface_m - within_m))
    return Intrusion(intruding, int(np.count_nonzero(z_m < surface_m + within_m)))


def _met(
    seen: Level, by: Level, T_by_seen: FloatArray, noise: DepthNoise, settings: PlaceVerificationSettings
) -> tuple[FloatArray, FloatArray, FloatArray, int]:
    """Points (P,) that fall where the other view saw a surface: their depths, its depths, within how many metres both
    are one; and how many points there are in all.
    """
    points = seen.points()[0] @ T_by_seen[:3, :3].T + T_by_seen[:3, 3]
    count = len(points)
    points = points[points[:, 2] > noise.near_m]
    fx, fy, cx, cy = by.intrinsics
    u, v = np.rint(points[:, :2] / points[:, 2:] * (fx, fy) + (cx, cy)).astype(np.int64).T
    height, width = by.depth_m.shape
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    u, v, z_m = u[inside], v[inside], points[inside, 2]
    nearest_m, is_known = _nearest(by.depth_m, settings.free_px)[v, u], by.depth_m[v, u] > 0
    surface_m, z_m = nearest_m[is_known].astype(float), z_m[is_known]
    sigma_m = np.hypot(noise.sigma_m(surface_m), noise.sigma_m(z_m))
    within_m = settings.free_m + settings.free_share * surface_m + settings.free_sigmas * sigma_m
    return z_m, surface_m, within_m, count


def _nearest(depth_m: Float32Array, radius_px: int) -> Float32Array:
    """The nearest depth (h, w) within so many pixels: at an outline a point may belong to either side."""
    far = np.where(depth_m > 0, depth_m, _NOTHING)
    return np.asarray(cv2.erode(far, np.ones((2 * radius_px + 1,) * 2, np.uint8)), np.float32)
