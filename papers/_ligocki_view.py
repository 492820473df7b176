"""A virtual camera for `ligocki_elastic.py`: a surfel map seen from outside and above, with all of it in the picture.

Surfels show their face alone, so ceilings and the near walls are cut away by themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray
from wheelsight.mapping import ColoredView, SurfelMap

SIZE = (1280, 960)
_FOCAL_PX = 1500.0
_FAR_M = 100.0
_FILLS = 0.95  # of the picture's width or height
_STRAY_SHARE = 0.0007  # of the surfels, at each edge: a few strays must not make the room small
_STEPS = 40
_FITTED = 20_000  # surfels are enough to find the edges by
_AZIMUTHS = 12
_UPRIGHT = 0.5
_FINER = 2  # rendered so much finer, and averaged: smooth edges
_BEHIND_M = 0.05
_TOP, _BOTTOM = np.array([244, 246, 249]), np.array([206, 213, 222])


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """A pinhole camera without distortion.

    Attributes:
        T_map_camera: (4, 4).
        intrinsics: (4,) fx, fy, cx, cy in pixels; pixel centres lie at integers.
        size: (width, height).
    """

    T_map_camera: FloatArray
    intrinsics: FloatArray
    size: tuple[int, int]

    def scaled(self, factor: float) -> Viewpoint:
        """The same camera with so many times the pixels a side."""
        intrinsics = self.intrinsics * factor
        intrinsics[2:] += 0.5 * (factor - 1)
        return Viewpoint(self.T_map_camera, intrinsics, (round(self.size[0] * factor), round(self.size[1] * factor)))

    def project(self, p_map: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (n, 2) and depths (n,) in metres of points (n, 3) in front of the camera."""
        p = (p_map - self.T_map_camera[:3, 3]) @ self.T_map_camera[:3, :3]
        return p[:, :2] / p[:, 2:] * self.intrinsics[:2] + self.intrinsics[2:], p[:, 2]

    def hides(self, depth_m: Float32Array, p_map: FloatArray) -> BoolArray:
        """Which of points (n, 3) lie behind what the image `depth_m` of this camera shows, or out of the picture."""
        px, far_m = self.project(p_map)
        u, v = np.rint(px).astype(np.int64).T
        is_inside = (u >= 0) & (u < self.size[0]) & (v >= 0) & (v < self.size[1])
        shown_m = depth_m[np.clip(v, 0, self.size[1] - 1), np.clip(u, 0, self.size[0] - 1)]
        return np.asarray(~is_inside | ((shown_m > 0) & (far_m > shown_m + _BEHIND_M)))


def outside(
    surfel_map: SurfelMap, up: FloatArray, ahead: FloatArray, azimuth_deg: float | None, down_deg: float
) -> Viewpoint:
    """Where to look at a map from: from above, with all of it in the picture.

    Args:
        surfel_map: with stable surfels.
        up: (3,) of length 1, in the world.
        ahead: (3,) in the world, not along `up`: azimuth 0.
        azimuth_deg: which way to look, to the left of `ahead`; None for that of twelve which shows the most of walls.
        down_deg: how far to look down.
    """
    if azimuth_deg is not None:
        return _from(surfel_map, up, ahead, azimuth_deg, down_deg)
    tried = [_from(surfel_map, up, ahead, degrees, down_deg) for degrees in np.arange(_AZIMUTHS) * 360 / _AZIMUTHS]
    return max(tried, key=lambda view: _upright_px(surfel_map, up, view))


def _upright_px(surfel_map: SurfelMap, up: FloatArray, view: Viewpoint) -> int:
    """How many pixels show walls and what else stands upright: floors are seen from everywhere."""
    seen = _render(surfel_map, view.scaled(0.25))
    rise = seen.normal @ (view.T_map_camera[:3, :3].T @ up)
    return int(np.count_nonzero((seen.depth_m > 0) & (np.abs(rise) < _UPRIGHT)))


