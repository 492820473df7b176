"""Compiled parts of casting rays: aiming them, finding the geoms they can hit, and turning hits into images.

A tile is a rectangle of pixels, rows `tile`[0] to `tile`[1] and columns `tile`[2] to `tile`[3], the last left out; its
N rays are numbered row by row.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel

_PLANE = 0
_BOX = 6
_BEHIND = 1e-3
# Below this cosine between ray and surface, a shift of the origin may not be carried along the ray.
_GRAZING = 0.02
_TOLERANCE_M = 1e-6


@kernel
def aim(rays: Any, T_world_rows: Any, tile: Any, R: Any, out: Any) -> Any:
    """Turn a tile's `rays` (H, W, 3) into the world, each by its row of `T_world_rows` (H, 4, 4), into `out` (N, 3).

    Returns (4,) the least and greatest x/z and y/z of all of them in a camera frame turned by R (3, 3); infinite where
    one points backwards in it.
    """
    bounds = np.array([np.inf, -np.inf, np.inf, -np.inf])
    i = 0
    for row in range(tile[0], tile[1]):
        T = T_world_rows[row]
        for column in range(tile[2], tile[3]):
            x, y, z = rays[row, column]
            for k in range(3):
                out[i, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z
            a, b, c = out[i]
            i += 1
            depth = R[0, 2] * a + R[1, 2] * b + R[2, 2] * c
            if depth < _BEHIND:
                bounds[0], bounds[1], bounds[2], bounds[3] = -np.inf, np.inf, -np.inf, np.inf
                continue
            u = (R[0, 0] * a + R[1, 0] * b + R[2, 0] * c) / depth
            v = (R[0, 1] * a + R[1, 1] * b + R[2, 1] * c) / depth
            bounds[0], bounds[1] = min(bounds[0], u), max(bounds[1], u)
            bounds[2], bounds[3] = min(bounds[2], v), max(bounds[3], v)
    return bounds


@kernel
def choose(
    kind: Any, size_m: Any, center: Any, half_m: Any, R_world_geom: Any, R: Any, origin: Any, bounds: Any, far_m: float
) -> Any:
    """Indices of the geoms that rays in a frustum can hit; none that they can is left out.

    `center` (G, 3) and `half_m` (G, 3) are of the geoms' boxes, in their frames; a half of -1 marks what is not to be
    hit. The frustum starts at `origin` (3,), is turned by R (3, 3), and reaches from `bounds` (u_min, u_max, v_min,
    v_max) on the plane z = 1 out to `far_m`.

    Left out is what lies outside, and what lies behind a box or plane that the frustum's four corners hit: such a body
    is convex, so that every ray between hits it too, and no deeper than the deepest corner.
    """
    bounded = np.isfinite(bounds[0])
    sides, offsets = _sides(bounds, R, far_m)
    found, nearest = np.empty(len(kind), np.int32), np.empty(len(kind))
    count, limit = 0, np.inf
    for g in range(len(kind)):
        if half_m[g, 0] < 0:
            continue
        if kind[g] == _PLANE:
            nearest[count] = -np.inf
        else:
            nearest[count] = _nearest(R, center[g] - origin, half_m[g], R_world_geom[g])
            if bounded and not _touches(sides, offsets, center[g] - origin, half_m[g], R_world_geom[g]):
                continue
        found[count] = g
        count += 1
        if bounded and (kind[g] == _BOX or kind[g] == _PLANE):
            limit = min(limit, _cover(kind[g], size_m[g], origin - center[g], R_world_geom[g], R, bounds))
    kept = 0
    for i in range(count):
        if nearest[i] <= limit + _TOLERANCE_M:
            found[kept] = found[i]
            kept += 1
    return found[:kept]


@kernel
def _sides(bounds: Any, R: Any, far_m: float) -> tuple[Any, Any]:
    """Inward normals (6, 3) in the world and offsets (6,) of a frustum's planes, from its origin."""
    sides = np.zeros((6, 3))
    offsets = np.zeros(6)
    if np.isfinite(bounds[0]):
        sides[0] = (1.0, 0.0, -bounds[0])
        sides[1] = (-1.0, 0.0, bounds[1])
        sides[2] = (0.0, 1.0, -bounds[2])
        sides[3] = (0.0, -1.0, bounds[3])
        sides[4] = (0.0, 0.0, 1.0)
        sides[5] = (0.0, 0.0, -1.0)
        offsets[5] = far_m
    return sides @ R.T, offsets


