"""The surfaces that a simulated camera looked at, and how far a model is from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, PinholeCamera

CELL_M = 0.02
_STRIDE_PX = 4
_NEIGHBOURS = 8
# Samples this many pixels apart are joined by disks that reach half the diagonal between them.
_REACH = _STRIDE_PX / np.sqrt(2)


@dataclass(frozen=True, slots=True, eq=False)
class TrueSurface:
    """Disks on true surfaces, at most one in a cell of 2 cm, so that each counts for as much surface.

    Attributes:
        points: (n, 3) in the world frame, metres.
        normals: (n, 3) of length 1.
        reach_m: (n,) the disks' radii.
        was_seen: (n,) whether the sensor measured there.
    """

    points: FloatArray
    normals: FloatArray
    reach_m: FloatArray
    was_seen: BoolArray

    def distances_m(self, points: FloatArray) -> FloatArray:
        """(m,) from points (m, 3) to the nearest of the disks."""
        tree = KDTree(self.points)
        out = np.empty(len(points))
        for part in np.array_split(np.arange(len(points)), max(1, len(points) // 100_000)):
            _, near = tree.query(points[part], k=min(_NEIGHBOURS, len(self.points)))
            near = near.reshape(len(part), -1)
            off = points[part, None] - self.points[near]
            across = np.abs((off * self.normals[near]).sum(axis=-1))
            along = np.sqrt(np.maximum((off**2).sum(axis=-1) - across**2, 0))
            beyond = np.maximum(along - self.reach_m[near], 0)
            out[part] = np.hypot(across, beyond).min(axis=1)
        return out

    def covered(self, points: FloatArray, within_m: float = 0.02) -> float:
        """The share of what was seen that has one of the points (m, 3) so near."""
        if not len(points):
            return 0.0
        distance_m, _ = KDTree(points).query(self.points[self.was_seen], distance_upper_bound=within_m)
        return float(np.isfinite(distance_m).mean())


class SurfaceBuilder:
    """Collects the true surface from what a camera without error would see."""

    def __init__(self, camera: PinholeCamera) -> None:
        self._rays = camera.rays()
        self._focal_px = camera.fx
        self._parts: list[FloatArray] = []

    def add(self, true_depth_m: Float32Array, T_world_camera: FloatArray, was_measured: BoolArray) -> None:
        """What is seen without error, (H, W), from a pose (4, 4), and at which pixels (H, W) the sensor measured."""
        points = self._rays * true_depth_m[..., None].astype(float)
        right, down = points[:, 1:] - points[:, :-1], points[1:] - points[:-1]
        normal = np.cross(right[:-1], down[:, :-1])
        depth_m = true_depth_m[:-1, :-1]
        # The neighbour that spans an edge lies farther off than any surface seen at less than 80°.
        step_m = np.maximum(np.linalg.norm(right[:-1], axis=-1), np.linalg.norm(down[:, :-1], axis=-1))
        there = (depth_m > 0) & (true_depth_m[1:, :-1] > 0) & (true_depth_m[:-1, 1:] > 0)
        there &= step_m < 6 * depth_m / self._focal_px
        pick = np.zeros_like(there)
        pick[::_STRIDE_PX, ::_STRIDE_PX] = True
        pick &= there
        R, t = T_world_camera[:3, :3], T_world_camera[:3, 3]
        normals = normal[pick] / np.linalg.norm(normal[pick], axis=-1, keepdims=True)
        reach_m = _REACH * depth_m[pick] / self._focal_px
        where = points[:-1, :-1][pick] @ R.T + t
        self._parts.append(np.column_stack([where, normals @ R.T, reach_m, was_measured[:-1, :-1][pick]]))

    def surface(self) -> TrueSurface:
        """One disk a cell: of what was seen where there is such, and then the nearest, which is the smallest."""
        disks = np.concatenate(self._parts)
        disks = disks[np.lexsort((disks[:, 6], -disks[:, 7]))]
        _, first = np.unique(np.floor(disks[:, :3] / CELL_M).astype(np.int64), axis=0, return_index=True)
        disks = disks[first]
        return TrueSurface(disks[:, :3], disks[:, 3:6], np.maximum(disks[:, 6], CELL_M / 2), disks[:, 7] > 0)
