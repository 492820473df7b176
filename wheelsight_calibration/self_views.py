"""Flat patches in the keyframes of a map, and pairs of keyframes that see the same patches from different places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, se3
from wheelsight.core.keyframes import Keyframe

# Cells along an image's longer side. Kinect v1's error of depth is alike over an eighth of it (docs/decisions), which
# four cells cover. Chosen.
_CELLS_ACROSS = 32
_MOST_OF_CELL = 0.8  # share of a cell's pixels with depth
_LEAST_CELL_PX = 3
# Largest spread of a cell's pixels about its plane, in σ of the depth noise; an edge or a leaf has more. Chosen.
_MOST_SPREAD = 2.5
_STEEPEST = np.cos(np.radians(75.0))  # incidence, beyond which noise and edges decide a patch's depth
# What of a patch's error does not average out: roughness within a cell, as a share of a pixel's noise. Chosen.
_PATCH_SIGMA_M, _PATCH_SHARE = 0.002, 0.3
# A patch seen twice: largest angle between its normals, and the share of the patches that a pair of views must share.
_ALIKE = np.cos(np.radians(20.0))
_LEAST_SHARED, _FEWEST_SHARED = 0.1, 20
_COARSE = 5  # one patch of this number decides whether two views overlap


@dataclass(frozen=True, eq=False)
class Patches:
    """Flat patches of one keyframe, one a cell of a grid over its image, in the camera frame.

    Attributes:
        stamp_s: time of the frame.
        rays: (N, 3) to the patches' middles, with z = 1.
        depth_m: (N,) along z.
        normals: (N, 3) unit, towards the camera.
        sigma_m: (N,) standard deviation of the patch along its normal.
        at: (rows, columns) number of a cell's patch, -1 for none.
        cell_px: side of a cell.
        intrinsics: (4,) fx, fy, cx, cy of the keyframe's images.
    """

    stamp_s: float
    rays: FloatArray
    depth_m: FloatArray
    normals: FloatArray
    sigma_m: FloatArray
    at: IntArray
    cell_px: int
    intrinsics: FloatArray

    @property
    def points_m(self) -> FloatArray:
        """(N, 3) the patches' middles."""
        return self.rays * self.depth_m[:, None]

    def __len__(self) -> int:
        return len(self.depth_m)

    def cells_of(self, points_m: FloatArray) -> IntArray:
        """Return the patch (M,) on which each point (M, 3) of the camera frame is seen, -1 for none."""
        fx, fy, cx, cy = self.intrinsics
        z = points_m[:, 2]
        in_front = z > 0.1
        z = np.where(in_front, z, 1.0)
        column = np.floor((points_m[:, 0] / z * fx + cx + 0.5) / self.cell_px)
        row = np.floor((points_m[:, 1] / z * fy + cy + 0.5) / self.cell_px)
        rows, columns = self.at.shape
        inside = in_front & (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        found = np.full(len(points_m), -1)
        found[inside] = self.at[row[inside].astype(int), column[inside].astype(int)]
        return found


def patches_of(keyframe: Keyframe, calibration: Calibration) -> Patches:
    """Return the flat patches of a keyframe: cells whose inverse depth is linear in the pixel, as a plane's is."""
    depth_m, noise = keyframe.depth_m.astype(float), calibration.depth_noise
    fx, fy, cx, cy = np.asarray(keyframe.intrinsics, float)
    height, width = depth_m.shape
    side = max(_LEAST_CELL_PX, max(height, width) // _CELLS_ACROSS)
    rows, columns = height // side, width // side
    tile = np.s_[: rows * side, : columns * side]
    seen = ((depth_m > noise.near_m) & (depth_m < noise.far_m))[tile]
    inverse = np.divide(1.0, depth_m[tile], out=np.zeros(seen.shape), where=seen)
    v, u = np.mgrid[: rows * side, : columns * side].astype(float)
    x, y = (u - cx) / fx, (v - cy) / fy

    def cells(values: FloatArray) -> FloatArray:
        """(rows · columns, side²)."""
        tiled = np.asarray(values, float).reshape(rows, side, columns, side)
        return tiled.transpose(0, 2, 1, 3).reshape(rows * columns, side * side)

    kept, q, rays = (
        cells(seen.astype(float)),
        cells(inverse),
        np.stack([cells(x), cells(y), np.ones((rows * columns, side**2))], -1),
    )
    weighted = rays * kept[..., None]
    H, g = np.einsum("nki,nkj->nij", weighted, rays), np.einsum("nki,nk->ni", weighted, q)
    count = kept.sum(axis=1)
    usable = count >= _MOST_OF_CELL * side**2
    H[~usable] = np.eye(3)
    middle = np.divide(weighted.sum(axis=1), np.maximum(count, 1)[:, None])
    # The fit is about the cell's middle, since x and y of one cell hardly differ.
    plane = np.linalg.solve(H + 1e-12 * np.eye(3), g[..., None])[..., 0]
    off = (q - np.einsum("nki,ni->nk", rays, plane)) * kept
    at_middle = np.einsum("ni,ni->n", plane, middle)
    usable &= at_middle > 1e-3
    z = 1 / np.where(usable, at_middle, 1.0)
    spread_m = np.sqrt((off**2).sum(axis=1) / np.maximum(count - 3, 1)) * z**2
    pixel_m = noise.sigma_m(z)
    size = np.linalg.norm(plane, axis=1)
    normals = -plane / np.maximum(size, 1e-9)[:, None]
    cosine = -(normals * middle).sum(axis=1) / np.maximum(np.linalg.norm(middle, axis=1), 1e-9)
    usable &= (spread_m < _MOST_SPREAD * pixel_m) & (cosine > _STEEPEST)
    # Neighbouring pixels share their noise: about a third of a cell's pixels are independent (Kinect v1's blocks).
    along = np.abs(normals[:, 2]) * pixel_m / np.sqrt(np.maximum(count / 3, 1))
    sigma_m = np.sqrt(along**2 + _PATCH_SIGMA_M**2 + (_PATCH_SHARE * pixel_m) ** 2)
    numbers = np.full(rows * columns, -1)
    numbers[usable] = np.arange(np.count_nonzero(usable))
    found = (middle[usable], z[usable], normals[usable], sigma_m[usable])
    intrinsics = np.array([fx, fy, cx, cy])
    return Patches(keyframe.stamp_s, *found, numbers.reshape(rows, columns), side, intrinsics)


class PatchPair(NamedTuple):
    """Patches (M,) of view `first` and of view `second` that lie on one surface."""

    first: int
    second: int
    of_first: IntArray
    of_second: IntArray


def matched(views: Sequence[Patches], first: int, second: int, T_first_second: FloatArray, gate_m: float) -> PatchPair:
    """Return the patches that both views see, within `gate_m` along their normals.

    Args:
        T_first_second: (4, 4), correct to about a cell.
        gate_m: largest distance of a patch's middle from the other one's plane; a share of the depth is added.
    """
    a, b = views[first], views[second]
    T = se3.invert(T_first_second)
    points = se3.apply(T, a.points_m)
    cell = b.cells_of(points)
    on = np.flatnonzero(cell >= 0)
    of_b = cell[on]
    normals = a.normals[on] @ T[:3, :3].T
    off_m = np.abs(((points[on] - b.points_m[of_b]) * b.normals[of_b]).sum(axis=1))
    alike = (normals * b.normals[of_b]).sum(axis=1) > _ALIKE
    kept = alike & (off_m < gate_m * (1 + 0.25 * points[on, 2]))
    return PatchPair(first, second, on[kept], of_b[kept])


def overlapping(
    views: Sequence[Patches], T_map_camera: FloatArray, partners: int, on_view: Callable[[int], None] = lambda _: None
) -> list[tuple[int, int]]:
    """Return pairs of views that share surfaces, at most `partners` new ones a view, the most different ones first.

    Views differ by the distance from which they see a surface, and by where in the image it stands: such pairs say the
    most about the camera. The next two views are always partners, since they hold the way together.
    """
    count = len(views)
    inverses = se3.invert(T_map_camera)
    pairs: set[tuple[int, int]] = set()
    for i in range(count):
        some = views[i].points_m[::_COARSE]
        in_map = se3.apply(T_map_camera[i], some)
        gains = np.zeros(count)
        for j in range(i + 1, count):
            points = se3.apply(inverses[j], in_map)
            cell = views[j].cells_of(points)
            on = np.flatnonzero(cell >= 0)
            if len(on) < max(_LEAST_SHARED * len(some), _FEWEST_SHARED / _COARSE):
                continue
            near = np.abs(points[on, 2] - views[j].depth_m[cell[on]]) < 0.1 * (1 + points[on, 2])
            if np.count_nonzero(near) < _LEAST_SHARED * len(some):
                continue
            seen = on[near]
            zoom = np.abs(np.log(points[seen, 2] / some[seen, 2])).mean()
            rays = some[seen, :2] / some[seen, 2:]
            moved = np.linalg.norm(points[seen, :2] / points[seen, 2:] - rays, axis=1).mean()
            gains[j] = np.sqrt(len(seen)) * (0.05 + zoom + 0.5 * moved)
        best = np.argsort(-gains)[:partners]
        chosen = {int(j) for j in best if gains[j] > 0} | {j for j in (i + 1, i + 2) if j < count and gains[j] > 0}
        pairs |= {(i, j) for j in chosen}
        on_view(i)
    return sorted(pairs)


def on_floor(view: Patches, T_base_camera: FloatArray, most_deg: float, most_m: float) -> BoolArray:
    """Return (N,) whether a patch lies on the floor by the mount (4, 4), correct to this angle and height."""
    up = T_base_camera[2, :3]
    height = view.points_m @ up + T_base_camera[2, 3]
    return np.asarray((view.normals @ up > np.cos(np.radians(most_deg))) & (np.abs(height) < most_m))
