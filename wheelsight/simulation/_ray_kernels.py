"""Compiled parts of casting rays: aiming them, finding the geoms they can hit, and turning hits into images."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_PLANE = 0
_BEHIND = 1e-3
# Below this cosine between ray and surface, a shift of the origin may not be carried along the ray.
_GRAZING = 0.02


@njit(cache=True, nogil=True)
def aim(rays: Any, R_world_rows: Any, R_world_band: Any, out: Any) -> Any:
    """Turn rays (N, W, 3) of N rows into the world, each by its row's rotation, into `out` (N, W, 3).

    Returns (4,) the least and greatest x/z and y/z of all of them in the camera frame of the band.
    """
    bounds = np.array([np.inf, -np.inf, np.inf, -np.inf])
    for row in range(len(rays)):
        R = R_world_rows[row]
        S = R_world_band.T @ R
        for column in range(rays.shape[1]):
            x, y, z = rays[row, column]
            for i in range(3):
                out[row, column, i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
            depth = S[2, 0] * x + S[2, 1] * y + S[2, 2] * z
            if depth < _BEHIND:
                return np.array([-np.inf, np.inf, -np.inf, np.inf])
            u = (S[0, 0] * x + S[0, 1] * y + S[0, 2] * z) / depth
            v = (S[1, 0] * x + S[1, 1] * y + S[1, 2] * z) / depth
            bounds[0], bounds[1] = min(bounds[0], u), max(bounds[1], u)
            bounds[2], bounds[3] = min(bounds[2], v), max(bounds[3], v)
    return bounds


@njit(cache=True, nogil=True)
def within(
    kind: Any,
    center: Any,
    half: Any,
    R_world_geom: Any,
    is_visible: Any,
    R: Any,
    origin: Any,
    bounds: Any,
    far_m: float,
) -> Any:
    """Indices of the geoms whose oriented boxes reach into a frustum; planes always do.

    `center` (G, 3) and `half` (G, 3) are of the boxes; the frustum starts at `origin` (3,), is turned by R (3, 3) and
    reaches from `bounds` (u_min, u_max, v_min, v_max) on the plane z = 1 out to `far_m`. None that it touches is left
    out; some that it does not touch may be in.
    """
    sides = np.zeros((6, 3))
    sides[0] = (1.0, 0.0, -bounds[0])
    sides[1] = (-1.0, 0.0, bounds[1])
    sides[2] = (0.0, 1.0, -bounds[2])
    sides[3] = (0.0, -1.0, bounds[3])
    sides[4] = (0.0, 0.0, 1.0)
    sides[5] = (0.0, 0.0, -1.0)
    offsets = np.array([0.0, 0.0, 0.0, 0.0, 0.0, far_m])
    sides = sides @ R.T
    found = np.empty(len(kind), np.int32)
    count = 0
    for g in range(len(kind)):
        if not is_visible[g]:
            continue
        if (
            kind[g] == _PLANE
            or not np.isfinite(bounds[0])
            or _touches(sides, offsets, center[g] - origin, half[g], R_world_geom[g])
        ):
            found[count] = g
            count += 1
    return found[:count]


@njit(cache=True, nogil=True)
def _touches(sides: Any, offsets: Any, center: Any, half: Any, R: Any) -> bool:
    for s in range(len(sides)):
        n = sides[s]
        reach = offsets[s] + 1e-6
        for k in range(3):
            reach += n[k] * center[k] + abs(n[0] * R[0, k] + n[1] * R[1, k] + n[2] * R[2, k]) * half[k]
        if reach < 0:
            return False
    return True


@njit(cache=True, nogil=True)
def gather(
    hit: Any,
    distance: Any,
    normal: Any,
    rays_world: Any,
    shift: Any,
    far_m: float,
    geoms: Any,
    depth_m: Any,
    geom: Any,
    normal_world: Any,
) -> None:
    """Write what a band's rays hit into its rows of the view.

    `hit`, `distance` (N·W,), `normal` (N·W, 3) are MuJoCo's answers for rays from the band's origin; `shift` (N, 3)
    takes each row's own origin to the band's. A hit surface is carried along its tangent plane: exact for flat ones;
    where the ray grazes it, the distance stays as it was. `geoms` (K,) are the indices of what was cast at.
    """
    rows, columns = depth_m.shape
    for row in range(rows):
        for column in range(columns):
            i = row * columns + column
            z = distance[i]
            if hit[i] < 0 or z < 0:
                depth_m[row, column], geom[row, column], normal_world[row, column] = 0.0, -1, 0.0
                continue
            n, ray = normal[i], rays_world[row, column]
            across = n[0] * ray[0] + n[1] * ray[1] + n[2] * ray[2]
            length = np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
            if abs(across) > _GRAZING * length:
                z += (n[0] * shift[row, 0] + n[1] * shift[row, 1] + n[2] * shift[row, 2]) / across
            if z > far_m or z <= 0:
                depth_m[row, column], geom[row, column], normal_world[row, column] = 0.0, -1, 0.0
                continue
            depth_m[row, column], geom[row, column] = z, geoms[hit[i]]
            for k in range(3):
                normal_world[row, column, k] = n[k]