def _from(surfel_map: SurfelMap, up: FloatArray, ahead: FloatArray, azimuth_deg: float, down_deg: float) -> Viewpoint:
    surfels = surfel_map.surfels("stable")
    azimuth, down = np.radians([azimuth_deg, down_deg])
    level = ahead - (ahead @ up) * up
    level /= np.linalg.norm(level)
    forward = np.cos(azimuth) * level + np.sin(azimuth) * np.cross(up, level)
    z = np.cos(down) * forward - np.sin(down) * up
    x = np.cross(forward, up)
    R_map_camera = np.stack([x, np.cross(z, x), z], axis=1)
    shown = surfels.position[surfels.normal @ z < 0].astype(float)
    shown = shown[:: max(1, len(shown) // _FITTED)] @ R_map_camera
    T_map_camera = np.eye(4)
    T_map_camera[:3, :3], T_map_camera[:3, 3] = R_map_camera, R_map_camera @ _eye(shown)
    return Viewpoint(T_map_camera, np.array([_FOCAL_PX, _FOCAL_PX, *(0.5 * np.array(SIZE) - 0.5)]), SIZE)


def _eye(points: FloatArray) -> FloatArray:
    """Where (3,) the camera must stand, in axes of its own, for points (n, 3) to fill the picture."""
    low, high = np.quantile(points, [_STRAY_SHARE, 1 - _STRAY_SHARE], axis=0)
    wanted = np.array(SIZE) * _FILLS / _FOCAL_PX
    away_m = float(max((high - low)[:2] / wanted) + 0.5 * (high - low)[2])
    eye = 0.5 * (low + high) - [0, 0, away_m]
    for _ in range(_STEPS):  # perspective makes what is near larger: each step comes nearer to filling
        slopes = (points - eye)[:, :2] / np.maximum(points - eye, 0.1)[:, 2:]
        first, last = np.quantile(slopes, [_STRAY_SHARE, 1 - _STRAY_SHARE], axis=0)
        eye[:2] += 0.5 * away_m * 0.5 * (first + last)
        step_m = away_m * (float(np.sqrt(max((last - first) / wanted))) - 1)
        away_m, eye[2] = away_m + step_m, eye[2] - step_m
    return np.asarray(eye)


def picture_of(surfel_map: SurfelMap, view: Viewpoint) -> tuple[ByteArray, Float32Array]:
    """The stable surfels from a viewpoint: (h, w, 3) uint8 red green blue on a light ground, and depth (h, w)."""
    seen = _render(surfel_map, view.scaled(_FINER))
    image = np.where(seen.color < 0, np.maximum(seen.grey, 0)[..., None], seen.color)
    is_known = (seen.depth_m > 0)[..., None].astype(np.float32)
    share = cv2.resize(is_known, view.size, interpolation=cv2.INTER_AREA)[..., None]
    color = cv2.resize(image * is_known, view.size, interpolation=cv2.INTER_AREA)
    down = np.linspace(0, 1, view.size[1])[:, None, None]
    picture = color + (1 - share) * (_TOP * (1 - down) + _BOTTOM * down)
    nearest = np.where(seen.depth_m > 0, seen.depth_m, np.float32(np.inf))
    nearest = nearest.reshape(view.size[1], _FINER, view.size[0], _FINER).min(axis=(1, 3))
    return np.asarray(np.clip(np.rint(picture), 0, 255), np.uint8), np.where(np.isinf(nearest), 0, nearest)


def _render(surfel_map: SurfelMap, view: Viewpoint) -> ColoredView:
    shape = (view.size[1], view.size[0])
    return surfel_map.render(view.T_map_camera, view.intrinsics, shape, which="stable", far_m=_FAR_M)


def frustum_of(view: Viewpoint, T_map_camera: FloatArray, slopes: Sequence[FloatArray], far_m: float) -> FloatArray:
    """The edges (8, 2, 2) in pixels, from a camera's centre to four corners by their `slopes` x/z, y/z, and round."""
    corners = np.array([[*slope, 1.0] for slope in slopes]) * far_m
    p_map = np.vstack([np.zeros(3), corners]) @ T_map_camera[:3, :3].T + T_map_camera[:3, 3]
    px, _ = view.project(p_map)
    edges = [(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1)]
    return np.array([[px[a], px[b]] for a, b in edges])