@kernel
def _nearest(R: Any, center: Any, half: Any, R_geom: Any) -> Any:
    """Least depth of a box along the z axis of R."""
    depth = 0.0
    for k in range(3):
        along = R[0, 2] * R_geom[0, k] + R[1, 2] * R_geom[1, k] + R[2, 2] * R_geom[2, k]
        depth += R[k, 2] * center[k] - abs(along) * half[k]
    return depth


@kernel
def _touches(sides: Any, offsets: Any, center: Any, half: Any, R: Any) -> bool:
    for s in range(len(sides)):
        n = sides[s]
        reach = offsets[s] + _TOLERANCE_M
        for k in range(3):
            reach += n[k] * center[k] + abs(n[0] * R[0, k] + n[1] * R[1, k] + n[2] * R[2, k]) * half[k]
        if reach < 0:
            return False
    return True


@kernel
def _cover(kind: int, size: Any, start: Any, R_geom: Any, R: Any, bounds: Any) -> float:
    """Depth of the deepest of the four corner rays' hits on a box or plane; infinite where one misses.

    `start` (3,) is where rays begin, from the geom's middle. A ray that begins inside counts as a miss.
    """
    S = R_geom.T @ R
    o = R_geom.T @ start
    deepest = 0.0
    for corner in range(4):
        u, v = bounds[corner % 2], bounds[2 + corner // 2]
        enters, leaves = 0.0, np.inf
        if kind == _PLANE:
            d = S[2, 0] * u + S[2, 1] * v + S[2, 2]
            if o[2] <= 0 or d >= -_TOLERANCE_M:
                return np.inf
            enters = -o[2] / d
        for k in range(2 if kind == _PLANE else 3):
            if kind == _PLANE and size[k] <= 0:
                continue
            d = S[k, 0] * u + S[k, 1] * v + S[k, 2]
            reach = size[k] - _TOLERANCE_M
            if kind == _PLANE:
                if abs(o[k] + enters * d) > reach:
                    return np.inf
            elif abs(d) < 1e-12:
                if abs(o[k]) > reach:
                    return np.inf
            else:
                first, second = (-reach - o[k]) / d, (reach - o[k]) / d
                enters, leaves = max(enters, min(first, second)), min(leaves, max(first, second))
        if enters <= 0 or enters > leaves:
            return np.inf
        deepest = max(deepest, enters)
    return deepest


@kernel
def put(
    chosen: Any,
    kind: Any,
    size_m: Any,
    position: Any,
    R_world_geom: Any,
    to_kind: Any,
    to_size: Any,
    to_position: Any,
    to_R: Any,
    to_group: Any,
) -> None:
    """Copy the `chosen` (K,) geoms into the first places of a small model, group 0; the others go to group 1."""
    to_group[:] = 1
    for i in range(len(chosen)):
        g = chosen[i]
        to_kind[i], to_group[i] = kind[g], 0
        to_size[i], to_position[i] = size_m[g], position[g]
        for k in range(9):
            to_R[i, k] = R_world_geom[g, k // 3, k % 3]


@kernel
def gather(
    hit: Any,
    distance: Any,
    normal: Any,
    rays_world: Any,
    T_world_rows: Any,
    tile: Any,
    origin: Any,
    far_m: float,
    chosen: Any,
    depth_m: Any,
    geom: Any,
    normal_world: Any,
) -> None:
    """Write what a tile's rays hit into an image.

    `hit`, `distance` (N,), `normal` (N, 3) are MuJoCo's answers for `rays_world` (N, 3) from `origin` (3,). A hit
    surface is carried along its tangent plane to where the row's own origin sees it: exact for flat ones; where the ray
    grazes it, the distance stays as it was. `chosen` (K,) are the indices of what was cast at. Where nothing is hit
    within `far_m`, the image stays as it was.
    """
    i = -1
    for row in range(tile[0], tile[1]):
        for column in range(tile[2], tile[3]):
            i += 1
            z = distance[i]
            if hit[i] < 0 or z < 0:
                continue
            n, ray = normal[i], rays_world[i]
            across, carried, square = 0.0, 0.0, 0.0
            for k in range(3):
                across += n[k] * ray[k]
                carried += n[k] * (origin[k] - T_world_rows[row, k, 3])
                square += ray[k] * ray[k]
            if abs(across) > _GRAZING * np.sqrt(square):
                z += carried / across
            if 0 < z <= far_m:
                depth_m[row, column], geom[row, column] = z, chosen[hit[i]]
                for k in range(3):
                    normal_world[row, column, k] = n[k]
